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
from hybrid_id.identification.objective import Evaluation, Loss, evaluate
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiler_works
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

PROXIMAL_SHARE = 0.5
"""A step of this share of a parameter costs one residual variance: where records tell nothing, nothing moves."""
SETTLED = 0.01
"""Defects that move the outputs by less than this share of the residuals do not blur the cost."""
SHARP = 0.1
"""Defects below this share of the residuals need no shooting before the next linearisation."""
PERFECT = 1e-8
"""Least variance of the weighted residuals: a record that is met to a ten-thousandth of its noise is met."""
PATIENCE = 4
"""Trial steps that together have to gain something, where a fit is to end early."""
LOST = 1e3
"""Cost over the least so far at which such a fit ends, too: closing its defects has shown that it has lost its way."""
NOTHING = 0.05
"""Fall of the cost, in variances of what is left, that such a fit takes for none: a third of a standard error."""
STALLED = 1e12
"""Damping at which no step is left."""


def solve_box(hessian: Tensor, gradient: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Minimise ``g s + s H s / 2`` over ``low <= s <= high`` for a batch, by a primal active set from s = 0.

    Each round goes towards the minimum over the loose coordinates, stops at the first bound in the way and holds that
    coordinate; where nothing is in the way, the held coordinate that wants to leave its bound most is let loose
    (Nocedal, Wright, Numerical Optimization, algorithm 16.3). The value falls in every round, and the free
    solution, where it lies inside, takes one.

    Args:
        hessian: H, ``(G, n, n)``, positive definite.
        gradient: g, ``(G, n)``.
        low: lower limits, ``(G, n)``, not above 0.
        high: upper limits, ``(G, n)``, not below 0.
    """
    step = torch.zeros_like(gradient)
    held = ((low >= 0) & (gradient > 0)) | ((high <= 0) & (gradient < 0))
    identity = torch.eye(gradient.shape[1], dtype=gradient.dtype, device=gradient.device)
    noise = 1e-12 * gradient.abs().amax(1, keepdim=True)
    for _ in range(6 * gradient.shape[1]):
        loose = (~held).to(gradient.dtype)
        slope = gradient + (hessian @ step[..., None])[..., 0]
        matrix = hessian * loose[:, :, None] * loose[:, None, :] + torch.diag_embed(held.to(gradient.dtype))
        move = torch.linalg.solve(matrix, -slope * loose)
        room = torch.where(move > 0, high - step, low - step) / torch.where(move == 0, torch.inf, move)
        room = torch.where(move == 0, torch.inf, room)
        fraction, first = room.min(1, keepdim=True)
        blocked = fraction < 1.0
        hit = blocked & (identity[first[:, 0]] > 0)
        step = (step + fraction.clamp(0.0, 1.0) * move).clamp(low, high)
        step = torch.where(hit, torch.where(move > 0, high, low), step)  # exactly, for the comparison below
        held = held | hit
        slope = gradient + (hessian @ step[..., None])[..., 0]
        pull = torch.where(step <= low, -slope, torch.where(step >= high, slope, torch.zeros_like(slope)))
        pull = torch.where(held & (low < high), pull - noise, torch.zeros_like(pull))
        strongest, which = pull.max(1, keepdim=True)
        leaves = ~blocked & (strongest > 0)
        if not bool((blocked | leaves).any()):
            break
        held = held & ~(leaves & (identity[which[:, 0]] > 0))
    return step


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

    def clip(self, values: Tensor) -> Tensor:
        """Values ``(G, n_f)`` inside the box."""
        return torch.maximum(torch.minimum(values, self.upper), self.lower)

    def prior_cost(self, values: Tensor) -> Tensor:
        """Loss of the priors at values ``(G, n_f)``, ``(G,)``."""
        return 0.5 * (self.prior_precision * (values - self.prior_mean).square()).sum(1)


@dataclass(frozen=True)
class LMStep:
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


def bounded_lm_step(
    hessian: Tensor, gradient: Tensor, unit: Tensor, damping: Tensor, low: Tensor, high: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The LM step of every set inside its box, by Marquardt's scaling: each parameter in units of its standard error.

    Whoever differentiates (exact sensitivities, finite differences, the adjoint method) takes this step.

    Args:
        hessian: Gauss-Newton matrix or another metric, ``(G, n, n)``.
        gradient: of the cost, ``(G, n)``.
        unit: inverse root of the diagonal, ``(G, n)``; 0 for what nothing depends on.
        damping: added to the scaled diagonal, ``(G, n)``.
        low: least step, ``(G, n)``; opened to hold zero.
        high: largest step alike.

    Returns:
        Step in units of ``unit``, scaled matrix, and damped scaled matrix.
    """
    scaled = hessian * unit[:, :, None] * unit[:, None, :]
    matrix, size = scaled + torch.diag_embed(damping), unit.clamp_min(1e-300)
    step = solve_box(matrix, gradient * unit, low.clamp_max(0.0) / size, high.clamp_min(0.0) / size)
    return step, scaled, matrix


def lm_step(
    part: Evaluation,
    group: Tensor,
    values: Tensor,
    damping: Tensor,
    residual_variance: Tensor,
    state_rms: Tensor,
    bounds: Bounds,
) -> LMStep:
    """The step that minimises the damped quadratic model inside the box and a trust region of relative changes.

    Args:
        part: evaluation of the rows.
        group: set of each row, ``(R,)``.
        values: free parameters, ``(G, n_f)``.
        damping: Marquardt damping, ``(G,)``.
        residual_variance: of the weighted residuals of each set, ``(G,)``.
        state_rms: of each row's states, ``(R, n_x)``.
        bounds: box and priors.
    """
    near = residual_variance[group, None] * (PROXIMAL_SHARE * state_rms).square().reciprocal()
    hessian, gradient, gain, back = reduced(part, group, len(values), damping[group], near)
    hessian = hessian + torch.diag_embed(bounds.prior_precision.expand_as(values))
    gradient = gradient + bounds.prior_precision * (values - bounds.prior_mean)
    diagonal = hessian.diagonal(dim1=1, dim2=2)
    unit = diagonal.clamp_min(1e-300).rsqrt().where(diagonal > 0, torch.zeros_like(diagonal))
    scale = torch.maximum(values.abs(), bounds.scale)
    # a proximal term keeps directions that the records do not tell where they are
    proximal = residual_variance[:, None] * (unit / (PROXIMAL_SHARE * scale)).square()
    low = torch.maximum(bounds.lower - values, -0.6 * scale)
    high = torch.minimum(bounds.upper - values, 1.5 * scale)
    added = damping[:, None] + proximal + (unit == 0).to(unit.dtype)
    step, scaled, matrix = bounded_lm_step(hessian, gradient, unit, added, low, high)
    quadratic = (step * (scaled @ step[..., None])[..., 0]).sum(1).clamp_min(0.0)
    shift = step * unit
    first = -back[..., -1] - (back[..., :-1] @ shift[group][..., None])[..., 0]
    return LMStep(
        values, shift, first, (quadratic / residual_variance.clamp_min(1e-300)).sqrt(),
        -(gradient * unit * step).sum(1) - 0.5 * quadratic + gain, matrix, unit, damping[group], near, group,
    )  # fmt: skip


def geodesic_acceleration(
    step: LMStep, part: Evaluation, refused: Evaluation, bounds: Bounds, loss: Loss
) -> tuple[Tensor, Tensor]:
    """A refused step, corrected by the curvature that its own trial shows: new parameters ``(G, n_f)`` and nodes.

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
    _, slope, _, back = reduced(pull, step.group, len(step.values), step.damping, step.near)
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
    return part.x + (part.node_sensitivity.flatten(1, 2) @ move[..., None]).view_as(part.x)


def reduced(
    e: Evaluation, sets: Tensor, count: int, damping: Tensor, near: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Eliminate each row's first state and add the rows of each set.

    Args:
        e: evaluation of R rows.
        sets: set of each row, ``(R,)``.
        count: number of sets, G.
        damping: Marquardt damping of each row, ``(R,)``.
        near: proximal precision of the first states, ``(R, n_x)``.

    Returns:
        Hessian ``(G, n_f, n_f)``, gradient ``(G, n_f)``, fall of the cost by the first states alone ``(G,)``, and the
        way back ``(R, n_x, n_f + 1)``: minus the first states' change per unit of each parameter, and (last) without.
    """
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


@dataclass(frozen=True)
class Options:
    """Settings of the fit; the defaults suit servo records.

    Attributes:
        max_iterations: trial steps a set may take.
        tolerance: converged when the next step is shorter than this many standard errors.
        chunk: samples that are integrated in a row between nodes.
        damping: initial Levenberg-Marquardt damping, relative to the diagonal.
        least_gain: share of the cost beyond the noise's, half a unit a sample, that :data:`PATIENCE` trial steps
            together have to gain, and :data:`NOTHING` at least; a set that gains less has stalled. With 0 it goes on
            as long as it can.
        closed: whether the end is a free run; a first look at many models may leave small defects between samples.
        loss: loss of the weighted residuals.
    """

    max_iterations: int = 200
    tolerance: float = 0.01
    chunk: int = 8
    damping: float = 1e-3
    least_gain: float = 0.0
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


def free_parameters(system: System) -> list[int]:
    """Indices of the parameters to estimate.

    Raises:
        InputError: there is none.
    """
    if not system.estimated:
        raise InputError("The model has no parameter to estimate; set 'estimate: true' for at least one.")
    return system.estimated


@dataclass(frozen=True)
class LeastSquares:
    """Weighted output error of parameter sets on their rows of data: what every fit minimises.

    Attributes:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: rows of data.
        sets: parameter set of each row, ``(R,)`` with values 0 .. G - 1.
        free: indices of the parameters to move.
        bounds: box and priors of the free parameters.
    """

    system: System
    engine: Engine
    batch: Batch
    sets: Tensor
    free: list[int]
    bounds: Bounds

    def at(
        self, part: Batch, x: Tensor, theta: Tensor, loss: Loss, chunk: int, engine: Engine | None = None
    ) -> Evaluation:
        """The objective of some rows at their nodes ``(R, T, n_x)`` and parameters ``(n_p, R)``; see `evaluate`."""
        return evaluate(self.system, engine or self.engine, part, x, theta, self.free, loss=loss, chunk=chunk)

    def cost(self, e: Evaluation, theta: Tensor, group: Tensor) -> Tensor:
        """Loss of each set with its priors, ``(G,)``, at parameters ``(n_p, G)``; ``group`` is the set of each row."""
        return self.bounds.prior_cost(theta[self.free].T).index_add(0, group, e.cost)

    def close(
        self, e: Evaluation, part: Batch, theta: Tensor, wanted: Tensor, whole: Tensor, options: Options
    ) -> Evaluation:
        """The evaluation with the defects of wanted rows closed in longer chunks, over ``whole`` rows if need be.

        Newton's closing can cycle about a change from stick to slip: longer chunks do not, nor does a loop.
        """
        limit = (part.weight > 0).sum((1, 2)).clamp_min(1).reciprocal() * 2.0 * e.cost
        limit = 2.0 * SETTLED * limit.clamp_min(PERFECT).sqrt()
        for chunk in (16 * options.chunk, part.dt.shape[1]):
            left = wanted.nonzero().flatten()
            if left.numel() == 0:
                break
            rows = part.take(left), e.x[left], theta[:, left], options.loss, chunk
            try:  # one sample after the other: a thousand times as fast in C
                new = self.at(*rows, replace(self.engine, compiled=self.engine.compiled or compiler_works()))
            except InputError:  # a solver or an operation that has no C expression
                new = self.at(*rows)
            e = e.with_rows(left, new)
            wanted = wanted & whole & (e.defect > limit)
        return e


def minimise(
    problem: LeastSquares,
    theta: Tensor,
    options: Options | None = None,
    progress: Callable[[int, Tensor, Tensor], bool | None] | None = None,
    nodes: Tensor | None = None,
) -> Outcome:
    """Fit the free parameters of every set to its rows; sets that have ended leave the batch.

    Args:
        problem: the objective.
        theta: start values of all parameters, ``(n_p, G)``, inside the bounds.
        options: settings.
        progress: called after each iteration with (iteration, cost of each set, still running); true ends the fit.
        nodes: states to start from, ``(R, T, n_x)`` (default: the batch's guess).
    """
    options, batch, sets = options or Options(), problem.batch, problem.sets
    theta, index = theta.clone(), torch.tensor(problem.free, device=theta.device)
    state_rms = batch.x.square().mean(1).sqrt().clamp_min(1e-9)
    best = problem.at(batch, batch.x if nodes is None else nodes, theta[:, sets], options.loss, options.chunk)
    cost = problem.cost(best, theta, sets)
    samples = (batch.weight > 0).sum((1, 2)).to(cost.dtype)
    data = torch.zeros_like(cost).index_add(0, sets, samples).clamp_min(1.0)
    start = theta[index].abs().amax(1)
    bounds = replace(problem.bounds, scale=torch.maximum(0.1 * start, problem.bounds.scale))
    # where neither start value nor range gives a size that steps are measured by, a standard error is it: a fixed one
    # would end the fit, as steps as short as it allows may be far below the standard error, as if converged
    variances = (2.0 * cost / data)[sets, None]
    information = best.hessian.diagonal(dim1=1, dim2=2)[:, -len(bounds.scale) :] / variances
    told = torch.isfinite(information).all(1)
    total = information[told].mean(0) if bool(told.any()) else torch.zeros_like(bounds.scale)
    larger = torch.maximum(total.clamp_min(1e-300).rsqrt(), bounds.scale)
    bounds = replace(bounds, scale=torch.where((bounds.sized == 0) & (total > 0), larger, bounds.scale))
    known = torch.isfinite(cost)
    status = ["max_iterations" if ok else "diverged" for ok in known.tolist()]
    running = known.nonzero().flatten()  # numbers of the sets that still run: an index, no mask
    damping, growth = (torch.full_like(cost, value) for value in (options.damping, 2.0))
    iterations = torch.zeros(theta.shape[1], dtype=torch.long, device=theta.device)
    # what each set does next in place of a step: close the defects of its point, or try a refused step corrected
    closing, again = (torch.zeros_like(known) for _ in range(2))
    curved, curved_nodes = theta.clone(), batch.x.clone()
    # length in standard errors of the last uncorrected step with damping below 1
    nearest = torch.full_like(cost, torch.inf)
    history = [cost.clone()]

    def leave(mask: Tensor, reason: str) -> None:
        for g in running[mask].tolist():
            status[g] = reason

    while running.numel() and int(iterations[running[0]]) < options.max_iterations:
        local = torch.full_like(iterations, -1)
        local[running] = torch.arange(running.numel(), device=local.device)
        rows = (local[sets] >= 0).nonzero().flatten()
        group, part = local[sets[rows]], best.take(rows)
        variance = (2.0 * cost / data).clamp_min(PERFECT)[running]
        values = theta[index][:, running].T
        step = lm_step(part, group, values, damping[running], variance, state_rms[rows], bounds)
        # after a refusal whose yardstick still had open defects, those are closed before the next trial
        shut, accelerated = closing[running], again[running]
        honest = (damping[running] < 1.0) & ~shut & ~accelerated
        nearest[running] = torch.where(honest, step.size, nearest[running])
        short = honest & (step.size < options.tolerance)
        blur = torch.zeros_like(variance).scatter_reduce(0, group, part.defect, "amax") / variance.sqrt()

        done, stuck = short & (blur < SETTLED), damping[running] >= STALLED
        idle = comes_to_nothing(torch.stack(history)[:, running], data[running], options.least_gain)
        if bool((done | stuck | idle).any()):
            leave(stuck | idle, "stalled")
            # kinks of dry friction can end the descent a fraction of a standard error early
            leave(done | (stuck & (nearest[running] < 0.3)), "converged")
            running = running[~(done | stuck | idle)]
            continue

        going = (~shut).to(cost.dtype)
        trial = theta[:, running].clone()
        trial[index] = bounds.clip(step.values + going[:, None] * step.shift).T
        trial = torch.where(accelerated, curved[:, running], trial)
        x = torch.where(accelerated[group, None, None], curved_nodes[rows], step.nodes(part, going))
        # near the end the nodes move so little that no event changes its sample: Newton closes the defects alone
        near = bool(((blur < SHARP) & (step.size < 3.0)).all())
        tried = batch.take(rows)
        new = problem.at(tried, x, trial[:, group], options.loss, 1 if near else options.chunk)
        cycling = (new.defect > 2 * SETTLED * variance.sqrt()[group]) & (new.defect > 0.7 * part.defect)
        cycling &= (shut | short)[group]
        new = problem.close(new, tried, trial[:, group], cycling, short[group], options)
        shut = shut.index_fill(0, group[cycling], True)

        new_cost = problem.cost(new, trial, group)
        gained, finite = cost[running] - new_cost, torch.isfinite(new_cost)
        accepted = finite & ((gained >= -1e-9 * cost[running]) | shut)
        redo = ~accepted & finite & ~accelerated & ~shut
        if bool(redo.any()):
            corrected, curved_nodes[rows] = geodesic_acceleration(step, part, new, bounds, options.loss)
            curved[:, running] = trial
            curved[index[:, None], running] = corrected.T
        again[running] = redo
        closing[running] = ~accepted & ~redo & (blur > 2 * SETTLED)
        iterations[running] += 1
        keep = accepted[group].nonzero().flatten()
        best = best.with_rows(rows[keep], new.take(keep))
        theta[:, running[accepted]] = trial[:, accepted]
        # curved valleys are long: a prediction that holds earns a much larger step at once
        ratio, refusal = gained / step.predicted.clamp_min(1e-300), growth[running]
        cost[running[accepted]] = new_cost[accepted]
        history.append(cost.clone())
        ease = torch.where(ratio > 0.75, 0.1, torch.where(ratio > 0.25, 0.5, 2.0)).to(cost.dtype)
        ease = torch.where(accelerated, 1.0, ease).where(accepted, refusal).where(~(shut | redo), 1.0)
        growth[running] = torch.where(accepted, 2.0, torch.where(redo, 1.0, 2.0) * refusal)
        damping[running] = (damping[running] * ease).clamp(1e-12, STALLED)
        if progress is not None and progress(int(iterations.max()), cost, running):
            leave(torch.ones_like(running, dtype=torch.bool), "interrupted")
            break
    if options.closed:  # the end is a free run
        open_rows = best.defect > SETTLED * (2.0 * cost / data).clamp_min(PERFECT).sqrt()[sets]
        best = problem.close(best, batch, theta[:, sets], open_rows, open_rows, options)
        cost = problem.cost(best, theta, sets)
    return Outcome(theta, cost, iterations, status, best, history)


def comes_to_nothing(costs: Tensor, data: Tensor, least_gain: float) -> Tensor:
    """Which sets have gained too little by their last steps, or have lost their way, ``(G,)``.

    Args:
        costs: of each set after each iteration, ``(k, G)``.
        data: number of measurements of each set, ``(G,)``.
        least_gain: see :class:`Options`.
    """
    cost = costs[-1]
    if least_gain == 0.0 or len(costs) <= PATIENCE:
        return torch.zeros_like(cost, dtype=torch.bool)
    beyond, gain = (cost - 0.5 * data).clamp_min(0.0), costs[-1 - PATIENCE] - cost
    # a cost that has risen was too low by open defects: the fit is not where it was
    nothing = NOTHING * (2.0 * cost / data).clamp_min(PERFECT)
    little = (gain >= 0.0) & (gain < torch.maximum(least_gain * beyond, nothing))
    return little | (cost > LOST * costs.amin(0))
