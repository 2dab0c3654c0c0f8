"""Methods that fit with the diagnosis' own engine: the diagnosis itself, and two baselines on its candidates.

`stribeck` always names Stribeck friction, the usual suspect, at the joint where it predicts best. `bic` adds every
effect of the catalogue alone, fits it and judges by Schwarz's criterion, ``BIC = n log(RSS / n) + k log n``
(G. Schwarz, Ann. Stat. 6, 1978), over the train records, errors taken as independent. That is what a careful engineer
does by hand: nothing is left out for validation, no pair is tried, and nothing outside the catalogue is thought of.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid_id.baselines.answer import answer, gap_of, named
from hybrid_id.baselines.by_joint import Part, joined, parts_of
from hybrid_id.diagnosis.arm import diagnose_arm
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.diagnosis.fits import Fits, Task
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.result import Diagnosis
from hybrid_id.diagnosis.starts import tasks
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.units import stem
from hybrid_id.systems.arm import MOTION
from hybrid_id.systems.by_joint import as_in_robot
from hybrid_id.systems.chain import System

NAME = "stribeck_friction"
ITERATIONS = 15


def stribeck(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name Stribeck friction, whatever the records say; of a robot at the joint with the largest error."""
    tried: list[tuple[Part, FittedModel, list[FittedModel]]] = []
    for part in parts_of(dataset, system):
        fits = Fits(part.dataset)
        base = fits.base(part.system, free=True)
        todo = [task for task in tasks(fits, base) if task.effects[0][0] == NAME]
        found = sorted((o for o in fits.run(todo, ITERATIONS) if o is not None), key=lambda one: one.error)
        tried.append((part, base, found))
    tried.sort(key=lambda own: -own[1].error)
    places = [part.placed(one.effects[0][1]) for part, _, found in tried for one in found]
    places = list(dict.fromkeys(places)) or [
        tried[0][0].placed(f"{tried[0][0].system.joints[0].name}/motor_friction")
    ]
    effects = [named(NAME, where, 1.0 if k == 0 else 0.0, selected=k == 0) for k, where in enumerate(places)]
    before = joined(system, [base.system for _, base, _ in tried])
    leading = next((found[0].system for _, _, found in tried if found), None)
    after = before if leading is None else joined(before, [leading])
    return answer(dataset.name, effects, gap_of(dataset, system, before, after))


COARSE, FULL = 2, 20
"""Iterations of the fits of all effects, and of the best."""
FINALISTS = 5
"""Candidates that are fitted further, after a coarse fit of all."""


def bic(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name the effect with the least criterion, if any is below that of the nominal model, of a robot at any joint."""
    before: list[System] = []
    ranked: list[tuple[float, Part, FittedModel]] = []
    for part in parts_of(dataset, system):
        fits = Fits(part.dataset)
        base = fits.base(part.system, free=True)
        coarse = best_of_each(fits.run(tasks(fits, base), COARSE))
        finals = fits.run([Task(one.effects, one.system) for one in coarse[:FINALISTS]], FULL)
        ranked += [(criterion(one) - criterion(base), part, one) for one in best_of_each([*coarse, *finals])]
        before.append(base.system)
    ranked.sort(key=lambda own: own[0])
    against = np.array(
        [0.0, *(surplus for surplus, _, _ in ranked)]
    )  # the nominal model's, and each effect's
    weights = np.exp(-0.5 * (against - against.min()))
    weights = weights / weights.sum()
    found = bool(ranked) and ranked[0][0] < 0.0
    effects = [
        named(one.effects[0][0], part.placed(one.effects[0][1]), weight, selected=found and k == 0)
        for k, ((_, part, one), weight) in enumerate(zip(ranked, weights[1:], strict=True))
    ]
    first = joined(system, before)
    chosen = joined(first, [ranked[0][2].system]) if ranked else first
    return answer(dataset.name, effects, gap_of(dataset, system, first, chosen))


def criterion(one: FittedModel) -> float:
    """Schwarz's criterion of a fit."""
    residual = np.concatenate([r.reshape(-1) for r in one.result.residual])
    n = np.count_nonzero(residual)
    return float(n * np.log(np.square(residual).sum() / n) + len(one.result.names) * np.log(n))


def best_of_each(found: list[FittedModel | None]) -> list[FittedModel]:
    """The best fit of each effect at each place, least criterion first."""
    best: dict[tuple[tuple[str, str], ...], FittedModel] = {}
    for one in sorted((e for e in found if e is not None), key=criterion):
        best.setdefault(one.effects, one)
    return list(best.values())


def diagnosis(dataset: Dataset, system: System) -> dict[str, Any]:
    """Content of ``diagnosis.json``, with all that the proposed experiment is made of; of a robot joint by joint.

    A robot's ``next_experiments`` are those of each joint with a tie that matters.

    Raises:
        KeyboardInterrupt: stopped before its end: half a search is no answer to a case.
    """
    if system.tree is None:
        found = diagnose(dataset, system)
        if found.interrupted:
            raise KeyboardInterrupt
        content = found.as_dict()
        return content | {"next_experiments": proposed(found)}
    arm = diagnose_arm(dataset, system)
    if arm.interrupted:
        raise KeyboardInterrupt
    acting = [joint for joint, one in arm.joints.items() if one.unknown]
    where = max(acting, key=lambda joint: arm.parts[joint]) if arm.unknown else None
    experiments = [entry for joint in arm.tied for entry in proposed(arm.joints[joint])]
    return arm.as_dict() | {
        "unknown_at": where and {"joint": where, "place": None}, "next_experiments": experiments,
    }  # fmt: skip


def proposed(found: Diagnosis) -> list[dict[str, Any]]:
    """The proposed records with all that they are made of; none where they distinguish nothing.

    Beside each entry of ``diagnosis.json``: ``sample_time``, the ``command``, the robot's other angles ``held`` and
    the outputs at its ``start``, by channel.
    """
    entries: list[dict[str, Any]] = found.as_dict()["next_experiments"]
    for entry, one in zip(entries, found.proposed, strict=True):
        given = as_in_robot(one.inputs, found.model)
        entry |= {
            "sample_time": float(one.time[1] - one.time[0]),
            "command": [round(float(u), 4) for u in one.command],
            "held": {n: float(v[0]) for n, v in given.items() if stem(n) == MOTION[0]},
            "start": dict(one.start),
        }
    return entries
