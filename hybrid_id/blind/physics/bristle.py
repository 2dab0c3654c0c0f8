"""Friction with memory of the deflection before sliding."""

from dataclasses import dataclass, field

import numpy as np

from hybrid_id.blind.physics.law import Lanes, Law, Push, Signals


@dataclass
class Dahl(Law):
    """``F' = s (v - |v| F / F_c)`` (Dahl, 1968, exponent 1), stepped exactly for a held speed.

    s [N m/rad], F_c [N m].
    """

    F_c: Lanes
    stiffness: Lanes
    on_link: bool = False
    _force: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)

    def start(self, lanes: int) -> None:
        self._force = np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        speed = self.speed(x)
        end = self.F_c * np.sign(speed)
        after = end + (self._force - end) * np.exp(-self.stiffness * np.abs(speed) * x.step / self.F_c)
        push.torque = push.torque - 0.5 * (self._force + after)
        self._force = after


@dataclass
class LuGre(Law):
    """``z' = v - s |v| z / g(v)``, ``F = s z + d z'``, ``g = F_c + drop exp(-(v/v_s)^2)``.

    Canudas de Wit et al., IEEE Trans. Autom. Control 40(3), 1995. s [N m/rad], d [N m s/rad];
    the viscous part of the law belongs to `Viscous`.
    """

    F_c: Lanes
    stiffness: Lanes
    damping: Lanes
    drop: Lanes = 0.0
    v_s: Lanes = 1.0
    on_link: bool = False
    _z: np.ndarray = field(default_factory=lambda: np.zeros(1), repr=False)

    def start(self, lanes: int) -> None:
        self._z = np.zeros(lanes)

    def act(self, push: Push, x: Signals) -> None:
        speed = self.speed(x)
        level = self.F_c + self.drop * np.exp(-((speed / self.v_s) ** 2))
        end = np.sign(speed) * level / self.stiffness
        after = end + (self._z - end) * np.exp(-self.stiffness * np.abs(speed) * x.step / level)
        force = self.stiffness * 0.5 * (self._z + after) + self.damping * (after - self._z) / x.step
        push.torque = push.torque - force
        self._z = after


@dataclass
class MaxwellSlip(Law):
    """Parallel springs, each of which slides beyond its own force (Iwan, 1966): hysteresis with memory of reversals.

    Springs of equal stiffness ``s / n`` slide at forces ``F_c 2 i / (n (n + 1))``, i = 1 .. n; s [N m/rad], F_c [N m].
    """

    F_c: Lanes
    stiffness: Lanes
    springs: int = 5
    on_link: bool = False
    _forces: np.ndarray = field(default_factory=lambda: np.zeros((1, 1)), repr=False)

    def start(self, lanes: int) -> None:
        self._forces = np.zeros((self.springs, lanes))

    def act(self, push: Push, x: Signals) -> None:
        n = self.springs
        share = (np.arange(1, n + 1) * 2 / (n * (n + 1)))[:, None]
        limit = share * self.F_c
        after = self._forces + self.stiffness / n * self.speed(x) * x.step
        after = np.clip(after, -limit, limit)
        push.torque = push.torque - 0.5 * (self._forces + after).sum(axis=0)
        self._forces = after
