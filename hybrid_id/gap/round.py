"""One step of the search: the catalogue's effects beside a model, all looked at, the promising fitted to the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import hybrid_id.gap.effects  # noqa: F401  (fills the catalogue)
from hybrid_id.errors import InputError
from hybrid_id.gap.bent import bent_parameters
from hybrid_id.gap.catalogue import CATALOGUE
from hybrid_id.gap.evidence import WHITE, coloured
from hybrid_id.gap.refit import LOOK, TO_THE_END, Explanation, Name, Refit, Task
from hybrid_id.gap.scales import scales
from hybrid_id.gap.scan import Left
from hybrid_id.identification.horizons import hidden_links
from hybrid_id.systems.chain import System

SECOND_LOOK = 10
"""Iterations of a second look."""
PROMISING, MORE_STARTS, FINALISTS, LATE = 16, 6, 4, 4
"""Candidates that get a second look, further starts of the best that do, candidates that are fitted to the end, and
those that get a second look beside two effects."""
SAME = 2e-3
"""Costs that differ by less than this share are of one valley."""
HOPELESS = 2.5
"""Mean square error beyond the best's from which a candidate is not fitted to the end, nor any further where the best
leaves white noise or stands beside another effect."""
STILL_OPEN = 0.15
"""Share of the mean square that the best closes which a candidate may leave open and still be fitted further."""
IDLE, IDLERS = 0.99, 6
"""Cost relative to the model before from which a candidate has brought nothing yet, and how many of these get a second
look; the best of them is fitted to the end."""
SIMPLER = 1.1
"""Mean square error over the best's up to which a candidate with fewer parameters is fitted to the end, too."""
LEAST_RATIO = 1.015
"""An effect, or a further parameter of one, must lower the RMS of the errors of prediction at least by this factor."""
TOLD = 2.5
"""Standard errors, block by block, from which records part two rivals."""
LEFT_OPEN = 0.1
"""A rival that leaves more than this share of the gap's mean square open, which another closes, is none."""
NEAR = 1.15
"""Mean square error of a second look, relative to the model before, up to which an effect beside another may still win:
that model has been fitted to the end."""
PROMISE = 1.025
"""Factor by which an effect beside another lowers the RMS of the errors in two looks where it is fitted to the end,
with its rivals, and shaken: half of the least that is believed."""

Progress = Callable[[str, int, int], object]


@dataclass(frozen=True, eq=False)
class Round:
    """One step of the search: what was there before, and every candidate that was added to it, best first.

    Attributes:
        before: the model that they are added to.
        candidates: with one more effect each.
        again: whether an effect and its rivals are compared once more, beside those that were found after it.
    """

    before: Explanation
    candidates: tuple[Explanation, ...]
    again: bool = False

    @property
    def best(self) -> Explanation | None:
        """The candidate that predicts best, None where there is none."""
        return self.candidates[0] if self.candidates else None


def one_round(
    refit: Refit,
    before: Explanation,
    today: System,
    stage: str,
    among: frozenset[Name] | None = None,
    progress: Progress | None = None,
) -> Round:
    """Every effect of the catalogue, or some of them, added to a model, one at a time."""
    return Round(before, _ranked(refit, before, *tasks(refit, before, today, among), stage, progress))


def tasks(
    refit: Refit, before: Explanation, today: System, among: frozenset[Name] | None = None
) -> tuple[list[Task], list[Task]]:
    """A fit to start for every effect, place and start point, or for those of some effects.

    Each starts where the model before has ended. Where that has bent its parameters to make up for what it lacks, each
    may start from today's own values, too: the second list.
    """
    batch = refit.records(before.system)
    left = Left(before.result, batch)
    taken, found, others = set(before.effects), [], []
    bent = len(before.effects) < 2 and bool(bent_parameters(today, before.system))
    least = before.result.cost
    here, there = refit.slopes(before.system, least), refit.slopes(today, least) if bent else None
    for size in scales(before.system, batch):
        for effect in CATALOGUE.values():
            for where, starts in effect.models(before.system, size, left).items():
                name = effect.name, where
                if name in taken or (among is not None and name not in among):
                    continue
                names = tuple(sorted((*before.effects, name)))
                for start in starts:
                    found.append(Task(names, start, here))
                    if bent and (again := _as_today(start, today)) is not None:
                        # behind play slopes that are borrowed from afar lead astray
                        others.append(Task(names, again, None if hidden_links(again, batch) else there))
    return found, others


def _as_today(system: System, today: System) -> System | None:
    """The system with today's own values of all that both have; None where they cannot stand beside the effect."""
    names = {(info.component, info.symbol): info.name for info in system.table}
    values = {(i.component, i.symbol): i.spec.value for i in today.table if i.spec.estimate}
    with suppress(InputError):  # no mass matrix, say, of inertias that a gear with play has divided
        return system.with_values({names[key]: value for key, value in values.items() if key in names})
    return None


def _ranked(
    refit: Refit,
    before: Explanation,
    todo: Sequence[Task],
    more_todo: Sequence[Task],
    stage: str,
    progress: Progress | None,
) -> tuple[Explanation, ...]:
    """Fit tasks, the promising ones to the end; the best start of each set of effects, best prediction first.

    The second tasks are tried where the best of the first still leaves more than white noise.
    """
    total, count = len(todo) + len(more_todo) + PROMISING + MORE_STARTS + FINALISTS, [0]

    def tick() -> None:
        count[0] += 1
        if progress is not None:
            progress(stage, count[0], total)

    ranked: list[Explanation] = []
    for part in (todo, more_todo):
        if ranked and is_white(ranked[0]):
            break
        known = {e.effects: e.evidence.error for e in ranked}
        looked = [e for e in refit.run(part, LOOK, tick) if e is not None]
        # a start that is behind where another of the same effects has come to is let go, behind play not at once
        bar = {e: HOPELESS if hidden_links(e.system, refit.records(e.system)) else 1.0 for e in looked}
        looked = [e for e in looked if e.evidence.error < bar[e] * known.get(e.effects, math.inf)]
        seen = best_of_each(looked, MORE_STARTS)
        firsts = best_of_each(seen)
        late = len(before.effects) > 1
        more_starts = [e for e in seen if e not in firsts][: 0 if late else MORE_STARTS]
        promising = firsts[: LATE if late else PROMISING] + more_starts
        ranked = _further(refit, before, promising, [*ranked, *firsts], SECOND_LOOK, tick)
    finished: set[tuple[Name, ...]] = set()
    hope = any(_promises(e, before) for e in ranked)
    for keep in (FINALISTS, 1, 1) if hope else (1,):
        left = [e for e in ranked[:keep] if e.effects not in finished]
        finished |= {e.effects for e in left}
        ranked = _further(refit, before, left, ranked, TO_THE_END, tick)
    simpler = _simpler(ranked, finished) if hope else []
    finished |= {e.effects for e in simpler}
    ranked = _further(refit, before, simpler, ranked, TO_THE_END, tick)
    return tuple(simplest_first(ranked, finished, before))


def _further(
    refit: Refit,
    before: Explanation,
    some: Sequence[Explanation],
    everyone: Sequence[Explanation],
    iterations: int,
    tick: Callable[[], object],
) -> list[Explanation]:
    """Some of the candidates fitted further, as far as they promise anything, among everyone again, best first."""
    if not some:
        return list(everyone)
    last, best = iterations == TO_THE_END, min((*some, *everyone), key=lambda e: e.evidence.error)
    strict = last or before.effects or is_white(best)
    least = best.evidence.error
    closing = least + STILL_OPEN * max(before.evidence.error - least, 0.0)
    limit = max(HOPELESS * least, closing) if strict else math.inf
    if before.effects:  # beside another effect, one that promises nothing is let go
        limit = min(limit, NEAR * before.evidence.error)
    rivals = [e for e in some if e.evidence.error < limit]
    idle = [e for e in rivals if e.result.cost > IDLE * before.result.cost]
    rivals = [e for e in rivals if e not in idle[1 if last else IDLERS :]]
    todo = [
        Task(e.effects, e.system, cost=e.result.cost, x0=e.result.x0, shake=_promises(e, before))
        for e in rivals
    ]
    more = refit.run(todo, iterations, tick)
    # what has been fitted further counts, be it better or worse; the rest stays as it was seen
    kept = [e for e in (*everyone, *some) if e not in rivals]
    return best_of_each([*(e for e in more if e is not None), *kept])


def _simpler(ranked: Sequence[Explanation], finished: set[tuple[Name, ...]]) -> list[Explanation]:
    """Candidates that may yet explain as much as the best, with fewer parameters than it has."""
    return [
        e
        for e in ranked
        if e.effects not in finished
        and e.evidence.error < SIMPLER * ranked[0].evidence.error
        and len(e.result.names) < len(ranked[0].result.names)
    ][:FINALISTS]


def _promises(one: Explanation, before: Explanation) -> bool:
    """Whether a candidate may yet be believed, as far as it has been fitted; beside no other effect each may."""
    return not before.effects or PROMISE**2 * one.evidence.error < before.evidence.error


def is_white(one: Explanation) -> bool:
    """Whether a candidate leaves next to nothing but white noise: no other can do much better."""
    return coloured(one.result.residual) < WHITE


def simplest_first(
    ranked: list[Explanation], finished: set[tuple[Name, ...]], before: Explanation
) -> list[Explanation]:
    """Of the candidates that predict as well as the best, the one with the fewest parameters leads (Occam)."""
    if not ranked:
        return []
    best = ranked[0].evidence
    closed = best.error + LEFT_OPEN * max(before.evidence.error - best.error, 0.0)
    equals = [
        e
        for e in ranked
        if e.effects in finished
        and e.evidence.error < LEAST_RATIO**2 * best.error
        and (e.evidence.error <= closed or best.z(e.evidence) < TOLD)
    ]
    first = min(equals, key=lambda e: len(e.result.names), default=ranked[0])
    return [first, *(e for e in ranked if e is not first)]


def best_of_each(found: Sequence[Explanation], each: int = 1) -> list[Explanation]:
    """The best fits of each set of effects, best first; of those that have come to the same end only one."""
    ends: dict[tuple[Name, ...], list[float]] = {}
    best = []
    for one in sorted(found, key=lambda e: e.evidence.error):
        known = ends.setdefault(one.effects, [])
        if len(known) < each and all(one.result.cost > (1.0 + SAME) * end for end in known):
            known.append(one.result.cost)
            best.append(one)
    return best
