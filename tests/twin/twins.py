"""The true machines of the paper's later stages, and signals that make them stick and slip."""

from pathlib import Path

import numpy as np

from hybrid_id.records.yaml_file import read_yaml
from hybrid_id.twin.machines import ONE_LINK_FLEXIBLE, start_state, two_link
from hybrid_id.twin.rotor import NO_RIPPLE

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
FLEXIBLE = read_yaml(CONFIGS / "twin_link1_flexible.yaml")["truth"]
ARM = read_yaml(CONFIGS / "twin_both_links.yaml")["truth"]
RATIOS = (156.0, 84.0)
FRICTION = ("f_11", "f_12", "f_21", "f_22", "f_3")


def lanes(values: dict[str, float], **changes: float | np.ndarray) -> dict[str, np.ndarray]:
    """Parameters of runs side by side, some of them changed."""
    return {name: np.atleast_1d(value) for name, value in (values | changes).items()}


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
