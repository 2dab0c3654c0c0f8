"""Whether residuals look like noise: their own correlation, and that with the inputs before them.

Source of both tests and their bands: L. Ljung, System Identification, 2nd ed., 1999, section 16.6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri

LAGS = 100
LEVEL = 0.99
"""Confidence of the bands, and share of white residuals that pass."""
SHARED = 0.1
"""Correlation of neighbouring residuals up to which next to nothing is left to model, however surely it is there."""


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of weighted residuals, averaged over the records.

    Attributes:
        lags: 0 .. L, in samples.
        correlation: (L + 1, n_y); 1 at lag 0.
        band: white residuals stay within plus-minus this at a single lag.
        outside: share of the lags above 0 that leave the band, (n_y,).
    """

    lags: np.ndarray
    correlation: np.ndarray
    band: float
    outside: np.ndarray


def whiteness(residual: Sequence[np.ndarray]) -> Whiteness:
    """Autocorrelation ``R(k) = Σ r_t r_{t+k} / Σ r_t²``, at lags up to a quarter of the shortest record, and its band.

    Args:
        residual: weighted residuals of each record, (T, n_y).
    """
    lags = max(1, min(LAGS, min(len(r) for r in residual) // 4))
    total = np.zeros((lags + 1, residual[0].shape[1]))
    for r in residual:
        for k in range(lags + 1):
            total[k] += np.sum(r[: len(r) - k] * r[k:], axis=0)
    correlation = total / np.where(total[0] > 0, total[0], 1.0)
    band = float(ndtri(0.5 + LEVEL / 2) / np.sqrt(sum(len(r) for r in residual)))
    outside = np.mean(np.abs(correlation[1:]) > band, axis=0)
    return Whiteness(np.arange(lags + 1), correlation, band, outside)


@dataclass(frozen=True)
class Follows:
    """The strongest correlation of a residual with one input before it.

    Attributes:
        input: its name.
        correlation: at that lag, -1 to 1.
        lag: samples by which the residual is later, from 1.
        band: unrelated residuals stay within plus-minus this at all lags together.
    """

    input: str
    correlation: float
    lag: int
    band: float

    @property
    def sure(self) -> bool:
        """Whether chance alone does not explain it."""
        return abs(self.correlation) > self.band


@dataclass(frozen=True)
class ResidualTest:
    """What the residuals of one output say of its model.

    Attributes:
        output: its name.
        samples: residuals of all records together.
        rms: their RMS over the noise; inf where the output has no noise or a run has diverged.
        lags: lags that were looked at.
        outside: share of these whose autocorrelation leaves the band.
        chance: probability that white residuals have as much autocorrelation over these lags together.
        shared: correlation of neighbouring residuals.
        follows: for each input that moves the strongest correlation with it, the strongest first.
    """

    output: str
    samples: int
    rms: float
    lags: int
    outside: float
    chance: float
    shared: float
    follows: tuple[Follows, ...]

    @property
    def followed(self) -> tuple[Follows, ...]:
        """The inputs that the residuals surely follow."""
        return tuple(one for one in self.follows if one.sure)

    @property
    def verdict(self) -> str:
        """``white``, ``nearly white``, ``not white``, or ``diverged``."""
        if not np.isfinite(self.shared):
            return "diverged"
        if self.chance > 1.0 - LEVEL and not self.followed:
            return "white"
        return "not white" if self.followed or self.shared > SHARED else "nearly white"


def residual_test(
    output: str,
    residual: Sequence[np.ndarray],
    inputs: Sequence[Mapping[str, np.ndarray]],
    noise: Sequence[float],
) -> ResidualTest:
    """Test the residuals of one output.

    Args:
        output: its name.
        residual: of each record, measured - simulated, ``(T,)``.
        inputs: of each record, by name, ``(T,)``.
        noise: standard deviation of each record's noise, in the output's unit; 0 where it has none.
    """
    samples = sum(len(r) for r in residual)
    if not all(np.isfinite(r).all() for r in residual):
        return ResidualTest(output, samples, np.inf, LAGS, np.nan, np.nan, np.nan, ())
    square = sum(np.square(r / n).sum() if n > 0 else np.inf for r, n in zip(residual, noise, strict=True))
    # every record counts by its own noise, as in a fit
    scaled = [r / n if n > 0 else r for r, n in zip(residual, noise, strict=True)]
    white = whiteness([r[:, None] for r in scaled])
    common = [name for name in inputs[0] if all(name in one for one in inputs)]
    moving = [name for name in common if any(np.ptp(one[name]) > 0 for one in inputs)]
    squares = float(np.square(white.correlation[1:, 0]).sum())
    chance = float(chdtrc(len(white.lags) - 1, samples * squares))
    found = (follows(name, scaled, [one[name] for one in inputs]) for name in moving)
    return ResidualTest(
        output, samples, float(np.sqrt(square / samples)), len(white.lags) - 1, float(white.outside[0]), chance,
        float(white.correlation[1, 0]), tuple(sorted(found, key=lambda one: -abs(one.correlation / one.band))),
    )  # fmt: skip


def follows(name: str, residual: Sequence[np.ndarray], signal: Sequence[np.ndarray]) -> Follows:
    """Strongest correlation ``R(k) = Σ e_t u_{t-k}`` at lags 1 .. L: an input acts on what comes after it.

    Of residuals that have nothing to do with the input ``R(k)`` has the variance ``Σ_l R_e(l) R_u(l)``, whatever their
    colours are. The band is widened for L lags (Bonferroni), which are no L independent looks.

    Args:
        name: of the input.
        residual: of each record, ``(T,)``.
        signal: the input alike.
    """
    lags = max(1, min(LAGS, min(len(r) for r in residual) // 4))
    width = 1 << (2 * max(len(r) for r in residual) - 1).bit_length()
    centred = [[np.fft.rfft(s - s.mean(), width) for s in signals] for signals in (residual, signal)]
    reach = width // 8
    across = np.sum([np.fft.irfft(e * u.conj(), width) for e, u in zip(*centred, strict=True)], axis=0)
    across = across[1 : lags + 1]
    own = [np.sum([np.fft.irfft(np.abs(s) ** 2, width)[:reach] for s in one], axis=0) for one in centred]
    scale = float(np.sqrt(own[0][0] * own[1][0])) or 1.0
    best = int(np.argmax(np.abs(across)))
    # what chance leaves of the sum itself must not make the band narrower than that of white residuals
    spread = max(float(own[0] @ own[1]) * 2.0 / scale**2 - 1.0, 1.0)
    band = float(ndtri(1.0 - 0.5 * (1.0 - LEVEL) / lags) * np.sqrt(spread / sum(len(r) for r in residual)))
    return Follows(name, float(across[best]) / scale, best + 1, band)
