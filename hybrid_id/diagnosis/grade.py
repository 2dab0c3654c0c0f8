"""What each effect explains and how surely: shares, probabilities, ties, and what remains."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import expit

from hybrid_id.diagnosis.catalogue import effect
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import Fits
from hybrid_id.diagnosis.locate import Location
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.screen import SelectionStep, log_odds, log_odds_at, needed_fall
from hybrid_id.diagnosis.select import Selection, accepted_ones, chances, passes, refitted_without
from hybrid_id.diagnosis.validation import Validation, mean_square

Interval = tuple[float, float]
NEGLIGIBLE = 0.005
"""Share of a gap below which an effect explains next to nothing of it."""


@dataclass(frozen=True)
class RatedEffect:
    """One effect at one place.

    Attributes:
        name, where: which effect acts where.
        probability: that it is at work.
        selected: whether the diagnosis asserts it.
        tied_with: effects that it is indistinguishable from, ``name@where``.
        parameters: estimate and standard error of each parameter that it brings, by symbol; a fixed one that belongs
            to the answer has the error 0.
        share: of the gap that it explains where it is added after those before it; None of one that is not selected.
        share_interval: 95 % interval of that; every draw of records chooses again among the rivals of its step.
        alone: share of the gap that it explains when it stands alone beside the nominal model.
        sure: whether its share is above 0 in 97.5 % of draws of short blocks, which what helps by chance is not; of
            records, where what remains is structural; or joints of a robot together have shown it.
        others: probability that it is one of those it is indistinguishable from, by the step that has compared them.
    """

    name: str
    where: str
    probability: float
    selected: bool
    tied_with: tuple[str, ...]
    parameters: dict[str, tuple[float, float]]
    share: float | None = None
    share_interval: Interval | None = None
    alone: float | None = None
    sure: bool = True
    others: float = 0.0

    @property
    def together(self) -> float:
        """Probability that it or one that it is indistinguishable from is at work."""
        return min(self.probability + self.others, 1.0)

    @property
    def rank(self) -> tuple[float, ...]:
        """Sorts effects: selected ones by share, then by probability; equally probable ones by what each explains."""
        return -self.selected, -(self.share or 0.0), -self.probability, -(self.alone or 0.0)

    @property
    def negligible(self) -> bool:
        """Whether it explains next to nothing of the gap: it is fitted, and not said to be missing."""
        return self.share is not None and self.share < NEGLIGIBLE


@dataclass(frozen=True)
class Grade:
    """How the gap divides. Gap: mean square of the re-fitted model's errors on records left out, less the floor's.

    Attributes:
        effects: every effect that was tried, the selected ones by share, then the others by probability.
        remainder: structural share of the gap that stays unexplained.
        remainder_interval: 95 % interval, for the chosen model as it is: its draws know no rivals.
        unknown: whether what remains is at least a tenth of the gap and surely as much as all that is explained; at a
            joint of a robot, surely a tenth (:func:`of_robot`).
        coloured: whether what the chosen model leaves is structural for more than small random torques.
        gap: mean square of weighted errors, in noise variances.
        beyond_floor: the same as a share of what the re-fitted model leaves.

    The floor is ``(1 - structural) * error`` of the chosen model.
    """

    effects: tuple[RatedEffect, ...]
    remainder: float
    remainder_interval: Interval
    unknown: bool
    gap: float
    beyond_floor: float
    coloured: bool = True


def behind_play(model: FittedModel) -> bool:
    """Whether a model has play, behind which nobody has measured where the link is."""
    return any("backlash" in key for key in model.system.components)


def structural_share(
    model: FittedModel, left: Sequence[Location], within_records: float | None = None
) -> float:
    """Share of what a model leaves that a right model would not leave.

    All that has colour, also where each record has parameters of its own; where small random torques would leave less
    colour, what a torque as a function of some signal explains on records left out.

    Args:
        model: the model.
        left: torques that would explain what it leaves.
        within_records: the same share, of its own mean square, where each record has a parameter set of its own; None
            where these have not been fitted.
    """
    if mean_square(model.result.residual) < CRITERIA.negligible**2:
        return 0.0
    share = model.autocorrelation if within_records is None else min(model.autocorrelation, within_records)
    if share > CRITERIA.coloured or behind_play(model):
        return share
    return min(max(max((one.share for one in left), default=0.0), 0.0), share)


def grade(fits: Fits, found: Selection, structural: float, *, seed: int = 0) -> Grade:
    """Shares, probabilities and ties of all that a search has tried.

    Args:
        fits: fits the models between the nominal one and the chosen one, where the search has not.
        found: the search.
        structural: share of what the chosen model leaves that has a cause.
        seed: of the bootstrap.
    """
    # models from the re-fitted nominal one to the chosen one, an effect more each, and the step of each effect
    chosen, base = found.chosen, found.base
    order: dict[Name, SelectionStep] = {}
    for leading in found.steps:
        if (
            leading.leader is not None
            and (name := added_effect(leading.leader, leading.before)) in chosen.effects
        ):
            order.setdefault(name, leading)
    for name in chosen.effects:
        order.setdefault(name, SelectionStep(base, (chosen,)))
    models, names, end = [chosen], list(order), list[Name]()
    known = [e for s in found.steps for e in (s.before, *s.candidates) if e.judged]
    while len(names) > 1:
        rests = [tuple(sorted(set(names) - {name})) for name in names]
        simpler = [e for e in known if e.effects in rests]
        if not any(e.effects == rests[-1] for e in simpler):
            again = refitted_without(fits, base, models[0], names[-1])
            simpler += [] if again is None else [again]
        if not simpler:
            break
        models.insert(0, min(simpler, key=lambda e: e.error))
        end.insert(0, added_effect(models[1], models[0]))
        names.remove(end[0])
    steps = [order[name] for name in (*names, *end)]
    models = [base, *models] if chosen.effects else [base]
    first, last = models[0].validation, models[-1].validation
    floor = last.error * (1.0 - structural)
    # no share is more than all, nor where the model predicts worse than nothing
    gap = max(
        first.error - floor, last.error - floor, last.error - first.error, 1e-12 * max(first.error, 1e-300)
    )
    generator = np.random.default_rng(seed)

    def drawn(*, records: bool) -> np.ndarray:
        # draws of the shares (draws, n + 1), the remainder last: shares choose among rivals, too; it does not
        weights = first.drawn(generator, records=records)
        ends = [one.validation for one in models]
        rivals = []
        for before, after, step in zip(models[:-1], models[1:], steps, strict=False):
            # the step may have compared them beside other effects than the chosen ones: what counts is the
            # distance to its best
            shift = after.error / max(step.leader.error, 1e-300) if step.leader is not None else 1.0
            some = [(after.validation, 1.0), *((e.validation, shift) for e in _leaders(step, after)[1:])]
            rivals.append((before.validation, some))
        found = np.zeros((len(weights), len(models)))
        for draw, weight in zip(found, weights, strict=True):

            def over(one: Validation, weight: np.ndarray = weight) -> float:
                return float(weight @ one.blocks / (weight @ one.sizes))

            left, explained = structural * over(ends[-1]), over(ends[0]) - over(ends[-1])
            gap = max(left + explained, left, -explained, 1e-300)
            for k, (before, some) in enumerate(rivals):
                draw[k] = (over(before) - min(shift * over(one) for one, shift in some)) / gap
            draw[-1] = left / gap
        # of records that an effect serves worse than none: no share is more than all
        return np.clip(found, -1.0, 1.0)

    # what a model leaves differs more from record to record than within one: blocks would make shares too sure
    draws, coloured = drawn(records=True), structural > CRITERIA.coloured
    # where structure is left, the errors of one record go together, and what helps one of them alone is chance, too
    chance = np.quantile(draws if coloured else drawn(records=False), 0.025, axis=0)
    shares = {
        added_effect(b, a): ((a.error - b.error) / gap, _interval(draws[:, k]), bool(chance[k] > 0.0))
        for k, (a, b) in enumerate(pairwise(models))
    }
    shares |= {name: (*shares[name][:2], True) for name in found.shown if name in shares}
    measurable = gap > CRITERIA.least_fall * first.error  # shares of next to nothing say nothing
    alone: dict[Name, float] = {}
    for step in found.steps:
        if measurable and not step.before.effects:
            for e in step.candidates:
                alone.setdefault(added_effect(e, step.before), first.error * e.fall(step.before) / gap)
    rated = []
    for c in _rated_effects(found, structural):
        name = c.name, c.where
        share, interval, sure = shares.get(name, (None, None, True))
        rated.append(replace(c, share=share, share_interval=interval, alone=alone.get(name), sure=sure))
    remainder = structural * last.error / gap
    explained = sum(c.share or 0.0 for c in rated if c.selected)
    interval = _interval(draws[:, -1])
    # a remainder that other records could have made the smaller part says nothing of the catalogue
    surely = remainder >= CRITERIA.substantial and interval[0] >= explained
    beyond_floor = min(max(1.0 - floor / max(first.error, 1e-300), 0.0), 1.0)
    return Grade(_in_order(rated), remainder, interval, surely and coloured, gap, beyond_floor, coloured)


def doubtful(found: Grade) -> list[Name]:
    """Selected effects that may not be asserted: improbable, with all that they are tied with, or of no sure size."""
    return [
        (c.name, c.where)
        for c in found.effects
        if c.selected and (c.together < CRITERIA.least_probability or not c.sure)
    ]


def of_robot(found: Grade, refuted: Collection[Name], left: float) -> Grade:
    """The same at a joint of a robot that lacks something: such a robot lacks more than its records can show.

    What was tried and not selected has the base rate, which small effects have that records do not exclude. It has
    more as far as what remains at the joint is the robot's, and not the others' noise or other values in each record:
    the rest of it is no part of the gap, and intervals of shares reach from those with it to those without it, and to
    those without any of what remains where that may be next to nothing. No share is more than all.

    As far as something remains, what is selected may be the image of what the catalogue lacks, as a wave over the angle
    is of a latch: its probability is so much nearer to the least that is asserted. Where a substantial share surely
    remains, the catalogue lacks something.

    Args:
        found: of the joint by itself.
        refuted: effects that the robot has refuted.
        left: share of the structure in the joint's errors that each record's own values of the robot leave.
    """
    rate, gap = CRITERIA.base_rate, max(1.0 - (1.0 - left) * found.remainder, 1e-12)
    measurable = max(gap, CRITERIA.least_fall)  # shares of less than that say nothing
    remainder, surely, most = (left * r / gap for r in (found.remainder, *found.remainder_interval))
    lacks = found.coloured and left > CRITERIA.coloured and surely >= CRITERIA.substantial
    bare = gap if lacks else max(1.0 - found.remainder, 1e-12)
    # factors on the probabilities of selected effects and what they are tied with, name@where, by what remains
    doubt: dict[str, float] = {}
    for candidate in found.effects:
        if candidate.selected:
            reach = 1.0 - remainder * max(candidate.together - CRITERIA.least_probability, 0.0) / max(
                candidate.together, 1e-12
            )
            doubt |= dict.fromkeys((f"{candidate.name}@{candidate.where}", *candidate.tied_with), reach)

    def rated(c: RatedEffect) -> RatedEffect:
        known = (c.name, c.where) in refuted
        factor = doubt.get(f"{c.name}@{c.where}", 1.0)
        c = replace(c, probability=factor * c.probability, others=factor * c.others)
        if not c.selected:
            return c if known else replace(c, probability=rate + left * max(c.probability - rate, 0.0))
        low, high = c.share_interval or (0.0, 0.0)
        share, alone = (
            None if size is None else min(max(size / measurable, -1.0), 1.0) for size in (c.share, c.alone)
        )
        least, most = min(low, share or 0.0), max(high, c.share or 0.0, 0.0)
        return replace(
            c,
            share=share,
            alone=alone,
            share_interval=c.share_interval and (least, min(most / bare, max(most, share or 0.0, 1.0))),
        )

    return replace(
        found,
        effects=_in_order(map(rated, found.effects)),
        remainder=remainder,
        remainder_interval=(surely, min(most, max(found.remainder_interval[1], remainder))),
        unknown=lacks or (found.unknown and remainder >= CRITERIA.substantial),
        gap=gap * found.gap,
        beyond_floor=gap * found.beyond_floor,
    )


def _in_order(effects: Iterable[RatedEffect]) -> tuple[RatedEffect, ...]:
    return tuple(sorted(effects, key=lambda one: one.rank))


def _leaders(step: SelectionStep, after: FittedModel) -> list[FittedModel]:
    """Accepted candidates that other records could have put first: where structure is left, none of more parameters."""
    alike = accepted_ones(step)
    most = math.inf if after.no_structure or not alike else len(alike[0].result.names)
    return [e for e in alike if len(e.result.names) <= most]


def _interval(draws: np.ndarray) -> Interval:
    return float(np.quantile(draws, 0.025)), float(np.quantile(draws, 0.975))


def last_words(found: Selection) -> dict[Name, tuple[SelectionStep, FittedModel, dict[Name, float]]]:
    """By effect that was tried the step which says how probable it is, its model there, and how probable all are."""
    said: dict[Name, tuple[SelectionStep, FittedModel, dict[Name, float]]] = {}
    for step in found.compared:
        if step.leader is None:
            continue
        names = [added_effect(model, step.before) for model in step.candidates]
        # probability of each candidate: how surely the best predicts better, and how surely each explains anything
        best, logs = step.candidates[0], np.full(len(step.candidates), -np.inf)
        known = chances(step)
        present = {one: chance_of_presence(one, step.before, p) for one, p in known.items()}
        passing = [one for one, p in known.items() if passes(one, step.before, p)]
        sure = present.get(best, 0.0) if step.shown is None else step.shown.probability
        for k, one in enumerate(step.candidates):
            if step.odds:
                logs[k] = step.odds[k]
            elif one is best:
                logs[k] = 0.0
            elif one.judged and one.error < step.before.error and not _contains(one, step):
                explains = min(max(present[one], 1e-300) / max(sure, 1e-300), 1.0)
                logs[k] = log_odds(best, one, step.before) + math.log(explains)
                # what is not accepted, as one record alone gains by it, say, is no more probable than a best that is
                if best in passing and one not in passing:
                    logs[k] = min(logs[k], 0.0)
        sizes = np.exp(logs - logs.max())
        odds = dict(zip(names, (sure * sizes / sizes.sum()).tolist(), strict=True))
        for name, model in zip(names, step.candidates, strict=True):
            if name not in said or step.swap or odds[name] > said[name][2][name]:
                said[name] = step, model, odds
    return said


def _rated_effects(found: Selection, structural: float) -> list[RatedEffect]:
    """Every effect that was tried, with the probability of the step that decides on it (:func:`last_words`).

    Where something structural is left, none of the others is excluded by what is selected. What was accepted and is not
    sure enough to be asserted is no more probable than that asks.
    """
    chosen = set(found.chosen.effects)
    best: dict[Name, RatedEffect] = {}
    for name, (step, model, odds) in last_words(found).items():
        alike = (added_effect(e, step.before) for e in indistinguishable(model, step))
        ties = [rival for rival in alike if rival != name]
        sizes = dict(step.shown.sizes) if step.shown is not None and model is step.leader else {}
        best[name] = RatedEffect(
            name[0], name[1], odds[name], name in chosen, tuple("@".join(rival) for rival in ties),
            sizes or parameters_of(found.chosen if name in chosen else model, name),
            others=sum(odds[rival] for rival in ties),
        )  # fmt: skip
    # what the selected ones have made needless is no more probable than that these are wrong
    least = min((c.probability for c in best.values() if c.selected), default=0.0)
    untrue = best.keys() if found.own is not None else found.refuted
    best |= {
        name: replace(c, probability=CRITERIA.false_alarms * c.probability)
        for name, c in best.items()
        if name in untrue
    }
    if found.own is not None:
        return list(best.values())
    rated = [
        c if c.selected or not chosen else replace(c, probability=min(c.probability, 1.0 - least))
        for c in best.values()
    ]
    rivals = {rival for c in rated if c.selected for rival in c.tied_with}
    others = {
        name: structural * p
        for name, p in _beside(found).items()
        if "@".join(name) not in rivals and name not in found.refuted
    }
    rated = [
        c if c.selected else replace(c, probability=max(c.probability, others.get((c.name, c.where), 0.0)))
        for c in rated
    ]
    unsure = {"@".join(name) for name in found.unsure}
    for k, c in enumerate(rated):
        if not c.selected and unsure & {f"{c.name}@{c.where}", *c.tied_with}:
            # with all that it is tied with no more probable together than what is asserted has to be
            most = CRITERIA.least_probability
            probability = min(c.probability, most)
            rated[k] = replace(c, probability=probability, others=min(c.others, most - probability))
    return rated


def _beside(found: Selection) -> dict[Name, float]:
    """Probability of each effect that was tried beside the chosen model, where something structural is left.

    Of several that a machine lacks, the largest is found and the others stay too small to be accepted. The odds are
    those of the base rate, times the ratio of likelihoods of the fits; no more than what may be asserted.
    """
    falls = {added_effect(e, step.before): 1.0 for step in found.steps for e in step.candidates}
    for step in found.steps:
        if set(step.before.effects) == set(found.chosen.effects):
            falls |= {
                added_effect(e, step.before): min(e.trained / max(step.before.trained, 1e-300), 1.0)
                for e in step.candidates
            }
    rate, power = CRITERIA.base_rate, -0.5 * CRITERIA.left_worth
    odds = {name: rate / (1.0 - rate) * max(left, 1e-6) ** power for name, left in falls.items()}
    return {name: min(o / (1.0 + o), CRITERIA.least_probability) for name, o in odds.items()}


def chance_of_presence(one: FittedModel, before: FittedModel, p: float) -> float:
    """Probability that the effect of a finished candidate or one beside it is at work, and not none beyond ``before``.

    The p-value of the whole search as a bound of the Bayes factor against chance, ``-e p ln p`` at even odds
    (T. Sellke, M. J. Bayarri and J. O. Berger, The American Statistician 55, 2001), times how far the fall is
    what an effect needs.
    """
    fall = one.validation.fall(before.validation) / needed_fall(one, before)
    against = -np.e * p * np.log(p) if p < np.exp(-1.0) else 1.0
    return float(expit(CRITERIA.fall_slope * (fall - 1.0)) / (1.0 + against))


def _contains(model: FittedModel, step: SelectionStep) -> bool:
    """Whether an effect has a step's best as its special case: that it explains as much says nothing for it."""
    (name, where), best = (
        added_effect(model, step.before),
        step.leader and added_effect(step.leader, step.before),
    )
    return best is not None and best[1] == where and best[0] in effect(name).contains


def indistinguishable(model: FittedModel, step: SelectionStep) -> list[FittedModel]:
    """Candidates of a step whose errors are those of one of them, as far as its records say; itself among them.

    None for what does not explain what the best does. Where it leaves structure, the errors have reasons of their own:
    what does the greater part of what the best does counts, if it is not much less probable.
    """
    unlikely = log_odds_at(CRITERIA.distinct_z)
    if step.odds:
        own = step.odds[step.candidates.index(model)]
        return [e for e, odds in zip(step.candidates, step.odds, strict=True) if abs(odds - own) < -unlikely]
    least = min(e.error for e in step.candidates if e.judged or e is model)
    open_ = CRITERIA.left_open if model.no_structure else 1.0 - CRITERIA.major_share
    closed = least + open_ * max(step.before.error - least, 0.0)
    near = 1.0 / (1.0 - CRITERIA.distinct_fall) if model.no_structure else math.inf
    if not model.judged or model.error >= closed:
        return []
    return [
        e
        for e in step.candidates
        if e.judged
        and e.error < closed
        and not _contains(e, step)
        and max(e.error / model.error, model.error / e.error) < near
        and (
            model.ahead_of(e) < CRITERIA.distinct_z
            if model.no_structure
            else log_odds(model, e, step.before) > unlikely
        )
    ]


def tied_models(found: Selection) -> list[list[FittedModel]]:
    """For each selected effect that has rivals the models of the step which rates it, its own and those that tie."""
    words = last_words(found)
    groups = [
        indistinguishable(model, step) for n, (step, model, _) in words.items() if n in found.chosen.effects
    ]
    return [equals for equals in groups if len(equals) > 1]


def tied_steps(
    found: Selection, steps: Sequence[SelectionStep]
) -> list[tuple[SelectionStep, list[FittedModel]]]:
    """The same, each with the step that has compared them, of some steps.

    The whole robot's has the last word on its own.
    """
    known, ties = set[tuple[Name, ...]](), []
    for step in sorted(steps, key=lambda one: not one.odds):
        if step.leader is None or step.leader.effects != found.chosen.effects:
            continue
        equals = [
            e for e in indistinguishable(step.leader, step) if e is step.leader or e.effects not in known
        ]
        if step.odds:
            known |= {e.effects for e in step.candidates}
        if len(equals) > 1:
            ties.append((step, equals))
    return ties


def tied_sets(found: Sequence[RatedEffect]) -> list[tuple[str, ...]]:
    """Groups of effects that these records cannot distinguish, of the selected ones."""
    return [(f"{c.name}@{c.where}", *c.tied_with) for c in found if c.selected and c.tied_with]


def parameters_of(model: FittedModel, name: Name) -> dict[str, tuple[float, float]]:
    """Estimates and standard errors of what an effect brings; what it brings fixed has none."""
    result = model.result
    jacobian = np.concatenate([j.reshape(-1, j.shape[-1]) for j in result.jacobian])
    scale = max(result.noise_scale**2 * result.n_samples / max(model.validation.effective, 1.0), 1e-300)
    # priors, too, are scaled to what the model leaves
    information = (jacobian.T @ jacobian + np.diag(result.prior_precision)) / scale
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
    unseen = np.diag(information) == 0.0  # no measurement depends on it
    covariance[unseen, unseen] = np.inf
    keys = {f"{name[1]}/{kind}" for kind in effect(name[0]).kinds}
    found = {}
    for k, parameter in enumerate(result.names):
        info = result.system.parameter(parameter)
        if info.component in keys:
            found[info.symbol] = (float(result.values[k]), float(np.sqrt(max(covariance[k, k], 0.0))))
    for info in result.system.table:
        if info.component in keys and effect(name[0]).shape.get(info.symbol) in found:
            found[info.symbol] = (info.spec.value, 0.0)
    return found
