"""Which effects: the catalogue is searched by fits, richest first look at all, then the best to the end.

Forward selection with backward deletion: the effect that predicts records left out best is added; then the next beside
it; then those that had explained as much as the first are tried in its place, and each of the chosen has to show that
the rest cannot do without it. Before an effect is believed, the model without it is fitted again from where the model
with it has ended.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from hybrid_id.diagnosis.belief import COMPLETE_RATIO, LEAST_Z, better
from hybrid_id.diagnosis.catalogue import CATALOGUE
from hybrid_id.diagnosis.evidence import coloured, negligible
from hybrid_id.diagnosis.exchange import exchanges, refitted_without
from hybrid_id.diagnosis.explanation import Explanation, Name, new_effect
from hybrid_id.diagnosis.ranking import LEAST_RATIO
from hybrid_id.diagnosis.refit import TO_THE_END, WINDOW, Refit, Task
from hybrid_id.diagnosis.round import FINALISTS, IDLE, Progress, Round, finished, one_round
from hybrid_id.diagnosis.scan import Left
from hybrid_id.systems.chain import System

MOST = 3
"""Effects at once."""
MOST_ROUNDS = 6
"""Rounds of a search, in which effects that have made others needless may take their place."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Result of the search.

    Attributes:
        base: today's model, re-fitted.
        rounds: the steps; the first tells the effects one by one.
        chosen: the set that the search stands by; ``base`` where no effect has earned its place.
        window: length [s] of the windows over which the rounds' models have been compared; None for whole records.
        full: whether the search ended with as many effects as it may have, and something left.
    """

    base: Explanation
    rounds: tuple[Round, ...]
    chosen: Explanation
    window: float | None = None
    full: bool = False


def attribute(
    refit: Refit, system: System, *, most: int = MOST, progress: Progress | None = None
) -> Attribution:
    """Search the catalogue for the effects that the records call for.

    Where even the best model's free runs lose the records, the search is held again over windows from measured states,
    and the set that it ends with is fitted to whole records.

    Args:
        refit: fits models to the train records.
        system: today's model.
        most: effects at most.
        progress: called with (stage, done, total).
    """
    found = _search(refit, system, most, progress)
    best = min(
        (e for r in found.rounds for e in r.candidates), key=lambda e: e.evidence.error, default=found.base
    )
    if not refit.strays(min(best, found.chosen, key=lambda e: e.evidence.error)):
        return found
    fitted, shorter = found.base.system, refit.within(WINDOW)
    if shorter.batch(fitted).rows == refit.records(fitted).rows:  # too short for windows
        return found
    within = _search(shorter, system, most, progress)
    tasks = [Task(within.chosen.effects, within.chosen.system)] if within.chosen.effects else []
    ends = [e for e in refit.run(tasks, TO_THE_END) if e is not None]
    return Attribution(found.base, within.rounds, ends[0] if ends else found.base, WINDOW, within.full)


def search_on(
    refit: Refit, system: System, found: Attribution, *, most: int = MOST, progress: Progress | None = None
) -> Attribution | None:
    """The search held again without the effects that it stands by; None where no other has been looked at.

    For test records that refuse these: the train records may have liked them best by chance, and others nearly as much.
    """
    refused, first = found.chosen.effects, found.rounds[0]
    others = [e for e in first.candidates if not set(e.effects) & set(refused)]
    if not others:
        return None
    ends = finished(refit, others[:FINALISTS])
    ends.sort(key=lambda e: e.evidence.error)
    again = Round(first.before, (*ends, *others[FINALISTS:]))
    return _search(refit, system, most, progress, again, refused)


def _search(
    refit: Refit,
    system: System,
    most: int,
    progress: Progress | None,
    first: Round | None = None,
    refused: Collection[Name] = (),
) -> Attribution:
    """Forward selection with backward deletion, from a first round on, without refused effects."""
    base = refit.base(system) if first is None else first.before
    chosen, rounds, restarted = base, [], False
    while (
        len(chosen.effects) < most
        and sum(not one.again for one in rounds) < MOST_ROUNDS
        and _leaves_something(chosen)
    ):
        stage, alive = f"effect {len(chosen.effects) + 1}", _alive(rounds, chosen)
        found = first or one_round(refit, chosen, system, stage, alive, refused, progress)
        first = None
        rounds.append(found)
        best, again = found.best, []
        if best is not None and chosen.effects and _gains(best, chosen):
            # beside the new one a rival of an earlier effect may do what that one does not
            again = exchanges(refit, base, best, rounds)
            best = min(
                (e.best for e in again if e.best is not None), key=lambda e: e.evidence.error, default=best
            )
        if best is None or negligible(chosen.result.residual) or not better(best, chosen):
            if chosen.effects and found.best is not None and _sure(found.best, chosen):
                # what is too small to be believed may still have led the fit before out of the ripples of its cost
                chosen = _second_chance(refit, base, chosen, found.best)
            break
        before = chosen
        if set(chosen.effects) < set(best.effects):
            before = _second_chance(refit, base, chosen, best)
        base = base if before.effects else before
        rounds[-1] = replace(rounds[-1], before=before)
        if not better(best, before):
            once_more, chosen = before is not chosen and not restarted, before
            if not once_more:
                break
            # the fit before had not found its best: the round is held again from there
            restarted = True
            rounds.pop()
            continue
        rounds += again
        chosen = _freed(refit, best)
        if before.effects:
            chosen = _challenge(refit, base, chosen, rounds)
            # one that has made the others needless is searched on from, where it does better than they did
            if len(chosen.effects) <= len(before.effects) and not _in_their_place(chosen, before):
                break
    full = len(chosen.effects) >= most and _leaves_something(chosen)
    return Attribution(base if chosen.effects else chosen, tuple(rounds), chosen, full=full)


def sure_though_small(found: Attribution) -> Attribution | None:
    """The search with the effect that it would add next, where its gain is sure but too small to be believed alone.

    The train records may be slow where others are fast. None where no such effect is there, and over windows, in which
    errors are no errors of whole records.
    """
    last = found.rounds[-1] if found.rounds and found.window is None else None
    if last is None or last.best is None or last.before.effects != found.chosen.effects:
        return None
    small = _sure(last.best, found.chosen) and not better(last.best, found.chosen)
    return replace(found, chosen=last.best) if small else None


def _sure(richer: Explanation, simpler: Explanation) -> bool:
    """Whether a model predicts surely better, by however little."""
    return richer.evidence.z(simpler.evidence) >= LEAST_Z


def _freed(refit: Refit, chosen: Explanation) -> Explanation:
    """The model with what an effect's law leaves open freed too, where that predicts clearly better.

    Before another effect may explain what the first one's simplest form has left.
    """
    laws = [(CATALOGUE[name], where) for name, where in chosen.effects if CATALOGUE[name].further is not None]
    if not laws:
        return chosen
    left = Left(chosen.result, refit.records(chosen.system))
    starts = [start for law, where in laws for start in law.freer(chosen.system, where, left)]
    for one in refit.run([Task(chosen.effects, start) for start in starts], TO_THE_END):
        if one is not None and _sure(one, chosen) and one.evidence.gain(chosen.evidence) >= LEAST_RATIO:
            chosen = one
    return chosen


def _in_their_place(chosen: Explanation, before: Explanation) -> bool:
    """Whether other effects than before predict better than those did."""
    better_off = chosen.evidence.error < before.evidence.error
    return better_off and bool(chosen.effects) and chosen.effects != before.effects


def _leaves_something(simpler: Explanation) -> bool:
    """Whether another effect could be believed at all beside the first: none explains white noise."""
    return not simpler.effects or coloured(simpler.result.residual) >= 1.0 - COMPLETE_RATIO**-2


def _gains(richer: Explanation, simpler: Explanation) -> bool:
    """Whether a model predicts so much better that it might be believed, were it the right one."""
    return richer.evidence.gain(simpler.evidence) > COMPLETE_RATIO


def _alive(rounds: Sequence[Round], chosen: Explanation) -> frozenset[Name] | None:
    """Effects that are worth a look beside two others: those that have brought anything beside one of them.

    None for all of the catalogue.
    """
    last = next((one for one in reversed(rounds) if one.before.effects and not one.again), None)
    if last is None or len(chosen.effects) <= len(last.before.effects):
        return None
    alive = (e for e in last.candidates if e.result.cost < IDLE * last.before.result.cost)
    return frozenset(new_effect(e, last.before) for e in alive)


def _second_chance(refit: Refit, base: Explanation, simpler: Explanation, richer: Explanation) -> Explanation:
    """The simpler model fitted again from where the richer one ended: the new effect may only have freed its fit."""
    again = refitted_without(refit, base, richer, new_effect(richer, simpler))
    return again if again is not None and again.evidence.error < simpler.evidence.error else simpler


def _challenge(refit: Refit, base: Explanation, chosen: Explanation, rounds: Sequence[Round]) -> Explanation:
    """Drop what the others have made needless."""
    for name in chosen.effects:
        rest = tuple(e for e in chosen.effects if e != name)
        # the others have ended elsewhere than before they had each other: the rest may do better from there
        known = [e for r in rounds for e in (r.before, *r.candidates) if e.effects == rest]
        again = refitted_without(refit, base, chosen, name)
        simpler = min(
            (e for e in (*known, again) if e is not None), key=lambda e: e.evidence.error, default=None
        )
        if simpler is not None and not better(chosen, simpler):
            return simpler
    return chosen
