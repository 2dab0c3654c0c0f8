"""Effects that act on all joints of a robot, judged by all joints together.

The floor under an arm presses on every joint that carries its tip. Each of these by itself may find it as likely as a
spring of its own, and assert neither. One floor for all joints takes two parameters, and has to be where all of them
say; springs take two at each. So all joints are simulated: without either, with the one effect, and with the likeliest
other of each joint that finds it likely.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scipy.special import expit

from hybrid_id.diagnosis.catalogue import brought
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.diagnose import Answer, frozen_again
from hybrid_id.diagnosis.fits import COARSE, FULL, Fits, Task
from hybrid_id.diagnosis.grade import chance_of_presence, last_words, parameters_of
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.screen import Progress, SelectionStep, log_odds
from hybrid_id.diagnosis.select import chance, passes
from hybrid_id.diagnosis.starts import swapped
from hybrid_id.diagnosis.whole_robot import (
    UNFITTED,
    WholeRobot,
    acts_on_all,
    fitted,
    held,
    train_rows,
    what,
    without_effect,
)
from hybrid_id.identification.horizons import Horizon
from hybrid_id.parameters import Bounded
from hybrid_id.records.dataset import Dataset
from hybrid_id.simulation.prepare import SIGNAL_SHARE
from hybrid_id.systems.chain import System

AS_LIKELY = 0.5
"""Probability of an effect, over that of the likeliest, from which a joint counts among those that find it likely."""


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


def judged_by_all(
    dataset: Dataset,
    nominal: System,
    answers: Mapping[str, Answer],
    *,
    horizon: Horizon,
    seed: int = 0,
    signal_share: float = SIGNAL_SHARE,
    progress: Progress | None = None,
) -> dict[str, Answer]:
    """The joints' answers, with what acts on all joints where all of them together make it probable.

    Asked is what two joints or more find likely and not all of them assert.

    Args:
        dataset: of the whole robot.
        nominal: the nominal robot.
        answers: of the joints by themselves, by name.
        horizon: how long free runs are.
        seed: of the resampling.
        signal_share: see :func:`hybrid_id.simulation.prepare.make_batch`.
        progress: called with (stage, done, total).
    """
    found = dict(answers)
    for each in _witnesses(answers):
        if progress is not None:
            progress("what acts on all joints", 0, 1)
        robot = WholeRobot(dataset, nominal, found, signal_share, horizon)
        rests = _without(robot, each)
        judged = None if rests is None else _judged(robot, rests, each)
        if rests is None or judged is None:
            continue
        sizes, sure, odds = judged
        for name, witness in each.items():
            step = _step(found[name], rests[name], witness, sizes, sure, odds)
            if step is None or step.leader is None:
                continue
            searched = found[name].searched
            searched = replace(searched, chosen=step.leader, steps=(*searched.steps, step))
            found[name] = frozen_again(found[name], searched, robot.drives[name], seed=seed)
    return found


def _witnesses(answers: Mapping[str, Answer]) -> list[dict[str, Witness]]:
    """For each effect of all joints that is to be judged its witnesses by joint, the most of them first."""
    found = defaultdict[tuple[str, str], dict[str, Witness]](dict)
    for name, answer in answers.items():
        words = last_words(answer.found)
        rated = {(c.name, c.where): c for c in answer.grade.effects}
        most = max((c.probability for c in rated.values()), default=0.0)
        for effect, (step, model, odds) in words.items():
            if not acts_on_all(effect[0]) or not model.judged:
                continue
            if rated[effect].probability < max(AS_LIKELY * most, CRITERIA.base_rate):
                continue
            others = [e for e in step.candidates if e.judged and e is not model]
            rival = max(others, key=lambda one: odds[added_effect(one, step.before)], default=None)
            witness = Witness(effect, step.before, model, rival, rated[effect].selected)
            found[what(effect, model.system)][name] = witness
    asked = [
        each
        for each in found.values()
        if len(each) > 1 and not all(witness.asserted for witness in each.values())
    ]
    return sorted(asked, key=len, reverse=True)


def _without(robot: WholeRobot, each: Mapping[str, Witness]) -> dict[str, FittedModel] | None:
    """The joints' models without the effect, held as in their searches; None where one cannot be fitted."""
    models = {name: one.found.chosen for name, one in robot.answers.items()}
    by = next((name for name, witness in each.items() if witness.effect in models[name].effects), None)
    rests = models if by is None else without_effect(robot, models, by, each[by].effect)
    return rests and {name: held(one, robot.answers[name].searched.base) for name, one in rests.items()}


def _judged(
    robot: WholeRobot, rests: Mapping[str, FittedModel], each: Mapping[str, Witness]
) -> tuple[dict[str, tuple[float, float]], float, float] | None:
    """The effect's parameters with their errors, how probable it is, and its rivals' log-odds; None if not accepted."""
    fits = Fits(robot.records, signal_share=robot.signal_share, kept=robot.kept).over(robot.horizon)
    known = tuple(sorted({effect for joint in each for effect in rests[joint].effects}))
    plain = _to_the_end(fits, robot, [known], [rests])
    if plain is None:
        return None
    fits.weights = plain.validation.even_weights()
    plain = replace(plain, validation=plain.validation.weighted(fits.weights))
    own = {name: one for name, witness in each.items() if (one := _with(rests[name], witness, witness.model))}
    others = {
        name: one
        for name, witness in each.items()
        if witness.rival and (one := _with(rests[name], witness, witness.rival))
    }
    effects = [(*known, each[name].effect) for name in own]
    richer = _to_the_end(fits, robot, effects, [{**rests, name: one} for name, one in own.items()])
    if richer is None:
        return None
    names = tuple(sorted({*known, *(effect for one in others.values() for effect in one.effects)}))
    several = _to_the_end(fits, robot, [names], [{**rests, **others}]) if others else None
    rivals = [] if several is None else [several]
    p = chance(richer, plain, rivals)
    sure = chance_of_presence(richer, plain, p)
    odds = max((log_odds(richer, one, plain) for one in rivals), default=-math.inf)
    if not passes(richer, plain, p) or sure * expit(-odds) < CRITERIA.least_probability:
        return None
    sizes = (parameters_of(richer, witness.effect) for witness in each.values())
    return next(filter(None, sizes), {}), sure, odds


def _with(rest: FittedModel, witness: Witness, one: FittedModel) -> FittedModel | None:
    """A joint's model less the effect, with what a candidate has instead, not fitted; None where that cannot stand."""
    for task in swapped(rest.system, rest.effects, [one], witness.before):
        return replace(rest, effects=task.effects, result=replace(rest.result, system=task.system))
    return None


def _to_the_end(
    fits: Fits,
    robot: WholeRobot,
    effects: Sequence[tuple[Name, ...]],
    starts: Sequence[Mapping[str, FittedModel]],
) -> FittedModel | None:
    """The robot fitted to the end from the best of its starts, judged by records left out; None where it cannot be."""
    tasks = [
        Task(tuple(sorted(names)), robot.system(models, held=True))
        for names, models in zip(effects, starts, strict=True)
    ]
    if len(tasks) > 1:
        ends = [end for end in fits.run(tasks, COARSE) if end is not None]
        tasks = [Task(end.effects, end.system) for end in sorted(ends, key=lambda end: end.result.cost)[:1]]
    try:
        for task in tasks:
            rows = train_rows(robot.records, task.system, robot.horizon, robot.signal_share)
            near = fitted(task.system, rows, robot.kept)
            return fits.run([replace(task, system=near.system)], FULL)[0]
    except UNFITTED:
        pass
    return None


def _step(
    answer: Answer,
    rest: FittedModel,
    witness: Witness,
    sizes: Mapping[str, tuple[float, float]],
    sure: float,
    odds: float,
) -> SelectionStep | None:
    """The selection step by which a joint has the effect, of the size that all joints give it; None where it cannot."""
    own, other = (one and _with(rest, witness, one) for one in (witness.model, witness.rival))
    if own is None:
        return None
    infos = brought(own.system, *witness.effect)
    specs = {
        infos[symbol].name: _known(infos[symbol].spec, *size)
        for symbol, size in sizes.items()
        if symbol in infos and size[1] > 0.0
    }
    tasks = [Task(own.effects, own.system.with_specs(specs))]
    tasks += [Task(other.effects, other.system)] if other else []
    model, *rivals = answer.fits.run(tasks, FULL)
    if model is None:
        return None
    rivals = [one for one in rivals if one is not None]
    return SelectionStep(rest, (model, *rivals), swap=True, odds=(0.0, *(odds for _ in rivals)), shown=sure)


def _known(spec: Bounded, value: float, std: float) -> Bounded:
    """A parameter as all joints have found it, with its standard error."""
    inside = min(max(value, spec.lower), spec.upper)
    return replace(spec.at(inside), prior_mean=inside, prior_std=std)
