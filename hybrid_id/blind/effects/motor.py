"""Effects of winding and magnets."""

import numpy as np

from hybrid_id.blind.effects.base import Effect, dry, log_uniform, stall
from hybrid_id.blind.physics.motor import Cogging


class WindingLag(Effect):
    """First-order lag of the current, L / R."""

    name, place, sized, size_keys = "electrical_lag", "motor", ("lag",), {"lag": "seconds"}

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"lag": log_uniform(rng, 0.002, 0.012)})

    def install(self, machine, robot):
        self.drive(machine).motor.lag = self.values["lag"]


class CoggingTorque(Effect):
    """One period of torque over the rotor's angle."""

    name, place, sized = "cogging", "motor", ("amplitude",)
    size_keys = {"amplitude": "newton_metres", "periods": "periods_per_turn"}
    shapes, signed = ("phase",), ("phase",)
    overtone = 0.0

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(
            joint,
            {
                "amplitude": dry(robot, joint) * rng.uniform(0.3, 1.5),
                "periods": float(rng.choice([1, 2, 4, 6, 8, 12])),
                "phase": rng.uniform(0, 2 * np.pi),
            },
        )

    def install(self, machine, robot):
        v = self.values
        amplitudes, periods, phases = (v["amplitude"],), (v["periods"],), (v["phase"],)
        if self.overtone:
            amplitudes += (self.overtone * v["amplitude"],)
            periods += (2 * v["periods"],)
            phases += (2.7 * v["phase"],)
        self.drive(machine).rotor_laws.append(Cogging(amplitudes, periods, phases))


class CoggingWithOvertone(CoggingTorque):
    """The same with a second harmonic of a third: no magnet is a sine."""

    place = "motor"
    overtone = 0.33


class Warming(Effect):
    """Winding that warms with the square of its torque; its resistance rises and takes torque away."""

    name, place, sized = "thermal_derating", "motor", ("rise",)
    size_keys = {"rise": "relative_rise_of_resistance", "cooling": "seconds_of_cooling"}
    shapes = ("cooling",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"rise": rng.uniform(0.2, 0.8), "cooling": log_uniform(rng, 3.0, 30.0)})

    def install(self, machine, robot):
        motor, v = self.drive(machine).motor, self.values
        # the rise after 5 s at a quarter of the stall torque, were there no cooling
        motor.heating = v["rise"] / (5.0 * (0.25 * stall(robot, self.joint)) ** 2)
        motor.cooling = v["cooling"]
