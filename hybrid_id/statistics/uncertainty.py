"""Covariance of estimates from the Jacobian: plain, and robust against autocorrelated residuals.

Convention of this package: ``residual = w (y - ŷ)`` and ``jacobian = w ∂ŷ/∂θ`` with ``w`` = 1 / standard deviation.
A fit weighs the records by that w, whatever residuals it ends with, and a prior of information P as it is given: the
Hessian of its cost is ``JᵀJ + P``, and its inverse A tells how the estimate answers to either.
One record has arrays (T,) and (T, p), or (T, n_y) and (T, n_y, p); several records come as sequences of such.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from hybrid_id.statistics.long_run import long_run_covariance

Arrays = np.ndarray | Sequence[np.ndarray]

_NUMERICALLY_NULL = 1e-12  # eigenvalues of a unit-diagonal information matrix below this are rounding


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of an estimate.

    Attributes:
        matrix: (p, p); a pseudo-inverse where directions are undetermined.
        std_error: (p,); inf for parameters that an undetermined direction moves.
        noise_variance: Variance of the weighted residuals; 1 where the weights are right.
        method: "plain" or "robust".
        lag: Samples over which the robust version sums; 0 for the plain one.
        inverse_hessian: A, (p, p).
    """

    matrix: np.ndarray
    std_error: np.ndarray
    noise_variance: float
    method: str
    lag: int
    inverse_hessian: np.ndarray

    def interval(self, estimate: np.ndarray, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Normal confidence interval (lower, upper), each (p,)."""
        reach = ndtri(0.5 + level / 2) * self.std_error
        return np.asarray(estimate) - reach, np.asarray(estimate) + reach


def covariance(
    jacobian: Arrays,
    residual: Arrays,
    *,
    prior_information: np.ndarray | None = None,
    noise_variance: float | None = None,
) -> Covariance:
    """``A (s² JᵀJ + P) A``: right where residuals are white and the model is; ``s² (JᵀJ)⁻¹`` without a prior.

    Args:
        jacobian: Weighted Jacobian of one record or of several.
        residual: Weighted residuals alike.
        prior_information: P, inverse covariance of a Gaussian prior, (p, p) or its diagonal (p,).
        noise_variance: s², where it is known; ``Σr² / (N - p)`` otherwise.
    """
    records = as_records(jacobian, residual)
    variance = noise_variance_of(records) if noise_variance is None else noise_variance
    hessian = np.sum([np.einsum("tyi,tyj->ij", j, j) for j, _ in records], axis=0)
    prior = prior_matrix(prior_information, len(hessian))
    inverse, determined = scaled_inverse(hessian + prior)
    # the same, without cancellation where there is no prior
    matrix = variance * inverse + (1.0 - variance) * inverse @ prior @ inverse
    return Covariance(matrix, _std_error(matrix, determined), variance, "plain", 0, inverse)


def robust_covariance(
    jacobian: Arrays,
    residual: Arrays,
    *,
    prior_information: np.ndarray | None = None,
) -> Covariance:
    """``A (B + P) A`` with B the long-run covariance of the scores ``J_tᵀ r_t``: residuals may be autocorrelated.

    Records are independent of each other. A model error that lasts as long as a record escapes it: compare with
    the scatter between records (`trust`).

    Args:
        jacobian: Weighted Jacobian of one record or of several.
        residual: Weighted residuals alike.
        prior_information: As in `covariance`; the prior's mean counts as one more measurement.
    """
    records = as_records(jacobian, residual)
    variance = noise_variance_of(records)
    hessian = np.sum([np.einsum("tyi,tyj->ij", j, j) for j, _ in records], axis=0)
    prior = prior_matrix(prior_information, len(hessian))
    inverse, determined = scaled_inverse(hessian + prior)
    # principal axes of the information: along a null direction the scores are zero, and must stay zero
    scale = diagonal_scale(hessian)
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    kept = values > _NUMERICALLY_NULL * len(values)
    root = np.sqrt(values[kept])
    axes, back = vectors[:, kept] / scale[:, None] / root, vectors[:, kept] * scale[:, None] * root
    rotated, lag = long_run_covariance([np.einsum("tyi,ty->ti", j @ axes, r) for j, r in records])
    scores = back @ rotated @ back.T
    n_residuals = sum(r.size for _, r in records)
    correction = n_residuals / max(n_residuals - len(hessian), 1)
    matrix = inverse @ (correction * scores + prior) @ inverse
    return Covariance(matrix, _std_error(matrix, determined), variance, "robust", lag, inverse)


def as_records(jacobian: Arrays, residual: Arrays) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs (T, n_y, p), (T, n_y), one for each record."""
    if isinstance(residual, np.ndarray):
        jacobian, residual = [np.asarray(jacobian)], [residual]
    return [
        (np.reshape(j, (len(r), -1, np.shape(j)[-1])), np.reshape(r, (len(r), -1)))
        for j, r in zip(jacobian, residual, strict=True)
    ]


def prior_matrix(prior_information: np.ndarray | None, size: int) -> np.ndarray:
    """Prior information as a matrix (p, p)."""
    if prior_information is None:
        return np.zeros((size, size))
    prior = np.asarray(prior_information, float)
    return np.diag(prior) if prior.ndim == 1 else prior


def diagonal_scale(information: np.ndarray) -> np.ndarray:
    """What a matrix of information is divided by for a unit diagonal (p,); 1 for a parameter that moves nothing."""
    scale = np.sqrt(np.diag(information))
    return np.where(scale > 0, scale, 1.0)


def scaled_inverse(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pseudo-inverse (p, p) of an information matrix, and which parameters it determines (p,) bool.

    Eigenvalues are judged after scaling to a unit diagonal, so that units do not matter.
    """
    scale = diagonal_scale(information)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = values > _NUMERICALLY_NULL * len(values)
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    determined = np.linalg.norm(vectors[:, ~kept], axis=1) < 1e-4
    return inverse / np.outer(scale, scale), determined


def _std_error(matrix: np.ndarray, determined: np.ndarray) -> np.ndarray:
    return np.where(determined, np.sqrt(np.maximum(np.diag(matrix), 0.0)), np.inf)


def noise_variance_of(records: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Mean square of the weighted residuals per degree of freedom; 1 where there is nothing left.

    Residuals with weight zero stand for samples that are not there.
    """
    count = sum(np.count_nonzero(r) for _, r in records) - records[0][0].shape[-1]
    total = sum(float(np.sum(r**2)) for _, r in records)
    return total / max(count, 1) if total > 0 else 1.0
