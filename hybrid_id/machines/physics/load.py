"""What acts on a link from outside; torques at the joint [N m]."""

from dataclasses import dataclass, field

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law, Push, Signals


@dataclass
class Gravity(Law):
    """``tau = -G sin(q_a - q_0)``; G [N m], q_0 [rad] where the load hangs down."""

    G: Lanes
    q_0: Lanes = 0.0
    smooth = True

    def act(self, push: Push, x: Signals) -> None:
        push.torque = push.torque - self.G * np.sin(x.q_a - self.q_0)


@dataclass
class RestSpring(Law):
    """``tau = -k d - k_3 d^3`` with d = q_a - rest: a cable or hose; k [N m/rad], k_3 [N m/rad^3]."""

    k: Lanes
    rest: Lanes
    k_3: Lanes = 0.0

    def act(self, push: Push, x: Signals) -> None:
        twist = x.q_a - self.rest
        push.torque = push.torque - (self.k + self.k_3 * twist**2) * twist


@dataclass
class ConstantTorque(Law):
    """A bias [N m], of the rotor or of the link."""

    bias: Lanes

    def act(self, push: Push, x: Signals) -> None:
        push.torque = push.torque + self.bias


@dataclass
class SoftStop(Law):
    """A soft obstacle from angle `start_at` [rad] on: ``-k p - d p'`` of the depth p, never pulling."""

    start_at: Lanes
    k: Lanes
    d: Lanes

    def act(self, push: Push, x: Signals) -> None:
        side = np.sign(self.start_at)
        depth = np.maximum(side * (x.q_a - self.start_at), 0.0)
        force = self.k * depth + np.where(depth > 0, self.d * side * x.v_a, 0.0)
        push.torque = push.torque - side * np.maximum(force, 0.0)


@dataclass
class Pulses(Law):
    """Torque pulses [N m] of given length [s] every `period` seconds from `first` on, of alternating sign."""

    torque: Lanes
    first: float
    period: float
    length: float

    def act(self, push: Push, x: Signals) -> None:
        count = np.floor((x.time - self.first) / self.period)
        into = x.time - self.first - count * self.period
        side = 1 - 2 * (count - 2 * np.floor(0.5 * count))
        pushes = (x.time > self.first) & (into < self.length)
        push.torque = push.torque + np.where(pushes, self.torque * side, 0.0)


@dataclass
class PeriodicTorque(Law):
    """``A sin(2 pi f t + phi)``: a neighbour that shakes the frame; A [N m], f [Hz]. It begins after `rest` [s]."""

    A: Lanes
    f: float
    phase: float
    rest: float = 0.1

    def act(self, push: Push, x: Signals) -> None:
        wave = self.A * np.sin(2 * np.pi * self.f * x.time + self.phase)
        push.torque = push.torque + np.where(x.time > self.rest, wave, 0.0)


@dataclass
class Latch(Law):
    """A groove at one angle: ``-A d / w exp(-(d / w)^2)`` pulls the link into q_0; A [N m], w [rad]."""

    A: Lanes
    q_0: Lanes
    width: Lanes

    def act(self, push: Push, x: Signals) -> None:
        d = (x.q_a - self.q_0) / self.width
        push.torque = push.torque - self.A * d * np.exp(-(d**2))


@dataclass
class SecondMass(Law):
    """A mass mounted by a spring on the link: ``J_2 q'' = k (q_a - q) + d (q_a' - q')``, its own resonance.

    J_2 [kg m^2], frequency ``sqrt(k / J_2)`` [rad/s], damping ratio.
    """

    J_2: Lanes
    frequency: Lanes
    damping: float
    _speed: np.ndarray | None = field(default=None, repr=False)
    _angle: np.ndarray | None = field(default=None, repr=False)

    def start(self, lanes: int) -> None:
        self._angle, self._speed = None, np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        if self._angle is None or self._speed is None:
            self._angle, self._speed = x.q_a.copy(), np.zeros_like(x.q_a)
        pull = self.frequency**2 * (x.q_a - self._angle) + 2 * self.damping * self.frequency * (
            x.v_a - self._speed
        )
        push.torque = push.torque - self.J_2 * pull
        self._speed = self._speed + x.step * pull
        self._angle = self._angle + x.step * self._speed


@dataclass
class NegativeDamping(Law):
    """``+F v exp(-(v / v_0)^2)``: drives small motions, vanishes with speed; F [N m s/rad], v_0 [rad/s]."""

    F: Lanes
    v_0: Lanes

    def act(self, push: Push, x: Signals) -> None:
        push.torque = push.torque + self.F * x.v_a * np.exp(-((x.v_a / self.v_0) ** 2))


@dataclass
class Windage(Law):
    """``-c (v_a - w)|v_a - w|``: air that moves past the link; c [N m s^2/rad^2], w [rad/s]."""

    c: Lanes
    wind: Lanes

    def act(self, push: Push, x: Signals) -> None:
        relative = x.v_a - self.wind
        push.torque = push.torque - self.c * relative * np.abs(relative)
