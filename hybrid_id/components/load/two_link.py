"""Two links: the inertia of each joint at its link, and what couples the two."""

import torch

from hybrid_id.components.base import Coupling, Effect, Inertia
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class LinkInertia(Inertia):
    """All that one joint of an arm moves, as one number at the link: the paper's P_1 or P_2.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | P | kg m^2 | P_1: both links with q_2 at 90 degrees, and rotor 1 times r^2; P_2: link 2, and rotor 2 times r^2 |
    | rotor_share | 1 | part of P on the motor's side of the gear; not identifiable while the gear is rigid and no
    load-dependent friction acts, so it is held by default |
    """

    kind = "link_inertia"
    P = Parameter(0.5, lower=1e-12, upper=1e9, unit="kg m^2", doc="inertia at the link")
    rotor_share = Parameter(0.3, upper=1.0, unit="1", doc="share of the rotor in P", estimate=False)

    def rotor(self, p, gear_ratio):
        return p.rotor_share * p.P / gear_ratio**2

    def link(self, p, gear_ratio):
        return (1.0 - p.rotor_share) * p.P

    def total(self, p, gear_ratio):
        return p.P / gear_ratio**2


class JointCoupling(Coupling):
    """Paper, eq. (13) and (14): the terms of P_3 and P_4 in ``M(q) a + c(q, v) = tau``, q_2 relative to link 1.

    ``M = [[P_1 + 2 P_3 cos q_2, P_4 + P_3 cos q_2], [., P_2]]``,
    ``c = [-P_3 sin q_2 (2 v_1 v_2 + v_2^2), P_3 sin q_2 v_1^2]``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | P_3 | kg m^2 | mass of link 2 times length of link 1 times distance of its centre from joint 2 |
    | P_4 | kg m^2 | link 2 alone about joint 2; both are 0 where the joints are not coupled |

    The paper prints neither M nor c; this is the planar arm with four parameters in M, the share of rotor 2's spin
    in M_12 neglected. P_1 and P_2 belong to ``link_inertia`` of the two joints.
    """

    kind = "joint_coupling"
    P_3 = Parameter(0.0, lower=-1e9, upper=1e9, unit="kg m^2", doc="coupling that varies with the angle")
    P_4 = Parameter(0.0, lower=-1e9, upper=1e9, unit="kg m^2", doc="link 2 alone about its joint")
    effect = Effect(
        "joint_coupling",
        "torques by which the links of an arm accelerate each other; of the size of the second link's inertia",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        where_held=True,
    )

    def inertia(self, p, angle):
        varying = p.P_3 * torch.cos(angle)
        return 2.0 * varying, p.P_4 + varying

    def torques(self, p, angles, speeds):
        (_, angle), (first, second) = angles, speeds
        varying = p.P_3 * torch.sin(angle)
        return -varying * (2.0 * first + second) * second, varying * first**2

    @staticmethod
    def starts(site):
        known = [part for part in site.components.values() if isinstance(part, JointCoupling)]
        if len(site.ratios) < 2 or site.joint != 1:
            return []
        if any(spec.estimate for part in known for spec in part.specs.values()):
            return []
        at_second = (part for key, part in site.components.items() if key.startswith("joint2/load/"))
        inertia, ratio = next(part for part in at_second if isinstance(part, Inertia)), site.ratios[1]
        size = float(inertia.total(inertia.view(), ratio).detach()) * ratio**2
        return [{"P_3": free(0.2 * size, 0.0, 3 * size), "P_4": free(0.3 * size, 0.0, size)}]
