"""Motors that turn with the joint before theirs, too: the gears of a wrist, which a model takes for single ones.

What such a motor does is missing at both joints, and nothing at one of them explains it. So where a joint lacks
something outside the catalogue, it is fitted together with its neighbour, without and with a gear between them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid_id.components.base import Component, ServoLoop
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer
from hybrid_id.diagnosis.fits import FULL, Fits, Task
from hybrid_id.diagnosis.grade import chance_of_presence
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.select import chance, passes
from hybrid_id.diagnosis.thinning import thinned
from hybrid_id.diagnosis.whole_robot import WholeRobot
from hybrid_id.errors import InputError
from hybrid_id.robots.tree import RigidBodyTree
from hybrid_id.systems.by_joint import moving_records, some, with_others_measured
from hybrid_id.systems.chain import System

TURNS = (-3.0, -2.0, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 2.0, 3.0)
"""Turns of a motor behind its own gear for one of the other joint: they are sought between the neighbours of the best.

The ends are beyond any wrist."""
CLOSE = 0.02
"""To what they are sought, and the step by which their cost is differentiated."""
LOOKS = 8
"""Fits by which they are sought."""


@dataclass(frozen=True)
class CoupledGear:
    """A gear that a robot has and its model lacks, by which a motor turns with the joint before its own, too.

    Attributes:
        motor: name of the joint that the motor drives.
        joint: name of the joint before it.
        turns: of the motor behind its own gear for one turn of that joint: the entry of C, see
            :class:`~hybrid_id.robots.couplings.GearCoupling`.
        std: its standard error.
        share: of the mean square that the re-fitted model leaves of both joints on records left out.
        probability: that the gear is there.
    """

    motor: str
    joint: str
    turns: float
    std: float
    share: float
    probability: float


def with_gears(system: System, gears: Sequence[CoupledGear]) -> System:
    """A robot with gears that its model lacks.

    Raises:
        InputError: a part of a joint that no coupled gear can have.
    """
    tree = cast(RigidBodyTree, system.tree)
    known = [
        ([tree.names[joint] for joint in one.joints], [list(row) for row in one.matrix])
        for one in tree.couplings
    ]
    added = [([one.joint, one.motor], [[1.0, 0.0], [one.turns, 1.0]]) for one in gears]
    parts = [
        (key.rpartition("/")[0], copy.deepcopy(cast(Component, part)))
        for key, part in system.components.items()
    ]
    coupled = tree.coupled([*known, *added])
    return System(system.gear_ratio, parts, system.aliases, system.name, coupled)


def coupled_gears(robot: WholeRobot) -> tuple[CoupledGear, ...]:
    """The gears that the records show, the likeliest first; of a joint at most one."""
    found = list[CoupledGear]()
    pairs = _pairs(robot.nominal, robot.answers)
    for done, (joint, motor) in enumerate(pairs):
        robot.say("coupled gears", done, len(pairs))
        if (one := _gear(robot, joint, motor)) is not None:
            found.append(one)
    kept = list[CoupledGear]()
    for one in sorted(found, key=lambda one: -one.share):
        if not {one.motor, one.joint}.intersection(
            name for other in kept for name in (other.motor, other.joint)
        ):
            kept.append(one)
    return tuple(kept)


def _pairs(system: System, answers: Mapping[str, Answer]) -> list[tuple[int, int]]:
    """Neighbours of which one lacks something outside the catalogue, and whose motors no loop holds at their goals.

    A loop over the motor's own angle would lead the joint astray wherever its neighbour goes, which nobody overlooks.
    """
    tree, found = cast(RigidBodyTree, system.tree), []
    for motor, own in enumerate(tree.joints):
        joint = own.parent
        names = [tree.names[k] for k in (joint, motor)] if joint >= 0 else []
        if not names or any(name not in answers for name in names):
            continue
        held = any(isinstance(system.joints[k].drive.input[1], ServoLoop) for k in (joint, motor))
        if any(answers[name].grade.unknown for name in names) and not held:
            found.append((joint, motor))
    return found


def _gear(robot: WholeRobot, joint: int, motor: int) -> CoupledGear | None:
    """The gear by which one motor turns with the joint before it; None where the records do not show any."""
    tree, pair = cast(RigidBodyTree, robot.nominal.tree), (joint, motor)
    gear = CoupledGear(tree.names[motor], tree.names[joint], 0.0, math.inf, 0.0, 0.0)
    records = with_others_measured(moving_records(robot.dataset, *pair), robot.nominal, *pair)
    bare = some(robot.nominal, pair)
    fits = Fits(thinned(records, bare, robot.signal_share), signal_share=robot.signal_share, kept=robot.kept)
    fits = fits.over(robot.horizon)

    @cache
    def fitted(turns: float) -> FittedModel | None:
        try:
            one = some(with_gears(robot.nominal, [replace(gear, turns=turns)]), pair)
        except InputError:
            return None
        return fits.run([Task((), one)], FULL)[0]

    def cost(turns: float) -> float:
        end = fitted(turns)
        return math.inf if end is None else end.result.cost

    plain = fits.run([Task((), bare)], FULL)[0]
    if plain is None:
        return None
    costs = {turns: cost(turns) if turns else plain.result.cost for turns in TURNS[1:-1]}
    first = TURNS.index(min(costs, key=lambda turns: costs[turns]))
    if TURNS[first] == 0.0:
        return None
    ends = TURNS[first - 1], TURNS[first + 1]
    looks = {"maxiter": LOOKS, "xatol": CLOSE}
    near = cast(Any, minimize_scalar(cost, bounds=ends, method="bounded", options=looks))
    turns = min(TURNS[first], float(near.x), key=cost)
    below, here, above = cost(turns - CLOSE), cost(turns), cost(turns + CLOSE)
    bend = (above + below - 2.0 * here) / CLOSE**2
    if np.isfinite(bend) and bend > 0.0:  # to the least of the parabola through them
        turns -= float(np.clip(0.5 * (above - below) / CLOSE / bend, -CLOSE, CLOSE))
    richer = fitted(turns)
    return None if richer is None else _shown(replace(gear, turns=turns), plain, richer, bend)


def _shown(gear: CoupledGear, plain: FittedModel, richer: FittedModel, bend: float) -> CoupledGear | None:
    """A gear as records left out bear it out; None where they do not.

    Args:
        gear: with its turns.
        plain: both joints without it.
        richer: both with it.
        bend: second derivative of the cost by the turns.
    """
    weights = plain.validation.even_weights()
    plain, richer = (replace(one, validation=one.validation.weighted(weights)) for one in (plain, richer))
    p = chance(richer, plain)
    sure = chance_of_presence(richer, plain, p)
    if not passes(richer, plain, p) or sure < CRITERIA.least_probability:
        return None
    # as many of the errors as are independent tell of it
    worth = richer.trained * richer.result.n_samples / max(richer.validation.effective, 1.0)
    std = float(np.sqrt(worth / bend)) if np.isfinite(bend) and bend > 0.0 else math.inf
    return replace(gear, std=std, share=richer.validation.fall(plain.validation), probability=sure)
