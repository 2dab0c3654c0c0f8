"""Cross-validation matrix, every parameter set on every record, and the set to use (paper, III.B, Table 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

TOLERANCE = 2.0  # points of fit


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Fits in % of set i on record j.

    Attributes:
        fits: (n_sets, n_records, n_signals); -inf where the simulation diverged.
        set_names, record_names, signal_names: What the axes stand for.
        own_record: (n_sets,) the record that a set was estimated from, -1 for none.
    """

    fits: np.ndarray
    set_names: tuple[str, ...]
    record_names: tuple[str, ...]
    signal_names: tuple[str, ...]
    own_record: Sequence[int]

    def matrix(self, signal: str | None = None) -> np.ndarray:
        """Fits of one signal, or averaged over the signals, (n_sets, n_records)."""
        if signal is None:
            # A constant signal has no fit (nan); the others stand for the record.
            known = ~np.isnan(self.fits)
            total = np.where(known, self.fits, 0.0).sum(axis=2)
            return np.where(known.any(axis=2), total / np.maximum(known.sum(axis=2), 1), np.nan)
        return self.fits[:, :, self.signal_names.index(signal)]


@dataclass(frozen=True, eq=False)
class Selection:
    """The set to use, and how it was found.

    Attributes:
        index, name: The selected set.
        paper_index, paper_name: The set that the paper's plain rule selects.
        mean, std, percent: Fit over the records of each set (n_sets,), signals averaged; percent is 100 std / mean.
        candidate: (n_sets,) bool; mean fit within the tolerance of the best.
        reason: Why this set, in words.
    """

    index: int
    name: str
    paper_index: int
    paper_name: str
    mean: np.ndarray
    std: np.ndarray
    percent: np.ndarray
    candidate: np.ndarray
    reason: str

    def summary(self) -> str:
        """The reason, and what the paper's rule says."""
        same = "the paper's plain rule selects the same set"
        other = f"the paper's plain rule would select {self.paper_name} (mean fit {self.mean[self.paper_index]:.2f} %)"
        return f"{self.reason}; {same if self.paper_index == self.index else other}"


def select(matrix: CrossValidation) -> Selection:
    """The set of least std/mean of fit among those whose mean fit is within `TOLERANCE` points of the best.

    Differs from the paper, which takes the least std/mean of all: that rewards a set which is bad everywhere alike.
    Sets that diverge on a record, or fit no better than the mean of the data, are selected only where there is no
    other, and the reason says so.

    Args:
        matrix: Cross-validation matrix; the signals are averaged.
    """
    fits = matrix.matrix()
    diverged = np.any(np.isneginf(fits), axis=1)
    known = np.ma.masked_invalid(fits)  # nan: a record with nothing to explain
    mean = np.where(diverged, -np.inf, known.mean(axis=1).filled(-np.inf))
    std = known.std(axis=1, ddof=1).filled(np.nan)
    usable = mean > 0
    if not np.any(
        usable
    ):  # the one that diverges on the fewest records, then of the best mean fit on the others
        index = int(np.lexsort((-known.mean(axis=1).filled(-np.inf), np.isneginf(fits).sum(axis=1)))[0])
        name = matrix.set_names[index]
        reason = (
            f"no parameter set simulates the records better than their mean, and {name} is the least bad; check the "
            "model"
        )
        percent = np.full(len(mean), np.inf)
        return Selection(index, name, index, name, mean, std, percent, usable, reason)
    percent = np.where(usable, 100 * np.nan_to_num(std) / np.where(usable, mean, 1.0), np.inf)

    candidate = usable & (mean >= mean[usable].max() - TOLERANCE)
    index = int(np.argmin(np.where(candidate, percent, np.inf)))
    paper = int(np.argmin(percent))
    name = matrix.set_names[index]
    reason = (
        f"{name} has the least std/mean of fit, {percent[index]:.2f} %, among the {candidate.sum()} of {len(mean)} "
        f"sets within {TOLERANCE:g} points of the best mean fit; its own is {mean[index]:.2f} %"
    )
    return Selection(index, name, paper, matrix.set_names[paper], mean, std, percent, candidate, reason)
