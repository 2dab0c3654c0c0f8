"""Motors that turn with the joint before theirs, too: the gears of a wrist, which a model takes for single ones.

What such a motor does is missing at both joints, and nothing at one of them explains it. So where two neighbours lack
something, one of them something outside the catalogue, both are fitted together, without and with a gear between them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, cast

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid_id.components.base import Component, ServoLoop
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import FULL, Fits, Task
from hybrid_id.diagnosis.grade import chance_of_presence
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.select import chance, passes
from hybrid_id.diagnosis.thinning import thinned
from hybrid_id.diagnosis.whole_robot import WholeRobot
from hybrid_id.errors import InputError
from hybrid_id.robots.couplings import GearCoupling
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
    added = (
        GearCoupling(
            (tree.names.index(one.joint), tree.names.index(one.motor)), ((1.0, 0.0), (one.turns, 1.0))
        )
        for one in gears
    )
    parts = [
        (key.rpartition("/")[0], copy.deepcopy(cast(Component, part)))
        for key, part in system.components.items()
    ]
    coupled = replace(tree, couplings=(*tree.couplings, *added))
    return System(system.gear_ratio, parts, system.aliases, system.name, coupled)


def coupled_gears(robot: WholeRobot) -> tuple[CoupledGear, ...]:
    """The gears that the records show, the likeliest first; of a joint at most one."""
    found = list[CoupledGear]()
    # neighbours that both lack something, one of them outside the catalogue, angles logged, and driven by no loop
    tree, pairs = cast(RigidBodyTree, robot.nominal.tree), []
    logged = {channel.name for channel in robot.dataset.outputs}
    for driven, own in enumerate(tree.joints):
        pair = (own.parent, driven)
        names = [tree.names[k] for k in pair if k >= 0]
        lacking = [
            answer
            for name in names
            if (answer := robot.answers.get(name)) is not None
            and bool(answer.grade.unknown or answer.found.chosen.effects)
        ]
        able = len(lacking) == 2 and any(answer.grade.unknown for answer in lacking)
        able = able and logged.issuperset(f"q_a{k + 1}" for k in pair)
        if able and not any(isinstance(robot.nominal.joints[k].drive.input[1], ServoLoop) for k in pair):
            pairs.append(pair)
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


def _gear(robot: WholeRobot, joint: int, motor: int) -> CoupledGear | None:
    """The gear by which one motor turns with the joint before it; None where the records do not show any."""
    tree, pair = cast(RigidBodyTree, robot.nominal.tree), (joint, motor)
    gear = CoupledGear(tree.names[motor], tree.names[joint], 0.0, math.inf, 0.0, 0.0)
    records = with_others_measured(moving_records(robot.dataset, *pair), robot.nominal, *pair)
    bare = some(robot.nominal, pair)
    fits = Fits(thinned(records, bare), kept=robot.kept)
    fits = fits.over(robot.horizon)

    @cache
    def fitted(turns: float) -> FittedModel | None:
        try:
            one = some(with_gears(robot.nominal, [replace(gear, turns=turns)]), pair) if turns else bare
        except InputError:
            return None
        return fits.run([Task((), one)], FULL)[0]

    def cost(turns: float) -> float:
        end = fitted(turns)
        return math.inf if end is None else end.result.cost

    plain = fitted(0.0)
    first = min(TURNS[1:-1], key=cost)
    if plain is None or first == 0.0:
        return None
    at = TURNS.index(first)
    ends = TURNS[at - 1], TURNS[at + 1]
    looks = {"maxiter": LOOKS, "xatol": CLOSE}
    near = cast(Any, minimize_scalar(cost, bounds=ends, method="bounded", options=looks))
    turns = min(first, float(near.x), key=cost)
    below, here, above = cost(turns - CLOSE), cost(turns), cost(turns + CLOSE)
    bend = (above + below - 2.0 * here) / CLOSE**2
    if np.isfinite(bend) and bend > 0.0:  # to the least of the parabola through them
        turns -= float(np.clip(0.5 * (above - below) / CLOSE / bend, -CLOSE, CLOSE))
    richer, beside = fitted(turns), [fitted(turns - CLOSE), fitted(turns + CLOSE)]
    std = math.inf if richer is None else _error(richer, *beside)
    # a gear turns by the same in every record, what looks like one does not
    if richer is None or std > CRITERIA.max_relative_std * abs(turns):
        return None
    named = {name: robot.answers[name].found.chosen for name in (gear.joint, gear.motor)}
    if any(one.effects for one in named.values()):  # what is named without it has to err more
        both = replace(robot, answers={name: robot.answers[name] for name in named}).system(named)
        effects = tuple(sorted(effect for one in named.values() for effect in one.effects))
        instead = fits.run([Task(effects, both)], FULL)[0]
        if instead is not None and instead.error <= richer.error:
            return None
    rivals = [one for other in TURNS[1:-1] if other and (one := fitted(other)) is not None]
    # as records left out bear it out
    weights = plain.validation.even_weights()

    def weighted(one: FittedModel) -> FittedModel:
        return replace(one, validation=one.validation.weighted(weights))

    plain, richer = weighted(plain), weighted(richer)
    p = chance(richer, plain, [weighted(one) for one in rivals])
    sure = chance_of_presence(richer, plain, p)
    if not passes(richer, plain, p) or sure < CRITERIA.least_probability:
        return None
    share = richer.validation.fall(plain.validation)
    return replace(gear, turns=turns, std=std, share=share, probability=sure)


def _error(richer: FittedModel, below: FittedModel | None, above: FittedModel | None) -> float:
    """Standard error of the turns, all other parameters fitted; no less than a quarter of what they are sought to.

    The larger of two: as many of the errors as are independent tell of the turns; and the records do, for the errors of
    one go together: by them the products of the errors and of what the turns change there scatter.
    """
    if below is None or above is None:
        return math.inf
    slopes = [
        (b - a) / (2.0 * CLOSE) for a, b in zip(below.result.residual, above.result.residual, strict=True)
    ]
    information = sum(float(np.square(s).sum()) for s in slopes)
    gradient = dict.fromkeys(richer.result.records, 0.0)
    for name, slope, left in zip(richer.result.records, slopes, richer.result.residual, strict=True):
        gradient[name] += float((slope * left).sum())
    if len(gradient) < 2 or information == 0.0:
        return math.inf
    worth = richer.trained * richer.result.n_samples / max(richer.validation.effective, 1.0)
    scatter = len(gradient) * float(np.var(list(gradient.values()), ddof=1))
    return max((worth / information) ** 0.5, scatter**0.5 / information, 0.25 * CLOSE)
