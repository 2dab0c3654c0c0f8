"""One rigid joint with a DC motor and set-valued dry friction."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.twin.friction import DryFriction, Lanes


@dataclass(frozen=True, eq=False)
class RigidDrive(Lanes):
    """A motor, a rigid gear and one link, written at the motor shaft.

        J v' = P_m1 (u - P_m2 v) + w - f_3 v - (G_l / r) sin(q / r) - F,    q' = v
        F = F_dry(|v|, sgn v) sgn v                                         sliding
        -F_dry(0, -) <= F <= F_dry(0, +), v' = 0                            sticking

    | symbol | meaning | unit |
    | --- | --- | --- |
    | q, v | motor angle and speed (the state) | rad, rad/s |
    | u, w | voltage and disturbing torque (the inputs) | V, N m |
    | J | inertia of rotor, gear and link | kg m^2 |
    | P_m1, P_m2 | k_m / R and back-EMF constant, eq. (3) in the units of the reading notes | N m/V, V s/rad |
    | f_3 | viscous friction, eq. (16) | N m s/rad |
    | G_l | gravity torque at the level link, q = 0 hanging down | N m |
    | r | gear ratio, motor turns per joint turn | 1 |

    At rest the joint sticks while the applied torque lies within the friction levels at zero speed, each side its
    own; the eq. (15) level at zero speed lies a little under its peak.
    """

    J: np.ndarray | float
    P_m1: np.ndarray | float
    P_m2: np.ndarray | float
    dry: DryFriction
    f_3: np.ndarray | float = 0.0
    G_l: np.ndarray | float = 0.0
    r: np.ndarray | float = 1.0

    def _applied(self, q: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Torque (B,) on the rotor at rest, dry friction apart."""
        torque = self.P_m1 * u[0] + u[1]
        return torque - self.G_l / self.r * np.sin(q / self.r) if np.any(self.G_l) else torque

    def rate(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State derivative (2, B); see `Mechanism`."""
        q, v = x
        side = mode[0]
        damping = self.P_m1 * self.P_m2 + self.f_3
        torque = self._applied(q, u) - damping * v - side * self.dry.level(side * v, side)
        return np.array([v, np.where(side == 0, 0.0, torque / self.J)])

    def guards(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Speed in the direction of sliding (1, B); a joint at rest stays so while its input is held."""
        return np.where(mode == 0, 1.0, mode * x[1])

    def settle(
        self, x: np.ndarray, mode: np.ndarray, u: np.ndarray, at_rest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stop the marked joints and let them stick or break away; see `Mechanism`."""
        if not at_rest.any():
            return x, mode
        torque = self._applied(x[0], u)
        breaks_away = (torque > self.dry.level(0.0, 1.0)) * 1.0 - (torque < -self.dry.level(0.0, -1.0))
        return np.array([x[0], np.where(at_rest[0], 0.0, x[1])]), np.where(at_rest, breaks_away, mode)

    def initial_mode(self, x: np.ndarray) -> np.ndarray:
        """Direction of the start speed (1, B)."""
        return np.sign(x[1:2])
