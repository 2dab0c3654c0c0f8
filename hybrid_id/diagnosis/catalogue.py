"""The catalogue: what a diagnosis makes of the effects that the laws in :mod:`hybrid_id.components` declare."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import cast

from hybrid_id.components import CATALOGUE
from hybrid_id.components.base import Attached, Component, Effect, Shared, Values
from hybrid_id.components.site import Scales, Searches, Site
from hybrid_id.diagnosis.periodic import Residual, friction_spots, friction_waves, gear_waves, rotor_waves
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded, ParameterInfo
from hybrid_id.systems.chain import System

ROTOR_SHARES = (0.1, 0.02)
"""Shares of the rotor in a joint's inertia that are tried where the model's own does not go with an effect."""
SIDES = (
    "encoders on both sides of the gear, or commands faster than the joint's resonance: only what acts on the link "
    "winds the gear up, and above the resonance the rotor swings without it"
)
"""The excitation that distinguishes the sides of a gear, where the same effect may act on either."""
JOINTS = "one joint moved while the other is held"
"""The same of two joints."""


def with_effect(
    effect: Effect, system: System, scales: Scales, left: Residual | None = None
) -> dict[str, list[System]]:
    """The system with an effect at each place of a joint where it may act, one model for each start point.

    Of several places on a joint with a rigid gear only one is tried: both sides move alike.

    Args:
        effect: of the catalogue.
        system: a model.
        scales: of the joint.
        left: what the model's fit leaves, for laws that look for their start points there.
    """
    joint, places = system.joint(scales.joint), effect.places
    if joint.rigid:  # where the nominal model has its friction, else the first
        beyond = "link_friction" in places and joint.frictions["link_friction"]
        places = ("link_friction",) if beyond and not joint.frictions["motor_friction"] else places[:1]
    # what sits nowhere in particular is the same at any joint
    laws = [
        law
        for law in effect.laws
        if joint is system.joints[0] or not issubclass(law, Shared) or issubclass(law, Attached)
    ]
    found: dict[str, list[System]] = {}
    for place in places:
        site = Site(
            **vars(scales),
            place=place,
            components=cast("dict[str, Component]", dict(system.components.items())),
            rigid=bool(system.joint(scales.joint).rigid),
            ratios=tuple(joint.gear_ratio for joint in system.joints),
            searches={} if left is None else _searches(left, scales.joint, place),
        )
        if site.has(*effect.kinds) and not effect.where_held:
            continue
        starts = [(law, values) for law in laws for values in law.starts(site)]
        starts = [one for one in starts if not _listed_elsewhere(system, joint.name, *one)]
        built = [_model(system, f"{joint.name}/{place}", law, values) for law, values in starts]
        if kept := [model for model in built if model is not None]:
            found[f"{joint.name}/{place}"] = kept
    return found


def _listed_elsewhere(system: System, joint: str, law: type[Component], values: Values) -> bool:
    """Whether the robot has a law that acts on several joints already, with its parameters, at another one of them."""
    if not issubclass(law, Shared):
        return False
    point = values.get(getattr(law, "option", ""), "")
    parts = (item for robot in system.whole for item in robot.components.items())
    return any(
        isinstance(part, law) and part.point == point and not key.startswith(f"{joint}/")
        for key, part in parts
    )


def with_further(effect: Effect, system: System, where: str, left: Residual) -> list[System]:
    """The system with further parameters of an effect freed, one model for each start point.

    Args:
        effect: of the catalogue.
        system: a model that has it.
        where: its place.
        left: what the model's fit leaves.
    """
    key = next((k for kind in effect.kinds if (k := f"{where}/{kind}") in system.components), None)
    if key is None:
        return []
    law, (joint, place) = cast(Component, system.components[key]), where.split("/")
    names = {info.symbol: info.name for info in system.table if info.component == key}

    def specs(values: Values) -> dict[str, Bounded]:
        kept = _inside(type(law), values).items()
        return {names[s]: v if isinstance(v, Bounded) else law.specs[s].at(v) for s, v in kept}

    searches = _searches(left, int(joint.removeprefix("joint")), place)
    return [system.with_specs(specs(values)) for values in law.further(searches)]


def _searches(left: Residual, joint: int, place: str) -> Searches:
    """The searches that a law may ask for, by name."""
    searches = rotor_waves, gear_waves, friction_waves, friction_spots
    return {search.__name__: partial(search, left, joint, place) for search in searches}


def _model(system: System, where: str, law: type[Component], values: Values) -> System | None:
    """The model at one start point; None where it cannot be built."""
    share = rotor_share(system, where.split("/")[0])
    for lighter in (None, *(ROTOR_SHARES if share is not None else ())):
        with suppress(InputError):  # too heavy a rotor leaves the links of an arm no mass matrix
            start = system if lighter is None or share is None else system.with_values({share.name: lighter})
            options = [value for value in values.values() if isinstance(value, str)]
            richer = start.with_component(where, law(*options, **_inside(law, values)))
            if share is None or not law.splits_inertia:
                return richer
            spec = richer.parameter(share.name).spec
            low, high = max(spec.lower, 0.01), min(spec.upper, 0.99)
            return richer.with_specs({share.name: replace(spec, estimate=True, lower=low, upper=high)})
    return None


def effect(name: str) -> Effect:
    """The effect of a name.

    Raises:
        InputError: it is not in the catalogue.
    """
    if name not in CATALOGUE:
        raise InputError(f"Effect '{name}' is not in the catalogue; it has {', '.join(sorted(CATALOGUE))}.")
    return CATALOGUE[name]


def rivals(name: str) -> dict[str, str]:
    """Effects that an effect is mistaken for, each with the excitation that distinguishes the two."""
    own = CATALOGUE[name].mistaken_for if name in CATALOGUE else {}
    return {**own, **{e.name: e.mistaken_for[name] for e in CATALOGUE.values() if name in e.mistaken_for}}


def separation(one: tuple[str, str], other: tuple[str, str]) -> str:
    """The excitation that distinguishes two effects, each by name and place; empty where none is known."""
    (name, here), (rival, there) = one, other
    if name != rival:
        return rivals(name).get(rival, "")
    return SIDES if here.split("/")[0] == there.split("/")[0] else JOINTS


def brought(system: System, name: str, where: str) -> dict[str, ParameterInfo]:
    """Rows of a system's table of what an effect brings at its place, by symbol."""
    keys = {f"{where}/{kind}" for kind in effect(name).kinds}
    return {info.symbol: info for info in system.table if info.component in keys}


def part_of(system: System, where: str, kind: str) -> Component | None:
    """The component of a kind at a place, None where there is none."""
    return dict(system.components.items()).get(f"{where}/{kind}")  # type: ignore[return-value]


def _inside(law: type[Component], values: Values) -> dict[str, float | Bounded]:
    """Values in the declared units, whose bounds stay inside what the component's own physics allows."""
    kept: dict[str, float | Bounded] = {}
    for symbol, value in values.items():
        if isinstance(value, str):  # an option, of what sits at a point of a robot
            continue
        declared = law.declared[symbol]
        if isinstance(value, Bounded):
            low, high = max(value.lower, declared.lower), min(value.upper, declared.upper)
            inside = min(max(value.value, low), high)
            value = replace(value, lower=low, upper=high, value=inside, unit=declared.unit)
        kept[symbol] = value
    return kept


def rotor_share(system: System, joint: str) -> ParameterInfo | None:
    """The rotor's share of a joint's inertia; None where the model has two inertias."""
    return next(
        (i for i in system.table if i.symbol == "rotor_share" and i.component.startswith(joint)), None
    )


def over_angle(effects: Sequence[tuple[str, str]]) -> bool:
    """Whether a torque over the angle is among effects of the catalogue.

    It may halt the motion at one detent or the next: a free run then says little of how well a model is known.
    """
    return any(name in CATALOGUE and CATALOGUE[name].over_angle for name, _ in effects)
