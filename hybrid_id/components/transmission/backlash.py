"""Play in the gear."""

import math

import torch

from hybrid_id.components.base import Effect, Transmission
from hybrid_id.components.site import free
from hybrid_id.components.transmission.flexibility import damping, stiffness
from hybrid_id.parameters import Parameter

GAPS = (0.0007, 0.0015, 0.003, 0.006, 0.012, 0.025, 0.05, 0.1)
"""Play as a share of the link's range: a fit has a local minimum near each."""


class Backlash(Transmission):
    """Dead zone with a spring and a damper that act in contact only.

    With ``delta = q_m / r - q_a`` and the depth e by which it leaves [-gap / 2, gap / 2]:
    ``tau_s = k e + D``, the damper's ``D = d d(delta)/dt`` held within ``[-k |e|, k |e|]``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | gap | rad | total play at the link: what the link may move while the rotor is held |
    | c = 1 / k | rad/(N m) | compliance in contact; 0 is a rigid gear with play (see ``joint_flexibility``) |
    | zeta | 1 | damping ratio in contact: ``d = 2 zeta sqrt(k J)``, J the inertias of rotor and link in series |

    The damper never exceeds the spring: the teeth do not pull as they part, and they do not meet with a jump of torque,
    over which no step would be accurate nor a sensitivity exact. gap = c = 0 is the rigid gear, gap = 0 a flexible one,
    from which fits of richer models start; a wide gap has local minima, so start at several.

    Source: the classical dead zone, [15] of the paper.
    """

    kind = "backlash"
    gap = Parameter(0.0, upper=1.0, unit="rad", doc="total play at the link")
    compliance = Parameter(0.0, upper=1e6, unit="rad/(N m)", doc="compliance in contact", estimate=False)
    zeta = Parameter(0.3, upper=2.0, unit="1", doc="damping ratio in contact", estimate=False)
    splits_inertia = True
    effect = Effect(
        "backlash",
        "play between teeth; usually 1 to 20 mrad at the link of spur and planetary gears, next to none in harmonic "
        "drives",
        "M. Nordin, P.-O. Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38(10), 2002",
        {
            "joint_flexibility": "slow reversals under little load and much, with an encoder on the link: play is as "
            "wide under any load, a spring's twist grows with it",
            "hardening_flexibility": "loads from one side to the other, with an encoder on the link: play gives way "
            "without torque, a spring never does",
            "kinematic_error": "slow turns both ways, with an encoder on the link: play shifts with the direction, an "
            "error of the gear does not",
        },
        smoothness="kinks where the teeth touch",
    )

    def torque(self, p, deflection, rate, inertia):
        half, k = 0.5 * p.gap, stiffness(p.compliance, inertia)
        beyond = deflection - half * torch.sign(deflection)
        spring = k * torch.where(deflection.abs() >= half, beyond, torch.zeros_like(beyond))
        damper = damping(p.zeta, k, inertia) * rate
        return spring + torch.minimum(torch.maximum(damper, -spring.abs()), spring.abs())

    def loaded(self, p):
        return 0.5 * p.gap + 1e-6

    @staticmethod
    def starts(site):
        # play has a compliance of its own, and would take the place of one that another effect has brought
        if site.has("backlash_flexibility", "hardening_flexibility", "joint_flexibility"):
            return []
        gaps = [free(share * site.angle, 0.0, 0.3 * site.angle) for share in GAPS]
        spring = site.at().get("linear_spring")
        if spring is None:
            return [{"gap": gap} for gap in gaps]
        k, d = spring.specs["k"].value, spring.specs["d"].value
        zeta = d / (2.0 * math.sqrt(k * site.series))
        contact = {"compliance": free(1 / k, 0.0, 30 / k), "zeta": free(zeta, 0.0, 2.0)}
        return [{"gap": gap, **contact} for gap in gaps]
