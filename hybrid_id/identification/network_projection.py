"""Networks held off what the physics can say: the part of their accelerations that parameters cause, too, has a price.

Source: B. M. Gyorok et al., Orthogonal projection-based regularization for efficient model augmentation, L4DC 2025
(PMLR 283): the price of ``P r``, with P the projection onto the physics' sensitivities along the records.
Differs from it: sensitivities of the accelerations at the measured states rather than of the model's next state, so
that neither P nor what it is taken along moves within a stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybrid_id.identification.network_data import networks_of
from hybrid_id.simulation.prepare import Batch
from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class Projection:
    """Price of the networks' overlap with the physics, ``w / 2 ||Q' c||^2``, along fixed states.

    Here c are the accelerations that the networks cause there and Q is an orthonormal basis of those that the estimated
    parameters cause. The weight w makes a mean square of ``(Q' c)`` equal to that of output scales everywhere cost as
    much as a mean square output error of ``price`` noise variances.

    Attributes:
        system: holds the networks.
        weights: all of them, in the order of the system's parameters.
        x, u, values: states, channels and parameters (table order), along which c is taken.
        through: by network's output name, ``sqrt(w) Q' diag(e)`` with the accelerations e of a unit output, ``(n, N)``.
    """

    system: System
    weights: list[nn.Parameter]
    x: list[Tensor]
    u: dict[str, Tensor]
    values: list[Tensor]
    through: dict[str, Tensor]

    def parts(self) -> Tensor:
        """Weighted parts of the networks' accelerations along each direction of Q, ``(n,)``."""
        names = list(self.through)
        outputs = self.system.outputs(names, self.x, self.u, self.system.views(self.values))
        found = []
        for name, output in zip(names, outputs, strict=True):
            matrix = self.through[name]
            found.append(matrix @ output.expand_as(self.x[0]).repeat(matrix.shape[1] // len(self.x[0])))
        return torch.stack(found).sum(0)

    def value(self) -> tuple[Tensor, Tensor]:
        """Price of the weights as they are, and its gradient, ``(n_w,)``."""
        with torch.enable_grad():
            cost = 0.5 * self.parts().square().sum()
            grads = torch.autograd.grad(cost, self.weights, allow_unused=True)
        return cost.detach(), self._flat(grads)

    def curvature(self) -> Tensor:
        """Its Gauss-Newton matrix in the weights, ``(n_w, n_w)``."""
        with torch.enable_grad():
            parts = self.parts()
            rows = [
                self._flat(torch.autograd.grad(p, self.weights, retain_graph=True, allow_unused=True))
                for p in parts
            ]
        jacobian = torch.stack(rows)
        return jacobian.T @ jacobian

    def _flat(self, grads: tuple[Tensor | None, ...]) -> Tensor:
        pairs = zip(grads, self.weights, strict=True)
        return torch.cat([(torch.zeros_like(w) if g is None else g).flatten() for g, w in pairs])


def projection(
    system: System, batch: Batch, theta: Tensor, weights: list[nn.Parameter], *, width: float, price: float
) -> Projection | None:
    """The price of overlap along the states of a batch's guess; None where there is none to pay.

    Args:
        system: holds the networks.
        batch: rows; samples without a measurement do not count.
        theta: all parameters, ``(n_p, 1)``.
        weights: of the networks.
        width: speed over which friction is smoothed [rad/s].
        price: see :class:`Projection`.
    """
    used = (batch.weight > 0).any(2).reshape(-1)
    x = [column.reshape(-1)[used] for column in batch.x.unbind(2)]
    u = {name: channel.reshape(-1)[used] for name, channel in batch.u.items()}
    values = list(theta.detach())
    found = effects(system, width, x, u, values)
    free = [found[name] for name in physical_names(system)]
    basis = span(torch.stack(free, 1)) if free else x[0].new_zeros(len(x[0]), 0)
    if price == 0.0 or basis.shape[1] == 0:
        return None
    data = float((batch.weight > 0).sum())
    caused = {
        name: found[f"b_0 {networks.joint.name}/{place}"] for name, place, _, networks in networks_of(system)
    }
    scales = {name: part.output_scale for name, _, part, _ in networks_of(system)}
    size = sum(float((caused[n] * scales[n]).square().sum()) for n in caused)
    weight = (price * data / max(size, 1e-300)) ** 0.5
    return Projection(system, weights, x, u, values, {n: weight * basis.T * e for n, e in caused.items()})


def effects(
    system: System, width: float, x: Sequence[Tensor], u: Mapping[str, Tensor], values: Sequence[Tensor]
) -> dict[str, Tensor]:
    """Derivatives of all accelerations, in units of their RMS, by each estimated parameter and each network's b_0.

    The networks sleep meanwhile: else a change of scale of all torques looks like any network.

    Args:
        system: equations of motion.
        width: speed over which friction is smoothed [rad/s].
        x: states, ``(N,)`` each.
        u: channels, ``(N,)`` each.
        values: all parameters in table order, ``(1,)`` each.

    Returns:
        By name of the parameter, or ``b_0 joint1/motor``, ``(N times speeds,)``.
    """
    values, leaves = list(values), {}
    for k, info in enumerate(system.table):
        if info.spec.estimate or info.symbol == "b_0":
            place = info.component.rpartition("/")[0]
            values[k] = values[k].expand_as(x[0]).clone().requires_grad_()
            leaves[f"b_0 {place}" if info.symbol == "b_0" else info.name] = values[k]
    p = system.views(values)
    for key, part in system.networks.items():
        for name, weight in part.last_weights().items():
            setattr(p[key], name, torch.zeros_like(weight))
    with torch.enable_grad():
        rates = system.rates(x, u, p, width=width)
        rows = []
        for row in system.speed_rows:
            size = rates[row].detach().square().mean().sqrt().clamp_min(1e-300)
            grads = torch.autograd.grad(
                rates[row].sum(), list(leaves.values()), retain_graph=True, allow_unused=True
            )
            rows.append([torch.zeros_like(x[0]) if g is None else g / size for g in grads])
    return {name: torch.cat([row[k] for row in rows]) for k, name in enumerate(leaves)}


def physical_names(system: System) -> list[str]:
    """The estimated parameters, without those that belong to a network."""
    return [info.name for info in system.table if info.spec.estimate and info.symbol != "b_0"]


def span(columns: Tensor) -> Tensor:
    """Orthonormal basis of the span of columns ``(N, n)``."""
    size = columns.norm(dim=0)
    columns = columns[:, size > 0] / size[size > 0]
    if columns.shape[1] == 0:
        return columns
    left, strength, _ = torch.linalg.svd(columns, full_matrices=False)
    return left[:, strength > 1e-9 * strength[0]]
