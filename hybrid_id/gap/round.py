"""One step of the search: the catalogue's effects beside a model, all looked at, the promising fitted to the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hybrid_id.gap.evidence import WHITE, coloured
from hybrid_id.gap.refit import LOOK, TO_THE_END, WINDOW, Explanation, Name, Refit, Task
from hybrid_id.gap.starts import special_cases, tasks
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

    late = len(before.effects) > 1
    ranked = _second_looks(refit, before, refit.run(todo, LOOK, tick), LATE if late else PROMISING, tick)
    if more_todo and not (ranked and is_white(ranked[0])):
        ranked = best_of_each([*ranked, *_from_afar(refit, ranked, more_todo, tick)])
    finished: set[tuple[Name, ...]] = set()
    hope = any(_promises(e, before) for e in ranked)
    for keep in (FINALISTS, 1, 1) if hope else (1,):
        left = [e for e in ranked[:keep] if e.effects not in finished]
        finished |= {e.effects for e in left}
        ranked = _further(refit, before, left, ranked, TO_THE_END, tick)
    special = special_cases(refit, before, ranked[0]) if hope else []
    finished |= {task.effects for task in special}
    ranked = best_of_each([*ranked, *(e for e in refit.run(special, TO_THE_END) if e is not None)])
    simpler = _simpler(ranked, finished) if hope else []
    finished |= {e.effects for e in simpler}
    ranked = _further(refit, before, simpler, ranked, TO_THE_END, tick)
    return tuple(simplest_first(ranked, finished, before))


def _second_looks(
    refit: Refit,
    before: Explanation,
    looked: Sequence[Explanation | None],
    most: int,
    tick: Callable[[], object],
) -> list[Explanation]:
    """The most promising of first looks fitted further, and some more starts of the best."""
    seen = best_of_each([e for e in looked if e is not None], MORE_STARTS)
    firsts = best_of_each(seen)
    more_starts = [e for e in seen if e not in firsts][: MORE_STARTS if most > LATE else 0]
    return _further(refit, before, firsts[:most] + more_starts, firsts, SECOND_LOOK, tick)


def _from_afar(
    refit: Refit, ranked: Sequence[Explanation], tasks: Sequence[Task], tick: Callable[[], object]
) -> list[Explanation]:
    """Fits from values that are far: first over windows from measured states, over which any model is nearly linear.

    Where the link is hidden behind play no window knows its state: where nothing else explains the records, looks at
    whole ones instead, of which those are let go that stay far behind what has been found.
    """
    batch = refit.records(tasks[0].system)  # which links are seen is the same for every model
    hidden = [hidden_links(task.system, batch) for task in tasks]

    def looked(among: Refit, behind: bool) -> list[Explanation]:
        some = [task for task, one in zip(tasks, hidden, strict=True) if one == behind]
        return best_of_each([e for e in among.run(some, LOOK, tick) if e is not None], MORE_STARTS)

    def further(seen: Sequence[Explanation], least: float, most: int) -> list[Explanation]:
        best = [e for e in seen if e.evidence.error < HOPELESS * least][:most]
        more = refit.run([Task(e.effects, e.system) for e in best], SECOND_LOOK, tick)
        return [e for e in more if e is not None]

    seen = looked(refit.within(WINDOW), False)
    found = further(seen, seen[0].evidence.error if seen else math.inf, PROMISING)
    if any(is_white(e) for e in found):
        return found
    known = min((e.evidence.error for e in (*ranked, *found)), default=math.inf)
    return [*found, *further(looked(refit, True), known, MORE_STARTS)]


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
    return not before.effects or one.evidence.gain(before.evidence) > PROMISE


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
