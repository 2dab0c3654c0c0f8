"""What connects rotor and link: a map of angles, and a spring where they can move apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.machines.physics.law import Lanes, Law


@dataclass
class Gear:
    """The gear's map ``q_a = q_m / r + sum e sin(n q_m + phi)``: ratio r, and errors e [rad at the link]."""

    ratio: float
    errors: Sequence[Lanes] = ()
    periods: Sequence[float] = ()
    phases: Sequence[float] = ()

    def angle(self, q_m: np.ndarray) -> np.ndarray:
        """Angle behind the gear (B,) [rad]."""
        angle = q_m / self.ratio
        for e, n, phase in zip(self.errors, self.periods, self.phases, strict=True):
            angle = angle + e * (np.sin(n * q_m + phase) - np.sin(phase))
        return angle

    def slope(self, q_m: np.ndarray) -> Lanes:
        """First derivative of the map, torque behind the gear to torque before it."""
        slope: Lanes = 1 / self.ratio
        for e, n, phase in zip(self.errors, self.periods, self.phases, strict=True):
            slope = slope + e * n * np.cos(n * q_m + phase)
        return slope

    def curvature(self, q_m: np.ndarray) -> Lanes:
        """Second derivative of the map."""
        curvature: Lanes = 0.0
        for e, n, phase in zip(self.errors, self.periods, self.phases, strict=True):
            curvature = curvature - e * n**2 * np.sin(n * q_m + phase)
        return curvature


@dataclass
class LinearSpring(Law):
    """``k d + k_3 d^3 + damping d'``; k [N m/rad], damping [N m s/rad], k_3 [N m/rad^3] of one that hardens."""

    k: Lanes
    damping: Lanes
    k_3: Lanes = 0.0

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        return (self.k + self.k_3 * twist**2) * twist + self.damping * rate


@dataclass
class BacklashFlexibility(Law):
    """A spring that gives way around zero, eq. (12) of the paper: tau_s = k d (1 - sech(beta d)^alpha).

    | symbol | meaning | unit |
    | --- | --- | --- |
    | d | deflection q_m / r - q_a, at the link | rad |
    | k | stiffness far out | N m/rad |
    | alpha | shape | 1 |
    | beta | sharpness; the play's half-width is about 1 / (alpha beta) | 1/rad |
    """

    k: Lanes
    alpha: Lanes
    beta: Lanes

    def torque(self, twist: np.ndarray, rate: np.ndarray | float = 0.0, step: float = 0.0) -> np.ndarray:
        sharp = np.abs(self.beta * twist)
        # log cosh, which overflows nowhere, and is x^2 / 2 near zero, where the other form would cancel
        log_cosh = np.where(
            sharp < 1e-2,
            sharp**2 / 2 - sharp**4 / 12 + sharp**6 / 45,
            sharp + np.log1p(np.exp(-2 * sharp)) - np.log(2.0),
        )
        return -self.k * twist * np.expm1(-self.alpha * log_cosh)
