"""One selection step: every effect of the catalogue beside a model, first screened, the best then fitted to the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from scipy.stats import norm

from hybrid_id.diagnosis.catalogue import CATALOGUE, over_angle
from hybrid_id.diagnosis.criteria import CRITERIA
from hybrid_id.diagnosis.fits import COARSE, FINER, FULL, WINDOW, Fits, Task, without_priors
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.starts import from_nominal, special_cases, tasks
from hybrid_id.identification.horizons import Horizon
from hybrid_id.identification.windows import hidden_links
from hybrid_id.systems.chain import System

PROMISING, STARTS, FINALISTS = 12, 4, 4
"""Effects that are fitted finer, further initial values of the best of them, and effects that are fitted to the end."""
HOPELESS = 2.5
"""Mean square error beyond the best's from which a candidate is not fitted further."""
SAME = 2e-3
"""Costs that differ by less than this share are of one basin."""
SURE = 2.0
"""Factor on the standard errors that distinguish two candidates, where these are of the fits' own errors."""
FURTHER = 8e-3
"""Share of the mean square that a further fit along ripples has to gain, for another one to follow."""

Progress = Callable[[str, int, int], object]


@dataclass(frozen=True)
class Shown:
    """What joints of a robot together say of an effect that acts on all of them.

    Attributes:
        probability: that it is at work.
        sizes: estimate and standard error of each parameter that it brings, by symbol.
    """

    probability: float
    sizes: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class SelectionStep:
    """One selection step: what was there before, and every candidate that was added to it, best first.

    Attributes:
        before: the model that they are added to.
        candidates: with one more effect each.
        swap: whether an effect and its rivals are compared once more, beside those that were found after it.
        odds: logarithm of the odds of each candidate against the best, where other records than the models' own have
            compared them: those of a whole robot; empty elsewhere.
        shown: what joints of a robot together say of the first one's effect; None elsewhere.
    """

    before: FittedModel
    candidates: tuple[FittedModel, ...]
    swap: bool = False
    odds: tuple[float, ...] = ()
    shown: Shown | None = None

    @property
    def leader(self) -> FittedModel | None:
        """The first candidate: of those that predict about as well the simplest or most probable; None without any."""
        return self.candidates[0] if self.candidates else None


def selection_step(
    fits: Fits,
    before: FittedModel,
    nominal: System,
    *,
    among: frozenset[Name] | None = None,
    progress: Progress | None = None,
) -> SelectionStep:
    """Every effect of the catalogue, or some of them, added to a model, one at a time: stages screen and fit.

    Where the nominal model is held, the priors travel in its ``System`` to every candidate, and from there to the
    chosen model. What does better without them is fitted without; the answer has none (``diagnose._unheld``).

    Args:
        fits: fits models to the train records.
        before: the model that the effects are added to.
        nominal: the nominal system.
        among: the effects that are tried; None for all.
        progress: called with (stage, done, total).
    """
    near = tasks(fits, before, among)
    total, count = len(near) + PROMISING + STARTS + FINALISTS, [0]
    stage = f"effect {len(before.effects) + 1}"

    def tick() -> None:
        count[0] += 1
        if progress is not None:
            progress(stage, min(count[0], total), total)

    ranked = screen(fits, nominal, before, near, tick)
    # stage fit: the best candidates to the end, then judged by re-fits without the records that judge them
    # a first round for all finalists; each later one fits to the end who leads now, where that is another one
    for keep in (FINALISTS, 1, 1) if any(promising(one, before) for one in ranked) else (1,):
        chosen = best_of_each(ranked, key=effects_of)[:keep]
        ranked = _further(
            fits, nominal, before, [one for one in chosen if not one.judged], ranked, FULL, tick
        )
    if ranked and promising(ranked[0], before):
        # the leading effect from its other initial values, its special cases, and simpler candidates, all to the end
        if not ranked[0].white:
            own = [one for one in ranked if one.effects == ranked[0].effects and not one.judged]
            ranked = _further(fits, nominal, before, own[:FINALISTS], ranked, FULL, tick)
            # along the ripples of a torque over the angle each further fit comes a little further
            for _ in range(FINALISTS):
                if ranked[0].white or not over_angle(ranked[0].effects):
                    break
                again = fits.run([Task(ranked[0].effects, ranked[0].system, x0=ranked[0].result.x0)], FULL)[0]
                if again is None or again.trained > (1.0 - SAME) * ranked[0].trained:
                    break
                gained = 1.0 - again.trained / ranked[0].trained
                ranked = best_of_each([again, *ranked], 2)
                if gained < FURTHER:
                    break
        special = fits.run(special_cases(fits, before, ranked[0]), FULL)
        ranked = best_of_each([*ranked, *(e for e in special if e is not None)], 2)
        simpler = [
            e
            for e in ranked
            if not e.judged
            and e.trained < ranked[0].trained / (1.0 - CRITERIA.distinct_fall)
            and len(e.result.names) < len(ranked[0].result.names)
        ]
        ranked = _further(fits, nominal, before, simpler[:FINALISTS], ranked, FULL, tick)
    ends = best_of_each(ranked, key=effects_of, order=by_prediction)
    return SelectionStep(before, tuple(simplest_first(ends, before)))


def screen(
    fits: Fits, nominal: System, before: FittedModel, near: Sequence[Task], tick: Callable[[], object]
) -> list[FittedModel]:
    """Stage screen: all candidates fitted coarsely, and the promising ones finer; best first, none of them judged.

    Args:
        fits: fits models to the train records.
        nominal: the nominal system.
        before: the model that the effects are added to.
        near: fits of the candidates that begin at that model.
        tick: called after each fit.
    """
    coarse = best_of_each([one for one in fits.run(near, COARSE, tick) if one is not None], STARTS)
    ranked = _finer(fits, nominal, before, coarse, tick)
    ranked = [*_freed(fits, nominal, before, ranked[:1]), *ranked[1:]]
    if not (ranked and ranked[0].no_structure):
        far = from_nominal(fits, before, nominal, best_of_each(coarse, key=effects_of))
        # over whole records any wave takes some of what another one leaves, over short windows the right one most
        wave = fits.whole and ranked and over_angle((added_effect(ranked[0], before),))
        if wave and not hidden_links(ranked[0].system, fits.records(before.system)):
            far += [task for task in near if task.effects == ranked[0].effects]
        ranked = best_of_each([*ranked, *_from_afar(fits, nominal, before, ranked, far, tick)], 2)
    return ranked


def promising(one: FittedModel, before: FittedModel) -> bool:
    """Whether a candidate may yet be accepted, as far as it has been fitted: by half of the least fall."""
    least = needed_fall(one, before) if before.effects else CRITERIA.least_fall
    return one.fall(before) > 0.5 * least


def needed_fall(richer: FittedModel, simpler: FittedModel) -> float:
    """Relative fall of the mean square from which an effect is named."""
    if not simpler.effects:
        # what takes next to nothing, and leaves the colour of the rest as it was, has fitted the records' differences
        much_less = richer.autocorrelation <= CRITERIA.autocorrelation_left * simpler.autocorrelation
        return CRITERIA.least_fall if much_less else CRITERIA.completing_fall
    completes = richer.white or (richer.no_structure and not simpler.no_structure)
    return CRITERIA.completing_fall if completes else CRITERIA.next_fall


def _finer(
    fits: Fits,
    nominal: System,
    before: FittedModel,
    coarse: Sequence[FittedModel],
    tick: Callable[[], object],
) -> list[FittedModel]:
    """The most promising effects fitted finer, and some more initial values of the best; beside two effects fewer."""
    firsts = best_of_each(coarse, key=effects_of)
    many, starts = (FINALISTS, 0) if len(before.effects) > 1 else (PROMISING, STARTS)
    more = [one for one in coarse if one not in firsts][:starts]
    return _further(fits, nominal, before, firsts[:many] + more, firsts, FINER, tick)


def _from_afar(
    fits: Fits,
    nominal: System,
    before: FittedModel,
    ranked: Sequence[FittedModel],
    far: Sequence[Task],
    tick: Callable[[], object],
) -> list[FittedModel]:
    """Fits from values that are far: first over windows from measured states, over which any model is nearly linear.

    What closes the lesser part of what the best closes there, beside the model before, is not fitted to whole records.
    Where all leave structure with their parameters held, they are fitted without priors, too. Where the link is hidden
    behind play no window knows its state: where nothing else explains the records, coarse fits of whole ones instead,
    of which those are let go that stay far behind what has been found.
    """
    if not far:
        return []
    batch = fits.records(far[0].system)  # which links are measured is the same for every model
    hidden = [hidden_links(task.system, batch) for task in far]
    seen, behind = ([t for t, one in zip(far, hidden, strict=True) if one == side] for side in (False, True))

    def run(among: Fits, some: Sequence[Task], iterations: int) -> list[FittedModel]:
        return best_of_each([e for e in among.run(some, iterations, tick) if e is not None], STARTS)

    def again(some: Sequence[FittedModel]) -> list[Task]:
        return [Task(e.effects, e.system) for e in some]

    short = fits.over(Horizon("windows", WINDOW))

    def over_windows(some: Sequence[Task], most: int) -> list[FittedModel]:
        # from so far a few steps do not tell yet who ends where
        return run(short, again(run(short, some, COARSE)[:most]), FINER)

    ends = over_windows(seen, PROMISING)
    start = short.run([Task(before.effects, before.system)], FINER)[0] if ends else None
    part = 1.0 - CRITERIA.major_share
    half = math.inf if start is None else _open(ends[0].trained, start.trained, part)
    found = run(fits, again([e for e in ends if e is ends[0] or e.trained < half]), FINER)
    held = without_priors(before.system, nominal).table != before.system.table
    if held and not any(one.no_structure for one in found):
        # priors that hold a model which lacks something keep the right effect, too, from the values that it needs
        free = [Task(task.effects, without_priors(task.system, nominal)) for task in seen]
        enough = [one for one in over_windows(free, FINALISTS) if one.no_structure]
        found += [one for one in run(fits, again(enough), FINER) if one.no_structure]
    if not fits.whole or any(one.white for one in found):
        return found
    known = min((e.trained for e in (*ranked, *found)), default=math.inf)
    rivals = [e for e in run(fits, behind, COARSE) if e.trained < HOPELESS * known][:STARTS]
    return [*found, *run(fits, again(rivals), FINER)]


def _further(
    fits: Fits,
    nominal: System,
    before: FittedModel,
    some: Sequence[FittedModel],
    everyone: Sequence[FittedModel],
    iterations: int,
    tick: Callable[[], object],
) -> list[FittedModel]:
    """Some of the candidates fitted further, as far as they are not hopeless, among everyone again, best first.

    A few at a time, for what the first ones leave says which others are still rivals. To the end, what does
    better without its parameters held is fitted without (:func:`_held_or_not`).
    """
    left, done, ends = list(some), list[FittedModel](), list[FittedModel]()
    for count in (1, FINALISTS - 1, len(left)):
        if not left:
            break
        best = min((e for e in (*ends, *some, *everyone) if e not in done), key=lambda e: e.trained)
        leads, below = best.trained / (1.0 - CRITERIA.distinct_fall), _judged_below(ends, before)
        left = [e for e in left if e is best or _worth_it(e, best, before, iterations)]
        rivals, left = left[:count], left[count:]
        starts = [(e, e) for e in rivals]
        if iterations == FULL:
            starts = [(e, start) for e in rivals for start in _held_or_not(fits, nominal, e)]
        if ends and iterations == FULL and best.white:
            starts = [(e, start) for e, start in starts if start.trained < _no_rival(best, before)]
        more = fits.run(
            [
                Task(
                    e.effects,
                    start.system,
                    cost=e.result.cost,
                    x0=e.result.x0,
                    perturb=promising(e, before) and e.trained < leads,
                    judged_below=below,
                )
                for e, start in starts
            ],
            iterations,
            tick,
        )
        # what has been fitted further counts, be it better or worse; the rest stays as it was seen
        done += [e for e, _ in starts]
        ends += better_ways([e for e, _ in starts], more)
        if iterations == FINER and len(done) == 1:
            ends = _freed(fits, nominal, before, ends)
    return best_of_each([*ends, *(e for e in (*everyone, *some) if e not in done)], 2)


def _worth_it(one: FittedModel, best: FittedModel, before: FittedModel, iterations: int) -> bool:
    """Whether a candidate is worth another fit beside the best.

    It is where it may come down to it yet, by its errors; and as a rival of what may be accepted. No rival is what
    surely errs more by the errors of the fits themselves, where the best leaves no structure.
    """
    near = min(_open(best.trained, before.trained, 1.0 - CRITERIA.major_share), HOPELESS * best.trained)
    if iterations != FULL and one.trained < near:
        return True
    if not promising(best, before):
        return one.trained < near
    fitted = best.no_structure and not (best.judged or one.judged)  # errors of the same records
    sure = fitted and best.ahead_of(one) > SURE * CRITERIA.distinct_z
    return one.trained < (_closed(best, before) if sure else _no_rival(best, before))


def _closed(best: FittedModel, before: FittedModel) -> float:
    """Mean square of the errors from which a candidate leaves too much open of what the best closes."""
    share = CRITERIA.left_open if best.no_structure else 1.0 - CRITERIA.major_share
    return _open(best.trained, before.trained, share)


def _open(best: float, before: float, share: float) -> float:
    """Mean square of the errors of what leaves a share open of what the best closes."""
    return best + share * max(before - best, 0.0)


def _no_rival(best: FittedModel, before: FittedModel) -> float:
    """Mean square of the errors from which no candidate is a rival: it errs clearly more, or leaves too much open."""
    return max(best.trained / (1.0 - CRITERIA.distinct_fall) ** 2, _closed(best, before))


def _judged_below(ends: Sequence[FittedModel], before: FittedModel) -> float:
    """Mean square below which further candidates are judged, beside those that have been fitted to the end.

    Where the best leaves no structure, and records left out bear it out, one that errs clearly more is no rival.
    """
    best = min(ends, key=lambda e: e.trained, default=None)
    if best is None or not (best.judged and best.no_structure):
        return math.inf
    sure = best.fall(before) >= needed_fall(best, before) and best.error < _no_rival(best, before)
    return _no_rival(best, before) if sure else math.inf


def _freed(
    fits: Fits, nominal: System, before: FittedModel, leader: Sequence[FittedModel]
) -> list[FittedModel]:
    """A leading candidate, if any, fitted with its parameters held no longer where that leaves white noise.

    Then no other can do much better, and far fewer are worth a fit.
    """
    if not leader or leader[0].white or not promising(leader[0], before):
        return list(leader)
    free = _unheld(fits, nominal, leader[0])
    return list(leader) if free is None or not free.white else [free]


def _unheld(fits: Fits, nominal: System, one: FittedModel) -> FittedModel | None:
    """A candidate fitted with its parameters held no longer; None where none is."""
    start = without_priors(one.system, nominal)
    if start.table == one.system.table:
        return None
    return fits.run([Task(one.effects, start, x0=one.result.x0)], FINER)[0]


def _held_or_not(fits: Fits, nominal: System, one: FittedModel) -> list[FittedModel]:
    """A candidate where its last fits start: held, held no longer where it then leaves no structure, or both.

    Both where it errs clearly less when free: records left out decide (:func:`better_ways`), as they have of the
    nominal model's priors.
    """
    free = _unheld(fits, nominal, one)
    if free is not None and free.no_structure:
        return [free]
    less = free is not None and free.trained < (1.0 - CRITERIA.distinct_fall) * one.trained
    return [one, free] if free is not None and less else [one]


def better_ways(some: Sequence[FittedModel], ends: Sequence[FittedModel | None]) -> list[FittedModel]:
    """Of each candidate the end of its fits, a later one only where records left out are surely better for it."""
    found = dict[FittedModel, FittedModel]()
    for one, end in zip(some, ends, strict=True):
        if end is None:
            continue
        first = found.setdefault(one, end)
        if not end.judged:
            continue
        less = end.error < (1.0 - CRITERIA.distinct_fall) * first.error
        if not first.judged or (less and end.ahead_of(first) >= CRITERIA.distinct_z):
            found[one] = end
    return list(found.values())


effects_of = attrgetter("effects")
"""A candidate's effects, whatever their shape."""


def shape_of(one: FittedModel) -> tuple[object, ...]:
    """A candidate's effects with their fixed shape: waves of different periods are different models."""
    laws = [(CATALOGUE[name], where) for name, where in one.effects if name in CATALOGUE]
    fixed = {f"{where}/{kind}": law.shape for law, where in laws if law.shape for kind in law.kinds}
    shape = (i for i in one.system.table if i.symbol in fixed.get(i.component, ()) and not i.spec.estimate)
    return one.effects, tuple(i.spec.value for i in shape)


def by_prediction(one: FittedModel) -> tuple[bool, float]:
    """By the errors on records left out; what has not been fitted to the end comes after."""
    return not one.judged, one.error


def best_of_each(
    found: Sequence[FittedModel],
    each: int = 1,
    key: Callable[[FittedModel], object] = shape_of,
    order: Callable[[FittedModel], Any] = attrgetter("trained"),
) -> list[FittedModel]:
    """The best fits of each set of effects, best first; of those that have come to the same end only one, fitted to it.

    Args:
        found: fits.
        each: so many of each set.
        key: what counts as one set; by default every shape does.
        order: by which they are ranked; by default the errors of the fit itself, which all stages have.
    """
    ends: dict[object, list[int]] = {}
    best: list[FittedModel] = []
    for one in sorted(found, key=order):
        known = ends.setdefault(key(one), [])
        same = (k for k in known if abs(one.result.cost - best[k].result.cost) <= SAME * best[k].result.cost)
        twin = next(same, None)
        if twin is not None:
            best[twin] = one if one.judged and not best[twin].judged else best[twin]
        elif len(known) < each:
            known.append(len(best))
            best.append(one)
    return best


def log_odds(best: FittedModel, one: FittedModel, before: FittedModel) -> float:
    """Of a candidate against the leading one: that it predicts better, and half a logarithm of the sample a parameter.

    The second is what a needless parameter costs a marginal likelihood (G. Schwarz, Annals of Statistics 6, 1978).
    Only of what explains the greater part of what the best does: of the rest, parameters are not needless. Where the
    best leaves no structure, it leads by what is more than chance already. What errs more in all is no better for being
    so on most records.
    """
    surplus = best.ahead_of(one)
    if best.no_structure or one.error > best.error:
        surplus = max(surplus, 0.0)
    if best.no_structure:
        return log_odds_at(surplus)
    further = len(one.result.names) - len(best.result.names)
    cost = 0.5 * further * math.log(max(best.validation.effective, 1.0))
    return log_odds_at(surplus) - (cost if _does_much(best, one, before) else max(cost, 0.0))


def log_odds_at(surplus: float) -> float:
    """Logarithm of the odds that a difference which is seen so many standard errors above zero is below it."""
    return float(norm.logsf(surplus) - norm.logcdf(surplus))


def simplest_first(ranked: list[FittedModel], before: FittedModel) -> list[FittedModel]:
    """Of the finished candidates that predict as well as the best, the one with fewest parameters leads (parsimony).

    Where the best leaves structure, the most probable one does, which has fewer parameters or the best predictions.
    Where the records cannot tell on which side of a gear an effect acts, it is where it usually does.
    """
    if not ranked:
        return []
    best = next((e for e in ranked if e.judged), ranked[0])
    equals = [e for e in ranked if e.judged and _equals(best, e, before)]
    if best.no_structure:
        first = min(equals, key=lambda e: len(e.result.names), default=best)
    else:
        first = max(equals, key=lambda e: log_odds(best, e, before), default=best)
    twins = [
        e for e in equals if named_alike(e) == named_alike(first) and first.ahead_of(e) < CRITERIA.distinct_z
    ]
    first = min(twins, key=_unusual, default=first)
    return [first, *(e for e in ranked if e is not first)]


def _equals(best: FittedModel, one: FittedModel, before: FittedModel) -> bool:
    """Whether a candidate predicts as well as the best.

    Where the best leaves no structure, next to as well; where it leaves some, whatever these records do not surely tell
    from it, and what does the greater part of what it does: a flexible law takes some of what others leave.
    """
    if best.no_structure:
        closed = best.error + CRITERIA.left_open * max(before.error - best.error, 0.0)
        near = one.error < best.error / (1.0 - CRITERIA.least_fall)
        return near and (one.error <= closed or best.ahead_of(one) < CRITERIA.distinct_z)
    return _does_much(best, one, before) and best.ahead_of(one) < CRITERIA.distinct_z


def _does_much(best: FittedModel, one: FittedModel, before: FittedModel) -> bool:
    """Whether a candidate explains the greater part of what the best does."""
    return before.error - one.error >= CRITERIA.major_share * (before.error - best.error)


def named_alike(one: FittedModel) -> list[tuple[str, str]]:
    """A candidate's effects by name and joint, wherever in the joint they act."""
    return sorted((name, where.split("/")[0]) for name, where in one.effects)


def _unusual(one: FittedModel) -> int:
    """How far a candidate's places are from those where its effects usually act."""
    return sum(CATALOGUE[name].places.index(where.split("/")[1]) for name, where in one.effects)
