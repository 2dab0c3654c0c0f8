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

from hybrid_id.errors import InputError
from hybrid_id.identification.lm_step import Bounds, geodesic_acceleration, lm_step
from hybrid_id.identification.objective import Evaluation, Loss, evaluate
from hybrid_id.simulation.c_code import compiler
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

__all__ = ["Bounds", "Options", "Outcome", "minimise"]

SETTLED = 0.01
"""Defects that move the outputs by less than this share of the residuals do not blur the cost."""
SHARP = 0.1
"""Defects below this share of the residuals need no shooting before the next linearisation."""
PERFECT = 1e-8
"""Least variance of the weighted residuals: a record that is met to a ten-thousandth of its noise is met."""
STALLED = 1e12
"""Damping at which no step is left."""


@dataclass(frozen=True)
class Options:
    """Settings of the fit; the defaults suit servo records.

    Attributes:
        max_iterations: trial steps a set may take.
        tolerance: converged when the next step is shorter than this many standard errors.
        chunk: samples that are integrated in a row between nodes.
        damping: initial Levenberg-Marquardt damping, relative to the diagonal.
        closed: whether the end is a free run; a first look at many models may leave small defects between samples.
        loss: loss of the weighted residuals.
    """

    max_iterations: int = 200
    tolerance: float = 0.01
    chunk: int = 8
    damping: float = 1e-3
    closed: bool = True
    loss: Loss = field(default_factory=Loss)


@dataclass
class Outcome:
    """What a batched fit ends with, for each set (G) and row (R).

    Attributes:
        theta: all parameters in table order, ``(n_p, G)``.
        cost: loss with priors, ``(G,)``.
        iterations: trial steps taken, ``(G,)``.
        status: "converged", "stalled", "max_iterations", "interrupted" or "diverged", one a set.
        at: the last evaluation of each row (sensitivities, residuals, nodes), in the batch's order.
        history: cost of each set after each iteration.
    """

    theta: Tensor
    cost: Tensor
    iterations: Tensor
    status: list[str]
    at: Evaluation
    history: list[Tensor]


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
    options, count, device = options or Options(), theta.shape[1], theta.device
    theta, index = theta.clone(), torch.tensor(free, device=device)
    start = theta[index].abs().amax(1)
    bounds = replace(bounds, scale=torch.maximum(0.1 * start, bounds.scale))
    spread = batch.x.square().mean(1).sqrt().clamp_min(1e-9)

    def at(part: Batch, x: Tensor, point: Tensor, chunk: int, by: Engine = engine) -> Evaluation:
        return evaluate(system, by, part, x, point, free, loss=options.loss, chunk=chunk)

    def total(e: Evaluation, point: Tensor, group: Tensor) -> Tensor:
        return bounds.prior_cost(point[index].T).index_add(0, group, e.cost)

    def walk(e: Evaluation, part: Batch, point: Tensor, wanted: Tensor, whole: Tensor) -> Evaluation:
        # Newton's closing can cycle about a change from stick to slip: longer chunks do not, nor does a loop
        limit = (part.weight > 0).sum((1, 2)).clamp_min(1).reciprocal() * 2.0 * e.cost
        limit = 2.0 * SETTLED * limit.clamp_min(PERFECT).sqrt()
        for chunk in (16 * options.chunk, part.dt.shape[1]):
            left = wanted.nonzero().flatten()
            if left.numel() == 0:
                break
            rows = part.take(left), e.x[left], point[:, left], chunk
            try:  # one sample after the other: a thousand times as fast in C
                new = at(*rows, replace(engine, compiled=engine.compiled or compiler() is not None))
            except InputError:  # an operation that has no C expression
                new = at(*rows)
            e = e.with_rows(left, new)
            wanted = wanted & whole & (e.defect > limit)
        return e

    best = at(batch, batch.x if nodes is None else nodes, theta[:, sets], options.chunk)
    cost = total(best, theta, sets)
    data = (
        torch.zeros_like(cost)
        .index_add(0, sets, (batch.weight > 0).sum((1, 2)).to(cost.dtype))
        .clamp_min(1.0)
    )
    bounds = replace(bounds, scale=_scale(best, bounds, (2.0 * cost / data)[sets]))
    status = ["max_iterations" if ok else "diverged" for ok in torch.isfinite(cost).tolist()]
    running = torch.isfinite(cost).nonzero().flatten()
    damping, growth = torch.full_like(cost, options.damping), torch.full_like(cost, 2.0)
    iterations = torch.zeros(count, dtype=torch.long, device=device)
    closing, again = (
        torch.zeros_like(iterations, dtype=torch.bool),
        torch.zeros_like(iterations, dtype=torch.bool),
    )
    bent, bent_x, nearest = theta.clone(), batch.x.clone(), torch.full_like(cost, torch.inf)
    history = [cost.clone()]

    def leave(mask: Tensor, reason: str) -> None:
        for g in running[mask].tolist():
            status[g] = reason

    while running.numel() and int(iterations[running[0]]) < options.max_iterations:
        local = torch.full((count,), -1, device=device)
        local[running] = torch.arange(running.numel(), device=device)
        rows = (local[sets] >= 0).nonzero().flatten()
        group, part = local[sets[rows]], best.take(rows)
        noise = (2.0 * cost[running] / data[running]).clamp_min(PERFECT)
        step = lm_step(part, group, theta[index][:, running].T, damping[running], noise, spread[rows], bounds)
        blur = _worst(part.defect, group, noise)
        honest = (damping[running] < 1.0) & ~closing[running] & ~again[running]
        nearest[running] = torch.where(honest, step.size, nearest[running])
        short = honest & (step.size < options.tolerance)
        done = short & (blur < SETTLED)
        stuck = damping[running] >= STALLED
        if bool((done | stuck).any()):
            # kinks of dry friction can end the descent a fraction of a standard error early
            leave(stuck, "stalled")
            leave(done | (stuck & (nearest[running] < 0.3)), "converged")
            running = running[~(done | stuck)]
            continue
        # after a refusal whose yardstick still had open defects, close those before the next trial
        shut, bending = closing[running], again[running]
        going = (~shut).to(cost.dtype)
        trial = theta[:, running].clone()
        trial[index] = bounds.clip(step.values + going[:, None] * step.shift).T
        trial = torch.where(bending, bent[:, running], trial)
        x = torch.where(bending[group, None, None], bent_x[rows], step.nodes(part, going))
        # near the end the nodes move so little that no event changes its sample: Newton closes the defects alone
        chunk = 1 if bool(((blur < SHARP) & (step.size < 3.0)).all()) else options.chunk
        tried = batch.take(rows)
        new = at(tried, x, trial[:, group], chunk)
        cycling = (new.defect > 2 * SETTLED * noise.sqrt()[group]) & (new.defect > 0.7 * part.defect)
        cycling &= (shut | short)[group]
        new = walk(new, tried, trial[:, group], cycling, short[group])
        shut = shut.index_fill(0, group[cycling], True)
        new_cost = total(new, trial, group)
        gained = cost[running] - new_cost
        accepted = torch.isfinite(new_cost) & ((gained >= -1e-9 * cost[running]) | shut)
        redo = ~accepted & torch.isfinite(new_cost) & ~bending & ~shut
        if bool(redo.any()):
            values, bent_x[rows] = geodesic_acceleration(step, part, new, bounds, options.loss)
            bent[:, running] = trial
            bent[index[:, None], running] = values.T
        again[running] = redo
        closing[running] = ~accepted & ~redo & (blur > 2 * SETTLED)
        iterations[running] += 1
        keep = accepted[group].nonzero().flatten()
        best = best.with_rows(rows[keep], new.take(keep))
        theta[:, running[accepted]] = trial[:, accepted]
        cost[running[accepted]] = new_cost[accepted]
        history.append(cost.clone())
        # curved valleys are long: a prediction that holds earns a much larger step at once
        ratio = gained / step.predicted.clamp_min(1e-300)
        ease = torch.where(ratio > 0.75, 0.1, torch.where(ratio > 0.25, 0.5, 2.0)).to(cost.dtype)
        ease = torch.where(bending, 1.0, ease).where(accepted, growth[running]).where(~(shut | redo), 1.0)
        growth[running] = torch.where(accepted, 2.0, torch.where(redo, 1.0, 2.0) * growth[running])
        damping[running] = (damping[running] * ease).clamp(1e-12, STALLED)
        if progress is not None and progress(int(iterations.max()), cost, running):
            leave(torch.ones_like(running, dtype=torch.bool), "interrupted")
            break
    if not options.closed:
        return Outcome(theta, cost, iterations, status, best, history)
    noise = (2.0 * cost / data).clamp_min(PERFECT)
    open_rows = best.defect > SETTLED * noise.sqrt()[sets]
    best = walk(best, batch, theta[:, sets], open_rows, open_rows)
    return Outcome(theta, total(best, theta, sets), iterations, status, best, history)


def _scale(e: Evaluation, bounds: Bounds, noise: Tensor) -> Tensor:
    """Sizes that steps are measured by, ``(n_f,)``: a standard error where neither start value nor range gives one.

    A fixed size would end the fit: steps as short as it allows may be far below the standard error, as if converged.

    Args:
        e: evaluation at the start.
        bounds: box and scales.
        noise: variance of the weighted residuals of each row, ``(R,)``.
    """
    information = e.hessian.diagonal(dim1=1, dim2=2)[:, -len(bounds.scale) :] / noise[:, None]
    known = torch.isfinite(information).all(1)
    total = information[known].mean(0) if bool(known.any()) else torch.zeros_like(bounds.scale)
    unknown = (bounds.sized == 0) & (total > 0)
    return torch.where(unknown, torch.maximum(total.clamp_min(1e-300).rsqrt(), bounds.scale), bounds.scale)


def _worst(defect: Tensor, group: Tensor, noise: Tensor) -> Tensor:
    """Largest defect among the rows of each set, in units of its residuals."""
    return torch.zeros_like(noise).scatter_reduce(0, group, defect, "amax") / noise.sqrt()
