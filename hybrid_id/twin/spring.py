"""Springs between rotor and link of the twins."""

from dataclasses import dataclass

import numpy as np

from hybrid_id.twin.friction import Lanes


@dataclass(frozen=True, eq=False)
class BacklashFlexibility(Lanes):
    """A spring that gives way around zero, eq. (12) of the paper: tau_s = k d (1 - sech(beta d)^alpha).

    | symbol | meaning | unit |
    | --- | --- | --- |
    | d | deflection q_m / r - q_a, at the link | rad |
    | k | stiffness far out | N m/rad |
    | alpha | shape | 1 |
    | beta | sharpness; the play's half-width is about 1 / (alpha beta) | 1/rad |
    """

    k: np.ndarray | float
    alpha: np.ndarray | float
    beta: np.ndarray | float

    def torque(self, deflection: np.ndarray) -> np.ndarray:
        """tau_s (B,) [N m] at the link."""
        sharp = np.abs(self.beta * deflection)
        # log cosh, which overflows nowhere, and is x^2 / 2 near zero, where the other form would cancel
        log_cosh = np.where(
            sharp < 1e-2,
            sharp**2 / 2 - sharp**4 / 12 + sharp**6 / 45,
            sharp + np.log1p(np.exp(-2 * sharp)) - np.log(2.0),
        )
        return -self.k * deflection * np.expm1(-self.alpha * log_cosh)
