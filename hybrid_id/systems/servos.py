"""Servos that are known by name: what their data sheets say, as start values of a drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hybrid_id.components.friction.viscous import Viscous
from hybrid_id.components.input.position_servo import PositionServo
from hybrid_id.parameters import Bounded

ROOM = 5.0
"""How many times larger or smaller than by the data sheet a fit may find it."""


@dataclass(frozen=True)
class Servo:
    """A servo with a proportional loop from position error to duty.

    Attributes:
        stall: torque at the joint at full duty and standstill [N m], at ``voltage``.
        no_load: speed at full duty without load [rad/s], at ``voltage``.
        voltage: supply [V].
        duty_per_gain: duty per error and register P [1/rad].
        source: where the numbers come from.
    """

    stall: float
    no_load: float
    voltage: float
    duty_per_gain: float
    source: str


SERVOS: Mapping[str, Servo] = {
    "sts3215": Servo(
        2.94,
        4.71,
        12.0,
        0.165,
        "Feetech STS3215-C018; duty as K-Scale measured it",
    ),
    "xl330_m288": Servo(
        0.52, 10.8, 5.0, 4096 / (2 * math.pi) / 256 / 885, "Robotis XL330-M288-T; duty by Rhoban BAM"
    ),
}
"""Servos by the name that a model file gives them."""


def drive_of(
    servo: Servo,
    gain: float,
    gear_ratio: float = 1.0,
    voltage: float | None = None,
    goals: tuple[float, float] | None = None,
) -> tuple[PositionServo, Viscous]:
    """Position loop and viscous friction; the back-EMF is part of the friction.

    Stall torque and no-load speed grow with the supply, so that their ratio stays.

    Args:
        servo: by its data sheet.
        gain: value of the register P.
        gear_ratio: motor turns per joint turn in the model; 1 where its motors are seen at their joints.
        voltage: supply [V]; the data sheet's where it is None.
        goals: least and largest goal [rad], which no data sheet knows; None where there is no limit.
    """
    stall = servo.stall * (1.0 if voltage is None else voltage / servo.voltage)
    stiffness, friction = gain * servo.duty_per_gain * stall, servo.stall / servo.no_load / gear_ratio**2
    limits = {} if goals is None else dict(zip(("goal_min", "goal_max"), goals, strict=True))
    loop = PositionServo(
        k_p=Bounded(stiffness, stiffness / ROOM, stiffness * ROOM, "N m/rad"),
        tau_max=Bounded(stall, stall / ROOM, stall * ROOM, "N m", False),
        **limits,
    )
    return loop, Viscous(F_v=Bounded(friction, 0.0, friction * ROOM, "N m s/rad"))
