"""A drive's input stage and motor as an actuator of MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from hybrid_id.components import (
    Cogging,
    CurrentMotor,
    DCMotor,
    Deadband,
    ElectricalLag,
    PositionLoop,
    Saturation,
    ThermalDerating,
    TorqueMotor,
)
from hybrid_id.errors import InputError
from hybrid_id.systems.chain import Views
from hybrid_id.systems.joint import Joint

COPPER = 0.0039
"""Temperature coefficient of copper [1/K]."""
PLAIN = ("voltage", "current_command", "torque_command")
"""Inputs that give the logged channel as it is."""

Attributes = dict[str, str]


def number(value: Any) -> str:
    """A number as MJCF writes it."""
    return f"{float(value):.10g}"


def numbers(values: Iterable[Any]) -> str:
    """Numbers as MJCF writes them."""
    return " ".join(map(number, values))


def left_out(key: str, why: str) -> str:
    """The sentence about a component that the export does not carry."""
    where, kind = key.rsplit("/", 1)
    return f"{where}: {kind} is left out, {why}"


def motor(joint: Joint, p: Views, step: float, extras: Attributes) -> tuple[str, Attributes, list[str]]:
    """Tag, attributes and notes of the actuator ``motor``, whose length is the rotor's angle.

    Args:
        joint: the joint.
        p: parameter views.
        step: MuJoCo's time step [s].
        extras: what else a ``dcmotor`` carries, friction and cogging.
    """
    key, part = joint.drive.motor
    limits, notes = _command(joint, p, step)
    found = {
        "name": f"motor{joint.number}",
        "joint": f"joint{joint.number}",
        "gear": number(joint.gear_ratio),
    } | limits
    if isinstance(part, DCMotor):
        K = float(p[key].P_m2)
        if K <= 0.0:
            raise InputError(
                f"{key}: P_m2 is {K:g}, but MuJoCo's dcmotor needs a back-EMF; give it a value above 0"
            )
        R = K / float(p[key].P_m1)
        found |= {"motorconst": numbers([K, K]), "resistance": number(R)} | extras
        for name, winding, _ in joint.drive.windings:
            own = p[name]
            if isinstance(winding, ElectricalLag):
                found["inductance"] = f"0 {number(own.T_e)}"
            elif isinstance(winding, ThermalDerating):
                capacity = R * COPPER * float(own.T_w) / (K**2 * max(float(own.c), 1e-12))
                found["thermal"] = f"0 {number(capacity)} {number(own.T_w)} {COPPER} 25 25"
            else:
                notes.append(left_out(name, "MuJoCo's winding knows inductance and heat"))
        return "dcmotor", found, notes
    gains = {CurrentMotor: "k_t", TorqueMotor: "gain"}
    symbol = next((s for kind, s in gains.items() if isinstance(part, kind)), None)
    if symbol is None:
        notes.append(left_out(key, "MuJoCo has no such motor"))
    windings = (name for name, _, _ in joint.drive.windings)
    notes += [left_out(name, "MuJoCo has it in motors that take a voltage only") for name in windings]
    return "general", found | {"gainprm": number(getattr(p[key], symbol) if symbol else 0.0)}, notes


def cogging(joint: Joint, p: Views) -> tuple[Attributes, list[str]]:
    """Torques on the rotor as an attribute of a ``dcmotor``: ``amplitude sin(periods q + phase)``; and notes."""
    found: Attributes = {}
    notes = []
    for key, part in joint.drive.torques:
        view = p[key]
        if not isinstance(part, Cogging):
            notes.append(left_out(key, "MuJoCo's motor has no such torque"))
        elif float(view.n) != round(float(view.n)):
            notes.append(
                left_out(key, f"MuJoCo's has a whole number of periods per turn, not {float(view.n):g}")
            )
        else:
            size = math.hypot(float(view.T_c), float(view.T_s))
            phase = math.atan2(float(view.T_c), float(view.T_s))
            found["cogging"] = f"{number(size)} {round(float(view.n))} {number(phase)}"
            if float(view.T_c2) or float(view.T_s2):
                notes.append(left_out(f"{key}, second wave", "MuJoCo's motor has one"))
    return found, notes


def passive(name: str, on: Attributes, gear: float, extras: Attributes) -> tuple[str, Attributes]:
    """Tag and attributes of an actuator without input that carries friction or cogging alone."""
    head = {"name": name, "gear": number(gear), "input": "none", "motorconst": "0 0", "resistance": "1"}
    return "dcmotor", head | on | extras


def _command(joint: Joint, p: Views, step: float) -> tuple[Attributes, list[str]]:
    """Limit and delay of the command, and what of the input stage stays outside."""
    _, source = joint.drive.input
    found: Attributes = {}
    notes = []
    if source.kind not in PLAIN:
        notes.append(
            f"joint{joint.number}/input: ctrl is the motor's voltage; {source.kind} ({', '.join(source.channels)}) "
            "stays with the controller"
        )
    for key, part in joint.drive.maps:
        if isinstance(part, Saturation):
            found["ctrlrange"] = numbers([-p[key].V_max, p[key].V_max])
        elif isinstance(part, Deadband):
            notes.append(left_out(key, "MuJoCo's actuators have no dead band"))
        else:
            notes.append(left_out(key, "MuJoCo's actuators have no such map"))
    if joint.drive.delay is not None and (steps := round(float(p[joint.drive.delay[0]].T_d) / step)):
        if isinstance(source, PositionLoop):  # MuJoCo would delay the angle that the loop reads, too
            notes.append(f"{joint.drive.delay[0]}: it delays the goal, and stays with the controller")
        else:
            found |= {"delay": number(steps * step), "nsample": str(steps)}
    return found, notes
