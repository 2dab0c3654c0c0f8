"""The catalogue: every effect that a diagnosis can name, where it may act, and where its fit starts."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import cast

from hybrid_id.components.base import REGISTRY, Component
from hybrid_id.diagnosis.periodic import Left
from hybrid_id.diagnosis.scales import Scales
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded, ParameterInfo
from hybrid_id.systems.chain import System

ROTOR_SHARES = (0.1, 0.02)
"""Shares of the rotor in a joint's inertia that are tried where the model's own does not go with an effect."""
Values = Mapping[str, float | Bounded]
Start = tuple[str, Values]
"""A component's kind and its parameter values."""
SIDES = (
    "encoders on both sides of the gear, or commands faster than the joint's resonance: only what acts on the link "
    "winds the gear up, and above the resonance the rotor swings without it"
)
"""The excitation that tells the sides of a gear apart, where the same effect may act on either."""
JOINTS = "one joint moved while the other is held"
"""The same of two joints."""


@dataclass(frozen=True)
class Effect:
    """One effect of the catalogue.

    Attributes:
        name: how a diagnosis calls it.
        places: where it may act, most usual first; of several places on a rigid joint only the first is tried.
        starts: start points of its fit for one joint, each a component's kind and values; none where it cannot act.
        mistaken_for: effects that records easily confuse with it, each with the excitation that tells the two apart.
            Either of the two may state a pair: ask :func:`rivals`.
        source: where the effect is described: authors, title, where it appeared, year.
        splits: components of it that need the split of inertia between rotor and link, which is then estimated.
        kinds: components that model it, where they are not called as it is.
        scan: looks in what a fit leaves for start points, by (what is left, joint, place); ``starts`` takes what it
            returns as a further argument.
        shape: fixed parameters that belong to the answer (the periods of a wave), each with the estimated one that it
            goes with.
        contains: effects that are special cases of it at the same place: it is no rival of theirs.
        further: parameters that are freed once the effect has been chosen, where that pays: start points of them by
            (its component, what the fit with it leaves, joint, place).
        smoothness: of its torque or voltage: ``smooth``, or where it jumps or kinks.
    """

    name: str
    places: tuple[str, ...]
    starts: Callable[..., Sequence[Start]]
    mistaken_for: Mapping[str, str]
    source: str
    splits: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    scan: Callable[[Left, int, str], Sequence[object]] | None = None
    shape: Mapping[str, str] = field(default_factory=dict)
    contains: tuple[str, ...] = ()
    further: Callable[[Component, Left, int, str], Sequence[Values]] | None = None
    smoothness: str = "smooth"

    def __post_init__(self) -> None:
        if not self.kinds:
            object.__setattr__(self, "kinds", (self.name,))

    def models(self, system: System, scales: Scales, left: Left | None = None) -> dict[str, list[System]]:
        """The system with this effect at each place of a joint where it may act, one model for each start point.

        Args:
            system: a model.
            scales: of the joint.
            left: what the model's fit leaves, for an effect that looks for its start points there.
        """
        joint = system.joints[scales.joint - 1]
        places = self.places
        if joint.rigid:  # both sides move alike: where today's model has its friction, else the first
            beyond = "link_friction" in places and joint.frictions["link_friction"]
            places = ("link_friction",) if beyond and not joint.frictions["motor_friction"] else places[:1]
        found: dict[str, list[System]] = {}
        for place in places:
            where = f"{joint.name}/{place}"
            starts = self.starts(system, scales, place)
            if starts and self.scan is not None and left is not None:
                starts = self.starts(system, scales, place, self.scan(left, scales.joint, place))
            models = [self._model(system, where, *start) for start in starts]
            if any(model is not None for model in models):
                found[where] = [model for model in models if model is not None]
        return found

    def freer(self, system: System, where: str, left: Left) -> list[System]:
        """The system with further parameters of this effect freed, one model for each start point.

        Args:
            system: a model that has the effect.
            where: its place.
            left: what the model's fit leaves.
        """
        key = next((k for kind in self.kinds if (k := f"{where}/{kind}") in system.components), None)
        if key is None or self.further is None:
            return []
        part = cast(Component, system.components[key])
        names = {info.symbol: info.name for info in system.table if info.component == key}
        return [
            system.with_specs(
                {names[s]: v if isinstance(v, Bounded) else part.specs[s].at(v)
                 for s, v in _inside(part.kind, values).items()}
            )
            for values in self.further(part, left, int(where[5]), where.split("/")[1])
        ]  # fmt: skip

    def _model(self, system: System, where: str, kind: str, values: Values) -> System | None:
        """The model at one start point; None where it cannot be built."""
        share = rotor_share(system, where[:6])
        for lighter in (None, *(ROTOR_SHARES if share is not None else ())):
            with suppress(InputError):  # too heavy a rotor leaves the links of an arm no mass matrix
                start = (
                    system if lighter is None or share is None else system.with_values({share.name: lighter})
                )
                richer = start.with_component(where, REGISTRY[kind](**_inside(kind, values)))
                if share is None or kind not in self.splits:
                    return richer
                spec = richer.parameter(share.name).spec
                low, high = max(spec.lower, 0.01), min(spec.upper, 0.99)
                return richer.with_specs({share.name: replace(spec, estimate=True, lower=low, upper=high)})
        return None

    @property
    def equation(self) -> str:
        """First line of the sheet of the component that models it."""
        return (inspect.getdoc(REGISTRY[self.kinds[0]]) or "").split("\n", 1)[0]


CATALOGUE: dict[str, Effect] = {}


def register(effect: Effect) -> Effect:
    """Put an effect into the catalogue; a later one of the same name takes its place."""
    CATALOGUE[effect.name] = effect
    return effect


def effect(name: str) -> Effect:
    """The effect of a name.

    Raises:
        InputError: it is not in the catalogue.
    """
    if name not in CATALOGUE:
        raise InputError(f"Effect '{name}' is not in the catalogue; it has {', '.join(sorted(CATALOGUE))}.")
    return CATALOGUE[name]


def rivals(name: str) -> dict[str, str]:
    """Effects that an effect is mistaken for, each with the excitation that tells the two apart."""
    own = CATALOGUE[name].mistaken_for if name in CATALOGUE else {}
    return {**own, **{e.name: e.mistaken_for[name] for e in CATALOGUE.values() if name in e.mistaken_for}}


def separation(one: tuple[str, str], other: tuple[str, str]) -> str:
    """The excitation that tells two effects apart, each by name and place; empty where none is known."""
    (name, here), (rival, there) = one, other
    if name != rival:
        return rivals(name).get(rival, "")
    return SIDES if here.split("/")[0] == there.split("/")[0] else JOINTS


def has(system: System, where: str, *kinds: str) -> bool:
    """Whether the system has a component of one of the kinds at a place."""
    return any(f"{where}/{kind}" in system.components for kind in kinds)


def part_of(system: System, where: str, kind: str) -> Component | None:
    """The component of a kind at a place, None where there is none."""
    return dict(system.components.items()).get(f"{where}/{kind}")  # type: ignore[return-value]


def free(value: float, lower: float, upper: float, unit: str = "1") -> Bounded:
    """An estimated parameter inside its bounds."""
    lower, upper = float(lower), float(upper)
    return Bounded(min(max(float(value), lower), upper), lower, upper, unit)


def _inside(kind: str, values: Values) -> dict[str, float | Bounded]:
    """Values whose bounds stay inside what the component's own physics allows."""
    kept: dict[str, float | Bounded] = {}
    for symbol, value in values.items():
        declared = REGISTRY[kind].declared[symbol]
        if isinstance(value, Bounded):
            low, high = max(value.lower, declared.lower), min(value.upper, declared.upper)
            value = replace(
                value, lower=low, upper=high, value=min(max(value.value, low), high), unit=declared.unit
            )
        kept[symbol] = value
    return kept


def rotor_share(system: System, joint: str) -> ParameterInfo | None:
    """The rotor's share of a joint's inertia; None where the model has two inertias."""
    return next(
        (i for i in system.table if i.symbol == "rotor_share" and i.component.startswith(joint)), None
    )


def over_angle(effects: Sequence[tuple[str, str]]) -> bool:
    """Whether a torque over the angle is among effects of the catalogue.

    It may halt the motion at one detent or the next: a free run then tells little of how well a model is known.
    """
    return any(name in CATALOGUE and CATALOGUE[name].scan is not None for name, _ in effects)
