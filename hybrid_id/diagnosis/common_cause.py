"""Effects that act on all joints of a robot, judged by several of them together.

The floor under an arm presses on every joint that carries its tip. Each of these by itself may find it as likely as a
spring of its own, and assert neither. One floor for all joints takes two parameters, and has to be where all of them
say; springs take two at each. So the joints that find it likely are simulated together: without either, with the one
effect, and with the likeliest other of each.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scipy.special import expit

from hybrid_id.diagnosis.catalogue import brought
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer
from hybrid_id.diagnosis.fits import COARSE, FULL, Fits, Task
from hybrid_id.diagnosis.grade import chance_of_presence, last_words, parameters_of
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.screen import SelectionStep, Shown, log_odds
from hybrid_id.diagnosis.select import chance, passes
from hybrid_id.diagnosis.starts import swapped
from hybrid_id.diagnosis.whole_robot import (
    UNFITTED,
    What,
    WholeRobot,
    acts_on_all,
    fitted,
    held,
    less,
    what,
    without_effect,
)
from hybrid_id.parameters import Bounded

AS_LIKELY = 0.5
"""Probability of an effect, over that of the likeliest in its place, from which a joint finds it likely."""


@dataclass(frozen=True, eq=False)
class Witness:
    """What a joint that finds an effect of all joints likely says of it.

    Attributes:
        effect: its name, and the place at which the joint has it.
        before: the model that the joint's search has added it to.
        model: the joint with it.
        rival: the joint with what is likeliest in its place; None without any.
        asserted: whether the joint asserts it.
    """

    effect: Name
    before: FittedModel
    model: FittedModel
    rival: FittedModel | None
    asserted: bool


Judged = tuple[Shown, Mapping[str, Bounded], float]
"""What the witnesses together say of an effect that they find probable: how probable it is and its parameters, these
with their bounds by symbol, and the log-odds of what the witnesses have in its place otherwise."""


def judged_by_all(robot: WholeRobot) -> dict[str, Answer]:
    """The joints' answers, with what acts on all joints where several of them together make it probable.

    Asked is what two joints or more find likely and not all of these assert. The others move as they were measured.
    """
    found = dict(robot.answers)
    # the effects of all joints that are to be judged, each with its witnesses by joint; the most of them first
    kinds = defaultdict[What, dict[str, Witness]](dict)
    for joint, answer in robot.answers.items():
        asserted = {(one.name, one.where) for one in answer.grade.effects if one.selected}
        for kind, (last, model, odds) in last_words(answer.found).items():
            likely = odds[kind] >= max(AS_LIKELY * max(odds.values()), CRITERIA.base_rate)
            if acts_on_all(kind[0]) and model.judged and (likely or kind in asserted):
                others = [e for e in last.candidates if e.judged and e is not model]
                rival = max(others, key=lambda e: odds[added_effect(e, last.before)], default=None)
                heard = Witness(kind, last.before, model, rival, kind in asserted)
                kinds[what(kind, model.system)][joint] = heard
    asked = [
        (kind, each)
        for kind, each in kinds.items()
        if len(each) > 1 and not all(heard.asserted for heard in each.values())
    ]
    for effect, each in sorted(asked, key=lambda one: -len(one[1])):
        robot.say("what acts on all joints", 0, 1)
        some = replace(robot, answers={name: found[name] for name in each})
        try:
            rests = _without(some, effect, each)
            judged = None if rests is None else _judged(some, rests, each)
        except UNFITTED:
            continue
        if rests is None or judged is None:
            continue
        for name, witness in each.items():
            step = _step(found[name], rests[name], witness, judged)
            if step is not None:
                searched = found[name].searched
                searched = replace(searched, chosen=step.candidates[0], steps=(*searched.steps, step))
                found[name] = some.frozen(name, searched)
    return found


def _without(robot: WholeRobot, effect: What, each: Mapping[str, Witness]) -> dict[str, FittedModel] | None:
    """The witnesses' models without the effect, and without what they assert in its place; held as in their searches.

    None where one cannot be fitted. A fit of all of them together is not held (:func:`_task`).
    """
    models = {name: robot.answers[name].found.chosen for name in each}
    has = ((name, e) for name, one in models.items() for e in one.effects if what(e, one.system) == effect)
    known = next(has, None)
    rests = models if known is None else without_effect(robot, models, *known)
    if rests is None:
        return None
    for name, witness in each.items():
        image = witness.rival and added_effect(witness.rival, witness.before)
        if image in rests[name].effects and not witness.asserted:
            rest = less(robot.answers[name], rests[name], image)
            if rest is None:
                return None
            rests[name] = rest
    as_found = {name: robot.answers[name].found.chosen for name in each}
    return {
        name: held(one, robot.answers[name]) if one is as_found[name] else one for name, one in rests.items()
    }


def _judged(
    robot: WholeRobot, rests: Mapping[str, FittedModel], each: Mapping[str, Witness]
) -> Judged | None:
    """What the witnesses say together; None where the effect is not accepted, or no more probable than others."""
    jobs = next(iter(robot.answers.values())).fits.jobs
    fits = Fits(robot.records, jobs=jobs, kept=robot.kept)
    fits = fits.over(robot.horizon)
    plain = _to_the_end(fits, [_task(robot, rests)])
    own = _each_with(rests, each, {name: witness.model for name, witness in each.items()})
    if plain is None or not own:
        return None
    fits.weights = plain.validation.even_weights()
    plain = replace(plain, validation=plain.validation.weighted(fits.weights))
    first = next(iter(own))
    richer = _to_the_end(fits, _starts(robot, rests, each, own))
    others = _each_with(rests, each, {name: witness.rival for name, witness in each.items()})
    several = _to_the_end(fits, [_task(robot, {**rests, **others})]) if others else None
    if richer is None or (others and several is None):
        return None
    rivals = [] if several is None else [several]
    p = chance(richer, plain, rivals)
    odds = max((log_odds(richer, one, plain) for one in rivals), default=-math.inf)
    sure = chance_of_presence(richer, plain, p)
    if not passes(richer, plain, p) or sure * expit(-odds) < CRITERIA.least_probability:
        return None
    ends = parameters_of(richer, each[first].effect)
    specs = {s: i.spec for s, i in brought(richer.system, *each[first].effect).items() if s in ends}
    return Shown(sure, ends), specs, odds


def _starts(
    robot: WholeRobot,
    rests: Mapping[str, FittedModel],
    each: Mapping[str, Witness],
    own: Mapping[str, FittedModel],
) -> list[Task]:
    """Fits with the effect, of the size that each witness has found.

    It is listed at the first of them, so that there is one program.
    """
    sizes = {
        name: {symbol: info.spec for symbol, info in brought(one.system, *each[name].effect).items()}
        for name, one in own.items()
    }
    first = next(iter(own))
    task = _task(robot, {**rests, first: own[first]})
    infos = brought(task.system, *each[first].effect)
    specs = ({infos[symbol].name: spec for symbol, spec in size.items()} for size in sizes.values())
    return [replace(task, system=task.system.with_specs(one)) for one in specs]


def _each_with(
    rests: Mapping[str, FittedModel],
    each: Mapping[str, Witness],
    candidates: Mapping[str, FittedModel | None],
) -> dict[str, FittedModel]:
    """The witnesses' models with what a candidate of each has, where that can stand."""
    found = {name: _with(rests[name], each[name], one) for name, one in candidates.items()}
    return {name: one for name, one in found.items() if one is not None}


def _with(rest: FittedModel, witness: Witness, one: FittedModel | None) -> FittedModel | None:
    """A joint's model less the effect, with what a candidate has instead, not fitted; None where that cannot stand."""
    for task in swapped(rest.system, rest.effects, [one] if one else [], witness.before):
        return replace(rest.at(task.system), effects=task.effects)
    return None


def _task(robot: WholeRobot, models: Mapping[str, FittedModel]) -> Task:
    """A fit of the witnesses together that begins with these models of theirs, held by no priors of their searches.

    The priors have kept the drives where they make up for what is missing, and with it they are elsewhere. What free
    drives take instead of it counts against it.
    """
    effects = {effect for one in models.values() for effect in one.effects}
    return Task(tuple(sorted(effects)), robot.system(models))


def _to_the_end(fits: Fits, tasks: Sequence[Task]) -> FittedModel | None:
    """The best of some fits, to the end and judged by records left out; None where it cannot be fitted."""
    task = tasks[0]
    if len(tasks) > 1:
        ends = [end for end in fits.run(tasks, COARSE) if end is not None]
        if not ends:
            return None
        task = replace(task, system=min(ends, key=lambda end: end.result.cost).system)
    near = fitted(task.system, fits.batch(task.system), fits.kept)  # goes on while steps gain anything
    return fits.run([replace(task, system=near.system)], FULL)[0]


def _step(answer: Answer, rest: FittedModel, witness: Witness, judged: Judged) -> SelectionStep | None:
    """The selection step by which a joint has the effect, of the size that all have found; None where it cannot."""
    shown, specs, against = judged
    own, other = (_with(rest, witness, one) for one in (witness.model, witness.rival))
    if own is None:
        return None

    def sized(one: FittedModel) -> FittedModel:
        infos = brought(one.system, *witness.effect)
        fixed = {infos[s].name: replace(spec, estimate=False) for s, spec in specs.items()}
        return one.at(one.system.with_specs(fixed))

    before = _from_both(answer.fits, rest, witness.before)
    model = _from_both(answer.fits, sized(own), sized(witness.model))
    if before is None or model is None:
        return None
    rival = other and witness.rival and _from_both(answer.fits, other, witness.rival)
    rivals = [rival] if rival else []
    odds = (0.0, *(against for _ in rivals))
    return SelectionStep(before, (model, *rivals), swap=True, odds=odds, shown=shown)


def _from_both(fits: Fits, start: FittedModel, known: FittedModel) -> FittedModel | None:
    """The better end of fits from the model that all were judged with, and from where the joint's own search ended."""
    starts = [start, known] if known.effects == start.effects else [start]
    ends = fits.run([Task(one.effects, one.system) for one in starts], FULL)
    return min((end for end in ends if end is not None), key=lambda end: end.error, default=None)
