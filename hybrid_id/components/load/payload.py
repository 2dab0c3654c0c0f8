"""What a robot carries: a point mass at one of its points."""

from types import SimpleNamespace

from torch import Tensor

from hybrid_id.components.base import Attached
from hybrid_id.parameters import Parameter


class Payload(Attached):
    """A mass ``m_l`` at ``(x_l, y_l, z_l)`` in the axes of a site or body: its weight and inertia act on all joints.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | m_l | kg | mass; 0 is no payload |
    | x_l, y_l, z_l | m | its centre in the axes of the site or body (held at 0 by default) |

    The payload's inertia about its own centre is neglected. The joint at whose load it is listed must carry it; a fit
    of one joint by itself estimates it at that joint alone.

    Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, section 12.6.
    """

    kind = "payload"
    m_l = Parameter(0.1, upper=1e4, unit="kg", doc="mass of the payload")
    x_l = Parameter(0.0, lower=-10.0, upper=10.0, unit="m", doc="centre along x", estimate=False)
    y_l = Parameter(0.0, lower=-10.0, upper=10.0, unit="m", doc="centre along y", estimate=False)
    z_l = Parameter(0.0, lower=-10.0, upper=10.0, unit="m", doc="centre along z", estimate=False)

    def mass(self, p: SimpleNamespace) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor]]:
        """Mass [kg] and centre [m] in the axes of the point, ``(B,)`` each."""
        return p.m_l, (p.x_l, p.y_l, p.z_l)
