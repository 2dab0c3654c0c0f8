"""Dry and viscous friction that one direction has beyond the other."""

import torch

from hybrid_id.components.base import Effect, Friction
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

ALL_OVER = "slow motion both ways over the whole range: uneven friction is the same all over, the load is not"


class AsymmetricFriction(Friction):
    """``max(F_a, 0)`` forwards and ``max(-F_a, 0)`` backwards, dry; and so the viscous D_a: beside any other law.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | F_a | N m | dry friction forwards beyond that backwards; negative where backwards has more |
    | D_a | N m s/rad | the same of the viscous friction |

    Source: direction-dependent friction, B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994,
    section 2; the paper's eq. (8) and (15) hold it together with the Stribeck curve.
    """

    kind = "asymmetric_friction"
    F_a = Parameter(1e-3, lower=-1e3, upper=1e3, unit="N m", doc="dry friction forwards beyond backwards")
    D_a = Parameter(
        1e-6, lower=-1e3, upper=1e3, unit="N m s/rad", doc="viscous friction forwards beyond backwards"
    )
    effect = Effect(
        "asymmetric_friction",
        "friction that one direction has more of, of preloaded teeth or seals; usually 5 to 30 % of the friction",
        "B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and compensation "
        "methods for the control of machines with friction, Automatica 30(7), 1994",
        {
            "constant_torque": "steady speeds both ways at several heights, cold and warm: friction changes, a bias "
            "stays (an uneven dry level that never changes is the same law as a bias on its side of the gear)",
            "gravity_load": ALL_OVER,
            "spring_load": ALL_OVER,
            "quadratic_drag": "the same steady speeds both ways up to the top: drag is the same both ways",
            "load_dependent_friction": "the same moves both ways with two payloads: uneven friction keeps to the "
            "direction, the other grows with the load",
        },
        smoothness="jumps with the direction",
    )

    def smooth(self, p, speed):
        return _beyond(p.D_a, (speed > 0).to(speed.dtype)) * speed

    def dry(self, p, magnitude, forward):
        return _beyond(p.F_a, forward)

    @staticmethod
    def starts(site):
        if any(law.by_direction for law in site.frictions):
            return []
        limit, damp = site.dry * site.gearing, 2.0 * site.torque * site.gearing**2 / site.speed
        return [
            {"F_a": free(sign * 0.2 * limit, -3 * limit, 3 * limit), "D_a": free(0.0, -damp, damp)}
            for sign in (1.0, -1.0)
        ]


def _beyond(excess, forward):
    # a parameter at zero may leave it to either side: its slope there is that of the forward half
    return torch.where(excess >= 0, excess * forward, -excess * (1.0 - forward))
