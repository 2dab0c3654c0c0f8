"""A base that does not stand as the robot's description says, so that gravity points elsewhere."""

import math
from types import SimpleNamespace

import torch
from torch import Tensor

from hybrid_id.components.base import Effect, Shared
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

POSTURES = (
    "rests in many postures: a tilted base loads each joint as its axis lies, a {} is the same in all of them"
)

_WALL = 0.5 * math.pi
MOUNTS = ((0.0, 0.0), (_WALL, 0.0), (-_WALL, 0.0), (0.0, _WALL), (0.0, -_WALL), (math.pi, 0.0))
"""Turns of a base about x and y that stands on a table, at each of four walls, and hangs from a ceiling [rad]."""


class BaseTilt(Shared):
    """Gravity ``R^T g_0`` in the base's axes, ``R = R_x(e_x) R_y(e_y)``: it acts on all joints.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | g_0 | m/s^2 | gravity in the description, in the base's axes |
    | e_x, e_y | rad | how far the base is turned about its x axis, then about its new y axis |

    A fit of one joint by itself estimates it at that joint alone.

    Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, section 9.3 (gravity in the
    base's axes).
    """

    kind = "base_tilt"
    e_x = Parameter(0.0, lower=-3.3, upper=3.3, unit="rad", doc="turn of the base about x")
    e_y = Parameter(0.0, lower=-1.6, upper=1.6, unit="rad", doc="turn of the base about y")
    effect = Effect(
        "base_tilt",
        "base that stands on a slope or is mounted askew, or gravity that points elsewhere in the description; "
        "usually a few degrees",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        {
            "constant_torque": POSTURES.format("bias"),
            "encoder_zero": POSTURES.format("wrong zero"),
            "link_mass": "rests in many postures, axes upright among them: a mass leaves an upright axis alone, a tilt "
            "loads it",
        },
    )

    def gravity(
        self, p: SimpleNamespace, described: tuple[float | Tensor, float | Tensor, float | Tensor]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Acceleration of free fall in the base's axes [m/s^2], ``(B,)`` each, of the described one."""
        x, y, z = described
        s_x, c_x, s_y, c_y = torch.sin(p.e_x), torch.cos(p.e_x), torch.sin(p.e_y), torch.cos(p.e_y)
        y, z = c_x * y + s_x * z, c_x * z - s_x * y
        return c_y * x - s_y * z, y, s_y * x + c_y * z

    @staticmethod
    def starts(site):
        if not site.bodies:
            return []
        return [{"e_x": free(x, -3.3, 3.3), "e_y": free(y, -1.6, 1.6)} for x, y in MOUNTS]
