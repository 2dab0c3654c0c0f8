"""Where the fits of a round start: every effect beside a model, at every place, from every start point."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress

import hybrid_id.diagnosis.effects  # noqa: F401  (fills the catalogue)
from hybrid_id.diagnosis.bent import bent_parameters
from hybrid_id.diagnosis.catalogue import CATALOGUE, part_of, rotor_share
from hybrid_id.diagnosis.explanation import Explanation, Name, new_effect
from hybrid_id.diagnosis.refit import Refit, Task
from hybrid_id.diagnosis.scales import scales
from hybrid_id.diagnosis.scan import Left
from hybrid_id.errors import InputError
from hybrid_id.identification.horizons import hidden_links
from hybrid_id.systems.chain import System


def tasks(
    refit: Refit,
    before: Explanation,
    today: System,
    among: frozenset[Name] | None = None,
    refused: Collection[Name] = (),
) -> tuple[list[Task], list[Task]]:
    """A fit to start for every effect, place and start point, or for those of some effects, but for refused ones.

    Each starts where the model before has ended. Where that has bent its parameters to make up for what it lacks, each
    may start from today's own values, too: the second list, for fits from afar.
    """
    batch = refit.records(before.system)
    left = Left(before.result, batch)
    taken, found, others = set(before.effects), [], []
    bent = len(before.effects) < 2 and bool(bent_parameters(today, before.system))
    least = before.result.cost
    here, there = refit.slopes(before.system, least), None
    if bent and hidden_links(before.system, batch) and (own := as_today(before.system, today)) is not None:
        there = refit.slopes(own, least)  # behind play even a look from afar is one at whole records
    for size in scales(before.system, batch):
        for effect in CATALOGUE.values():
            for where, starts in effect.models(before.system, size, left).items():
                name = effect.name, where
                if name in taken or name in refused or (among is not None and name not in among):
                    continue
                names = tuple(sorted((*before.effects, name)))
                for start in starts:
                    found.append(Task(names, start, here))
                    if bent and (again := as_today(start, today)) is not None:
                        others.append(Task(names, again, there))
    return found, others


def as_today(system: System, today: System) -> System | None:
    """The system with today's own values of all that both have; None where they cannot stand beside the effect."""
    names = {(info.component, info.symbol): info.name for info in system.table}
    values = {(i.component, i.symbol): i.spec.value for i in today.table if i.spec.estimate}
    with suppress(InputError):  # no mass matrix, say, of inertias that a gear with play has divided
        return system.with_values({names[key]: value for key, value in values.items() if key in names})
    return None


def special_cases(refit: Refit, before: Explanation, richer: Explanation) -> list[Task]:
    """Fits of what an effect has as its special cases, each in its place and from where the fit with it has ended.

    From the model before, which lacks both, the richer law may have found a way that the special case has not.
    """
    name, where = new_effect(richer, before)
    rest = without(richer.system, before.system, (name, where)) if CATALOGUE[name].contains else None
    if rest is None:
        return []
    (size,) = (s for s in scales(rest, refit.records(rest)) if where.startswith(f"joint{s.joint}/"))
    others = tuple(effect for effect in richer.effects if effect != (name, where))
    return [
        Task(tuple(sorted((*others, (special, where)))), start)
        for special in CATALOGUE[name].contains
        for start in CATALOGUE[special].models(rest, size).get(where, [])
    ]


def without(system: System, base: System, name: Name) -> System | None:
    """The system less one of its effects; what the effect had replaced comes back."""
    for kind in CATALOGUE[name[0]].kinds:
        part = part_of(system, name[1], kind)
        if part is None:
            continue
        family = part.family()
        here = (p for key, p in base.components.items() if key.startswith(f"{name[1]}/"))
        old = next((p for p in here if isinstance(p, family)), None)
        rest = system.without_component(name[1], kind) if old is None else system.with_component(name[1], old)
        return _joined(rest, base, name[1][:6])
    return None


def _joined(system: System, base: System, joint: str) -> System:
    """The system with the rotor's share of a joint as it was, where no effect is left that tells it."""
    share = rotor_share(system, joint)
    telling = {
        f"{joint}/{place}/{kind}" for e in CATALOGUE.values() for place in e.places for kind in e.splits
    }
    if share is None or any(key in telling and key not in base.components for key in system.components):
        return system
    return system.with_specs({share.name: base.parameter(share.name).spec})
