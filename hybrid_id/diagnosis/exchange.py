"""Models with one effect less, or with another one in its place."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from hybrid_id.diagnosis.belief import better
from hybrid_id.diagnosis.catalogue import CATALOGUE, part_of, rotor_share
from hybrid_id.diagnosis.explanation import Explanation, Name, new_effect
from hybrid_id.diagnosis.ranking import LEAST_RATIO
from hybrid_id.diagnosis.refit import TO_THE_END, Refit, Task
from hybrid_id.diagnosis.round import HOPELESS, SECOND_LOOK, Round
from hybrid_id.diagnosis.starts import without
from hybrid_id.errors import InputError
from hybrid_id.systems.chain import System

SPRINGS = ("backlash", "joint_flexibility", "hardening_flexibility")
"""Effects of which a gear has one."""
RIVAL, RIVALS = 1.1, 3
"""Mean square error over that of its round's best up to which an effect is tried in its place beside a later one, and
how many are."""


def exchanges(refit: Refit, base: Explanation, chosen: Explanation, rounds: Sequence[Round]) -> list[Round]:
    """Each earlier effect against those that explained as much as it did when it stood alone, now beside the others."""
    found = []
    for one in rounds:
        name = None if one.again or one.best is None else new_effect(one.best, one.before)
        if name not in chosen.effects or one.best is None or one.best.effects == chosen.effects:
            continue
        rest = without(chosen.system, base.system, name)
        tasks = [] if rest is None else _tasks(rest, tuple(e for e in chosen.effects if e != name), one)
        ends = sorted((e for e in refit.run(tasks, TO_THE_END) if e is not None), key=_error)
        alone = refitted_without(refit, base, chosen, name) if ends else None
        if alone is not None:
            # of equals the one that was found first leads
            first = ends[0] if better(ends[0], chosen, LEAST_RATIO) else chosen
            others = (e for e in sorted((*ends, chosen), key=_error) if e is not first)
            found.append(Round(alone, (first, *others), again=True))
    return found


def _tasks(rest: System, effects: tuple[Name, ...], one: Round) -> list[Task]:
    """The rivals of a round's best put beside the effects that the rest has."""
    best, tasks = one.candidates[0].evidence.error, []
    for rival in [e for e in one.candidates[1:] if e.evidence.error < RIVAL * best][:RIVALS]:
        name = new_effect(rival, one.before)
        start = None if name in effects or _sprung(name, effects) else _with(rest, rival.system, name)
        if start is not None:
            tasks.append(Task(tuple(sorted((*effects, name))), start))
    return tasks


def _sprung(name: Name, effects: Sequence[Name]) -> bool:
    """Whether an effect would take the place of another one that makes the same gear give way."""
    return name[0] in SPRINGS and any(where == name[1] and other in SPRINGS for other, where in effects)


def _with(system: System, other: System, name: Name) -> System | None:
    """The system with an effect as another one has it; None where it cannot stand there."""
    effect, share = CATALOGUE[name[0]], rotor_share(other, name[1][:6])
    for kind in effect.kinds:
        part = part_of(other, name[1], kind)
        if part is not None:
            with suppress(InputError):
                found = system.with_component(name[1], part)
                if share is None or kind not in effect.splits:
                    return found
                return found.with_specs({share.name: share.spec})
    return None


def _error(one: Explanation) -> float:
    return one.evidence.error


def refitted_without(refit: Refit, base: Explanation, richer: Explanation, name: Name) -> Explanation | None:
    """A model less one of its effects, fitted from where it stands; None where that cannot be fitted."""
    start = without(richer.system, base.system, name)
    rest = tuple(effect for effect in richer.effects if effect != name)
    found = None if start is None else refit.run([Task(rest, start)], SECOND_LOOK)[0]
    if found is None or found.evidence.error > HOPELESS * richer.evidence.error:
        return found
    return refit.run([Task(rest, found.system)], TO_THE_END)[0]
