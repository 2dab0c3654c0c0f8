"""Gravity on a two-link arm."""

import torch

from hybrid_id.components.base import Coupling
from hybrid_id.components.load.gravity import Gravity, hanging
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class ArmGravity(Coupling):
    """Gravity in a vertical or tilted plane, q_2 relative to link 1.

    ``tau_2 = G_l2 sin(q_1 + q_2 - q_0)``, ``tau_1 = G_l1 sin(q_1 - q_0) + tau_2``.

    Source: W. Khalil and E. Dombre, Modeling, Identification and Control of Robots, 2002.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | G_l1 | N m | weight torque about joint 1 of link 1 with link 2 as a point at its end |
    | G_l2 | N m | weight torque of link 2 about joint 2; in a tilted plane both times the sine of the tilt |
    | q_0 | rad | angle of joint 1 at which the stretched arm hangs, 0 in a vertical plane (held by default) |
    """

    kind = "arm_gravity"
    G_l1 = Parameter(0.0, lower=-1e6, upper=1e6, unit="N m", doc="weight torque about joint 1")
    G_l2 = Parameter(0.0, lower=-1e6, upper=1e6, unit="N m", doc="weight torque of link 2 about joint 2")
    q_0 = Parameter(0.0, lower=-10.0, upper=10.0, unit="rad", doc="angle of the hanging arm", estimate=False)
    effect = Gravity.effect

    def torques(self, p, angles, speeds):
        first = angles[0] - p.q_0
        second = p.G_l2 * torch.sin(first + angles[1])
        return p.G_l1 * torch.sin(first) + second, second

    @staticmethod
    def starts(site):
        if len(site.ratios) == 1 or site.joint > 1:  # a weight on either link shows at both joints
            return []
        torque = site.torque * site.ratio
        sizes = [free(share * torque, -3.0 * torque, 3.0 * torque) for share in (0.05, 0.02)]
        return hanging(site.at().get("arm_gravity"), dict(zip(("G_l1", "G_l2"), sizes, strict=True)))
