"""Gears that couple the joints of a wrist: a motor turns with several joints at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hybrid_id.errors import InputError

SINGULAR = 1e-6
"""Smallest over largest singular value of a coupling's matrix, below which motors leave a joint undetermined."""


@dataclass(frozen=True)
class GearCoupling:
    """``q_m = diag(r) C q``, so that by power ``tau = C^T diag(r) tau_m``: motors and joints of a coupled gear.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | q, tau | rad, N m | angles of the coupled joints, torques at them |
    | q_m, tau_m | rad, N m | angles of their motors, torques of these |
    | r | 1 | gear ratio of each motor |
    | C | 1 | one row a motor, one column a joint; the identity where motors are not coupled |

    Source: M. Gautier, S. Briot, Global identification of joint drive gains and dynamic parameters of robots, J.
    Dynamic Systems, Measurement, and Control 136(5), 2014: the wrist of a Staubli TX40. Differs from it by states at
    the motors, so that rotors, their friction and their torques stay each motor's own.

    Attributes:
        joints: numbers of the joints, from 0; motor k drives joint ``joints[k]`` where nothing is coupled.
        matrix: C, by rows.

    Raises:
        InputError: fewer than two joints, one of them twice, or a matrix that is not square, finite and invertible.
    """

    joints: tuple[int, ...]
    matrix: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        n = len(self.joints)
        if n < 2 or len(set(self.joints)) < n:
            raise InputError("A coupling needs two different joints at least.")
        if len(self.matrix) != n or any(len(row) != n for row in self.matrix):
            raise InputError(
                f"A coupling of {n} joints needs a matrix of {n} rows with {n} numbers, one row a motor."
            )
        if not np.isfinite(self.matrix).all():
            raise InputError("The matrix of a coupling holds a number that is not finite.")
        least, *_, most = sorted(np.linalg.svd(np.array(self.matrix), compute_uv=False))
        if least <= SINGULAR * most:
            rows = [list(row) for row in self.matrix]
            raise InputError(
                f"The matrix {rows} of a coupling is singular: its motors leave a motion of the joints undetermined; "
                "give each motor a row of its own that says how far each joint turns it."
            )

    def motors_of(self, joint: int, gear_ratio: Mapping[int, float]) -> dict[int, float]:
        """Which motors turn a joint, by the numbers of their joints: how far it turns for one turn of each.

        Args:
            joint: number of the joint, from 0.
            gear_ratio: motor turns per turn behind its gear, by the number of the motor's joint.
        """
        row = np.linalg.inv(np.array(self.matrix))[self.joints.index(joint)]
        return {k: float(s) / gear_ratio[k] for k, s in zip(self.joints, row, strict=True) if s}

    def joints_of(self, motor: int, gear_ratio: Mapping[int, float]) -> dict[int, float]:
        """Which joints turn with a motor, by their numbers: how far it turns for one turn of each.

        Args:
            motor: number of its joint, from 0.
            gear_ratio: as of :meth:`motors_of`.
        """
        row = self.matrix[self.joints.index(motor)]
        return {k: entry * gear_ratio[motor] for k, entry in zip(self.joints, row, strict=True) if entry}
