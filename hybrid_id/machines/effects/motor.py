"""Effects between the command and the rotor: amplifier, winding, magnets."""

import numpy as np

from hybrid_id.machines.effects.base import Effect, choice, dry, stall, supply, uniform
from hybrid_id.machines.physics.motor import Cogging


class InputDelay(Effect):
    """Dead time before the amplifier: ``u(t - delay)``, in fractions of a sample too, as its mean over a step."""

    name, place, sized = "delay", "input", ("delay",)
    drawn = {"delay": uniform(0.003, 0.012, log=True)}

    def volts(self, volts, x):
        ends = [(x.time + side * x.step - self.values["delay"]) / x.sample_time for side in (-0.5, 0.5)]
        first, last = (np.floor(end + 1e-9) for end in ends)
        # a step is no longer than a sample: at most one change of the held command falls into it
        new = np.where(last > first, (ends[1] - last) * x.sample_time / x.step, 1.0)
        return (1 - new) * x.commanded(first) + new * x.commanded(last)

    def install(self, machine, robot):
        self.drive(machine).amplifier.insert(0, self.law(robot))


class Threshold(Effect):
    """Nothing below a threshold, the whole command above it."""

    name, place, sized = "voltage_deadband", "input", ("volts",)
    drawn = {"volts": uniform(0.4, 1.5, lambda robot, joint: dry(robot, joint) / robot.value(joint, "P_m1"))}
    shift = 0.0

    def volts(self, volts, x):
        size, threshold = np.abs(volts), self.values["volts"]
        return np.where(size > threshold, np.sign(volts) * (size - self.shift * threshold), 0.0)


class DeadZone(Threshold):
    """Nothing below a threshold, the command less the threshold above it."""

    shift = 1.0


class HardLimit(Effect):
    """A supply below the largest commands, which cuts them."""

    name, place, sized = "voltage_saturation", "input", ("excess",)
    drawn = {"excess": uniform(0.5, 2.0), "supply": supply}

    @property
    def limit(self):
        """Highest voltage [V]."""
        return self.values["supply"] / (1 + self.values["excess"])

    def volts(self, volts, x):
        return np.clip(volts, -self.limit, self.limit)


class SoftLimit(HardLimit):
    """The same, neared gradually: ``u / (1 + |u / limit|^8)^(1/8)``."""

    replaces = True

    def volts(self, volts, x):
        return volts / (1 + np.abs(volts / self.limit) ** 8.0) ** (1 / 8.0)


class WeakSupply(Effect):
    """A weak supply behind a PWM amplifier: ``u - sag d^2 T`` with the duty ``d = u / supply`` and the motor torque T.

    The source carries ``d`` times the winding's current, and the winding sees ``d`` times what it is left with; ``sag``
    [V/(N m)], ``supply`` [V]. Braking pumps it up.
    """

    name, place, sized = "supply_sag", "input", ("sag",)
    drawn = {
        "sag": uniform(0.1, 0.5, lambda robot, joint: robot.supply / stall(robot, joint)),
        "supply": supply,
    }

    def volts(self, volts, x):
        v = self.values
        # beyond it the voltage that is left swings from step to step
        most = 0.9 / self.robot.value(self.joint, "P_m1")
        return volts - np.minimum(v["sag"], most) * (volts / v["supply"]) ** 2 * x.effort


class WindingLag(Effect):
    """First-order lag of the current, L / R."""

    name, place, sized = "electrical_lag", "motor", ("lag",)
    drawn = {"lag": uniform(0.002, 0.012, log=True)}

    def install(self, machine, robot):
        self.drive(machine).motor.lag = self.values["lag"]


class CoggingTorque(Effect):
    """One period of torque over the rotor's angle."""

    name, place, sized = "cogging", "motor", ("amplitude",)
    shapes, signed = ("phase",), ("phase",)
    drawn = {
        "amplitude": uniform(0.3, 1.5, dry),
        "periods": choice([1, 2, 4, 6, 8, 12]),
        "phase": uniform(0, 2 * np.pi),
    }
    overtone = 0.0

    def law(self, robot):
        v = self.values
        return Cogging(
            (v["amplitude"], self.overtone * v["amplitude"]),
            (v["periods"], 2 * v["periods"]),
            (v["phase"], 2.7 * v["phase"]),
        )


class CoggingWithOvertone(CoggingTorque):
    """The same with a second harmonic of a third: no magnet is a sine."""

    overtone = 0.33


class Warming(Effect):
    """Winding that warms with the square of its torque; its resistance rises and takes torque away."""

    name, place, sized = "thermal_derating", "motor", ("rise",)
    shapes = ("cooling",)
    drawn = {"rise": uniform(0.2, 0.8), "cooling": uniform(3.0, 30.0, log=True)}

    def install(self, machine, robot):
        motor, v = self.drive(machine).motor, self.values
        # the rise after 5 s at a quarter of the stall torque, were there no cooling
        motor.heating = v["rise"] / (5.0 * (0.25 * stall(robot, self.joint)) ** 2)
        motor.cooling = v["cooling"]
