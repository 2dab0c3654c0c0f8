"""Methods that fit with the diagnosis' own engine: the diagnosis itself, and two baselines on its candidates.

`stribeck` always names Stribeck friction, the usual suspect, at the joint where it predicts best. `bic` adds every
effect of the catalogue alone, fits it and judges by Schwarz's criterion, ``BIC = n log(RSS / n) + k log n``
(G. Schwarz, Ann. Stat. 6, 1978), over the train records, errors taken as independent. That is what a careful engineer
does by hand: nothing is left out for validation, no pair is tried, and nothing outside the catalogue is thought of.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid_id.diagnosis.arm import diagnose_arm
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import diagnose
from hybrid_id.diagnosis.errors_on_test import errors, shrink
from hybrid_id.diagnosis.fits import Fits, Task, engine
from hybrid_id.diagnosis.grade import RatedEffect
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.result import Diagnosis, effect_entry, gap_entry
from hybrid_id.diagnosis.starts import tasks
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.systems.by_joint import (
    joint_parts,
    joints_to_diagnose,
    named,
    some,
    with_drive,
    with_others_measured,
)
from hybrid_id.systems.chain import System

STRIBECK = "stribeck_friction"
ITERATIONS = 15
"""Iterations of the fits of Stribeck friction."""
COARSE, FULL = 2, 20
"""Iterations of the fits of all effects, and of the best."""
FINALISTS = 5
"""Candidates that are fitted further, after a coarse fit of all."""


def stribeck(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name Stribeck friction, whatever the records say; of a robot at the joint with the largest error."""
    tried: list[tuple[FittedModel, list[FittedModel]]] = []
    for records, nominal in taken_apart(dataset, system):
        fits = Fits(records)
        base = fits.base(nominal, free=True)
        todo = [task for task in tasks(fits, base) if task.effects[0][0] == STRIBECK]
        fitted = sorted((f for f in fits.run(todo, ITERATIONS) if f is not None), key=lambda fit: fit.error)
        tried.append((base, fitted))
    tried.sort(key=lambda pair: -pair[0].error)
    places = [named(base.system, fit.effects[0][1]) for base, fitted in tried for fit in fitted]
    if not places:
        worst = tried[0][0].system
        places = [named(worst, f"{worst.joints[0].name}/motor_friction")]
    effects = [
        RatedEffect(STRIBECK, where, float(k == 0), k == 0, (), {})
        for k, where in enumerate(dict.fromkeys(places))
    ]
    before = joined(system, [base.system for base, _ in tried])
    leading = next((fitted[0].system for _, fitted in tried if fitted), None)
    after = before if leading is None else joined(before, [leading])
    return answer(dataset, effects, system, before, after)


def bic(dataset: Dataset, system: System) -> dict[str, Any]:
    """Name the effect with the least criterion, if any is below that of the nominal model, of a robot at any joint."""
    before: list[System] = []
    ranked: list[tuple[float, FittedModel]] = []
    for records, nominal in taken_apart(dataset, system):
        fits = Fits(records)
        base = fits.base(nominal, free=True)
        coarse = best_of_each(fits.run(tasks(fits, base), COARSE))
        finals = fits.run([Task(fit.effects, fit.system) for fit in coarse[:FINALISTS]], FULL)
        ranked += [(criterion(fit) - criterion(base), fit) for fit in best_of_each([*coarse, *finals])]
        before.append(base.system)
    ranked.sort(key=lambda pair: pair[0])
    surplus = np.array([0.0, *(more for more, _ in ranked)])  # the nominal model's, and each effect's
    weights = np.exp(-0.5 * (surplus - surplus.min()))
    weights = weights / weights.sum()
    found = bool(ranked) and ranked[0][0] < 0.0
    effects = [
        RatedEffect(
            fit.effects[0][0], named(fit.system, fit.effects[0][1]), float(weight), found and k == 0, (), {}
        )
        for k, ((_, fit), weight) in enumerate(zip(ranked, weights[1:], strict=True))
    ]
    first = joined(system, before)
    chosen = joined(first, [ranked[0][1].system]) if ranked else first
    return answer(dataset, effects, system, first, chosen)


def criterion(fit: FittedModel) -> float:
    """Schwarz's criterion of a fit."""
    residual = np.concatenate([r.reshape(-1) for r in fit.result.residual])
    n = np.count_nonzero(residual)
    return float(n * np.log(np.square(residual).sum() / n) + len(fit.result.names) * np.log(n))


def best_of_each(fits: Sequence[FittedModel | None]) -> list[FittedModel]:
    """The best fit of each effect at each place, least criterion first."""
    best: dict[tuple[tuple[str, str], ...], FittedModel] = {}
    for fit in sorted((f for f in fits if f is not None), key=criterion):
        best.setdefault(fit.effects, fit)
    return list(best.values())


def taken_apart(dataset: Dataset, system: System) -> list[tuple[Dataset, System]]:
    """The joints of a robot one by one, the others as they were measured; a machine without a tree as it is.

    Raises:
        InputError: no joint can be taken by itself.
    """
    if system.tree is None:
        return [(dataset, system)]
    names, skipped = joints_to_diagnose(dataset, system)
    if not names:
        raise InputError(f"No joint can be taken by itself ({'; '.join(skipped.values())}).")
    parts = joint_parts(system)
    return [(with_others_measured(dataset, system, *parts[n]), some(system, parts[n])) for n in names]


def joined(whole: System, models: Sequence[System]) -> System:
    """A robot with the drives of models of its joints; the model itself of a machine without a tree."""
    if whole.tree is None:
        return models[0]
    for model in models:
        whole = with_drive(whole, model)
    return whole


def answer(
    dataset: Dataset, effects: Sequence[RatedEffect], nominal: System, before: System, after: System
) -> dict[str, Any]:
    """The answer of a baseline, in the form of ``diagnosis.json``, with errors on the test records if there are any.

    Args:
        dataset: the case's records.
        effects: best first.
        nominal: the model as it was given.
        before: its re-fit.
        after: the corrected one, fitted.
    """
    given, first, last = (errors(dataset, model, engine()) for model in (nominal, before, after))
    closed = first and last and shrink(first, last, min(last.noise, last.nrmse))
    wrong_values = bool(given and first and given.nrmse >= CRITERIA.wrong_values * first.nrmse)
    silent = "parameters_only" if wrong_values else "no_gap"
    verdict = "effects" if any(one.selected for one in effects) else silent
    return {
        "case": dataset.name, "verdict": verdict, "unknown": False, "no_gap": verdict == silent,
        "effects": [effect_entry(one) for one in effects], "ties": [],
        "gap": gap_entry(given, first, last, closed, ""),
    }  # fmt: skip


def diagnosis(dataset: Dataset, system: System) -> dict[str, Any]:
    """Content of ``diagnosis.json``; of a robot joint by joint, and ``unknown_location`` with it.

    Raises:
        KeyboardInterrupt: stopped before its end: half a search is no answer to a case.
    """
    found = diagnose(dataset, system) if system.tree is None else diagnose_arm(dataset, system)
    if found.interrupted:
        raise KeyboardInterrupt
    if isinstance(found, Diagnosis):
        return found.as_dict()
    acting = found.joints_with_unknown
    where = max(acting, key=lambda joint: found.parts[joint], default=None)
    return found.as_dict() | {"unknown_location": where and {"joint": where, "side": None}}
