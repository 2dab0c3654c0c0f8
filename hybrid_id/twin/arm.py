"""Two rigid links with a DC motor and set-valued dry friction in each joint."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from hybrid_id.twin.friction import Lanes
from hybrid_id.twin.rotor import Rotor


@dataclass(frozen=True, eq=False)
class TwoLinkArm(Lanes):
    """A planar arm in the horizontal plane, eq. (13)-(14) of the paper as the reading notes have them.

        M(q) q'' + c(q, q') = (r_i (T_i - F_i)),    q_mi = r_i q_i
        M = [[P_1 + 2 P_3 cos q_2, P_4 + P_3 cos q_2], [., P_2]]
        c = [-P_3 sin q_2 (2 q_1' q_2' + q_2'^2), P_3 sin q_2 q_1'^2]

    | symbol | meaning | unit |
    | --- | --- | --- |
    | q_i, q_mi | angles of joint (relative) and motor; the state is q_m1, v_m1, q_m2, v_m2 | rad, rad/s |
    | T_i, F_i | torque of the motor less viscous friction, and dry friction, see `Rotor` | N m |
    | P_1 | inertia that joint 1 sees, rotor included, without the coupling's part | kg m^2 |
    | P_2 | inertia that joint 2 sees, rotor included | kg m^2 |
    | P_3, P_4 | coupling, and link 2 about its joint | kg m^2 |
    | r_i | gear ratio, motor turns per joint turn | 1 |

    The equations are divided by the gear ratios and so written at the motor shafts. The inputs are the voltages
    u_1, u_2, then the disturbing torques w_1, w_2. Joints act on each other through M and c, so which of those at rest
    stick is decided for both at once: the nine pairs of stick, forwards and backwards are tried, and since M is
    positive definite exactly one of them holds.
    """

    rotor_1: Rotor
    rotor_2: Rotor
    P_1: np.ndarray | float
    P_2: np.ndarray | float
    P_3: np.ndarray | float
    P_4: np.ndarray | float
    r_1: np.ndarray | float
    r_2: np.ndarray | float

    def _mass(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """M_11, M_12, M_22 (B,) at the motor shafts."""
        coupling = self.P_3 * np.cos(x[2] / self.r_2)
        m_11 = (self.P_1 + 2 * coupling) / self.r_1**2
        return m_11, (self.P_4 + coupling) / (self.r_1 * self.r_2), self.P_2 / np.square(self.r_2)

    def _torques(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques (B,) on both rotors, dry friction apart and those of motion taken off."""
        (q_1, v_1, q_2, v_2), (u_1, u_2, w_1, w_2) = x, u
        speed_1, speed_2 = v_1 / self.r_1, v_2 / self.r_2
        swing = self.P_3 * np.sin(q_2 / self.r_2)
        return (
            self.rotor_1.torque(q_1, v_1, u_1, w_1) + swing * (2 * speed_1 + speed_2) * speed_2 / self.r_1,
            self.rotor_2.torque(q_2, v_2, u_2, w_2) - swing * speed_1**2 / self.r_2,
        )

    def _motion(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations (2, B) in a mode, and the torques (2, B) that friction holds in joints that stick."""
        m_11, m_12, m_22 = self._mass(x)
        torque_1, torque_2 = self._torques(x, u)
        torque_1 = torque_1 - self.rotor_1.friction(x[1], mode[0])
        torque_2 = torque_2 - self.rotor_2.friction(x[3], mode[1])
        slides_1, slides_2 = mode != 0
        felt = m_12 * (slides_1 & slides_2)  # between two joints that both move
        determinant = m_11 * m_22 - felt**2
        a_1 = slides_1 * (m_22 * torque_1 - felt * torque_2) / determinant
        a_2 = slides_2 * (m_11 * torque_2 - felt * torque_1) / determinant
        return np.array([a_1, a_2]), np.array([torque_1 - m_12 * a_2, torque_2 - m_12 * a_1])

    def rate(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State derivative (4, B); see `Mechanism`."""
        (a_1, a_2), _ = self._motion(x, mode, u)
        return np.array([x[1], a_1, x[3], a_2])

    def guards(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Speed of each joint in its direction of sliding, or the room that its friction has (2, B)."""
        _, (held_1, held_2) = self._motion(x, mode, u)
        return np.array(
            [self.rotor_1.guard(x[1], mode[0], held_1), self.rotor_2.guard(x[3], mode[1], held_2)]
        )

    def settle(
        self, x: np.ndarray, mode: np.ndarray, u: np.ndarray, at_rest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stop the marked joints and let each stick or break away, both at once; see `Mechanism`."""
        if not at_rest.any():
            return x, mode
        x = x.copy()
        x[1::2][at_rest] = 0.0
        best, most = mode, np.full(x.shape[1], -np.inf)
        for pair in product((0.0, 1.0, -1.0), repeat=2):
            trial = np.where(at_rest, np.array(pair)[:, None], mode)
            room = np.where(at_rest, self._room(x, trial, u), np.inf).min(axis=0)
            best = np.where(room > most, trial, best)
            most = np.maximum(room, most)
        return x, best

    def _room(self, x: np.ndarray, mode: np.ndarray, u: np.ndarray) -> np.ndarray:
        """How well (2, B) joints at rest fit a mode: friction's room where it holds, else the push [N m]."""
        accelerations, (held_1, held_2) = self._motion(x, mode, u)
        m_11, _, m_22 = self._mass(x)
        push = mode * accelerations * np.array([m_11, np.broadcast_to(m_22, m_11.shape)])
        return np.where(mode == 0, np.array([self.rotor_1.room(held_1), self.rotor_2.room(held_2)]), push)

    def initial_mode(self, x: np.ndarray) -> np.ndarray:
        """Directions of the start speeds (2, B)."""
        return np.sign(x[1::2])
