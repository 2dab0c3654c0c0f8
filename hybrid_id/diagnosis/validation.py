"""Errors on records that an estimate has not seen, and what they say of one model against another.

These are the validation records where there are some. Elsewhere train records are left out whole, in turn, in at most
six folds: the model is fitted again without them, and predicts them. The squared errors of two models are compared
block by block. Where the richer model predicts no better, the sign of each block's difference is a coin's: thousands of
draws of these signs, the same for all candidates, give the distribution of the largest statistic of a whole search (R.
A. Fisher, The Design of Experiments, 1935, section 21; P. H. Westfall and S. S. Young, Resampling-Based Multiple
Testing, 1993, for the maximum). It is conservative, for a needless parameter makes predictions worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

BLOCK = 0.25
"""Length [s] of the blocks in which errors are compared."""
FEWEST = 4
"""Records from which a mean over records has a standard error."""
DRAWS = 2000
"""Draws of a null distribution, and of a bootstrap."""


@dataclass(frozen=True)
class Validation:
    """Squared errors of prediction, in units of the measurements' weights: noise variances.

    Attributes:
        blocks: sums over short blocks, ``(n,)``.
        sizes: measurements in each block, ``(n,)``.
        row: number of the record or window that each block is from, ``(n,)``.
        effective: how many independent measurements they are worth.
        record: number of the record that each block is from, ``(n,)``.
    """

    blocks: np.ndarray
    sizes: np.ndarray
    row: np.ndarray
    effective: float
    record: np.ndarray

    def even_weights(self) -> np.ndarray:
        """Weights of the records, ``(R,)``, with which none counts for more than the one that is predicted next worst.

        Where a record goes elsewhere than all others, its error says little of a model and would drown the rest.
        """
        errors = np.bincount(self.record, self.blocks) / np.maximum(np.bincount(self.record, self.sizes), 1)
        limit = np.sort(errors)[-2] if len(errors) > 1 else errors[0]
        return np.minimum(1.0, limit / np.maximum(errors, 1e-300))

    def weighted(self, weights: np.ndarray) -> Validation:
        """The same with the errors of each record times a weight, ``(R,)``."""
        return replace(self, blocks=self.blocks * weights[self.record])

    def without(self, record: int) -> Validation:
        """The same of all records but one."""
        kept = self.record != record
        return replace(
            self,
            blocks=self.blocks[kept],
            sizes=self.sizes[kept],
            row=self.row[kept],
            record=self.record[kept],
        )

    def drawn(self, generator: np.random.Generator, *, records: bool) -> np.ndarray:
        """Weights of the blocks, ``(DRAWS / 4, n)``, in draws of the blocks alone or of the records and their blocks.

        Weights are exponential (D. B. Rubin, The Bayesian Bootstrap, Annals of Statistics 9, 1981), so that no draw
        lacks the one record in which an effect acts.
        """
        weights = generator.exponential(size=(DRAWS // 4, len(self.blocks)))
        if not records:
            return weights
        return weights * generator.exponential(size=(DRAWS // 4, int(self.record.max()) + 1))[:, self.record]

    @property
    def error(self) -> float:
        """Mean square of the weighted errors of prediction, in noise variances."""
        return float(self.blocks.sum() / self.sizes.sum())

    @property
    def typical(self) -> float:
        """Geometric mean over the records of their mean square: each counts alike."""
        errors = np.bincount(self.record, self.blocks) / np.maximum(np.bincount(self.record, self.sizes), 1)
        return float(np.exp(np.log(np.maximum(errors, 1e-300)).mean()))

    def fall(self, simpler: Validation) -> float:
        """Share of another model's mean square by which this one's is lower."""
        return 1.0 - self.error / max(simpler.error, 1e-300)

    def rests_on(self, simpler: Validation) -> int | None:
        """Number of the record without which this one predicts no better than a simpler model, None where none is."""
        gain = np.bincount(self.record, simpler.blocks - self.blocks)
        best = int(gain.argmax())
        return best if len(gain) > 2 and 0.0 < gain.sum() <= gain[best] else None

    def z(self, other: Validation) -> float:
        """By how many standard errors this one predicts better than another: mean relative difference of their blocks.

        Relative to the errors of both and the noise, for a free run's error grows along the record: the last blocks
        would drown the rest, and no effect, however large, would be sure.
        """
        difference = _relative(self, other)
        spread = float(difference.std(ddof=1)) if len(difference) > 1 else 0.0
        return float(difference.mean() / max(spread, 1e-3) * np.sqrt(len(difference)))

    def over_records(self, other: Validation) -> tuple[float, int]:
        """The same where both err for reasons of their own, record by record: these reasons last as long as a record.

        Errors below the noise say nothing: it is added to both, and records in which both err by less are left out, as
        those are in which a joint stands still.

        Returns:
            Mean over the records of the logarithm of the ratio of mean squares, in standard errors (Student's t), and
            the number of records; of fewer than :data:`FEWEST` records, equal parts of these.
        """
        own = self.row
        parts = -(-FEWEST // (int(own.max()) + 1))
        if parts > 1:
            sizes = np.bincount(own)
            within = np.concatenate([np.arange(size) * parts // size for size in sizes])
            own = np.unique(own * parts + within, return_inverse=True)[1]
        noise = np.bincount(own, _noise(self, other))
        ours, theirs = np.bincount(own, self.blocks), np.bincount(own, other.blocks)
        ratio = np.log((theirs + noise) / (ours + noise))
        loud = np.maximum(ours, theirs) > noise
        ratio = ratio[loud] if loud.sum() >= FEWEST else ratio
        n = len(ratio)
        spread = float(ratio.std(ddof=1)) if n > 1 else 0.0
        return float(ratio.mean() / max(spread, 1e-3) * np.sqrt(n)), n


def validation(residuals: Sequence[np.ndarray], sample_time: float, records: Sequence[str]) -> Validation:
    """Blocks of weighted errors of prediction.

    Args:
        residuals: weighted errors of each record or window, which the estimate has not seen, ``(T, n_y)``.
        sample_time: of the records [s].
        records: name of the record that each is of.
    """
    length, blocks, sizes, row = max(1, round(BLOCK / sample_time)), [], [], []
    number_of = {name: k for k, name in enumerate(dict.fromkeys(records))}
    for number, residual in enumerate(residuals):
        starts = np.arange(0, len(residual), length)
        blocks.append(np.add.reduceat(np.square(residual).sum(1), starts))
        sizes.append(np.add.reduceat(np.count_nonzero(residual, axis=1), starts))
        row.append(np.full(len(starts), number))
    sums, counts, own = np.concatenate(blocks), np.maximum(np.concatenate(sizes), 1), np.concatenate(row)
    record = np.array([number_of[name] for name in records])[own]
    return Validation(sums, counts, own, effective_samples(residuals), record)


def p_values(richer: Sequence[Validation], simpler: Validation, seed: int = 0) -> np.ndarray:
    """Probability that a search over all these models would find one so much better by chance, for each, ``(n,)``.

    Two statistics are taken, whichever says more: the mean difference of the blocks relative to their record's error,
    and relative to both errors of the block. The first sees an effect that acts at few instants, the second one that
    acts always and is drowned by the end of free runs. Where the differences of neighbouring
    blocks go together, a statistic is less by the root of the number of blocks over which they do.

    Args:
        richer: validations of the candidates.
        simpler: of the model that they are added to.
        seed: of the draws.
    """
    if not richer:
        return np.empty(0)
    generator, ones = np.random.default_rng(seed), []
    rows = np.bincount(simpler.row)
    for one in richer:
        scale = np.bincount(simpler.row, simpler.blocks + _noise(one, simpler)) / np.maximum(rows, 1)
        ones += [(simpler.blocks - one.blocks) / scale[simpler.row], _relative(one, simpler)]
    differences = np.array(ones)
    size = np.sqrt(np.square(differences).sum(1)).clip(1e-300)
    alike = np.sqrt([_correlation_length(one, simpler.row) for one in ones])
    seen = (differences.sum(1) / size / alike).reshape(-1, 2).max(1)
    signs = generator.choice([-1.0, 1.0], size=(DRAWS, differences.shape[1]))
    largest = (signs @ (differences / size[:, None]).T).max(1)
    return (1.0 + (largest[:, None] >= seen).sum(0)) / (1.0 + DRAWS)


def _relative(one: Validation, other: Validation) -> np.ndarray:
    return (other.blocks - one.blocks) / (other.blocks + one.blocks + _noise(one, other))


def _noise(one: Validation, other: Validation) -> np.ndarray:
    """What the noise alone leaves of each block, below which errors say nothing: those of a joint that stands still.

    A block whose errors are all zero has counted none of its measurements.
    """
    return np.maximum(one.sizes, other.sizes)


def _correlation_length(series: np.ndarray, row: np.ndarray) -> float:
    """Blocks over which a series goes together: ``1 + 2 sum rho_k`` with the autocorrelations while positive.

    Each record's own mean is taken out: that one record gains more than another is no correlation in time. What this
    takes from the correlation, about its length over that of a record, is given back.
    """
    own = np.unique(row, return_inverse=True)[1]
    count = np.bincount(own)
    centred = series - (np.bincount(own, series) / count)[own]
    total, length, shortest = float(centred @ centred), 1.0, int(count.min())
    for lag in range(1, max(2, shortest // 2)):
        same = row[lag:] == row[:-lag]
        rho = float((centred[lag:] * centred[:-lag])[same].sum()) / max(total, 1e-300)
        if rho <= 0.0:
            break
        length += 2.0 * rho
    return length * (1.0 + 2.0 * length / max(shortest, 2))


def autocorrelation(residuals: Sequence[np.ndarray]) -> float:
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
