"""Long-run covariance: the covariance of the sum of a correlated series."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

_CHUNKS = 300  # a record is summed in about so many chunks first: shorter correlations are inside one
_LARGEST_ORDER = 12


def long_run_covariance(series: Sequence[np.ndarray]) -> tuple[np.ndarray, int]:
    """Covariance of ``Σ_records Σ_t s_t`` for scores that may be autocorrelated; records are independent.

    Chunks are summed; each column is whitened by an autoregression whose order Akaike's criterion chooses (den
    Haan and Levin, "A practitioner's guide to robust covariance matrix estimation", Handbook of Statistics 15, 1997);
    what correlation is left goes through a Bartlett kernel (Newey and West, Econometrica 55, 1987, with the lag
    of their Rev. Econ. Stud. 61, 1994). High orders are needed: an oscillating sensitivity times a slow residual is
    an oscillation, which a first-order filter mistakes for a trend.

    Args:
        series: Scores of each record, [(T, p)], each column of mean zero.

    Returns:
        Covariance (p, p), and the reach of the correlation that it counts, in samples.
    """
    if not series[0].shape[1]:  # the records tell nothing
        return np.zeros((0, 0)), 0
    chunk = max(max(len(s) for s in series) // _CHUNKS, 1)
    sums = [np.add.reduceat(s, np.arange(0, len(s), chunk)) for s in series]
    size = np.sqrt(np.sum([np.sum(s**2, axis=0) for s in sums], axis=0))
    size = np.where(size > 0, size, 1.0)  # columns may differ by decades
    sums = [s / size for s in sums]
    count = sum(len(s) for s in sums)

    largest = min(_LARGEST_ORDER, max(len(s) for s in sums) // 5)  # a short record among long ones tells less
    correlation = np.stack([np.diag(_lagged_products(sums, k)) for k in range(largest + 1)])
    filters = [_whitening_filter(column, count) for column in correlation.T]
    white = [
        np.stack([lfilter(f, 1.0, s[:, k]) for k, f in enumerate(filters)], axis=1)[largest:] for s in sums
    ]
    lag = _newey_west_lag(white)
    total = _lagged_products(white, 0)
    for k in range(1, lag + 1):
        term = _lagged_products(white, k)
        total = total + (1 - k / (lag + 1)) * (term + term.T)
    recolour = size / np.array([f.sum() for f in filters])
    total = total * np.outer(recolour, recolour) * count / sum(len(w) for w in white)
    return total, chunk * (lag + max(len(f) for f in filters) - 1)


def lag_one_correlation(series: Sequence[np.ndarray]) -> np.ndarray:
    """First autocorrelation of each column, pooled over the records [(T, p)] -> (p,)."""
    products = np.sum([np.sum(s[1:] * s[:-1], axis=0) for s in series], axis=0)
    squares = np.sum([np.sum(s[:-1] ** 2, axis=0) for s in series], axis=0)
    return products / np.where(squares > 0, squares, 1.0)


def _lagged_products(series: Sequence[np.ndarray], lag: int) -> np.ndarray:
    """``Σ_t s_t s_{t-lag}ᵀ`` summed over the records (p, p)."""
    return np.sum([s[min(lag, len(s)) :].T @ s[: max(len(s) - lag, 0)] for s in series], axis=0)


def _whitening_filter(correlation: np.ndarray, count: int) -> np.ndarray:
    """``1 - a_1 z⁻¹ - … `` of the best order from autocovariances (order + 1,) by the Yule-Walker equations."""
    best, best_criterion = np.ones(1), 0.0
    for order in range(1, len(correlation) if correlation[0] > 0 else 1):
        a = solve_toeplitz(correlation[:order], correlation[1 : order + 1])
        left = max(1 - a @ correlation[1 : order + 1] / correlation[0], 1e-12)
        criterion = count * np.log(left) + 2 * order
        if criterion < best_criterion:
            best, best_criterion = np.concatenate([[1.0], -a]), criterion
    return best


def _newey_west_lag(series: Sequence[np.ndarray]) -> int:
    longest = max(len(s) for s in series)
    pilot = min(int(4 * (longest / 100) ** (2 / 9)), longest - 1)
    traces = np.array([np.trace(_lagged_products(series, k)) for k in range(pilot + 1)])
    flat = traces[0] + 2 * traces[1:].sum()
    slope = 2 * np.sum(np.arange(1, pilot + 1) * traces[1:])
    if flat <= 0:
        return pilot
    return int(min(1.1447 * np.cbrt((slope / flat) ** 2 * longest), longest // 4))
