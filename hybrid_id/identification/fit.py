"""From prepared records and a system to parameter sets: warm start, multi-start, Levenberg-Marquardt, results."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import hidden_links
from hybrid_id.identification.least_squares import Bounds, Options, minimise
from hybrid_id.identification.result import FitResult, make_result
from hybrid_id.identification.start_points import start_points
from hybrid_id.identification.warm_start import grow, warm_start
from hybrid_id.simulation.memory import keep_freed_memory
from hybrid_id.simulation.prepare import Batch
from hybrid_id.simulation.rollout import rollout, simulate
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

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
    """Identify one parameter set for each record of a batch, or one for all of them.

    The warm start fits short windows that begin at measured states, where the problem is nearly convex (behind a
    gear with play and no encoder: horizons that grow from the records' starts); the full fit then runs over whole
    records (output error, paper eq. 2). With several starts each set keeps its best end; a loss with stages keeps the
    best quarter of the starts after each stage.

    Args:
        system: model with start values, bounds, priors and roles.
        batch: prepared records, or pieces of them (:meth:`hybrid_id.identification.horizons.Horizon.cut`).
        pooled: one parameter set for all rows; otherwise one for all rows of one name.
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
    records = list(dict.fromkeys(batch.names))
    sets = torch.tensor([0 if pooled else records.index(name) for name in batch.names], device=device)
    count = 1 if pooled else len(records)
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

    # a parameter that starts at zero moves in steps of its range, where it has one, else as the records say
    widths = [spec.upper - spec.lower for spec in specs]
    ranges = [0.05 * width if math.isfinite(width) and width < 1e5 else 0.0 for width in widths]
    scale = [abs(spec.value) or reach or 1e-3 for spec, reach in zip(specs, ranges, strict=True)]
    sized = [float(spec.value != 0.0 or reach > 0.0) for spec, reach in zip(specs, ranges, strict=True)]
    return Bounds(
        column([s.lower for s in specs]),
        column([s.upper for s in specs]),
        column([s.value if s.prior_mean is None else s.prior_mean for s in specs]),
        column([0.0 if s.prior_std is None else s.prior_std**-2 for s in specs]),
        0.1 * column(scale),
        column(sized),
    )
