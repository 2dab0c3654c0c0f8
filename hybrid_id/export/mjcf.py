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

from hybrid_id import __version__
from hybrid_id.components import ConstantTorque, DCMotor, Gravity, Spring
from hybrid_id.export.actuators import Attributes, cogging, left_out, motor, number, numbers, passive
from hybrid_id.export.bodies import G, Link, fill, hanging_angle, links
from hybrid_id.export.curves import SUPPLY, Resistance, elasticity, resistance
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

STEP = 0.25e-3
"""MuJoCo's time step [s]."""
BRISTLE = 2.0 * math.pi * 300.0
"""Angular frequency [rad/s] of an inertia on the bristle that stands for dry friction with a Stribeck curve."""
HARD = "0.99 0.999 0.001"
"""Impedance of constraints that hardly give way."""
HINGE = {"type": "hinge", "axis": "0 0 1"}
DRY = {"solreffriction": "0.0005 1", "solimpfriction": HARD}


@dataclass(frozen=True)
class Mjcf:
    """An exported system.

    Attributes:
        text: the MJCF document.
        notes: what it leaves out or carries otherwise, a sentence each.
    """

    text: str
    notes: tuple[str, ...]


def to_mjcf(system: System, *, step: float = STEP) -> Mjcf:
    """The system at its present values as an MJCF document with a time step [s].

    Raises:
        InputError: no two bodies have the inertias of the model.
    """
    return _Document(system, step).build()


class _Document:
    """One system on its way into a document."""

    def __init__(self, system: System, step: float) -> None:
        self.system, self.step = system, step
        self.p = system.views([value.detach().reshape(1) for value in system.theta()])
        self.notes: list[str] = []
        self.root = ET.Element("mujoco", model=system.name)
        ET.SubElement(self.root, "compiler", angle="radian", inertiafromgeom="false")
        option = {"timestep": number(step), "gravity": f"0 0 {-G}", "integrator": "implicitfast"}
        ET.SubElement(self.root, "option", option)
        self.world, self.tendons, self.actuators, self.sensors = (
            ET.SubElement(self.root, tag) for tag in ("worldbody", "tendon", "actuator", "sensor")
        )
        self.passive: list[tuple[str, Attributes]] = []

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
        self.notes += [
            left_out(key, "MuJoCo has no networks: --to torch exports it") for key in self.system.networks
        ]
        if not len(self.tendons):
            self.root.remove(self.tendons)
        title = (
            f"hybrid_id {__version__}: {self.system.name}; masses stand for moments, their sizes mean nothing"
        )
        words = "\n    ".join(["", title, *self.notes]).replace("--", "- -")
        self.root.insert(0, ET.Comment(f"{words}\n  "))
        ET.indent(self.root)
        return Mjcf(ET.tostring(self.root, encoding="unicode") + "\n", tuple(self.notes))

    def _joint(self, parent: ET.Element, joint: Joint, link: Link, frame: Attributes) -> ET.Element:
        """One joint with all that acts at it; returns the link's body."""
        n, r = joint.number, joint.gear_ratio
        key, part = joint.drive.motor
        top = SUPPLY / max(float(self.p[key].P_m2), 1e-3) if isinstance(part, DCMotor) else 500.0
        rotor = resistance(joint, "motor_friction", self.p, top)
        side = resistance(joint, "link_friction", self.p, top / r)
        self.notes += [*rotor.notes, *side.notes]
        extras, notes = cogging(joint, self.p)
        self.notes += notes + [
            left_out(k, "MuJoCo's gears have a constant ratio") for k, _ in joint.gear.errors
        ]
        name = f"link{n}" if joint.rigid else f"rotor{n}"
        body = ET.SubElement(parent, "body", {"name": name, "pos": f"{number(link.place)} 0 0"} | frame)
        hinge = HINGE | {"name": f"joint{n}", "armature": number(link.armature)}
        tendon = {"name": f"link_angle{n}"}
        at_rotor, at_link = (
            {"joint": f"joint{n}"},
            {"joint": f"joint{n}"} if joint.rigid else {"tendon": tendon["name"]},
        )
        extras |= self._friction(hinge, rotor, r, self._stopped(joint, "motor_friction"))
        own = self._friction(
            hinge if joint.rigid else tendon, side, 1.0, self._stopped(joint, "link_friction")
        )
        if own:
            self.passive.append(passive(f"link_friction{n}", at_link, 1.0, own))
        (hinge if joint.rigid else tendon).update(
            self._spring(joint, "springref" if joint.rigid else "springlength")
        )
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
        fill(body, link)
        if extras and not isinstance(part, DCMotor):
            self.passive.append(passive(f"rotor_friction{n}", at_rotor, r, extras))
        tag, attributes, notes = motor(joint, self.p, self.step, extras)
        ET.SubElement(self.actuators, tag, attributes)
        self.notes += notes
        self._uneven(f"friction{n}", rotor, r, at_rotor)
        self._uneven(f"link_friction{n}", side, 1.0, at_link)
        self._loads(joint, at_link)
        self._sense(joint, at_link)
        return body

    def _stopped(self, joint: Joint, place: str) -> float:
        """Inertia that a place's friction stops, on its own side of the gear [kg m^2]."""
        (key, mass), r, rotor = joint.inertia, joint.gear_ratio, place == "motor_friction"
        if joint.rigid:
            return float(mass.total(self.p[key], r)) * (1.0 if rotor else r**2)
        return float((mass.rotor if rotor else mass.link)(self.p[key], r))

    def _friction(self, target: Attributes, friction: Resistance, gear: float, inertia: float) -> Attributes:
        """Write friction into a hinge or tendon; what falls with speed or has a bristle is returned as LuGre."""
        before = [float(d) for d in target.get("damping", "0 0 0").split()]
        damping = [
            b + gear ** (k + 2) * d for k, (b, d) in enumerate(zip(before, friction.damping, strict=True))
        ]
        if any(damping):
            target["damping"] = numbers(damping)
        if friction.bristle is None and not friction.falls:
            if friction.coulomb > 0:
                level = gear * friction.coulomb + float(target.get("frictionloss", 0.0))
                target |= {"frictionloss": number(level)} | DRY
            return {}
        bristle = friction.bristle or (inertia * BRISTLE**2, 0.0)
        return {"lugre": numbers([*bristle, friction.coulomb, friction.static, friction.stribeck])}

    def _spring(self, joint: Joint, rest: str) -> Attributes:
        """A spring load as attributes of a hinge or a tendon."""
        views = [self.p[key] for key, part in joint.loads if isinstance(part, Spring)]
        if not views:
            return {}
        angle = float(views[0].q_s)
        if rest == "springlength" and angle == -1.0:
            angle -= 1e-9  # MuJoCo takes -1 for "where the model stands at first"
        return {"stiffness": number(views[0].k_s), rest: number(angle)}

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

    def _loads(self, joint: Joint, at_link: Attributes) -> None:
        for key, part in joint.loads:
            if isinstance(part, ConstantTorque):
                self._bias(f"constant_torque{joint.number}", float(self.p[key].T_0), at_link)
            elif isinstance(part, Gravity) and len(self.system.joints) > 1:
                self.notes.append(left_out(key, "no body of an arm weighs like that: take arm_gravity"))
            elif not isinstance(part, Spring | Gravity):
                self.notes.append(left_out(key, "MuJoCo has no such load"))
        self.notes += [
            left_out(key, "apply the logged torque through qfrc_applied") for key, _ in joint.logged
        ]

    def _uneven(self, name: str, friction: Resistance, gear: float, on: Attributes) -> None:
        """What one direction of motion has beyond the other: a bias, and dampers that act one way up to a force."""
        self._bias(f"{name}_bias", gear * friction.bias, on)
        for k, (torque, speed) in enumerate(friction.ramps):
            own = {"name": f"{name}_{k + 1}", "gear": number(gear), "gainprm": "0", "biastype": "affine"} | on
            # the trace in the middle keeps the compiler from reading a rate that drives as a damping ratio
            own["biasprm"] = numbers([0.0, -1e-12, -torque / speed])
            own["forcerange"] = numbers(sorted((0.0, -torque)))
            self.passive.append(("general", own))

    def _bias(self, name: str, torque: float, on: Attributes) -> None:
        """A constant torque against forward motion: an actuator that its command does not reach."""
        if torque:
            attributes = {
                "name": name,
                "gainprm": "0",
                "biastype": "affine",
                "biasprm": f"{number(-torque)} 0 0",
            }
            self.passive.append(("general", attributes | on))

    def _sense(self, joint: Joint, at_link: Attributes) -> None:
        n, kind = joint.number, next(iter(at_link))
        for name, tag in ((f"q_m{n}", "actuatorpos"), (f"v_m{n}", "actuatorvel")):
            ET.SubElement(self.sensors, tag, name=name, actuator=f"motor{n}")
        for name, tag in ((f"q_a{n}", f"{kind}pos"), (f"v_a{n}", f"{kind}vel")):
            ET.SubElement(self.sensors, tag, {"name": name} | at_link)
        offsets = [
            key for key, part in joint.sensing.sensors if any(spec.value for spec in part.specs.values())
        ]
        late = [] if joint.sensing.late is None else [joint.sensing.late[0]]
        self.notes += [
            left_out(key, "the exported sensors read true angles, in time") for key in [*offsets, *late]
        ]
