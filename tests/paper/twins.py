"""Machines of the paper's twins with parameters of a test's own, and signals that make them stick and slip."""

from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.machines.physics.friction import Viscous
from hybrid_id.machines.physics.law import Law
from hybrid_id.machines.physics.load import Gravity
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.stick_slip import StickSlip
from hybrid_id.machines.physics.transmission import Gear
from hybrid_id.paper.twin import read_settings
from hybrid_id.records.yaml_file import read_yaml

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
LEVELS = ("f_11", "f_12", "f_21", "f_22", "f_3")


def config(stage: str) -> dict[str, Any]:
    return read_yaml(CONFIGS / f"twin_{stage}.yaml")


def mechanism(stage: str, *, ripple: bool = False, **changes: float) -> tuple[StickSlip, np.ndarray]:
    """One run of a stage's machine with its true parameters, some of them changed, and its state at rest."""
    settings = config(stage)
    return read_settings(settings).begin([settings["truth"] | changes], ripple=ripple)


def rigid(*friction: Law, J, P_m1, P_m2, f_3=0.0, G_l=0.0, r=1.0) -> StickSlip:
    """A motor, a rigid gear and one link, written at the motor shaft: J v' = P_m1 (u - P_m2 v) - f_3 v - dry."""
    drive = Drive(Gear(r), J, Motor(P_m1, P_m2), link_laws=[Gravity(G_l)] if G_l else [])
    drive.rotor_laws = [*friction, Viscous(f_3)]
    return StickSlip(Machine([drive], OneLink(0.0)))


def sines(time: np.ndarray, peak: float, tones: list[float], phase: float) -> np.ndarray:
    """A voltage (T,) of a few tones [Hz]."""
    return peak / len(tones) * sum(np.cos(2 * np.pi * f * time + phase * k) for k, f in enumerate(tones, 1))
