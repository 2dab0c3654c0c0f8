"""A system as an MJCF document for MuJoCo 4: what stands for what, and what it leaves out.

A joint becomes a hinge at the link's angle whose armature is the rotor behind the gear. Behind a compliant gear that
hinge is the rotor's, and a second one in series is the gear's deflection. What acts on a link's own angle is a fixed
tendon over its hinges. Actuators and sensors bear the names of the model's channels; a motor's `ctrl` is its voltage
[V] (current [A], torque [N m]).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from hybrid_id import __version__
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.export.bodies import G, Link, hanging_angle, links
from hybrid_id.export.curves import SUPPLY, elasticity
from hybrid_id.export.drives import HARD, Attributes, Drives, Mjcf, carried, number, numbers
from hybrid_id.export.own_file import edited
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

STEP = 0.25e-3
"""MuJoCo's time step [s]; a robot's description keeps its own."""
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
        if (hangs := hanging_angle(self.system, self.p)) is not None:  # x along a link that hangs at q = q_0
            c, s = math.cos(hangs), math.sin(hangs)
            frame = {"xyaxes": numbers([0.0, -s, -c, 0.0, c, -s])}
        parent = self.world
        for joint, link in zip(self.system.joints, links(self.system, self.p), strict=True):
            parent = self._joint(parent, joint, link, frame)
            frame = {}
        for tag, attributes in self.passive:  # behind the motors, whose commands come first in ctrl
            ET.SubElement(self.actuators, tag, attributes)
        self.notes += carried(self.system.networks.items(), self.p)[1]
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

    def _joint(self, parent: ET.Element, joint: Joint, link: Link, frame: Attributes) -> ET.Element:
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
