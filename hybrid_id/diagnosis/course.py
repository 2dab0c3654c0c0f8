"""Where something unknown acts: at which joint and side a torque of any course in time explains most.

A torque of any course has no signal and needs no catalogue. One torque has to explain the outputs of all joints at
once, so that the right joint of an arm explains more than another; so does the right side of a compliant gear, by less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.diagnosis.explanation import Explanation
from hybrid_id.diagnosis.probe import probe
from hybrid_id.diagnosis.refit import Refit

KNOT = 0.05
"""Time [s] over which the torque is smooth."""
SURE = 3.0
"""Standard errors by which another place has to explain less."""


@dataclass(frozen=True)
class Course:
    """How much of what a model leaves a torque of any course could explain at one side of a joint.

    Attributes:
        joint: ``joint1`` ...
        place: ``motor`` or ``load``: the side of the gear; ``joint`` where both move alike, or one is not measured.
        share: part of the mean square within a short window, averaged over these, less what chance would explain.
        behind: by how many standard errors it leaves more than the best place does; 0 for that.
    """

    joint: str
    place: str
    share: float
    behind: float


def courses(refit: Refit, explanation: Explanation) -> list[Course]:
    """Every side of every joint, the best first.

    Args:
        refit: holds the train records.
        explanation: the fitted model.
    """
    batch, engine = refit.records(explanation.system), explanation.result.engine
    left: dict[tuple[str, str], np.ndarray] = {}
    for joint in explanation.system.joints:
        sides = {}
        for side in ("motor",) if joint.rigid else ("motor", "load"):
            rest, whole = probe(explanation.system, engine, batch, joint.number, side).unexplained(KNOT)
            # windows count alike: one in which a joint sticks otherwise than it was linearised would drown the rest
            sides["joint" if joint.rigid else side] = rest / np.maximum(whole, 1e-300)
        if not {f"q_m{joint.number}", f"q_a{joint.number}"} <= set(batch.outputs):
            sides = {"joint": min(sides.values(), key=np.mean)}  # one encoder tells no side
        left |= {(joint.name, side): rest for side, rest in sides.items()}
    least = min(left.values(), key=np.mean)
    found = [Course(*place, 1.0 - float(rest.mean()), _surplus(rest, least)) for place, rest in left.items()]
    return sorted(found, key=lambda one: -one.share)


def _surplus(rest: np.ndarray, least: np.ndarray) -> float:
    """By how many standard errors the mean of what is left in a window exceeds the least, relative to both."""
    surplus = (rest - least) / np.maximum(rest + least, 1e-300)
    spread = float(surplus.std()) / np.sqrt(len(surplus))
    return float(surplus.mean()) / spread if spread > 0 else 0.0


def acts_at(found: Sequence[Course]) -> tuple[str | None, str | None]:
    """Joint and side at which something acts, each None where another explains nearly as much."""
    if not found or found[0].share <= 0.0:
        return None, None
    best, others = found[0], found[1:]
    if any(one.joint != best.joint and one.behind < SURE for one in others):
        return None, None
    told = best.place != "joint" and all(one.behind >= SURE for one in others if one.joint == best.joint)
    return best.joint, best.place if told else None
