"""Whether the residuals of a fit look like noise: their autocorrelation (Ljung, System Identification, 16.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

LAGS = 100


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of weighted residuals, averaged over the records.

    Attributes:
        lags: 0 .. L, in samples.
        correlation: (L + 1, n_y); 1 at lag 0.
        band: white residuals stay within plus-minus this at a single lag.
        outside: share of the lags above 0 that leave the band, (n_y,).
        level: confidence of the band.
    """

    lags: np.ndarray
    correlation: np.ndarray
    band: float
    outside: np.ndarray
    level: float


def whiteness(residual: Sequence[np.ndarray], *, lags: int = LAGS, level: float = 0.99) -> Whiteness:
    """Autocorrelation ``R(k) = Σ r_t r_{t+k} / Σ r_t²`` and the band of white residuals.

    Args:
        residual: weighted residuals of each record, (T, n_y).
        lags: greatest lag; at most a quarter of the shortest record.
        level: confidence of the band.
    """
    lags = max(1, min(lags, min(len(r) for r in residual) // 4))
    total = np.zeros((lags + 1, residual[0].shape[1]))
    for r in residual:
        for k in range(lags + 1):
            total[k] += np.sum(r[: len(r) - k] * r[k:], axis=0)
    correlation = total / np.where(total[0] > 0, total[0], 1.0)
    band = float(ndtri(0.5 + level / 2) / np.sqrt(sum(len(r) for r in residual)))
    outside = np.mean(np.abs(correlation[1:]) > band, axis=0)
    return Whiteness(np.arange(lags + 1), correlation, band, outside, level)
