"""The ground truth of a case: what is at work in it, and all that counts as right."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hybrid_id.machines.effects import Effect
from hybrid_id.machines.effects.base import UNKNOWN
from hybrid_id.machines.experiments import SAMPLE_TIME, noise_std
from hybrid_id.machines.grading import Graded, level_of
from hybrid_id.machines.messy import Messy
from hybrid_id.machines.rivals import Alone, Rival
from hybrid_id.machines.robots import Robot


def ground_truth(
    graded: Graded,
    family: str,
    source: tuple[int, int],
    *,
    rivals: Sequence[list[Rival]],
    alone: Mapping[str, Alone] | None,
) -> dict[str, Any]:
    """The ground truth of a case.

    Args:
        graded: the case with its records.
        family: single, pair, none, parameters or unknown.
        source: the seed that it was made from, and which of the machines that were drawn.
        rivals: for each effect others that were tried in its place, the best first; none where they were not tried.
        alone: what each effect of a pair leaves without the other; None where that was not tried.
    """
    floor = graded.records.noise_floor
    oracle = {
        "nominal": graded.errors.nominal,
        "refit": graded.errors.refit,
        "with_effect": floor if graded.case.effects else graded.errors.refit,
        "noise_floor": floor,
    }
    notes: dict[str, Any] = {"refit_over_floor_on_train_records": round(graded.errors.train, 2)}
    found: dict[str, Any] = {
        "family": family,
        "effects": [
            _answer(effect, rivals[i] if rivals else [], graded.case.robot)
            for i, effect in enumerate(graded.case.effects)
        ],
        "level": _level(graded, family, rivals),
        "oracle": {key: float(f"{value:.4g}") for key, value in oracle.items()},
        "made_by": {
            "engine": graded.case.engine,
            "system": graded.case.robot.system,
            "seed": source[0],
            "draw": source[1],
            "formulas": [type(effect).__name__ for effect in graded.case.effects],
        },
        "notes": notes,
    }
    if len(rivals) == 1 and rivals[0]:
        near = [rival for rival in rivals[0][:6] if np.isfinite(rival.rest)]
        rest = {f"{r.effect.name}@{r.effect.joint + 1}": round(r.rest, 3) for r in reversed(near)}
        notes["rest_of_gap_with_rival"] = dict(reversed(rest.items()))
    if alone:
        notes["with_only_over_both"] = {
            name: {"test": round(one.test, 2), "train": round(one.train, 2)} for name, one in alone.items()
        }
    return found


def messy_ground_truth(messy: Messy, family: str, source: tuple[int, int]) -> dict[str, Any]:
    """The ground truth of a messy machine: that of a clean one, its effects in the order in which they are added.

    Each effect has, too, its `role` (dominant or small), its `share` of the gap in that order and what it `closes`
    alone, both on the test and on the train records, and by how much a small one alone lifts the re-fit over the floor;
    `messy` sums them up.

    Args:
        messy: the machine.
        family: single, pair or unknown by its dominant effects; none or parameters where its structure is right.
        source: the seed that it was made from, and which of the machines that were drawn.
    """
    found = ground_truth(
        messy.graded, family, source, rivals=[list(part.rivals) for part in messy.parts], alone=None
    )
    found["level"] = messy.graded.level
    for effect, part in zip(found["effects"], messy.parts, strict=True):
        effect |= {"role": part.role, "share": round(part.share, 4), "closes": round(part.closes, 4)}
        effect |= {"closes_train": round(part.closes_train, 4), "share_train": round(part.share_train, 4)}
        if part.lift is not None:
            effect["lift"] = round(part.lift, 3)
    encoders = messy.graded.case.campaign.encoders
    flaws, noise = encoders.flaws, noise_std(encoders)
    found["notes"].pop("rest_of_gap_with_rival", None)
    found["notes"]["rest_with_rival"] = [
        {f"{r.effect.name}@{r.effect.where}": round(r.rest, 3) for r in part.rivals if np.isfinite(r.rest)}
        for part in messy.parts
        if part.role == "dominant"
    ]
    found["messy"] = {
        "small_share": round(sum(part.share for part in messy.parts if part.role == "small"), 4),
        "outside_share": round(sum(part.share for part in messy.parts if part.effect.name == UNKNOWN), 4),
        "dominant_outside": family == "unknown",
        "drift_of_friction": [float(f"{std:.3g}") for std in messy.drift.std(axis=1)],
        "harmless_parameters_not_in_model": list(messy.withheld),
    }
    if flaws is not None:
        found["messy"]["encoders"] = {
            "ripple_over_noise": [float(f"{v:.3g}") for v in flaws.ripple / noise],
            "late_seconds": [float(f"{v:.3g}") for v in flaws.late * SAMPLE_TIME],
            "samples_with_missed_counts": float(f"{np.mean(flaws.lost != 0):.3g}"),
        }
    return found


def _level(graded: Graded, family: str, rivals: Sequence[list[Rival]]) -> str:
    """Level of a case; outside the catalogue it is what the best of the named effects leaves that counts."""
    if family != "unknown":
        return graded.level
    return level_of(min([graded.ratio, *(rival.ratio for of_one in rivals for rival in of_one)]))


def _answer(effect: Effect, rivals: list[Rival], robot: Robot) -> dict[str, Any]:
    """One effect of the ground truth, with all that counts as right."""
    right = [effect, *(rival.effect for rival in rivals if rival.counts)]
    pairs = [(one.name, place) for one in right for place in _places(one, robot)]
    known = [(name, place) for name, place in pairs if name != UNKNOWN]
    return {
        "name": effect.name,
        "where": effect.where,
        "accept": list(dict.fromkeys(name for name, _ in known)),
        "accept_where": list(dict.fromkeys(place for _, place in pairs)),
        "right": list(dict.fromkeys(f"{name}@{place}" for name, place in known)),
        "size": effect.size(),
    }


def _places(effect: Effect, robot: Robot) -> list[str]:
    """Places of an effect that physics alone cannot tell apart."""
    if robot.system == "two_link" and effect.name in ("gravity_load", "joint_coupling"):
        return ["joint1/load", "joint2/load"]
    if effect.place == "motor_friction" and robot.system != "one_link_flexible":
        return [effect.where, effect.where.replace("motor_friction", "link_friction")]
    return [effect.where]
