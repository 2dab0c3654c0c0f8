"""Effects that act on the links from outside, or between them."""

from dataclasses import replace

import numpy as np

from hybrid_id.machines.effects.base import Effect, dry, dry_at_link, uniform
from hybrid_id.machines.physics.law import Lanes
from hybrid_id.machines.physics.load import Gravity

GRAVITY = 9.81
LINK = ("one_link", "one_link_flexible")


class Unbalance(Effect):
    """A weight off the axis of one link; where the model has gravity, off the link's own line too."""

    name, place, sized, systems = "gravity_load", "load", ("G",), LINK
    shapes, signed = ("q_0",), ("q_0",)
    made = Gravity

    @classmethod
    def draw(cls, rng, robot, joint):
        G = dry_at_link(robot, joint) * rng.uniform(0.2, 1.0)
        aside = rng.choice([-1, 1]) * rng.uniform(0.8, 2.3)
        return cls(joint, {"G": G, "q_0": aside if robot.vertical else rng.uniform(-np.pi, np.pi)})


class Tilt(Effect):
    """A base of an arm that is not level."""

    name, place, sized, systems = "gravity_load", "load", ("sine",), ("two_link",)
    shapes, signed = ("q_0",), ("q_0",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(0, {"sine": rng.uniform(0.02, 0.15), "q_0": rng.uniform(-np.pi, np.pi)})

    @classmethod
    def acts_at(cls, robot, joint):
        return joint == 0  # a base has one tilt

    def scaled(self, factor):
        grown = super().scaled(factor)
        return grown.with_values({"sine": np.clip(grown.values["sine"], -0.95, 0.95)})

    def install(self, machine, robot):
        pull: Lanes = GRAVITY * self.values["sine"]
        first, second = (pull * moment for moment in robot.moments)
        machine.links = replace(machine.links, G_1=first, G_2=second, q_0=self.values["q_0"])


class Hose(Effect):
    """A cable or hose that pulls towards a rest angle: ``-k d - k_3 d^3`` with d = q_a - rest."""

    name, place, sized = "spring_load", "load", ("k",)
    shapes, signed = ("rest",), ("rest",)
    drawn = {"k": uniform(0.3, 1.5, dry_at_link), "rest": uniform(-0.5, 0.5)}
    cubic = 0.0

    def act(self, push, x):
        k, twist = self.values["k"], x.q_a - self.values["rest"]
        push.torque = push.torque - (k + self.cubic * k * twist**2) * twist


class StiffeningHose(Hose):
    """The same, stiffer when it is drawn out."""

    cubic = 0.3


class Bias(Effect):
    """A constant torque, or an offset of the amplifier."""

    name, place, sized = "constant_torque", "load", ("bias",)
    signed = ("bias",)
    drawn = {"bias": uniform(0.08, 0.6, dry, either=True, log=True)}

    def act(self, push, x):
        push.torque = push.torque + self.values["bias"]

    def install(self, machine, robot):
        most = 0.95 * dry(robot, self.joint)  # the joint still starts at rest
        bias = np.clip(self.values["bias"], -most, most)
        self.drive(machine).rotor_laws.append(self.with_values({"bias": bias}))


class WithheldCoupling(Effect):
    """Inertial coupling of two links that the nominal model does without."""

    name, place, sized, systems = "joint_coupling", "load", ("P_3", "P_4"), ("two_link",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(0, {name: float(robot.values[name]) for name in ("P_3", "P_4")})

    def scaled(self, factor):
        return super().scaled(np.minimum(factor, 1.0))

    def alter(self, robot):
        return robot.with_values(self.values, withheld=True)
