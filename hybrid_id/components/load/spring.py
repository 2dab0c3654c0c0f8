"""Cable or hose that pulls the link towards a rest angle."""

import math

from hybrid_id.components.base import Effect, LoadTorque
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Spring(LoadTorque):
    """``tau_s = k_s (q - q_s)`` at the link, Hooke's law.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | k_s | N m/rad | stiffness of what pulls |
    | q_s | rad | rest angle (held by default) |
    """

    kind = "spring_load"
    k_s = Parameter(0.1, upper=1e6, unit="N m/rad", doc="stiffness of what pulls")
    q_s = Parameter(0.0, lower=-1e3, upper=1e3, unit="rad", doc="rest angle", estimate=False)
    effect = Effect(
        "spring_load",
        "cable, hose or spring that pulls the link to a rest angle; usually below 10 % of the rated torque at the ends",
        "R. Hooke, Lectures de Potentia Restitutiva, or of Spring, London, 1678",
    )

    def torque(self, p, angle, speed):
        return p.k_s * (angle - p.q_s)

    @staticmethod
    def starts(site):
        size, reach = 0.05 * site.torque * site.ratio / site.angle, max(3.0 * site.angle, math.pi)
        rest = free(site.middle, site.middle - reach, site.middle + reach)
        return [{"k_s": free(size, 0.0, 200.0 * size), "q_s": rest}]

    def mjcf(self, p):
        return {"stiffness": (p.k_s,), "rest": (p.q_s,)}, ""
