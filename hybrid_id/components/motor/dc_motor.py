"""Permanent-magnet DC motor fed with a voltage."""

from hybrid_id.components.base import Motor
from hybrid_id.parameters import Parameter


class DCMotor(Motor):
    """Paper, eq. (3): ``tau_m = P_m1 (U - P_m2 v)``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | P_m1 = k_m / R | N m/V | stall torque per volt |
    | P_m2 = k_e | V s/rad | back-EMF constant; in SI units equal to the torque constant k_m |
    | U | V | winding voltage |
    | v | rad/s | rotor speed |

    Current ``i = (U - P_m2 v) / R = tau_m / P_m2``: a measured current or torque lifts the scale degeneracy that
    voltage and angle leave. Differs from the paper's letter: there ``U - v / P_m2`` with P_m1 in mN m/V; Table 1
    only makes sense with P_m2 = 1/k_n as read here. The winding's inductance is neglected, as in the paper.
    """

    kind = "dc_motor"
    P_m1 = Parameter(0.019059, lower=1e-9, upper=1e3, unit="N m/V", doc="stall torque per volt, k_m/R")
    P_m2 = Parameter(0.0254, upper=1e3, unit="V s/rad", doc="back-EMF (and torque) constant")

    def torque(self, p, command, speed):
        return p.P_m1 * (command - p.P_m2 * speed)

    def current(self, p, torque):
        return torque / p.P_m2

    def mjcf(self, p):
        constant = float(p.P_m2)
        return {"motorconst": (constant, constant), "resistance": (constant / float(p.P_m1),)}, ""
