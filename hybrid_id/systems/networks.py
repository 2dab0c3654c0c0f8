"""The residual networks of one joint: what they read, what they add, and what they remember."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from hybrid_id.components.base import Component, StateUpdate
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.errors import InputError, close_match
from hybrid_id.systems.balance import Channels, Rows, Views

if TYPE_CHECKING:
    from hybrid_id.systems.joint import Joint


LINK_PLACES = ("link_friction", "load")
SIGNALS = (
    "angle",
    "speed",
    "direction",
    "command",
    "torque",
    "load",
    "transmitted",
    "deflection",
    "deflection_rate",
)
HARMONIC = re.compile(r"(sin|cos) ?(\d+(?:\.\d+)?)")
OF_JOINT = re.compile(r"(angle|speed)(\d+)")


class Networks:
    """Networks by place, one a place.

    Signals that an input may name, of the side (rotor or link) on which the place acts: ``angle`` [rad], ``speed``
    [rad/s], ``direction`` (the speed once more, whose sign a network takes, smoothed as friction is),
    ``sin n`` and ``cos n`` of n times the angle; and of the joint: ``command`` (effective, in the motor's unit),
    ``torque`` (the motor's [N m]), ``load`` (at the link [N m], link friction excepted), ``transmitted`` (through the
    gear, at the link [N m]: the spring's torque, or behind a rigid gear what the joint's own balance without dry
    friction leaves for the link); with a compliant gear ``deflection`` [rad] and ``deflection_rate`` [rad/s]. With a
    joint's number behind it (``angle2``), ``angle`` and ``speed`` are those of that joint's link. All are without what
    networks add.

    Args:
        joint: the joint, its drive and loads in place.
        parts: its components by key.
        first_row: row of the first hidden state.

    Raises:
        InputError: an input that its place does not know.
    """

    def __init__(self, joint: Joint, parts: Mapping[str, Component], first_row: int) -> None:
        self.joint, self.joints = joint, [joint]  # all of them once the chain is wired
        self.state_names: list[str] = []
        self.by_place: dict[str, tuple[str, ResidualNetwork, range]] = {}
        for key, part in parts.items():
            if isinstance(part, ResidualNetwork):
                place, row = key.split("/")[1], first_row + len(self.state_names)
                rigid, where = self.joint.rigid, f"{self.joint.name}/{place}"
                if place == "transmission" and rigid:
                    raise InputError(
                        f"A rigid gear has no spring torque to which {part.kind} at '{where}' could add; "
                        "put it at motor_friction, or make the gear compliant."
                    )
                known = SIGNALS[: 7 if rigid else None]
                known = tuple(s for s in known if not (place == "input" and s == "torque"))
                for name in part.inputs:
                    if name not in known and not HARMONIC.fullmatch(name) and not OF_JOINT.fullmatch(name):
                        raise InputError(
                            f"{part.kind} at '{where}' has no input '{name}'{close_match(name, known)}; it knows "
                            f"{', '.join(known)}, sin n, cos n, "
                            "and angle and speed with a joint's number."
                        )
                    if (match := HARMONIC.fullmatch(name)) and not float(match[2]):
                        raise InputError(
                            f"{part.kind} at '{where}' has the input '{name}', which is the same at every angle; "
                            "give a number above 0."
                        )
                self.by_place[place] = (key, part, range(row, row + part.memory))
                self.state_names += [f"{name}_{place}{joint.number}" for name in part.states]

    def connect(self, joints: Sequence[Joint]) -> None:
        """Let the networks read the motion of all joints; an InputError where one reads a joint that is not there."""
        self.joints = list(joints)
        numbers = [joint.number for joint in joints]
        for place, (_, part, _) in self.by_place.items():
            for name in part.inputs:
                if (found := OF_JOINT.fullmatch(name)) and int(found[2]) not in numbers:
                    raise InputError(
                        f"{part.kind} at '{self.joint.name}/{place}' has the input '{name}', a joint that is not "
                        f"there; the last one is {joints[-1].name}."
                    )

    def signals(self, place: str, x: Rows, u: Channels, p: Views) -> tuple[list[Tensor], list[Tensor]]:
        """Inputs in their units and hidden states of the network in a place, ``(B,)`` each."""
        _, part, rows = self.by_place[place]
        inputs = [self._signal(name, place, x, u, p) for name in part.inputs]
        return inputs, [x[row] for row in rows]

    def _signal(self, name: str, place: str, x: Rows, u: Channels, p: Views) -> Tensor:
        joint = self.joint
        at_link = place in LINK_PLACES
        if match := HARMONIC.fullmatch(name):
            function = torch.sin if match[1] == "sin" else torch.cos
            return function(float(match[2]) * self._motion(joint, x, p, at_link, 0))
        if match := OF_JOINT.fullmatch(name):
            other = next(one for one in self.joints if one.number == int(match[2]))
            return self._motion(other, x, p, True, int(match[1] == "speed"))
        if name in ("angle", "speed", "direction"):
            return self._motion(joint, x, p, at_link, int(name != "angle"))
        if name == "command":
            return joint.drive.command(x, u, p, network=False)
        if name == "torque":
            return joint.drive.motor_torque(x, u, p, network=False)
        angle, speed = self._motion(joint, x, p, True, 0), self._motion(joint, x, p, True, 1)
        if name == "load":
            return joint.load_torque(angle, speed, u, p)
        if name == "transmitted":
            return self._transmitted(x, u, p)
        row = joint.positions[0]
        return joint.gear.deflection(x[row : row + 2], (angle, speed), p)[name == "deflection_rate"]

    def _transmitted(self, x: Rows, u: Channels, p: Views) -> Tensor:
        """Torque through the gear at the link, ``load + J_link a`` where the gear is rigid, ``(B,)``."""
        joint = self.joint
        if not joint.rigid:
            return joint.spring_torque(x, p)
        (key, inertia), ratio = joint.inertia, joint.gear_ratio
        (angle, speed), rotor_speed = joint.link_motion(x, p), x[joint.positions[0] + 1]
        slope = joint.gear.map(x[joint.positions[0]], p)[1]

        def drag(place: str, v: Tensor) -> Tensor | float:
            terms = (law.smooth(p[name], v) for name, law in joint.frictions[place])
            return sum(term for term in terms if term is not None)

        load = joint.load_torque(angle, speed, u, p) + drag("link_friction", speed)
        push = joint.drive.motor_torque(x, u, p, network=False) - drag("motor_friction", rotor_speed)
        link = inertia.link(p[key], ratio)
        acceleration = (push - slope * load) / (inertia.rotor(p[key], ratio) + slope * slope * link)
        return load + link * slope * acceleration

    @staticmethod
    def _motion(joint: Joint, x: Rows, p: Views, at_link: bool, order: int) -> Tensor:
        """Angle (order 0) or speed (1) of the rotor or the link."""
        return joint.link_motion(x, p)[order] if at_link else x[joint.positions[0] + order]

    def output(self, place: str, x: Rows, u: Channels, p: Views) -> Tensor | None:
        """What the network in a place adds there, ``(B,)`` in the place's unit; None where there is none."""
        if place not in self.by_place:
            return None
        key, part, _ = self.by_place[place]
        return part.output(p[key], *self.signals(place, x, u, p))

    def state_updates(self, x: Rows, u: Channels, p: Views) -> list[tuple[int, StateUpdate]]:
        """Row of each hidden state, and how it goes on."""
        found = []
        for place, (key, part, rows) in self.by_place.items():
            if part.memory:
                pairs = part.state_updates(p[key], *self.signals(place, x, u, p))
                found += [(row, StateUpdate(*pair)) for row, pair in zip(rows, pairs, strict=True)]
        return found
