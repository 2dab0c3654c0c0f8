"""Effects between the command and the motor's terminals."""

import numpy as np

from hybrid_id.blind.effects.base import Effect, dry, log_uniform, stall
from hybrid_id.blind.physics.input import Deadband, Delay, Saturation, SoftSaturation, SupplySag


class InputDelay(Effect):
    """Dead time before the amplifier."""

    name, place, sized, size_keys = "delay", "input", ("delay",), {"delay": "seconds"}

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"delay": log_uniform(rng, 0.003, 0.012)})

    def install(self, machine, robot):
        self.drive(machine).amplifier.insert(0, Delay(self.values["delay"]))


class MeasurementDelay(InputDelay):
    """Dead time behind the only encoder: the same from outside, up to what a controller makes of it."""

    place = "input"
    systems = ("one_link", "one_link_flexible")

    @classmethod
    def fits(cls, robot):
        return super().fits(robot) and not robot.link_encoder

    def install(self, machine, robot):
        self.drive(machine).sensor_delay = self.values["delay"]


class Threshold(Effect):
    """Nothing below a threshold, the whole command above it."""

    name, place, sized = "voltage_deadband", "input", ("volts",)
    shift = 0.0

    @classmethod
    def draw(cls, rng, robot, joint):
        breakaway = dry(robot, joint) / robot.value(joint, "P_m1")
        return cls(joint, {"volts": breakaway * rng.uniform(0.4, 1.5)})

    def install(self, machine, robot):
        self.drive(machine).amplifier.append(Deadband(self.values["volts"], self.shift))


class DeadZone(Threshold):
    """Nothing below a threshold, the command less the threshold above it."""

    place = "input"
    shift = 1.0


class HardLimit(Effect):
    """A supply below the largest commands, which cuts them."""

    name, place, sized, size_keys = "voltage_saturation", "input", ("excess",), {"volts": "volts"}
    soft = False

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"excess": rng.uniform(0.5, 2.0), "supply": robot.supply})

    @property
    def limit(self):
        """Highest voltage [V]."""
        return self.values["supply"] / (1 + self.values["excess"])

    def size(self):
        return Effect(self.joint, {"volts": self.limit}).size()

    def install(self, machine, robot):
        law = SoftSaturation(self.limit) if self.soft else Saturation(self.limit)
        self.drive(machine).amplifier.append(law)


class SoftLimit(HardLimit):
    """The same, neared gradually."""

    place, replaces = "input", True
    soft = True


class WeakSupply(Effect):
    """A supply whose voltage sags under load."""

    name, place, sized, size_keys = "supply_sag", "input", ("sag",), {"sag": "volts_per_newton_metre"}

    @classmethod
    def draw(cls, rng, robot, joint):
        sag = rng.uniform(0.1, 0.5) * robot.supply / stall(robot, joint)
        return cls(joint, {"sag": sag, "supply": robot.supply})

    def install(self, machine, robot):
        # beyond it the voltage that is left swings from step to step
        most = 0.9 / robot.value(self.joint, "P_m1")
        self.drive(machine).amplifier.append(
            SupplySag(np.minimum(self.values["sag"], most), self.values["supply"])
        )
