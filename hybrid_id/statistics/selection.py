"""Selection of the best parameter set from the cross-validation matrix (paper, III.B, Table 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid_id.statistics.cross_validation import CrossValidation

TOLERANCE = 2.0  # points of fit


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


def select(matrix: CrossValidation, *, tolerance: float = TOLERANCE, include_own: bool = True) -> Selection:
    """The set of least std/mean of fit among those whose mean fit is within `tolerance` points of the best.

    Differs from the paper, which takes the least std/mean of all: that rewards a set which is bad everywhere alike.
    Sets that diverge on a record, or fit no better than the mean of the data, are selected only where there is no
    other, and the reason says so.

    Args:
        matrix: Cross-validation matrix; the signals are averaged.
        tolerance: Points of fit.
        include_own: Whether the record that a set was estimated from counts, as in the paper.
    """
    fits = matrix.matrix() if include_own else matrix.other_records()
    diverged = np.any(np.isneginf(fits), axis=1)
    known = np.ma.masked_invalid(fits)  # nan: own record left out, or a record with nothing to explain
    mean = np.where(diverged, -np.inf, known.mean(axis=1).filled(-np.inf))
    std = known.std(axis=1, ddof=1).filled(np.nan)
    usable = mean > 0
    if not np.any(usable):
        return _least_bad(matrix, fits, mean, std)
    percent = np.where(usable, 100 * np.nan_to_num(std) / np.where(usable, mean, 1.0), np.inf)

    candidate = usable & (mean >= mean[usable].max() - tolerance)
    index = int(np.argmin(np.where(candidate, percent, np.inf)))
    paper = int(np.argmin(percent))
    name = matrix.set_names[index]
    reason = (
        f"{name} has the least std/mean of fit, {percent[index]:.2f} %, among the {candidate.sum()} of {len(mean)} "
        f"sets within {tolerance:g} points of the best mean fit; its own is {mean[index]:.2f} %"
    )
    return Selection(index, name, paper, matrix.set_names[paper], mean, std, percent, candidate, reason)


def _least_bad(matrix: CrossValidation, fits: np.ndarray, mean: np.ndarray, std: np.ndarray) -> Selection:
    """The set that diverges on the fewest records, then of the best mean fit on the others."""
    finite = np.ma.masked_invalid(fits)
    rest = finite.mean(axis=1).filled(-np.inf)
    index = int(np.lexsort((-rest, np.isneginf(fits).sum(axis=1)))[0])
    name = matrix.set_names[index]
    fault = "no parameter set simulates the records better than their mean"
    reason = f"{fault}, and {name} is the least bad; check the model"
    none = np.zeros(len(mean), dtype=bool)
    return Selection(index, name, index, name, mean, std, np.full(len(mean), np.inf), none, reason)
