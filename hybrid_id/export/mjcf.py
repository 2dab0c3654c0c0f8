"""A system as an MJCF document for MuJoCo 4: what stands for what, and what it leaves out.

A joint becomes a hinge at the link's angle whose armature is the rotor behind the gear. Behind a compliant gear that
hinge is the rotor's, and a second one in series is the gear's deflection. What acts on a link's own angle is a fixed
tendon over its hinges. Actuators and sensors bear the names of the model's channels; a motor's `ctrl` is its voltage
[V] (current [A], torque [N m]).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

from hybrid_id import __version__
from hybrid_id.components.load.arm_gravity import ArmGravity
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.load.two_link import JointCoupling
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.errors import InputError
from hybrid_id.export.curves import SUPPLY, elasticity
from hybrid_id.export.drives import HARD, Attributes, Drives, Mjcf, number, numbers
from hybrid_id.export.own_file import edited
from hybrid_id.systems.chain import System, Views
from hybrid_id.systems.joint import Joint

STEP = 0.25e-3
"""MuJoCo's time step [s]; a robot's description keeps its own."""
G = 9.81
"""Gravity of the exported world [m/s^2]."""
LENGTH = 0.3
"""Of a first link [m] whose length no parameter gives: any will do."""
SLIVER = 1e-3
"""Share of a joint's inertia that its link gets where the model leaves it none: a body needs some."""
HINGE = {"type": "hinge", "axis": "0 0 1"}


def to_mjcf(system: System) -> Mjcf:
    """The system at its present values as an MJCF document; a robot's is its own description with the drives put in.

    Raises:
        InputError: no two bodies have the inertias of the model, or a robot's description cannot be edited.
    """
    return _Document(system).build() if system.tree is None else edited(system, system.tree)


class _Document(Drives):
    """One system on its way into a document."""

    def __init__(self, system: System) -> None:
        super().__init__(system, STEP)
        self.root = ET.Element("mujoco", model=system.name)
        ET.SubElement(self.root, "compiler", angle="radian", inertiafromgeom="false")
        option = {"timestep": number(STEP), "gravity": f"0 0 {-G}", "integrator": "implicitfast"}
        ET.SubElement(self.root, "option", option)
        self.world, self.tendons, self.actuators, self.sensors = (
            ET.SubElement(self.root, tag) for tag in ("worldbody", "tendon", "actuator", "sensor")
        )

    def build(self) -> Mjcf:
        """Write everything, root to tip."""
        frame: Attributes = {}
        if (hangs := _hanging_angle(self.system, self.p)) is not None:  # x along a link that hangs at q = q_0
            c, s = math.cos(hangs), math.sin(hangs)
            frame = {"xyaxes": numbers([0.0, -s, -c, 0.0, c, -s])}
        parent = self.world
        for joint, link in zip(self.system.joints, _links(self.system, self.p), strict=True):
            parent = self._joint(parent, joint, link, frame)
            frame = {}
        for tag, attributes in self.passive:  # behind the motors, whose commands come first in ctrl
            ET.SubElement(self.actuators, tag, attributes)
        self.carry(self.system.networks.items())
        if not len(self.tendons):
            self.root.remove(self.tendons)
        title = (
            f"hybrid_id {__version__}: {self.system.name}; masses stand for moments, their sizes mean nothing"
        )
        words = "\n    ".join(["", title, *self.notes]).replace("--", "- -")
        self.root.insert(0, ET.Comment(f"{words}\n  "))
        ET.indent(self.root)
        joints, motors = (
            tuple(f"{name}{j.number}" for j in self.system.joints) for name in ("joint", "motor")
        )
        return Mjcf(ET.tostring(self.root, encoding="unicode") + "\n", tuple(self.notes), joints, motors)

    def _joint(self, parent: ET.Element, joint: Joint, link: _Link, frame: Attributes) -> ET.Element:
        """One joint with all that acts at it; returns the link's body."""
        n = joint.number
        name = f"link{n}" if joint.rigid else f"rotor{n}"
        body = ET.SubElement(parent, "body", {"name": name, "pos": f"{number(link.place)} 0 0"} | frame)
        hinge = HINGE | {"name": f"joint{n}", "armature": number(link.armature)}
        tendon = {"name": f"link_angle{n}"}
        at_rotor, at_link = (
            {"joint": f"joint{n}"},
            {"joint": f"joint{n}"} if joint.rigid else {"tendon": tendon["name"]},
        )
        tag, attributes = self.act(joint, hinge, hinge if joint.rigid else tendon, at_rotor, at_link)
        ET.SubElement(body, "joint", hinge)
        if not joint.rigid:
            trace = max(1e-6 * link.armature, 1e-12)  # a rotor that is all armature still has to be a body
            ET.SubElement(body, "inertial", pos="0 0 0", mass=number(trace), diaginertia=numbers([trace] * 3))
            body = ET.SubElement(body, "body", name=f"link{n}")
            self._gear(body, joint)
            fixed = ET.SubElement(self.tendons, "fixed", tendon)
            if link.extra:
                fixed.set("armature", number(link.extra))
            for hinged in (f"joint{n}", f"gear{n}"):
                ET.SubElement(fixed, "joint", joint=hinged, coef="1")
        if link.weightless:
            body.set("gravcomp", "1")
        centre, moments = f"{number(link.arm)} 0 0", numbers([link.inertia] * 3)
        ET.SubElement(body, "inertial", pos=centre, mass=number(link.mass), diaginertia=moments)
        # its shape is for the eye and touches nothing
        seen = 0.3 if abs(link.arm) < 0.01 else 2.0 * max(min(link.arm, 1.0), -1.0)
        shape = {"type": "capsule", "fromto": f"0 0 0 {number(seen)} 0 0", "size": "0.02"}
        ET.SubElement(body, "geom", shape | {"contype": "0", "conaffinity": "0"})
        ET.SubElement(self.actuators, tag, attributes)
        at_motor = {"actuator": f"motor{n}"}
        if self.closes(joint):  # its actuator is as long as the joint's angle, which its goal is
            at_motor = {"tendon": f"motor_angle{n}"}
            fixed = ET.SubElement(self.tendons, "fixed", name=at_motor["tendon"])
            ET.SubElement(fixed, "joint", joint=f"joint{n}", coef=number(joint.gear_ratio))
        for side, on in (("m", at_motor), ("a", at_link)):
            for letter, what in (("q", "pos"), ("v", "vel")):
                ET.SubElement(self.sensors, f"{next(iter(on))}{what}", {"name": f"{letter}_{side}{n}"} | on)
        self.sensed(joint)
        return body

    def _gear(self, body: ET.Element, joint: Joint) -> None:
        """The hinge of a compliant gear's deflection, and the springs that set in beyond some of it."""
        n, (key, part) = joint.number, joint.drive.motor
        stall = SUPPLY * float(self.p[key].P_m1) if isinstance(part, DCMotor) else 10.0
        found = elasticity(joint, self.p, stall * joint.gear_ratio)
        hinge = HINGE | {"name": f"gear{n}", "damping": number(found.damping)}
        if any(found.stiffness):
            hinge["stiffness"] = numbers([found.stiffness[0], 0.0, found.stiffness[1]])
        if found.limits is not None:
            half, stiffness, rate = found.limits
            hinge |= {"limited": "true", "range": numbers([-half, half]), "solimplimit": HARD}
            hinge["solreflimit"] = numbers([-stiffness, -rate])
        ET.SubElement(body, "joint", hinge)
        for k, (start, stiffness) in enumerate(found.beyond.items()):
            band = {"stiffness": number(stiffness), "springlength": numbers([-start, start])}
            fixed = ET.SubElement(self.tendons, "fixed", {"name": f"gear{n}_{k + 1}"} | band)
            ET.SubElement(fixed, "joint", joint=f"gear{n}", coef="1")
        self.notes += found.notes


@dataclass(frozen=True)
class _Link:
    """One link as a body, of an equivalent mass: a model knows moments alone.

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


def _hanging_angle(system: System, p: Views) -> float | None:
    """Angle of joint 1 at which the arm hangs down [rad], None where no gravity acts."""
    arm = _coupling(system, p, ArmGravity)
    if arm is not None:
        return float(arm.q_0)
    single = [key for key, part in system.joints[0].loads if isinstance(part, Gravity)]
    return float(p[single[0]].q_0) if single and len(system.joints) == 1 else None


def _links(system: System, p: Views) -> list[_Link]:
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
        return [_Link(sides[0][0], *_solid(sides[0][1], sum(weight) / G))]
    return _two(system, p, sides)


def _solid(inertia: float, moment: float) -> tuple[float, float, float]:
    """Mass, arm and inertia about the centre, from the inertia about the joint and the mass's moment [kg m]."""
    mass = max(2.0 * moment**2 / inertia, 0.1 if inertia > 1e-3 else 100.0 * inertia)
    return mass, moment / mass, inertia - moment**2 / mass


def _two(system: System, p: Views, sides: list[tuple[float, float]]) -> list[_Link]:
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
        mass, arm, inertia = _solid(own, moment) if own > 0 else (1.0, 0.0, 0.0)
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
        _Link(rotor, *_solid(rest, pull)),
        _Link(rotor_2, mass, arm, inertia, extra, length, weightless and gravity is not None),
    ]
