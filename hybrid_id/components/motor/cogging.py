"""Torque of magnets and slots."""

import math

import torch

from hybrid_id.components.base import Effect, RotorTorque
from hybrid_id.components.site import free, second_wave
from hybrid_id.parameters import Parameter

FIRST_SHARES = (1.0, 0.3)
"""Of the cogging that a linear estimate asks for: beside so much, the rotor may stop elsewhere than it did."""

REPEATED = 2.0
"""Waves over the range of all motion from which a torque over the angle is periodic: less may be any other."""

NEAR = 0.02
"""Periods per turn by which a number may miss the whole one that stands for it in MuJoCo: a record has few turns."""


def least_periods(reach: float) -> float:
    """Periods a turn from which a wave comes again within so large a range of the rotor's angle [rad]."""
    return 2.0 * math.pi * REPEATED / reach


class Cogging(RotorTorque):
    """``tau = T_c cos(n q) + T_s sin(n q)`` with the rotor's angle q, zero on average over a turn.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | T_c, T_s | N m | amplitudes, of either sign |
    | n | 1 | periods per turn of the rotor (least common multiple of poles and slots, or a multiple) |
    | T_c2, T_s2, n_2 | N m, 1 | the same of a second wave, which is added: an overtone, say |

    Source: J. F. Gieras, Permanent Magnet Motor Technology, 3rd ed., 2009, chapter 6: two terms of the series.
    """

    kind = "cogging"
    T_c = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="amplitude of the cosine")
    T_s = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="amplitude of the sine")
    n = Parameter(6.0, lower=0.0, upper=1e4, unit="1", doc="periods per turn", estimate=False)
    T_c2 = Parameter(0.0, -1e3, 1e3, "N m", "amplitude of the second wave's cosine", estimate=False)
    T_s2 = Parameter(0.0, -1e3, 1e3, "N m", "amplitude of the second wave's sine", estimate=False)
    n_2 = Parameter(12.0, upper=1e4, unit="1", doc="periods per turn of the second wave", estimate=False)
    effect = Effect(
        "cogging",
        "magnets that pull the rotor to its slots, again and again over the range of motion; usually 1 to 5 % of the "
        "rated torque, none with an ironless rotor",
        "T. M. Jahns, W. L. Soong, Pulsating torque minimization techniques for permanent magnet AC motor drives - a "
        "review, IEEE Trans. Industrial Electronics 43(2), 1996",
        {
            "position_dependent_friction": "slow motion both ways over several turns: cogging pushes alike in both "
            "directions, friction opposes both",
            "kinematic_error": "slow and fast motion over the same turns: cogging keeps its torque, that of a gear's "
            "error grows with the square of the speed",
            "coulomb_friction": "released at many angles: cogging pulls the rotor into the next detent, dry friction "
            "lets it rest anywhere",
            "stribeck_friction": "creeping over several turns of the rotor: cogging ripples over the angle, Stribeck "
            "friction goes with the speed alone",
            "presliding_friction": "small reversals at many angles: detents stay where they are, a bristle springs "
            "about any angle",
        },
        over_angle=True,
        shape={"n": "T_c", "n_2": "T_c2"},
        whole=("n", "n_2"),
    )

    def torque(self, p, angle, speed):
        first = p.T_c * torch.cos(p.n * angle) + p.T_s * torch.sin(p.n * angle)
        return first + p.T_c2 * torch.cos(p.n_2 * angle) + p.T_s2 * torch.sin(p.n_2 * angle)

    @staticmethod
    def starts(site):
        limit, near = 3.0 * site.torque, math.pi / site.turns
        least = least_periods(site.turns)
        return [
            {
                "T_c": free(share * c, -limit, limit),
                "T_s": free(share * d, -limit, limit),
                "n": free(n, max(n - near, least), n + near),
            }
            for n, c, d in site.search("rotor_waves", (least, 1e-6, 0.0))[:3]
            for share in FIRST_SHARES
        ]

    def further(self, searches):
        return second_wave(self, searches["rotor_waves"], ("T_c2", "T_s2"), 1.5)

    def mjcf(self, p):
        # MuJoCo's is amplitude sin(periods q + phase)
        periods, cosine, sine = float(p.n), float(p.T_c), float(p.T_s)
        whole = round(periods)
        if abs(periods - whole) > NEAR:
            return {}, f"is left out, MuJoCo's has a whole number of periods per turn, not {periods:g}"
        said = [] if periods == whole else [f"has {whole} periods per turn there, not {periods:.6g}"]
        if float(p.T_c2) or float(p.T_s2):
            said.append("has a second wave, which is left out, MuJoCo's motor has one")
        return {"cogging": (math.hypot(cosine, sine), whole, math.atan2(cosine, sine))}, "; it ".join(said)
