"""Gravity on a link that moves in a vertical plane."""

import torch

from hybrid_id.components.base import LoadTorque
from hybrid_id.parameters import Parameter


class Gravity(LoadTorque):
    """``tau_g = G_l sin(q - q_0)`` at the link.

    Source: W. Khalil and E. Dombre, Modeling, Identification and Control of Robots, 2002.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | G_l = m g l | N m | gravity torque of the horizontal link |
    | q_0 | rad | angle of the hanging link, 0 unless the encoder's zero lies elsewhere (held unless told otherwise) |
    """

    kind = "gravity_load"
    G_l = Parameter(1.0, lower=-1e6, upper=1e6, unit="N m", doc="gravity torque of the horizontal link")
    q_0 = Parameter(0.0, lower=-10.0, upper=10.0, unit="rad", doc="angle of the hanging link", estimate=False)

    def torque(self, p, angle, speed):
        return p.G_l * torch.sin(angle - p.q_0)
