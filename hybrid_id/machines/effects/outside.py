"""Effects that no table of names holds; a diagnosis should say so, and where they act."""

import numpy as np

from hybrid_id.machines.effects.base import UNKNOWN, ActingSpring, Effect, dry, fast, link_inertia
from hybrid_id.machines.robots import log_uniform

RESTING = 0.1
"""Time at the start of each record before the frame is shaken [s]."""


class Outside(Effect):
    """An effect that no table of names holds."""

    name = UNKNOWN


class GrowingFriction(Outside):
    """Dry friction that grows as ``F (1 - exp(-t / T))`` in each record: grease that stiffens, a gear that warms."""

    place, sized = "motor_friction", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"F": dry(robot, joint) * rng.uniform(0.5, 2.0), "T": rng.uniform(2.0, 8.0)})

    def act(self, push, x, m):
        push.dry(self.values["F"] * (1 - np.exp(-np.maximum(x.time, 0.0) / self.values["T"])))


class ThinningGrease(Outside):
    """Viscous friction that falls with the work E done on it [J]: ``F / (1 + E / E_0)``."""

    place, sized, memory = "motor_friction", ("F",), ("work",)

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = fast(robot, joint)
        F = dry(robot, joint) * rng.uniform(0.5, 2.0) / speed
        return cls(joint, {"F": F, "E_0": F * speed**2 * rng.uniform(0.2, 1.0)})

    def act(self, push, x, m):
        slope = self.values["F"] / (1 + m._work / self.values["E_0"])
        m._work = m._work + x.step * slope * x.v_m**2
        push.slope = push.slope + slope


class StickAfterRest(Outside):
    """Breakaway that grows with the time at rest, ``F (1 - exp(-t_rest / T))``, gone after ``slip`` [rad] of motion."""

    place, sized, memory = "motor_friction", ("F",), ("rest",)

    @classmethod
    def draw(cls, rng, robot, joint):
        F = dry(robot, joint) * rng.uniform(1.0, 3.0)
        return cls(joint, {"F": F, "T": rng.uniform(0.05, 0.4), "slip": rng.uniform(1.0, 8.0)})

    def act(self, push, x, m):
        v, speed = self.values, np.abs(x.v_m)
        push.dry(v["F"] * (1 - np.exp(-m._rest / v["T"])))
        m._rest = np.where(speed > 0, m._rest * np.exp(-speed * x.step / v["slip"]), m._rest + x.step)


class CubicDrag(Outside):
    """Drag with the third power of the speed."""

    place, sized = "motor_friction", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"F": dry(robot, joint) * rng.uniform(0.5, 2.0) / fast(robot, joint) ** 3})

    def act(self, push, x, m):
        push.slope = push.slope + self.values["F"] * x.v_m**2


class Groove(Outside):
    """A latch at one angle of the link: ``-A d / w exp(-(d / w)^2)`` pulls it into q_0; A [N m], w [rad]."""

    place, sized = "load", ("A",)

    @classmethod
    def draw(cls, rng, robot, joint):
        A = dry(robot, joint) * robot.ratio[joint] * rng.uniform(1.0, 4.0)
        return cls(joint, {"A": A, "q_0": rng.uniform(-0.3, 0.3), "width": rng.uniform(0.03, 0.12)})

    def act(self, push, x, m):
        d = (x.q_a - self.values["q_0"]) / self.values["width"]
        push.torque = push.torque - self.values["A"] * d * np.exp(-(d**2))


class ToolContact(Outside):
    """A soft obstacle from angle `start_at` [rad] on: ``-k p - d p'`` of the depth p, never pulling."""

    place, sized = "load", ("k", "d")

    @classmethod
    def draw(cls, rng, robot, joint):
        k = dry(robot, joint) * robot.ratio[joint] * log_uniform(rng, 2.0, 20.0)
        side = rng.choice([-1, 1]) * rng.uniform(0.1, 0.4)
        return cls(joint, {"k": k, "d": 0.05 * k, "start_at": side})

    def act(self, push, x, m):
        v, side = self.values, np.sign(self.values["start_at"])
        depth = np.maximum(side * (x.q_a - v["start_at"]), 0.0)
        force = v["k"] * depth + np.where(depth > 0, v["d"] * side * x.v_a, 0.0)
        push.torque = push.torque - side * np.maximum(force, 0.0)


class TorquePulses(Outside):
    """Torque pulses [N m] of given length [s] every `period` seconds from `first` on, of alternating sign."""

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

    def act(self, push, x, m):
        v = self.values
        count = np.floor((x.time - v["first"]) / v["period"])
        side = 1 - 2 * (count - 2 * np.floor(0.5 * count))
        pushes = (x.time > v["first"]) & (x.time - v["first"] - count * v["period"] < v["length"])
        push.torque = push.torque + np.where(pushes, v["torque"] * side, 0.0)


class ShakenFrame(Outside):
    """A neighbour that shakes the frame: ``A sin(2 pi f t + phase)``; A [N m], f [Hz]."""

    place, sized = "load", ("A",)

    @classmethod
    def draw(cls, rng, robot, joint):
        A = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.5, 2.0)
        return cls(joint, {"A": A, "f": rng.uniform(0.5, 6.0), "phase": rng.uniform(0, 2 * np.pi)})

    def act(self, push, x, m):
        wave = self.values["A"] * np.sin(2 * np.pi * self.values["f"] * x.time + self.values["phase"])
        push.torque = push.torque + np.where(x.time > RESTING, wave, 0.0)


class MountedMass(Outside):
    """A second mass on the link with a resonance of its own; behind a rigid gear, a flexible joint does the same.

    ``J_2 q'' = k (q_a - q) + d (q_a' - q')``; J_2 [kg m^2], frequency ``sqrt(k / J_2)`` [rad/s], damping ratio.
    """

    place, sized, systems = "load", ("J_2",), ("one_link_flexible",)
    memory = ("twist", "speed")

    @classmethod
    def draw(cls, rng, robot, joint):
        J_2 = link_inertia(robot, joint) * rng.uniform(0.2, 0.8)
        frequency = 2 * np.pi * rng.uniform(1.0, 4.0)
        return cls(joint, {"J_2": J_2, "frequency": frequency, "damping": rng.uniform(0.02, 0.1)})

    def act(self, push, x, m):
        v = self.values
        pull = v["frequency"] ** 2 * m._twist + 2 * v["damping"] * v["frequency"] * (x.v_a - m._speed)
        push.torque = push.torque - v["J_2"] * pull
        m._speed = m._speed + x.step * pull
        m._twist = m._twist + x.step * (x.v_a - m._speed)


class DrivenSlowMotion(Outside):
    """Negative damping of slow motion: ``+F v exp(-(v / v_0)^2)`` vanishes with speed; F [N m s/rad], v_0 [rad/s]."""

    place, sized = "load", ("F",)

    @classmethod
    def draw(cls, rng, robot, joint):
        speed = rng.uniform(0.1, 0.4) * fast(robot, joint) / robot.ratio[joint]
        F = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 1.0) / speed
        return cls(joint, {"F": F, "v_0": speed})

    def act(self, push, x, m):
        v = self.values
        push.torque = push.torque + v["F"] * x.v_a * np.exp(-((x.v_a / v["v_0"]) ** 2))


class Wind(Outside):
    """Air that moves past the link: ``-c (v_a - w)|v_a - w|``; c [N m s^2/rad^2], w [rad/s]."""

    place, sized = "load", ("c",)

    @classmethod
    def draw(cls, rng, robot, joint):
        wind = rng.choice([-1, 1]) * rng.uniform(0.5, 2.0)
        c = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 1.5) / wind**2
        return cls(joint, {"c": c, "wind": wind})

    def act(self, push, x, m):
        v = self.values
        most = 0.9 * dry(m.robot, self.joint) * m.robot.ratio[self.joint]  # the joint still starts at rest
        relative = x.v_a - v["wind"]
        c = np.minimum(v["c"], most / v["wind"] ** 2)
        push.torque = push.torque - c * relative * np.abs(relative)


class CommutationRipple(Outside):
    """Commutation: a ripple that grows with the motor's torque, ``share tau_motor sin(n q_m + phase)``."""

    place, sized = "motor", ("share",)

    @classmethod
    def draw(cls, rng, robot, joint):
        values = {
            "share": rng.uniform(0.1, 0.5),
            "periods": float(rng.choice([1, 2, 3])),
            "phase": rng.uniform(0, 6.28),
        }
        return cls(joint, values)

    def act(self, push, x, m):
        share = np.minimum(self.values["share"], 0.9)
        push.torque = push.torque + share * x.effort * np.sin(
            self.values["periods"] * x.q_m + self.values["phase"]
        )


class FieldWeakening(Outside):
    """A torque constant that falls with the speed."""

    place, sized = "motor", ("loss",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"loss": rng.uniform(0.3, 2.0)})

    def install(self, machine, robot):
        self.drive(machine).motor.weakening = fast(robot, self.joint) / np.sqrt(self.values["loss"])


class UnevenAmplifier(Outside):
    """An amplifier that gives ``1 + excess`` of the command in one direction only."""

    place, sized = "input", ("excess",)

    @classmethod
    def draw(cls, rng, robot, joint):
        return cls(joint, {"excess": rng.uniform(0.03, 0.2)})

    def volts(self, volts, x, m):
        return np.where(volts > 0, (1 + self.values["excess"]) * volts, volts)


class HystereticGear(Outside):
    """A spring with losses that do not depend on speed, where the model's is linear."""

    place, sized, systems = "transmission", ("limit",), ("one_link_flexible",)
    replaces, memory = True, ("sliding",)

    @classmethod
    def draw(cls, rng, robot, joint):
        limit = dry(robot, joint) * robot.ratio[joint] * rng.uniform(0.3, 1.5)
        return cls(joint, {"limit": limit, "share": rng.uniform(0.3, 0.8)})

    def install(self, machine, robot):
        self.drive(machine).spring = ActingSpring(self, robot)

    def torque(self, twist, rate, step, m):
        v, k = self.values, m.robot.values["k"]
        m._sliding = np.clip(m._sliding + v["share"] * k * rate * step, -v["limit"], v["limit"])
        return k * twist + m._sliding + m.robot.values["d"] * rate
