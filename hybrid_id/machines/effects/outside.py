"""Effects that no table of names holds; a diagnosis should say so, and where they act."""

import numpy as np

from hybrid_id.machines.effects.base import (
    UNKNOWN,
    Effect,
    choice,
    dry,
    dry_at_link,
    fast,
    link_inertia,
    uniform,
)

RESTING = 0.1
"""Time at the start of each record before the frame is shaken [s]."""


class Outside(Effect):
    """An effect that no table of names holds."""

    name = UNKNOWN


class GrowingFriction(Outside):
    """Dry friction that grows as ``F (1 - exp(-t / T))`` in each record: grease that stiffens, a gear that warms."""

    place, sized = "motor_friction", ("F",)
    drawn = {"F": uniform(0.5, 2.0, dry), "T": uniform(2.0, 8.0)}

    def act(self, push, x):
        push.dry(self.values["F"] * (1 - np.exp(-np.maximum(x.time, 0.0) / self.values["T"])))


class ThinningGrease(Outside):
    """Viscous friction that falls with the work E done on it [J]: ``F / (1 + E / E_0)``."""

    place, sized, memory = "motor_friction", ("F",), ("work",)

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = fast(robot, joint)
        F = dry(robot, joint) * rng.uniform(0.5, 2.0) / speed
        return cls(joint, {"F": F, "E_0": F * speed**2 * rng.uniform(0.2, 1.0)})

    def act(self, push, x):
        slope = self.values["F"] / (1 + self._work / self.values["E_0"])
        self._work = self._work + x.step * slope * x.v_m**2
        push.slope = push.slope + slope


class StickAfterRest(Outside):
    """Breakaway that grows with the time at rest, ``F (1 - exp(-t_rest / T))``, gone after ``slip`` [rad] of motion."""

    place, sized, memory = "motor_friction", ("F",), ("rest",)
    drawn = {"F": uniform(1.0, 3.0, dry), "T": uniform(0.05, 0.4), "slip": uniform(1.0, 8.0)}

    def act(self, push, x):
        v, speed = self.values, np.abs(x.v_m)
        push.dry(v["F"] * (1 - np.exp(-self._rest / v["T"])))
        self._rest = np.where(
            speed > 0, self._rest * np.exp(-speed * x.step / v["slip"]), self._rest + x.step
        )


class CubicDrag(Outside):
    """Drag with the third power of the speed."""

    place, sized = "motor_friction", ("F",)
    drawn = {"F": uniform(0.5, 2.0, lambda robot, joint: dry(robot, joint) / fast(robot, joint) ** 3)}

    def act(self, push, x):
        push.slope = push.slope + self.values["F"] * x.v_m**2


class Groove(Outside):
    """A latch at one angle of the link: ``-A d / w exp(-(d / w)^2)`` pulls it into q_0; A [N m], w [rad]."""

    place, sized = "load", ("A",)
    drawn = {"A": uniform(1.0, 4.0, dry_at_link), "q_0": uniform(-0.3, 0.3), "width": uniform(0.03, 0.12)}

    def act(self, push, x):
        d = (x.q_a - self.values["q_0"]) / self.values["width"]
        push.torque = push.torque - self.values["A"] * d * np.exp(-(d**2))


class ToolContact(Outside):
    """A soft obstacle from angle `start_at` [rad] on: ``-k p - d p'`` of the depth p, never pulling."""

    place, sized = "load", ("k", "d")

    @classmethod
    def draw(cls, rng, robot, joint):
        k = uniform(2.0, 20.0, dry_at_link, log=True)(rng, robot, joint)
        side = rng.choice([-1, 1]) * rng.uniform(0.1, 0.4)
        return cls(joint, {"k": k, "d": 0.05 * k, "start_at": side})

    def act(self, push, x):
        v, side = self.values, np.sign(self.values["start_at"])
        depth = np.maximum(side * (x.q_a - v["start_at"]), 0.0)
        force = v["k"] * depth + np.where(depth > 0, v["d"] * side * x.v_a, 0.0)
        push.torque = push.torque - side * np.maximum(force, 0.0)


class TorquePulses(Outside):
    """Torque pulses [N m] of given length [s] every `period` seconds from `first` on, of alternating sign."""

    place, sized = "load", ("torque",)
    drawn = {
        "torque": uniform(1.0, 4.0, dry_at_link),
        "period": uniform(0.7, 2.5),
        "first": uniform(0.3, 1.0),
        "length": uniform(0.05, 0.2),
    }

    def act(self, push, x):
        v = self.values
        count = np.floor((x.time - v["first"]) / v["period"])
        side = 1 - 2 * (count - 2 * np.floor(0.5 * count))
        pushes = (x.time > v["first"]) & (x.time - v["first"] - count * v["period"] < v["length"])
        push.torque = push.torque + np.where(pushes, v["torque"] * side, 0.0)


class ShakenFrame(Outside):
    """A neighbour that shakes the frame: ``A sin(2 pi f t + phase)``; A [N m], f [Hz]."""

    place, sized = "load", ("A",)
    drawn = {"A": uniform(0.5, 2.0, dry_at_link), "f": uniform(0.5, 6.0), "phase": uniform(0, 2 * np.pi)}

    def act(self, push, x):
        wave = self.values["A"] * np.sin(2 * np.pi * self.values["f"] * x.time + self.values["phase"])
        push.torque = push.torque + np.where(x.time > RESTING, wave, 0.0)


class MountedMass(Outside):
    """A second mass on the link with a resonance of its own; behind a rigid gear, a flexible joint does the same.

    ``J_2 q'' = k (q_a - q) + d (q_a' - q')``; J_2 [kg m^2], frequency ``sqrt(k / J_2)`` [rad/s], damping ratio.
    """

    place, sized, systems = "load", ("J_2",), ("one_link_flexible",)
    memory = ("twist", "speed")
    drawn = {
        "J_2": uniform(0.2, 0.8, link_inertia),
        "frequency": uniform(1.0, 4.0, lambda robot, joint: 2 * np.pi),
        "damping": uniform(0.02, 0.1),
    }

    def act(self, push, x):
        v = self.values
        pull = v["frequency"] ** 2 * self._twist + 2 * v["damping"] * v["frequency"] * (x.v_a - self._speed)
        push.torque = push.torque - v["J_2"] * pull
        self._speed = self._speed + x.step * pull
        self._twist = self._twist + x.step * (x.v_a - self._speed)


class DrivenSlowMotion(Outside):
    """Negative damping of slow motion: ``+F v exp(-(v / v_0)^2)`` vanishes with speed; F [N m s/rad], v_0 [rad/s]."""

    place, sized = "load", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = rng.uniform(0.1, 0.4) * fast(robot, joint) / robot.ratio[joint]
        F = dry_at_link(robot, joint) * rng.uniform(0.3, 1.0) / speed
        return cls(joint, {"F": F, "v_0": speed})

    def act(self, push, x):
        v = self.values
        push.torque = push.torque + v["F"] * x.v_a * np.exp(-((x.v_a / v["v_0"]) ** 2))


class Wind(Outside):
    """Air that moves past the link: ``-c (v_a - w)|v_a - w|``; c [N m s^2/rad^2], w [rad/s]."""

    place, sized = "load", ("c",)

    @classmethod
    def draw(cls, rng, robot, joint):
        wind = rng.choice([-1, 1]) * rng.uniform(0.5, 2.0)
        c = dry_at_link(robot, joint) * rng.uniform(0.3, 1.5) / wind**2
        return cls(joint, {"c": c, "wind": wind})

    def act(self, push, x):
        v = self.values
        most = 0.9 * dry_at_link(self.robot, self.joint)  # the joint still starts at rest
        relative = x.v_a - v["wind"]
        c = np.minimum(v["c"], most / v["wind"] ** 2)
        push.torque = push.torque - c * relative * np.abs(relative)


class CommutationRipple(Outside):
    """Commutation: a ripple that grows with the motor's torque, ``share tau_motor sin(n q_m + phase)``."""

    place, sized = "motor", ("share",)
    drawn = {"share": uniform(0.1, 0.5), "periods": choice([1, 2, 3]), "phase": uniform(0, 6.28)}

    def act(self, push, x):
        share = np.minimum(self.values["share"], 0.9)
        push.torque = push.torque + share * x.effort * np.sin(
            self.values["periods"] * x.q_m + self.values["phase"]
        )


class FieldWeakening(Outside):
    """A torque constant that falls with the speed."""

    place, sized = "motor", ("loss",)
    drawn = {"loss": uniform(0.3, 2.0)}

    def install(self, machine, robot):
        self.drive(machine).motor.weakening = fast(robot, self.joint) / np.sqrt(self.values["loss"])


class UnevenAmplifier(Outside):
    """An amplifier that gives ``1 + excess`` of the command in one direction only."""

    place, sized = "input", ("excess",)
    drawn = {"excess": uniform(0.03, 0.2)}

    def volts(self, volts, x):
        return np.where(volts > 0, (1 + self.values["excess"]) * volts, volts)


class HystereticGear(Outside):
    """A spring with losses that do not depend on speed, where the model's is linear."""

    place, sized, systems = "transmission", ("limit",), ("one_link_flexible",)
    replaces, memory = True, ("sliding",)
    drawn = {"limit": uniform(0.3, 1.5, dry_at_link), "share": uniform(0.3, 0.8)}

    def torque(self, twist, rate, step):
        v, k = self.values, self.robot.values["k"]
        self._sliding = np.clip(self._sliding + v["share"] * k * rate * step, -v["limit"], v["limit"])
        return k * twist + self._sliding + self.robot.values["d"] * rate
