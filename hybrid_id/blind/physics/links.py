"""Inertia of the links, as seen at the joints."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.blind.physics.law import Lanes


@dataclass
class OneLink:
    """One link of inertia J [kg m^2]."""

    J: Lanes

    def mass(self, q: list[np.ndarray]) -> tuple[Lanes, Lanes, Lanes]:
        """Elements 11, 12, 22 of the mass matrix."""
        return self.J, 0.0, 1.0

    def bias(self, q: list[np.ndarray], v: list[np.ndarray]) -> list[Lanes]:
        """Torques that the motion itself asks for, each joint (B,)."""
        return [0.0]


@dataclass
class TwoLinks:
    """Two links in a plane, ``a`` and ``b`` about their joints with the other stretched along, ``c`` the coupling.

    ``M = [[a + 2 c cos q_2, b + c cos q_2], [., b]]``, all [kg m^2]; tilted out of the horizontal plane, the links pull
    with ``G_1 sin(q_1 - q_0)`` and ``G_2 sin(q_1 + q_2 - q_0)`` [N m].
    """

    a: Lanes
    b: Lanes
    c: Lanes
    G_1: Lanes = 0.0
    G_2: Lanes = 0.0
    q_0: Lanes = 0.0

    def mass(self, q: list[np.ndarray]) -> tuple[Lanes, Lanes, Lanes]:
        """Elements 11, 12, 22 of the mass matrix."""
        swing = self.c * np.cos(q[1])
        return self.a + 2 * swing, self.b + swing, self.b

    def bias(self, q: list[np.ndarray], v: list[np.ndarray]) -> list[Lanes]:
        """Coriolis and centrifugal torques and those of gravity, each joint (B,)."""
        swing = self.c * np.sin(q[1])
        second = self.G_2 * np.sin(q[0] + q[1] - self.q_0)
        first = self.G_1 * np.sin(q[0] - self.q_0) + second
        return [first - swing * (2 * v[0] + v[1]) * v[1], second + swing * v[0] ** 2]
