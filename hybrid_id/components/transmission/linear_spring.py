"""Linear joint flexibility."""

from hybrid_id.components.base import Transmission
from hybrid_id.parameters import Parameter


class LinearSpring(Transmission):
    """``tau_s = k delta + d d(delta)/dt`` with ``delta = q_m / r - q_a`` (paper, eq. 5 with a linear tau_s).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k | N m/rad | stiffness at the link |
    | d | N m s/rad | damping at the link |
    """

    kind = "linear_spring"
    k = Parameter(300.0, lower=1e-6, upper=1e9, unit="N m/rad", doc="stiffness")
    d = Parameter(0.5, upper=1e6, unit="N m s/rad", doc="damping")

    def torque(self, p, deflection, rate, inertia):
        return p.k * deflection + p.d * rate
