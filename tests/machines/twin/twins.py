"""The true machines of the paper's later stages, and signals that make them stick and slip."""

from pathlib import Path

import numpy as np

from hybrid_id.machines.physics.friction import AsymmetricStribeck, Viscous
from hybrid_id.machines.physics.law import Law
from hybrid_id.machines.physics.load import Gravity
from hybrid_id.machines.physics.machine import Drive, Machine, OneLink
from hybrid_id.machines.physics.motor import Motor
from hybrid_id.machines.physics.stick_slip import StickSlip
from hybrid_id.machines.physics.transmission import Gear
from hybrid_id.machines.twin.settings import NO_RIPPLE, ONE_LINK_FLEXIBLE, start_state, two_link
from hybrid_id.records.yaml_file import read_yaml

PEAKS = ("f_11", "f_12", "f_13", "f_14", "f_21", "f_22", "f_23", "f_24")
CONFIGS = Path(__file__).resolve().parents[3] / "configs"
FLEXIBLE = read_yaml(CONFIGS / "twin_link1_flexible.yaml")["truth"]
ARM = read_yaml(CONFIGS / "twin_both_links.yaml")["truth"]
RATIOS = (156.0, 84.0)
FRICTION = ("f_11", "f_12", "f_21", "f_22", "f_3")


def lanes(values: dict[str, float], **changes: float | np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of runs side by side, some of them changed."""
    return {name: np.atleast_1d(value) for name, value in (values | changes).items()}


def rigid(*friction: Law, J, P_m1, P_m2, f_3=0.0, G_l=0.0, r=1.0) -> StickSlip:
    """A motor, a rigid gear and one link, written at the motor shaft: J v' = P_m1 (u - P_m2 v) - f_3 v - dry."""
    drive = Drive(Gear(r), J, Motor(P_m1, P_m2), link_laws=[Gravity(G_l)] if G_l else [])
    drive.rotor_laws = [*friction, Viscous(f_3)]
    return StickSlip(Machine([drive], OneLink(0.0)))


def at_rest_levels(system: StickSlip, joint: int = 0) -> dict[float, float]:
    """Torque that holds a joint at zero speed [N m], by side."""
    dry = next(law for law in system.drives[joint].rotor_laws if isinstance(law, AsymmetricStribeck))
    return dict(zip((1.0, -1.0), (float(level.item()) for level in dry.levels(np.zeros(1))), strict=True))


def flexible(ripple=NO_RIPPLE, **changes):
    return ONE_LINK_FLEXIBLE.build(lanes(FLEXIBLE, **changes), RATIOS[:1], [ripple])


def arm(ripple=NO_RIPPLE, held: int | None = None, **changes):
    return two_link(held).build(lanes(ARM, **changes), RATIOS, [ripple, ripple])


def at_rest(machine, n_motors: int) -> np.ndarray:
    """State (n_x, 1) at rest, every angle zero."""
    return start_state(machine, np.zeros((n_motors, 1)), RATIOS[:n_motors])


def sines(time: np.ndarray, peak: float, tones: list[float], phase: float) -> np.ndarray:
    """A voltage (T,) of a few tones [Hz]."""
    return peak / len(tones) * sum(np.cos(2 * np.pi * f * time + phase * k) for k, f in enumerate(tones, 1))
