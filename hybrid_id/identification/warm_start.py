"""Where a fit of whole records starts: short windows, or horizons that grow from the start where a state is hidden."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from hybrid_id.identification.horizons import measured_windows
from hybrid_id.identification.least_squares import Options, minimise
from hybrid_id.identification.lm_step import Bounds
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.rollout import rollout
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine
from hybrid_id.systems.chain import System

WINDOW = 0.4
"""Length [s] of the windows of the warm start; one in four is used."""
FIRST = 0.5
"""Length [s] of the first horizon, over which all rows share one set of parameters."""
GROWTH = 2.0
LAST = 4.0

Report = Callable[[int, Tensor, Tensor], bool | None] | None


def warm_start(
    system: System,
    engine: Engine,
    batch: Batch,
    sets: Tensor,
    theta: Tensor,
    free: list[int],
    bounds: Bounds,
    options: Options,
    progress: Report = None,
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


def grow(
    system: System,
    engine: Engine,
    batch: Batch,
    sets: Tensor,
    theta: Tensor,
    free: list[int],
    bounds: Bounds,
    options: Options,
    report: Report = None,
) -> Tensor:
    """Parameters of each set after fits of the first 0.5, 1, 2 and 4 s of the records, ``(n_p, G)``.

    Windows cannot begin in mid-motion where nobody knows the state; from rest everybody does. Over the shortest
    horizon all rows share their parameters, so that every start point ends in the same valley; then each set goes its
    own way, and starts at the last horizon once more from the values of the set that fits best.

    Args:
        system: what is simulated.
        engine: how a sample is integrated.
        batch: whole records.
        sets: parameter set of each row, ``(R,)``.
        theta: start points of all parameters, ``(n_p, S)``; any number of them.
        free: indices of the parameters to move.
        bounds: box and priors.
        options: settings of the fit.
        report: called after each iteration.
    """
    coarse = replace(options, max_iterations=30, tolerance=0.3, loss=options.loss.stages[0])
    count = int(sets.max()) + 1
    step = batch.step
    samples = batch.dt.shape[1]

    def run(seconds: float, start: Tensor, shared: bool) -> tuple[Tensor, Tensor]:
        part, row = batch.windows(min(samples, round(seconds / step)), samples, batch.x0_std)
        group = sets[row]
        if shared:
            part = part.take(torch.arange(part.rows, device=row.device).repeat(start.shape[1]))
            group = torch.arange(start.shape[1], device=row.device).repeat_interleave(len(row))
        fine = with_substeps(system, engine, part, start[:, group])
        nodes = rollout(system, fine, part, start[:, group])
        found = minimise(system, fine, part, group, start, free, bounds, coarse, report, nodes)
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
