"""Units that measured files come in, and the SI unit that every record is converted to on reading."""

import math
import re

from hybrid_id.errors import InputError

# SI unit -> {spelling found in files: factor to the SI unit}
_SPELLINGS: dict[str, dict[str, float]] = {
    "s": {"s": 1, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60},
    "rad": {
        "rad": 1,
        "mrad": 1e-3,
        "deg": math.pi / 180,
        "°": math.pi / 180,
        "rev": 2 * math.pi,
        "turn": 2 * math.pi,
    },
    "rad/s": {
        "rad/s": 1,
        "deg/s": math.pi / 180,
        "°/s": math.pi / 180,
        "rpm": 2 * math.pi / 60,
        "rev/s": 2 * math.pi,
    },
    "rad/s^2": {"rad/s^2": 1, "deg/s^2": math.pi / 180},
    "m/s^2": {"m/s^2": 1},
    "m": {"m": 1, "mm": 1e-3, "um": 1e-6, "µm": 1e-6},
    "m/s": {"m/s": 1, "mm/s": 1e-3},
    "V": {"V": 1, "mV": 1e-3},
    "A": {"A": 1, "mA": 1e-3},
    "N m": {
        "N m": 1,
        "Nm": 1,
        "N*m": 1,
        "N·m": 1,
        "mN m": 1e-3,
        "mNm": 1e-3,
        "mN*m": 1e-3,
        "N cm": 1e-2,
        "Ncm": 1e-2,
    },
    "N": {"N": 1, "mN": 1e-3},
    "degC": {"degC": 1, "°C": 1},
    "1": {"1": 1, "-": 1, "%": 1e-2},
}
_TO_SI = {spelling: (si, factor) for si, group in _SPELLINGS.items() for spelling, factor in group.items()}

# Stem of a channel's name -> the SI units that it may have; metres and newtons are for linear axes.
_KINDS: dict[str, tuple[str, ...]] = {
    "u": ("V",),
    "supply": ("V",),
    "duty": ("1",),
    "gain": ("1",),
    "enable": ("1",),
    "goal": ("rad", "m"),
    "tau": ("N m", "N"),
    "tau_a": ("N m", "N"),
    "i": ("A",),
    "q_m": ("rad", "m"),
    "q_a": ("rad", "m"),
    "v_m": ("rad/s", "m/s"),
    "v_a": ("rad/s", "m/s"),
    "temperature": ("degC",),
    "t": ("s",),
}


def stem(channel: str) -> str:
    """Return a channel's name without the number of its joint: `q_m1` -> `q_m`."""
    return re.sub(r"\d+$", "", channel)


def number_of(channel: str) -> str:
    """The number that a channel's name ends with, that of its joint: `q_m1` -> `1`."""
    return channel[len(stem(channel)) :]


def spellings() -> list[str]:
    """Every unit that files may come in, as it is written there."""
    return list(_TO_SI)


def to_si(unit: str, channel: str) -> tuple[str, float]:
    """Return the SI unit of a channel and the factor that brings values in `unit` to it.

    Args:
        unit: A spelling found in files, `deg`, `rpm`, `mN m`.
        channel: Name of the channel, `t` for time; it decides which kind of unit makes sense.

    Raises:
        InputError: when the unit is unknown, or of another kind than the channel.
    """
    kinds = _KINDS.get(stem(channel), tuple(_SPELLINGS))
    known = [spelling for kind in kinds for spelling in _SPELLINGS[kind]]
    if unit not in _TO_SI or _TO_SI[unit][0] not in kinds:
        raise InputError(f"unit '{unit}' does not fit '{channel}'; give one of: {', '.join(known)}")
    return _TO_SI[unit]
