"""The rotor of a joint whose link belongs to a rigid-body tree."""

import torch

from hybrid_id.components.base import Inertia
from hybrid_id.parameters import Parameter


class RotorInertia(Inertia):
    """What turns with the motor: rotor, pinion and fast gears; MuJoCo's ``armature`` over the gear ratio squared.

    The inertia of the links depends on the arm's posture and comes from the tree (:mod:`hybrid_id.robots.tree`).

    | symbol | unit | meaning |
    | --- | --- | --- |
    | J_m | kg m^2 | rotor and gear, at the motor |
    """

    kind = "rotor_inertia"
    at_motor = True
    J_m = Parameter(1e-5, lower=1e-12, upper=1e6, unit="kg m^2", doc="rotor inertia at the motor")

    def rotor(self, p, gear_ratio):
        return p.J_m

    def link(self, p, gear_ratio):
        return torch.zeros_like(p.J_m)
