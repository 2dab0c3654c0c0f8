"""Stribeck's fall of friction from breakaway to Coulomb."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class Stribeck(Friction):
    """Paper, eq. (6): its exponential term, the level above Coulomb ``F_drop exp(-|v / v_s|^p)``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_drop = F_s - F_c | N m | breakaway level less Coulomb level |
    | v_s | rad/s | Stribeck speed |
    | p | 1 | shape; 1 exponential, 2 Gaussian (held unless told otherwise) |

    Differs from the paper's letter: F_s is written as F_c + F_drop with F_drop >= 0, so that the inequality
    F_s >= F_c holds by construction and F_drop = 0 is the Coulomb model. Coulomb and viscous terms are components
    of their own.
    """

    kind = "stribeck_friction"
    F_drop = Parameter(0.005, upper=1e6, unit="N m", doc="breakaway less Coulomb level")
    v_s = Parameter(10.0, lower=1e-6, upper=1e5, unit="rad/s", doc="Stribeck speed")
    p = Parameter(1.0, lower=0.25, upper=4.0, unit="1", doc="shape exponent", estimate=False)

    def dry(self, p, magnitude, forward):
        # the offset keeps the derivative of the power finite at rest
        return p.F_drop * torch.exp(-(((magnitude + 1e-12) / p.v_s) ** p.p))
