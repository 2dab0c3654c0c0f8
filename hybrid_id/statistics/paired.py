"""Paired differences over repeats that share records, and what may be said of their mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from hybrid_id.errors import InputError


@dataclass(frozen=True)
class PairedDifference:
    """Mean of ``first - second`` over pairs, with its interval.

    Attributes:
        mean, lower, upper: of the difference; nan bounds where fewer than two pairs are left.
        std: between the pairs.
        level: confidence.
        n_pairs: pairs in which both values are finite.
    """

    mean: float
    lower: float
    upper: float
    std: float
    level: float
    n_pairs: int


def paired_difference(
    first: np.ndarray, second: np.ndarray, *, overlap: float = 0.0, level: float = 0.95
) -> PairedDifference:
    """Student's interval of the mean difference, corrected for training sets that share records.

    ``var(mean) = (1 / n + overlap) s^2``. Repeats whose training sets are drawn from the same records are not
    independent, and the usual ``s^2 / n`` is too confident by far; with ``overlap`` = 0 this is the paired t-interval.

    Source: C. Nadeau, Y. Bengio, Inference for the Generalization Error, Machine Learning 52, 2003: overlap = records
    tested on over records trained with.

    Args:
        first: values by repeat, ``(n,)``; pairs with a value that is not finite are left out.
        second: those of the same repeats that are subtracted.
        overlap: correction, at least 0.
        level: confidence.

    Raises:
        InputError: values that do not pair up, or a negative overlap.
    """
    a, b = np.asarray(first, float), np.asarray(second, float)
    if a.ndim != 1 or a.shape != b.shape:
        raise InputError(f"values of shapes {a.shape} and {b.shape} are no pairs; give one of each a repeat.")
    if not overlap >= 0.0:
        raise InputError(f"overlap is {overlap}; give a share of at least 0.")
    kept = np.isfinite(a) & np.isfinite(b)
    difference = a[kept] - b[kept]
    n = len(difference)
    if n < 2:
        return PairedDifference(float(difference.mean()) if n else np.nan, np.nan, np.nan, np.nan, level, n)
    mean, std = float(difference.mean()), float(difference.std(ddof=1))
    reach = float(stdtrit(n - 1, 0.5 + level / 2.0)) * std * (1.0 / n + overlap) ** 0.5
    return PairedDifference(mean, mean - reach, mean + reach, std, level, n)
