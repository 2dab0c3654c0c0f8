"""Friction that grows with the torque through the gear."""

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter


class LoadDependent(Friction):
    """Dry level ``mu |tau_t|`` with tau_t the torque transmitted through the gear, seen at the motor.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | mu | 1 | friction per transmitted torque |

    ``systems/joint.py: balances`` has the loop (friction changes the acceleration, which changes tau_t) in closed
    form. tau_t depends on how the inertia is shared between rotor and link, so ``splits_inertia`` frees the rotor's
    share. The effect has a second law, ``efficiency_loss``, which takes the motor's torque and needs no share. Source:
    Rhoban BAM, models M3-M6 (Duclusaud et al., ICRA 2025, arXiv 2410.08650); there the load is |tau_m - tau_external|,
    which is twice the transmitted torque of a joint whose inertia is shared equally between rotor and link.
    """

    kind = "load_dependent_friction"
    places = ("motor_friction",)
    mu = Parameter(0.05, upper=0.95, unit="1", doc="friction per transmitted torque")
    splits_inertia = True
    effect = Effect(
        "load_dependent_friction",
        "teeth that rub the harder the more torque they carry; usually 5 to 30 % of it, what the gear's efficiency "
        "lacks of one",
        "A. C. Bittencourt, S. Gunnarsson, Static friction in a robot joint - modeling and identification of load and "
        "temperature effects, J. Dynamic Systems, Measurement, and Control 134(5), 2012",
        {
            "position_dependent_friction": "the same slow move with two payloads: friction over the angle stays as it "
            "is",
        },
        smoothness="jumps with the direction",
    )

    def load_factor(self, p):
        return p.mu

    @staticmethod
    def starts(site):
        return [{"mu": free(0.1, 0.0, 0.9)}]
