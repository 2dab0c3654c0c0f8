"""Dry friction that varies over the joint's angle."""

import math

import torch

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.bristle import Bristle
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

LOADED = (
    "slow motion both ways over the whole range: friction turns with the direction, a load torque does not"
)


class PositionDependent(Friction):
    """Dry level ``A_0 + A_c cos(n q) + A_s sin(n q)`` beyond the other laws', q [rad] the joint's angle at the link.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | A_0 | N m | mean, where no other law has it |
    | A_c, A_s | N m | amplitudes, of either sign, where the friction acts (motor or link) |
    | n | 1 | periods per turn of the joint |

    The levels of all laws of a place add up and never fall below zero. Source: M. R. Popovic, A. A. Goldenberg,
    "Modeling of friction using spectral analysis", IEEE Trans. Robotics and Automation 14(1), 1998: the fundamental.
    """

    kind = "position_dependent_friction"
    A_0 = Parameter(0.0, upper=1e3, unit="N m", doc="mean level", estimate=False)
    A_c = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="amplitude of the cosine")
    A_s = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="amplitude of the sine")
    n = Parameter(1.0, upper=1e4, unit="1", doc="periods per turn of the joint", estimate=False)
    effect = Effect(
        "position_dependent_friction",
        "friction that varies over the joint's angle, of a bent shaft, a dent, a tight spot; usually 10 to 50 % of the "
        "friction",
        "M. R. Popovic, A. A. Goldenberg, Modeling of friction using spectral analysis, IEEE Trans. Robotics and "
        "Automation 14(1), 1998",
        {
            "gravity_load": LOADED,
            "spring_load": LOADED,
            "kinematic_error": "slow motion both ways over several turns: friction turns with the direction, an error "
            "of the gear does not",
        },
        smoothness="jumps with the direction",
        contains=("coulomb_friction",),
        over_angle=True,
    )

    def dry_over(self, p, angle):
        return p.A_0 + p.A_c * torch.cos(p.n * angle) + p.A_s * torch.sin(p.n * angle)

    @staticmethod
    def starts(site):
        most, near = 3.0 * site.dry * site.gearing, math.pi / site.angle
        # a place without dry friction has no mean that the waves could be added to
        dry = any(law.has_level or isinstance(law, Bristle) for law in site.frictions)
        mean = {} if dry else {"A_0": free(0.1 * most, 0.0, most)}
        return [
            {
                **mean,
                "A_c": free(c, -most, most),
                "A_s": free(d, -most, most),
                "n": free(n, n - near, n + near),
            }
            for n, c, d in site.search("friction_waves", (1.0, 1e-6, 0.0))
        ]
