"""What a robot touches: a level floor or table under one of its points."""

from __future__ import annotations

from types import SimpleNamespace

from torch import Tensor

from hybrid_id.components.base import Attached, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

LIFTED = "the same slow moves of the joint with the tip high and low: what it touches pushes where the tip is low alone"


class FloorContact(Attached):
    """``f = k_f max(z_f - z, 0)`` upwards at a point of the robot at height z: it acts on all joints that carry it.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | z_f | m | height of the floor in the axes of the robot's base |
    | k_f | N/m | stiffness of floor, point and links together |

    The floor neither damps nor rubs. The point is a site or a body's origin of the robot's description, named by the
    option ``point``.

    Source: penalty contact, e.g. W. J. Stronge, Impact Mechanics, 2nd ed., 2018, section 11.1.
    """

    kind = "floor_contact"
    left_out = "is left out, a plane in the description does it"
    z_f = Parameter(0.0, lower=-100.0, upper=100.0, unit="m", doc="height of the floor")
    k_f = Parameter(1e3, upper=1e8, unit="N/m", doc="stiffness of the contact")
    effect = Effect(
        "floor_contact",
        "floor or table that the robot's end rests on where it is low, along the base's z; usually as much force as "
        "the motors give, where goals end below it",
        "W. J. Stronge, Impact Mechanics, 2nd ed., Cambridge, 2018",
        {
            "cable_pull": LIFTED,
            "spring_load": LIFTED,
            "constant_torque": LIFTED,
            "link_mass": LIFTED,
            "encoder_zero": LIFTED,
            "joint_flexibility": LIFTED,
        },
        smoothness="kinks where it touches",
    )

    def force(self, p: SimpleNamespace, height: Tensor | float) -> Tensor:
        """Force upwards [N], ``(B,)``, at a height [m]."""
        return p.k_f * (p.z_f - height).clamp_min(0.0)

    @staticmethod
    def starts(site):
        if site.tip is None:
            return []
        lowest, highest = site.tip.lowest, site.tip.highest
        reach = highest - lowest
        # pressed in by as much as the tip moves, at a lever as long, it takes the joint's torque
        size = site.torque * site.ratio / reach**2
        k_f = free(10.0 * size, 0.0, 1e4 * size)
        return [
            {"point": site.tip.name, "z_f": free(lowest + share * reach, lowest, highest), "k_f": k_f}
            for share in (0.1, 0.3)
        ]
