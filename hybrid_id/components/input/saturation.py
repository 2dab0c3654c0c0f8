"""Limit of the supply."""

import torch

from hybrid_id.components.base import CommandMap, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class Saturation(CommandMap):
    """``u' = sgn u min(|u|, V_max)``: the supply gives no more than V_max [V].

    Source: saturation, e.g. H. Khalil, Nonlinear Systems, 3rd ed., 2002, section 1.2.7.
    """

    kind = "voltage_saturation"
    V_max = Parameter(10.0, upper=1e4, unit="V", doc="largest voltage")
    effect = Effect(
        "voltage_saturation",
        "supply or amplifier that gives no more than a limit; usually 2 to 20 % below the supply's nominal voltage",
        "H. K. Khalil, Nonlinear Systems, 3rd ed., Prentice Hall, 2002, section 1.2.7",
        {
            "quadratic_drag": "steps of growing height from standstill: a limit shows in the first acceleration, drag "
            "at speed only",
            "thermal_derating": "the same full step cold and after minutes of heavy work: a limit cuts alike, heat "
            "takes more by then",
            "load_dependent_friction": "a heavy payload moved by commands well below the limit: friction under load "
            "still shows",
            "stribeck_friction": "steady slow speeds at small commands: Stribeck friction acts there, a limit does not",
            "kinematic_error": "slow turns at small commands, with an encoder on the link: an error of the gear "
            "repeats with the rotor's angle, a limit does not act",
        },
        smoothness="kinks at the limit, or bends before it",
    )

    def map(self, p, command, speed):
        return torch.sign(command) * torch.minimum(command.abs(), p.V_max)

    @staticmethod
    def starts(site):
        # the duty that an amplifier has applied, beside the supply, has its limits in it
        if site.has("duty_supply"):
            return []
        low, high = 0.2 * site.command, site.command
        return [{"V_max": free(x * high, low, high)} for x in (0.95, 0.75, 0.55)]

    def mjcf(self, p):
        return {"ctrlrange": (-p.V_max, p.V_max)}, ""
