"""What may act at a joint of an arm beyond its description, dominant or small."""

import numpy as np

from hybrid_id.machines.effects.base import UNKNOWN, Acting, Effect
from hybrid_id.machines.physics.friction import LoadDependent, PositionDependent, Stribeck, Uneven
from hybrid_id.machines.physics.load import ConstantTorque, RestSpring
from hybrid_id.machines.physics.machine import Drive
from hybrid_id.machines.physics.motor import Delay
from hybrid_id.machines.physics.transmission import LinearSpring

TWIST_DAMPING = 0.004
"""Damping of a gear that gives way, by its stiffness [s]."""


class ArmEffect(Effect):
    """An effect at one joint of an arm.

    Attributes:
        for_torque: whether arms whose torques are commanded may have it, and not those with servos alone.
    """

    systems = ("robot",)
    for_torque = True

    @classmethod
    def fits(cls, robot):
        return super().fits(robot) and (robot.servo or cls.for_torque)

    @classmethod
    def small(cls, rng, robot, joint, grown):
        """A small one, larger on one arm than on another by a factor; None where there are none."""
        return None


class ArmStribeck(ArmEffect):
    """Breakaway above Coulomb."""

    name, place, sized, shapes = "stribeck_friction", "motor_friction", ("drop",), ("slip",)

    @classmethod
    def draw(cls, rng, robot, joint):
        drop = robot.value(joint, "F_c") * rng.uniform(0.9, 2.1)
        return cls(joint, {"drop": drop, "slip": rng.uniform(0.06, 0.22)})

    @classmethod
    def small(cls, rng, robot, joint, grown):
        drop = grown * robot.value(joint, "F_c") * rng.uniform(0.01, 0.07)
        return cls(joint, {"drop": drop, "slip": rng.uniform(0.06, 0.22)})

    def law(self, robot):
        return Stribeck(self.values["drop"], self.values["slip"])


class ArmLoadFriction(ArmEffect):
    """Dry friction with the torque of the motor."""

    name, place, sized = "load_dependent_friction", "motor_friction", ("load",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"load": rng.uniform(0.14, 0.36)})

    def law(self, robot):
        return LoadDependent(self.values["load"], by_effort=True)


class ArmUneven(ArmEffect):
    """A share of the dry friction by which one direction has more, the other less."""

    name, place, sized, signed = "asymmetric_friction", "motor_friction", ("uneven",), ("uneven",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"uneven": rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.75)})

    @classmethod
    def small(cls, rng, robot, joint, grown):
        return cls(joint, {"uneven": grown * rng.uniform(-0.025, 0.025)})

    def law(self, robot):
        return Uneven(2.0 * np.clip(self.values["uneven"], -0.97, 0.97) * robot.value(self.joint, "F_c"))


class ArmRipple(ArmEffect):
    """A share of the dry friction that waves over the joint's angle."""

    name, place, sized = "position_dependent_friction", "motor_friction", ("ripple",)
    shapes, signed = ("waves", "phase"), ("phase",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, cls._shaped(rng, rng.uniform(0.55, 0.92)))

    @classmethod
    def small(cls, rng, robot, joint, grown):
        return cls(joint, cls._shaped(rng, grown * rng.uniform(0.004, 0.03)))

    @staticmethod
    def _shaped(rng, ripple):
        return {"ripple": ripple, "waves": rng.uniform(2.2, 5.2), "phase": rng.uniform(-np.pi, np.pi)}

    def law(self, robot):
        v, level = self.values, robot.value(self.joint, "F_c")
        return PositionDependent(np.minimum(v["ripple"], 0.97) * level, v["waves"], v["phase"], mean=0.0)


class ArmSpring(ArmEffect):
    """A cable that pulls towards a rest angle."""

    name, place, sized, shapes, signed = "spring_load", "load", ("spring",), ("rest",), ("rest",)

    @classmethod
    def draw(cls, rng, robot, joint):
        spring = robot.moment[joint] * rng.uniform(0.6, 1.6)
        return cls(joint, {"spring": spring, "rest": rng.uniform(-0.55, 0.55)})

    def law(self, robot):
        return RestSpring(self.values["spring"], self.values["rest"])


class ArmBias(ArmEffect):
    """A constant torque."""

    name, place, sized, signed = "constant_torque", "load", ("bias",), ("bias",)

    @classmethod
    def draw(cls, rng, robot, joint):
        side = rng.choice([-1.0, 1.0])
        return cls(joint, {"bias": side * robot.moment[joint] * rng.uniform(0.28, 0.62)})

    def law(self, robot):
        return ConstantTorque(self.values["bias"])


class EncoderZero(ArmEffect):
    """An encoder whose zero is another than that of which the goals speak."""

    name, place, sized, signed, for_torque = "encoder_zero", "sensor", ("zero",), ("zero",), False

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"zero": rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(1.9, 4.2))})

    @classmethod
    def small(cls, rng, robot, joint, grown):
        return cls(joint, {"zero": grown * np.radians(rng.uniform(-0.02, 0.02))})

    def install(self, machine, robot):
        drive = self.drive(machine)
        drive.sensor_zero = drive.sensor_zero + self.values["zero"]


class ArmDelay(ArmEffect):
    """Dead time of the goals; to the first order it is a lag."""

    name, place, sized, for_torque = "delay", "input", ("delay",), False
    alias = ("electrical_lag", "motor")

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"delay": rng.uniform(0.018, 0.055)})

    def install(self, machine, robot):
        self.drive(machine).amplifier.insert(0, Delay(self.values["delay"]))


class GoalRateLimit(ArmEffect):
    """A servo that follows its goal with a largest rate [rad/s]; it begins where the first one is."""

    name, place, sized, for_torque, replaces = "goal_rate_limit", "input", ("rate",), False, True
    memory = ("aim",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"rate": rng.uniform(0.75, 1.45)})

    def volts(self, volts, x, m):
        most = self.values["rate"] * x.step
        followed = m._aim + np.minimum(np.maximum(volts - m._aim, -most), most)
        m._aim = np.where(x.time < x.step, volts, followed)
        return m._aim


class ArmSoftGear(ArmEffect):
    """A gear that gives way."""

    name, place, sized, replaces = "joint_flexibility", "transmission", ("twist",), True

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"twist": robot.moment[joint] * rng.uniform(11.0, 28.0)})

    def install(self, machine, robot):
        k = self.values["twist"]
        self.drive(machine).spring = LinearSpring(k, TWIST_DAMPING * k)


class LinkMass(ArmEffect):
    """A link that is heavier or lighter than described by a share; all joints that carry it feel it.

    It acts on the links themselves, see `hybrid_id.machines.arm.Arm.assemble`.
    """

    name, place, sized, signed = "link_mass", "load", ("mass",), ("mass",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"mass": rng.choice([-0.48, 0.72]) * rng.uniform(0.9, 1.12)})

    @classmethod
    def small(cls, rng, robot, joint, grown):
        return cls(joint, {"mass": grown * rng.uniform(-0.022, 0.022)})


class Nameless(Acting):
    """A torque and a factor on dry friction, of which is kept what they were in the mean of each sample.

    Attributes:
        trace: torque [N m] and factor, (2, T, B).
        drives: of all joints.
    """

    trace: np.ndarray | None = None
    drives: list[Drive]

    def act(self, push, x):
        if self.trace is None:
            self.trace = np.zeros((2, *x.history.shape))
        torque, factor = self.effect.of(x, self)
        if x.time > 0:
            self.trace[:, int(x.time / x.sample_time)] += np.array([torque, factor]) * x.step / x.sample_time
        push.torque = push.torque + torque
        push.plus, push.minus = push.plus * factor, push.minus * factor


class ArmOutside(ArmEffect):
    """An effect that no table of names holds: a torque at a joint, or a factor on its dry friction."""

    name = UNKNOWN

    def of(self, x, m):
        """Torque (B,) [N m] and factor (B,)."""
        raise NotImplementedError

    def install(self, machine, robot):
        """Build it in last of all, since it changes what others add."""
        law = Nameless(self, robot)
        law.drives = machine.drives
        self.drive(machine).rotor_laws.append(law)


class FrictionOverOtherJoint(ArmOutside):
    """Dry friction that waves over the angle q of another joint, ``1 + share sin(waves q + phase)``."""

    place, sized, formula = "motor_friction", ("share",), "friction_over_other_joint"

    @classmethod
    def draw(cls, rng, robot, joint):
        other = float(rng.choice([k for k in range(robot.joints) if k != joint]))
        shape = {"waves": rng.uniform(2.0, 4.4), "phase": rng.uniform(-np.pi, np.pi), "other": other}
        return cls(joint, {"share": rng.uniform(0.66, 0.95)} | shape)

    def of(self, x, m):
        v, angle = self.values, m.drives[int(self.values["other"])].x.q_a
        return 0.0 * angle, 1.0 + v["share"] * np.sin(v["waves"] * angle + v["phase"])


class TorqueOverTime(ArmOutside):
    """A torque by a clock of its own [Hz], not that of the record."""

    place, sized, formula = "load", ("torque",), "torque_over_time"

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(
            joint, {"torque": robot.moment[joint] * rng.uniform(0.22, 0.5), "rate": rng.uniform(0.35, 0.9)}
        )

    def of(self, x, m):
        turn = 2 * np.pi * self.values["rate"] * x.time + m.robot.phase
        return self.values["torque"] * np.sin(turn + 1.7 * np.sin(0.37 * turn)), np.ones_like(turn)


class Latch(ArmOutside):
    """A detent that holds to the side from which the joint has come: a torque with a memory of the last end [rad]."""

    place, sized, formula, memory = "load", ("torque",), "latch", ("side",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(
            joint, {"torque": robot.moment[joint] * rng.uniform(0.16, 0.4), "reach": rng.uniform(0.18, 0.4)}
        )

    def of(self, x, m):
        m._side = np.where(np.abs(x.q_a) > self.values["reach"], np.sign(x.q_a), m._side)
        return np.where(m._side < 0, -1.0, 1.0) * self.values["torque"], np.ones_like(x.q_a)


class RunningIn(ArmOutside):
    """Dry friction that falls while the joint travels [rad], anew in every record: ``1 + share exp(-way / travel)``."""

    place, sized, formula, memory = "motor_friction", ("share",), "running_in", ("way",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"share": rng.uniform(1.3, 3.2), "travel": rng.uniform(0.9, 2.6)})

    def of(self, x, m):
        m._way = m._way + np.abs(x.v_a) * x.step
        return 0.0 * m._way, 1.0 + self.values["share"] * np.exp(-m._way / self.values["travel"])
