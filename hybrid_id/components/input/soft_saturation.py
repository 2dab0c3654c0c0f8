"""A supply whose limit is neared gradually."""

import torch

from hybrid_id.components.base import CommandMap
from hybrid_id.components.input.saturation import Saturation
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

SOFTEST = 3.0
"""Least exponent that is looked for: at half of V_max 4 % of the command are lost. No supply's limit bends more."""


class SoftSaturation(CommandMap):
    """``u' = u / (1 + |u / V_max|^n)^(1/n)``: the supply gives less and less of a command that nears V_max.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | V_max | V | what no command exceeds |
    | n | 1 | sharpness: 2 bends from half of V_max on, 20 is a corner to the eye |

    Source: the limit of a power stage with a soft knee, C. Rapp, "Effects of HPA-nonlinearity on a 4-DPSK/OFDM-signal
    for a digital sound broadcasting system", Proc. 2nd European Conf. Satellite Communications, 1991.
    """

    kind = "soft_saturation"
    V_max = Parameter(10.0, lower=1e-6, upper=1e4, unit="V", doc="largest voltage")
    n = Parameter(6.0, lower=1.0, upper=50.0, unit="1", doc="sharpness of the knee")
    effect = Saturation.effect

    def map(self, p, command, speed):
        size = command.abs()
        # relative to the larger of both, whose power is 1: neither overflows
        largest = torch.maximum(size, p.V_max * torch.ones_like(size))
        both = (size / largest) ** p.n + (p.V_max / largest) ** p.n
        return command * p.V_max / (largest * both ** (1.0 / p.n))

    @staticmethod
    def starts(site):
        if site.has("duty_supply"):
            return []
        low, high = 0.2 * site.command, site.command
        return [
            {"V_max": free(x * high, low, 2.0 * high), "n": free(6.0, SOFTEST, 30.0)} for x in (0.95, 0.65)
        ]
