"""Baseline: always Stribeck friction, the usual suspect, at the joint where it predicts best."""

from __future__ import annotations

from typing import Any

from hybrid_id.contenders.report import answer, gap_of, named
from hybrid_id.diagnosis.candidates import tasks
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

NAME = "stribeck_friction"
ITERATIONS = 15


def stribeck(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name Stribeck friction, whatever the records say."""
    fits = Fits(dataset)
    base = fits.base(system, free=True)
    todo = [task for task in tasks(fits, base) if task.effects[0][0] == NAME]
    found = sorted((one for one in fits.run(todo, ITERATIONS) if one is not None), key=lambda one: one.error)
    places = list(dict.fromkeys(one.effects[0][1] for one in found)) or ["joint1/motor_friction"]
    effects = [named(NAME, where, 1.0 if k == 0 else 0.0, selected=k == 0) for k, where in enumerate(places)]
    after = found[0] if found else base
    return answer(dataset.name, effects, gap_of(dataset, system, base.result, after.result))
