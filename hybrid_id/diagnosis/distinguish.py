"""Explanations that a joint's own records cannot distinguish, distinguished by the motion of all joints.

A joint by itself takes the others as they were measured. To it a wrong zero of its encoder and a torque at its load may
be one and the same: either shifts the angle that is measured. To its neighbours they are two things: with the torque
the link is where it was measured, with the wrong zero it is not, and its weight pulls elsewhere. So all joints are
simulated, once with each of the explanations, and without what little else the neighbours are said to lack.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace

from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer
from hybrid_id.diagnosis.fits import without_priors
from hybrid_id.diagnosis.grade import tied_steps
from hybrid_id.diagnosis.model import FittedModel, added_effect
from hybrid_id.diagnosis.screen import SelectionStep, log_odds_at
from hybrid_id.diagnosis.select import accepted_ones
from hybrid_id.diagnosis.validation import validation
from hybrid_id.diagnosis.whole_robot import (
    UNFITTED,
    What,
    WholeRobot,
    fitted,
    held,
    parts_of_gap,
    train_rows,
    what,
)
from hybrid_id.systems.chain import System


def distinguished(robot: WholeRobot) -> dict[str, Answer]:
    """The joints' answers, each with that of its indistinguishable explanations which all joints make most probable.

    Of one tie a joint, where it explains a substantial share of the robot's gap: a fit of a whole robot costs as much
    as a joint's search. Joints whose search has gone over short runs and then whole ones keep their ties.
    """
    answers = robot.answers
    found, ties = dict(answers), {name: tie for name, one in answers.items() if (tie := _tie(one))}
    if not ties or len(answers) < 2:
        return found
    each = {
        n: (one.fits.dataset, one.found.base.system, one.grade.beyond_floor) for n, one in answers.items()
    }
    parts, _ = parts_of_gap(each, robot.horizon)
    large = [name for name, (_, share, _) in ties.items() if parts[name] * share >= CRITERIA.substantial]
    for k, name in enumerate(sorted(large, key=lambda name: -parts[name])):
        robot.say("the whole robot", k, len(large) + 1)
        answer, (step, _, equals) = found[name], ties[name]
        chosen = _large_models(found, parts)
        alike = _held_alike(equals, robot.drives[name])
        compared = _compared(step, equals, [_fitted(robot, chosen | {name: one}) for one in alike])
        if compared is None:
            continue
        first, searched = compared.candidates[0], answer.searched
        now = searched.chosen if first.effects == searched.chosen.effects else first
        searched = replace(searched, chosen=now, steps=(*searched.steps, compared))
        again = robot.frozen(name, searched)
        if again.found.chosen.effects == first.effects:
            found[name] = again
    return found


def _tie(answer: Answer) -> tuple[SelectionStep, float, list[FittedModel]] | None:
    """The step that has left a joint's explanations open, the share of that which leads, and these; None without any.

    Of several the one about most of the gap. Of those that its records accept by themselves: another is none that
    could stand alone.
    """
    if answer.searched.near is not None:
        return None
    shares = {(c.name, c.where): c.share or 0.0 for c in answer.grade.effects}
    found = []
    for step, equals in tied_steps(answer.found, answer.searched.steps):
        lead, accepted = added_effect(equals[0], step.before), accepted_ones(step)
        able = [one for one in equals if one in accepted]
        if step.leader in able and len(able) > 1 and lead not in answer.found.shown:
            found.append((step, shares.get(lead, 0.0), able))
    # the last step about an effect has the last word
    return max(reversed(found), key=lambda one: one[1], default=None)


def _large_models(answers: Mapping[str, Answer], parts: Mapping[str, float]) -> dict[str, FittedModel]:
    """What stands for each joint beside another one's explanations: its model, or its re-fitted one.

    The latter where its effects explain no substantial share of the robot's gap, what acts on all joints wherever it is
    claimed: they may be the image of one of the explanations, as a tilted base is of a wrong zero before the joint, and
    speak for the others.

    Args:
        answers: of the joints.
        parts: share of each joint in the robot's gap.
    """
    shares, claimed = defaultdict[What, float](float), defaultdict[str, list[What]](list)
    for name, one in answers.items():
        for c in one.grade.effects:
            if c.selected:
                effect = what((c.name, c.where), one.found.chosen.system)
                claimed[name].append(effect)
                shares[effect] += parts[name] * (c.share or 0.0)
    large = {effect for effect, share in shares.items() if share >= CRITERIA.substantial}
    return {
        name: held(one.found.chosen if large.intersection(claimed[name]) else one.searched.base, one)
        for name, one in answers.items()
    }


def _held_alike(equals: Sequence[FittedModel], nominal: System) -> list[FittedModel]:
    """Explanations of a tie all held by the priors of the search, or all free where any of them is.

    A free drive takes much of what a wrong explanation leaves, and no held one may be compared with it.
    """
    free = [without_priors(one.system, nominal) for one in equals]
    if all(one.system.table != own.table for one, own in zip(equals, free, strict=True)):
        return list(equals)
    return [one.at(own) for one, own in zip(equals, free, strict=True)]


def _fitted(robot: WholeRobot, models: Mapping[str, FittedModel]) -> FittedModel | None:
    """The whole robot with these models of its joints, fitted to the train records; None where that fails.

    Held by the priors of the search, but for what it has freed of them: free, the drives take much of what a wrong
    explanation leaves.
    """
    try:
        system = robot.system(models, held=True)
        rows = train_rows(robot.records, system, robot.horizon)
        fit = fitted(system, rows, robot.kept)
    except UNFITTED:
        return None
    # windows of a record err for the same reasons: records are the witnesses
    seen = validation(fit.joined(fit.residual), rows.sample_time, list(dict.fromkeys(rows.names)))
    return FittedModel((), fit, seen, judged=False)


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
        if best.validation.fall(robot.validation) > CRITERIA.distinct_fall:
            further = max(further, 0)  # fewer parameters are no merit of what errs clearly more
        cost = 0.5 * further * math.log(max(best.validation.effective, 1.0))
        return (log_odds_at(max(best.ahead_of(robot), 0.0)) if robot is not best else 0.0) - cost

    known = sorted(((odds(robot), one) for one, robot in able), key=lambda one: -one[0])
    top = known[0][0]
    return SelectionStep(
        step.before, tuple(one for _, one in known), swap=True, odds=tuple(value - top for value, _ in known)
    )
