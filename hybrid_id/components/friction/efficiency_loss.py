"""Friction that grows with the torque that goes into the gear."""

from hybrid_id.components.base import Friction
from hybrid_id.components.friction.load_dependent import LoadDependent
from hybrid_id.parameters import Parameter


class EfficiencyLoss(Friction):
    """Dry level ``mu |tau_m|`` with tau_m the torque of the motor: of what goes in, the share 1 - mu comes out.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | mu | 1 | friction per torque of the motor, one less the gear's efficiency |

    Where ``load_dependent_friction`` takes the torque that leaves the gear, this law takes the one that enters it; a
    rotor that accelerates distinguishes them. Source: efficiency of a gear, e.g. VDI 2158 and G. Niemann, H. Winter,
    Maschinenelemente 2, Springer 2003, section 21.5.
    """

    kind = "efficiency_loss"
    places = ("motor_friction",)
    mu = Parameter(0.05, upper=0.95, unit="1", doc="friction per torque of the motor")
    effect = LoadDependent.effect

    def effort_factor(self, p):
        return p.mu

    @staticmethod
    def starts(site):
        return LoadDependent.starts(site)
