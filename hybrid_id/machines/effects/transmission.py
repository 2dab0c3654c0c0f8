"""Effects of the gear."""

import numpy as np

from hybrid_id.machines.effects.base import Effect, link_inertia, stall, uniform
from hybrid_id.machines.physics.transmission import Gear, LinearSpring

RIGID = ("one_link", "two_link")
MOST_LOSS = 3.0
"""Most that the losses of an impact add to a contact's force, as a factor: steeper ones no step of a fit resolves."""


class FlatTeeth(Effect):
    """Play between flat teeth of a rigid gear, which touch beyond half of the gap.

    ``k p^n (1 + c p')`` of the depth p (Hunt and Crossley, 1975), at most ``MOST_LOSS k p^n``, never pulling; with
    contact k [N m/rad], loss c [s/rad] and n = 1 for flat teeth.
    """

    name, place, sized = "backlash", "transmission", ("gap",)
    systems = RIGID
    exponent, substeps, replaces = 1.0, 4, True
    drawn = {
        "gap": uniform(0.004, 0.04, log=True),
        "contact": lambda rng, robot, joint: (
            link_inertia(robot, joint) * (2 * np.pi * rng.uniform(25, 50)) ** 2
        ),
        "loss": uniform(1.0, 8.0, log=True),
    }

    def torque(self, twist, rate, step):
        v, side = self.values, np.sign(twist)
        # a stiffness per power of depth that gives the same force one milliradian deep
        contact = v["contact"] * 1e-3 ** (1 - self.exponent)
        depth = np.maximum(np.abs(twist) - 0.5 * v["gap"], 0.0)
        return side * contact * depth**self.exponent * np.clip(1 + v["loss"] * side * rate, 0.0, MOST_LOSS)


class RoundTeeth(FlatTeeth):
    """Play between round teeth (Hertz)."""

    exponent = 1.5


class PlayBeforeSpring(Effect):
    """Play in series with the spring of a flexible gear, which carries beyond half of the gap and never pulls."""

    name, place, sized = "backlash", "transmission", ("gap",)
    systems, replaces = ("one_link_flexible",), True
    drawn = {"gap": uniform(0.005, 0.05, log=True)}

    def torque(self, twist, rate, step):
        side, own = np.sign(twist), self.robot.values
        depth = np.abs(twist) - 0.5 * self.values["gap"]
        force = own["k"] * depth + own["d"] * side * rate
        return np.where(depth > 0, side * np.maximum(force, 0.0), 0.0)


class SoftGear(Effect):
    """A spring where the model is rigid."""

    name, place, sized, systems = "joint_flexibility", "transmission", ("compliance",), RIGID
    shapes, replaces = ("ratio",), True
    drawn = {
        "compliance": lambda rng, robot, joint: (
            1 / (link_inertia(robot, joint) * (2 * np.pi * rng.uniform(3, 9)) ** 2)
        ),
        "ratio": uniform(0.03, 0.2),
    }

    def spring(self, robot):
        """Stiffness and damping of the linear spring."""
        stiffness = 1 / self.values["compliance"]
        damping = 2 * self.values["ratio"] * np.sqrt(stiffness * link_inertia(robot, self.joint))
        return stiffness, damping

    def install(self, machine, robot):
        self.drive(machine).spring = LinearSpring(*self.spring(robot))


class SlightlyHardSoftGear(SoftGear):
    """The same, a little stiffer far out, as no gear is linear."""

    def install(self, machine, robot):
        k, damping = self.spring(robot)
        twist = 0.3 * stall(robot, self.joint) * robot.ratio[self.joint] / k
        self.drive(machine).spring = LinearSpring(k, damping, 0.1 * k / twist**2)


class CubicSpring(Effect):
    """A cubic spring where the model's is linear."""

    name, place, sized = "hardening_flexibility", "transmission", ("stiffening",)
    systems = ("one_link_flexible",)
    drawn, replaces = {"stiffening": uniform(1.0, 20.0, log=True)}, True

    def install(self, machine, robot):
        k = robot.values["k"]
        twist = stall(robot, self.joint) * robot.ratio[self.joint] / k
        stiffer = self.values["stiffening"] * k / twist**2
        self.drive(machine).spring = LinearSpring(k, robot.values["d"], stiffer)


class SteppedSpring(CubicSpring):
    """A spring that gets stiffer beyond a knee: teeth that come to bear one after the other."""

    install = Effect.install

    def torque(self, twist, rate, step):
        robot, k = self.robot, self.robot.values["k"]
        knee = 0.04 * stall(robot, self.joint) * robot.ratio[self.joint] / k
        beyond = np.sign(twist) * np.maximum(np.abs(twist) - knee, 0.0)
        return k * (twist + self.values["stiffening"] * beyond) + robot.values["d"] * rate


class GearError(Effect):
    """A ratio that waves with the rotor's angle."""

    name, place, sized = "kinematic_error", "transmission", ("error",)
    shapes, signed = ("phase",), ("phase",)
    overtone = 0.0

    @classmethod
    def draw(cls, rng, robot, joint):
        periods = float(rng.choice([0.5, 1, 1, 2, 2]))
        error = rng.uniform(0.05, 0.3) / (robot.ratio[joint] * periods)
        return cls(joint, {"error": error, "periods": periods, "phase": rng.uniform(0, 2 * np.pi)})

    def install(self, machine, robot):
        v, ratio = self.values, robot.ratio[self.joint]
        # the map must rise everywhere
        error = np.minimum(v["error"], 0.6 / (ratio * v["periods"]))
        errors, periods, phases = (error,), (v["periods"],), (v["phase"],)
        if self.overtone:
            errors += (self.overtone * error,)
            periods += (2 * v["periods"],)
            phases += (1.7 * v["phase"],)
        self.drive(machine).gear = Gear(ratio, errors, periods, phases)


class GearErrorWithOvertone(GearError):
    """The same with a second harmonic."""

    overtone = 0.25
