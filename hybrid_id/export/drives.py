"""What acts at a joint, as MuJoCo's attributes and actuators: friction, springs, loads and the motor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hybrid_id.components.input.position_loop import PositionLoop
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.motor.dc_motor import DCMotor
from hybrid_id.errors import InputError
from hybrid_id.export.curves import SUPPLY, FrictionCurve, friction_curve, left_out, noted
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

BRISTLE = 2.0 * math.pi * 300.0
"""Angular frequency [rad/s] of an inertia on the bristle that stands for dry friction with a Stribeck curve."""
STIFFEST = 0.5
"""Largest such frequency times the time step: a stiffer bristle is unstable."""
HARD = "0.99 0.999 0.001"
"""Impedance of constraints that hardly give way."""
DRY = {"solreffriction": "0.0005 1", "solimpfriction": "0.9999 0.9999 0.001"}
"""Dry friction that holds: at MuJoCo's largest impedance, with less of which an arm creeps under its weight."""
TOP_SPEED, JOINT_SPEED = 500.0, 30.0
"""Speeds [rad/s] of a rotor and of its joint up to which friction is fitted where no back-EMF bounds them."""

COMMANDS = {"V": "voltage [V]", "A": "current [A]", "N m": "torque [N m]"}
"""What a motor's command is, by its unit."""

Attributes = dict[str, str]


@dataclass(frozen=True)
class Mjcf:
    """An exported system.

    Attributes:
        text: the MJCF document.
        notes: what it leaves out or carries otherwise, a sentence each.
        joints, motors: names of the joints and of their actuators there.
        home: folder that its files (meshes, includes) are named from; None where it names none.
        held: joints that the system holds still, and where [rad or m]; the document leaves them as they were.
    """

    text: str
    notes: tuple[str, ...]
    joints: tuple[str, ...]
    motors: tuple[str, ...]
    home: Path | None = None
    held: Mapping[str, float] = field(default_factory=dict)


class Drives:
    """The drives of a system on their way into an MJCF.

    Args:
        system: at the values to export.
        step: MuJoCo's time step [s].

    Attributes:
        notes: what is left out or carried otherwise, a sentence each.
        passive: tag and attributes of actuators that no command reaches.
    """

    def __init__(self, system: System, step: float) -> None:
        self.system, self.step = system, step
        self.p = system.views([value.detach().reshape(1) for value in system.theta()])
        self.notes: list[str] = []
        self.passive: list[tuple[str, Attributes]] = []

    def label(self, joint: Joint) -> str:
        """What the names of a joint's actuators end in."""
        return str(joint.number)

    def act(
        self, joint: Joint, hinge: Attributes, link: Attributes, at_rotor: Attributes, at_link: Attributes
    ) -> tuple[str, Attributes]:
        """Write friction and springs of a joint into its attributes; returns tag and attributes of its motor.

        Args:
            joint: the joint.
            hinge: attributes of the rotor's hinge.
            link: of what is at the link's angle: the same hinge, or a tendon behind a compliant gear.
            at_rotor: what actuators on the rotor name as their target.
            at_link: the same on the link.
        """
        label, r = self.label(joint), joint.gear_ratio
        key, part = joint.drive.motor
        servo = self.closes(joint)
        top = min(TOP_SPEED, JOINT_SPEED * r)
        if isinstance(part, DCMotor):
            top = SUPPLY / max(float(self.p[key].P_m2), 1e-3)
        rotor = friction_curve(joint, "motor_friction", self.p, top)
        side = friction_curve(joint, "link_friction", self.p, top / r)
        self.notes += [*rotor.notes, *side.notes]
        extras = self.carry(joint.drive.torques)
        self.carry(joint.gear.errors)
        extras |= self._friction(hinge, rotor, r, self._stopped(joint, "motor_friction"))
        own = self._friction(link, side, 1.0, self._stopped(joint, "link_friction"))
        if own:
            self.passive.append(_passive(f"link_friction{label}", at_link, 1.0, own))
        loads = [(key, part, *part.mjcf(self.p[key])) for key, part in joint.loads]
        if springs := [carry for *_, carry, _ in loads if "rest" in carry]:
            rest, angle = "springref" if "joint" in at_link else "springlength", float(springs[0]["rest"][0])
            if rest == "springlength" and angle == -1.0:
                angle -= 1e-9  # MuJoCo takes -1 for "where the model stands at first"
            link |= {"stiffness": numbers(springs[0]["stiffness"]), rest: number(angle)}
        if extras and not isinstance(part, DCMotor):
            self.passive.append(_passive(f"rotor_friction{label}", at_rotor, r, extras))
        head = {"name": f"motor{label}"} | at_rotor | {"gear": "1" if servo else number(r)}
        tag, attributes = self._loop(joint) if servo else self._actuator(joint, extras)
        self._uneven(f"friction{label}", rotor, r, at_rotor)
        self._uneven(f"link_friction{label}", side, 1.0, at_link)
        for key, part, carry, missing in loads:
            if "bias" in carry:
                self._bias(f"{part.kind}{label}", float(carry["bias"][0]), at_link)
            if isinstance(part, Gravity) and self.system.tree is not None:
                missing = "is left out, the description's bodies have their own weight"
            elif isinstance(part, Gravity) and len(self.system.joints) > 1:
                missing = "is left out, no body of an arm weighs like that: take arm_gravity"
            self._note(key, missing)
        self.carry(joint.logged)
        self.carry([(stage, part) for stage, part, _ in joint.drive.stages])
        return tag, head | attributes

    def closes(self, joint: Joint) -> bool:
        """Whether MuJoCo closes the joint's position loop itself: one that acts at the angle that it reads."""
        return joint.drive.input[1].at_joint and bool(self.system.tree or joint.rigid)

    def carry(self, parts: Iterable[tuple[str, Any]], *motor: float) -> Attributes:
        """Attributes that components become; what these leave out is noted."""
        found: Attributes = {}
        for key, part in parts:
            own, missing = part.mjcf(self.p.get(key), *motor)
            found |= written(own)
            self._note(key, missing)
        return found

    def _note(self, key: str, missing: str) -> None:
        """Note what the export lacks of a component, where it lacks anything."""
        self.notes += [noted(key, missing)] if missing else []

    def _actuator(self, joint: Joint, extras: Attributes) -> tuple[str, Attributes]:
        """Tag and attributes beyond name, target and gear of a joint's actuator, whose length is the rotor's angle.

        ``extras`` are what else a ``dcmotor`` carries, friction and cogging.

        Raises:
            InputError: the motor has no back-EMF.
        """
        (key, part), found = joint.drive.motor, self._command(joint)
        own, missing = part.mjcf(self.p[key])
        self._note(key, missing)
        windings = [(name, winding) for name, winding, _ in joint.drive.windings]
        if "motorconst" not in own:
            why = "MuJoCo has it in motors that take a voltage only"
            self.notes += [left_out(name, why) for name, _ in windings]
            return "general", found | written(own or {"gainprm": (0.0,)})
        (constant, _), (resistance,) = own["motorconst"], own["resistance"]
        if constant <= 0.0:
            raise InputError(
                f"{key}: P_m2 is {constant:g}, but MuJoCo's dcmotor needs a back-EMF; give it a value above 0"
            )
        return "dcmotor", found | written(own) | extras | self.carry(windings, resistance, constant)

    def _loop(self, joint: Joint) -> tuple[str, Attributes]:
        """Tag and attributes beyond name, target and gear of a position loop, whose command is its goal.

        MuJoCo delays the goal alone and reads the angle as it is, as the model does.
        """
        (key, source), (motor, part) = joint.drive.input, joint.drive.motor
        own, missing = source.mjcf(self.p[key])
        driven, other = part.mjcf(self.p[motor])
        (gain,) = driven.get("gainprm", (0.0,))
        scaled = {name: [float(gain) * float(v) for v in own[name]] for name in own if name != "ctrlrange"}
        found = written(scaled | {name: own[name] for name in own if name == "ctrlrange"})
        self._note(key, missing)
        self._note(motor, other)
        self.notes += [
            left_out(name, "MuJoCo's position loop has no such stage") for name, _ in joint.drive.maps
        ]
        return "general", found | {"biastype": "affine"} | self._delay(joint)

    def _delay(self, joint: Joint) -> Attributes:
        """What holds a command back by whole steps."""
        steps = 0 if joint.drive.delay is None else round(float(self.p[joint.drive.delay[0]].T_d) / self.step)
        return {"delay": number(steps * self.step), "nsample": str(steps)} if steps else {}

    def _command(self, joint: Joint) -> Attributes:
        """Limit and delay of the command; what of the input stage stays outside is noted."""
        key, source = joint.drive.input
        missing = source.mjcf(self.p[key])[1]
        if source.at_joint:
            missing = (
                "stays with the controller, and its torque over the gear ratio is ctrl: it reads the link's angle, but "
                "MuJoCo's actuators read the angle at which they act, the rotor's"
            )
        if missing:
            asked = f"{source.kind} ({', '.join(source.channels)})"
            self.notes.append(f"joint{joint.number}/input: ctrl is the {commanded(joint)}; {asked} {missing}")
        found, held = self.carry(joint.drive.maps), self._delay(joint)
        if held and joint.drive.delay and (isinstance(source, PositionLoop) or source.at_joint):
            # MuJoCo would delay the angle that the loop reads, too
            self.notes.append(f"{joint.drive.delay[0]}: it delays the goal, and stays with the controller")
            held = {}
        return found | held

    def sensed(self, joint: Joint) -> None:
        """Note what of a joint's sensors is left out."""
        late = [one for one in (joint.sensing.late, joint.sensing.lag) if one is not None]
        self.carry([*joint.sensing.sensors, *late])

    def _stopped(self, joint: Joint, place: str) -> float:
        """Inertia that a place's friction stops, on its own side of the gear [kg m^2]."""
        (key, mass), r, rotor = joint.inertia, joint.gear_ratio, place == "motor_friction"
        if joint.rigid:
            return float(mass.total(self.p[key], r)) * (1.0 if rotor else r**2)
        return float((mass.rotor if rotor else mass.link)(self.p[key], r))

    def _friction(
        self, target: Attributes, friction: FrictionCurve, gear: float, inertia: float
    ) -> Attributes:
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
        bristle = friction.bristle or (inertia * min(BRISTLE, STIFFEST / self.step) ** 2, 0.0)
        return {"lugre": numbers([*bristle, friction.coulomb, friction.static, friction.stribeck])}

    def _uneven(self, name: str, friction: FrictionCurve, gear: float, on: Attributes) -> None:
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
                "gear": "1",
                "gainprm": "0",
                "biastype": "affine",
                "biasprm": f"{number(-torque)} 0 0",
            }
            self.passive.append(("general", attributes | on))


def commanded(joint: Joint) -> str:
    """What a joint's motor takes, with its unit."""
    gives = joint.drive.input[1].gives
    return "motor's " + COMMANDS.get(gives, f"command [{gives}]")


def _passive(name: str, on: Attributes, gear: float, extras: Attributes) -> tuple[str, Attributes]:
    """Tag and attributes of an actuator without input that carries friction or cogging alone."""
    head = {"name": name, "gear": number(gear), "input": "none", "motorconst": "0 0", "resistance": "1"}
    return "dcmotor", head | on | extras


def written(attributes: Mapping[str, Sequence[Any]]) -> Attributes:
    """Attributes as MJCF writes them."""
    return {name: numbers(values) for name, values in attributes.items()}


def number(value: Any) -> str:
    """A number as MJCF writes it."""
    return f"{float(value):.10g}"


def numbers(values: Iterable[Any]) -> str:
    """Numbers as MJCF writes them."""
    return " ".join(map(number, values))
