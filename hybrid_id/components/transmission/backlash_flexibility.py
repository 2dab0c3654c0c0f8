"""The paper's spring with a soft zone around zero."""

import math

import torch

from hybrid_id.components.base import Transmission
from hybrid_id.parameters import Parameter


class BacklashFlexibility(Transmission):
    """Paper, eq. (12): ``tau_s = k delta (1 - sech(beta delta)^alpha)`` with ``delta = q_m / r - q_a``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k | N m/rad | stiffness at the link, far out |
    | alpha | 1 | shape |
    | beta | 1/rad | sharpness; the half-width of the play is about 1 / (alpha beta) |
    | d | N m s/rad | damping at the link where the spring acts |

    Far out ``k delta``, near zero ``k alpha beta^2 delta^3 / 2``. Differs from the paper: the damping, which the paper
    has not, acts in proportion to ``1 - sech^alpha`` and is 0 and held by default. delta, the redundant
    state x_3 of eq. (4), is no state here but the difference of x_1 / r and x_4: float64 keeps it to 1e-12 rad at
    1e4 rad, while a state of its own would drift from them and take a row more of every sensitivity.
    """

    kind = "backlash_flexibility"
    k = Parameter(380.0, lower=1e-6, upper=1e9, unit="N m/rad", doc="stiffness far out")
    alpha = Parameter(0.31, lower=1e-3, upper=1e3, unit="1", doc="shape")
    beta = Parameter(169.0, lower=1e-3, upper=1e9, unit="1/rad", doc="sharpness")
    d = Parameter(0.0, upper=1e6, unit="N m s/rad", doc="damping where the spring acts", estimate=False)

    def torque(self, p, deflection, rate, inertia):
        share = -torch.expm1(-p.alpha * log_cosh(p.beta * deflection))
        return share * (p.k * deflection + p.d * rate)

    def loaded(self, p):
        # there sech^alpha is below a thousandth or so, and the spring as stiff as it gets
        return 8.0 / (p.alpha * p.beta) + 1.0 / p.beta


def log_cosh(x: torch.Tensor) -> torch.Tensor:
    """``log(cosh(x))`` to full relative accuracy near zero, with no overflow far out."""
    near = x.clamp(-1.0, 1.0)
    far = x.abs()
    far = far + torch.log1p(torch.exp(-2.0 * far)) - math.log(2.0)
    return torch.where(x.abs() < 1.0, torch.log1p(2.0 * torch.sinh(0.5 * near) ** 2), far)
