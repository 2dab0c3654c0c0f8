"""Dry friction in one range of the joint's angle."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.components.friction.position_dependent import PositionDependent
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class LocalFriction(Friction):
    """Dry level ``A exp(-((q - q_0) / w)^2)`` beyond the other laws', q [rad] the joint's angle at the link.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | A | N m | height, negative where the friction is lower, where it acts (motor or link) |
    | q_0 | rad | middle of the spot |
    | w | rad | its half width |

    The levels of all laws of a place add up and never fall below zero: a tooth, a seal, a dent. Source: friction that
    depends on the angle, B. Armstrong-Helouvry, Control of Machines with Friction, Kluwer 1991; one radial basis.
    """

    kind = "local_friction"
    A = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="height")
    q_0 = Parameter(0.0, lower=-1e3, upper=1e3, unit="rad", doc="middle of the spot")
    w = Parameter(0.2, lower=1e-3, upper=1e3, unit="rad", doc="its half width")
    effect = PositionDependent.effect

    def dry_over(self, p, angle):
        return p.A * torch.exp(-(((angle - p.q_0) / p.w) ** 2))

    @staticmethod
    def starts(site):
        most, reach = 3.0 * site.dry * site.gearing, site.angle
        return [
            {
                "A": free(height, -most, most),
                "q_0": free(q, q - 0.2 * reach, q + 0.2 * reach),
                "w": free(w, 0.01 * reach, reach),
            }
            for q, w, height in site.search("friction_spots", (0.0, 0.1, 1e-6))
        ]
