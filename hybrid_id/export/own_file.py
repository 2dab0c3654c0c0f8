"""A robot's own description with the drives put in: only what they change is written, all else stays as it was.

MuJoCo reads the description and says what holds at each joint, defaults and includes counted in; what differs is then
written into the text of the file itself, at the joint's and the actuator's own elements, so that comments, layout,
classes, meshes and includes survive. A URDF, which has no place for a rotor, is first turned into MJCF by MuJoCo.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid_id import __version__
from hybrid_id.components.load.body_inertia import BodyInertia
from hybrid_id.components.load.payload import Payload
from hybrid_id.errors import InputError
from hybrid_id.export.curves import left_out, noted
from hybrid_id.export.drives import Attributes, Drives, Mjcf, commanded, number, numbers
from hybrid_id.robots.description import braking, compiled, idle, read_spec, without_missing_meshes
from hybrid_id.robots.tree import Body, RigidBodyTree, TreeJoint
from hybrid_id.systems.chain import System
from hybrid_id.systems.joint import Joint

SAME = 1e-9
"""Relative difference below which a value of the file stands."""
AT_JOINT = (0, 1)
"""MuJoCo's numbers of transmissions to a joint: in its own frame, and in its parent's."""
OWN = "hybrid_id"
"""Class of the actuators that the drives bring, so that no default of the file reaches into these."""
_PLAIN = {"dyntype": "none", "gaintype": "fixed", "biastype": "none"}
_PLAIN |= {f"{what}limited": "false" for what in ("ctrl", "force", "act")}
_PLAIN |= {what: "0" for what in ("damping", "armature", "delay", "nsample", "inheritrange")} | {
    "actdim": "-1"
}
"""What an actuator of that class is where its element does not say otherwise."""


def edited(system: System, tree: RigidBodyTree) -> Mjcf:
    """The description that a robot was read from, with the system's drives at its joints.

    Args:
        system: the system at the values to export.
        tree: its tree.

    Raises:
        InputError: the robot was read from no file, or a joint stands in a file that it includes.
    """
    if not tree.source:
        raise InputError("a robot that was read from no file has none to be edited; load its MJCF or URDF")
    path = Path(tree.source)
    spec, text = read_spec(path), path.read_bytes().decode("utf-8")
    if converted := _Text(text).root == "robot":
        fixed = set[str]()
        for body in (
            spec.bodies
        ):  # the base, which as a part of the world would touch the first link, touches nothing
            if body.name == "world" or (body.parent.name in fixed and not body.joints):
                fixed.add(body.name)
                for geom in body.geoms:
                    geom.contype = geom.conaffinity = 0
        try:
            text = spec.to_xml()
        except ValueError as error:  # of a link without an inertia, say
            words = ", ".join(str(error).splitlines()[:2])
            raise InputError(f"{path}: MuJoCo makes no MJCF of it ({words}); mend it there.") from None
    exported = _Edit(system, tree, path, text, spec).build(converted=converted)
    try:
        mujoco_model(exported)
    except ValueError as error:
        raise InputError(
            f"{path}: MuJoCo does not take it with the drives put in ({' '.join(str(error).split())}); rename or take "
            "out what does not go with them."
        ) from None
    return exported


def mujoco_model(exported: Mjcf) -> Any:
    """MuJoCo's model of an exported system, its files found where the description's are, what it holds still held.

    Raises:
        ValueError: MuJoCo does not take it.
    """
    mujoco: Any = importlib.import_module("mujoco")
    files = {} if exported.home is None else _included(exported.text, exported.home)
    spec = mujoco.MjSpec.from_string(exported.text, include=files)
    if exported.home is not None:
        spec.modelfiledir = str(exported.home)
        without_missing_meshes(exported.home / "exported", mujoco, spec)
    model = spec.compile()
    if not exported.held:
        return model
    # a base is held by taking out its free joint, others by an equality, stiff as may be
    names, stiff = {model.joint(k).name for k in range(model.njnt)}, 2.0 * spec.option.timestep
    bases = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    for joint in (base for base in bases if {base.name, base.parent.name} & exported.held.keys()):
        spec.delete(joint)
        for key in list(spec.keys):  # whose positions are those with the base's
            spec.delete(key)
    for name, at in exported.held.items():
        if name in names and model.joint(name).qpos0.size == 1:
            held = spec.add_equality(
                type=mujoco.mjtEq.mjEQ_JOINT, name1=name, objtype=mujoco.mjtObj.mjOBJ_JOINT
            )
            held.data[0] = at - float(model.joint(name).qpos0[0])
            held.solref[:], held.solimp[:3] = (stiff, 1.0), (0.99, 0.999, 0.001)
    return spec.compile()


def _included(text: str, home: Path) -> dict[str, bytes]:
    """Files that a text includes, and those that they include, by the names it gives them."""
    found: dict[str, bytes] = {}
    for element in _Text(text).elements:
        name = element.values.get("file", "")
        if element.tag == "include" and (home / name).is_file():
            found[name] = (home / name).read_bytes()
            found |= _included(found[name].decode("utf-8"), home)
    return found


@dataclass(frozen=True)
class _Element:
    """An element of a file's text.

    Attributes:
        tag: its name.
        values: its attributes.
        above: names of the elements around it, outermost first.
        start, head, end: where it begins, where its start tag ends and where it ends.
    """

    tag: str
    values: Attributes
    above: tuple[str, ...]
    start: int
    head: int
    end: int


class _Text:
    """An XML text whose elements are found and changed where they stand."""

    def __init__(self, text: str) -> None:
        self.raw = text.encode()
        self.elements: list[_Element] = []
        self.changes: list[tuple[int, int, str]] = []
        opened: list[tuple[str, Attributes, int, int]] = []
        parser = expat.ParserCreate("utf-8")
        start_tag = re.compile(
            rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>"""
        )  # a value may hold the sign that ends tags

        def start(tag: str, values: Attributes) -> None:
            head = start_tag.match(self.raw, parser.CurrentByteIndex)
            assert head is not None
            opened.append((tag, values, *head.span()))

        def end(tag: str) -> None:
            _, values, first, head = opened.pop()
            empty = self.raw[head - 2 : head] == b"/>"
            last = head if empty else self.raw.index(b">", parser.CurrentByteIndex) + 1
            above = tuple(name for name, *_ in opened)
            self.elements.append(_Element(tag, values, above, first, head, last))

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(self.raw, True)

    @property
    def root(self) -> str:
        """Name of the outermost element."""
        return self.elements[-1].tag

    def put(self, element: _Element, values: Attributes) -> None:
        """Set attributes of an element."""
        head = self.raw[element.start : element.head].decode()
        for name, value in values.items():
            new = quoteattr(value)
            old = re.compile(rf"""(\s{re.escape(name)}\s*=\s*)("[^"]*"|'[^']*')""")
            if old.search(head):
                head = old.sub(rf"\g<1>{new}", head, count=1)
            else:
                head = re.sub(r"(\s*/?>)$", rf" {name}={new}\1", head)
        self.changes.append((element.start, element.head, head))

    def replace(self, element: _Element, new: str) -> None:
        """Put another element in the place of one."""
        self.changes.append((element.start, element.end, new))

    def insert(self, element: _Element, line: str) -> None:
        """Add a line at the beginning of an element, one step further in than itself."""
        self.changes.append((element.head, element.head, f"\n{self._margin(element)}  {line}"))

    def append(self, element: _Element, lines: list[str]) -> None:
        """Add lines at the end of an element, one step further in than itself."""
        margin = self._margin(element)
        inside = "".join(f"\n{margin}  {line}" for line in lines)
        if self.raw[element.head - 2 : element.head] == b"/>":
            head = self.raw[element.start : element.head - 2].decode().rstrip()
            self.changes.append((element.start, element.end, f"{head}>{inside}\n{margin}</{element.tag}>"))
            return
        close = self.raw.rindex(b"</", element.start, element.end)
        before = len(self.raw[:close].rstrip())
        self.changes.append((before, before, inside))

    def _margin(self, element: _Element) -> str:
        line = self.raw[self.raw.rfind(b"\n", 0, element.start) + 1 : element.start].decode()
        return line if not line.strip() else ""

    def __str__(self) -> str:
        found = self.raw
        for start, end, new in sorted(self.changes, key=lambda change: change[:2], reverse=True):
            found = found[:start] + new.encode() + found[end:]
        return found.decode()


class _Edit(Drives):
    """One system on its way into its robot's description."""

    def __init__(self, system: System, tree: RigidBodyTree, path: Path, text: str, spec: Any) -> None:
        self.model = compiled(path, spec)
        super().__init__(system, float(self.model.opt.timestep))
        self.tree, self.path = tree, path
        # MuJoCo makes a damping of these ratios by the inertia, which the drives change
        self.damping_ratios = {one.id for one in spec.actuators if one.biasprm[2] > 0.0}
        self.text, self.own_class = _Text(text), False
        self.elements = [*self.text.elements]
        for included in _included(text, path.parent).values():
            self.elements += _Text(included.decode("utf-8")).elements
        self.added: list[str] = []
        self.shafts: list[str] = []
        self.replaced: dict[tuple[str, str], list[str]] = {}

    def label(self, joint: Joint) -> str:
        """The joint's own name."""
        return f"_{self.tree.names[joint.number - 1]}"

    def build(self, *, converted: bool) -> Mjcf:
        """Put every joint's drive in, then what has no place in the file yet."""
        motors = tuple(
            self._joint(joint, known)
            for joint, known in zip(self.system.joints, self.tree.joints, strict=True)
        )
        self.added += [self._new(tag, attributes) for tag, attributes in self.passive]
        self._masses()
        self._compensation()
        self.carry([*self.system.networks.items(), *self.system.arm.contacts])
        for (old, command), names in self.replaced.items():
            self.notes.append(f"{', '.join(names)}: in the place of a {old} the actuator takes the {command}")
        own = re.compile(r"\bjoint(\d+)(?=/)")
        notes = [own.sub(lambda found: self.tree.names[int(found[1]) - 1], note) for note in self.notes]
        if self.tree.held:
            notes.append(f"{', '.join(self.tree.held)}: held still in the model; here as the file has it")
        if converted:
            notes.insert(
                0, f"{self.path.name} is a URDF, which has no place for a rotor: MuJoCo made an MJCF of it"
            )
        self._sections(notes)
        files = any(e.tag == "include" or "file" in e.values for e in self.text.elements)
        return Mjcf(
            str(self.text), tuple(notes), self.tree.names, motors, self.path.parent if files else None,
            dict(self.tree.held),
        )  # fmt: skip

    def _new(self, tag: str, attributes: Attributes) -> str:
        """An actuator that a drive brings, in a class of its own where the file has defaults for all."""
        limited = {f"{end}limited": "true" for end in ("ctrl", "force") if f"{end}range" in attributes}
        defaults = any(e.above[1:] == ("default",) and e.tag != "default" for e in self.elements)
        self.own_class |= defaults
        return _written(tag, attributes | limited | ({"class": OWN} if defaults else {}))

    def _masses(self) -> None:
        """Write inertias that differ from the file's into their bodies, and payloads as bodies of their own."""
        bodies = self.system.arm.bodies(self.p)
        sites = {self.model.site(i).name: i for i in range(self.model.nsite)}
        # what of the file takes masses from elsewhere than its bodies' own elements
        overruled = next(
            (
                f'the file\'s compiler has {name}="{e.values[name]}"'
                for e in self.elements
                for name in ("inertiafromgeom", "settotalmass")
                if e.tag == "compiler" and e.values.get(name, "auto") not in ("auto", "false")
            ),
            "",
        )
        for key, part in self.system.arm.masses:
            element = self._body(part.point)
            if element is None:
                why = f"'{part.point}' stands in a file that this one includes"
                self.notes.append(left_out(key, why))
            elif overruled:
                self.notes.append(left_out(key, overruled))
            elif isinstance(part, Payload):
                mass, centre = part.mass(self.p[key])
                place = np.array([float(value) for value in centre])
                if (i := sites.get(part.point)) is not None:
                    turn = Rotation.from_quat(self.model.site_quat[i], scalar_first=True)
                    place = self.model.site_pos[i] + turn.apply(place)
                if float(mass):
                    named = {"name": f"payload_{part.point}", "pos": numbers(place.tolist())}
                    weight = {"pos": "0 0 0", "mass": number(float(mass)), "diaginertia": "0 0 0"}
                    body = f"{_written('body', named)[:-2]}>{_written('inertial', weight)}</body>"
                    self.text.append(element, [body])
            else:
                changed = bodies[key].held()
                known = next(body for body in self.tree.bodies if body.name == changed.name)
                ten = _ten(changed)
                if np.allclose(_ten(known), ten, rtol=SAME, atol=1e-12):
                    continue
                values = {"mass": number(ten[0]), "pos": numbers(ten[1:4]), "fullinertia": numbers(ten[4:])}
                inside = (*element.above, "body")
                own = [e for e in self.text.elements if e.tag == "inertial" and e.above == inside]
                own = [e for e in own if element.start < e.start < element.end]
                if own:
                    self.text.replace(own[0], _written("inertial", values))
                else:
                    self.text.insert(element, _written("inertial", values))

    def _compensation(self) -> None:
        """Write the share of each body's weight that the controller holds as its ``gravcomp``."""
        if not self.system.arm.compensations:
            return
        key, known = self.system.arm.compensations[0], self.tree.believed
        share, heavy = float(self.p[key].c_g), [body for body in self.tree.bodies if body.inertia.mass]
        there = {} if known is None else {body.name: body.inertia.mass for body in known.bodies}
        own = {body.name: float(there.get(body.name, 0.0)) / float(body.inertia.mass) for body in heavy}
        wanted = {name: share * (now if known else 1.0) for name, now in own.items()}
        changed = {name: value for name, value in wanted.items() if abs(value - own[name]) > SAME}
        elements = {name: element for name in changed if (element := self._body(name)) is not None}
        if lacking := [name for name in changed if name not in elements]:
            why = f"for '{lacking[0]}' has no name of its own in the file, or stands in one that it includes"
            self.notes.append(left_out(key, why))
            return
        for name, element in elements.items():
            self.text.put(element, {"gravcomp": number(changed[name])})
        wrong = ["changed masses"] * any(isinstance(part, BodyInertia) for _, part in self.system.arm.masses)
        if wrong := wrong + ["the tilt"] * bool(self.system.arm.tilts):
            words = f"holds the weight in MuJoCo with {' and '.join(wrong)}, which the robot's controller does not know"
            self.notes.append(noted(key, words))

    def _body(self, point: str) -> _Element | None:
        """The element of a body by its name, or of the body around a site of that name.

        Of one without a name by its number, where all bodies stand in this file, in their order.
        """
        inside = [e for e in self.text.elements if "worldbody" in e.above]
        bodies = sorted((e for e in inside if e.tag == "body"), key=lambda e: e.start)
        named = [e for e in inside if e.values.get("name") == point]
        if site := next((e for e in named if e.tag == "site"), None):
            return next((e for e in reversed(bodies) if e.start < site.start < e.end), None)
        if body := next((e for e in named if e.tag == "body"), None):
            return body
        if len(bodies) != self.model.nbody - 1:
            return None
        numbered = dict(zip((f"body{b}" for b in range(1, 1 + len(bodies))), bodies, strict=True))
        body = numbered.get(point.rstrip("_"))
        return None if body is None or "name" in body.values else body

    def _sections(self, notes: list[str]) -> None:
        """What stands beside the joints: new actuators, and what is left out as a comment."""
        root, top = self.text.elements[-1], (self.text.root,)
        words = [f"hybrid_id {__version__}: drives of {', '.join(self.tree.names)}", *notes]
        lines = [f"<!-- {'; '.join(words).replace('--', '- -')} -->"]
        known = any(e.tag == "default" and e.values.get("class") == OWN for e in self.elements)
        if self.own_class and not known:
            plain = _written("general", _PLAIN)
            lines += ["<default>", f'  <default class="{OWN}">{plain}</default>', "</default>"]
        section = next((e for e in self.text.elements if e.tag == "actuator" and e.above == top), None)
        if self.added and section is not None:
            self.text.append(section, self.added)
        elif self.added:
            lines += ["<actuator>", *(f"  {line}" for line in self.added), "</actuator>"]
        if self.shafts:
            lines += ["<tendon>", *(f"  {line}" for line in self.shafts), "</tendon>"]
        if self.system.arm.tilts:
            pull = self.tree.falling(self.system.arm.gravity(self.p)).gravity
            lines.append(_written("option", {"gravity": numbers(pull)}))
        self.text.append(root, lines)

    def _joint(self, joint: Joint, known: TreeJoint) -> str:
        """Write a joint's drive; returns the name of its actuator."""
        element = next(
            (
                e
                for e in self.text.elements
                if e.tag == "joint" and "worldbody" in e.above and e.values.get("name") == known.name
            ),
            None,
        )
        if element is None:
            raise InputError(
                f"{self.path}: joint '{known.name}' stands in a file that this one includes (or replicates); give that "
                "file as the 'file' of 'robot' in model.yaml, so that the export can write into it."
            )
        (key, mass), r = joint.inertia, joint.gear_ratio
        view = self.p[key]
        if joint.rigid:
            rotor = float(mass.total(view, r)) * r**2
        else:
            rotor = float(mass.rotor(view, r)) * r**2
            gear = joint.gear.transmission[0]
            self.notes.append(left_out(gear, "the joint stays rigid: its link would need a second joint"))
        target = {"joint": known.name}
        found: Attributes = {"armature": number(rotor), "damping": "0 0 0", "frictionloss": "0"}
        if joint.motors:  # a coupled motor's rotor: a fixed tendon as long as its angle behind its own gear
            shaft, found = found, found | {"armature": "0"}
            turned_by = {"tendon": f"shaft{self.label(joint)}"}
            tag, attributes = self.act(joint, shaft, found, turned_by, target)
            shaft["damping"] = re.sub(r"( 0)+$", "", shaft["damping"])
            inside = "".join(
                _written("joint", {"joint": self.tree.names[link.number - 1], "coef": number(turns / r)})
                for link, turns in joint.links
            )
            named = {"name": turned_by["tendon"]} | shaft
            self.shafts.append(f"{_written('fixed', named)[:-2]}>{inside}</fixed>")
        else:
            tag, attributes = self.act(joint, found, found, target, target)
        found["damping"] = re.sub(r"( 0)+$", "", found["damping"])
        here = self.model.joint(known.name).id
        if self.model.jnt_actfrclimited[
            here
        ]:  # its limit of torque stays, and is said, but where a servo's is larger
            low, high = self.model.jnt_actfrcrange[here]
            unit = "N m" if known.kind == "hinge" else "N"
            words = f"{known.name}: its actuatorfrcrange, {low:g} to {high:g} {unit},"
            largest = float(attributes["forcerange"].split()[1]) if "forcerange" in attributes else math.inf
            if not self.closes(joint):
                self.notes.append(
                    f"{words} stays, the model has no such limit; take it out where your records exceed it"
                )
            elif largest > min(-low, high):
                self.notes.append(f"{words} is switched off, the servo's own limit is larger")
                found |= {"actuatorfrclimited": "false"}
        self.sensed(joint)
        # angles of MJCF's text are in degrees unless it says otherwise
        said = [e.values["angle"] for e in self.elements if e.tag == "compiler" and "angle" in e.values]
        turned = known.kind == "hinge" and (said[-1] != "radian" if said else True)
        if turned and "springref" in found:
            found["springref"] = number(math.degrees(float(found["springref"])))
        at = int(self.model.joint(known.name).dofadr[0])
        alone = replace(  # without what its actuators bring along
            known,
            armature=float(self.model.dof_armature[at]),
            damping=float(np.ravel(self.model.dof_damping[at])[0]),
        )
        self.text.put(element, _changed(found, alone, turned=turned))
        return self._motor(joint, known, tag, attributes)

    def _motor(self, joint: Joint, known: TreeJoint, tag: str, attributes: Attributes) -> str:
        """Put the drive's motor in the place of the joint's actuator, or beside the others; returns its name."""
        mine, here = self._acting(known)
        if here is not None and (new := self._kept(joint, mine, here, tag, attributes)) is not None:
            named = {} if "name" in mine[0].values else {"name": attributes["name"]}
            # the drive's rotor and friction stand at the joint
            brought = {"armature": self.model.actuator_armature, "damping": self.model.actuator_damping}
            new |= {name: "0" for name, values in brought.items() if values[here.id]}
            if named or new:
                self.text.put(mine[0], named | new)
            for brake in mine[1:]:
                self._idle(brake, known, "brakes it, and is part of the joint's damping")
            return (mine[0].values | named)["name"]
        command = commanded(joint)
        if self.closes(joint):
            command = "goal [rad]" if known.kind == "hinge" else "goal [m]"
        if tag == "general" and here is not None and not self.closes(joint):
            attributes |= _limits(here, ("force",), here.gear[0] / float(attributes["gear"]))
        if not mine:
            self.added.append(self._new(tag, attributes))
            return attributes["name"]
        attributes["name"] = mine[0].values.get("name", attributes["name"])
        self.text.replace(mine[0], self._new(tag, attributes))
        for other in mine[1:]:
            self._idle(other, known, "is part of the drive")
        self.replaced.setdefault((" and a ".join(e.tag for e in mine), command), []).append(known.name)
        return attributes["name"]

    def _idle(self, element: _Element, known: TreeJoint, why: str) -> None:
        """Leave an actuator without effect: without it, all that follow would have other places in ``ctrl``."""
        named = {name: value for name, value in element.values.items() if name == "name"}
        self.text.replace(element, self._new("general", named | {"joint": known.name, "gainprm": "0"}))
        self.notes.append(
            f"{known.name}: its {element.tag} {why}; it stays without effect, so that all keep their places in ctrl"
        )

    def _acting(self, known: TreeJoint) -> tuple[list[_Element], Any | None]:
        """A joint's actuators in the text, first what drives it, and what MuJoCo knows of that one.

        The latter is None where the joint has no actuator, or others elsewhere.
        """
        mine = [
            e
            for e in self.text.elements
            if "actuator" in e.above and known.name in (e.values.get("joint"), e.values.get("jointinparent"))
        ]
        joint = self.model.joint(known.name).id
        acting = [
            one
            for one in map(self.model.actuator, range(self.model.nu))
            if int(one.trntype[0]) in AT_JOINT and int(one.trnid[0]) == joint
        ]
        by_itself = self.model.actuator_armature, self.model.actuator_damping, self.model.actuator_biastype
        if len(acting) > len(mine) and any(values[one.id] for one in acting for values in by_itself):
            raise InputError(
                f"{self.path}: an actuator of joint '{known.name}' stands in a file that this one includes, and acts "
                "without a command (armature, damping or a loop), beside the drive; move it into this file."
            )
        if len(acting) != len(mine):
            return mine, None
        brakes, dead = braking(self.model), idle(self.model)
        both = [pair for pair in zip(mine, acting, strict=True) if not dead[pair[1].id]]
        both.sort(key=lambda pair: brakes[pair[1].id])
        return [element for element, _ in both], both[0][1] if both else None

    def _kept(
        self, joint: Joint, mine: list[_Element], here: Any, tag: str, attributes: Attributes
    ) -> Attributes | None:
        """Attributes that make a drive's motor of the joint's own actuator; None where it cannot become that."""
        if tag != "general" or "joint" not in attributes:
            return None
        if self.closes(joint):
            return self._adjusted(joint, mine[0], here, attributes) if len(mine) == 1 else None
        plain = not (here.gaintype[0] or here.biastype[0] or here.dyntype[0]) and here.gainprm[0] > 0.0
        if not plain or set(attributes) - {"name", "joint", "gear", "gainprm"}:  # limits or a delay
            return None
        gear = float(attributes["gear"]) * float(attributes["gainprm"]) / here.gainprm[0]
        if math.isclose(here.gear[0], gear, rel_tol=SAME):
            return {}
        if len(mine) != 1 or gear <= 0.0:
            return None
        self.notes.append(
            f"{self.tree.names[joint.number - 1]}: its actuator has the gear {gear:g} in the place of "
            f"{here.gear[0]:g}, and takes the {commanded(joint)}; its limits are the same at the joint"
        )
        return {"gear": number(gear)} | _limits(here, ("ctrl", "force"), here.gear[0] / gear)

    def _adjusted(
        self, joint: Joint, element: _Element, here: Any, attributes: Attributes
    ) -> Attributes | None:
        """What of a file's own position loop differs from the drive's; None where its element cannot carry it."""
        taken = {"position": ("kp", "kv"), "general": ("gainprm", "biasprm")}.get(element.tag)
        others = {"dampratio", "timeconst", "inheritrange", "delay"} & set(element.values)
        if taken is None or others or here.dyntype[0] != 0:
            return None
        bias = [float(v) for v in attributes["biasprm"].split()]
        new: Attributes = {}
        if not math.isclose(here.gear[0], 1.0, rel_tol=SAME):
            new["gear"] = attributes["gear"]
            self.notes.append(
                f"{self.tree.names[joint.number - 1]}: its actuator has the gear 1 in the place of "
                f"{here.gear[0]:g}, so that its goal is the joint's"
            )
        same = np.allclose([-bias[1], *bias], [here.gainprm[0], *here.biasprm[:3]], rtol=SAME, atol=0.0)
        if not same or here.id in self.damping_ratios:
            both = (
                number(-bias[1]),
                number(0.0 - bias[2]) if element.tag == "position" else attributes["biasprm"],
            )
            new |= dict(zip(taken, both, strict=True))
        for limit in ("force", "ctrl"):
            name, flag = f"{limit}range", f"{limit}limited"
            limited = bool(getattr(here, flag)[0])
            if limited and name not in attributes:
                new |= {flag: "false"}
            after = [float(v) for v in attributes.get(name, "").split()]
            if after and not (limited and np.allclose(after, getattr(here, name), rtol=SAME, atol=0.0)):
                new |= {name: attributes[name]} | ({} if limited else {flag: "true"})
        return new | {name: attributes[name] for name in ("delay", "nsample") if name in attributes}


def _limits(here: Any, names: Iterable[str], times: float) -> Attributes:
    """Limits of an actuator, so many times as wide, as attributes; those that it has."""
    found: Attributes = {}
    for name in names:
        if getattr(here, f"{name}limited")[0]:
            found[f"{name}range"] = numbers(sorted(times * end for end in getattr(here, f"{name}range")))
    return found


def _ten(body: Body) -> list[float]:
    """Mass [kg], centre [m], and inertia about it in MuJoCo's order xx, yy, zz, xy, xz, yz [kg m^2]."""
    mass, centre, about = body.inertia.at_centre()
    moments = [about[i][j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return [float(value) for value in (mass, *centre, *moments)]


def _changed(found: Attributes, known: TreeJoint, *, turned: bool) -> Attributes:
    """Those attributes of a joint that differ from what holds there by the file."""
    rest = math.degrees(known.reference) if turned else known.reference
    before = {
        "armature": known.armature,
        "damping": known.damping,
        "frictionloss": known.friction_loss,
        "stiffness": known.stiffness,
        "springref": rest,
    }

    def same(name: str, value: str) -> bool:
        first, *more = value.split()
        return not more and math.isclose(float(first), before[name], rel_tol=SAME, abs_tol=1e-300)

    return {name: value for name, value in found.items() if name not in before or not same(name, value)}


def _written(tag: str, attributes: Attributes) -> str:
    return f"<{tag} {' '.join(f'{name}={quoteattr(value)}' for name, value in attributes.items())}/>"
