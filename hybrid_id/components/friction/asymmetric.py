"""Dry and viscous friction that one direction has beyond the other."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class AsymmetricFriction(Friction):
    """``max(F_a, 0)`` forwards and ``max(-F_a, 0)`` backwards, dry; and so the viscous D_a: beside any other law.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_a | N m | dry friction forwards beyond that backwards; negative where backwards has more |
    | D_a | N m s/rad | the same of the viscous friction |

    Source: direction-dependent friction, B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994,
    section 2; the paper's eq. (8) and (15) hold it together with the Stribeck curve.
    """

    kind = "asymmetric_friction"
    F_a = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="dry friction forwards beyond backwards")
    D_a = Parameter(
        1e-6, lower=-1e3, upper=1e3, unit="N m s/rad", doc="viscous friction forwards beyond backwards"
    )

    def smooth(self, p, speed):
        return _beyond(p.D_a, (speed > 0).to(speed.dtype)) * speed

    def dry(self, p, magnitude, forward):
        return _beyond(p.F_a, forward)


def _beyond(excess, forward):
    # a parameter at zero may leave it to either side: its slope there is that of the forward half
    return torch.where(excess >= 0, excess * forward, -excess * (1.0 - forward))
