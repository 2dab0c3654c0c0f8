"""From prepared records and a system to parameter sets: warm start, multi-start, Levenberg-Marquardt, results."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from hybrid_id.components.base import Component
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import (
    Bounds,
    LeastSquares,
    Options,
    free_parameters,
    minimise,
)
from hybrid_id.identification.result import FitResult, make_result
from hybrid_id.identification.windows import hidden_links, measured_windows
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.compiled import compiled_for, supports_compiled
from hybrid_id.simulation.memory import keep_freed_memory
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

WINDOW = 0.4
"""Length [s] of the windows of the warm start; one in four is used."""
FIRST = 0.5
"""Length [s] of the first horizon, over which all rows share one set of parameters."""
GROWTH = 2.0
LAST = 4.0
UNBOUNDED = 1e5
"""A range, or a bound, from which on it is none of a machine's, and tells no size of a parameter."""
Report = Callable[[int, Tensor, Tensor], bool | None] | None
Progress = Callable[[str, int, Tensor, Tensor], bool | None]


def start_points(
    system: System,
    free: Sequence[int],
    bounds: Bounds,
    numbers: Sequence[int],
    starts: int,
    spread: float,
    seed: int,
    given: Tensor | None = None,
) -> Tensor:
    """Start values of all parameters, ``(n_p, starts * G)``: the given point, then points spread around it.

    Args:
        system: model with start values.
        free: indices of the parameters to move.
        bounds: their box and scales.
        numbers: of the sets, G of them; each draws points of its own, whatever other sets are beside it.
        starts: number of points.
        spread: half-width of the factors, 0.5 for +-50 %.
        seed: of the draws.
        given: the first point, ``(n_p, G)``; the system's values by default.
    """
    base = system.theta().detach()[:, None].expand(-1, len(numbers)) if given is None else given
    generators = [np.random.default_rng([seed, number]) for number in numbers]
    points = [base.clone()]
    limits = [limit.to(base.device)[:, None] for limit in (bounds.lower, bounds.upper)]
    reach = 10.0 * bounds.scale.to(base.device)[:, None]
    for _ in range(starts - 1):
        point = base.clone()
        drawn = np.stack([generator.uniform(-1.0, 1.0, len(free)) for generator in generators], 1)
        part = torch.tensor(drawn, device=base.device)
        here = point[list(free)]
        # no factor moves a zero: such a parameter is drawn from the range that its steps are measured by
        moved = torch.where(here == 0, part * reach, here * (1.0 + spread * part))
        point[list(free)] = torch.maximum(torch.minimum(moved, limits[1]), limits[0])
        points.append(point)
    return torch.cat(points, 1)


def warm_start(problem: LeastSquares, theta: Tensor, options: Options, report: Report = None) -> Tensor:
    """Parameters of each set after a fit of short windows from measured states, ``(n_p, G)``."""
    found_windows = measured_windows(problem.system, problem.batch, WINDOW, every=4)
    if found_windows is None:
        return theta
    windows, row = found_windows
    coarse = replace(options, max_iterations=15, tolerance=0.3, loss=options.loss.stages[0])
    part = replace(problem, batch=windows, sets=problem.sets[row])
    found = minimise(part, theta, coarse, report)
    usable = torch.isfinite(found.theta).all(0) & torch.isfinite(found.cost)
    return torch.where(usable, found.theta, theta)


def grow(problem: LeastSquares, theta: Tensor, options: Options, report: Report = None) -> Tensor:
    """Parameters of each set after fits of the first 0.5, 1, 2 and 4 s of the records, ``(n_p, G)``.

    Windows cannot begin in mid-motion where nobody knows the state; from rest everybody does. Over the shortest
    horizon all rows share their parameters, so that every start point ends in the same minimum; then each set goes its
    own way, and starts at the last horizon once more from the values of the set that fits best.

    Args:
        problem: the objective over whole records.
        theta: start points of all parameters, ``(n_p, S)``; any number of them.
        options: settings of the fit.
        report: called after each iteration.
    """
    coarse = replace(options, max_iterations=30, tolerance=0.3, loss=options.loss.stages[0])
    system, batch, sets = problem.system, problem.batch, problem.sets
    count = int(sets.max()) + 1
    step = batch.sample_time
    samples = batch.dt.shape[1]

    def run(seconds: float, start: Tensor, shared: bool) -> tuple[Tensor, Tensor]:
        part, row = batch.windows(min(samples, round(seconds / step)), samples, batch.x0_std)
        group = sets[row]
        if shared:
            part = part.take(torch.arange(part.rows, device=row.device).repeat(start.shape[1]))
            group = torch.arange(start.shape[1], device=row.device).repeat_interleave(len(row))
        fine = with_substeps(system, problem.engine, part, start[:, group])
        nodes = rollout(system, fine, part, start[:, group])
        here = replace(problem, engine=fine, batch=part, sets=group)
        found = minimise(here, start, coarse, report, nodes)
        usable = torch.isfinite(found.theta).all(0) & torch.isfinite(found.cost)
        size = torch.zeros_like(found.cost).index_add(0, group, (part.weight > 0).sum((1, 2)).to(found.cost))
        cost = torch.where(usable, found.cost / size, torch.full_like(found.cost, torch.inf))
        return torch.where(usable, found.theta, start), cost

    theta, cost = run(FIRST, theta, shared=True)
    theta = theta[:, cost.argmin()][:, None].expand(-1, count).clone()
    seconds = FIRST * GROWTH
    theta, cost = run(seconds, theta, shared=False)
    while seconds < LAST and round(seconds / step) < samples:
        seconds *= GROWTH
        theta, cost = run(seconds, theta, shared=False)
    if count > 1:
        again, lower = run(seconds, theta[:, cost.argmin()][:, None].expand(-1, count).clone(), shared=False)
        theta = torch.where(lower < cost, again, theta)
    return theta


def fit(
    system: System,
    batch: Batch,
    *,
    pooled: bool = False,
    engine: Engine | None = None,
    options: Options | None = None,
    starts: int = 1,
    spread: float = 0.5,
    seed: int = 0,
    warm: bool = True,
    start_values: Tensor | None = None,
    x0: Tensor | None = None,
    numbers: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> list[FitResult]:
    """Identify one parameter set for each record of a batch, or one for all of them.

    The warm start fits short windows that begin at measured states, where the problem is nearly convex (behind a
    gear with play and no encoder: horizons that grow from the records' starts). The full fit then runs over all rows
    as they are, whole records or pieces of them (output error, paper eq. 2). With several starts each set keeps its
    best end; a loss with stages keeps the best quarter of the starts after each stage.

    Args:
        system: model with start values, bounds, priors and roles.
        batch: prepared records, or pieces of them (:meth:`hybrid_id.identification.horizons.Horizon.cut`).
        pooled: one parameter set for all rows; otherwise one for all rows of one name.
        engine: how a sample is integrated (default: dry friction, compiled where it can be); its sub-steps are raised
            where stability or accuracy needs it.
        options: settings of the minimisation.
        starts: number of start points; the first is the system's values, the others are spread around it.
        spread: half-width of the factors of the other start points, 0.5 for +-50 %.
        seed: of the start points.
        warm: whether to fit windows first; switch it off to start a richer model at a simpler one's optimum.
        start_values: start values of all parameters for each set, ``(n_p, G)``, instead of the system's.
        x0: first states of an earlier fit, ``(R, n_x)``, from whose free runs this one goes on, where they stay finite;
            by default from the measured states at every sample. Where the link is hidden it begins with free runs
            from the batch's first states, whatever these are.
        numbers: of the sets among all, where others are fitted elsewhere: each draws start points of its own.
        progress: called with (stage, iteration, cost of each set, sets still running); where it returns true, the
            fit ends with the values that it has.

    Raises:
        InputError: nothing to estimate.
    """
    keep_freed_memory()
    options, engine = options or Options(), engine or compiled_for(system, Engine())
    free = free_parameters(system)
    device = batch.x.device
    rows = torch.arange(batch.rows, device=device)
    records = list(dict.fromkeys(batch.names))
    sets = torch.tensor([0 if pooled else records.index(name) for name in batch.names], device=device)
    count = 1 if pooled else len(records)
    bounds = make_bounds(system, free, device)
    drawn_as = numbers or range(count)
    # every start has a copy of all rows and a column of theta a set: column = start x count + set
    theta = start_points(system, free, bounds, drawn_as, starts, spread, seed, start_values).to(device)
    start = theta[:, :count]
    many = batch.take(rows.repeat(starts)) if starts > 1 else batch
    many_sets = torch.cat([sets + k * count for k in range(starts)])

    def report(stage: str):
        return None if progress is None else partial(progress, stage)

    if warm:
        # a smooth law is close to its dry limit, whose steps cost a fraction
        quick = engine if engine.friction == "dry" or engine.compiled else Engine()
        quick = with_substeps(system, quick, many, theta[:, many_sets])
        if hidden_links(system, batch):
            first = LeastSquares(system, quick, batch, sets, free, bounds)
            theta = grow(first, theta[:, ::count], options, report("windows"))
            starts, many, many_sets = 1, batch, sets
        else:
            first = LeastSquares(system, quick, many, many_sets, free, bounds)
            theta = warm_start(first, theta, options, report("windows"))
    engine = with_substeps(system, engine, many, theta[:, many_sets])
    nodes, alive, each = None, starts, torch.arange(count, device=device)
    if hidden_links(system, batch):  # the guess loads no spring, from which Newton's method goes astray
        nodes = rollout(system, engine, many, theta[:, many_sets])
    elif x0 is not None:
        begun = replace(many, x=many.x.clone())
        begun.x[:, 0] = x0.repeat(starts, 1)
        run = rollout(system, engine, begun, theta[:, many_sets])
        nodes = torch.where(run.isfinite().all(2).all(1)[:, None, None], run, many.x)
    for loss in options.loss.stages:
        setting = replace(options, loss=loss)
        limited = setting
        for refinements_left in (2, 1, 0):
            problem = LeastSquares(system, engine, many, many_sets, free, bounds)
            outcome = minimise(problem, theta, limited, report("records"), nodes)
            finer = with_substeps(system, engine, many, outcome.theta[:, many_sets])
            settled = finer.substeps == engine.substeps or "interrupted" in outcome.status
            if settled or refinements_left == 0:
                break
            engine, theta, nodes = finer, outcome.theta, outcome.at.x
            # where none are left, the end is only simulated with the finer sub-steps
            left = limited.max_iterations - int(outcome.iterations.max())
            limited = replace(limited, max_iterations=left)
        cost = outcome.cost.where(torch.isfinite(outcome.cost), torch.full_like(outcome.cost, math.inf))
        order = cost.reshape(alive, count).argsort(0)
        if loss == options.loss or "interrupted" in outcome.status:
            break
        # the next stage: the best starts twice, from their own and from the measured states, and the first start with
        # them, so that it is beaten
        better = order[: max(1, alive // 4)]
        ends = outcome.theta[:, (better * count + each).flatten()]
        own = outcome.at.x[(better[:, sets] * batch.rows + rows).flatten()]
        simulated = simulate(system, engine, batch, start[:, sets]).x
        theta = torch.cat([ends, ends, start], 1)
        nodes = torch.cat([own, batch.x.repeat(len(better), 1, 1), simulated])
        alive = theta.shape[1] // count
        many = batch.take(rows.repeat(alive))
        many_sets = torch.cat([sets + k * count for k in range(alive)])
    best = order[0] * count + each
    return [make_result(replace(problem, batch=batch), outcome, int(g), setting) for g in best]


def fit_records(
    system: System,
    batch: Batch,
    *,
    engine: Engine,
    numbers: Sequence[int] | None = None,
    progress: Progress | None = None,
    kept: Kept | None = None,
    **settings: Any,
) -> list[FitResult]:
    """One parameter set for each record, arguments as of :func:`fit`; ``kept`` are those of an earlier run.

    Compiled steps gain nothing by company, but the stiffest record would give its sub-steps to all: with them each
    record is fitted by itself, unless a gear's start needs all of them.
    """
    records = list(dict.fromkeys(batch.names))
    drawn_as = list(numbers or range(len(records)))
    if not supports_compiled(system, engine, batch.x) or hidden_links(system, batch):
        return kept_fit(kept, system, batch, engine=engine, numbers=drawn_as, progress=progress, **settings)
    costs = torch.full((len(records),), math.inf, dtype=torch.float64)
    found: list[FitResult] = []

    def report(stage: str, iteration: int, cost: Tensor, running: Tensor) -> bool | None:
        if progress is None:
            return None
        costs[len(found)] = cost.min()
        going = torch.arange(len(found) + (0 if len(running) else 1), len(records))
        return progress(stage, iteration, costs, going)

    for record, number in zip(records, drawn_as, strict=True):
        rows = torch.tensor([row for row, name in enumerate(batch.names) if name == record])
        part = batch.take(rows.to(batch.x.device))
        found += kept_fit(kept, system, part, engine=engine, numbers=[number], progress=report, **settings)
    return found


def kept_fit(
    kept: Kept | None, system: System, batch: Batch, *, progress: Progress | None = None, **settings: Any
) -> list[FitResult]:
    """:func:`fit`, read where an earlier run has kept it."""
    if kept is None:
        return fit(system, batch, progress=progress, **settings)
    made_from = batch, str(batch.x.device), settings
    return kept.results(
        made_from, system, lambda watched: fit(system, batch, progress=watched, **settings), progress
    )


def make_bounds(system: System, free: Sequence[int], device: torch.device | str = "cpu") -> Bounds:
    """Box, priors and scales of the free parameters."""
    specs = [system.table[i].spec for i in free]

    def column(values: Sequence[float]) -> Tensor:
        return torch.tensor(list(values), dtype=torch.float64, device=device)

    # a parameter that starts at zero moves in steps of its range, where it has one, else as the records say; and one of
    # either sign in a range of its own, for how near to zero it starts is no measure of it
    widths = [spec.upper - spec.lower for spec in specs]
    ranges = [0.05 * width if math.isfinite(width) and width < UNBOUNDED else 0.0 for width in widths]
    signed = []
    for i, spec in zip(free, specs, strict=True):
        # bounds that are those of its law hold for any machine: they are no range of its own
        law = cast(Component, system.components[system.table[i].component]).declared[system.table[i].symbol]
        ranged = (spec.lower, spec.upper) != (law.lower, law.upper)
        signed.append(spec.lower < 0.0 < spec.upper and ranged)
    scale = [
        max(abs(spec.value), reach * either) or reach or 1e-3
        for spec, reach, either in zip(specs, ranges, signed, strict=True)
    ]
    sized = [float(spec.value != 0.0 or reach > 0.0) for spec, reach in zip(specs, ranges, strict=True)]
    return Bounds(
        column([s.lower for s in specs]),
        column([s.upper for s in specs]),
        column([s.value if s.prior_mean is None else s.prior_mean for s in specs]),
        column([0.0 if s.prior_std is None else s.prior_std**-2 for s in specs]),
        0.1 * column(scale),
        column(sized),
    )
