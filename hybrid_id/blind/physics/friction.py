"""Friction of a shaft; every law may sit on the rotor or on the link."""

from dataclasses import dataclass, field

import numpy as np

from hybrid_id.blind.physics.law import Lanes, Law, Push, Signals


@dataclass
class Viscous(Law):
    """``F_v v`` [N m s/rad]."""

    F_v: Lanes
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        push.slope = push.slope + self.F_v


@dataclass
class Coulomb(Law):
    """``F_c Sgn(v)``, set-valued at rest [N m]."""

    F_c: Lanes
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        push.dry(self.F_c)


@dataclass
class SmoothCoulomb(Law):
    """``F_c tanh(v / w)``; it creeps where a set-valued law sticks; w [rad/s]."""

    F_c: Lanes
    width: Lanes
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        ratio = np.abs(self.speed(x)) / self.width
        secant = np.where(ratio > 1e-6, np.tanh(ratio) / np.maximum(ratio, 1e-6), 1.0)
        push.slope = push.slope + self.F_c / self.width * secant


@dataclass
class Stribeck(Law):
    """Dry friction ``drop s(|v| / v_s)`` above Coulomb's, by one of three shapes.

    exponential ``exp(-x)`` (Tustin), gaussian ``exp(-x^2)`` (Bo and Pavelescu), lorentzian ``1 / (1 + x^2)`` (Hess and
    Soom); drop [N m], v_s [rad/s].
    """

    drop: Lanes
    v_s: Lanes
    shape: str = "gaussian"
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        ratio = np.abs(self.speed(x)) / self.v_s
        if self.shape == "exponential":
            share = np.exp(-ratio)
        elif self.shape == "gaussian":
            share = np.exp(-(ratio**2))
        else:
            share = 1 / (1 + ratio**2)
        push.dry(self.drop * share)


@dataclass
class Uneven(Law):
    """Friction higher forwards than backwards: dry by ``excess`` [N m], viscous by ``slope`` [N m s/rad]."""

    excess: Lanes
    slope: Lanes = 0.0
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        push.plus = push.plus + 0.5 * self.excess
        push.minus = push.minus - 0.5 * self.excess
        push.torque = push.torque - 0.5 * self.slope * np.abs(self.speed(x))


@dataclass
class Power(Law):
    """``F |v|^n sgn(v)``: drag of a fan at n = 2, cubic at n = 3, shear thinning below 1; F [N m (s/rad)^n]."""

    F: Lanes
    exponent: float = 2.0
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        push.slope = push.slope + self.F * np.abs(self.speed(x)) ** (self.exponent - 1)


@dataclass
class LoadDependent(Law):
    """Dry friction ``mu |tau|`` of the torque through the gear, or of the motor's own (`by_effort`)."""

    mu: Lanes
    by_effort: bool = False
    needs_carried = True

    def act(self, push: Push, x: Signals) -> None:
        push.dry(self.mu * np.abs(x.effort if self.by_effort else x.carried))


@dataclass
class PositionDependent(Law):
    """Dry friction over the joint's angle: ``A (1 + sin(n q + phi))``, or ``A exp(-(n (q - phi))^2)`` of a tight spot.

    A [N m] at the body that it acts on; q is the link's angle on either side of the gear.
    """

    amplitude: Lanes
    periods: float
    phase: float
    spot: bool = False
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        if self.spot:
            push.dry(self.amplitude * np.exp(-((self.periods * (x.q_a - self.phase)) ** 2)))
        else:
            push.dry(self.amplitude * (1 + np.sin(self.periods * x.q_a + self.phase)))


@dataclass
class WearingIn(Law):
    """Dry friction that grows as ``F (1 - exp(-t / T))`` in each record: grease that stiffens, a gear that warms."""

    F: Lanes
    T: float

    def act(self, push: Push, x: Signals) -> None:
        push.dry(self.F * (1 - np.exp(-max(x.time, 0.0) / self.T)))


@dataclass
class WarmingGear(Law):
    """Viscous friction that falls while the gear works: ``F / (1 + E / E_0)``, E the work done on friction [J]."""

    F: Lanes
    E_0: Lanes
    _work: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)

    def start(self, lanes: int) -> None:
        self._work = np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        slope = self.F / (1 + self._work / self.E_0)
        self._work = self._work + x.step * slope * x.v_m**2
        push.slope = push.slope + slope


@dataclass
class StickAfterRest(Law):
    """Breakaway that grows with the time at rest: ``F (1 - exp(-t_rest / T))``, gone after ``slip`` [rad] of motion."""

    F: Lanes
    T: float
    slip: Lanes
    _rest: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)

    def start(self, lanes: int) -> None:
        self._rest = np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        push.dry(self.F * (1 - np.exp(-self._rest / self.T)))
        moved = np.abs(x.v_m) * x.step / self.slip
        self._rest = np.where(np.abs(x.v_m) > 0, self._rest * np.exp(-moved), self._rest + x.step)
