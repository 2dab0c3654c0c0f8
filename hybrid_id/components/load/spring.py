"""Cable or hose that pulls the link towards a rest angle."""

from hybrid_id.components.base import LoadTorque
from hybrid_id.parameters import Parameter


class Spring(LoadTorque):
    """``tau_s = k_s (q - q_s)`` at the link, Hooke's law.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k_s | N m/rad | stiffness of what pulls |
    | q_s | rad | rest angle (held unless told otherwise) |
    """

    kind = "spring_load"
    k_s = Parameter(0.1, upper=1e6, unit="N m/rad", doc="stiffness of what pulls")
    q_s = Parameter(0.0, lower=-1e3, upper=1e3, unit="rad", doc="rest angle", estimate=False)

    def torque(self, p, angle, speed):
        return p.k_s * (angle - p.q_s)
