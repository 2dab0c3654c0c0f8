"""One rigid joint with a DC motor and set-valued dry friction."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.twin.rotor import Rotor


@dataclass(frozen=True, eq=False, kw_only=True)
class RigidDrive(Rotor):
    """A motor, a rigid gear and one link, written at the motor shaft.

        J v' = T - (G_l / r) sin(q / r) - F,    q' = v
        F = F_dry(|v|, sgn v) sgn v                                         sliding
        -F_dry(0, -) <= F <= F_dry(0, +), v' = 0                            sticking

    | symbol | meaning | unit |
    | --- | --- | --- |
    | q, v | motor angle and speed (the state) | rad, rad/s |
    | T | torque of the motor, viscous friction off, see `Rotor`; the inputs are its u and w | N m |
    | J | inertia of rotor, gear and link | kg m^2 |
    | G_l | gravity torque at the level link, q = 0 hanging down | N m |
    | r | gear ratio, motor turns per joint turn | 1 |

    At rest the joint sticks while the applied torque lies within the friction levels at zero speed, each side its
    own; the eq. (15) level at zero speed lies a little under its peak.
    """

    J: np.ndarray | float
    G_l: np.ndarray | float = 0.0
    r: np.ndarray | float = 1.0

    def _applied(self, q: np.ndarray, v, u: np.ndarray) -> np.ndarray:
        """Torque (B,) on the rotor, dry friction apart."""
        torque = self.torque(q, v, u[0], u[1])
        return torque - self.G_l / self.r * np.sin(q / self.r) if np.any(self.G_l) else torque

    def rate(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State derivative (2, B); see `Mechanism`."""
        q, v = x
        torque = self._applied(q, v, u) - self.friction(v, mode[0])
        return np.array([v, np.where(mode[0] == 0, 0.0, torque / self.J)])

    def guards(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Speed in the direction of sliding (1, B); a joint at rest stays so while its input is held."""
        return np.where(mode == 0, 1.0, mode * x[1])

    def settle(
        self, x: np.ndarray, mode: np.ndarray, u: np.ndarray, at_rest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stop the marked joints and let them stick or break away; see `Mechanism`."""
        if not at_rest.any():
            return x, mode
        breaks_away = self.break_away(self._applied(x[0], 0.0, u))
        return np.array([x[0], np.where(at_rest[0], 0.0, x[1])]), np.where(at_rest, breaks_away, mode)

    def initial_mode(self, x: np.ndarray) -> np.ndarray:
        """Direction of the start speed (1, B)."""
        return np.sign(x[1:2])
