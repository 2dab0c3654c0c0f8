"""The motor's side of a joint, which every machine of this package has."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.twin.friction import DryFriction, Lanes

#: Share by which a torque must exceed friction to wake a joint at rest, so that rounding wakes nothing.
HYSTERESIS = 1e-8


@dataclass(frozen=True, eq=False)
class TorqueRipple(Lanes):
    """Torque that a motor's commutation or a gear's teeth add, A sin(n q): an effect outside every model here.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | A | amplitude | N m |
    | n | periods per turn of the motor | 1 |
    """

    A: np.ndarray | float = 0.0
    n: np.ndarray | float = 1.0

    def torque(self, q: np.ndarray) -> np.ndarray:
        """Torque (B,) on the rotor at the motor angle q."""
        return self.A * np.sin(self.n * q)


NO_RIPPLE = TorqueRipple()


@dataclass(frozen=True, eq=False)
class Rotor(Lanes):
    """A DC motor with dry and viscous friction, all that acts on a rotor but inertia and gear.

        T = P_m1 (u - P_m2 v) + w + A sin(n q) - f_3 v

    | symbol | meaning | unit |
    | --- | --- | --- |
    | q, v | motor angle and speed | rad, rad/s |
    | u, w | voltage and disturbing torque | V, N m |
    | P_m1, P_m2 | k_m / R and back-EMF constant, eq. (3) in the units of the reading notes | N m/V, V s/rad |
    | f_3 | viscous friction, eq. (16) | N m s/rad |
    | dry | set-valued dry friction F: opposes sliding with its level, holds up to its levels at rest | N m |
    """

    P_m1: np.ndarray | float
    P_m2: np.ndarray | float
    dry: DryFriction
    f_3: np.ndarray | float = 0.0
    ripple: TorqueRipple = NO_RIPPLE

    def torque(self, q, v, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """T (B,), dry friction apart."""
        torque = self.P_m1 * u + w
        if np.any(self.ripple.A):
            torque = torque + self.ripple.torque(q)
        return torque - (self.P_m1 * self.P_m2 + self.f_3) * v

    def friction(self, v: np.ndarray, side: np.ndarray | float) -> np.ndarray:
        """Dry friction (B,) on the side on which it slides, 0 where it sticks (side 0)."""
        return side * self.dry.level(side * v, side)

    def limit(self, side: float) -> np.ndarray:
        """Torque (B,) on one side that friction holds at rest."""
        return (1 + HYSTERESIS) * self.dry.level(0.0, side)

    def room(self, held: np.ndarray) -> np.ndarray:
        """How far (B,) the torque that friction holds at rest lies inside its limits; negative outside."""
        return np.minimum(self.limit(1.0) - held, self.limit(-1.0) + held)

    def guard(self, v: np.ndarray, side: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Not negative (B,) as long as the rotor slides towards its side, or as friction holds it."""
        return np.where(side == 0, self.room(held) + HYSTERESIS * self.limit(1.0), side * v)

    def break_away(self, held: np.ndarray) -> np.ndarray:
        """Side (B,) to which a torque moves the rotor from rest, 0 where friction holds it."""
        return (held > self.limit(1.0)) * 1.0 - (held < -self.limit(-1.0))
