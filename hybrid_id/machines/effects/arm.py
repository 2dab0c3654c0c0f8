"""What may act at a joint of an arm beyond its description, dominant or small."""

from typing import Any

import numpy as np

from hybrid_id.machines.effects.base import UNKNOWN, Effect, uniform
from hybrid_id.machines.effects.friction import EffortFriction, StribeckGaussian
from hybrid_id.machines.effects.load import Bias, Hose
from hybrid_id.machines.effects.motor import InputDelay
from hybrid_id.machines.physics.transmission import LinearSpring

TWIST_DAMPING = 0.004
"""Damping of a gear that gives way, by its stiffness [s]."""


def level(arm, joint):
    """Dry friction of a joint [N m]."""
    return arm.value(joint, "F_c")


def moment(arm, joint):
    """Torque of the weight that a joint carries [N m]."""
    return arm.moment[joint]


def degrees(arm, joint):
    """An angle of one degree [rad]."""
    return np.pi / 180


class ArmEffect(Effect):
    """An effect at one joint of an arm.

    Attributes:
        for_torque: whether arms whose torques are commanded may have it, and not those with servos alone.
        small: how each value of a small one is drawn; empty where there are none.
    """

    systems = ("robot",)
    for_torque = True
    small = {}

    @classmethod
    def fits(cls, robot):
        return super().fits(robot) and (robot.servo or cls.for_torque)

    @classmethod
    def draw_small(cls, rng, arm, joint, grown):
        """A small one, larger on one arm than on another by a factor."""
        return cls(joint, {key: draw(rng, arm, joint) for key, draw in cls.small.items()}).scaled(grown)


class ArmStribeck(ArmEffect, StribeckGaussian):
    """Breakaway above Coulomb."""

    drawn = {"drop": uniform(0.9, 2.1, level), "v_s": uniform(0.06, 0.22)}
    small = drawn | {"drop": uniform(0.01, 0.07, level)}


class ArmLoadFriction(ArmEffect, EffortFriction):
    """Dry friction with the torque of the motor."""

    drawn = {"mu": uniform(0.14, 0.36)}


class ArmUneven(ArmEffect):
    """A share of the dry friction by which one direction has more, the other less."""

    name, place, sized, signed = "asymmetric_friction", "motor_friction", ("uneven",), ("uneven",)
    drawn = {"uneven": uniform(0.4, 0.75, either=True)}
    small = {"uneven": uniform(-0.025, 0.025)}

    def act(self, push, x):
        more = np.clip(self.values["uneven"], -0.97, 0.97) * level(self.robot, self.joint)
        push.plus, push.minus = push.plus + more, push.minus - more


class ArmRipple(ArmEffect):
    """A share of the dry friction that waves over the joint's angle: ``share F_c sin(n q + phase)``."""

    name, place, sized = "position_dependent_friction", "motor_friction", ("ripple",)
    shapes, signed = ("waves", "phase"), ("phase",)
    drawn = {
        "ripple": uniform(0.55, 0.92),
        "waves": uniform(2.2, 5.2),
        "phase": uniform(-np.pi, np.pi),
    }
    small = drawn | {"ripple": uniform(0.004, 0.03)}

    def act(self, push, x):
        v, most = self.values, level(self.robot, self.joint)
        push.dry(np.minimum(v["ripple"], 0.97) * most * np.sin(v["waves"] * x.q_a + v["phase"]))


class ArmSpring(ArmEffect, Hose):
    """A cable that pulls towards a rest angle."""

    drawn = {"k": uniform(0.6, 1.6, moment), "rest": uniform(-0.55, 0.55)}


class ArmBias(ArmEffect, Bias):
    """A constant torque."""

    drawn = {"bias": uniform(0.28, 0.62, moment, either=True)}
    install = Effect.install


class EncoderZero(ArmEffect):
    """An encoder whose zero is another than that of which the goals speak."""

    name, place, sized, signed, for_torque = "encoder_zero", "sensor", ("zero",), ("zero",), False
    drawn = {"zero": uniform(1.9, 4.2, degrees, either=True)}
    small = {"zero": uniform(-0.02, 0.02, degrees)}

    def install(self, machine, robot):
        drive = self.drive(machine)
        drive.sensor_zero = drive.sensor_zero + self.values["zero"]


class ArmDelay(ArmEffect, InputDelay):
    """Dead time of the goals; to the first order it is a lag."""

    alias, for_torque = ("electrical_lag", "motor"), False
    drawn = {"delay": uniform(0.018, 0.055)}


class GoalRateLimit(ArmEffect):
    """A servo that follows its goal with a largest rate [rad/s]; it begins where the first one is."""

    name, place, sized, for_torque, replaces = "goal_rate_limit", "input", ("rate",), False, True
    drawn, memory = {"rate": uniform(0.75, 1.45)}, ("aim",)

    def volts(self, volts, x):
        most = self.values["rate"] * x.step
        followed = self._aim + np.minimum(np.maximum(volts - self._aim, -most), most)
        self._aim = np.where(x.time < x.step, volts, followed)
        return self._aim


class ArmSoftGear(ArmEffect):
    """A gear that gives way."""

    name, place, sized, replaces = "joint_flexibility", "transmission", ("twist",), True
    drawn = {"twist": uniform(11.0, 28.0, moment)}

    def install(self, machine, robot):
        k = self.values["twist"]
        self.drive(machine).spring = LinearSpring(k, TWIST_DAMPING * k)


class LinkMass(ArmEffect):
    """A link that is heavier or lighter than described by a share; all joints that carry it feel it.

    It acts on the links themselves, see `hybrid_id.machines.arm.Arm.assemble`.
    """

    name, place, sized, signed = "link_mass", "load", ("mass",), ("mass",)
    drawn = {"mass": lambda rng, arm, joint: rng.choice([-0.48, 0.72]) * rng.uniform(0.9, 1.12)}
    small = {"mass": uniform(-0.022, 0.022)}


class ArmOutside(ArmEffect):
    """An effect that no table of names holds: a torque at a joint, or a factor on its dry friction.

    Attributes:
        trace: torque [N m] and factor in the mean of each sample, (2, T, B).
        drives: of all joints.
    """

    name = UNKNOWN
    trace: Any = None
    drives: Any

    def of(self, x):
        """Torque (B,) [N m] and factor (B,)."""
        raise NotImplementedError

    def act(self, push, x):
        if self.trace is None:
            self.trace = np.zeros((2, *x.history.shape))
        torque, factor = self.of(x)
        if x.time > 0:
            self.trace[:, int(x.time / x.sample_time)] += np.array([torque, factor]) * x.step / x.sample_time
        push.torque = push.torque + torque
        push.plus, push.minus = push.plus * factor, push.minus * factor

    def install(self, machine, robot):
        """Build it in last of all, since it changes what others add."""
        law = self.law(robot)
        law.drives = machine.drives
        self.drive(machine).rotor_laws.append(law)


class FrictionOverOtherJoint(ArmOutside):
    """Dry friction that waves over the angle q of another joint, ``1 + share sin(waves q + phase)``."""

    place, sized, formula = "motor_friction", ("share",), "friction_over_other_joint"
    drawn = {
        "other": lambda rng, arm, joint: float(rng.choice([k for k in range(arm.joints) if k != joint])),
        "waves": uniform(2.0, 4.4),
        "phase": uniform(-np.pi, np.pi),
        "share": uniform(0.66, 0.95),
    }

    def of(self, x):
        v, angle = self.values, self.drives[int(self.values["other"])].x.q_a
        return 0.0 * angle, 1.0 + v["share"] * np.sin(v["waves"] * angle + v["phase"])


class TorqueOverTime(ArmOutside):
    """A torque by a clock of its own [Hz], not that of the record."""

    place, sized, formula = "load", ("torque",), "torque_over_time"
    drawn = {"torque": uniform(0.22, 0.5, moment), "rate": uniform(0.35, 0.9)}

    def of(self, x):
        turn = 2 * np.pi * self.values["rate"] * x.time + self.robot.phase
        return self.values["torque"] * np.sin(turn + 1.7 * np.sin(0.37 * turn)), np.ones_like(turn)


class Latch(ArmOutside):
    """A detent that holds to the side from which the joint has come: a torque with a memory of the last end [rad]."""

    place, sized, formula, memory = "load", ("torque",), "latch", ("side",)
    drawn = {"torque": uniform(0.16, 0.4, moment), "reach": uniform(0.18, 0.4)}

    def of(self, x):
        self._side = np.where(np.abs(x.q_a) > self.values["reach"], np.sign(x.q_a), self._side)
        return np.where(self._side < 0, -1.0, 1.0) * self.values["torque"], np.ones_like(x.q_a)


class RunningIn(ArmOutside):
    """Dry friction that falls while the joint travels [rad], anew in every record: ``1 + share exp(-way / travel)``."""

    place, sized, formula, memory = "motor_friction", ("share",), "running_in", ("way",)
    drawn = {"share": uniform(1.3, 3.2), "travel": uniform(0.9, 2.6)}

    def of(self, x):
        self._way = self._way + np.abs(x.v_a) * x.step
        return 0.0 * self._way, 1.0 + self.values["share"] * np.exp(-self._way / self.values["travel"])
