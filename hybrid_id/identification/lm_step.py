"""One damped Gauss-Newton step of every parameter set inside its box, and its bend along a curved valley."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from hybrid_id.identification.box import solve_box
from hybrid_id.identification.objective import Evaluation, Loss

REACH = 0.5
"""A step of this share of a parameter costs one residual variance: where records tell nothing, nothing moves."""


@dataclass(frozen=True)
class Bounds:
    """Box and prior of the free parameters, ``(n_f,)`` each.

    Attributes:
        lower: lower bounds.
        upper: upper bounds.
        prior_mean: centre of the prior.
        prior_precision: its precision, 0 where there is none.
        scale: smallest size that a parameter's steps are measured by.
        sized: 1 where its start value or its range gives that size; where it is 0, only the records do.
    """

    lower: Tensor
    upper: Tensor
    prior_mean: Tensor
    prior_precision: Tensor
    scale: Tensor
    sized: Tensor

    def to(self, dtype: torch.dtype) -> Bounds:
        """The same in another precision."""
        return Bounds(*(value.to(dtype) for value in vars(self).values()))

    def clip(self, values: Tensor) -> Tensor:
        """Values ``(G, n_f)`` inside the box."""
        return torch.maximum(torch.minimum(values, self.upper), self.lower)

    def prior_cost(self, values: Tensor) -> Tensor:
        """Loss of the priors at values ``(G, n_f)``, ``(G,)``."""
        return 0.5 * (self.prior_precision * (values - self.prior_mean).square()).sum(1)


@dataclass(frozen=True)
class DampedStep:
    """Step of G sets and of the nodes of their R rows.

    Attributes:
        values: parameters before the step, ``(G, n_f)``.
        shift: change of the parameters, ``(G, n_f)``.
        first: change of the first states, ``(R, n_x)``.
        size: length in standard errors, ``(G,)``.
        predicted: fall of the cost that the quadratic model promises, ``(G,)``.
        matrix: damped Hessian in units of ``unit``, ``(G, n_f, n_f)``.
        unit: standard error of each parameter alone, ``(G, n_f)``.
        damping: Marquardt damping of each row, ``(R,)``.
        near: proximal precision of the first states, ``(R, n_x)``.
        group: set of each row, ``(R,)``.
    """

    values: Tensor
    shift: Tensor
    first: Tensor
    size: Tensor
    predicted: Tensor
    matrix: Tensor
    unit: Tensor
    damping: Tensor
    near: Tensor
    group: Tensor

    def nodes(self, part: Evaluation, going: Tensor) -> Tensor:
        """Nodes after the step (of sets where ``going`` is 1.0) with their defects closed, ``(R, T, n_x)``."""
        rows = going[self.group, None]
        return _moved(part, rows * self.first, rows * self.shift[self.group])


def lm_step(
    part: Evaluation,
    group: Tensor,
    values: Tensor,
    damping: Tensor,
    noise: Tensor,
    spread: Tensor,
    bounds: Bounds,
) -> DampedStep:
    """The step that minimises the damped quadratic model inside the box and a trust region of relative changes.

    Args:
        part: evaluation of the rows.
        group: set of each row, ``(R,)``.
        values: free parameters, ``(G, n_f)``.
        damping: Marquardt damping, ``(G,)``.
        noise: variance of the weighted residuals, ``(G,)``.
        spread: RMS of each row's states, ``(R, n_x)``.
        bounds: box and priors.
    """
    near = noise[group, None] * (REACH * spread).square().reciprocal()
    hessian, gradient, gain, back = _reduce(part, group, len(values), damping[group], near)
    hessian = hessian + torch.diag_embed(bounds.prior_precision.expand_as(values))
    gradient = gradient + bounds.prior_precision * (values - bounds.prior_mean)
    # Marquardt's scaling: every parameter in units of its own standard error
    diagonal = hessian.diagonal(dim1=1, dim2=2)
    unit = diagonal.clamp_min(1e-300).rsqrt().where(diagonal > 0, torch.zeros_like(diagonal))
    scaled = hessian * unit[:, :, None] * unit[:, None, :]
    scale = torch.maximum(values.abs(), bounds.scale)
    # a proximal term keeps directions that the records do not tell where they are
    proximal = noise[:, None] * (unit / (REACH * scale)).square()
    matrix = scaled + torch.diag_embed(damping[:, None] + proximal + (unit == 0).to(unit.dtype))
    low = torch.maximum(bounds.lower - values, -0.6 * scale).clamp_max(0.0)
    high = torch.minimum(bounds.upper - values, 1.5 * scale).clamp_min(0.0)
    slope = gradient * unit
    step = solve_box(matrix, slope, low / unit.clamp_min(1e-300), high / unit.clamp_min(1e-300))
    quadratic = (step * (scaled @ step[..., None])[..., 0]).sum(1).clamp_min(0.0)
    shift = step * unit
    first = -back[..., -1] - (back[..., :-1] @ shift[group][..., None])[..., 0]
    return DampedStep(
        values, shift, first, (quadratic / noise.clamp_min(1e-300)).sqrt(),
        -(slope * step).sum(1) - 0.5 * quadratic + gain, matrix, unit, damping[group], near, group,
    )  # fmt: skip


def geodesic_acceleration(
    step: DampedStep, part: Evaluation, refused: Evaluation, bounds: Bounds, loss: Loss
) -> tuple[Tensor, Tensor]:
    """A refused step bent by the curvature that its own trial shows: new parameters ``(G, n_f)`` and nodes.

    The trial's residuals less their linear prediction are half the second derivative along the step; correcting them
    to first order gives the path ``t shift + t^2 second``. Source: M. K. Transtrum, J. P. Sethna, "Improvements to the
    Levenberg-Marquardt algorithm for nonlinear least-squares minimization", arXiv 1201.5885 (2012), their geodesic
    acceleration with the trial in place of a finite difference.
    """
    along = torch.cat([step.first, step.shift[step.group]], 1)
    curvature = part.residual - (part.jacobian.flatten(1, 2) @ along[..., None]).view_as(part.residual)
    curvature = curvature - refused.residual
    curvature = curvature * loss.factor(part.residual)
    pull = replace(part, gradient=(part.jacobian * curvature[..., None]).sum((1, 2)))
    _, slope, _, back = _reduce(pull, step.group, len(step.values), step.damping, step.near)
    second = torch.linalg.solve(step.matrix, -(slope * step.unit)[..., None])[..., 0]
    sizes = [(s / step.unit.clamp_min(1e-300)).norm(dim=1) for s in (step.shift, second * step.unit)]
    t = (0.375 * sizes[0] / sizes[1].clamp_min(1e-300)).clamp_max(1.0)[:, None]
    turned = second * step.unit
    path = t * step.shift + t.square() * turned
    drift = -back[..., -1] - (back[..., :-1] @ turned[step.group][..., None])[..., 0]
    first = t[step.group] * step.first + t[step.group].square() * drift
    return bounds.clip(step.values + path), _moved(part, first, path[step.group])


def _moved(part: Evaluation, first: Tensor, shift: Tensor) -> Tensor:
    move = torch.cat([first, shift, first.new_ones(len(first), 1)], 1)
    return part.x + (part.chain.flatten(1, 2) @ move[..., None]).view_as(part.x)


def _reduce(
    e: Evaluation, sets: Tensor, count: int, damping: Tensor, near: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Eliminate each row's first state and add the rows of each set: hessian, gradient, gain and the way back."""
    n_x = near.shape[1]
    h_xx, h_xt, h_tt = e.hessian[:, :n_x, :n_x], e.hessian[:, :n_x, n_x:], e.hessian[:, n_x:, n_x:]
    right = torch.cat([h_xt, e.gradient[:, :n_x, None]], 2)
    diagonal = h_xx.diagonal(dim1=1, dim2=2)
    back = torch.linalg.solve(h_xx + torch.diag_embed(damping[:, None] * diagonal + near), right)
    schur = h_tt - h_xt.transpose(1, 2) @ back[..., :-1]
    slope = e.gradient[:, n_x:] - (h_xt.transpose(1, 2) @ back[..., -1:])[..., 0]
    gain = 0.5 * (e.gradient[:, :n_x] * back[..., -1]).sum(1)
    n_f = schur.shape[-1]
    hessian = schur.new_zeros(count, n_f, n_f).index_add(0, sets, schur)
    gradient = slope.new_zeros(count, n_f).index_add(0, sets, slope)
    return hessian, gradient, gain.new_zeros(count).index_add(0, sets, gain), back
