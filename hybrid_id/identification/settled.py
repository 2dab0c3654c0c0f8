"""Fits over pieces of records, whose hidden first states are those of the fitted values.

A piece begins in states that nobody has measured (the twist of a gear, a bristle, heat) as a free run of the model has
them there, and is held to them. A free run with the start values holds the estimates to these: so records are cut anew
with the fitted values, and fitted again, until the estimates stay or err more than those before.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.keep import Kept
from hybrid_id.identification.result import FitResult
from hybrid_id.simulation.batch import Batch
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
        settings: further arguments of :func:`hybrid_id.identification.fit.fit`, but for the start points.
    """
    if not sets or not horizon.simulates(sets[0].system, batch):
        return sets
    found = []
    for one in sets:
        rows = [row for row, name in enumerate(batch.names) if name in one.records]
        own = batch.take(torch.tensor(rows, device=batch.x.device))
        before, least = one, math.inf
        for _ in range(ROUNDS):
            if one.status in ("diverged", "interrupted"):
                break
            part = horizon.cut(one.system, engine, own)
            (again,) = kept_fit(kept, one.system, part, pooled=True, engine=engine, **settings)
            errs = again.history[
                0
            ]  # those of the values that it begins with, from their own hidden first states
            if again.status == "diverged" or not errs <= least:
                one = before
                break
            one, before, least = again, one, errs
            if _moved(before, one) <= SETTLED * one.noise_scale:
                break
        found.append(one)
    return found


def _moved(before: FitResult, after: FitResult) -> float:
    """RMS by which the weighted outputs move between two sets of values, to first order."""
    step = after.values - before.values
    squares = sum(float(np.square(part.reshape(-1, len(step)) @ step).sum()) for part in after.jacobian)
    return float(np.sqrt(squares / max(after.n_samples, 1)))
