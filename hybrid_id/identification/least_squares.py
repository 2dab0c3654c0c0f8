"""Batched Levenberg-Marquardt on the lifted output-error problem: bounds, priors, initial states, robust loss.

All parameter sets (records, starts, pooled groups) advance together; a set that has converged leaves the batch.
One iteration: integrate short chunks from the nodes, linearise all samples at once, condense, eliminate the initial
states, solve a small box-constrained problem for each set. See :mod:`hybrid_id.simulation.lifted`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from hybrid_id.identification.box import solve_box
from hybrid_id.identification.objective import Evaluation, Loss, evaluate
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System


@dataclass(frozen=True)
class Bounds:
    """Box and prior of the free parameters, ``(n_f,)`` each; a prior's precision is 0 where there is none."""

    lower: Tensor
    upper: Tensor
    prior_mean: Tensor
    prior_precision: Tensor
    scale: Tensor


@dataclass(frozen=True)
class Options:
    """Settings of the fit; the defaults suit servo records.

    Attributes:
        max_iterations: trial steps a set may take.
        tolerance: converged when the next step is shorter than this many standard errors.
        chunk: samples that are integrated in a row between nodes.
        damping: initial Levenberg-Marquardt damping, relative to the diagonal.
        loss: loss of the weighted residuals.
        target: stop a set when its cost falls below this (``(G,)`` or None): for benchmarks.
    """

    max_iterations: int = 60
    tolerance: float = 0.01
    chunk: int = 8
    damping: float = 1e-3
    reach: float = 0.5
    loss: Loss = field(default_factory=Loss)
    target: Tensor | None = None


@dataclass
class Outcome:
    """What a batched fit ends with, for each set (G) and row (R).

    Attributes:
        theta: all parameters in table order, ``(n_p, G)``.
        cost: loss with priors, ``(G,)``.
        iterations: trial steps taken, ``(G,)``.
        status: "converged", "target", "stalled", "max_iterations", "interrupted" or "diverged", one a set.
        at: the last evaluation of each row (sensitivities, residuals, nodes), in the batch's order.
        history: cost of each set after each iteration.
    """

    theta: Tensor
    cost: Tensor
    iterations: Tensor
    status: list[str]
    at: Evaluation
    history: list[Tensor]


def _reduce(
    e: Evaluation, sets: Tensor, count: int, damping: Tensor, reach: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Eliminate each row's first state and add the rows of each set: hessian, gradient, gain and the way back.

    Args:
        e: evaluation of the rows.
        sets: set of each row.
        count: number of sets.
        damping: Marquardt damping of each row's first state, ``(R,)``.
        reach: proximal precision of each row's first state, ``(R, n_x)``.
    """
    n_x = reach.shape[1]
    h_xx, h_xt, h_tt = e.hessian[:, :n_x, :n_x], e.hessian[:, :n_x, n_x:], e.hessian[:, n_x:, n_x:]
    right = torch.cat([h_xt, e.gradient[:, :n_x, None]], 2)
    diagonal = h_xx.diagonal(dim1=1, dim2=2)
    back = torch.linalg.solve(h_xx + torch.diag_embed(damping[:, None] * diagonal + reach), right)
    schur = h_tt - h_xt.transpose(1, 2) @ back[..., :-1]
    slope = e.gradient[:, n_x:] - (h_xt.transpose(1, 2) @ back[..., -1:])[..., 0]
    gain = 0.5 * (e.gradient[:, :n_x] * back[..., -1]).sum(1)
    n_f = schur.shape[-1]
    hessian = schur.new_zeros(count, n_f, n_f).index_add(0, sets, schur)
    gradient = slope.new_zeros(count, n_f).index_add(0, sets, slope)
    return hessian, gradient, gain.new_zeros(count).index_add(0, sets, gain), back


def _worst(defect: Tensor, group: Tensor, noise: Tensor) -> Tensor:
    """Largest defect among the rows of each set, in units of its residuals."""
    return torch.zeros_like(noise).scatter_reduce(0, group, defect, "amax") / noise.sqrt()


def minimise(
    system: System,
    engine: Engine,
    batch: Batch,
    sets: Tensor,
    theta: Tensor,
    free: list[int],
    bounds: Bounds,
    options: Options | None = None,
    progress: Callable[[int, Tensor, Tensor], bool | None] | None = None,
    nodes: Tensor | None = None,
) -> Outcome:
    """Fit the free parameters of every set to its rows.

    Args:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: rows of data.
        sets: parameter set of each row, ``(R,)`` with values 0 .. G - 1.
        theta: start values of all parameters, ``(n_p, G)``, inside the bounds.
        free: indices of the parameters to move.
        bounds: box and priors of the free parameters.
        options: settings.
        progress: called after each iteration with (iteration, cost of each set, still running); true ends the fit.
        nodes: states to start from, ``(R, T, n_x)`` (default: the batch's guess).
    """
    options = options or Options()
    count = theta.shape[1]
    theta, free_index = theta.clone(), torch.tensor(free, device=theta.device)

    def with_prior(cost: Tensor, point: Tensor) -> Tensor:
        offset = point[free_index].T - bounds.prior_mean
        return cost + 0.5 * (bounds.prior_precision * offset.square()).sum(1)

    def set_cost(e: Evaluation, group: Tensor, point: Tensor, size: int) -> Tensor:
        return with_prior(e.cost.new_zeros(size).index_add(0, group, e.cost), point)

    def at(part: Batch, nodes: Tensor, point: Tensor) -> Evaluation:
        return evaluate(system, engine, part, nodes, point, free, loss=options.loss, chunk=options.chunk)

    best = at(batch, batch.x if nodes is None else nodes, theta[:, sets])
    cost = set_cost(best, sets, theta, count)
    data = (batch.weight > 0).sum((1, 2)).to(cost.dtype)
    data = data.new_zeros(count).index_add(0, sets, data).clamp_min(1.0)
    damping, growth = torch.full_like(cost, options.damping), torch.full_like(cost, 2.0)
    iterations = torch.zeros(count, dtype=torch.long, device=theta.device)
    closing = torch.zeros(count, dtype=torch.bool, device=theta.device)
    retries, pending, pending_x = torch.zeros_like(iterations), theta.clone(), batch.x.clone()
    status = ["max_iterations"] * count
    running = torch.arange(count, device=theta.device)
    history = [cost.clone()]
    spread = batch.x.square().mean(1).sqrt().clamp_min(1e-9)
    magnitude = torch.maximum(0.1 * theta[free_index].abs().amax(1), bounds.scale)
    if not bool(torch.isfinite(cost).all()):
        for g in (~torch.isfinite(cost)).nonzero().flatten().tolist():
            status[g] = "diverged"
        running = torch.isfinite(cost).nonzero().flatten()

    for iteration in range(options.max_iterations):
        if running.numel() == 0:
            break
        local = torch.full((count,), -1, device=theta.device)
        local[running] = torch.arange(running.numel(), device=theta.device)
        rows = (local[sets] >= 0).nonzero().flatten()
        group, part, here = local[sets[rows]], best.take(rows), theta[:, running]
        noise = 2.0 * cost[running] / data[running]
        near = noise[group, None] * (options.reach * spread[rows]).square().reciprocal()
        hessian, gradient, gain, back = _reduce(part, group, running.numel(), damping[running][group], near)
        offset = here[free_index].T - bounds.prior_mean
        hessian = hessian + torch.diag_embed(bounds.prior_precision.expand(running.numel(), -1))
        gradient = gradient + bounds.prior_precision * offset
        # Marquardt's scaling: every parameter in units of its own standard error
        unit = hessian.diagonal(dim1=1, dim2=2).clamp_min(1e-300).rsqrt()
        unit = unit.where(hessian.diagonal(dim1=1, dim2=2) > 0, torch.zeros_like(unit))
        scaled = hessian * unit[:, :, None] * unit[:, None, :]
        values = here[free_index].T
        scale = torch.maximum(values.abs(), magnitude)
        # a proximal term keeps directions that the records do not tell where they are
        proximal = noise[:, None] * (unit / (options.reach * scale)).square()
        damped = scaled + torch.diag_embed(damping[running, None] + proximal + (unit == 0).to(unit.dtype))
        low = torch.maximum(bounds.lower - values, -0.6 * scale)
        high = torch.minimum(bounds.upper - values, 1.5 * scale)
        box = [limit / unit.clamp_min(1e-300) for limit in (low, high)]
        slope = gradient * unit
        step = solve_box(damped, slope, box[0].clamp_max(0.0), box[1].clamp_min(0.0))
        quadratic = (step * (scaled @ step[..., None])[..., 0]).sum(1)
        predicted = -(slope * step).sum(1) - 0.5 * quadratic + gain
        # after a refusal whose yardstick still had open defects, close those before the next trial
        going = (~closing[running]).to(step.dtype)
        shift = step * unit * going[:, None]
        first = going[group, None] * -back[..., -1] - (back[..., :-1] @ shift[group][..., None])[..., 0]
        move = torch.cat([first, shift[group], first.new_ones(len(rows), 1)], 1)
        trial = here.clone()
        trial[free_index] = torch.maximum(torch.minimum(values + shift, bounds.upper), bounds.lower).T
        moved = part.x + (part.chain @ move[:, None, :, None])[..., 0]
        again = retries[running] > 0
        trial[:, again] = pending[:, running[again]]
        moved = torch.where(again[group, None, None], pending_x[rows], moved)
        new = at(batch.take(rows), moved, trial[:, group])
        new_cost = set_cost(new, group, trial, running.numel())
        gained = cost[running] - new_cost
        accepted = torch.isfinite(new_cost) & ((gained >= -1e-9 * cost[running]) | closing[running])
        size = (quadratic.clamp_min(0.0) / noise.clamp_min(1e-300)).sqrt()

        settled = _worst(new.defect, group, noise) < 0.01
        open_before = _worst(part.defect, group, noise) > 0.02
        redo = ~accepted & torch.isfinite(new_cost) & ~again & ~closing[running]
        if bool(redo.any()):
            # geodesic correction (Transtrum, Sethna 2012) from the refused trial: it tells the residuals' curvature
            bend = part.residual - (part.jacobian @ move[:, None, :-1, None])[..., 0] - new.residual
            pull = replace(part, gradient=(part.jacobian * bend[..., None]).sum((1, 2)))
            _, slope, _, back = _reduce(pull, group, running.numel(), damping[running][group], near)
            second = torch.linalg.solve(damped, -(slope * unit)[..., None])[..., 0]
            length = (0.375 * step.norm(dim=1) / second.norm(dim=1).clamp_min(1e-300)).clamp_max(1.0)[:, None]
            turned = second * unit
            path = length * shift + length.square() * turned
            point = torch.maximum(torch.minimum(values + path, bounds.upper), bounds.lower)
            drift = -back[..., -1] - (back[..., :-1] @ turned[group][..., None])[..., 0]
            reach = length[group]
            curve = torch.cat([reach * first + reach.square() * drift, path[group], move[:, -1:]], 1)
            pending[:, running] = trial
            pending[free_index[:, None], running] = point.T
            pending_x[rows] = part.x + (part.chain @ curve[:, None, :, None])[..., 0]
        retries[running] = redo.to(retries.dtype)
        ratio = (gained / predicted.clamp_min(1e-300)).clamp(-10.0, 10.0)
        iterations[running] += 1
        keep = accepted[group].nonzero().flatten()
        best = best.with_rows(rows[keep], new.take(keep))
        theta[:, running[accepted]] = trial[:, accepted]
        cost[running[accepted]] = new_cost[accepted]
        # curved valleys are long: a prediction that holds earns a much larger step at once
        ease = torch.where(ratio > 0.75, 0.1, torch.where(ratio > 0.25, 0.5, 2.0)).to(ratio.dtype)
        ease = torch.where(again, torch.ones_like(ease), ease)
        damping[running] = torch.where(
            closing[running] | redo,
            damping[running],
            torch.where(accepted, damping[running] * ease, damping[running] * growth[running]),
        )
        damping.clamp_(1e-12, 1e12)
        growth[running] = torch.where(
            accepted, torch.full_like(ratio, 2.0), torch.where(redo, 1.0, 2.0) * growth[running]
        )
        history.append(cost.clone())
        converged = (
            settled & ~closing[running] & (size < options.tolerance) & (accepted | (damping[running] < 1.0))
        )
        reached = torch.zeros_like(converged)
        if options.target is not None:
            reached = accepted & settled & (cost[running] <= options.target[running])
        stalled = damping[running] >= 1e12
        closing[running] = ~accepted & open_before & ~redo
        for i, g in enumerate(running.tolist()):
            if bool(reached[i]):
                status[g] = "target"
            elif bool(converged[i]):
                status[g] = "converged"
            elif bool(stalled[i]):
                status[g] = "stalled"
        stop = progress is not None and bool(progress(iteration + 1, cost, running))
        running = running[~(reached | converged | stalled)]
        if stop:
            for g in running.tolist():
                status[g] = "interrupted"
            break
    return Outcome(theta, cost, iterations, status, best, history)
