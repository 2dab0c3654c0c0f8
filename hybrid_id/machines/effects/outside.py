"""Effects that no table of names holds; a diagnosis should say so, and where they act."""

import numpy as np

from hybrid_id.machines.effects.base import (
    UNKNOWN,
    Effect,
    dry,
    dry_at_link,
    fast,
    uniform,
)

RESTING = 0.1
"""Time at the start of each record before the frame is shaken [s]."""


class Outside(Effect):
    """An effect that no table of names holds."""

    name = UNKNOWN


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


class ShakenFrame(Outside):
    """A neighbour that shakes the frame: ``A sin(2 pi f t + phase)``; A [N m], f [Hz]."""

    place, sized = "load", ("A",)
    drawn = {"A": uniform(0.5, 2.0, dry_at_link), "f": uniform(0.5, 6.0), "phase": uniform(0, 2 * np.pi)}

    def act(self, push, x):
        wave = self.values["A"] * np.sin(2 * np.pi * self.values["f"] * x.time + self.values["phase"])
        push.torque = push.torque + np.where(x.time > RESTING, wave, 0.0)


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
