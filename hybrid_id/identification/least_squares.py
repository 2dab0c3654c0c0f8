"""Batched Levenberg-Marquardt on the lifted output-error problem: bounds, priors, initial states, robust loss.

All parameter sets (records, starts, pooled groups) advance together; a set that has converged leaves the batch.
One iteration: integrate short chunks from the nodes, linearise all samples at once, condense, eliminate the initial
states, solve a small box-constrained problem for each set. See :mod:`hybrid_id.simulation.lifted`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from hybrid_id.identification.objective import Loss
from hybrid_id.simulation.lifted import condense, linearise, shoot
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
    chunk: int = 16
    damping: float = 1e-3
    reach: float = 0.5
    loss: Loss = Loss()
    target: Tensor | None = None


@dataclass
class Evaluation:
    """Objective and its quadratic model at one point, rows of the batch and sets of parameters.

    Attributes:
        x: nodes, ``(R, T, n_x)``.
        chain: condensed sensitivities, ``(R, T, n_x, n_x + n_f + 1)``.
        jacobian: weighted sensitivities of the outputs to (first state, parameters), ``(R, T, n_y, n_x + n_f)``.
        residual: weighted residuals of the simulation (defects closed to first order), ``(R, T, n_y)``.
        cost: loss of each row, its initial-state prior included, ``(R,)``.
        hessian: Gauss-Newton matrix of each row in (first state, parameters), ``(R, n, n)``.
        gradient: ``(R, n)``.
        defect: RMS of what the defects still contribute to the weighted outputs, ``(R,)``.
    """

    x: Tensor
    chain: Tensor
    jacobian: Tensor
    residual: Tensor
    cost: Tensor
    hessian: Tensor
    gradient: Tensor
    defect: Tensor


def evaluate(
    system: System, engine: Engine, batch: Batch, x: Tensor, theta: Tensor, free: list[int], options: Options
) -> Evaluation:
    """Shoot, linearise and condense at the nodes ``x`` and parameters ``theta`` ``(n_p, R)``."""
    x = shoot(system, engine, x, batch.u, batch.dt, theta, options.chunk)
    lin = linearise(system, engine, x, batch.u, batch.dt, theta, free, batch.outputs)
    chain = condense(lin, x)
    n_x = x.shape[-1]
    jacobian = lin.c @ chain
    jacobian[..., n_x:-1] += lin.d
    closing = jacobian[..., -1]
    residual = (batch.y - lin.y - closing) * batch.weight
    factor = options.loss.factor(residual)
    jacobian = jacobian[..., :-1] * batch.weight[..., None]
    scaled = (jacobian * factor.sqrt()[..., None]).flatten(1, 2)
    hessian = scaled.transpose(1, 2) @ scaled
    gradient = -(scaled.transpose(1, 2) @ (residual * factor.sqrt()).flatten(1, 2)[..., None])[..., 0]
    # a held first state keeps its row of the identity, so that it solves to zero
    loose = (batch.x0_std > 0).to(x.dtype)
    precision = loose / batch.x0_std.clamp_min(1e-300).square().where(loose > 0, torch.ones_like(loose))
    shift = x[:, 0] - batch.x[:, 0]
    mask = torch.cat([loose, loose.new_ones(len(loose), len(free))], 1)
    jacobian = jacobian * mask[:, None, None, :]
    hessian = hessian * mask[:, :, None] * mask[:, None, :]
    gradient = gradient * mask
    hessian[:, range(n_x), range(n_x)] += precision + (1.0 - loose)
    gradient[:, :n_x] += precision * shift
    cost = options.loss.value(residual).sum((1, 2)) + 0.5 * (precision * shift.square()).sum(1)
    count = (batch.weight > 0).sum((1, 2)).clamp_min(1)
    defect = ((closing * batch.weight).square().sum((1, 2)) / count).sqrt()
    return Evaluation(x, chain, jacobian, residual, cost, hessian, gradient, defect)


def solve_box(hessian: Tensor, gradient: Tensor, low: Tensor, high: Tensor, rounds: int = 6) -> Tensor:
    """Minimise ``g s + s H s / 2`` over ``low <= s <= high`` for a batch, by an active set from the free solution.

    Args:
        hessian: ``(G, n, n)`` positive definite; gradient, low, high: ``(G, n)`` with low <= 0 <= high.
    """
    step = torch.zeros_like(gradient)
    fixed = torch.zeros_like(gradient, dtype=torch.bool)
    identity = torch.eye(gradient.shape[1], dtype=gradient.dtype, device=gradient.device)
    for _ in range(rounds):
        pinned = torch.where(fixed, step, torch.zeros_like(step))
        right = -(gradient + (hessian @ pinned[..., None])[..., 0])
        loose = (~fixed).to(gradient.dtype)
        matrix = hessian * loose[:, :, None] * loose[:, None, :] + identity * (1.0 - loose)[:, :, None]
        free = torch.linalg.solve(matrix, right * loose)
        candidate = torch.where(fixed, step, free)
        clipped = candidate.clamp(low, high)
        slope = gradient + (hessian @ clipped[..., None])[..., 0]
        outside = clipped != candidate
        release = fixed & (((clipped <= low) & (slope < 0)) | ((clipped >= high) & (slope > 0)))
        step = clipped
        if not bool((outside | release).any()):
            break
        fixed = (fixed | outside) & ~release
    return step


@dataclass
class Outcome:
    """What a batched fit ends with, for each set (G) and row (R).

    Attributes:
        theta: all parameters in table order, ``(n_p, G)``.
        cost: loss with priors, ``(G,)``.
        iterations: trial steps taken, ``(G,)``.
        status: "converged", "target", "stalled", "max_iterations" or "diverged", one a set.
        at: the last evaluation of each row (sensitivities, residuals, nodes), in the batch's order.
        history: cost of each set after each iteration.
    """

    theta: Tensor
    cost: Tensor
    iterations: Tensor
    status: list[str]
    at: Evaluation
    history: list[Tensor]


def _join(a: Evaluation, b: Evaluation, rows: Tensor) -> Evaluation:
    """``a`` with its rows ``rows`` replaced by those of ``b``."""
    pairs = {f.name: (getattr(a, f.name), getattr(b, f.name)) for f in fields(Evaluation)}
    return Evaluation(**{n: old.index_copy(0, rows, new) for n, (old, new) in pairs.items()})


def _select(e: Evaluation, rows: Tensor) -> Evaluation:
    return Evaluation(**{f.name: getattr(e, f.name)[rows] for f in fields(Evaluation)})


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


def minimise(
    system: System,
    engine: Engine,
    batch: Batch,
    sets: Tensor,
    theta: Tensor,
    free: list[int],
    bounds: Bounds,
    options: Options | None = None,
    progress: Callable[[int, Tensor, Tensor], None] | None = None,
) -> Outcome:
    """Fit the free parameters of every set to its rows.

    Args:
        system, engine: what is simulated, and how.
        batch: rows of data.
        sets: parameter set of each row, ``(R,)`` with values 0 .. G - 1.
        theta: start values of all parameters, ``(n_p, G)``, inside the bounds.
        free: indices of the parameters to move.
        bounds: box and priors of the free parameters.
        options: settings.
        progress: called after each iteration with (iteration, cost of each set, still running).
    """
    options = options or Options()
    count = theta.shape[1]
    theta, free_index = theta.clone(), torch.tensor(free, device=theta.device)

    def with_prior(cost: Tensor, at: Tensor) -> Tensor:
        offset = at[free_index].T - bounds.prior_mean
        return cost + 0.5 * (bounds.prior_precision * offset.square()).sum(1)

    def set_cost(e: Evaluation, group: Tensor, at: Tensor, size: int) -> Tensor:
        return with_prior(e.cost.new_zeros(size).index_add(0, group, e.cost), at)

    best = evaluate(system, engine, batch, batch.x, theta[:, sets], free, options)
    cost = set_cost(best, sets, theta, count)
    data = (batch.weight > 0).sum((1, 2)).to(cost.dtype)
    data = data.new_zeros(count).index_add(0, sets, data).clamp_min(1.0)
    damping, growth = torch.full_like(cost, options.damping), torch.full_like(cost, 2.0)
    iterations = torch.zeros(count, dtype=torch.long, device=theta.device)
    closing = torch.zeros(count, dtype=torch.bool, device=theta.device)
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
        group, part, here = local[sets[rows]], _select(best, rows), theta[:, running]
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
        nodes = part.x + (part.chain @ move[:, None, :, None])[..., 0]
        new = evaluate(system, engine, batch.take(rows), nodes, trial[:, group], free, options)
        new_cost = set_cost(new, group, trial, running.numel())
        gained = cost[running] - new_cost
        accepted = torch.isfinite(new_cost) & ((gained >= -1e-9 * cost[running]) | closing[running])
        size = (quadratic.clamp_min(0.0) / noise.clamp_min(1e-300)).sqrt()

        def worst(defect: Tensor) -> Tensor:
            return torch.zeros_like(noise).scatter_reduce(0, group, defect, "amax") / noise.sqrt()

        settled, open_before = worst(new.defect) < 0.01, worst(part.defect) > 0.02
        ratio = (gained / predicted.clamp_min(1e-300)).clamp(-10.0, 10.0)
        iterations[running] += 1
        keep = accepted[group].nonzero().flatten()
        best = _join(best, _select(new, keep), rows[keep])
        theta[:, running[accepted]] = trial[:, accepted]
        cost[running[accepted]] = new_cost[accepted]
        ease = (1.0 - (2.0 * ratio - 1.0) ** 3).clamp(0.1, 2.0)
        damping[running] = torch.where(
            closing[running],
            damping[running],
            torch.where(accepted, damping[running] * ease, damping[running] * growth[running]),
        )
        damping.clamp_(1e-12, 1e12)
        growth[running] = torch.where(accepted, torch.full_like(ratio, 2.0), 2.0 * growth[running])
        history.append(cost.clone())
        converged = (
            settled & ~closing[running] & (size < options.tolerance) & (accepted | (damping[running] < 1.0))
        )
        reached = torch.zeros_like(converged)
        if options.target is not None:
            reached = accepted & settled & (cost[running] <= options.target[running])
        stalled = damping[running] >= 1e12
        closing[running] = ~accepted & open_before
        for i, g in enumerate(running.tolist()):
            if bool(reached[i]):
                status[g] = "target"
            elif bool(converged[i]):
                status[g] = "converged"
            elif bool(stalled[i]):
                status[g] = "stalled"
        if progress is not None:
            progress(iteration + 1, cost, running)
        running = running[~(reached | converged | stalled)]
    return Outcome(theta, cost, iterations, status, best, history)
