"""Gear whose ratio is not quite constant."""

import torch

from hybrid_id.components.base import Component
from hybrid_id.parameters import Parameter


class KinematicError(Component):
    """``q_link = q_m / r + E_c (cos(n q_m) - 1) + E_s sin(n q_m)``: the map that the gear makes of the rotor's angle.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | E_c, E_s | rad | amplitudes at the link, of either sign |
    | n | 1 | periods per turn of the rotor (2 for harmonic drives, 1 for an eccentric pinion) |

    It stands beside the gear's own component. With g the map, a rigid gear carries ``J_m + g'^2 J_a`` and the torque
    ``J_a g' g'' v^2``; a compliant one is deflected by ``g(q_m) - q_a``. Source: T. D. Tuttle, W. P. Seering, "A
    nonlinear model of a harmonic drive gear transmission", IEEE Trans. Robotics and Automation 12(3), 1996.
    """

    kind = "kinematic_error"
    places = ("transmission",)
    E_c = Parameter(1e-4, lower=-1.0, upper=1.0, unit="rad", doc="amplitude of the cosine at the link")
    E_s = Parameter(1e-4, lower=-1.0, upper=1.0, unit="rad", doc="amplitude of the sine at the link")
    n = Parameter(1.0, upper=1e4, unit="1", doc="periods per turn of the rotor", estimate=False)

    def error(self, p, angle):
        """Error of the link's angle [rad], its first and its second derivative by the rotor's angle, ``(B,)`` each."""
        cosine, sine = torch.cos(p.n * angle), torch.sin(p.n * angle)
        value = p.E_c * (cosine - 1.0) + p.E_s * sine
        slope = p.n * (p.E_s * cosine - p.E_c * sine)
        return value, slope, -p.n.square() * (p.E_c * cosine + p.E_s * sine)
