"""Multisine excitation of least crest factor (paper, II.D: sums of sines of least crest factor)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hybrid_id.errors import InputError

_SEARCH_POINTS = 16  # grid points per period of the highest tone while optimising
_PEAK_POINTS = 64  # and for the peak that is reported
_SEARCH_POWERS = (4, 16, 64, 256)
_REFINE_POWERS = (16, 32, 64, 128, 256, 512, 1024, 2048)
TONES = 20
"""Tones of a multisine, unless another number is given or the band holds fewer."""
STARTS = 150
"""Phase sets that a search starts from, unless another number is given."""


@dataclass(frozen=True, eq=False)
class Multisine:
    """A designed excitation ``u(t) = offset + Σ a_k cos(2π f_k t + φ_k)``.

    Attributes:
        time: Sample instants (T,) [s].
        signal: The signal at those instants (T,), in the unit of the amplitude limits.
        frequencies: Tones (K,) [Hz], multiples of 1 / period.
        amplitudes, phases: Amplitude and phase [rad] of each tone (K,).
        offset: Middle of the amplitude limits.
        period: The signal repeats after this time [s].
        crest_factor: Peak / RMS of the alternating part; the peak is a bound for all times.
        peak: That bound on |u - offset|.
        message: What was designed, and what limited the amplitude.
    """

    time: np.ndarray
    signal: np.ndarray
    frequencies: np.ndarray
    amplitudes: np.ndarray
    phases: np.ndarray
    offset: float
    period: float
    crest_factor: float
    peak: float
    message: str

    def at(self, time: np.ndarray, derivative: int = 0) -> np.ndarray:
        """The continuous-time signal, or a derivative of it, at any instants (T,) [s]."""
        rates = 2 * np.pi * self.frequencies
        angle = np.multiply.outer(np.asarray(time, float), rates) + self.phases + 0.5 * np.pi * derivative
        return (0.0 if derivative else self.offset) + np.cos(angle) @ (self.amplitudes * rates**derivative)


def schroeder_phases(powers: np.ndarray) -> np.ndarray:
    """Phases of low crest factor for tones of given relative powers (K,) [rad].

    ``φ_k = -2π Σ_{j<k} (k - j) p_j`` with Σ p_j = 1 (Schroeder, IEEE Trans. Inf. Theory 16, 1970); for equal
    powers this is ``-π k (k - 1) / K``. Crest factor about 1.77 for 20 flat tones.
    """
    share = np.asarray(powers, float) / np.sum(powers)
    return -2 * np.pi * np.concatenate(([0.0], np.cumsum(np.cumsum(share))[:-1]))


def design_multisine(
    band: tuple[float, float],
    *,
    sample_time: float,
    duration: float,
    amplitude_limits: float | tuple[float, float],
    tones: int | None = None,
    spectrum: Literal["flat", "flat rate"] = "flat",
    predicted: Sequence[tuple[Callable[[np.ndarray], np.ndarray], float]] = (),
    starts: int = STARTS,
    seed: int = 0,
) -> Multisine:
    """Designs a multisine of least crest factor that fills its amplitude limits.

    The phases minimise the peak through a sequence of 2p-norms, p rising, each solved by Levenberg-Marquardt,
    after Guillaume, Schoukens, Pintelon and Kollár, "Crest-factor minimization using nonlinear Chebyshev
    approximation methods", IEEE Trans. Instrum. Meas. 40(6), 1991. Differs from the source by starting from
    several random phase sets beside Schroeder's, because the problem has many local minima.

    Args:
        band: Lowest and highest frequency [Hz]; the tones are spread evenly over it.
        sample_time: Sample time of the signal [s].
        duration: Length of the signal [s]; it holds a whole number of periods.
        amplitude_limits: Peak, or (lowest, highest) value of the signal.
        tones: Number of tones spread over the band; None for :func:`usual_tones`.
        spectrum: "flat", or "flat rate" for amplitudes as 1 / f.
        predicted: Pairs (response, peak): a linear response ``G(f)`` of the robot, frequencies (K,) [Hz] to
            complex gain (K,), and the peak that ``G u`` (say, the speed) must not exceed. Peaks of input
            and responses are minimised together, each relative to its limit.
        starts: Number of phase sets that the search starts from, Schroeder's and random ones.
        seed: Seed of the random ones.

    Raises:
        InputError: The tones do not fit into the duration or the sample time, or a limit is not positive.
    """
    n_samples = round(duration / sample_time) if sample_time > 0 else 0
    if n_samples < 2:
        raise InputError(f"excitation: duration {duration:g} s holds no two samples; lengthen it")
    period = n_samples * sample_time
    harmonics = _harmonics(band, usual_tones(band, period) if tones is None else tones, period, sample_time)
    relative = np.ones(len(harmonics)) if spectrum == "flat" else harmonics[0] / harmonics
    if not isinstance(amplitude_limits, tuple):
        amplitude_limits = (-amplitude_limits, amplitude_limits)
    lowest, highest = amplitude_limits
    limits = np.array([(highest - lowest) / 2, *(peak for _, peak in predicted)])
    if not np.all(np.isfinite(limits) & (limits > 0)):
        raise InputError("excitation: an amplitude limit is not finite or leaves no range; raise it")

    tone_frequencies = harmonics / period
    amplitudes = relative / np.sqrt(np.sum(relative**2) / 2)  # RMS 1, so that the peak is the crest factor
    gains = np.stack([np.ones(len(harmonics)), *(np.asarray(g(tone_frequencies)) for g, _ in predicted)])
    reduced = harmonics // np.gcd.reduce(harmonics)
    views = gains * amplitudes / limits[:, None]  # (1 + n_predicted, K): every row may reach peak 1 / scale
    phases = _least_peak_phases(reduced, views, amplitudes**2, starts, np.random.default_rng(seed))

    peaks = _peaks(reduced, views, phases)
    scale = 1.0 / peaks.max()
    angle = 2 * np.pi * np.outer(np.arange(n_samples), harmonics) / n_samples + phases
    crest_factor = float(peaks[0] * limits[0])
    limited_by = "the amplitude limit" if peaks.argmax() == 0 else f"predicted response {peaks.argmax()}"
    return Multisine(
        time=sample_time * np.arange(n_samples),
        signal=(lowest + highest) / 2 + scale * np.cos(angle) @ amplitudes,
        frequencies=tone_frequencies,
        amplitudes=scale * amplitudes,
        phases=phases,
        offset=(lowest + highest) / 2,
        period=float(period / np.gcd.reduce(harmonics)),
        crest_factor=crest_factor,
        peak=scale * crest_factor,
        message=f"{len(harmonics)} tones from {tone_frequencies[0]:.4g} to {tone_frequencies[-1]:.4g} Hz, "
        f"crest factor {crest_factor:.3f}, amplitude set by {limited_by}",
    )


def usual_tones(band: tuple[float, float], duration: float) -> int:
    """Number of tones where none is asked for: :data:`TONES`, or as many as a band [Hz] holds in a duration [s]."""
    first, last = _multiples(band, duration)
    return min(TONES, max(last - first + 1, 1))


def _multiples(band: tuple[float, float], period: float) -> tuple[int, int]:
    """The first and the last multiple of 1 / period in a band; the last is below the first where it holds none."""
    first, last = int(np.ceil(band[0] * period - 1e-9)), int(np.floor(band[1] * period + 1e-9))
    return max(first, 1), last


def _harmonics(band: tuple[float, float], tones: int, period: float, sample_time: float) -> np.ndarray:
    """Tones as ascending multiples of 1 / period (K,) int."""
    first, last = _multiples(band, period)
    if tones < 1 or last - first + 1 < tones:
        raise InputError(
            f"excitation: the band holds {max(last - first + 1, 0)} multiples of {1 / period:.4g} Hz, "
            f"fewer than {tones} tones; lengthen the duration or ask for fewer tones"
        )
    step = (last - first) // max(tones - 1, 1)
    if tones * max(step + 1, 1) <= last and step + 1 >= first:
        step += 1
    # Multiples of one number repeat sooner and reach the lowest crest factors.
    start = step * -(-first // step) if step else first
    start = start if start + step * (tones - 1) <= last else first
    harmonics = start + step * np.arange(tones)
    if harmonics[0] < 1 or harmonics[-1] / period >= 0.5 / sample_time:
        raise InputError(
            f"excitation: tones must lie between {1 / period:.4g} Hz and half the sampling frequency, "
            f"{0.5 / sample_time:.4g} Hz; change the band or the sample time"
        )
    return harmonics


def _waves(harmonics: np.ndarray, views: np.ndarray, points: int) -> np.ndarray:
    """Complex tones of every view on a grid over one period, (n_views * N, K)."""
    grid = np.arange(points * int(harmonics[-1])) / (points * int(harmonics[-1]))
    wave = np.exp(2j * np.pi * np.outer(grid, harmonics))
    return (wave[None] * views[:, None, :]).reshape(-1, len(harmonics))


def _peaks(harmonics: np.ndarray, views: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Upper bound of the peak of every view over continuous time.

    A trigonometric polynomial of degree n is at most ``1 / cos(π n / N)`` times its largest value on N >= 2n
    equidistant points (Ehlich and Zeller, Math. Z. 86, 1964).
    """
    signals = np.real(_waves(harmonics, views, _PEAK_POINTS) @ np.exp(1j * phases)).reshape(len(views), -1)
    return np.abs(signals).max(axis=1) / np.cos(np.pi / _PEAK_POINTS)


def _least_peak_phases(
    harmonics: np.ndarray, views: np.ndarray, powers: np.ndarray, starts: int, rng: np.random.Generator
) -> np.ndarray:
    """Phases of least peak: a coarse search from every start, then the best ones refined."""
    random = rng.uniform(0, 2 * np.pi, (starts - 1, len(harmonics)))
    coarse = _waves(harmonics, views, _SEARCH_POINTS // 2)
    searched = [
        _descend(coarse, phases, _SEARCH_POWERS, 12) for phases in (schroeder_phases(powers), *random)
    ]
    searched.sort(key=lambda phases: _peaks(harmonics, views, phases).max())
    fine = _waves(harmonics, views, _SEARCH_POINTS)
    refined = [_descend(fine, phases, _REFINE_POWERS, 40) for phases in searched[:8]]
    return min([*refined, searched[0]], key=lambda phases: _peaks(harmonics, views, phases).max())


def _descend(waves: np.ndarray, phases: np.ndarray, powers: Sequence[int], iterations: int) -> np.ndarray:
    """Levenberg-Marquardt on ``Σ |x|^p`` for rising p, with residuals ``|x|^(p/2)``."""
    for power in powers:
        damping = 1e-2
        rotated = waves * np.exp(1j * phases)
        level, cost = _power_norm(np.real(rotated).sum(axis=1), power)
        for _ in range(iterations):
            signal = np.real(rotated).sum(axis=1) / level
            size = np.abs(signal)
            residual = size ** (power // 2)
            slope = (power // 2) * np.sign(signal) * size ** (power // 2 - 1)
            jacobian = -slope[:, None] * np.imag(rotated) / level
            hessian, gradient = jacobian.T @ jacobian, jacobian.T @ residual
            diagonal = np.diag(np.diag(hessian) + 1e-12 * np.trace(hessian))
            for _ in range(8):
                trial = phases - np.linalg.solve(hessian + damping * diagonal, gradient)
                trial_rotated = waves * np.exp(1j * trial)
                trial_level, trial_cost = _power_norm(np.real(trial_rotated).sum(axis=1), power)
                if trial_cost < cost:
                    break
                damping *= 4
            else:
                break
            gain = cost - trial_cost
            phases, rotated, level, cost = trial, trial_rotated, trial_level, trial_cost
            damping = max(damping / 6, 1e-9)
            if gain < 1e-5:
                break
    return phases


def _power_norm(signal: np.ndarray, power: int) -> tuple[float, float]:
    """Largest magnitude, and logarithm of the p-norm of the signal (scaled: high powers stay finite)."""
    level = float(np.abs(signal).max())
    return level, float(np.log(level) + np.log(np.mean((np.abs(signal) / level) ** power)) / power)
