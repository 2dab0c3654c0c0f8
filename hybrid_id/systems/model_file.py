"""The model file: today's simulator as YAML, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from hybrid_id.components import REGISTRY, ArmGravity, Gravity, ResidualNetwork
from hybrid_id.components.base import Component
from hybrid_id.errors import InputError, close_match
from hybrid_id.parameters import Bounded
from hybrid_id.records.yaml_file import read_yaml, validate, write_yaml
from hybrid_id.systems.arms import FLAT_NAMES
from hybrid_id.systems.chain import System
from hybrid_id.systems.model_schema import FLAT, SKELETON, ModelFile, ParameterEntry
from hybrid_id.systems.places import check_place

WEIGHTS = (Gravity.kind, ArmGravity.kind)

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
    """The system that a model file describes; ``path`` is for messages."""
    if file.system not in FLAT:
        raise InputError(f"{path}: system '{file.system}' is not known; use one of {', '.join(FLAT)}.")
    joints = len({where.split("/")[0] for where, _ in SKELETON[file.system]})
    if len(file.gear_ratio) != joints or not all(math.isfinite(r) and r > 0 for r in file.gear_ratio):
        number = "one positive number" if joints == 1 else f"{joints} positive numbers"
        raise InputError(f"{path}: gear_ratio {file.gear_ratio} must hold {number} for {file.system}.")
    parts: Parts = {(where, part.kind): {} for where, part in SKELETON[file.system]}
    _add_components(parts, file, path)
    _add_parameters(parts, file, path)
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
        beyond = {(e.place, e.kind): (e.options, e.weights) for e in file.components}
        built = [
            (where, REGISTRY[kind].restored(values, *beyond.get((where, kind), ({}, {}))))
            for (where, kind), values in parts.items()
        ]
        return System(file.gear_ratio, built, FLAT_NAMES[file.system], name=file.system)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _add_components(parts: Parts, file: ModelFile, path: str) -> None:
    """Put the listed components into their places; one in a single place takes the default's."""
    listed: set[tuple[str, str]] = set()
    singles: dict[tuple[str, type], str] = {}
    for entry in file.components:
        kind, key = _kind(entry.kind, path), (entry.place, entry.kind)
        try:
            check_place(entry.place, kind, len(file.gear_ratio))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        if key in listed:
            raise InputError(
                f"{path}: components lists {entry.kind} at {entry.place} twice; keep one of them."
            )
        listed.add(key)
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
        parts[key] = {
            symbol: _bounded(kind, symbol, value, f"{path}: {entry.place} {entry.kind}.{symbol}")
            for symbol, value in entry.parameters.items()
        }


def _add_parameters(parts: Parts, file: ModelFile, path: str) -> None:
    """Put the flat parameters into their components; one that no component needs brings it along, the rest of it 0."""
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


def _kind(name: str, path: str) -> type[Component]:
    if name not in REGISTRY:
        near = close_match(name, REGISTRY) or f"; use one of {', '.join(sorted(REGISTRY))}."
        raise InputError(f"{path}: component kind '{name}' is not known{near}")
    return REGISTRY[name]


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
    spec.check(where)
    if spec.estimate and spec.lower == spec.upper:
        raise InputError(
            f"{where} has no room to be estimated, lower and upper are both {spec.lower:g}; set 'estimate: false'."
        )
    return spec


def describe_model(system: System) -> dict[str, Any]:
    """The canonical content of a model file for a system.

    Raises:
        InputError: a name that no model file knows, or one of another number of joints.
    """
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
            components.append({"place": where, "kind": kind, "parameters": values})
            if isinstance(part, ResidualNetwork):
                weights = {name: w.detach().tolist() for name, w in part.weights().items()}
                components[-1] |= {"options": part.options(), "weights": weights}
    gravity = "vertical" if any(key.split("/")[2] in WEIGHTS for key in system.components) else "none"
    order = [name for name in FLAT[system.name] if name in parameters]
    content: dict[str, Any] = {
        "system": system.name,
        "gear_ratio": list(system.gear_ratio),
        "gravity": gravity,
        "parameters": {name: parameters[name] for name in order},
    }
    return content | ({"components": components} if components else {})


def save_model(system: System, path: str | Path) -> None:
    """Write a system as a model file, under a temporary name first."""
    write_yaml(path, describe_model(system))


def _entry(spec: Bounded) -> dict[str, Any]:
    entry: dict[str, Any] = {"nominal": spec.value}
    entry |= {k: v for k, v in (("lower", spec.lower), ("upper", spec.upper)) if math.isfinite(v)}
    entry |= {"unit": spec.unit, "estimate": spec.estimate}
    if spec.prior_std is not None:
        entry |= {"prior_std": spec.prior_std}
        if spec.prior_mean != spec.value:
            entry["prior_mean"] = spec.prior_mean
    return entry


def values_of(system: System) -> Mapping[str, float]:
    """Parameter values by result name."""
    return {info.name: info.spec.value for info in system.table}
