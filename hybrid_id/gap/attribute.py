"""Which effects: the catalogue is searched by fits, richest first look at all, then the best to the end.

Forward selection with backward deletion: the effect that predicts records left out best is added; then the next beside
it; then each of the chosen has to show that the rest cannot do without it. Before an effect is believed, the model
without it is fitted again from where the model with it has ended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import hybrid_id.gap.effects  # noqa: F401  (fills the catalogue)
from hybrid_id.gap.catalogue import CATALOGUE, part_of
from hybrid_id.gap.harmonics import likely_waves
from hybrid_id.gap.refit import LOOK, TO_THE_END, Explanation, Name, Refit, Task
from hybrid_id.gap.scales import scales
from hybrid_id.study.replays import batch_of
from hybrid_id.systems.chain import System

MOST = 3
"""Effects at once."""
SECOND_LOOK = 10
"""Iterations of a second look."""
PROMISING, EACH, FINALISTS = 14, 3, 4
"""Candidates that get a second look, starts of one effect among them, and candidates that are fitted to the end."""
SAME = 2e-3
"""Costs that differ by less than this share are of one valley."""
HOPELESS = 2.5
"""Mean square error beyond the best's from which a candidate is not fitted to the end."""
FAR = 3.0
"""Mean square error, in units of the noise, from which a re-fit counts as far from the records."""
NEAR = 1.15
"""Mean square error of a second look, relative to the model before, up to which an effect beside another may still win:
that model has been fitted to the end."""
LEAST_RATIO = 1.015
"""An effect must lower the RMS of the errors of prediction at least by this factor ..."""
MORE_RATIO = 1.05
"""... beside another effect by this one, for what the fit of that one leaves another may pick up ..."""
LEAST_Z = 3.0
"""... and by so many standard errors, block by block."""
LARGE_RATIO, LARGE_Z = 1.2, 1.5
"""A gain as large as this one is believed earlier: where a second effect is missing, blocks scatter."""

Progress = Callable[[str, int, int], object]


@dataclass(frozen=True, eq=False)
class Round:
    """One step of the search: what was there before, and every candidate that was added to it, best first."""

    before: Explanation
    candidates: tuple[Explanation, ...]

    @property
    def best(self) -> Explanation | None:
        """The candidate that predicts best, None where there is none."""
        return self.candidates[0] if self.candidates else None


@dataclass(frozen=True, eq=False)
class Attribution:
    """Result of the search.

    Attributes:
        base: today's model, re-fitted.
        rounds: the steps; the first tells the effects one by one.
        chosen: the set that the search stands by; ``base`` where no effect has earned its place.
    """

    base: Explanation
    rounds: tuple[Round, ...]
    chosen: Explanation


def attribute(
    refit: Refit, system: System, *, most: int = MOST, progress: Progress | None = None
) -> Attribution:
    """Search the catalogue for the effects that the records call for.

    Args:
        refit: fits models to the train records.
        system: today's model.
        most: effects at most.
        progress: called with (stage, done, total).
    """
    base = refit.base(system)
    chosen, rounds, restarted = base, [], False
    while len(chosen.effects) < most:
        found = one_round(refit, chosen, system, f"effect {len(chosen.effects) + 1}", progress)
        rounds.append(found)
        if found.best is None or not better(found.best, chosen):
            break
        simpler = _second_chance(refit, base, chosen, found.best)
        if not better(found.best, simpler):
            once_more, chosen = simpler is not chosen and not restarted, simpler
            base = base if simpler.effects else simpler
            if not once_more:
                break
            # the fit before had not found its best: the round is held again from there
            restarted = True
            rounds.pop()
            continue
        before, chosen = simpler, found.best
        if before.effects:
            chosen = _challenge(refit, base, chosen, rounds)
            if len(chosen.effects) <= len(before.effects):
                break
    return Attribution(base if chosen.effects else chosen, tuple(rounds), chosen)


def better(richer: Explanation, simpler: Explanation) -> bool:
    """Whether a richer model predicts records that it has not seen clearly better."""
    ratio = (simpler.evidence.error / richer.evidence.error) ** 0.5
    least = MORE_RATIO if simpler.effects else LEAST_RATIO
    z = richer.evidence.z(simpler.evidence)
    return (ratio >= least and z >= LEAST_Z) or (ratio >= LARGE_RATIO and z >= LARGE_Z)


def one_round(
    refit: Refit, before: Explanation, today: System, stage: str, progress: Progress | None = None
) -> Round:
    """Every effect of the catalogue added to a model, one at a time."""
    return Round(before, _ranked(refit, before, tasks(refit, before, today), stage, progress))


def tasks(refit: Refit, before: Explanation, today: System) -> list[Task]:
    """A fit to start for every effect, place and start point.

    Each starts where the model before has ended. Where that is today's re-fitted model and it is far from the records,
    it has bent its parameters to make up for what it lacks; then each starts from today's own values, too.
    """
    batch = batch_of(refit.dataset, before.system, refit.dataset.train, refit.signal_share, "cpu")
    taken, found = set(before.effects), []
    bent = not before.effects and before.evidence.error > FAR
    for size in scales(before.system, batch):
        for effect in CATALOGUE.values():
            models = effect.models(before.system, size)
            if effect.name == "cogging":
                models = effect.scanned(before.system, size, likely_waves(before.result, batch, size.joint))
            for where, starts in models.items():
                if (effect.name, where) in taken:
                    continue
                names = tuple(sorted((*before.effects, (effect.name, where))))
                for start in starts:
                    found.append(Task(names, start))
                    if bent:
                        found.append(Task(names, _as_today(start, today)))
    return found


def _as_today(system: System, today: System) -> System:
    """The system with today's own values of all that both have."""
    names = {(info.component, info.symbol): info.name for info in system.table}
    values = {(i.component, i.symbol): i.spec.value for i in today.table if i.spec.estimate}
    return system.with_values({names[key]: value for key, value in values.items() if key in names})


def _ranked(
    refit: Refit, before: Explanation, todo: Sequence[Task], stage: str, progress: Progress | None
) -> tuple[Explanation, ...]:
    """Fit tasks, the promising ones to the end; the best start of each set of effects, best prediction first."""
    total, count = len(todo) + PROMISING + FINALISTS, [0]

    def tick() -> None:
        count[0] += 1
        if progress is not None:
            progress(stage, count[0], total)

    seen = refit.run(todo, LOOK, tick)
    ranked = _best_of_each([e for e in seen if e is not None], EACH)
    finished: set[tuple[Name, ...]] = set()
    for keep, iterations in (
        (PROMISING, SECOND_LOOK),
        (FINALISTS, TO_THE_END),
        (1, TO_THE_END),
        (1, TO_THE_END),
    ):
        limit = HOPELESS * ranked[0].evidence.error if iterations == TO_THE_END and ranked else math.inf
        if before.effects:  # beside another effect, one that promises nothing is let go
            limit = min(limit, NEAR * before.evidence.error)
        rivals = [e for e in ranked[:keep] if e.evidence.error < limit and e.effects not in finished]
        more = refit.run([Task(e.effects, e.system) for e in rivals], iterations, tick)
        finished |= {e.effects for e in rivals} if iterations == TO_THE_END else set()
        # what has been fitted further counts, be it better or worse; the rest stays as it was seen
        kept = [e for e in ranked if e not in rivals]
        ranked = _best_of_each([*(e for e in more if e is not None), *kept])
    return tuple(ranked)


def _best_of_each(found: Sequence[Explanation], each: int = 1) -> list[Explanation]:
    """The best fits of each set of effects, best first; of those that have come to the same end only one."""
    ends: dict[tuple[Name, ...], list[float]] = {}
    best = []
    for one in sorted(found, key=lambda e: e.evidence.error):
        known = ends.setdefault(one.effects, [])
        if len(known) < each and all(one.result.cost > (1.0 + SAME) * end for end in known):
            known.append(one.result.cost)
            best.append(one)
    return best


def _second_chance(refit: Refit, base: Explanation, simpler: Explanation, richer: Explanation) -> Explanation:
    """The simpler model fitted again from where the richer one ended: the new effect may only have freed its fit."""
    new = next(name for name in richer.effects if name not in simpler.effects)
    again = _refitted_without(refit, base, richer, new)
    return again if again is not None and again.evidence.error < simpler.evidence.error else simpler


def _challenge(refit: Refit, base: Explanation, chosen: Explanation, rounds: Sequence[Round]) -> Explanation:
    """Drop what the others have made needless."""
    for name in chosen.effects:
        rest = tuple(e for e in chosen.effects if e != name)
        # the others have ended elsewhere than before they had each other: the rest may do better from there
        known = [e for r in rounds for e in (r.before, *r.candidates) if e.effects == rest]
        again = _refitted_without(refit, base, chosen, name)
        simpler = min(
            (e for e in (*known, again) if e is not None), key=lambda e: e.evidence.error, default=None
        )
        if simpler is not None and not better(chosen, simpler):
            return simpler
    return chosen


def _refitted_without(refit: Refit, base: Explanation, richer: Explanation, name: Name) -> Explanation | None:
    """A model less one of its effects, fitted from where it stands; None where that cannot be fitted."""
    start = _without(richer.system, base.system, name)
    rest = tuple(effect for effect in richer.effects if effect != name)
    return None if start is None else refit.run([Task(rest, start)], TO_THE_END)[0]


def _without(system: System, base: System, name: Name) -> System | None:
    """The system less one of its effects; what the effect had replaced comes back."""
    for kind in CATALOGUE[name[0]].kinds:
        part = part_of(system, name[1], kind)
        if part is None:
            continue
        family = part.family()
        here = (p for key, p in base.components.items() if key.startswith(f"{name[1]}/"))
        old = next((p for p in here if isinstance(p, family)), None)
        return system.without_component(name[1], kind) if old is None else system.with_component(name[1], old)
    return None
