"""Joint flexibility as a compliance, so that zero is the rigid gear."""

import math

import torch

from hybrid_id.components.base import Effect, Transmission
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

STIFFEST = 2.0 * math.pi * 150.0
"""Angular frequency [rad/s] of rotor against link at compliance 0: five sub-steps at 500 Hz follow it."""
RESONANCES = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Where rotor and link may swing against each other [Hz]: a fit finds what is half an octave away."""
SOFTEST = 10.0
"""Largest compliance, over that of the slowest swing: how the inertia divides between rotor and link is not known."""
UNLOADED = (
    "slow turns without load and with it, with an encoder on the link: an error of the gear repeats with the rotor's "
    "angle, a spring's twist goes with the load"
)


def stiffness(compliance, inertia):
    """Stiffness [N m/rad] of a compliance [rad/(N m)] >= 0 in series with the least that the steps can follow.

    Args:
        compliance: of the gear, at the link.
        inertia: rotor and link in series, ``J_m r^2 J_a / (J_m r^2 + J_a)`` [kg m^2].
    """
    return 1.0 / (compliance + 1.0 / (inertia * STIFFEST**2))


def damping(ratio, stiff, inertia):
    """Damping [N m s/rad] at a share ``ratio`` of the critical one."""
    return 2.0 * ratio * torch.sqrt(stiff * inertia)


class JointFlexibility(Transmission):
    """Linear spring and damper between rotor and link, ``tau_s = k delta + d d(delta)/dt``, ``delta = q_m / r - q_a``.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | c = 1 / k | rad/(N m) | compliance at the link; 0 is the rigid gear, from which a fit of a richer model starts |
    | zeta | 1 | damping ratio: ``d = 2 zeta sqrt(k J)``, J the inertias of rotor and link in series |

    The law of ``linear_spring`` in parameters that end at the rigid gear. A truly rigid gear has fewer states, and an
    implicit step would blur the moments at which dry friction stops a side; so c = 0 is a spring at which rotor and
    link swing at 150 Hz, with which a servo's record agrees to well below an encoder's noise, stepped as any other.

    Source: M. W. Spong, Modeling and control of elastic joint robots, J. Dyn. Syst. Meas. Control 109, 1987.

    Along c a fit has several local minima: start it, too, where rotor and link swing within the band of the records.
    """

    kind = "joint_flexibility"
    compliance = Parameter(0.0, upper=1e6, unit="rad/(N m)", doc="compliance")
    zeta = Parameter(0.1, upper=2.0, unit="1", doc="damping ratio")
    splits_inertia = True
    effect = Effect(
        "joint_flexibility",
        "gear or shaft that twists under load; rotor and link usually swing against each other at 5 to 30 Hz",
        "M. W. Spong, Modeling and control of elastic joint robots, J. Dynamic Systems, Measurement, and Control "
        "109(4), 1987",
        {
            "hardening_flexibility": "the same sweep at several amplitudes: a hardening spring moves its resonance",
            "kinematic_error": UNLOADED,
            "spring_load": "slow motion over the whole range: a spring at the load pulls the harder the further, that "
            "of a gear does not",
        },
    )

    def torque(self, p, deflection, rate, inertia):
        k = stiffness(p.compliance, inertia)
        return k * deflection + damping(p.zeta, k, inertia) * rate

    @staticmethod
    def starts(site):
        if not site.rigid:
            return []
        compliances = [1.0 / (site.series * (2 * math.pi * f) ** 2) for f in RESONANCES]
        soft = SOFTEST * max(compliances)
        return [{"compliance": free(c, 0.0, soft), "zeta": free(0.1, 0.0, 2.0)} for c in compliances]
