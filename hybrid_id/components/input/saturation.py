"""Limit of the supply."""

import torch

from hybrid_id.components.drive import CommandMap
from hybrid_id.parameters import Parameter


class Saturation(CommandMap):
    """``u' = sgn u min(|u|, V_max)``: the supply gives no more than V_max [V].

    Source: saturation, e.g. H. Khalil, Nonlinear Systems, 3rd ed., 2002, section 1.2.7.
    """

    kind = "voltage_saturation"
    V_max = Parameter(10.0, upper=1e4, unit="V", doc="largest voltage")

    def map(self, p, command, speed):
        return torch.sign(command) * torch.minimum(command.abs(), p.V_max)
