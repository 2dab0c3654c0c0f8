"""Fits over pieces of records, whose hidden first states are those of the fitted values.

A piece begins in states that nobody has measured (the twist of a gear, a bristle, heat) as a free run of the model has
them there, and is held to them. A free run with the start values holds the estimates to these: so records are cut anew
with the fitted values, and fitted again, until the estimates stay or err more than those before.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from hybrid_id.identification.fit import fit, kept_fit
from hybrid_id.identification.horizons import Horizon, free_runs
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.least_squares import Options
from hybrid_id.identification.objective import Loss
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
from hybrid_id.simulation.stability import with_substeps
from hybrid_id.simulation.step import Engine

ROUNDS = 12
"""Times that records are cut anew at most: each takes about half of what is left of the way."""
SETTLED = 0.02
"""Share of what a fit leaves (RMS) by which its outputs move in a round, below which its estimates have settled."""


def settled(
    sets: list[FitResult],
    horizon: Horizon,
    batch: Batch,
    *,
    engine: Engine,
    kept: Kept | None = None,
    **settings: Any,
) -> list[FitResult]:
    """The sets, fitted again to pieces that begin as their own values say; as they are where no first state is hidden.

    Args:
        sets: fits to pieces that begin as the start values say, one of all records or one of each.
        horizon: of the pieces.
        batch: the whole records.
        engine: how a sample is integrated.
        kept: fits that are kept from before.
        settings: further arguments of :func:`hybrid_id.identification.fit.fit`, its options among them.
    """
    if not sets or not horizon.simulates(sets[0].system, batch):
        return sets
    found = []
    for one in sets:
        rows = [row for row, name in enumerate(batch.names) if name in one.records]
        own = batch.take(torch.tensor(rows, device=batch.x.device))
        if one.status not in ("diverged", "interrupted"):
            one = _until_it_stays(one, horizon, own, engine=engine, kept=kept, **settings)
        found.append(one)
    return found


def _until_it_stays(
    one: FitResult, horizon: Horizon, batch: Batch, *, engine: Engine, kept: Kept | None, **settings: Any
) -> FitResult:
    """A set fitted to pieces cut anew while it errs less from its own hidden first states, with its errors there."""
    options = settings.get("options") or Options()
    loss = options.loss
    part, first, least = _from_its_own(one, horizon, batch, loss)
    for _ in range(ROUNDS):
        (again,) = kept_fit(kept, one.system, part, pooled=True, engine=engine, **settings)
        if again.status == "diverged":
            break
        there, began, errs = _from_its_own(again, horizon, batch, loss)
        if not errs < least:
            break
        moved, one, part, first, least = _moved(one, again), again, there, began, errs
        if moved <= SETTLED * one.noise_scale or one.status == "interrupted":
            break
    as_it_is = settings | {"options": replace(options, max_iterations=0), "warm": False, "starts": 1}
    (end,) = fit(one.system, part, pooled=True, engine=one.engine, x0=first, **as_it_is)
    return replace(end, status=one.status, iterations=one.iterations, history=one.history)


def _from_its_own(
    one: FitResult, horizon: Horizon, batch: Batch, loss: Loss
) -> tuple[Batch, torch.Tensor, float]:
    """Pieces that begin as a set's values say, the first states of free runs over them, and what these cost."""
    part = horizon.cut(one.system, one.engine, batch)
    run = free_runs(one.system, with_substeps(one.system, one.engine, part), part)
    errors = ((run.y - part.y) * part.weight)[part.weight > 0]
    return part, run.x[:, 0], float(loss.value(errors).sum())


def _moved(before: FitResult, after: FitResult) -> float:
    """RMS by which the weighted outputs move between two sets of values, to first order."""
    step = after.values - before.values
    squares = sum(float(np.square(part.reshape(-1, len(step)) @ step).sum()) for part in after.jacobian)
    return float(np.sqrt(squares / max(after.n_samples, 1)))
