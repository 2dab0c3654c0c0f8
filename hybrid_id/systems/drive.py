"""From the logged channels of one joint to the torque of its motor: places ``input`` and ``motor``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

from torch import Tensor

from hybrid_id.components.base import REGISTRY, Component, Input, Motor, Sensor
from hybrid_id.components.drive import CommandMap, RotorTorque, Winding
from hybrid_id.components.input.delay import Delay
from hybrid_id.errors import InputError

if TYPE_CHECKING:
    from hybrid_id.systems.networks import Networks

Views = Mapping[str, SimpleNamespace]


def only(parts: Mapping[str, Component], kind: type, joint: str, what: str) -> tuple[str, Component]:
    """Key and component of the one of its kind; InputError where there is none or more."""
    found = [(key, part) for key, part in parts.items() if isinstance(part, kind)]
    if len(found) != 1:
        raise InputError(f"{joint} has {len(found)} components of type {what}; it needs exactly one.")
    return found[0]


class Drive:
    """Input, motor and what acts beside them.

    Args:
        number: joint number, from 1.
        parts: the joint's components by key, in their order.
        rotor: row of the rotor's angle in the system's state; its speed is the next.
        first_row: row of the first state that the drive owns.

    Attributes:
        state_names: of the states that it owns.
        networks: of the joint; those at its places act beside the components.

    Raises:
        InputError: no input or no motor.
    """

    def __init__(self, number: int, parts: Mapping[str, Component], rotor: int, first_row: int) -> None:
        joint = f"joint{number}"
        self.number, self.rotor = number, rotor
        self.networks: Networks | None = None
        self.input = cast("tuple[str, Input]", only(parts, Input, joint, "input"))
        self.motor = cast("tuple[str, Motor]", only(parts, Motor, joint, "motor"))
        self.encoders = [(k, c) for k, c in parts.items() if isinstance(c, Sensor) and c.channel == "q_m"]
        self.delay = next(((key, part) for key, part in parts.items() if isinstance(part, Delay)), None)
        maps = [(key, part) for key, part in parts.items() if isinstance(part, CommandMap)]
        self.maps = sorted(maps, key=lambda item: item[1].stage)
        self.torques = [(key, part) for key, part in parts.items() if isinstance(part, RotorTorque)]
        self.windings: list[tuple[str, Winding, range]] = []
        self.state_names: list[str] = []
        for key, part in parts.items():
            if isinstance(part, Winding):
                row = first_row + len(self.state_names)
                self.windings.append((key, part, range(row, row + len(part.states))))
                self.state_names += [f"{state}{number}" for state in part.states]

    def check(self) -> None:
        """Raise InputError where the motor takes another kind of command than its input gives."""
        joint, source, motor = f"joint{self.number}", self.input[1], self.motor[1]
        if motor.takes and source.gives != motor.takes:
            fits = [k for k, c in REGISTRY.items() if issubclass(c, Motor) and c.takes == source.gives]
            raise InputError(
                f"{source.kind} at {joint}/input gives {source.gives}, but {motor.kind} at {joint}/motor takes "
                f"{motor.takes}; put {' or '.join(sorted(fits))} there."
            )

    def past(self, sample_time: float) -> dict[str, int]:
        """Channels whose past the drive needs, and how many samples of it."""
        if self.delay is None:
            return {}
        lags = self.delay[1].lags(sample_time)
        return {f"{name}{self.number}": lags for name in self.input[1].channels}

    def hold(self, u: Mapping[str, Tensor], p: Views) -> Mapping[str, Tensor]:
        """Channels as they arrive after the delay; without one, or where that has been done before, as they are."""
        done, step = f"arrived{self.number}", f"step{self.number}"
        if self.delay is None or done in u:
            return u
        if step not in u:
            raise InputError(
                f"joint{self.number} has a delay, but its channels have no past; prepare them as a batch."
            )
        key, part = self.delay
        arrived = {**u, done: u[step]}
        for name in (f"{c}{self.number}" for c in self.input[1].channels):
            history = [u[name], *(u[f"{name}@{k}"] for k in range(1, len(u)) if f"{name}@{k}" in u)]
            arrived[name] = part.held(p[key], history, u[step])
        return arrived

    def command(
        self, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views, *, network: bool = True
    ) -> Tensor:
        """Effective command at the motor, ``(B,)``; without what a network adds where ``network`` is false."""
        key, part = self.input
        u = self.hold(u, p)
        channels = {name: u[f"{name}{self.number}"] for name in part.channels}
        angle, speed = x[self.rotor], x[self.rotor + 1]
        for name, encoder in self.encoders:  # a position loop compares its goal with what it reads
            angle = encoder.read(p[name], angle)
        command = part.command(p[key], channels, angle, speed)
        for key, step in self.maps:
            command = step.map(p[key], command, speed)
        added = self._added("input", x, u, p) if network else None
        return command if added is None else command + added

    def torque(self, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views) -> Tensor:
        """Torque on the rotor [N m], ``(B,)``."""
        torque = self.motor_torque(x, u, p)
        for key, part in self.torques:
            torque = torque + part.torque(p[key], x[self.rotor], x[self.rotor + 1])
        added = self._added("motor", x, u, p)
        return torque if added is None else torque + added

    def current(self, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views) -> Tensor:
        """Winding current [A], ``(B,)``."""
        key, motor = self.motor
        return motor.current(p[key], self.motor_torque(x, u, p))

    def motor_torque(
        self, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views, *, network: bool = True
    ) -> Tensor:
        """Torque of the motor alone; one that is switched off is an open circuit (no back-EMF)."""
        key, motor = self.motor
        torque = motor.torque(p[key], self.command(x, u, p, network=network), x[self.rotor + 1])
        for key, part, rows in self.windings:
            torque = part.torque(p[key], torque, [x[row] for row in rows])
        return self._switched(torque, u)

    def _added(self, place: str, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views) -> Tensor | None:
        return None if self.networks is None else self.networks.output(place, x, u, p)

    def _switched(self, torque: Tensor, u: Mapping[str, Tensor]) -> Tensor:
        enable = u.get(f"enable{self.number}")
        return torque if enable is None else torque * enable

    def relaxations(
        self, x: Sequence[Tensor], u: Mapping[str, Tensor], p: Views
    ) -> list[tuple[int, Tensor, Tensor]]:
        """Row, drive and rate [1/s] of each state, ``dz/dt = drive - rate z``."""
        if not self.windings:
            return []
        key, motor = self.motor
        torque = motor.torque(p[key], self.command(x, u, p), x[self.rotor + 1])
        torque = self._switched(torque, u)
        found = []
        for key, part, rows in self.windings:
            states = [x[row] for row in rows]
            pairs = part.relaxations(p[key], torque, states)
            found += [(row, drive, rate) for row, (drive, rate) in zip(rows, pairs, strict=True)]
            torque = part.torque(p[key], torque, states)
        return found
