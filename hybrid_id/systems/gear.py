"""The gear of one joint: how the rotor's motion becomes the link's, and the torque of a compliant one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import cast

from torch import Tensor

from hybrid_id.components.base import Component, Inertia, Transmission
from hybrid_id.components.transmission.kinematic_error import KinematicError
from hybrid_id.systems.drive import only

Views = Mapping[str, SimpleNamespace]


class Gear:
    """Transmission and kinematic errors.

    Args:
        joint: name of the joint, for messages.
        ratio: motor turns per joint turn.
        parts: the joint's components by key.

    Raises:
        InputError: not exactly one transmission.
    """

    def __init__(self, joint: str, ratio: float, parts: Mapping[str, Component]) -> None:
        self.ratio = ratio
        found = only(parts, Transmission, joint, "transmission")
        self.transmission = cast("tuple[str, Transmission]", found)
        self.errors = [(key, part) for key, part in parts.items() if isinstance(part, KinematicError)]
        self.rigid = found[1].rigid  # type: ignore[attr-defined]

    def map(self, angle: Tensor, p: Views) -> tuple[Tensor, Tensor | float, Tensor | None]:
        """Angle of the link behind an unloaded gear [rad], its slope and its bend by the rotor's angle.

        A gear without kinematic error has the slope 1/r everywhere and no bend.
        """
        link, slope, bend = angle / self.ratio, 1.0 / self.ratio, None
        for key, part in self.errors:
            value, first, second = part.error(p[key], angle)
            link, slope, bend = link + value, slope + first, second if bend is None else bend + second
        return link, slope, bend

    def deflection(self, rotor: Sequence[Tensor], link: Sequence[Tensor], p: Views) -> list[Tensor]:
        """Deflection of a compliant gear [rad] and its rate [rad/s] from angle and speed of both sides."""
        angle, slope, _ = self.map(rotor[0], p)
        return [angle - link[0], rotor[1] * slope - link[1]]

    def torque(
        self, rotor: Sequence[Tensor], link: Sequence[Tensor], inertia: tuple[str, Inertia], p: Views
    ) -> Tensor:
        """Torque of a compliant gear's spring at the link [N m], ``(B,)``."""
        (key, part), (spring_key, spring) = inertia, self.transmission
        sides = part.rotor(p[key], self.ratio) * self.ratio**2, part.link(p[key], self.ratio)
        series = sides[0] * sides[1] / (sides[0] + sides[1])
        deflection, rate = self.deflection(rotor, link, p)
        return spring.torque(p[spring_key], deflection, rate, series)

    def loaded(self, angle: Tensor, p: Views) -> Tensor | None:
        """Angle of the link [rad] with the spring fully loaded, None where zero load will do."""
        key, spring = self.transmission
        deflection = None if self.rigid else spring.loaded(p[key])
        return None if deflection is None else self.map(angle, p)[0] - deflection
