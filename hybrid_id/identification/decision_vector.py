"""What the adjoint trainer moves: each set's parameters, first states and network weights, as one vector.

Bounds are bounds here, too. Raw transforms, the usual way in training loops, flatten the objective near a bound: a
parameter that an early step drives there creeps back over a hundred gradients (f_13 of the paper's law did).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from hybrid_id.identification.costate import Gradient, gradient
from hybrid_id.identification.least_squares import LeastSquares
from hybrid_id.identification.networks import linearise_with_weights
from hybrid_id.identification.objective import Evaluation, Loss, evaluate, evaluate_condensed
from hybrid_id.simulation.lifted import condense
from hybrid_id.simulation.solvers import OdeEngine

OPEN_SHARE = 0.5
"""A direction that the data leave open is held in the metric (not in the objective) to this share of a parameter."""


@dataclass(frozen=True)
class Problem(LeastSquares):
    """Output error of every set as a function of its decision vector q, ``(G, N)``.

    q holds the free parameters in units of their size, the first states of the set's rows relative to the measured
    ones in units of their prior standard deviation, and (one set only) the networks' weights.

    Attributes:
        engine: how the system is integrated and differentiated.
        base: all parameters of each set in table order, ``(n_p, G)``; the free ones are replaced.
        extra: weights of the residual networks.
        loss: loss of the weighted residuals.
        hold: whether the free parameters stay where they are, while weights and first states move.
    """

    engine: OdeEngine
    base: Tensor
    extra: list[nn.Parameter]
    loss: Loss
    hold: bool = False

    @property
    def slots(self) -> Tensor:
        """Number of each row among the rows of its set, ``(R,)``."""
        same = self.sets[:, None] == self.sets[None, :]
        return same.tril(-1).sum(1)

    @property
    def data(self) -> Tensor:
        """Number of measurements of each set, ``(G,)``."""
        count = (self.batch.weight > 0).sum((1, 2)).to(self.base.dtype)
        return count.new_zeros(self.base.shape[1]).index_add(0, self.sets, count).clamp_min(1.0)

    @property
    def unit(self) -> Tensor:
        """Size of each free parameter, ``(n_f,)``."""
        return 10.0 * self.bounds.scale

    def start(self, theta: Tensor) -> Tensor:
        """Vector at all parameters ``(n_p, G)``, measured first states, and the weights as they are."""
        values = theta[self.free].T / self.unit
        states = int(self.slots.max() + 1) * self.batch.x.shape[2]
        weights = [w.detach().flatten() for w in self.extra]
        tail = [torch.cat(weights)[None].expand(len(values), -1)] if weights else []
        return torch.cat([values, values.new_zeros(len(values), states), *tail], 1)

    def theta(self, q: Tensor) -> Tensor:
        """All parameters of each set, ``(n_p, G)``."""
        theta = self.base.clone()
        # the box of q and this product are rounded each
        theta[self.free] = self.bounds.clip(self.unit * q[:, : len(self.free)]).T
        return theta

    def first_states(self, q: Tensor) -> Tensor:
        """First state of each row, ``(R, n_x)``."""
        return self.batch.x[:, 0] + self.batch.x0_std * self._states(q)[self.sets, self.slots]

    @property
    def weights(self) -> int:
        """Number of weights beyond the table."""
        return sum(w.numel() for w in self.extra)

    def set_weights(self, q: Tensor) -> None:
        """Write the weights beyond the table into the system."""
        if self.extra:
            torch.nn.utils.vector_to_parameters(q[0, -self.weights :], self.extra)

    def box(self, q: Tensor, *, trust: bool = True) -> tuple[Tensor, Tensor]:
        """Least and largest step from q, ``(G, N)`` each: bounds, and how far a parameter may move at once."""
        size = len(self.free)
        value = q[:, :size]
        scale = torch.maximum(value.abs(), 0.1 * torch.ones_like(value))
        low, high = torch.full_like(q, -torch.inf), torch.full_like(q, torch.inf)
        low[:, :size] = self.bounds.lower / self.unit - value
        high[:, :size] = self.bounds.upper / self.unit - value
        if trust:
            low[:, :size] = torch.maximum(low[:, :size], -0.6 * scale)
            high[:, :size] = torch.minimum(high[:, :size], 1.5 * scale)
        if self.hold:
            low[:, :size], high[:, :size] = 0.0, 0.0
        return low.clamp_max(0.0), high.clamp_min(0.0)

    def _states(self, q: Tensor) -> Tensor:
        end = q.shape[1] - self.weights
        return q[:, len(self.free) : end].reshape(len(q), -1, self.batch.x.shape[2])

    def of(self, chosen: Tensor) -> tuple[Problem, Tensor]:
        """The problem of some sets only, and the rows that belong to them."""
        local = torch.full((self.base.shape[1],), -1, device=self.sets.device)
        local[chosen] = torch.arange(len(chosen), device=self.sets.device)
        rows = (local[self.sets] >= 0).nonzero().flatten()
        part = replace(
            self, batch=self.batch.take(rows), sets=local[self.sets[rows]], base=self.base[:, chosen]
        )
        return part, rows

    def value(self, q: Tensor, nodes: Tensor) -> tuple[Tensor, Tensor, Gradient]:
        """Cost ``(G,)`` with priors, its gradient ``(G, N)``, and the simulation of the rows.

        Args:
            q: decision vector.
            nodes: states near the free run, ``(R, T, n_x)``.
        """
        self.set_weights(q)
        theta = self.theta(q)
        guess = torch.cat([self.first_states(q)[:, None], nodes[:, 1:]], 1)
        run = gradient(
            self.system, self.engine, self.batch, guess, theta[:, self.sets], self.free,
            loss=self.loss, extra=self.extra,
        )  # fmt: skip
        offset = theta[self.free].T - self.bounds.prior_mean
        states = self._states(q)
        cost = run.cost.new_zeros(len(q)).index_add(0, self.sets, run.cost)
        cost = cost + self.bounds.prior_cost(theta[self.free].T) + 0.5 * states.square().sum((1, 2))
        by_theta = torch.zeros_like(offset).index_add(0, self.sets, run.theta)
        by_value = self.unit * (by_theta + self.bounds.prior_precision * offset)
        by_state = states.clone()
        by_state[self.sets, self.slots] += self.batch.x0_std * run.start
        by_weight = [torch.cat([g.flatten() for g in run.extra])[None]] if self.extra else []
        return cost, torch.cat([by_value, by_state.flatten(1), *by_weight], 1), run

    def evaluated(self, q: Tensor, nodes: Tensor) -> Evaluation:
        """Sensitivities of the outputs to first states, parameters and, last, the weights of networks.

        Args:
            q: decision vector.
            nodes: the free run there.
        """
        self.set_weights(q)
        theta, exact = self.theta(q)[:, self.sets], replace(self.engine, gradient="backprop")
        if self.extra:
            lin = linearise_with_weights(self.system, exact, self.batch, nodes, theta, self.free)
            return evaluate_condensed(self.batch, nodes, lin, condense(lin, nodes), self.loss)
        return evaluate(self.system, exact, self.batch, nodes, theta, self.free, loss=self.loss, chunk=1)

    def held(self, cost: Tensor) -> Tensor:
        """Information that holds each parameter, in units of its size, and each weight beside the records, ``(G, n)``.

        Args:
            cost: at the end of the fit, which tells the noise.
        """
        noise = 2.0 * cost / self.data
        prior = self.bounds.prior_precision * self.unit.square() + (noise / OPEN_SHARE**2)[:, None]
        return torch.cat([prior, prior.new_full((len(prior), self.weights), float(noise[0]))], 1)

    def curvature(self, at: Evaluation, q: Tensor, cost: Tensor) -> Tensor:
        """Gauss-Newton matrix in the decision vector, ``(G, N, N)``, held where the records leave directions open.

        Args:
            at: sensitivities at q.
            q: decision vector.
            cost: the cost there.
        """
        n_f, n_x, size = len(self.free), self.batch.x.shape[2], q.shape[1]
        unit = self.batch.x0_std.where(self.batch.x0_std > 0, torch.ones_like(self.batch.x0_std))
        one = unit.new_ones(len(unit), self.weights)
        factor = torch.cat([unit, self.unit.expand(len(unit), -1), one], 1)
        hessian = at.hessian * factor[:, :, None] * factor[:, None, :]
        full = torch.eye(size, dtype=q.dtype, device=q.device).repeat(len(q), 1, 1)
        shared = [*range(n_f), *range(size - one.shape[1], size)]
        grid = torch.tensor(shared, device=q.device)
        full[:, grid[:, None], grid] = torch.diag_embed(self.held(cost)).index_add(
            0, self.sets, hessian[:, n_x:, n_x:]
        )
        for row, (g, slot) in enumerate(zip(self.sets.tolist(), self.slots.tolist(), strict=True)):
            at_slot = slice(n_f + slot * n_x, n_f + (slot + 1) * n_x)
            full[g, at_slot, at_slot] = hessian[row, :n_x, :n_x]
            full[g, grid, at_slot] = hessian[row, n_x:, :n_x]
            full[g, at_slot][:, grid] = hessian[row, :n_x, n_x:]
        return full
