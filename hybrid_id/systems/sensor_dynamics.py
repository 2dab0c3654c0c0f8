"""From the motion of one joint to what its encoders read: place ``sensor``, and what reads late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import cast

from torch import Tensor

from hybrid_id.components.base import Component, Sensor
from hybrid_id.components.sensor.late_reading import LateReading

Views = Mapping[str, SimpleNamespace]


class SensorDynamics:
    """Sensors of a joint.

    Args:
        number: joint number, from 1.
        parts: the joint's components by key, in their order.
        rotor: row of the rotor's angle in the system's state; its speed is the next.
        first_row: row of the first state that the readings own.

    Attributes:
        state_names: of the states that they own.
    """

    def __init__(self, number: int, parts: Mapping[str, Component], rotor: int, first_row: int) -> None:
        self.rotor, self.row = rotor, first_row
        self.sensors = cast(
            "list[tuple[str, Sensor]]", [(k, part) for k, part in parts.items() if isinstance(part, Sensor)]
        )
        self.late = next(((k, part) for k, part in parts.items() if isinstance(part, LateReading)), None)
        self.state_names = [f"{name}{number}" for name in self.late[1].states] if self.late else []

    def read(self, channel: str, value: Tensor, seen: float, x: Sequence[Tensor], p: Views) -> Tensor:
        """What is read where a channel (``q_m``, ``v_a`` ...) has a true value, ``(B,)``.

        Args:
            channel: without the joint's number.
            value: what it would read in time and at the model's zero.
            seen: what it turns for one turn of the motor, whose encoder tells it; 0 where that does not.
            x: state rows.
            p: parameter views.
        """
        if self.late is not None and seen:
            key, part = self.late
            angle, speed = x[self.rotor], x[self.rotor + 1]
            late = part.motion(p[key], angle, speed, x[self.row])
            value = value + seen * (late[channel[0] == "v"] - (angle, speed)[channel[0] == "v"])
        for key, sensor in self.sensors:
            if sensor.channel == channel:
                value = sensor.read(p[key], value)
        return value

    def relaxations(self, x: Sequence[Tensor], p: Views) -> list[tuple[int, Tensor, Tensor]]:
        """Row, drive and rate [1/s] of each state, ``dz/dt = drive - rate z``."""
        if self.late is None:
            return []
        key, part = self.late
        return [(self.row, *part.relaxation(p[key], x[self.rotor + 1]))]
