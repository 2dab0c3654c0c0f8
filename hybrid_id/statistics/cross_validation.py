"""Cross-validation matrix: every parameter set simulates every record (paper, III.B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.errors import InputError


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """Fits in % of set i on record j.

    Attributes:
        fits: (n_sets, n_records, n_signals); -inf where the simulation diverged.
        set_names, record_names, signal_names: What the axes stand for.
        own_record: (n_sets,) int; the record that a set was estimated from, -1 for none.
    """

    fits: np.ndarray
    set_names: tuple[str, ...]
    record_names: tuple[str, ...]
    signal_names: tuple[str, ...]
    own_record: np.ndarray

    def matrix(self, signal: str | None = None) -> np.ndarray:
        """Fits of one signal, or averaged over the signals, (n_sets, n_records)."""
        if signal is None:
            # A constant signal has no fit (nan); the others stand for the record.
            known = ~np.isnan(self.fits)
            total = np.where(known, self.fits, 0.0).sum(axis=2)
            return np.where(known.any(axis=2), total / np.maximum(known.sum(axis=2), 1), np.nan)
        return self.fits[:, :, self.signal_names.index(signal)]

    def other_records(self, signal: str | None = None) -> np.ndarray:
        """The matrix with nan for the record that a set was estimated from: fits on records unseen."""
        matrix = self.matrix(signal).copy()
        own = np.flatnonzero(self.own_record >= 0)
        matrix[own, self.own_record[own]] = np.nan
        return matrix

    def summary(self) -> str:
        """The matrix, averaged over the signals, with mean and std over the records."""
        matrix = self.matrix()
        width = max(map(len, self.set_names))
        lines = [f"fit % of set (row) on record (column), mean of {', '.join(self.signal_names)}"]
        lines += [
            f"{'':{width}}  " + " ".join(f"{name[-7:]:>7}" for name in self.record_names) + "    mean    std"
        ]
        for name, row in zip(self.set_names, matrix, strict=True):
            finite = row if np.all(np.isfinite(row)) else np.full(1, np.nan)
            values = " ".join(f"{fit:7.2f}" for fit in row)
            lines.append(f"{name:{width}}  {values} {finite.mean():7.2f} {_std(finite):6.2f}")
        return "\n".join(lines)


def cross_validation(
    fits: np.ndarray,
    *,
    set_names: Sequence[str] = (),
    record_names: Sequence[str] = (),
    signal_names: Sequence[str] = (),
    own_record: Sequence[int] | None = None,
) -> CrossValidation:
    """Wraps fits that are there already.

    Args:
        fits: (n_sets, n_records, n_signals) in %.
        set_names: Names of the sets; numbers from 1 where absent, as for the next two.
        record_names: Names of the records.
        signal_names: Names of the outputs.
        own_record: Record of each set; by default set i belongs to record i where there are as many.

    Raises:
        InputError: Names or owners do not fit the array.
    """
    fits = np.asarray(fits, float)
    if fits.ndim != 3:
        raise InputError(f"cross-validation: fits have {fits.ndim} axes; give (n_sets, n_records, n_signals)")
    named = []
    for size, names in zip(fits.shape, (set_names, record_names, signal_names), strict=True):
        named.append(tuple(names) or tuple(str(k + 1) for k in range(size)))
        if len(named[-1]) != size:
            raise InputError(f"cross-validation: {len(named[-1])} names for an axis of {size}; give one each")
    square = fits.shape[0] == fits.shape[1]
    default = np.arange(fits.shape[0]) if square else np.full(fits.shape[0], -1)
    owner = default if own_record is None else np.asarray(own_record, int)
    if owner.shape != fits.shape[:1] or np.any(owner >= fits.shape[1]):
        raise InputError("cross-validation: own_record must name one record, or -1, for each set; correct it")
    return CrossValidation(fits, *named, own_record=owner)


def _std(fits: np.ndarray) -> float:
    return float(fits.std(ddof=1)) if fits.size > 1 else float("nan")
