"""Effects that no table of names holds; a diagnosis should say so, and where they act."""

import numpy as np

from hybrid_id.machines.effects.base import UNKNOWN, Effect, dry, fast, link_inertia
from hybrid_id.machines.physics import friction, load
from hybrid_id.machines.physics.motor import TorqueRipple, UnevenGain
from hybrid_id.machines.physics.transmission import HystereticSpring
from hybrid_id.machines.robots import log_uniform


class Outside(Effect):
    """An effect that no table of names holds."""

    name = UNKNOWN


class GrowingFriction(Outside):
    """Dry friction that grows while a record runs."""

    place, sized = "motor_friction", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"F": dry(robot, joint) * rng.uniform(0.5, 2.0), "T": rng.uniform(2.0, 8.0)})

    def law(self, robot):
        return friction.WearingIn(self.values["F"], self.values["T"])


class ThinningGrease(Outside):
    """Viscous friction that falls with the work done on it."""

    place, sized = "motor_friction", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = fast(robot, joint)
        F = dry(robot, joint) * rng.uniform(0.5, 2.0) / speed
        return cls(joint, {"F": F, "E_0": F * speed**2 * rng.uniform(0.2, 1.0)})

    def law(self, robot):
        return friction.WarmingGear(self.values["F"], self.values["E_0"])


class StickAfterRest(Outside):
    """Breakaway that grows with the time at rest."""

    place, sized = "motor_friction", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        F = dry(robot, joint) * rng.uniform(1.0, 3.0)
        return cls(joint, {"F": F, "T": rng.uniform(0.05, 0.4), "slip": rng.uniform(1.0, 8.0)})

    def law(self, robot):
        return friction.StickAfterRest(self.values["F"], self.values["T"], self.values["slip"])


class CubicDrag(Outside):
    """Drag with the third power of the speed."""

    place, sized = "motor_friction", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"F": dry(robot, joint) * rng.uniform(0.5, 2.0) / fast(robot, joint) ** 3})

    def law(self, robot):
        return friction.Power(self.values["F"], exponent=3.0)


class Groove(Outside):
    """A latch at one angle of the link."""

    place, sized = "load", ("A",)

    @classmethod
    def draw(cls, rng, robot, joint):
        A = dry(robot, joint) * robot.ratio[joint] * rng.uniform(1.0, 4.0)
        return cls(joint, {"A": A, "q_0": rng.uniform(-0.3, 0.3), "width": rng.uniform(0.03, 0.12)})

    def law(self, robot):
        return load.Latch(self.values["A"], self.values["q_0"], self.values["width"])


class ToolContact(Outside):
    """A soft obstacle on one side."""

    place, sized = "load", ("k", "d")

    @classmethod
    def draw(cls, rng, robot, joint):
        k = dry(robot, joint) * robot.ratio[joint] * log_uniform(rng, 2.0, 20.0)
        side = rng.choice([-1, 1]) * rng.uniform(0.1, 0.4)
        return cls(joint, {"k": k, "d": 0.05 * k, "start_at": side})

    def law(self, robot):
        return load.SoftStop(self.values["start_at"], self.values["k"], self.values["d"])


class TorquePulses(Outside):
    """Pulses of torque from outside."""

    place, sized = "load", ("torque",)

    @classmethod
    def draw(cls, rng, robot, joint):
        torque = dry(robot, joint) * robot.ratio[joint] * rng.uniform(1.0, 4.0)
        period = rng.uniform(0.7, 2.5)
        values = {
            "torque": torque,
            "first": rng.uniform(0.3, 1.0),
            "period": period,
            "length": rng.uniform(0.05, 0.2),
        }
        return cls(joint, values)

    def law(self, robot):
        v = self.values
        return load.Pulses(v["torque"], float(v["first"]), float(v["period"]), float(v["length"]))


class ShakenFrame(Outside):
    """A torque that is periodic in time."""

    place, sized = "load", ("A",)

    @classmethod
    def draw(cls, rng, robot, joint):
        A = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.5, 2.0)
        return cls(joint, {"A": A, "f": rng.uniform(0.5, 6.0), "phase": rng.uniform(0, 2 * np.pi)})

    def law(self, robot):
        return load.PeriodicTorque(self.values["A"], float(self.values["f"]), float(self.values["phase"]))


class MountedMass(Outside):
    """A second mass on the link with a resonance of its own; behind a rigid gear, a flexible joint does the same."""

    place, sized, systems = "load", ("J_2",), ("one_link_flexible",)

    @classmethod
    def draw(cls, rng, robot, joint):
        J_2 = link_inertia(robot, joint) * rng.uniform(0.2, 0.8)
        frequency = 2 * np.pi * rng.uniform(1.0, 4.0)
        return cls(joint, {"J_2": J_2, "frequency": frequency, "damping": rng.uniform(0.02, 0.1)})

    def law(self, robot):
        return load.SecondMass(self.values["J_2"], self.values["frequency"], float(self.values["damping"]))


class DrivenSlowMotion(Outside):
    """Negative damping of slow motion."""

    place, sized = "load", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = rng.uniform(0.1, 0.4) * fast(robot, joint) / robot.ratio[joint]
        F = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 1.0) / speed
        return cls(joint, {"F": F, "v_0": speed})

    def law(self, robot):
        return load.NegativeDamping(self.values["F"], self.values["v_0"])


class Wind(Outside):
    """Air that moves past the link."""

    place, sized = "load", ("c",)

    @classmethod
    def draw(cls, rng, robot, joint):
        wind = rng.choice([-1, 1]) * rng.uniform(0.5, 2.0)
        c = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 1.5) / wind**2
        return cls(joint, {"c": c, "wind": wind})

    def law(self, robot):
        most = 0.9 * dry(robot, self.joint) * robot.ratio[self.joint]  # the joint still starts at rest
        wind = self.values["wind"]
        return load.Windage(np.minimum(self.values["c"], most / wind**2), wind)


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

    def law(self, robot):
        return UnevenGain(self.values["excess"])


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
