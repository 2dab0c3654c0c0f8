"""One joint whose gear has play and flexibility, with a DC motor and set-valued dry friction."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.twin.friction import Lanes, LinkFriction
from hybrid_id.twin.rotor import Rotor
from hybrid_id.twin.spring import BacklashFlexibility


@dataclass(frozen=True, eq=False)
class FlexibleDrive(Lanes):
    """A rotor and a link joined by a spring, eq. (4)-(5) of the paper.

        J_m v_m' = T - tau_s / r - F,    q_m' = v_m
        J_a v_a' = tau_s - tau_fa,       q_a' = v_a
        tau_s = tau_s(q_m / r - q_a), eq. (12);    tau_fa = tau_fa(v_a), eq. (9)

    | symbol | meaning | unit |
    | --- | --- | --- |
    | q_m, v_m, q_a, v_a | angle and speed of motor and link (the state) | rad, rad/s |
    | T, F | torque of the motor less viscous friction, and dry friction, see `Rotor` | N m |
    | J_m | inertia of rotor and gear, at the motor | kg m^2 |
    | J_a | inertia of the link | kg m^2 |
    | r | gear ratio, motor turns per joint turn | 1 |

    Differs from the source by leaving out x_3 = q_m / r - q_a, which the other states hold, and by dry friction that
    is set-valued: the rotor sticks while the spring moves the link, and breaks away when spring and motor together
    exceed the level at rest.
    """

    rotor: Rotor
    J_m: np.ndarray | float
    J_a: np.ndarray | float
    spring: BacklashFlexibility
    link_friction: LinkFriction
    r: np.ndarray | float

    def _on_rotor(
        self, x: np.ndarray, v: np.ndarray | float, u: np.ndarray, spring: np.ndarray
    ) -> np.ndarray:
        """Torque (B,) on the rotor at the speed v, dry friction apart."""
        return self.rotor.torque(x[0], v, u[0], u[1]) - spring / self.r

    def _spring(self, x: np.ndarray) -> np.ndarray:
        return self.spring.torque(x[0] / self.r - x[2])

    def rate(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State derivative (4, B); see `Mechanism`."""
        v_m, v_a, side = x[1], x[3], mode[0]
        spring = self._spring(x)
        on_rotor = self._on_rotor(x, v_m, u, spring) - self.rotor.friction(v_m, side)
        on_link = spring - self.link_friction.torque(v_a)
        return np.array([v_m, np.where(side == 0, 0.0, on_rotor / self.J_m), v_a, on_link / self.J_a])

    def guards(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Speed of the rotor in its direction of sliding, or the room that its friction has (1, B)."""
        held = self._on_rotor(x, 0.0, u, self._spring(x))
        return self.rotor.guard(x[1], mode[0], held)[None]

    def settle(
        self, x: np.ndarray, mode: np.ndarray, u: np.ndarray, at_rest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stop the marked rotors and let them stick or break away; see `Mechanism`."""
        if not at_rest.any():
            return x, mode
        breaks_away = self.rotor.break_away(self._on_rotor(x, 0.0, u, self._spring(x)))
        stopped = np.array([x[0], np.where(at_rest[0], 0.0, x[1]), x[2], x[3]])
        return stopped, np.where(at_rest, breaks_away, mode)

    def initial_mode(self, x: np.ndarray) -> np.ndarray:
        """Direction of the rotor's start speed (1, B)."""
        return np.sign(x[1:2])
