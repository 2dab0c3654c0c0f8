"""Gravity on a link that moves in a vertical plane."""

import torch

from hybrid_id.components.base import LoadTorque
from hybrid_id.parameters import Parameter


class Gravity(LoadTorque):
    """``tau_g = G_l sin q`` at the link, q = 0 hanging down.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | G_l = m g l | N m | gravity torque of the horizontal link |
    """

    kind = "gravity_load"
    G_l = Parameter(1.0, lower=-1e6, upper=1e6, unit="N m", doc="gravity torque of the horizontal link")

    def torque(self, p, angle, speed):
        return p.G_l * torch.sin(angle)
