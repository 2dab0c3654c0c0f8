"""The model file: the nominal model as YAML, and back."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from hybrid_id.components import REGISTRY
from hybrid_id.components.base import Component
from hybrid_id.components.load.arm_gravity import ArmGravity
from hybrid_id.components.load.gravity import Gravity
from hybrid_id.components.residual import ResidualNetwork
from hybrid_id.errors import InputError, close_match
from hybrid_id.parameters import Bounded, linear_unit
from hybrid_id.records.yaml_file import read_yaml, validate, write_yaml
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.builders import FLAT_NAMES, joint_names, robot
from hybrid_id.systems.by_joint import together
from hybrid_id.systems.chain import System, acts_along, check_place
from hybrid_id.systems.model_schema import (
    FLAT,
    ROBOT,
    SKELETON,
    ComponentEntry,
    ModelFile,
    ParameterEntry,
    RobotEntry,
)
from hybrid_id.systems.servos import SERVOS, drive_of

WEIGHTS = (Gravity.kind, ArmGravity.kind)

RATIOS, SLIDE_RATIOS = (1e-2, 1e5), (1e-2, 1e8)
"""Least and largest gear ratio of a joint that turns, and of one that slides [rad/m]."""

EVERY_JOINT = "all"
"""Stands for every joint in the list of servos."""

Parts = dict[tuple[str, str], dict[str, Bounded]]
"""Parameters of each component of a system, by place and kind."""


def load_model(path: str | Path) -> System:
    """Read a model file.

    Raises:
        InputError: the file, a key, a name, a unit or a bound is wrong; says which.
    """
    path = Path(path)
    return build_model(validate(ModelFile, read_yaml(path), path), str(path))


def build_model(file: ModelFile, path: str = "model") -> System:
    """The system that a model file describes; ``path`` is for messages, and where a robot's file is looked for."""
    if file.robot is None and file.system == ROBOT:
        raise InputError(
            f"{path}: key 'system' is missing; add one of {', '.join(FLAT)}, or name your robot's MJCF or URDF as "
            "robot: {file: arm.xml}."
        )
    if file.robot is not None and file.system != ROBOT:
        raise InputError(
            f"{path}: 'robot' and 'system: {file.system}' do not go together; keep the one that describes your machine."
        )
    return _known(file, path) if file.robot is None else _robot(file, file.robot, path)


def _robot(file: ModelFile, described: RobotEntry, path: str) -> System:
    """Drives at the joints of a robot's description; what the file lists takes the place of their usual parts."""
    tree = load_tree(Path(path).parent / described.file)
    if described.hold:
        try:
            tree = tree.holding(described.hold)
        except InputError as error:
            raise InputError(f"{path}: robot.hold: {error}") from None
    try:
        tree = tree.coupled([(one.joints, one.matrix) for one in file.couplings])
    except InputError as error:
        raise InputError(f"{path}: couplings: {error}") from None
    ratios = file.gear_ratio or [1.0] * len(tree.joints)
    if len(ratios) != len(tree.joints) or not all(math.isfinite(r) and r > 0 for r in ratios):
        raise InputError(
            f"{path}: gear_ratio {file.gear_ratio} must hold a positive number for each of {', '.join(tree.names)}."
        )
    _refuse_odd_ratios(ratios, [joint.kind == "slide" for joint in tree.joints], path)
    if file.parameters or file.gravity != "none":
        key = "parameters" if file.parameters else "gravity"
        raise InputError(
            f"{path}: '{key}' belongs to the systems {', '.join(FLAT)}; a robot's masses and gravity stand in "
            f"{described.file}, its drives under 'components'."
        )
    listed = []
    for k, one in enumerate(file.components):
        _placed_kind(one, k, tree.names, path)
        joint, _, place = one.place.rpartition("/")
        number = tree.names.index(joint)
        if tree.joints[number].kind == "slide" and acts_along(REGISTRY[one.kind], place, ratios[number]):
            # with the units of its law in place of those of the linear axis; the values are the same
            declared = REGISTRY[one.kind].declared
            own = {
                symbol: entry.model_copy(update={"unit": declared[symbol].unit})
                for symbol, entry in one.parameters.items()
                if symbol in declared and entry.unit == linear_unit(declared[symbol].unit)
            }
            one = one.model_copy(update={"parameters": one.parameters | own})
        listed.append(one.model_copy(update={"place": f"joint{number + 1}/{place}"}))
    file = file.model_copy(update={"components": listed, "gear_ratio": ratios})
    usual = robot(tree, ratios)
    servos = {name: servo for name, servo in file.servos.items() if name != EVERY_JOINT}
    if EVERY_JOINT in file.servos:
        servos = {name: file.servos[EVERY_JOINT] for name in tree.names} | servos
    for name, servo in servos.items():
        if name not in tree.names:
            near = close_match(name, tree.names)
            raise InputError(
                f"{path}: servos: the robot has no joint '{name}'{near}; it has {', '.join(tree.names)}."
            )
        if servo.preset not in SERVOS:
            raise InputError(f"{path}: servo '{servo.preset}' is not known; use one of {', '.join(SERVOS)}.")
        number = tree.names.index(name)
        own = tree.joints[number].servo
        goals = None if own is None else own.goals  # limits of goals stay the robot's
        loop, friction = drive_of(SERVOS[servo.preset], servo.p, ratios[number], servo.voltage, goals)
        usual = usual.with_component(f"joint{number + 1}/input", loop)
        usual = usual.with_component(f"joint{number + 1}/motor_friction", friction)
    parts: Parts = {
        (key.rsplit("/", 1)[0], cast(Component, part).kind): dict(cast(Component, part).specs)
        for key, part in usual.components.items()
    }
    try:
        _add_components(parts, file, path)
        built = _built(parts, file)
        system = System(ratios, built, joint_names(tree, built), name=ROBOT, tree=tree)
        for joint in system.joints:  # here, where the joints' own names are known
            joint.drive.check()
    except InputError as error:
        words = str(error).removeprefix(f"{path}: ")
        words = re.sub(r"\bjoint(\d+)(?=/| has )", lambda found: tree.names[int(found[1]) - 1], words)
        raise InputError(f"{path}: {words}") from None
    return system


def _refuse_odd_ratios(ratios: Sequence[float], slides: Sequence[bool], path: str) -> None:
    """Raise InputError for a ratio that no gear has: its inverse was meant, or another unit."""
    for ratio, slide in zip(ratios, slides, strict=True):
        low, high = SLIDE_RATIOS if slide else RATIOS
        if not low <= ratio <= high:
            what = f"{'rad' if slide else 'turns'} of the motor for one {'m ' if slide else ''}of the joint"
            raise InputError(
                f"{path}: gear_ratio {ratio:g} is none of a drive; give the {what}, a number from {low:g} to {high:g}."
            )


def _built(parts: Parts, file: ModelFile) -> list[tuple[str, Component]]:
    beyond = {(e.place, e.kind): (e.options, e.weights) for e in file.components}
    return [
        (where, REGISTRY[kind].restored(values, *beyond.get((where, kind), ({}, {}))))
        for (where, kind), values in parts.items()
    ]


def _known(file: ModelFile, path: str) -> System:
    """A system that the package knows by name, with its flat parameter names."""
    if file.system not in FLAT:
        raise InputError(f"{path}: system '{file.system}' is not known; use one of {', '.join(FLAT)}.")
    joints = len({where.split("/")[0] for where, _ in SKELETON[file.system]})
    if file.servos:
        raise InputError(
            f"{path}: 'servos' belongs to a robot with a description; list an input under 'components'."
        )
    if file.couplings:
        raise InputError(
            f"{path}: 'couplings' belongs to a robot with a description; remove it, or name your robot's file."
        )
    if not file.gear_ratio:
        raise InputError(f"{path}: key 'gear_ratio' is missing; add one number for each joint.")
    if len(file.gear_ratio) != joints or not all(math.isfinite(r) and r > 0 for r in file.gear_ratio):
        number = "one positive number" if joints == 1 else f"{joints} positive numbers"
        raise InputError(f"{path}: gear_ratio {file.gear_ratio} must hold {number} for {file.system}.")
    _refuse_odd_ratios(file.gear_ratio, [False] * joints, path)
    parts: Parts = {(where, part.kind): {} for where, part in SKELETON[file.system]}
    _add_components(parts, file, path)
    # a component that is not there yet comes with its parameter; what the file leaves out of it is 0 and held
    names, listed = FLAT[file.system], set(parts)
    replaced: dict[tuple[str, str], list[str]] = {}
    for name in file.parameters:
        if name not in names:
            known = ", ".join(names)
            raise InputError(f"{path}: parameter '{name}' is not known for {file.system}; it knows {known}.")
        where, kind_name, _ = names[name]
        if REGISTRY[kind_name].single and (where, kind_name) not in parts:
            replaced.setdefault((where, kind_name), []).append(name)
    if replaced:
        which = " and ".join(
            f"{', '.join(given)} of {kind_name} at {where}" for (where, kind_name), given in replaced.items()
        )
        raise InputError(f"{path}: 'components' replaces what has the parameters {which}; remove them.")
    for name, entry in file.parameters.items():
        where, kind_name, symbol = names[name]
        kind = REGISTRY[kind_name]
        values = parts.setdefault((where, kind_name), {})
        if symbol in values:
            raise InputError(
                f"{path}: parameter '{name}' is given under 'parameters' and as {kind_name}.{symbol} under "
                "'components'; keep one of them."
            )
        values[symbol] = _bounded(kind, symbol, entry, f"{path}: {name}")
    for key in set(parts) - listed:
        for symbol, declared in REGISTRY[key[1]].declared.items():
            if declared.estimate and symbol not in parts[key]:
                parts[key][symbol] = replace(declared.bounded(0.0), estimate=False)
    if (file.gravity == "vertical") != any(kind in WEIGHTS for _, kind in parts):
        name = "G_l" if joints == 1 else "G_l1 and G_l2"
        verb = (
            f"add {name} to"
            if file.gravity == "vertical"
            else f"set gravity to vertical or remove {name} from"
        )
        raise InputError(
            f"{path}: gravity is {file.gravity}, which does not fit the parameters; {verb} the file."
        )
    for name, (where, kind_name, symbol) in FLAT[file.system].items():
        given = parts.get((where, kind_name))
        optional = not REGISTRY[kind_name].single or not REGISTRY[kind_name].declared[symbol].estimate
        if given is not None and symbol not in given and not optional:
            raise InputError(
                f"{path}: parameter '{name}' is missing; give its nominal value under 'parameters'."
            )
    try:
        return System(file.gear_ratio, _built(parts, file), FLAT_NAMES[file.system], name=file.system)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _add_components(parts: Parts, file: ModelFile, path: str) -> None:
    """Put the listed components into their places; one in a single place takes the default's.

    Of one that is there already the file may name some parameters; the others stay.
    """
    listed: set[tuple[str, str]] = set()
    singles: dict[tuple[str, type], str] = {}
    joints = [f"joint{n + 1}" for n in range(len(file.gear_ratio))]
    for k, entry in enumerate(file.components):
        kind, key = _placed_kind(entry, k, joints, path), (entry.place, entry.kind)
        if key in listed:
            raise InputError(
                f"{path}: components lists {entry.kind} at {entry.place} twice; keep one of them."
            )
        listed.add(key)
        usual = parts.get(key, {})  # of the same kind: what the file does not name stays as it was
        if kind.single:
            family = kind.family()
            if other := singles.get((entry.place, family)):
                raise InputError(
                    f"{path}: {entry.place} holds exactly one component, but {other} and {entry.kind} are listed; "
                    "keep one of them."
                )
            singles[entry.place, family] = entry.kind
            for old in [
                key for key in parts if key[0] == entry.place and issubclass(REGISTRY[key[1]], family)
            ]:
                del parts[old]
        parts[key] = usual | {
            symbol: _bounded(kind, symbol, value, f"{path}: {entry.place} {entry.kind}.{symbol}")
            for symbol, value in entry.parameters.items()
        }


def _placed_kind(entry: ComponentEntry, k: int, joints: Sequence[str], path: str) -> type[Component]:
    """Class of the k-th listed component, which can sit in the place that the file gives it."""
    if entry.kind not in REGISTRY:
        near = close_match(entry.kind, REGISTRY) or f"; use one of {', '.join(sorted(REGISTRY))}."
        raise InputError(
            f"{path}: key 'components[{k}].kind': component kind '{entry.kind}' is not known{near}"
        )
    try:
        check_place(entry.place, REGISTRY[entry.kind], joints)
    except InputError as error:
        raise InputError(f"{path}: key 'components[{k}].place': {error}") from None
    return REGISTRY[entry.kind]


def _bounded(kind: type[Component], symbol: str, entry: ParameterEntry, where: str) -> Bounded:
    if symbol not in kind.declared:
        raise InputError(f"{where} is not a parameter; {kind.kind} has {', '.join(kind.declared) or 'none'}.")
    declared = kind.declared[symbol]
    if entry.unit is not None and entry.unit != declared.unit:
        raise InputError(f"{where} has unit '{entry.unit}'; convert it to '{declared.unit}'.")
    spec = Bounded(
        entry.nominal,
        declared.lower if entry.lower is None else entry.lower,
        declared.upper if entry.upper is None else entry.upper,
        declared.unit,
        declared.estimate if entry.estimate is None else entry.estimate,
        None
        if entry.prior_std is None
        else (entry.nominal if entry.prior_mean is None else entry.prior_mean),
        entry.prior_std,
    )
    if spec.lower < declared.lower or spec.upper > declared.upper:
        raise InputError(
            f"{where}: its range [{spec.lower:g}, {spec.upper:g}] leaves the physical range "
            f"[{declared.lower:g}, {declared.upper:g}]; narrow it."
        )
    if not declared.lower <= spec.value <= declared.upper and math.isfinite(spec.value):
        raise InputError(
            f"{where} = {spec.value:g} {spec.unit} lies outside its physical bounds [{declared.lower:g}, "
            f"{declared.upper:g}]; give a value inside."
        )
    spec.check(where)
    if spec.estimate and spec.lower == spec.upper:
        raise InputError(
            f"{where} has no room to be estimated, lower and upper are both {spec.lower:g}; set 'estimate: false'."
        )
    return spec


def describe_model(system: System, folder: Path | None = None) -> dict[str, Any]:
    """The canonical content of a model file for a system.

    Args:
        system: the system.
        folder: where the model file will lie; a robot's own file is then named as seen from there.

    Raises:
        InputError: a name that no model file knows, or one of another number of joints.
    """
    if system.whole:
        system = together(system)
    if system.tree is not None:
        if not system.tree.source:
            raise InputError(
                "a robot that was read from no file cannot be written to a model file; load its MJCF or URDF"
            )
        components = []
        for key, part in system.components.items():
            joint, place, _ = key.split("/")
            units = {info.symbol: info.unit for info in system.table if info.component == key}
            components.append(
                _component(f"{system.tree.names[int(joint[5:]) - 1]}/{place}", cast(Component, part), units)
            )
        file = system.tree.source if folder is None else seen_from(folder, system.tree.source)
        described = {"file": file} | ({"hold": dict(system.tree.held)} if system.tree.held else {})
        couplings = [
            {
                "joints": [system.tree.names[k] for k in one.joints],
                "matrix": [list(row) for row in one.matrix],
            }
            for one in system.tree.couplings
        ]
        return {
            "robot": described,
            "gear_ratio": list(system.gear_ratio),
            **({"couplings": couplings} if couplings else {}),
            "components": components,
        }
    joints = {where.split("/")[0] for where, _ in SKELETON.get(system.name, ())}
    if len(joints) != len(system.joints):
        raise InputError(
            f"a system named '{system.name}' with {len(system.joints)} joints cannot be written to a model file; name "
            f"it {' or '.join(SKELETON)}, by its joints"
        )
    flat = {where: name for name, where in FLAT[system.name].items()}
    defaults = {(where, kind.kind) for where, kind in SKELETON[system.name]}
    parameters: dict[str, Any] = {}
    components: list[dict[str, Any]] = []
    for key, module in system.components.items():
        part, (joint, place, kind) = cast(Component, module), key.split("/")
        where = f"{joint}/{place}"
        values = {symbol: _entry(spec) for symbol, spec in part.specs.items()}
        if all((where, kind, symbol) in flat for symbol in values) and (values or (where, kind) in defaults):
            parameters |= {flat[where, kind, symbol]: entry for symbol, entry in values.items()}
        else:
            components.append(_component(where, part))
    gravity = "vertical" if any(key.split("/")[2] in WEIGHTS for key in system.components) else "none"
    order = [name for name in FLAT[system.name] if name in parameters]
    content: dict[str, Any] = {
        "system": system.name,
        "gear_ratio": list(system.gear_ratio),
        "gravity": gravity,
        "parameters": {name: parameters[name] for name in order},
    }
    return content | ({"components": components} if components else {})


def seen_from(folder: Path, file: str) -> str:
    """A file's name as seen from a folder, so that both can be moved together; whole where no such name leads there."""
    whole = Path(file)
    try:
        return Path(os.path.relpath(whole.parent.resolve() / whole.name, folder.resolve())).as_posix()
    except ValueError:  # another drive of Windows
        return file


def _component(where: str, part: Component, units: Mapping[str, str] | None = None) -> dict[str, Any]:
    values = {s: _entry(spec) | {"unit": (units or {}).get(s, spec.unit)} for s, spec in part.specs.items()}
    entry: dict[str, Any] = {"place": where, "kind": part.kind, "parameters": values}
    if options := part.options():
        entry |= {"options": options}
    if isinstance(part, ResidualNetwork):
        entry |= {"weights": {name: w.detach().tolist() for name, w in part.weights().items()}}
    return entry


def save_model(
    system: System, path: str | Path, home: str | Path | None = None, moved: str | Path | None = None
) -> None:
    """Write a system as a model file, under a temporary name first.

    Args:
        system: the system.
        path: file to write.
        home: folder where the file will lie at last; that of the path by default.
        moved: folder, the path's or above it, that is moved with all that it holds until the file lies in ``home``; the
            path's by default.
    """
    here = Path(path).parent
    along = system.tree is not None and Path(system.tree.source).resolve().is_relative_to(
        (here if moved is None else Path(moved)).resolve()
    )
    write_yaml(path, describe_model(system, here if home is None or along else Path(home)))


def _entry(spec: Bounded) -> dict[str, Any]:
    entry: dict[str, Any] = {"nominal": spec.value + 0.0}  # -0.0 becomes 0.0
    entry |= {k: v for k, v in (("lower", spec.lower), ("upper", spec.upper)) if math.isfinite(v)}
    entry |= {"unit": spec.unit, "estimate": spec.estimate}
    if spec.prior_std is not None:
        entry |= {"prior_std": spec.prior_std}
        if spec.prior_mean != spec.value:
            entry["prior_mean"] = spec.prior_mean
    return entry
