"""Explanations that a joint's own records cannot distinguish, told apart by the motion of all joints.

A joint by itself takes the others as they were measured. To it a wrong zero of its encoder and a torque at its load may
be one and the same: either shifts the angle that is measured. To its neighbours they are two things: with the torque
the link is where it was measured, with the wrong zero it is not, and its weight pulls elsewhere. So all joints are
simulated, once with each of the explanations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer, freeze
from hybrid_id.diagnosis.fits import FULL, engine
from hybrid_id.diagnosis.grade import tied_step
from hybrid_id.diagnosis.model import FittedModel
from hybrid_id.diagnosis.screen import SelectionStep, log_odds_at
from hybrid_id.diagnosis.validation import validation
from hybrid_id.diagnosis.whole_robot import WholeRobot, parts_of_gap
from hybrid_id.errors import InputError
from hybrid_id.identification.fit import kept_fit
from hybrid_id.identification.least_squares import Options
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System


def told_apart(
    dataset: Dataset,
    nominal: System,
    answers: Mapping[str, Answer],
    *,
    seed: int = 0,
    signal_share: float = SIGNAL_SHARE,
) -> dict[str, Answer]:
    """The joints' answers, each with that of its indistinguishable explanations which all joints make most probable.

    Of what explains a substantial share of the robot's gap: a fit of a whole robot costs as much as a joint's search.

    Args:
        dataset: of the whole robot.
        nominal: the nominal robot.
        answers: of the joints by themselves, by name.
        seed: of the resampling.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
    """
    found = dict(answers)
    open_ = {
        name: tied
        for name, one in answers.items()
        if (tied := tied_step(one.found, one.searched.steps))[0] is not None and one.searched.near is None
    }
    if not open_ or len(answers) < 2:
        return found
    robot = WholeRobot(dataset, nominal, answers, signal_share)
    each = {
        n: (one.fits.dataset, one.found.base.system, one.grade.beyond_floor) for n, one in answers.items()
    }
    parts, *_ = parts_of_gap(each, robot.horizon, signal_share)
    for name, (step, equals) in sorted(open_.items(), key=lambda one: -parts[one[0]]):
        answer = found[name]
        if step is None or parts[name] * answer.grade.explained < CRITERIA.substantial:
            continue
        chosen = {joint: one.searched.chosen for joint, one in found.items()}
        compared = _compared(step, equals, [_fitted(robot, chosen | {name: one}) for one in equals])
        if compared is None:
            continue
        first, before = compared.candidates[0], answer.searched
        chosen_now = before.chosen if first.effects == before.chosen.effects else first
        searched = replace(before, chosen=chosen_now, steps=(*before.steps, compared))
        again = freeze(answer.fits, searched, robot.drives[name], seed=seed)
        found[name] = replace(again, rejected=tuple(dict.fromkeys((*answer.rejected, *again.rejected))))
    return found


def _fitted(robot: WholeRobot, models: Mapping[str, FittedModel]) -> FittedModel | None:
    """The whole robot with these models of its joints, fitted to the train records; None where that fails.

    Held by the priors of the search: free, its drives take much of what a wrong explanation leaves.
    """
    try:
        system = robot.system(models, held=True)
        batch = batch_of(robot.records, system, robot.records.train, robot.signal_share, "cpu")
        batch = robot.horizon.cut(system, engine(), batch)
        options = Options(max_iterations=FULL)
        fit = kept_fit(robot.kept, system, batch, pooled=True, engine=engine(), options=options, warm=False)[
            0
        ]
    except (InputError, RuntimeError, np.linalg.LinAlgError):
        return None
    if not all(np.isfinite(piece).all() for piece in fit.residual):
        return None
    return FittedModel((), fit, validation(fit.residual, batch.sample_time, batch.names), judged=False)


def _compared(
    step: SelectionStep, equals: Sequence[FittedModel], robots: Sequence[FittedModel | None]
) -> SelectionStep | None:
    """The explanations in the order of their odds by the whole robot; None where fewer than two could be fitted."""
    able = [(one, robot) for one, robot in zip(equals, robots, strict=True) if robot is not None]
    if len(able) < 2:
        return None
    _, best = min(able, key=lambda one: one[1].error)

    def odds(robot: FittedModel) -> float:
        further = len(robot.result.names) - len(best.result.names)
        cost = 0.5 * further * math.log(max(best.validation.effective, 1.0))
        return (log_odds_at(max(best.ahead_of(robot), 0.0)) if robot is not best else 0.0) - cost

    known = sorted(((odds(robot), one) for one, robot in able), key=lambda one: -one[0])
    top = known[0][0]
    return SelectionStep(
        step.before, tuple(one for _, one in known), swap=True, odds=tuple(value - top for value, _ in known)
    )
