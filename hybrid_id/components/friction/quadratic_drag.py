"""Drag that grows with the square of the speed."""

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class QuadraticDrag(Friction):
    """``tau = F_q v |v|`` with F_q [N m s^2/rad^2], v [rad/s]; source: windage, J. E. Vrancik, NASA TN D-4849, 1968."""

    kind = "quadratic_drag"
    F_q = Parameter(1e-7, upper=1e4, unit="N m s^2/rad^2", doc="drag coefficient")

    def smooth(self, p, speed):
        return p.F_q * speed * speed.abs()
