"""Dry friction in one range of the joint's angle."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class TightSpot(Friction):
    """Dry level ``A exp(-((q - q_0) / w)^2)`` beyond the other laws', q [rad] the joint's angle at the link.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | A | N m | height, negative where the friction is lower, where it acts (motor or link) |
    | q_0 | rad | middle of the spot |
    | w | rad | its half width |

    The levels of all laws of a place add up and never fall below zero: a tooth, a seal, a dent. Source: friction that
    depends on the angle, B. Armstrong-Helouvry, Control of Machines with Friction, Kluwer 1991; one radial basis.
    """

    kind = "tight_spot"
    A = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="height")
    q_0 = Parameter(0.0, lower=-1e3, upper=1e3, unit="rad", doc="middle of the spot")
    w = Parameter(0.2, lower=1e-3, upper=1e3, unit="rad", doc="its half width")

    def dry_over(self, p, angle):
        return p.A * torch.exp(-(((angle - p.q_0) / p.w) ** 2))
