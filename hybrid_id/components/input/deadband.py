"""Threshold of an amplifier."""

import torch

from hybrid_id.components.base import CommandMap, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

THRESHOLD = "slow ramps from rest at many angles: the threshold of a dead band is the same at all of them"


class Deadband(CommandMap):
    """``u' = sgn u (max(|u| - V_0, 0) + jump V_0 s((|u| - V_0) / width))``, s the logistic function.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | V_0 | V | threshold below which nothing comes out |
    | jump | 1 | 0: above it the command less the threshold; 1: above it the whole command |
    | width | V | over which the jump is smoothed, so that the records tell V_0 |

    Source: dead zone and relay with dead zone, e.g. H. Khalil, Nonlinear Systems, 3rd ed., 2002, section 1.2.7.
    """

    kind = "voltage_deadband"
    stage = 0
    V_0 = Parameter(0.2, upper=1e3, unit="V", doc="threshold")
    jump = Parameter(0.5, upper=1.0, unit="1", doc="share of the threshold that comes back above it")
    width = Parameter(0.02, lower=1e-6, upper=1e3, unit="V", doc="width of the jump", estimate=False)
    effect = Effect(
        "voltage_deadband",
        "amplifier that gives nothing below a threshold, from the dead time of its switches; usually 1 to 5 % of the "
        "supply",
        "S.-G. Jeong, M.-H. Park, The analysis and compensation of dead-time effects in PWM inverters, IEEE Trans. "
        "Industrial Electronics 38(2), 1991",
        {
            "coulomb_friction": "coasting, and braking by commands against the motion: friction helps to brake, a dead "
            "band takes from it",
            "stribeck_friction": "steady speeds from creeping upwards: a dead band costs the same voltage at each, "
            "what Stribeck friction adds falls off",
            "presliding_friction": "small steps from rest, below what breaks it away: a bristle gives way a little and "
            "springs back, in a dead band nothing moves",
            "position_dependent_friction": THRESHOLD,
            "cogging": THRESHOLD,
            "constant_torque": "the same small commands of either sign from rest: a dead band takes alike from both, a "
            "bias helps one and hinders the other",
            "backlash": "reversals with a weight or a spring that holds the teeth on one side: play is gone, a dead "
            "band is not",
        },
        smoothness="kinks or jumps at the threshold",
    )

    def map(self, p, command, speed):
        above = command.abs() - p.V_0
        return torch.sign(command) * (above.clamp_min(0.0) + p.jump * p.V_0 * torch.sigmoid(above / p.width))

    @staticmethod
    def starts(site):
        size = site.command_rms
        return [
            {
                "V_0": free(share * size, 0.0, size),
                "jump": free(jump, 0.0, 1.0),
                "width": max(0.002 * size, 1e-6),
            }
            for share in (0.05, 0.2, 0.5)
            for jump in (0.05, 0.95)
        ]

    def mjcf(self, p):
        return {}, "is left out, MuJoCo's actuators have no dead band"
