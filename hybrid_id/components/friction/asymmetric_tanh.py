"""The paper's link-side friction."""

import torch

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class AsymmetricTanh(Friction):
    """Paper, eq. (9): ``tau = (f_a1 Pos(v) + f_a2 Pos(-v)) tanh(s v)``, v the link's speed, s = 70 s/rad.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | f_a1, f_a2 | N m | level at the link, forward and backward |
    | slope | s/rad | s, the paper's 70; held by default |

    Smooth through zero: it brakes but does not hold, so that a pushed link creeps (below 1 / s = 0.014 rad/s). Differs
    from the paper's letter: Neg(v) is read as Pos(-v) here, since tanh already carries the sign; the paper's second
    term would push.
    """

    kind = "asymmetric_tanh"
    has_level = by_direction = True
    f_a1 = Parameter(0.0063, upper=1e6, unit="N m", doc="level forward")
    f_a2 = Parameter(0.0056, upper=1e6, unit="N m", doc="level backward")
    slope = Parameter(70.0, lower=1e-3, upper=1e6, unit="s/rad", doc="steepness at zero", estimate=False)

    def smooth(self, p, speed):
        return torch.where(speed > 0, p.f_a1, p.f_a2) * torch.tanh(p.slope * speed)
