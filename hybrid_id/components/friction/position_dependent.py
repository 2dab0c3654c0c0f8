"""Dry friction that varies over the joint's angle."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


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

    def dry_over(self, p, angle):
        return p.A_0 + p.A_c * torch.cos(p.n * angle) + p.A_s * torch.sin(p.n * angle)
