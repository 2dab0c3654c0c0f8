"""The model file: today's simulator as YAML, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import BaseModel, ConfigDict, Field

from hybrid_id.components import (
    REGISTRY,
    DCMotor,
    Gravity,
    LinearSpring,
    OneLink,
    Rigid,
    TwoInertias,
    Voltage,
)
from hybrid_id.components.base import Component
from hybrid_id.errors import InputError
from hybrid_id.parameters import Bounded
from hybrid_id.records.yaml_file import read_yaml, validate, write_yaml
from hybrid_id.systems.arms import FLAT_NAMES
from hybrid_id.systems.chain import System

Where = tuple[str, str, str]
"""Place, kind and symbol that a flat name stands for."""

FLAT: dict[str, dict[str, Where]] = {
    "one_link": {
        "J": ("joint1/load", "one_link", "J"),
        "rotor_share": ("joint1/load", "one_link", "rotor_share"),
        "P_m1": ("joint1/motor", "dc_motor", "P_m1"),
        "P_m2": ("joint1/motor", "dc_motor", "P_m2"),
        "F_c": ("joint1/motor_friction", "coulomb_friction", "F_c"),
        "F_v": ("joint1/motor_friction", "viscous_friction", "F_v"),
        "G_l": ("joint1/load", "gravity_load", "G_l"),
        "q_0": ("joint1/load", "gravity_load", "q_0"),
    },
    "one_link_flexible": {
        "J_m": ("joint1/load", "two_inertias", "J_m"),
        "J_a": ("joint1/load", "two_inertias", "J_a"),
        "k": ("joint1/transmission", "linear_spring", "k"),
        "d": ("joint1/transmission", "linear_spring", "d"),
        "P_m1": ("joint1/motor", "dc_motor", "P_m1"),
        "P_m2": ("joint1/motor", "dc_motor", "P_m2"),
        "F_cm": ("joint1/motor_friction", "coulomb_friction", "F_c"),
        "F_vm": ("joint1/motor_friction", "viscous_friction", "F_v"),
        "F_ca": ("joint1/link_friction", "coulomb_friction", "F_c"),
        "F_va": ("joint1/link_friction", "viscous_friction", "F_v"),
        "G_l": ("joint1/load", "gravity_load", "G_l"),
        "q_0": ("joint1/load", "gravity_load", "q_0"),
    },
}
"""Flat parameter names of each system. A friction or gravity name that is not listed is absent from the model."""

SKELETON: dict[str, tuple[tuple[str, type[Component]], ...]] = {
    "one_link": (
        ("joint1/input", Voltage),
        ("joint1/motor", DCMotor),
        ("joint1/transmission", Rigid),
        ("joint1/load", OneLink),
    ),
    "one_link_flexible": (
        ("joint1/input", Voltage),
        ("joint1/motor", DCMotor),
        ("joint1/transmission", LinearSpring),
        ("joint1/load", TwoInertias),
    ),
}
"""Components that a system always has, unless the file puts another one into their place."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ParameterEntry(_Section):
    """One parameter in a file: PEtab's columns, and an optional Gaussian prior around the nominal value."""

    nominal: float
    lower: float | None = None
    upper: float | None = None
    unit: str | None = None
    estimate: bool | None = None
    prior_std: float | None = Field(default=None, gt=0)
    prior_mean: float | None = None


class ComponentEntry(_Section):
    """One component beyond the system's defaults."""

    place: str
    kind: str
    parameters: dict[str, ParameterEntry | float] = {}


class ModelFile(_Section):
    """Content of a model file."""

    system: str
    gear_ratio: list[float]
    gravity: Literal["none", "vertical"] = "none"
    parameters: dict[str, ParameterEntry | float] = {}
    components: list[ComponentEntry] = []


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
    if len(file.gear_ratio) != 1 or not all(math.isfinite(r) and r > 0 for r in file.gear_ratio):
        raise InputError(
            f"{path}: gear_ratio {file.gear_ratio} must hold one positive number for {file.system}."
        )
    parts: dict[tuple[str, str], dict[str, Bounded]] = {}
    for where, component in SKELETON[file.system]:
        parts[where, component.kind] = {}
    singles: dict[tuple[str, type], tuple[str, str]] = {}
    for entry in file.components:
        kind = _kind(entry.kind, path)
        symbols = {
            s: _bounded(kind, s, e, f"{path}: {entry.place} {entry.kind}.{s}")
            for s, e in entry.parameters.items()
        }
        if (entry.place, entry.kind) in parts and entry.kind not in {
            c.kind for _, c in SKELETON[file.system]
        }:
            raise InputError(
                f"{path}: components lists {entry.kind} at {entry.place} twice; keep one of them."
            )
        if kind.single:
            family = _family(kind)
            for where, other in [key for key in parts if key[0] == entry.place]:
                if issubclass(REGISTRY[other], family):
                    del parts[where, other]
            if (entry.place, family) in singles:
                raise InputError(
                    f"{path}: {entry.place} holds exactly one component, but {singles[entry.place, family][1]} and "
                    f"{entry.kind} are listed; keep one of them."
                )
            singles[entry.place, family] = (entry.place, entry.kind)
        parts[entry.place, entry.kind] = symbols
    for name, entry in file.parameters.items():
        if name not in FLAT[file.system]:
            known = ", ".join(FLAT[file.system])
            raise InputError(f"{path}: parameter '{name}' is not known for {file.system}; it knows {known}.")
        where, kind_name, symbol = FLAT[file.system][name]
        kind = REGISTRY[kind_name]
        if kind.single and (where, kind_name) not in parts:
            raise InputError(
                f"{path}: parameter '{name}' belongs to {kind_name} at {where}, which 'components' replaces; remove it."
            )
        parts.setdefault((where, kind_name), {})[symbol] = _bounded(kind, symbol, entry, f"{path}: {name}")
    if (file.gravity == "vertical") != (("joint1/load", Gravity.kind) in parts):
        verb = "add G_l to" if file.gravity == "vertical" else "set gravity to vertical or remove G_l from"
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
        built = [(where, REGISTRY[kind](**values)) for (where, kind), values in parts.items()]
        return System(file.gear_ratio, built, FLAT_NAMES[file.system], name=file.system)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _family(kind: type[Component]) -> type[Component]:
    return [base for base in kind.__mro__ if getattr(base, "single", False)][-1]


def _kind(name: str, path: str) -> type[Component]:
    if name not in REGISTRY:
        raise InputError(
            f"{path}: component kind '{name}' is not known; use one of {', '.join(sorted(REGISTRY))}."
        )
    return REGISTRY[name]


def _bounded(kind: type[Component], symbol: str, entry: ParameterEntry | float, where: str) -> Bounded:
    if symbol not in kind.declared:
        raise InputError(f"{where} is not a parameter; {kind.kind} has {', '.join(kind.declared) or 'none'}.")
    declared = kind.declared[symbol]
    if not isinstance(entry, ParameterEntry):
        entry = ParameterEntry(nominal=entry)
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
    return spec.check(where)


def describe_model(system: System) -> dict[str, Any]:
    """The canonical content of a model file for a system."""
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
    gravity = "vertical" if any(key.endswith(f"/{Gravity.kind}") for key in system.components) else "none"
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
