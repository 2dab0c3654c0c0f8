"""Bodies that move as a system's inertias and gravity say: equivalent masses, for a model knows moments alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid_id.components.load.arm_gravity import ArmGravity
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.two_link import JointCoupling
from hybrid_id.errors import InputError
from hybrid_id.systems.chain import System, Views

G = 9.81
"""Gravity of the exported world [m/s^2]."""
LENGTH = 0.3
"""Of a first link [m] whose length no parameter gives: any will do."""
SLIVER = 1e-3
"""Share of a joint's inertia that its link gets where the model leaves it none: a body needs some."""


@dataclass(frozen=True)
class Link:
    """One link as a body.

    Attributes:
        armature: rotor, seen at the link [kg m^2].
        mass: equivalent mass [kg].
        arm: distance of its centre from the joint along the link [m].
        inertia: about its centre [kg m^2].
        extra: inertia at the link's own angle that no body has [kg m^2].
        place: distance of its joint from the joint before [m].
        weightless: whether gravity leaves it alone.
    """

    armature: float
    mass: float
    arm: float
    inertia: float
    extra: float = 0.0
    place: float = 0.0
    weightless: bool = False


def _coupling(system: System, p: Views, kind: type) -> Any:
    key = next((k for k, part in system.arm.couplings.items() if isinstance(part, kind)), None)
    return None if key is None else p[key]


def hanging_angle(system: System, p: Views) -> float | None:
    """Angle of joint 1 at which the arm hangs down [rad], None where no gravity acts."""
    arm = _coupling(system, p, ArmGravity)
    if arm is not None:
        return float(arm.q_0)
    single = [key for key, part in system.joints[0].loads if isinstance(part, Gravity)]
    return float(p[single[0]].q_0) if single and len(system.joints) == 1 else None


def links(system: System, p: Views) -> list[Link]:
    """The links of a system with one or two joints.

    Raises:
        InputError: no two bodies have the inertias of the model.
    """
    sides = []
    for joint in system.joints:
        (key, part), r = joint.inertia, joint.gear_ratio
        rotor, link = float(part.rotor(p[key], r)) * r**2, float(part.link(p[key], r))
        least = SLIVER * (rotor + link) if joint.rigid else 0.0
        sides.append((rotor + link - max(link, least), max(link, least)))
    if len(sides) == 1:
        weight = [float(p[key].G_l) for key, part in system.joints[0].loads if isinstance(part, Gravity)]
        return [Link(sides[0][0], *_body(sides[0][1], sum(weight) / G))]
    return _two(system, p, sides)


def _body(inertia: float, moment: float) -> tuple[float, float, float]:
    """Mass, arm and inertia about the centre, from the inertia about the joint and the mass's moment [kg m]."""
    mass = max(2.0 * moment**2 / inertia, 0.1 if inertia > 1e-3 else 100.0 * inertia)
    return mass, moment / mass, inertia - moment**2 / mass


def _two(system: System, p: Views, sides: list[tuple[float, float]]) -> list[Link]:
    """Both links of an arm: ``P_4 = I_2``, ``P_3 = m_2 l_1 c_2``, ``G_l2 = g m_2 c_2``, I_2 about joint 2."""
    (rotor, first), (rotor_2, second) = sides
    coupling, gravity = _coupling(system, p, JointCoupling), _coupling(system, p, ArmGravity)
    P_3, own = (0.0, 0.0) if coupling is None else (float(coupling.P_3), float(coupling.P_4))
    moment = 0.0 if gravity is None else float(gravity.G_l2) / G
    extra = 0.0
    if own <= 0.0 and P_3 == 0.0:
        own = SLIVER * second
    if system.joints[1].rigid:
        rotor_2 = rotor_2 + second - own
    else:
        extra = second - own
    weightless = moment == 0.0 and P_3 != 0.0
    if weightless:
        moment = P_3 / LENGTH
    if P_3 == 0.0:
        length = 0.0 if moment else LENGTH
        mass, arm, inertia = _body(own, moment) if own > 0 else (1.0, 0.0, 0.0)
        if not moment:
            mass = min(mass, SLIVER * first / LENGTH**2)
    else:
        length, (mass, arm) = (
            P_3 / moment,
            (moment**2 / (0.95 * own), 0.95 * own / moment) if own > 0 else (1.0, 0.0),
        )
        inertia = own - mass * arm**2
    rest = first - own - mass * length**2
    if rest <= 0.0 and system.joints[0].rigid:
        rest, rotor = rotor + rest - SLIVER * (rotor + first), SLIVER * (rotor + first)
    if own <= 0.0 or min(rest, rotor_2, extra) < 0.0 or rest == 0.0:
        raise InputError(
            "no two bodies have the inertias of this arm (P_2 must be at least P_4, and P_1 more than P_4 + P_3^2 / "
            "P_4); identify it within those bounds, then export it"
        )
    pull = 0.0 if gravity is None else float(gravity.G_l1) / G - (0.0 if weightless else mass * length)
    return [
        Link(rotor, *_body(rest, pull)),
        Link(rotor_2, mass, arm, inertia, extra, length, weightless and gravity is not None),
    ]
