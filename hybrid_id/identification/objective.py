"""The weighted output error (paper, eq. 2): its loss, and its quadratic model at a point of the lifted problem."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.lifted import Outputs, condense, linearise, shoot
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class Loss:
    """Paper, eq. (2): ``V = mean of eps^2``, each eps weighted to r by its channel's noise; and two robust losses.

    ``l2`` is r^2 / 2 (the paper's, up to a constant factor), ``huber`` Huber's with threshold ``delta``, ``l1`` |r|.

    ``l1`` is smoothed below ``delta``; both robust losses act through iterative re-weighting. The valleys of ``l1`` are
    narrow: a fit walks down its ``stages``, smoothed below each of ``widths`` times ``delta``.
    """

    kind: str = "l2"
    delta: float = 3.0
    widths: tuple[float, ...] = (30.0, 10.0, 3.0, 1.0)

    def __post_init__(self) -> None:
        if self.kind not in ("l2", "huber", "l1"):
            raise InputError(f"The loss '{self.kind}' is not known; use l2, huber or l1.")
        if not self.delta > 0.0:
            raise InputError(
                f"The loss has delta = {self.delta}; give a positive number of standard deviations."
            )

    @property
    def stages(self) -> tuple[Loss, ...]:
        """Losses to minimise in turn; the last one is the loss itself."""
        return tuple(
            replace(self, delta=w * self.delta) for w in (self.widths if self.kind == "l1" else (1.0,))
        )

    def value(self, r: Tensor) -> Tensor:
        """Loss of each residual."""
        if self.kind == "l2":
            return 0.5 * r.square()
        small = r.abs() <= self.delta
        huber = torch.where(small, 0.5 * r.square(), self.delta * (r.abs() - 0.5 * self.delta))
        return huber / self.delta if self.kind == "l1" else huber

    def factor(self, r: Tensor) -> Tensor:
        """Weight of each squared residual in the quadratic model, loss'(r) / r."""
        if self.kind == "l2":
            return torch.ones_like(r)
        factor = self.delta / r.abs().clamp_min(self.delta)
        return factor / self.delta if self.kind == "l1" else factor

    def curvature(self, r: Tensor) -> float:
        """Mean of loss''(r): what a residual tells of an estimate; of one residual at least."""
        if self.kind == "l2" or not r.numel():
            return 1.0
        share = max(float((r.abs() <= self.delta).double().mean()), 1.0 / r.numel())
        return share / self.delta if self.kind == "l1" else share


@dataclass
class Evaluation:
    """Objective and its quadratic model at one point, rows of the batch and sets of parameters.

    Attributes:
        x: nodes, ``(R, T, n_x)``.
        node_sensitivity: of the nodes, condensed, ``(R, T, n_x, n_x + n_f + 1)``.
        jacobian: weighted sensitivities of the outputs to (first state, parameters), ``(R, T, n_y, n_x + n_f)``.
        residual: weighted residuals of the simulation (defects closed to first order), ``(R, T, n_y)``.
        cost: loss of each row, its initial-state prior included, ``(R,)``.
        hessian: Gauss-Newton matrix of each row in (first state, parameters), ``(R, n, n)``.
        gradient: ``(R, n)``.
        defect: RMS of what the defects still contribute to the weighted outputs, ``(R,)``.
    """

    x: Tensor
    node_sensitivity: Tensor
    jacobian: Tensor
    residual: Tensor
    cost: Tensor
    hessian: Tensor
    gradient: Tensor
    defect: Tensor

    def take(self, rows: Tensor) -> Evaluation:
        """The evaluation of some rows; itself where they are all of them."""
        if len(rows) == len(self.cost) and bool((rows == torch.arange(len(rows), device=rows.device)).all()):
            return self
        return Evaluation(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def with_rows(self, rows: Tensor, new: Evaluation) -> Evaluation:
        """The evaluation with its rows ``rows`` replaced by those of ``new``."""
        if len(rows) == len(self.cost):
            return new
        pairs = {f.name: (getattr(self, f.name), getattr(new, f.name)) for f in fields(self)}
        return Evaluation(**{n: old.index_copy(0, rows, part) for n, (old, part) in pairs.items()})


def evaluate(
    system: System,
    engine: Engine,
    batch: Batch,
    x: Tensor,
    theta: Tensor,
    free: list[int],
    *,
    loss: Loss,
    chunk: int,
) -> Evaluation:
    """Shoot (with chunks of more than one sample), linearise and condense.

    Args:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: rows of data.
        x: nodes, ``(R, T, n_x)``.
        theta: all parameters of each row in table order, ``(n_p, R)``.
        free: indices of the parameters to differentiate by.
        loss: loss of the weighted residuals.
        chunk: samples that are integrated in a row between nodes.
    """
    if chunk > 1:
        x = shoot(system, engine, x, batch.u, batch.dt, theta, chunk)
    lin = linearise(system, engine, x, batch.u, batch.dt, theta, free, batch.outputs)
    return evaluate_condensed(batch, x, lin, condense(lin, x), loss)


def evaluate_condensed(
    batch: Batch, x: Tensor, outputs: Outputs, node_sensitivity: Tensor, loss: Loss
) -> Evaluation:
    """The objective and its quadratic model from condensed sensitivities.

    Args:
        batch: rows of data.
        x: nodes, ``(R, T, n_x)``.
        outputs: what is simulated there, with its Jacobians.
        node_sensitivity: see :func:`hybrid_id.simulation.lifted.condense`.
        loss: loss of the weighted residuals.
    """
    n_x = x.shape[-1]
    sensitivity = outputs.through(node_sensitivity)
    closing = sensitivity[..., -1]
    residual = (batch.y - outputs.y - closing) * batch.weight
    # a held first state keeps its row of the identity, so that it solves to zero
    loose = (batch.x0_std > 0).to(x.dtype)
    mask = torch.cat([loose, loose.new_ones(len(loose), node_sensitivity.shape[-1] - n_x - 1)], 1)
    jacobian = sensitivity[..., :-1] * (batch.weight[..., None] * mask[:, None, None])
    factor = loss.factor(residual)
    pull = (residual * factor).flatten(1, 2)[..., None]
    flat = jacobian.flatten(1, 2)
    scaled = flat if loss.kind == "l2" else flat * factor.flatten(1, 2)[..., None]
    hessian = scaled.transpose(1, 2) @ flat
    gradient = -(flat.transpose(1, 2) @ pull)[..., 0]
    precision = loose / batch.x0_std.clamp_min(1e-300).square().where(loose > 0, torch.ones_like(loose))
    shift = x[:, 0] - batch.x[:, 0]
    hessian[:, range(n_x), range(n_x)] += precision + (1.0 - loose)
    gradient[:, :n_x] += precision * shift
    cost = loss.value(residual).sum((1, 2)) + 0.5 * (precision * shift.square()).sum(1)
    count = (batch.weight > 0).sum((1, 2)).clamp_min(1)
    defect = ((closing * batch.weight).square().sum((1, 2)) / count).sqrt()
    return Evaluation(x, node_sensitivity, jacobian, residual, cost, hessian, gradient, defect)
