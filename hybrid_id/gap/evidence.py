"""What a fit is worth on records that it has not seen, without fitting it again.

Leaving a record out moves the estimate by one Gauss-Newton step, which the sensitivities of the fit already hold:
``(H - H_i) delta = sum_{j != i} J_j' r_j``; the record's residuals there are ``r_i - J_i delta``. Exact for a linear
model (A. C. Davison and D. V. Hinkley, Bootstrap Methods and their Application, 1997, section 6.4: the linear case).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_id.identification.result import FitResult

BLOCK = 0.25
"""Length [s] of the blocks in which errors are compared."""


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
        """Log-likelihood by which this one predicts better than another, in nats, at this one's correlation."""
        return 0.5 * self.effective * float(np.log(other.error / self.error))

    def z(self, other: Evidence) -> float:
        """How surely this one predicts better than another: the mean relative surplus of the other's error in a block.

        Relative to the errors of both, for a free run's error grows along the record: the last blocks would drown the
        rest, and no effect, however large, would be sure.
        """
        surplus = (other.blocks - self.blocks) / np.maximum(other.blocks + self.blocks, 1e-300)
        spread = float(surplus.std(ddof=1)) if len(surplus) > 1 else 0.0
        return float(surplus.mean() / max(spread, 1e-3) * np.sqrt(len(surplus)))


def evidence(result: FitResult, sample_time: float) -> Evidence:
    """Errors of a fit on each of its records, left out in turn.

    Args:
        result: of several records, pooled; it need not have converged.
        sample_time: of the records [s].
    """
    free = [i for i, name in enumerate(result.names) if name not in result.at_bound]
    return predicted([j[..., free] for j in result.jacobian], result.residual, sample_time)


def predicted(jacobian: Sequence[np.ndarray], residual: Sequence[np.ndarray], sample_time: float) -> Evidence:
    """Errors on each record from the sensitivities and residuals of all, by the step that the others ask for.

    Args:
        jacobian: weighted sensitivities of each record, ``(T, n_y, n)``.
        residual: weighted residuals of each record, ``(T, n_y)``.
        sample_time: of the records [s].
    """
    jacobians = [j.reshape(-1, j.shape[-1]) for j in jacobian]
    residuals = [r.reshape(-1) for r in residual]
    size = np.sqrt(sum((np.square(j).sum(0) for j in jacobians), np.zeros(jacobians[0].shape[1])))
    size = np.where(size > 0, size, 1.0)
    jacobians = [j / size for j in jacobians]
    hessians = [j.T @ j for j in jacobians]
    slopes = [j.T @ r for j, r in zip(jacobians, residuals, strict=True)]
    hessian, slope = np.sum(hessians, 0), np.sum(slopes, 0)
    blocks, left_out = [], []
    for j, r, h, g, shape in zip(jacobians, residuals, hessians, slopes, residual, strict=True):
        alone = len(residuals) == 1
        step = _solve(hessian if alone else hessian - h, slope if alone else slope - g)
        error = (r - j @ step).reshape(shape.shape)
        left_out.append(error)
        squares = np.square(error).sum(1)
        length = max(1, round(BLOCK / sample_time))
        blocks.append(np.add.reduceat(squares, np.arange(0, len(squares), length)))
    samples = sum(int(np.count_nonzero(r)) for r in residual)
    return Evidence(np.concatenate(blocks), samples, effective_samples(left_out))


def effective_samples(residuals: Sequence[np.ndarray]) -> float:
    """Number of independent samples that correlated residuals are worth.

    ``N / (1 + 2 sum rho_k)`` with the autocorrelations of all records together, summed while positive.

    Args:
        residuals: of each record, ``(T, n_y)``.
    """
    total = sum(r.size for r in residuals)
    longest = min(len(r) for r in residuals)
    size = 1 << (2 * max(len(r) for r in residuals) - 1).bit_length()
    spectrum = np.sum([np.square(np.abs(np.fft.rfft(r, size, axis=0))).sum(1) for r in residuals], 0)
    correlation = np.fft.irfft(spectrum)[:longest]
    if correlation[0] <= 0:
        return float(total)
    correlation = correlation / correlation[0]
    negative = np.nonzero(correlation <= 0)[0]
    end = int(negative[0]) if len(negative) else longest
    return float(total / max(1.0, 2.0 * correlation[:end].sum() - 1.0))


def _solve(hessian: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Step along the directions that the other records tell."""
    values, vectors = np.linalg.eigh(hessian)
    kept = values > 1e-8 * max(values.max(initial=0.0), 1e-300)
    return vectors[:, kept] @ ((vectors[:, kept].T @ slope) / values[kept])
