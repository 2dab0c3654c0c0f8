"""What connects rotor and link: a map of angles, and a spring where they can move apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.machines.physics.law import Lanes

MOST_LOSS = 3.0
"""Most that the losses of an impact add to a contact's force, as a factor: steeper ones no step of a fit resolves."""


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


class Spring:
    """A connection with torque of its own between the gear's end and the link, at the link's side."""

    def start(self, lanes: int) -> None:
        """Set the states of B runs to rest."""

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        """Torque on the link (B,) [N m] of a twist [rad] and its rate [rad/s]."""
        raise NotImplementedError


@dataclass
class LinearSpring(Spring):
    """``k d + damping d'``; k [N m/rad], damping [N m s/rad]."""

    k: Lanes
    damping: Lanes

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        return self.k * twist + self.damping * rate


@dataclass
class BacklashFlexibility(Spring):
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


@dataclass
class HardeningSpring(Spring):
    """``k d + k_3 d^3 + damping d'``; k_3 [N m/rad^3]."""

    k: Lanes
    damping: Lanes
    k_3: Lanes

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        return (self.k + self.k_3 * twist**2) * twist + self.damping * rate


@dataclass
class Play(Spring):
    """Teeth that touch beyond half of the gap: ``k p^n (1 + c p')`` of the depth p, at most ``3 k p^n``, never pulling.

    | symbol | meaning | unit |
    | --- | --- | --- |
    | gap | total play | rad |
    | k, n | contact stiffness; 1 for flat, 1.5 for round teeth (Hertz) | N m/rad^n, 1 |
    | c | losses of the impact (Hunt and Crossley, 1975) | s/rad |
    """

    gap: Lanes
    k: Lanes
    c: Lanes
    exponent: float = 1.0

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        side = np.sign(twist)
        depth = np.maximum(np.abs(twist) - 0.5 * self.gap, 0.0)
        return side * self.k * depth**self.exponent * np.clip(1 + self.c * side * rate, 0.0, MOST_LOSS)


@dataclass
class PlaySpring(Spring):
    """A spring with play in series: ``k p + damping p'`` of the twist p beyond half of the gap, never pulling."""

    gap: Lanes
    k: Lanes
    damping: Lanes

    def torque(self, twist: np.ndarray, rate: np.ndarray, step: float) -> np.ndarray:
        side = np.sign(twist)
        depth = np.abs(twist) - 0.5 * self.gap
        force = self.k * depth + self.damping * side * rate
        return np.where(depth > 0, side * np.maximum(force, 0.0), 0.0)
