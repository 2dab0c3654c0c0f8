"""Viscous friction."""

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class Viscous(Friction):
    """``tau = F_v v``, the last term of the paper's eq. (6), (11) and (16).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_v | N m s/rad | viscous coefficient |
    | v | rad/s | speed of the side on which it sits |
    """

    kind = "viscous_friction"
    F_v = Parameter(1e-4, upper=1e6, unit="N m s/rad", doc="viscous coefficient")

    def smooth(self, p, speed):
        return p.F_v * speed
