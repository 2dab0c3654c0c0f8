"""Threshold of an amplifier."""

import torch

from hybrid_id.components.drive import CommandMap
from hybrid_id.parameters import Parameter


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

    def map(self, p, command, speed):
        above = command.abs() - p.V_0
        return torch.sign(command) * (above.clamp_min(0.0) + p.jump * p.V_0 * torch.sigmoid(above / p.width))
