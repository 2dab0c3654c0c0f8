"""Friction that grows with the torque through the gear."""

from hybrid_id.components.base import Friction
from hybrid_id.parameters import Parameter


class LoadDependent(Friction):
    """Dry level ``mu |tau_t|`` with tau_t the torque transmitted through the gear, seen at the motor.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | mu | 1 | friction per transmitted torque |

    The chain solves the loop (friction changes the acceleration, which changes tau_t) in closed form. Source: Rhoban
    BAM, models M3-M6 (Duclusaud et al., ICRA 2025, arXiv 2410.08650); there the load is |tau_m - tau_external|, which
    is twice the transmitted torque of a joint whose inertia is shared equally between rotor and link.
    """

    kind = "load_dependent_friction"
    places = ("motor_friction",)
    mu = Parameter(0.05, upper=0.95, unit="1", doc="friction per transmitted torque")

    def load_factor(self, p):
        return p.mu
