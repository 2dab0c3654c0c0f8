"""Gravity on a link that moves in a vertical plane."""

import math

import torch

from hybrid_id.components.base import Effect, LoadTorque
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Gravity(LoadTorque):
    """``tau_g = G_l sin(q - q_0)`` at the link.

    Source: W. Khalil and E. Dombre, Modeling, Identification and Control of Robots, 2002.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | G_l = m g l | N m | gravity torque of the horizontal link |
    | q_0 | rad | angle of the hanging link, 0 unless the encoder's zero lies elsewhere (held by default) |
    """

    kind = "gravity_load"
    G_l = Parameter(1.0, lower=-1e6, upper=1e6, unit="N m", doc="gravity torque of the horizontal link")
    q_0 = Parameter(0.0, lower=-10.0, upper=10.0, unit="rad", doc="angle of the hanging link", estimate=False)
    effect = Effect(
        "gravity_load",
        "weight of the link, or of a plane that is tilted; up to the motor's whole torque where it moves vertically",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        {
            "spring_load": "slow motion both ways over a quarter turn and more: the pull of a spring grows evenly, "
            "that of a weight bends over",
            "joint_coupling": "each joint moved alone, slowly and fast: a weight acts at rest, a coupling with "
            "acceleration",
        },
        where_held=True,
    )

    def torque(self, p, angle, speed):
        return p.G_l * torch.sin(angle - p.q_0)

    @staticmethod
    def starts(site):
        if (
            len(site.ratios) > 1 or site.bodies
        ):  # the bodies of a robot have their weight: a wrong one is their mass
            return []
        torque = site.torque * site.ratio
        size = {"G_l": free(0.05 * torque, -3.0 * torque, 3.0 * torque)}
        return hanging(site.at().get("gravity_load"), size)

    def mjcf(self, p):
        return {}, ""  # the link's body weighs so


def hanging(here, size):
    """Start values of a weight anywhere on the link, or a plane tilted in any direction: the hanging angle is free.

    Args:
        here: the law where the model has it; its sizes are then kept as they are.
        size: its sizes, else.
    """
    angles = [0.5 * math.pi * quarter for quarter in range(4)]
    if here is not None:
        if here.specs["q_0"].estimate:
            return []
        size, angles = here.specs, [here.specs["q_0"].value + away for away in (0.3, -0.3)]
    turn = 2.0 * math.pi
    return [{**size, "q_0": free(angle, angle - turn, angle + turn)} for angle in angles]
