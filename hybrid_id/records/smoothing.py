"""Local polynomial smoothing of records: value and two derivatives, with a window that adapts to the motion."""

from __future__ import annotations

from math import comb, factorial

import numpy as np
from scipy.ndimage import convolve1d, median_filter

from hybrid_id.errors import InputError

_DEGREE = 3
_HALF_WINDOWS = (2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48, 64, 88)  # samples
_THRESHOLD = 1.5  # half-width of the confidence intervals that must intersect, in standard errors
_MEDIAN = 15  # samples; windows chosen by one odd sample alone do not count


def noise_level(y: np.ndarray) -> np.ndarray:
    """Standard deviation (...) of white noise on samples (..., T); half the quantum where an encoder is coarser.

    From the median size of fourth differences, which a smooth motion hardly reaches.
    """
    y = np.asarray(y, float)
    scale = 0.6745 * np.sqrt(sum(comb(4, k) ** 2 for k in range(5)))
    spread = np.median(np.abs(np.diff(y, n=4, axis=-1)), axis=-1) / scale
    # Without quantisation the smallest step is far below the noise, so that this changes nothing there.
    steps = np.abs(np.diff(y, axis=-1))
    real = steps > 1e-9 * np.ptp(y, axis=-1, keepdims=True)
    quantum = np.min(steps, axis=-1, initial=np.inf, where=real)
    return np.maximum(spread, np.where(np.isfinite(quantum), 0.5 * quantum, 0.0))


def smooth_derivatives(
    y: np.ndarray, sample_time: float | np.ndarray, noise_std: float | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, first and second derivative of noisy samples, each (..., T).

    Cubic polynomials in sliding windows (Savitzky and Golay, 1964), at each sample with the longest window whose
    value agrees with those of all shorter ones within the noise (intersection of confidence
    intervals: Goldenshluger and Nemirovski, 1997; Katkovnik, 1999): long at rest and in slow motion, short at
    reversals and impacts. Near the ends the polynomial of the first or last window is read off beside its middle.

    Args:
        y: Samples (..., T), T >= 5.
        sample_time: [s], or the stamps (T,) [s]; stamps that are not uniform go through linear interpolation.
        noise_std: Standard deviation of the noise on y, (...) or one for all; estimated where absent.

    Raises:
        InputError: Fewer than five samples.
    """
    y = np.asarray(y, float)
    n_samples = y.shape[-1]
    if n_samples < 5:
        raise InputError(f"smoothing: {n_samples} samples are too few; give at least 5")
    if np.ndim(sample_time) == 1:
        return _on_stamps(y, np.asarray(sample_time, float), noise_std)
    step = float(sample_time)
    noise = np.broadcast_to(noise_level(y) if noise_std is None else noise_std, y.shape[:-1])[..., None]

    longest = (n_samples - 1) // 2
    lower, upper = np.full(y.shape, -np.inf), np.full(y.shape, np.inf)
    chosen = np.zeros(y.shape, int)
    half_windows = [h for h in _HALF_WINDOWS if h <= longest]
    fits = []
    for number, half in enumerate(half_windows):
        fit = _local_polynomial(y, half)
        reach = _THRESHOLD * noise * fit[1]
        lower = np.maximum(lower, fit[0][0] - reach)
        upper = np.minimum(upper, fit[0][0] + reach)
        chosen[lower <= upper] = number  # the intersection only shrinks, so this ends at the last agreement
        fits.append(fit[0])
    chosen = median_filter(chosen, size=(1,) * (y.ndim - 1) + (min(_MEDIAN, n_samples),))

    results = np.empty((3, *y.shape))
    for number, fit in enumerate(fits):
        mine = chosen == number
        for d in range(3):
            results[d][mine] = fit[d][mine] / step**d
    return results[0], results[1], results[2]


def _local_polynomial(y: np.ndarray, half: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Derivatives per sample [(..., T)] * 3 in windows of 2 half + 1, and the value's gain of noise (T,)."""
    n_samples = y.shape[-1]
    offset = np.arange(-half, half + 1)
    inverse = np.linalg.pinv(np.vander(offset / half, _DEGREE + 1, increasing=True))
    gain = np.full(n_samples, np.linalg.norm(inverse[0]))
    results = []
    for d in range(3):
        # Row k reads the d-th derivative off the window's polynomial at its k-th sample.
        basis = np.zeros((2 * half + 1, _DEGREE + 1))
        for power in range(d, _DEGREE + 1):
            basis[:, power] = factorial(power) / factorial(power - d) * (offset / half) ** (power - d)
        weights = basis @ inverse / half**d
        fit = convolve1d(y, weights[half][::-1], axis=-1, mode="nearest")
        fit[..., :half] = y[..., : 2 * half + 1] @ weights[:half].T
        fit[..., n_samples - half :] = y[..., n_samples - 2 * half - 1 :] @ weights[half + 1 :].T
        if d == 0:
            gain[:half] = np.linalg.norm(weights[:half], axis=1)
            gain[n_samples - half :] = np.linalg.norm(weights[half + 1 :], axis=1)
        results.append(fit)
    return results, gain


def _on_stamps(
    y: np.ndarray, time: np.ndarray, noise_std: float | np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same on stamps (T,) that need not be uniform."""
    step = float(np.median(np.diff(time)))
    uniform = np.linspace(time[0], time[-1], max(round((time[-1] - time[0]) / step) + 1, 5))
    rows = y.reshape(-1, y.shape[-1])
    noise = noise_level(y) if noise_std is None else noise_std
    smooth = smooth_derivatives(np.stack([np.interp(uniform, time, row) for row in rows]), step, noise)
    value, slope, curvature = (
        np.stack([np.interp(time, uniform, row) for row in part]).reshape(y.shape) for part in smooth
    )
    return value, slope, curvature
