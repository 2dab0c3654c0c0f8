"""Stribeck's fall of friction from breakaway to Coulomb."""

import torch

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Stribeck(Friction):
    """Paper, eq. (6): its exponential term, the level above Coulomb ``F_drop exp(-|v / v_s|^p)``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_drop = F_s - F_c | N m | breakaway level less Coulomb level |
    | v_s | rad/s | Stribeck speed |
    | p | 1 | shape; 1 exponential, 2 Gaussian (held by default) |

    Differs from the paper's letter: F_s is written as F_c + F_drop with F_drop >= 0, so that the inequality
    F_s >= F_c holds by construction and F_drop = 0 is the Coulomb model. Coulomb and viscous terms are components
    of their own.
    """

    kind = "stribeck_friction"
    F_drop = Parameter(0.005, upper=1e6, unit="N m", doc="breakaway less Coulomb level")
    v_s = Parameter(10.0, lower=1e-6, upper=1e5, unit="rad/s", doc="Stribeck speed")
    p = Parameter(1.0, lower=0.25, upper=4.0, unit="1", doc="shape exponent", estimate=False)
    has_level = True
    effect = Effect(
        "stribeck_friction",
        "friction that falls from breakaway to Coulomb as a film of lubricant builds up; breakaway is usually 10 to "
        "60 % above",
        "L. C. Bo, D. Pavelescu, The friction-speed relation and its influence on the critical velocity of stick-slip "
        "motion, Wear 82(3), 1982",
        {
            "presliding_friction": "creeping at steady speeds, then small reversals from rest: the one shows a "
            "Stribeck fall, the other a bristle",
            "quadratic_drag": "steady speeds from creeping to the top: the slow end bends by a Stribeck fall, the fast "
            "by drag",
            "kinematic_error": "creeping at steady speeds over several turns: Stribeck friction goes with the speed "
            "alone, an error of the gear repeats with the rotor's angle",
        },
        smoothness="jumps with the direction",
    )

    def dry(self, p, magnitude, forward):
        # the offset keeps the derivative of the power finite at rest
        return p.F_drop * torch.exp(-(((magnitude + 1e-12) / p.v_s) ** p.p))

    @staticmethod
    def starts(site):
        if any(law.by_direction for law in site.frictions) or not site.has("coulomb_friction"):
            return []
        r, v = site.gearing, site.speed / site.gearing
        return [
            {
                "F_drop": free(0.3 * site.dry * r, 0.0, 5.0 * site.dry * r),
                "v_s": free(share * v, 0.002 * v, v),
                "p": free(p, 0.5, 3.0),
            }
            for share in (0.03, 0.15, 0.4)
            for p in (1.0, 2.0)
        ]
