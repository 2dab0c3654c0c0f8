"""Friction of a shaft, with and without memory; every law may sit on the rotor or on the link."""

from dataclasses import dataclass, field

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law, Push, Signals


@dataclass
class Viscous(Law):
    """``F_v v`` [N m s/rad]."""

    F_v: Lanes

    def act(self, push: Push, x: Signals) -> None:
        push.slope = push.slope + self.F_v


@dataclass
class Coulomb(Law):
    """``F_c Sgn(v)``, set-valued at rest [N m]."""

    F_c: Lanes

    def act(self, push: Push, x: Signals) -> None:
        push.dry(self.F_c)


@dataclass
class AsymmetricStribeck(Law):
    """Asymmetric Stribeck friction, eq. (15) of the paper, its Neg read as -Pos(-v); viscous friction is `Viscous`.

    F = f_i1 + (f_i2 - f_i1) exp(-((|v| - f_i3) / f_i4)^2) with i = 1 forwards, i = 2 backwards.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | f_11, f_21 | level at high speed | N m |
    | f_12, f_22 | level at the peak | N m |
    | f_13, f_23 | speed of the peak | rad/s |
    | f_14, f_24 | width of the peak | rad/s |

    The level at zero speed lies a little under its peak.
    """

    f_11: Lanes
    f_12: Lanes
    f_13: Lanes
    f_14: Lanes
    f_21: Lanes
    f_22: Lanes
    f_23: Lanes
    f_24: Lanes

    def __post_init__(self) -> None:
        self._rises = (self.f_12 - self.f_11, self.f_22 - self.f_21)

    def levels(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Opposing torques (B,) [N m] forwards and backwards, each smooth in the speed v [rad/s] through zero."""
        forwards = self.f_11 + self._rises[0] * np.exp(-np.square((v - self.f_13) / self.f_14))
        backwards = self.f_21 + self._rises[1] * np.exp(-np.square((v + self.f_23) / self.f_24))
        return forwards, backwards

    def act(self, push: Push, x: Signals) -> None:
        forwards, backwards = self.levels(x.v_m)
        push.plus = push.plus + forwards
        push.minus = push.minus + backwards


@dataclass
class AsymmetricTanh(Law):
    """Friction on the link's side, eq. (9) of the paper as the reading notes have it.

    tau_fa = (f_a1 Pos(v) + f_a2 Pos(-v)) tanh(70 v). Smooth at rest, so that it brakes and does not hold.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | v | speed of the link | rad/s |
    | f_a1, f_a2 | level forwards and backwards, at the link | N m |
    """

    f_a1: Lanes
    f_a2: Lanes
    on_link: bool = True

    def act(self, push: Push, x: Signals) -> None:
        v = self.speed(x)
        push.torque = push.torque - np.where(v > 0, self.f_a1, self.f_a2) * np.tanh(70.0 * v)


@dataclass
class Power(Law):
    """``F |v| v``, the drag of a fan; F [N m s^2/rad^2]."""

    F: Lanes
    on_link: bool = False

    def act(self, push: Push, x: Signals) -> None:
        push.slope = push.slope + self.F * np.abs(self.speed(x))


@dataclass
class LuGre(Law):
    """``z' = v - s |v| z / F_c``, ``F = s z + d z'``: bristles; without d, Dahl's law (1968, exponent 1).

    Canudas de Wit et al., IEEE Trans. Autom. Control 40(3), 1995, without their Stribeck curve; s [N m/rad], and
    d = `settling` s with a time [s]; the viscous part of the law belongs to `Viscous`.
    """

    F_c: Lanes
    stiffness: Lanes
    settling: Lanes = 0.0
    _z: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)

    def start(self, lanes: int) -> None:
        self._z = np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        speed = self.speed(x)
        end = np.sign(speed) * self.F_c / self.stiffness
        after = end + (self._z - end) * np.exp(-self.stiffness * np.abs(speed) * x.step / self.F_c)
        force = 0.5 * (self._z + after) + self.settling * (after - self._z) / x.step
        push.torque = push.torque - self.stiffness * force
        self._z = after


@dataclass
class MaxwellSlip(Law):
    """Parallel springs, each of which slides beyond its own force (Iwan, 1966): hysteresis with memory of reversals.

    Springs of equal stiffness ``s / n`` slide at forces ``F_c 2 i / (n (n + 1))``, i = 1 .. n; s [N m/rad], F_c [N m].
    """

    F_c: Lanes
    stiffness: Lanes
    springs: int = 5
    _forces: list[np.ndarray] = field(default_factory=list, repr=False)

    def start(self, lanes: int) -> None:
        self._forces = [np.zeros(lanes) for _ in range(self.springs)]

    def act(self, push: Push, x: Signals) -> None:
        n = self.springs
        more = self.stiffness / n * self.speed(x) * x.step
        for i, force in enumerate(self._forces):
            limit = (i + 1) * 2 / (n * (n + 1)) * self.F_c
            self._forces[i] = after = np.clip(force + more, -limit, limit)
            push.torque = push.torque - 0.5 * (force + after)
