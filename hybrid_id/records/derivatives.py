"""Value and derivatives of measured signals: by local polynomials, or by the discrete Fourier transform (paper, II.E).

Local polynomials have a window that adapts to the motion. The transform takes a record for one period of a periodic
signal. Where it is not, the step between the last and the first sample, in value, slope and curvature, rings through
the whole derivative. Such a record is split into a cubic polynomial that carries those steps, differentiated by hand,
and a remainder that is periodic with two continuous derivatives (subtraction of the jumps: Krylov; Lanczos, "Discourse
on Fourier series", 1966). What is left of the ringing stays near the ends, and those samples are marked.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import comb, factorial

import numpy as np
from scipy.fft import dst
from scipy.ndimage import convolve1d, median_filter, uniform_filter1d

from hybrid_id.errors import InputError

_DEGREE = 3
_HALF_WINDOWS = (2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48, 64, 88)  # samples
_THRESHOLD = 1.5
_MEDIAN = 15  # samples; windows chosen by one odd sample alone do not count


def noise_level(y: np.ndarray) -> np.ndarray:
    """Standard deviation (...) of white noise on samples (..., T); half the quantum where an encoder is coarser.

    From the median size of fourth differences, which a smooth motion hardly reaches.
    """
    y = np.asarray(y, float)
    scale = 0.6745 * np.sqrt(sum(comb(4, k) ** 2 for k in range(5)))
    spread = np.median(np.abs(np.diff(y, n=4, axis=-1)), axis=-1) / scale
    # Without quantisation the smallest step is far below the noise, so that this changes nothing there.
    return np.maximum(spread, 0.5 * least_step(y)[0])


def least_step(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least step between neighbouring samples (..., T), 0 where none changes, and the share that steps, (...) each.

    Of an encoder that moves slowly the least step is a count.
    """
    steps = np.abs(np.diff(y, axis=-1))
    real = steps > 1e-9 * np.ptp(y, axis=-1, keepdims=True)
    least = np.min(steps, axis=-1, initial=np.inf, where=real)
    return np.where(np.isfinite(least), least, 0.0), real.mean(axis=-1)


def smooth_derivatives(
    y: np.ndarray,
    sample_time: float | np.ndarray,
    noise_std: float | np.ndarray | None = None,
    threshold: float = _THRESHOLD,
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
        threshold: Half-width of the confidence intervals that must intersect, in standard errors: a smaller one leaves
            more noise and takes less of the motion.

    Raises:
        InputError: Fewer than five samples.
    """
    y = np.asarray(y, float)
    n_samples = y.shape[-1]
    if n_samples < 5:
        raise InputError(f"smoothing: {n_samples} samples are too few; give at least 5")
    if np.ndim(sample_time) == 1:
        # the same on stamps (T,) that need not be uniform
        time = np.asarray(sample_time, float)
        step = float(np.median(np.diff(time)))
        uniform = np.linspace(time[0], time[-1], max(round((time[-1] - time[0]) / step) + 1, 5))
        rows = y.reshape(-1, y.shape[-1])
        noise = noise_level(y) if noise_std is None else noise_std
        even = np.stack([np.interp(uniform, time, row) for row in rows])
        smooth = smooth_derivatives(even, step, noise, threshold)
        value, slope, curvature = (
            np.stack([np.interp(time, uniform, row) for row in part]).reshape(y.shape) for part in smooth
        )
        return value, slope, curvature
    step = float(sample_time)
    noise = np.broadcast_to(noise_level(y) if noise_std is None else noise_std, y.shape[:-1])[..., None]

    longest = (n_samples - 1) // 2
    lower, upper = np.full(y.shape, -np.inf), np.full(y.shape, np.inf)
    chosen = np.zeros(y.shape, np.int8)
    half_windows = [h for h in _HALF_WINDOWS if h <= longest]
    for number, half in enumerate(half_windows):
        value, gain = _local_polynomial(y, half)
        reach = threshold * noise * gain
        np.maximum(lower, value - reach, out=lower)
        np.minimum(upper, value + reach, out=upper)
        chosen[lower <= upper] = number  # the intersection only shrinks, so this ends at the last agreement
    chosen = median_filter(chosen, size=(1,) * (y.ndim - 1) + (min(_MEDIAN, n_samples),))

    results = np.empty((3, *y.shape))
    for number, half in enumerate(
        half_windows
    ):  # once more, for all of them of a long record fill the memory
        mine = chosen == number
        for d in range(3 if mine.any() else 0):
            results[d][mine] = _local_polynomial(y, half, d)[0][mine] / step**d
    still = np.ptp(y, axis=-1) == 0.0
    # a speed of rounding alone is a tiny value, which records refuse
    results[0][still], results[1:, still] = y[still], 0.0
    return results[0], results[1], results[2]


def _local_polynomial(y: np.ndarray, half: int, d: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The d-th derivative per sample (..., T) in windows of 2 half + 1, and its gain of noise (T,)."""
    n_samples, weights = y.shape[-1], _weights(half, d)
    fit = convolve1d(y, weights[half][::-1], axis=-1, mode="nearest")
    fit[..., :half] = y[..., : 2 * half + 1] @ weights[:half].T
    fit[..., n_samples - half :] = y[..., n_samples - 2 * half - 1 :] @ weights[half + 1 :].T
    gain = np.full(n_samples, np.linalg.norm(weights[half]))
    gain[:half] = np.linalg.norm(weights[:half], axis=1)
    gain[n_samples - half :] = np.linalg.norm(weights[half + 1 :], axis=1)
    return fit, gain


@cache
def _weights(half: int, d: int) -> np.ndarray:
    """Row k reads the d-th derivative off the polynomial of a window of 2 half + 1 samples at its k-th sample."""
    offset = np.arange(-half, half + 1)
    inverse = np.linalg.pinv(np.vander(offset / half, _DEGREE + 1, increasing=True))
    basis = np.zeros((2 * half + 1, _DEGREE + 1))
    for power in range(d, _DEGREE + 1):
        basis[:, power] = factorial(power) / factorial(power - d) * (offset / half) ** (power - d)
    return basis @ inverse / half**d


_ROLL_OFF = 0.25  # width of the band's soft edges, relative to the edge; a periodic record has sharp ones
_END_WINDOW = 0.75  # samples that tell value, slope and curvature at an end, in periods of f_hi
_SEAM_WINDOW = 0.5  # samples on each side of the seam that tell whether there is a step, in periods
_UNTRUSTED = 2.0  # samples marked at each end, in periods of f_hi
_STANDARD_ERRORS = 4.0  # a step at the seam below that many of its standard errors is noise
_NEGLIGIBLE = 2e-3  # and a step below this share of the signal's spread does no harm
_BERNOULLI = (np.poly1d([1, -1 / 2]), np.poly1d([1, -1, 1 / 6]), np.poly1d([1, -3 / 2, 1 / 2, 0]))


@dataclass(frozen=True, eq=False)
class SpectralResult:
    """Filtered records and their derivatives.

    Attributes:
        position, velocity, acceleration: (..., T), in the record's unit, per s and per s².
        valid: (..., T) bool; False near the ends of records that do not close on themselves.
        periodic: (...) bool; which records were taken for whole periods.
        band: The frequencies that were kept [Hz].
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    valid: np.ndarray
    periodic: np.ndarray
    band: tuple[float, float]


def differentiate(
    y: np.ndarray,
    sample_time: float,
    *,
    band: tuple[float, float] | None = None,
) -> SpectralResult:
    """Filters and differentiates: DFT, unwanted frequencies dropped, times jω, inverse DFT.

    Differs from the paper by the treatment of records that do not hold a whole number of periods: those with a step in
    value or slope, beyond the noise, at the seam where the last samples would be followed by the first ones.

    Args:
        y: Samples (..., T), uniform in time.
        sample_time: [s].
        band: Lowest and highest frequency to keep [Hz]. A lowest frequency above 0 takes mean and trend away.
            By default from 0 to where the spectrum sinks into its noise floor.

    Raises:
        InputError: Too few samples, or a band that the sample time cannot hold.
    """
    y = np.asarray(y, float)
    n_samples = y.shape[-1]
    nyquist = 0.5 / sample_time
    if n_samples < 16:
        raise InputError(f"spectral: {n_samples} samples are too few for a spectrum; give at least 16")
    edge = _noise_edge(y, sample_time)
    lowest, highest = band if band is not None else (0.0, edge)
    if not 0 <= lowest < highest <= nyquist:
        raise InputError(
            f"spectral: band {lowest:g} to {highest:g} Hz is empty or leaves 0 to {nyquist:g} Hz; change it"
        )

    cycle = 1 / (highest * sample_time)  # samples per period of the highest frequency
    seam_cycle = 1 / (max(highest, edge) * sample_time)  # tones above the band must not look like a step
    # whether there is no step in value and slope at the seam (...)
    window = int(np.clip(_SEAM_WINDOW * seam_cycle, 8, n_samples // 2))
    around = np.concatenate([y[..., -window:], y[..., :window]], axis=-1)
    k = (np.arange(2 * window) - window + 0.5) / window
    design = np.column_stack([np.vander(k, 6), k > 0, np.maximum(k, 0)])
    inverse = np.linalg.pinv(design)
    coefficients = around @ inverse.T
    noise = np.sum((around - coefficients @ design.T) ** 2, axis=-1) / (2 * window - design.shape[1])
    step = np.abs(coefficients[..., -2:])
    error = np.sqrt(noise)[..., None] * np.linalg.norm(inverse[-2:], axis=1)
    harmless = _NEGLIGIBLE * np.stack([np.std(y, axis=-1), window * np.std(np.diff(y), axis=-1)], axis=-1)
    whole = np.all(step <= _STANDARD_ERRORS * error + harmless, axis=-1)
    # value, slope and curvature one sample after the end, less those at the start (3, ...)
    window = int(np.clip(_END_WINDOW * cycle, 8, n_samples // 2))
    length = (window - 1) * sample_time
    inverse = np.linalg.pinv(np.vander(np.linspace(0, 1, window), 4, increasing=True))[:3]
    to_derivatives = inverse * np.array([[1.0], [1 / length], [2 / length**2]])
    start = y[..., :window] @ to_derivatives.T
    end = y[..., : -window - 1 : -1] @ (to_derivatives * np.array([[1.0], [-1.0], [1.0]])).T
    ahead = np.array([[1, sample_time, sample_time**2 / 2], [0, 1, sample_time], [0, 0, 1]])
    jumps = np.moveaxis(end @ ahead.T - start, -1, 0)
    jumps = np.where(whole, 0.0, jumps)  # (3, ...)

    record_time = n_samples * sample_time
    phase = np.arange(n_samples) / n_samples
    trends = [np.zeros_like(y) for _ in range(3)]
    for order, (jump, bernoulli) in enumerate(zip(jumps, _BERNOULLI, strict=True)):
        for d in range(3):
            shape = bernoulli.deriv(d)(phase) * record_time ** (order - d) / factorial(order + 1)
            trends[d] += jump[..., None] * shape

    frequency = np.fft.rfftfreq(n_samples, sample_time)
    soft, sharp = _low_pass(frequency, highest, _ROLL_OFF), _low_pass(frequency, highest, 0.0)
    sharp = sharp * (frequency >= lowest * (1 - 1e-9))
    spectrum = np.fft.rfft(y - trends[0]) * np.where(whole[..., None], sharp, soft)
    derivatives = [
        np.fft.irfft(spectrum * (2j * np.pi * frequency) ** d, n_samples) + trends[d] for d in range(3)
    ]
    if lowest > 0 and not np.all(whole):
        slow = _slow_part(derivatives[0], sample_time, lowest)
        derivatives = [x - np.where(whole[..., None], 0.0, s) for x, s in zip(derivatives, slow, strict=True)]

    margin = min(int(np.ceil(_UNTRUSTED * cycle)), n_samples // 2)
    if lowest > 0:
        margin = min(max(margin, int(np.ceil(1 / (lowest * sample_time)))), n_samples // 2)
    inside = (np.arange(n_samples) >= margin) & (np.arange(n_samples) < n_samples - margin)
    valid = whole[..., None] | inside
    return SpectralResult(*derivatives, valid=valid, periodic=whole, band=(lowest, highest))


def _low_pass(frequency: np.ndarray, edge: float, roll_off: float) -> np.ndarray:
    """1 up to the edge, then a raised-cosine fall to 0 of relative width `roll_off`."""
    width = max(roll_off, 1e-9) * edge
    return np.sin(np.pi / 2 * np.clip((edge + width - frequency) / width, 0, 1)) ** 2


def _slow_part(y: np.ndarray, sample_time: float, edge: float) -> list[np.ndarray]:
    """Content below the edge and its first two derivatives, each (..., T): a line and a few sines.

    The record less the line through its ends, reflected oddly at both, has no step in value and slope.
    """
    n_samples = y.shape[-1]
    record_time = (n_samples - 1) * sample_time
    phase = np.linspace(0, 1, n_samples)
    slope = (y[..., -1:] - y[..., :1]) / record_time
    line = y[..., :1] + slope * record_time * phase
    count = min(int(np.ceil(2 * record_time * edge)), n_samples - 2)
    omega = np.pi * np.arange(1, count + 1) / record_time
    sines = np.asarray(dst((y - line)[..., 1:-1], type=1))[..., :count] / (n_samples - 1)
    sines = sines * _low_pass(omega / (2 * np.pi), edge / (1 + _ROLL_OFF), _ROLL_OFF)
    angle = np.outer(omega * record_time, phase)
    return [
        line + sines @ np.sin(angle),
        slope + (sines * omega) @ np.cos(angle),
        -(sines * omega**2) @ np.sin(angle),
    ]


def _noise_edge(y: np.ndarray, sample_time: float) -> float:
    """Highest frequency whose power stands above the noise floor of the upper half of the spectrum [Hz]."""
    n_samples = y.shape[-1]
    trend = np.linspace(0, 1, n_samples) * (y[..., -1:] - y[..., :1]) + y[..., :1]
    power = np.abs(np.fft.rfft((y - trend) * np.hanning(n_samples))) ** 2
    power = np.asarray(uniform_filter1d(power, 5, axis=-1))
    floor = np.median(power[..., power.shape[-1] // 2 :], axis=-1, keepdims=True)
    above = np.flatnonzero(np.any(power > 10 * floor, axis=tuple(range(y.ndim - 1))))
    last = above[-1] if len(above) else 1
    return float(np.clip(1.25 * last / n_samples, 4 / n_samples, 0.4) / sample_time)
