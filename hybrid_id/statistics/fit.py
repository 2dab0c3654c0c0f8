"""Goodness of fit of simulated against measured outputs (paper, III.B)."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from hybrid_id.records.derivatives import least_step

NOW_AND_THEN = 0.5
"""Share of samples that step up to which the least step of a signal is a count of its encoder."""


def nrmse(measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Normalised error ``‖y - ŷ‖ / ‖y - mean y‖`` over the last axis.

    Args:
        measured: y, (..., T).
        simulated: ŷ, (..., T); leading axes broadcast, so many simulations may face one measurement.

    Returns:
        (...): 0 for a perfect simulation, 1 for one that is as good as the mean; +inf for a simulation that
        diverged (a value that is not finite), nan where the measurement is constant, or stays within a count of its
        encoder, and there is nothing to explain.
    """
    y, simulated = np.asarray(measured, float), np.asarray(simulated, float)
    spread = np.linalg.norm(y - y.mean(axis=-1, keepdims=True), axis=-1)
    # Rounding leaves a constant signal with a spread of about its size times 1e-16.
    constant = spread <= 1e-12 * np.linalg.norm(y, axis=-1)
    count, share = least_step(y)
    constant |= (share < NOW_AND_THEN) & (spread <= count * y.shape[-1] ** 0.5)
    diverged = ~np.all(np.isfinite(simulated), axis=-1)
    with np.errstate(over="ignore"):  # on its way to infinity
        error = np.linalg.norm(np.where(np.isfinite(simulated), simulated, 0.0) - y, axis=-1)
    ratio = np.where(diverged, np.inf, error / np.where(constant, 1.0, spread))
    return np.where(constant, np.nan, ratio)


def rmse(measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Root mean square error over the last axis, in the signals' unit; +inf for a simulation that diverged.

    Args:
        measured: y, (..., T).
        simulated: ŷ, (..., T).

    Returns:
        (...).
    """
    error = np.asarray(simulated, float) - np.asarray(measured, float)
    finite = np.isfinite(error).all(axis=-1)
    with np.errstate(over="ignore"):
        return np.where(finite, np.sqrt(np.mean(np.square(np.nan_to_num(error)), axis=-1)), np.inf)


def known_mean(values: Iterable[float]) -> float:
    """Mean of errors without those of outputs that stand still, which are NaN; NaN where no other is left."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else math.nan


def fit_percent(measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """Fit ``100 (1 - ‖y - ŷ‖ / ‖y - mean y‖)`` in % over the last axis; -inf for a simulation that diverged."""
    return 100.0 * (1.0 - nrmse(measured, simulated))
