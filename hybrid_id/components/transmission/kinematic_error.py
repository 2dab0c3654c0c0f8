"""Gear whose ratio is not quite constant."""

import math

import torch

from hybrid_id.components.base import Component, Effect
from hybrid_id.components.site import free, second_wave
from hybrid_id.parameters import Parameter

WORST_GEAR = 0.03
"""Largest error of a gear [rad at the link]: harmonic drives have 1e-3 and less, the moulded gears of toys 0.02."""
WAVES = 6
"""Periods of a gear's error that fits begin with."""


class KinematicError(Component):
    """``q_link = q_m / r + E_c (cos(n q_m) - 1) + E_s sin(n q_m)``: the map that the gear makes of the rotor's angle.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | E_c, E_s | rad | amplitudes at the link, of either sign |
    | n | 1 | periods per turn of the rotor (2 for harmonic drives, 1 for an eccentric pinion) |
    | E_c2, E_s2, n_2 | rad, 1 | the same of a second wave, which is added: an overtone, or another wheel's |

    It stands beside the gear's own component. With g the map, a rigid gear carries ``J_m + g'^2 J_a`` and the torque
    ``J_a g' g'' v^2``; a compliant one is deflected by ``g(q_m) - q_a``. Source: T. D. Tuttle, W. P. Seering, "A
    nonlinear model of a harmonic drive gear transmission", IEEE Trans. Robotics and Automation 12(3), 1996.
    """

    kind = "kinematic_error"
    left_out = "is left out, MuJoCo's gears have a constant ratio"
    places = ("transmission",)
    E_c = Parameter(1e-4, lower=-1.0, upper=1.0, unit="rad", doc="amplitude of the cosine at the link")
    E_s = Parameter(1e-4, lower=-1.0, upper=1.0, unit="rad", doc="amplitude of the sine at the link")
    n = Parameter(1.0, upper=1e4, unit="1", doc="periods per turn of the rotor", estimate=False)
    E_c2 = Parameter(0.0, -1.0, 1.0, "rad", "amplitude of the second wave's cosine", estimate=False)
    E_s2 = Parameter(0.0, -1.0, 1.0, "rad", "amplitude of the second wave's sine", estimate=False)
    n_2 = Parameter(2.0, upper=1e4, unit="1", doc="periods per turn of the second wave", estimate=False)
    splits_inertia = True
    effect = Effect(
        "kinematic_error",
        "gear whose ratio ripples over a turn; usually 1 mrad at the link and less, 20 mrad of moulded gears",
        "T. D. Tuttle, W. P. Seering, A nonlinear model of a harmonic drive gear transmission, IEEE Trans. Robotics "
        "and Automation 12(3), 1996",
        over_angle=True,
        shape={"n": "E_c", "n_2": "E_c2"},
    )

    def error(self, p, angle):
        """Error of the link's angle [rad], its first and its second derivative by the rotor's angle, ``(B,)`` each."""
        first = _wave(p.E_c, p.E_s, p.n, angle)
        second = _wave(p.E_c2, p.E_s2, p.n_2, angle)
        value, slope, curvature = (one + two for one, two in zip(first, second, strict=True))
        return value, slope, curvature

    @staticmethod
    def starts(site):
        small = 0.02 * min(0.01 * site.angle, 0.5 / site.ratio)
        limit, near = min(0.1 * site.angle, 0.9 / site.ratio, WORST_GEAR), math.pi / site.turns
        # a linear estimate from whole runs hardly identifies the period, and the fits from all of them soon do
        waves = [*((n, small, small) for n in (1.0, 2.0)), *site.search("gear_waves")[:WAVES]]
        return [
            {
                "E_c": free(c, -limit, limit),
                "E_s": free(d, -limit, limit),
                "n": free(n, n - near, n + near),
            }
            for n, c, d in waves
        ]

    def further(self, searches):
        return second_wave(self, searches["gear_waves"], ("E_c2", "E_s2"), 1.5)


def _wave(E_c, E_s, n, angle):
    cosine, sine = torch.cos(n * angle), torch.sin(n * angle)
    value = E_c * (cosine - 1.0) + E_s * sine
    return value, n * (E_s * cosine - E_c * sine), -n.square() * (E_c * cosine + E_s * sine)
