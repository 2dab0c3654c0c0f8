"""JSON logs of Rhoban's BAM bench: a Dynamixel servo that runs its own position loop and carries a pendulum.

Source: github.com/Rhoban/bam; Duclusaud et al., "Extended friction models for the physics simulation of servo
actuators", ICRA 2025, arXiv 2410.08650. One object with header keys (`mass` kg, `length` m, `kp`, `vin` V,
`trajectory`) and `entries`, one a sample.

| column | from | unit |
| --- | --- | --- |
| `t` | `timestamp` | s |
| `goal1` | `goal_position` | rad |
| `gain1` | header `kp`, the firmware's position gain | 1 |
| `duty1` | `load`: the present PWM as unsigned 16-bit count; less 65536 above 32767, over 885 | 1 |
| `supply1` | `input_volts` | V |
| `enable1` | `torque_enable`, 1 on and 0 off (the motor's terminals are open) | 1 |
| `q_m1` | `position`, 0 = hanging | rad |
| `v_m1` | `speed` | rad/s |
| `temperature1` | `temp` | degC |
"""

import gzip
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import parse_json, read_bytes
from hybrid_id.records.readers.table import Table, parsing, require_columns

FULL_DUTY = 885  # counts of the PWM register at 100 %
LARGEST = 1e300
_MOST_BYTES = 500_000_000
_KEYS = {
    "t": "timestamp",
    "goal1": "goal_position",
    "duty1": "load",
    "supply1": "input_volts",
    "enable1": "torque_enable",
    "q_m1": "position",
    "v_m1": "speed",
    "temperature1": "temp",
}


def read_bam(path: Path, wanted: Collection[str]) -> Table:
    """Read the wanted columns of a BAM log; `meta` holds its header and the mean of a logged temperature [degC].

    Raises:
        InputError: for a damaged file, another layout, or an entry that lacks a number.
    """
    header = _load(path)
    entries = header.pop("entries")
    meta = {
        key: float(value) if isinstance(value, bool) else value
        for key, value in header.items()
        if isinstance(value, str | int | float)
    }
    heat = [e["temp"] for e in entries if isinstance(e, dict) and isinstance(e.get("temp"), int | float)]
    if len(heat) == len(entries):
        meta["temperature1"] = float(np.mean(heat))
    names = [name for name, key in _KEYS.items() if key in entries[0]]
    require_columns(path, wanted, [*names, "gain1"] if "kp" in meta else names)
    columns = {}
    for name in wanted:
        values = np.full(len(entries), meta["kp"]) if name == "gain1" else _column(path, entries, _KEYS[name])
        if name == "duty1":
            values = np.where(values > 32767, values - 65536, values) / FULL_DUTY
        columns[name] = values
    return Table(path, columns, lambda k: f"entry {k + 1}", meta)


def bam_names(path: Path) -> list[str]:
    """Names of the columns that a BAM log has."""
    log = _load(path)
    names = [name for name, key in _KEYS.items() if key in log["entries"][0]]
    return [*names, "gain1"] if "kp" in log else names


def _load(path: Path) -> dict[str, Any]:
    """Read the JSON object and check its outer layout."""
    with parsing(path, "BAM log"):
        raw = read_bytes(path, _MOST_BYTES, "BAM log")
        log = parse_json(gzip.decompress(raw) if path.suffix == ".gz" else raw, path)
    entries = log.get("entries") if isinstance(log, dict) else None
    if not isinstance(entries, list) or not entries or not isinstance(entries[0], dict):
        raise InputError(f"{path} is no BAM log: it needs a list 'entries' of samples; give its 'format'")
    if not isinstance(log.get("kp", 0), int | float):
        raise InputError(
            f"{path}: header key 'kp' is {str(log['kp'])[:40]!r}; give the firmware's gain as a number"
        )
    return log


def _column(path: Path, entries: list[Any], key: str) -> np.ndarray:
    """Gather one key of every entry, (T,)."""
    try:
        return np.array([float(entry[key]) for entry in entries])
    except (KeyError, TypeError, ValueError, OverflowError):
        for k, entry in enumerate(entries, start=1):
            value = entry.get(key) if isinstance(entry, dict) else None
            if not isinstance(value, int | float) or abs(value) > LARGEST:
                found = "missing" if value is None else f"{str(value)[:40]!r}, no number that a sensor reads"
                raise InputError(f"{path}, entry {k}: key '{key}' is {found}; remove the entry") from None
        raise
