"""Joint flexibility that stiffens."""

import torch

from hybrid_id.components.base import Transmission
from hybrid_id.parameters import Parameter


class HardeningSpring(Transmission):
    """``tau_s = k delta + k_3 delta^3 + d d(delta)/dt`` with ``delta = q_m / r - q_a``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k | N m/rad | stiffness at the link, around zero |
    | k_3 | N m/rad^3 | cubic stiffness at the link; 0 is ``linear_spring`` |
    | d | N m s/rad | damping at the link |

    Source: the cubic spring of harmonic drives (T. Tuttle, W. Seering, IEEE Trans. Robotics Automation 12(3), 1996).
    """

    kind = "hardening_flexibility"
    k = Parameter(300.0, lower=1e-6, upper=1e9, unit="N m/rad", doc="stiffness around zero")
    k_3 = Parameter(0.0, upper=1e12, unit="N m/rad^3", doc="cubic stiffness")
    d = Parameter(0.5, upper=1e6, unit="N m s/rad", doc="damping")

    def torque(self, p, deflection, rate, inertia):
        return (p.k + p.k_3 * deflection**2) * deflection + p.d * rate

    def loaded(self, p):
        # twice the stiffness around zero, or as far as a joint's spring is ever wound
        return torch.sqrt(p.k / (3.0 * p.k_3.clamp_min(1e-12))).clamp_max(0.2)
