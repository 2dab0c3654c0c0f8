"""What a fit ends with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from hybrid_id.identification.least_squares import LeastSquares, Options, Outcome
from hybrid_id.identification.objective import Evaluation
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

MESSAGES = {
    "converged": "converged: the next step would be shorter than the tolerance (0.01 standard errors if not set)",
    "stalled": "no step lowers the cost any more; check the start values, or try others",
    "max_iterations": "iterations or restarts used up before convergence; raise max_iterations in a study file, or try "
    "other start values",
    "interrupted": "stopped by the user; the values are those of the last step",
    "diverged": "the simulation diverged at the start values; correct units, signs or start values",
}

NO_ESTIMATE = ("interrupted", "diverged")
"""Ends of a fit whose values are no optimum of anything."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """One parameter set, identified from one record or from several.

    Attributes:
        system: the identified system (start values replaced, bounds kept).
        names: names of the estimated parameters.
        values: estimates in physical units, ``(n_f,)``.
        units: their units.
        status: "converged", "stalled", "max_iterations", "interrupted" or "diverged".
        message: what the status means and what to do next.
        records: names of the records it was fitted to, one for each row: pieces of a record have its name.
        cost: loss with priors at the end.
        n_samples: number of measurements.
        iterations: trial steps.
        jacobian: for each row the weighted sensitivities of the outputs, start state eliminated, ``(T, n_y, n_f)``.
        residual: for each row the weighted residuals (measured - simulated), ``(T, n_y)``; what a robust loss makes
            of both, see :func:`sensitivities`.
        prior_precision: of each estimated parameter, ``(n_f,)``, 0 where it has no prior.
        x0: start states of each row, ``(R, n_x)``.
        engine: how it was integrated.
        history: cost after each iteration.
    """

    system: System
    names: tuple[str, ...]
    values: np.ndarray
    units: tuple[str, ...]
    status: str
    records: tuple[str, ...]
    cost: float
    n_samples: int
    iterations: int
    jacobian: tuple[np.ndarray, ...]
    residual: tuple[np.ndarray, ...]
    prior_precision: np.ndarray
    x0: np.ndarray
    engine: Engine
    history: tuple[float, ...] = field(default=())

    @property
    def message(self) -> str:
        """What the status means, and what to do next."""
        return MESSAGES[self.status]

    @property
    def ok(self) -> bool:
        """Whether the estimates may be used."""
        return self.status == "converged"

    @property
    def left_early(self) -> bool:
        """Whether the values are no optimum of anything, so that no interval may be claimed around them."""
        return self.status in NO_ESTIMATE

    @property
    def noise_scale(self) -> float:
        """RMS of the weighted residuals: 1 where the model misses no more than the weights say."""
        return float(np.sqrt(sum(np.sum(r**2) for r in self.residual) / max(self.n_samples, 1)))

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Estimated parameters that ended on a bound."""
        found = []
        for name, value in zip(self.names, self.values, strict=True):
            spec = self.system.parameter(name).spec
            width = max(abs(value), 1e-300)
            if value - spec.lower <= 1e-9 * width or spec.upper - value <= 1e-9 * width:
                found.append(name)
        return tuple(found)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Estimated parameters on which no measurement depends: they stay where they started."""
        seen = np.any([np.abs(part).max((0, 1)) > 0.0 for part in self.jacobian], axis=0)
        return tuple(name for name, one in zip(self.names, seen, strict=True) if not one)

    def of_records(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Sensitivities and residuals of each record, its pieces one after the other.

        Covariances take records as independent, which pieces of one are not: what a model lacks outlasts them.
        """
        return self.joined(self.jacobian), self.joined(self.residual)

    def joined(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """What each row has, the rows that are pieces of one record one after the other: an array for each record."""
        found = dict[str, list[np.ndarray]]()
        for name, part in zip(self.records, parts, strict=True):
            found.setdefault(name, []).append(part)
        return [np.concatenate(pieces) for pieces in found.values()]

    def condensed(self) -> FitResult:
        """The same fit with a root of each row's sensitivities, ``(n_f, 1, n_f)``, whose products are the same.

        Information and covariances come from products alone, and the root takes a thousandth of the memory.
        """
        flat = [part.reshape(-1, part.shape[-1]) for part in self.jacobian]
        roots = [np.asarray(np.linalg.qr(part, mode="r")) for part in flat]
        return replace(self, jacobian=tuple(root[:, None, :] for root in roots))

    def summary(self) -> str:
        """The fit in a few lines."""
        lines = [f"{', '.join(dict.fromkeys(self.records))}: {self.message} ({self.iterations} iterations)"]
        width = max((len(n) for n in self.names), default=0)
        for name, value, unit in zip(self.names, self.values, self.units, strict=True):
            note = "  at its bound" if name in self.at_bound else ""
            note += "  not seen by these records" if name in self.unseen else ""
            lines.append(f"  {name:<{width}}  {value:.5g} {unit}{note}")
        lines.append(f"  weighted residual {self.noise_scale:.3g} (1 = as the noise says)")
        return "\n".join(lines)


def make_result(problem: LeastSquares, outcome: Outcome, chosen: int, options: Options) -> FitResult:
    """The result of one set of a batched fit.

    Args:
        problem: what was minimised; of several starts, the records of one.
        outcome: end of the fit.
        chosen: the set.
        options: hold the loss.
    """
    system, batch, free = problem.system, problem.batch, problem.free
    rows = (problem.sets == chosen).nonzero().flatten()
    records = rows % batch.rows
    theta = outcome.theta[:, chosen].cpu()
    info = [system.table[i] for i in free]
    values = {i.name: float(theta[k]) for i, k in zip(info, free, strict=True)}
    jacobian, residual = sensitivities(outcome.at, rows, records, batch, options)
    return FitResult(
        system=system.with_values(values),
        names=tuple(values),
        values=np.array(list(values.values())),
        units=tuple(i.unit for i in info),
        status=outcome.status[chosen],
        records=tuple(batch.names[int(r)] for r in records),
        cost=float(outcome.cost[chosen]),
        n_samples=int((batch.weight[records] > 0).sum()),
        iterations=int(outcome.iterations[chosen]),
        jacobian=jacobian,
        residual=residual,
        prior_precision=problem.bounds.prior_precision.cpu().numpy(),
        x0=outcome.at.x[rows, 0].cpu().numpy(),
        engine=problem.engine,
        history=tuple(float(h[chosen]) for h in outcome.history),
    )


def sensitivities(
    at: Evaluation, rows: Tensor, records: Tensor, batch: Batch, options: Options
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """For each row the weighted sensitivities J, the start state eliminated, and the weighted residuals r.

    Of a robust loss J sqrt(m) and loss'(r) / sqrt(m), m the mean of loss'': their products are the curvature and the
    scores of an M-estimate (P. J. Huber, Robust Statistics, 1981, section 7.6), whose covariance so is that of a least
    squares'. The weights of its iterations would claim the curvature of residuals that pull alike wherever they are.
    """
    n_x, loss = at.x.shape[-1], options.loss
    known = (batch.weight[records] > 0).to(at.residual.device)
    curvature = math.sqrt(loss.curvature(at.residual[rows][known]))
    jacobians, residuals = [], []
    for row, record in zip(rows.tolist(), records.tolist(), strict=True):
        keep = (batch.weight[record] > 0).any(1)
        residual = at.residual[row][keep]
        jacobian = at.jacobian[row][keep] * curvature
        hessian = at.hessian[row]
        start, cross = hessian[:n_x, :n_x], hessian[:n_x, n_x:]
        back, singular = torch.linalg.solve_ex(start, cross)
        if singular:  # a start state that the record does not see, inside a gear's play say, takes up nothing
            back = torch.linalg.pinv(start, hermitian=True) @ cross
        jacobians.append((jacobian[..., n_x:] - jacobian[..., :n_x] @ back).cpu().numpy())
        residuals.append((residual * loss.factor(residual) / curvature).cpu().numpy())
    return tuple(jacobians), tuple(residuals)
