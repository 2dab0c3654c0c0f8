"""One joint of the machine: from the commanded voltage to what pushes rotor and link."""

from dataclasses import dataclass, field

import numpy as np

from hybrid_id.blind.physics.law import InputLaw, Lanes, Law, Push, Signals
from hybrid_id.blind.physics.motor import Motor
from hybrid_id.blind.physics.transmission import Gear, Spring


@dataclass
class Drive:
    """The chain of one joint; effects add to its lists or replace its parts.

    Attributes:
        gear: ratio and errors.
        rotor: inertia of the rotor [kg m^2].
        motor: torque of the motor.
        amplifier: laws between command and terminals, in their order.
        rotor_laws, link_laws: what acts on rotor and link.
        spring: None where rotor and link move as one.
        sensor_delay: age of the measured rotor angle [s], None: none.
    """

    gear: Gear
    rotor: Lanes
    motor: Motor
    amplifier: list[InputLaw] = field(default_factory=list)
    rotor_laws: list[Law] = field(default_factory=list)
    link_laws: list[Law] = field(default_factory=list)
    spring: Spring | None = None
    sensor_delay: Lanes | None = None

    def start(self, lanes: int, angle: np.ndarray) -> None:
        """Set the joint of B runs to rest at a link angle (B,) [rad]."""
        for law in (*self.rotor_laws, *self.link_laws, self.motor, *([self.spring] if self.spring else [])):
            law.start(lanes)
        self.x = x = Signals(lanes)
        x.q_m, x.q_a = angle * self.gear.ratio, angle.copy()
        self.needs_carried = any(law.needs_carried for law in self.rotor_laws)

    def push(self, time: float, step: float) -> None:
        """Move angles and, as the last step went, speeds on to the middle of the step, and sum what acts there."""
        x, half = self.x, 0.5 * step
        x.time, x.step = time + half, step
        x.q_m, x.v_m = x.q_m + half * x.v_m, _ahead(x.v_m, x.rise_m)
        self.slope = self.gear.slope(x.q_m)
        twist = rate = None
        if self.spring is None:
            x.q_a, x.v_a = self.gear.angle(x.q_m), self.slope * x.v_m
        else:
            x.q_a, x.v_a = x.q_a + half * x.v_a, _ahead(x.v_a, x.rise_a)
            twist, rate = self.gear.angle(x.q_m) - x.q_a, self.slope * x.v_m - x.v_a
        volts = x.command
        for law in self.amplifier:
            volts = law.volts(volts, x)
        x.volts = volts
        self.rotor_push, self.link_push = rotor, link = Push(), Push()
        self.motor.act(rotor, x)
        for law in self.rotor_laws:
            law.act(rotor, x)
        for law in self.link_laws:
            law.act(link, x)
        if self.spring is not None and twist is not None and rate is not None:
            torque = self.spring.torque(twist, rate, step)
            x.carried = self.slope * torque
            rotor.torque = rotor.torque - x.carried
            link.torque = link.torque + torque


def _ahead(speed: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Speed in the middle of a step that goes like the one before; what stands or is about to stop stays as it is."""
    middle = speed + 0.5 * rise
    return np.where(speed * middle > 0, middle, speed)
