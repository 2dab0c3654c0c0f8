"""From prepared records and a system to parameter sets: warm start, multi-start, Levenberg-Marquardt, results."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import grow, hidden_links
from hybrid_id.identification.least_squares import Bounds, Options, minimise
from hybrid_id.identification.result import FitResult, make_result
from hybrid_id.identification.start_points import start_points
from hybrid_id.simulation.memory import keep_freed_memory
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

WINDOW = 0.4
"""Length [s] of the windows of the warm start; one in four is used."""

Progress = Callable[[str, int, Tensor, Tensor], bool | None]


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
    numbers: Sequence[int] | None = None,
    progress: Progress | None = None,
) -> list[FitResult]:
    """Identify one parameter set for each row of a batch, or one for all of them.

    The warm start fits short windows that begin at measured states, where the problem is nearly convex (behind a
    gear with play and no encoder: horizons that grow from the records' starts); the full fit then runs over whole
    records (output error, paper eq. 2). With several starts each set keeps its best end; a loss with stages keeps the
    best quarter of the starts after each stage.

    Args:
        system: model with start values, bounds, priors and roles.
        batch: prepared records.
        pooled: one parameter set for all rows.
        engine: how a sample is integrated (default: dry friction); its sub-steps are raised where stability or
            accuracy needs it.
        options: settings of the minimisation.
        starts: number of start points; the first is the system's values, the others are spread around it.
        spread: half-width of the factors of the other start points, 0.5 for +-50 %.
        seed: of the start points.
        warm: whether to fit windows first; switch it off to start a richer model at a simpler one's optimum.
        start_values: start values of all parameters for each set, ``(n_p, G)``, instead of the system's.
        numbers: of the sets among all, where others are fitted elsewhere: each draws start points of its own.
        progress: called with (stage, iteration, cost of each set, sets still running); where it returns true, the
            fit ends with the values that it has.

    Raises:
        InputError: nothing to estimate.
    """
    keep_freed_memory()
    options, engine = options or Options(), engine or Engine()
    free = system.estimated
    if not free:
        raise InputError("The model has no parameter to estimate; set 'estimate: true' for at least one.")
    device = batch.x.device
    rows = torch.arange(batch.rows, device=device)
    sets = torch.zeros_like(rows) if pooled else rows
    count = 1 if pooled else batch.rows
    bounds = make_bounds(system, free, device)
    drawn_as = numbers or range(count)
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
            theta = grow(
                system, quick, batch, sets, theta[:, ::count], free, bounds, options, report("windows")
            )
            starts, many, many_sets = 1, batch, sets
        else:
            theta = warm_start(
                system, quick, many, many_sets, theta, free, bounds, options, report("windows")
            )
    engine = with_substeps(system, engine, many, theta[:, many_sets])
    nodes, alive, each = None, starts, torch.arange(count, device=device)
    if hidden_links(system, batch):  # the guess loads no spring, from which Newton's method goes astray
        nodes = rollout(system, engine, many, theta[:, many_sets])
    for loss in options.loss.stages:
        setting = replace(options, loss=loss)
        for refinements_left in (2, 1, 0):
            outcome = minimise(
                system, engine, many, many_sets, theta, free, bounds, setting, report("records"), nodes
            )
            finer = with_substeps(system, engine, many, outcome.theta[:, many_sets])
            settled = finer.substeps == engine.substeps or "interrupted" in outcome.status
            if settled or refinements_left == 0:  # the result names the engine that it was found with
                break
            engine, theta, nodes = finer, outcome.theta, outcome.at.x
        cost = outcome.cost.where(torch.isfinite(outcome.cost), torch.full_like(outcome.cost, math.inf))
        order = cost.reshape(alive, count).argsort(0)
        if loss == options.loss or "interrupted" in outcome.status:
            break
        # the best go on twice, from their own and from the measured states; the start joins them, so that it is beaten
        better = order[: max(1, alive // 4)]
        theta = outcome.theta[:, (better * count + each).flatten()]
        theta = torch.cat([theta, theta, start], 1)
        own = outcome.at.x[(better[:, sets] * batch.rows + rows).flatten()]
        nodes = torch.cat(
            [own, batch.x.repeat(len(better), 1, 1), simulate(system, engine, batch, start[:, sets]).x]
        )
        alive = 2 * len(better) + 1
        many = batch.take(rows.repeat(alive))
        many_sets = torch.cat([sets + k * count for k in range(alive)])
    best = order[0] * count + each
    return [
        make_result(system, batch, many_sets, outcome, int(g), free, bounds, engine, setting) for g in best
    ]


def make_bounds(system: System, free: Sequence[int], device: torch.device | str = "cpu") -> Bounds:
    """Box, priors and scales of the free parameters."""
    specs = [system.table[i].spec for i in free]

    def column(values: Sequence[float]) -> Tensor:
        return torch.tensor(list(values), dtype=torch.float64, device=device)

    scale = []
    for spec in specs:
        # a parameter that starts at zero moves in steps of its range, where it has one
        width = spec.upper - spec.lower
        scale.append(abs(spec.value) or (0.05 * width if math.isfinite(width) and width < 1e5 else 1e-3))
    return Bounds(
        column([s.lower for s in specs]),
        column([s.upper for s in specs]),
        column([s.value if s.prior_mean is None else s.prior_mean for s in specs]),
        column([0.0 if s.prior_std is None else s.prior_std**-2 for s in specs]),
        0.1 * column(scale),
    )


def window_samples(samples: int, step: float, seconds: float) -> int | None:
    """Samples of a window of so many seconds, 25 at least; None where four do not fit into a record.

    Args:
        samples: of the longest record.
        step: sample time [s].
        seconds: length of the window.
    """
    length = max(25, round(seconds / step))
    return length if 4 * length <= samples else None


def measured_windows(
    system: System, batch: Batch, seconds: float, every: int = 1
) -> tuple[Batch, Tensor] | None:
    """Windows of a batch whose first states are measured and free within their uncertainty, and the row of each.

    Args:
        system: tells the states.
        batch: whole records.
        seconds: length of a window.
        every: use one window in this many.

    Returns:
        None where the records are shorter than four windows.
    """
    step = batch.step
    length = window_samples(batch.x.shape[1], step, seconds)
    if length is None:
        return None
    noise = dict(zip(batch.outputs, (1.0 / batch.weight.amax(1)).unbind(1), strict=True))
    x0_std = 0.1 * batch.std(batch.x)
    x0_std[:, system.memory_rows] = 0.0
    for joint in system.joints:
        # behind a rigid gear either encoder tells both sides
        link = joint.gear_ratio if joint.rigid else 1.0
        for side, row, ratio in (("a", joint.positions[-1], link), ("m", joint.positions[0], 1.0)):
            if (angle := noise.get(f"q_{side}{joint.number}")) is not None:
                x0_std[:, row], x0_std[:, row + 1] = ratio * angle, ratio * angle / (20 * step)
            if (speed := noise.get(f"v_{side}{joint.number}")) is not None:
                x0_std[:, row + 1] = ratio * speed
    return batch.windows(length, every * length, x0_std)


def warm_start(
    system: System,
    engine: Engine,
    batch: Batch,
    sets: Tensor,
    theta: Tensor,
    free: list[int],
    bounds: Bounds,
    options: Options,
    progress: Callable[[int, Tensor, Tensor], bool | None] | None = None,
) -> Tensor:
    """Parameters of each set after a fit of short windows from measured states, ``(n_p, G)``."""
    found_windows = measured_windows(system, batch, WINDOW, every=4)
    if found_windows is None:
        return theta
    windows, row = found_windows
    coarse = replace(options, max_iterations=15, tolerance=0.3, loss=options.loss.stages[0])
    found = minimise(system, engine, windows, sets[row], theta, free, bounds, coarse, progress)
    usable = torch.isfinite(found.theta).all(0) & torch.isfinite(found.cost)
    return torch.where(usable, found.theta, theta)
