"""The paper's friction law that differs with the direction of motion."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class AsymmetricStribeck(Friction):
    """Paper, eq. (10), (15) and (16): Gaussian fall of the dry level, its parameters by direction, and ``f_3 v``.

    The level is ``f_11 + (f_12 - f_11) exp(-((|v| - f_13) / f_14)^2)`` for v > 0; for v < 0 the same with
    f_21 ... f_24.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | f_11, f_21 | N m | level far above the Stribeck speed, forward and backward |
    | f_12, f_22 | N m | peak level |
    | f_13, f_23 | rad/s | speed of the peak |
    | f_14, f_24 | rad/s | width of the fall |
    | f_3 | N m s/rad | viscous coefficient |

    Differs from the paper's letter: Neg(v) = -Pos(-v), so that friction opposes motion in both directions.
    """

    kind = "asymmetric_stribeck"
    has_level = by_direction = True
    f_11 = Parameter(0.010, upper=1e3, unit="N m", doc="far level, forward")
    f_12 = Parameter(0.030, upper=1e3, unit="N m", doc="peak level, forward")
    f_13 = Parameter(10.0, upper=1e4, unit="rad/s", doc="speed of the peak, forward")
    f_14 = Parameter(50.0, lower=1e-3, upper=1e5, unit="rad/s", doc="width of the fall, forward")
    f_21 = Parameter(0.010, upper=1e3, unit="N m", doc="far level, backward")
    f_22 = Parameter(0.030, upper=1e3, unit="N m", doc="peak level, backward")
    f_23 = Parameter(10.0, upper=1e4, unit="rad/s", doc="speed of the peak, backward")
    f_24 = Parameter(50.0, lower=1e-3, upper=1e5, unit="rad/s", doc="width of the fall, backward")
    f_3 = Parameter(5e-5, upper=1e3, unit="N m s/rad", doc="viscous coefficient")

    def smooth(self, p, speed):
        return p.f_3 * speed

    def dry(self, p, magnitude, forward):
        far = torch.lerp(p.f_21, p.f_11, forward)
        peak = torch.lerp(p.f_22, p.f_12, forward)
        centre = torch.lerp(p.f_23, p.f_13, forward)
        width = torch.lerp(p.f_24, p.f_14, forward)
        return far + (peak - far) * torch.exp(-self.exponent(magnitude - centre, width))

    def exponent(self, distance, width):
        """Exponent of the fall, (distance / width)^2 in eq. (15)."""
        return (distance / width) ** 2


class AsymmetricStribeckEq8(AsymmetricStribeck):
    """Paper, eq. (8) and (11): as eq. (15) with the exponent ``(|v| - f_13)^2 / f_14``; f_14 and f_24 in (rad/s)^2.

    Table 2 does not fit this form (its widths would be 7 rad/s, friction at rest under half of its peak); kept for
    comparison under its own name.
    """

    kind = "asymmetric_stribeck_eq8"
    f_14 = Parameter(
        2500.0, lower=1e-3, upper=1e8, unit="rad^2/s^2", doc="width of the fall squared, forward"
    )
    f_24 = Parameter(
        2500.0, lower=1e-3, upper=1e8, unit="rad^2/s^2", doc="width of the fall squared, backward"
    )

    def exponent(self, distance, width):
        return distance**2 / width
