"""What stages and closed loops end with, as files that a later run reads again."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id import __version__
from hybrid_id.errors import InputError
from hybrid_id.reading import read_object
from hybrid_id.records.files import plain, write_whole


@dataclass(frozen=True, eq=False)
class StageResult:
    """One stage: n sets of p parameters, s signals.

    Attributes:
        title: of the stage.
        names: estimated parameters (p).
        units: theirs.
        values: estimates ``(n, p)``.
        truths: of each set's own run ``(n, p)``; nan for what the machine does not have.
        std_error: of each set, its records alone ``(n, p)``; inf where no interval may be claimed.
        covariance: of the selected set ``(p, p)``.
        held_error: what the uncertainty of held parameters adds to the selected set's standard errors ``(p,)``.
        by_prior: names that a prior holds.
        held: parameters that an earlier stage or the data sheet holds, and their values.
        predicted_std: relative standard error that the check predicts from the selected set's record ``(p,)``.
        words: what the check says of the records' limits.
        signals: replayed signals (s).
        fits: fit % of every set on every record ``(n, n, s)``.
        truth_fits: fit % of the selected run's true parameters on every record ``(n, s)``.
        selected: index of the selected set.
        failed: sets that did not converge, and why.
        seconds: time of the fit.
    """

    title: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    truths: np.ndarray
    std_error: np.ndarray
    covariance: np.ndarray
    held_error: np.ndarray
    by_prior: tuple[str, ...]
    held: dict[str, float]
    predicted_std: np.ndarray
    words: tuple[str, ...]
    signals: tuple[str, ...]
    fits: np.ndarray
    truth_fits: np.ndarray
    selected: int
    failed: tuple[str, ...]
    seconds: float

    @property
    def percent(self) -> np.ndarray:
        """std/mean of each parameter over the sets [%], ``(p,)``."""
        return 100 * self.values.std(0, ddof=1) / np.abs(self.values.mean(0))

    @property
    def interval(self) -> np.ndarray:
        """Half-width of the selected set's 95 % intervals, held parameters' part included, ``(p,)``."""
        return 1.96 * np.hypot(self.std_error[self.selected], self.held_error)


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """Closed loops of m models, j joints, n seeds.

    Attributes:
        models: their names.
        time: ``(T,)`` s.
        desired: joint angles ``(T, j)`` rad.
        angle: of the first seed ``(T, j, m)`` rad.
        voltage: of the first seed ``(T, j, m)`` V.
        rms: ``(m, j, n)`` rad.
        peak: ``(m, j, n)`` rad.
        saturated: share of samples at the limit, ``(m, j, n)``.
    """

    models: tuple[str, ...]
    time: np.ndarray
    desired: np.ndarray
    angle: np.ndarray
    voltage: np.ndarray
    rms: np.ndarray
    peak: np.ndarray
    saturated: np.ndarray


def save(result: StageResult | TrackingResult, path: Path, key: dict[str, Any]) -> None:
    """Write a result with what it was made from, under a temporary name first."""
    content = plain({"program": f"hybrid_id {__version__}", "key": key, "result": asdict(result)})
    write_whole(path, json.dumps(content))


def load(kind: type[Any], path: Path, key: dict[str, Any]) -> Any:
    """The result in a file; None where there is none, or where it was made from something else."""
    try:
        content = read_object(path, "result of a stage")
        if content["key"] != json.loads(json.dumps(key)):
            return None
        values = content["result"]
        found = {f.name: _read(values[f.name], str(f.type)) for f in fields(kind)}
        if "std_error" in found:  # where no interval may be claimed it is infinite, which JSON cannot say
            found["std_error"] = np.nan_to_num(found["std_error"], nan=np.inf)
        return kind(**found)
    except (OSError, InputError, ValueError, KeyError, TypeError):
        return None


def _read(value: Any, kind: str) -> Any:
    if kind == "np.ndarray":
        return np.array(value, dtype=float)
    return tuple(value) if kind.startswith("tuple") else value
