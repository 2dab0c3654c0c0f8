"""Baseline: every effect of the catalogue added alone and fitted, judged by Schwarz's criterion.

``BIC = n log(RSS / n) + k log n`` (G. Schwarz, Ann. Stat. 6, 1978) over the train records, errors taken as
independent. What a careful engineer does by hand; nothing is left out for validation, no pair is tried, and nothing
outside the catalogue is thought of.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid_id.contenders.report import answer, gap_of, named
from hybrid_id.diagnosis.candidates import tasks
from hybrid_id.diagnosis.fits import Fits, Task
from hybrid_id.diagnosis.model import Model
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

COARSE, FULL = 2, 20
"""Iterations of the fits of all effects, and of the best."""
FINALISTS = 5
"""Candidates that are fitted further, after a coarse fit of all."""


def bic(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name the effect with the least criterion, if any is below that of the nominal model."""
    fits = Fits(dataset)
    base = fits.base(system, free=True)
    coarse = best_of_each(fits.run(tasks(fits, base), COARSE))
    finals = fits.run([Task(one.effects, one.system) for one in coarse[:FINALISTS]], FULL)
    ranked = best_of_each([*coarse, *finals])
    criteria = np.array([criterion(base), *(criterion(one) for one in ranked)])
    weights = np.exp(-0.5 * (criteria - criteria.min()))
    weights = weights / weights.sum()
    found = bool(ranked) and bool(criteria[1] < criteria[0])
    effects = [
        named(*one.effects[0], weight, selected=found and k == 0)
        for k, (one, weight) in enumerate(zip(ranked, weights[1:], strict=True))
    ]
    chosen = ranked[0] if found else base
    return answer(dataset.name, effects, gap_of(dataset, system, base.result, chosen.result))


def criterion(one: Model) -> float:
    """Schwarz's criterion of a fit."""
    residual = np.concatenate([r.reshape(-1) for r in one.result.residual])
    n = np.count_nonzero(residual)
    return float(n * np.log(np.square(residual).sum() / n) + len(one.result.names) * np.log(n))


def best_of_each(found: list[Model | None]) -> list[Model]:
    """The best fit of each effect at each place, least criterion first."""
    best: dict[tuple[tuple[str, str], ...], Model] = {}
    for one in sorted((e for e in found if e is not None), key=criterion):
        best.setdefault(one.effects, one)
    return list(best.values())
