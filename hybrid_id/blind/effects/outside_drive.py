"""Effects that no table of names holds, between amplifier and gear."""

import numpy as np

from hybrid_id.blind.effects.base import dry, fast
from hybrid_id.blind.effects.outside import Outside
from hybrid_id.blind.physics.input import UnevenGain
from hybrid_id.blind.physics.motor import TorqueRipple
from hybrid_id.blind.physics.transmission import HystereticSpring


class CommutationRipple(Outside):
    """A ripple that grows with the motor's torque."""

    place, sized = "motor", ("share",)

    @classmethod
    def draw(cls, rng, robot, joint):
        values = {
            "share": rng.uniform(0.1, 0.5),
            "periods": float(rng.choice([1, 2, 3])),
            "phase": rng.uniform(0, 6.28),
        }
        return cls(joint, values)

    def law(self, robot):
        v = self.values
        return TorqueRipple(np.minimum(v["share"], 0.9), v["periods"], v["phase"])


class FieldWeakening(Outside):
    """A torque constant that falls with the speed."""

    place, sized = "motor", ("loss",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"loss": rng.uniform(0.3, 2.0)})

    def install(self, machine, robot):
        self.drive(machine).motor.weakening = fast(robot, self.joint) / np.sqrt(self.values["loss"])


class UnevenAmplifier(Outside):
    """An amplifier with more gain in one direction."""

    place, sized = "input", ("excess",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"excess": rng.uniform(0.03, 0.2)})

    def install(self, machine, robot):
        self.drive(machine).amplifier.append(UnevenGain(self.values["excess"]))


class HystereticGear(Outside):
    """A spring with losses that do not depend on speed, where the model's is linear."""

    place, sized, systems = "transmission", ("limit",), ("one_link_flexible",)
    replaces = True

    @classmethod
    def draw(cls, rng, robot, joint):
        limit = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 1.5)
        return cls(joint, {"limit": limit, "share": rng.uniform(0.3, 0.8)})

    def install(self, machine, robot):
        k = robot.values["k"]
        spring = HystereticSpring(k, robot.values["d"], self.values["share"] * k, self.values["limit"])
        self.drive(machine).spring = spring
