"""One step of the search: the catalogue's effects beside a model, all looked at, the promising fitted to the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from hybrid_id.diagnosis.catalogue import over_angle
from hybrid_id.diagnosis.explanation import Explanation, Name
from hybrid_id.diagnosis.ranking import best_of_each, effects_of, is_white, simpler_ones, simplest_first
from hybrid_id.diagnosis.refit import LOOK, TO_THE_END, WINDOW, Refit, Task
from hybrid_id.diagnosis.starts import special_cases, tasks
from hybrid_id.identification.horizons import hidden_links
from hybrid_id.systems.chain import System

SECOND_LOOK = 10
"""Iterations of a second look."""
PROMISING, MORE_STARTS, FINALISTS, LATE = 16, 6, 4, 4
"""Candidates that get a second look, further starts of the best that do, candidates that are fitted to the end, and
those that get a second look beside two effects."""
STARTS, SHAPES = 2, 3
"""Starts of each shape that are kept beside each other, and further ones of the leading effect, of any shape, that are
fitted to the end where it leaves more than noise: the period of its wave and its phase decide how far it gets."""
GO_ON = 4
"""Times that the last fit of a torque over the angle is taken up again, from where it has ended, while it leaves more
than noise: along the ripples of its cost each brings it a little further."""
HOPELESS = 2.5
"""Mean square error beyond the best's from which a candidate is not fitted to the end, nor any further where the best
leaves white noise or stands beside another effect."""
STILL_OPEN = 0.15
"""Share of the mean square that the best closes which a candidate may leave open and still be fitted further."""
IDLE, IDLERS = 0.99, 6
"""Cost relative to the model before from which a candidate has brought nothing yet, and how many of these get a second
look; the best of them is fitted to the end."""
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
    refused: Collection[Name] = (),
    progress: Progress | None = None,
) -> Round:
    """Every effect of the catalogue, or some of them, but for refused ones, added to a model, one at a time."""
    return Round(
        before, _ranked(refit, before, *tasks(refit, before, today, among, refused), stage, progress)
    )


def finished(refit: Refit, some: Sequence[Explanation]) -> list[Explanation]:
    """Candidates fitted to the end, as far as they can be."""
    todo = [Task(e.effects, e.system, x0=e.result.x0) for e in some if not e.finished]
    ends = iter(refit.run(todo, TO_THE_END))
    return [e for e in (one if one.finished else next(ends) for one in some) if e is not None]


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
        ranked = best_of_each([*ranked, *_from_afar(refit, ranked, more_todo, tick)], STARTS)

    def to_the_end(some: Sequence[Explanation]) -> list[Explanation]:
        return _further(refit, before, [e for e in some if not e.finished], ranked, TO_THE_END, tick)

    hope = any(_promises(e, before) for e in ranked)
    for keep in (FINALISTS, 1, 1) if hope else (1,):
        ranked = to_the_end(best_of_each(ranked, key=effects_of)[:keep])
    if hope and ranked:  # the last fits of all may have failed
        if not is_white(ranked[0]):
            ranked = to_the_end([e for e in ranked if e.effects == ranked[0].effects][: 1 + SHAPES])
            ranked = best_of_each([*ranked, *_gone_on(refit, ranked[0])], STARTS)
        special = refit.run(special_cases(refit, before, ranked[0]), TO_THE_END)
        ranked = best_of_each([*ranked, *(e for e in special if e is not None)], STARTS)
        ranked = to_the_end(simpler_ones(ranked))
    return tuple(simplest_first(best_of_each(ranked, key=effects_of), before))


def _second_looks(
    refit: Refit,
    before: Explanation,
    looked: Sequence[Explanation | None],
    most: int,
    tick: Callable[[], object],
) -> list[Explanation]:
    """The most promising of first looks fitted further, and some more starts of the best."""
    seen = best_of_each([e for e in looked if e is not None], MORE_STARTS)
    firsts = best_of_each(seen, key=effects_of)
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
    return best_of_each([*(e for e in more if e is not None), *kept], STARTS)


def _gone_on(refit: Refit, one: Explanation) -> list[Explanation]:
    """Further fits of a candidate whose torque acts over the angle, each from where the one before has ended."""
    fits = [one]
    while over_angle(one.effects) and not is_white(fits[-1]) and len(fits) <= GO_ON:
        again = refit.run([Task(one.effects, fits[-1].system, x0=fits[-1].result.x0)], TO_THE_END)[0]
        if again is None:
            break
        fits.append(again)
    return fits[1:]


def _promises(one: Explanation, before: Explanation) -> bool:
    """Whether a candidate may yet be believed, as far as it has been fitted; beside no other effect each may."""
    return not before.effects or one.evidence.gain(before.evidence) > PROMISE
