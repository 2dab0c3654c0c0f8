"""Joint flexibility that stiffens."""

import torch

from hybrid_id.components.base import Effect, Transmission
from hybrid_id.components.site import free
from hybrid_id.components.transmission.flexibility import UNLOADED
from hybrid_id.parameters import Parameter


class HardeningSpring(Transmission):
    """``tau_s = k delta (1 + h delta^2) + d d(delta)/dt`` with ``delta = q_m / r - q_a``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k | N m/rad | stiffness at the link, around zero |
    | h = k_3 / k | 1/rad^2 | hardening, k_3 the cubic stiffness [N m/rad^3]; 0 is ``linear_spring`` |
    | d | N m s/rad | damping at the link |

    At 1 / sqrt(h) the torque is twice the linear one; h is of one size for small joints and large ones, so that a fit
    that starts at 0 knows how far to step. Source: the cubic spring of harmonic drives (T. Tuttle, W. Seering, IEEE
    Trans. Robotics and Automation 12(3), 1996), its k_3 written as k h.
    """

    kind = "hardening_flexibility"
    k = Parameter(300.0, lower=1e-6, upper=1e9, unit="N m/rad", doc="stiffness around zero")
    h = Parameter(0.0, upper=9e4, unit="1/rad^2", doc="hardening")
    d = Parameter(0.5, upper=1e6, unit="N m s/rad", doc="damping")
    effect = Effect(
        "hardening_flexibility",
        "gear that stiffens under load; a harmonic drive is usually 1.5 to 2.5 times as stiff then as around zero",
        "T. D. Tuttle, W. P. Seering, A nonlinear model of a harmonic drive gear transmission, IEEE Trans. Robotics "
        "and Automation 12(3), 1996",
        {"kinematic_error": UNLOADED},
    )

    def torque(self, p, deflection, rate, inertia):
        return p.k * deflection * (1.0 + p.h * deflection**2) + p.d * rate

    def loaded(self, p):
        # twice the stiffness around zero, or as far as a joint's spring is ever wound
        return torch.rsqrt(3.0 * p.h.clamp_min(1.0)).clamp_max(0.2)

    @staticmethod
    def starts(site):
        spring = site.at().get("linear_spring")
        if spring is None:
            return []
        twist = site.torque * site.ratio / spring.specs["k"].value
        linear = {"k": spring.specs["k"], "d": spring.specs["d"]}
        return [{**linear, "h": free(h / twist**2, 0.0, 9e4)} for h in (0.1, 1.0)]
