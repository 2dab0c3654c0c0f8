"""Baseline: always Stribeck friction, the usual suspect, at the joint where it predicts best."""

from __future__ import annotations

from typing import Any

from hybrid_id.contenders.report import answer, gap_of, suspect
from hybrid_id.diagnosis.refit import Refit
from hybrid_id.diagnosis.starts import tasks
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.chain import System

NAME = "stribeck_friction"
ITERATIONS = 15


def stribeck(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name Stribeck friction, whatever the records say."""
    refit = Refit(dataset)
    base = refit.base(system)
    todo = [task for part in tasks(refit, base, system) for task in part if task.effects[0][0] == NAME]
    fits = sorted(
        (one for one in refit.run(todo, ITERATIONS) if one is not None), key=lambda one: one.evidence.error
    )
    places = list(dict.fromkeys(one.effects[0][1] for one in fits)) or ["joint1/motor_friction"]
    effects = [
        suspect(NAME, where, 1.0 if k == 0 else 0.0, selected=k == 0) for k, where in enumerate(places)
    ]
    after = fits[0] if fits else base
    return answer(dataset.name, effects, gap_of(dataset, system, base.result, after.result))
