"""What errors of prediction say: how large they are, how many independent ones, how surely one model beats another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BLOCK = 0.25
"""Length [s] of the blocks in which errors are compared."""
WHITE = 0.1
"""Share of residuals that is no white noise, below which they are taken for it."""
NEGLIGIBLE = 0.1
"""RMS of weighted errors up to which nothing is looked for in them; 1 are the noise and what a good model misses."""
COLOURED = 0.3
"""The same, of train or of test records, from which something acts that a model lacks. Small random torques alone leave
a fifth at most in generated cases."""


@dataclass(frozen=True)
class Evidence:
    """Squared errors of prediction, in units of the measurements' weights.

    Attributes:
        blocks: sums over short blocks of every record, left out of its own estimate.
        samples: number of measurements.
        effective: how many independent measurements they are worth.
    """

    blocks: np.ndarray
    samples: int
    effective: float

    @property
    def error(self) -> float:
        """Mean square of the weighted errors of prediction."""
        return float(self.blocks.sum() / self.samples)

    def gain(self, other: Evidence) -> float:
        """Factor by which the RMS of the errors is lower here than another's."""
        return float(np.sqrt(other.error / self.error))

    def z(self, other: Evidence) -> float:
        """How surely this one predicts better than another: the mean relative surplus of the other's error in a block.

        Relative to the errors of both, for a free run's error grows along the record: the last blocks would drown the
        rest, and no effect, however large, would be sure.
        """
        surplus = (other.blocks - self.blocks) / np.maximum(other.blocks + self.blocks, 1e-300)
        spread = float(surplus.std(ddof=1)) if len(surplus) > 1 else 0.0
        return float(surplus.mean() / max(spread, 1e-3) * np.sqrt(len(surplus)))


def evidence(residuals: Sequence[np.ndarray], sample_time: float) -> Evidence:
    """What errors of prediction say.

    Args:
        residuals: weighted errors on each record, which the estimate has not seen, ``(T, n_y)``.
        sample_time: of the records [s].
    """
    length, blocks = max(1, round(BLOCK / sample_time)), []
    for residual in residuals:
        squares = np.square(residual).sum(1)
        blocks.append(np.add.reduceat(squares, np.arange(0, len(squares), length)))
    samples = sum(int(np.count_nonzero(r)) for r in residuals)
    return Evidence(np.concatenate(blocks), samples, effective_samples(residuals))


def coloured(residuals: Sequence[np.ndarray]) -> float:
    """Share of the mean square that neighbouring samples have in common: 0 for white noise, 1 for what is smooth.

    One less von Neumann's ratio, ``1 - <(r_t - r_{t-1})^2> / (2 <r_t^2>)`` (J. von Neumann, Ann. Math. Stat. 12, 1941):
    an encoder's noise is white, what a model lacks is not.

    Args:
        residuals: of each record, ``(T, n_y)``.
    """
    total = sum(float(np.square(r).sum()) for r in residuals)
    steps = sum(float(np.square(np.diff(r, axis=0)).sum()) for r in residuals)
    if not np.isfinite(total):  # a run that has diverged is no noise
        return 1.0
    return max(0.0, 1.0 - 0.5 * steps / total) if total > 0 else 0.0


def mean_square(residuals: Sequence[np.ndarray]) -> float:
    """Of errors in units of the measurements' weights."""
    return sum(float(np.square(one).sum()) for one in residuals) / sum(one.size for one in residuals)


def negligible(residuals: Sequence[np.ndarray]) -> bool:
    """Whether errors in units of the measurements' weights are far below what any good model misses."""
    return mean_square(residuals) < NEGLIGIBLE**2


def effective_samples(residuals: Sequence[np.ndarray]) -> float:
    """Number of independent samples that correlated residuals are worth.

    ``N / (1 + 2 sum rho_k)`` with the autocorrelations of all records together, summed while positive.

    Args:
        residuals: of each record, ``(T, n_y)``.
    """
    total = sum(r.size for r in residuals)
    longest = max(len(r) for r in residuals)
    size = 1 << (2 * longest - 1).bit_length()
    spectrum = np.sum([np.square(np.abs(np.fft.rfft(r, size, axis=0))).sum(1) for r in residuals], 0)
    correlation = np.fft.irfft(spectrum)[:longest]
    if correlation[0] <= 0:
        return float(total)
    correlation = correlation / correlation[0]
    negative = np.nonzero(correlation <= 0)[0]
    end = int(negative[0]) if len(negative) else longest
    return float(total / max(1.0, 2.0 * correlation[:end].sum() - 1.0))
