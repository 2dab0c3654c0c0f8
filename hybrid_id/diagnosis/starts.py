"""Where the fits of a selection step start: every effect beside a model, at every place, from every initial value."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from hybrid_id.components.base import Component
from hybrid_id.diagnosis.catalogue import CATALOGUE, part_of, rotor_share, with_effect
from hybrid_id.diagnosis.fits import Fits, Task
from hybrid_id.diagnosis.model import FittedModel, Name, added_effect
from hybrid_id.diagnosis.periodic import Residual
from hybrid_id.diagnosis.plausibility import implausible_parameters
from hybrid_id.diagnosis.scales import scales
from hybrid_id.errors import InputError
from hybrid_id.identification.windows import hidden_links
from hybrid_id.systems.chain import System


def tasks(fits: Fits, before: FittedModel, among: frozenset[Name] | None = None) -> list[Task]:
    """A fit to start for every effect, place and initial value, or for those of some effects, from a model's values.

    Args:
        fits: holds the records.
        before: the model that the effects are added to.
        among: the effects; None for the whole catalogue.
    """
    batch = fits.records(before.system)
    left = Residual(before.result, batch)
    near = fits.slopes(before.system, before.result.cost, before.result.x0)
    found = []
    for size in scales(before.system, batch):
        for effect in CATALOGUE.values():
            for where, starts in with_effect(effect, before.system, size, left).items():
                name = effect.name, where
                if name in before.effects or (among is not None and name not in among):
                    continue
                found += [Task(tuple(sorted((*before.effects, name))), start, near) for start in starts]
    return found


def from_nominal(
    fits: Fits, before: FittedModel, nominal: System, fitted: Sequence[FittedModel]
) -> list[Task]:
    """The same from the nominal values, with each effect as a coarse fit has found it.

    Only where the model before has moved its parameters beyond what data sheets get wrong, to make up for
    what it lacks: that may be far from where they are with the right effect.
    """
    if before.effects or not implausible_parameters(nominal, before.system):
        return []
    near = None
    if hidden_links(before.system, fits.records(before.system)):
        own = with_values_of(before.system, nominal)
        near = None if own is None else fits.slopes(own, before.result.cost)
    starts = ((one, with_values_of(one.system, nominal)) for one in fitted)
    return [Task(one.effects, start, near) for one, start in starts if start is not None]


def with_values_of(system: System, other: System) -> System | None:
    """The system with the values that another one estimates, of all that both have; None where these cannot stand."""
    names = {(info.component, info.symbol): info.name for info in system.table}
    values = {(i.component, i.symbol): i.spec.value for i in other.table if i.spec.estimate}
    with suppress(InputError):  # no mass matrix, say, of inertias that a gear with play has divided
        return system.with_values({names[key]: value for key, value in values.items() if key in names})
    return None


def special_cases(fits: Fits, before: FittedModel, richer: FittedModel) -> list[Task]:
    """Fits of what an effect has as its special cases, each in its place and from where the fit with it has ended.

    From the model before, which lacks both, the richer law may have found a way that the special case has not.
    """
    name, where = added_effect(richer, before)
    rest = without(richer.system, before.system, (name, where)) if CATALOGUE[name].contains else None
    if rest is None:
        return []
    (size,) = (s for s in scales(rest, fits.records(rest)) if where.startswith(f"joint{s.joint}/"))
    others = tuple(effect for effect in richer.effects if effect != (name, where))
    return [
        Task(tuple(sorted((*others, (special, where)))), start)
        for special in CATALOGUE[name].contains
        for start in with_effect(CATALOGUE[special], rest, size).get(where, [])
    ]


def swapped(
    rest: System, effects: tuple[Name, ...], rivals: Sequence[FittedModel], before: FittedModel
) -> list[Task]:
    """Rivals of an effect put beside the other effects that a model has, from the values that each had alone.

    Args:
        rest: the model without the effect.
        effects: that it has.
        rivals: of the effect, in the step that has brought it.
        before: the model that this step has begun with.
    """
    found = []
    for rival in rivals:
        name = added_effect(rival, before)
        # a gear has one spring: of effects whose laws replace each other only one is there
        taken = {kind for other, where in effects if where == name[1] for kind in _families(other)}
        excluded = name in effects or taken & _families(name[0])
        start = None if excluded else _with(rest, rival.system, name)
        if start is not None:
            found.append(Task(tuple(sorted((*effects, name))), start))
    return found


def _families(effect: str) -> set[type[Component]]:
    """The base classes of an effect's laws of which a place holds one, or the laws themselves."""
    return {law.family() for law in CATALOGUE[effect].laws}


def _with(system: System, other: System, name: Name) -> System | None:
    """The system with an effect as another system has it; None where it cannot stand there."""
    effect, share = CATALOGUE[name[0]], rotor_share(other, name[1][:6])
    for kind in effect.kinds:
        part = part_of(other, name[1], kind)
        if part is not None:
            with suppress(InputError):
                found = system.with_component(name[1], part)
                if share is None or not part.splits_inertia:
                    return found
                return found.with_specs({share.name: share.spec})
    return None


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
        # the system with the rotor's share of a joint as it was, where no effect is left that identifies it
        joint = name[1][:6]
        share = rotor_share(rest, joint)
        new = [
            c for k, c in rest.components.items() if k.startswith(f"{joint}/") and k not in base.components
        ]
        if share is None or any(isinstance(part, Component) and part.splits_inertia for part in new):
            return rest
        return rest.with_specs({share.name: base.parameter(share.name).spec})
    return None
