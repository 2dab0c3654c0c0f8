"""Uncertainty of estimates: plain, autocorrelation-robust and jackknife covariances, and the block bootstrap.

Convention of this package: ``residual = w (y - ŷ)`` and ``jacobian = w ∂ŷ/∂θ`` with ``w`` = 1 / standard deviation.
A fit weighs the records by that w, whatever residuals it ends with, and a prior of information P as it is given: the
Hessian of its cost is ``JᵀJ + P``, and its inverse A says how the estimate answers to either.
One record has arrays (T,) and (T, p), or (T, n_y) and (T, n_y, p); several records come as sequences of such.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.special import ndtri

Arrays = np.ndarray | Sequence[np.ndarray]

_NUMERICALLY_NULL = 1e-12  # eigenvalues of a unit-diagonal information matrix below this are rounding
_CHUNKS = 300  # a record is summed in about so many chunks first: shorter correlations are inside one
_LARGEST_ORDER = 12
BLOCKS = 30
"""Blocks that the records are cut into."""
_MOST_BLOCKS = 1000  # more of them cost time and tell no more


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of an estimate.

    Attributes:
        matrix: (p, p); a pseudo-inverse where directions are undetermined.
        std_error: (p,); inf for parameters that an undetermined direction moves.
        noise_variance: Variance of the weighted residuals; 1 where the weights are right.
        inverse_hessian: A, (p, p).
    """

    matrix: np.ndarray
    std_error: np.ndarray
    noise_variance: float
    inverse_hessian: np.ndarray


def normal_interval(estimate: np.ndarray, std_error: np.ndarray, level: float) -> np.ndarray:
    """Normal confidence intervals (lower, upper), ``(p, 2)``; NaN where the standard error is not finite."""
    reach = float(ndtri(0.5 + level / 2)) * np.where(np.isfinite(std_error), std_error, np.nan)
    return np.stack([estimate - reach, estimate + reach], axis=-1)


def covariance(
    jacobian: Arrays,
    residual: Arrays,
    *,
    prior_precision: np.ndarray | None = None,
) -> Covariance:
    """``A (s² JᵀJ + P) A``: right where residuals are white and the model is; ``s² (JᵀJ)⁻¹`` without a prior.

    Args:
        jacobian: Weighted Jacobian of one record or of several.
        residual: Weighted residuals alike.
        prior_precision: P, inverse covariance of a Gaussian prior, (p, p) or its diagonal (p,).
    """
    records, _, prior, inverse, determined = _normal_equations(jacobian, residual, prior_precision)
    variance = noise_variance_of(records)
    # the same, without cancellation where there is no prior
    matrix = variance * inverse + (1.0 - variance) * inverse @ prior @ inverse
    return Covariance(matrix, _std_error(matrix, determined), variance, inverse)


def robust_covariance(
    jacobian: Arrays,
    residual: Arrays,
    *,
    prior_precision: np.ndarray | None = None,
) -> Covariance:
    """``A (B + P) A`` with B the long-run covariance of the scores ``J_tᵀ r_t``: residuals may be autocorrelated.

    Records are independent of each other. A model error that lasts as long as a record escapes it: compare with
    the scatter between records (`reliability`).

    Arguments are those of :func:`covariance`; the prior's mean counts as one more measurement.
    """
    records, hessian, prior, inverse, determined = _normal_equations(jacobian, residual, prior_precision)
    variance = noise_variance_of(records)
    # principal axes of the information: along a null direction the scores are zero, and must stay zero
    scale, values, vectors, kept = scaled_eigen(hessian)
    root = np.sqrt(values[kept])
    axes, back = vectors[:, kept] / scale[:, None] / root, vectors[:, kept] * scale[:, None] * root
    rotated = long_run_covariance([np.einsum("tyi,ty->ti", j @ axes, r) for j, r in records])
    scores = back @ rotated @ back.T
    n_residuals = sum(r.size for _, r in records)
    correction = n_residuals / max(n_residuals - len(hessian), 1)
    matrix = inverse @ (correction * scores + prior) @ inverse
    return Covariance(matrix, _std_error(matrix, determined), variance, inverse)


def _normal_equations(
    jacobian: Arrays, residual: Arrays, prior_precision: np.ndarray | None
) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Records, ``JᵀJ``, prior P, A, and which parameters they determine."""
    records = as_records(jacobian, residual)
    hessian = np.sum([np.einsum("tyi,tyj->ij", j, j) for j, _ in records], axis=0)
    prior = prior_matrix(prior_precision, len(hessian))
    return records, hessian, prior, *scaled_inverse(hessian + prior)


def as_records(jacobian: Arrays, residual: Arrays) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs (T, n_y, p), (T, n_y), one for each record."""
    if isinstance(residual, np.ndarray):
        jacobian, residual = [np.asarray(jacobian)], [residual]
    return [
        (np.reshape(j, (len(r), -1, np.shape(j)[-1])), np.reshape(r, (len(r), -1)))
        for j, r in zip(jacobian, residual, strict=True)
    ]


def prior_matrix(prior_precision: np.ndarray | None, size: int) -> np.ndarray:
    """Prior information as a matrix (p, p)."""
    if prior_precision is None:
        return np.zeros((size, size))
    prior = np.asarray(prior_precision, float)
    return np.diag(prior) if prior.ndim == 1 else prior


def scaled_inverse(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pseudo-inverse (p, p) of an information matrix, and which parameters it determines (p,) bool.

    Eigenvalues are judged after scaling to a unit diagonal, so that units do not matter.
    """
    scale, values, vectors, kept = scaled_eigen(information)
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    determined = np.linalg.norm(vectors[:, ~kept], axis=1) < 1e-4
    return inverse / np.outer(scale, scale), determined


def scaled_eigen(information: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scale to a unit diagonal (p,), eigenvalues (p,) and vectors (p, p) then, and which are identified (p,) bool."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)  # 1 for a parameter that moves nothing
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return scale, values, vectors, values > _NUMERICALLY_NULL * len(values)


def _std_error(matrix: np.ndarray, determined: np.ndarray) -> np.ndarray:
    return np.where(determined, np.sqrt(np.maximum(np.diag(matrix), 0.0)), np.inf)


def noise_variance_of(records: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Mean square of the weighted residuals per degree of freedom; 1 where there is nothing left.

    Residuals with weight zero stand for samples that are not there.
    """
    count = sum(np.count_nonzero(r) for _, r in records) - records[0][0].shape[-1]
    total = sum(float(np.sum(r**2)) for _, r in records)
    return total / max(count, 1) if total > 0 else 1.0


def long_run_covariance(series: Sequence[np.ndarray]) -> np.ndarray:
    """Covariance (p, p) of ``Σ_records Σ_t s_t`` for scores that may be autocorrelated; records are independent.

    Chunks are summed; each column is whitened by an autoregression whose order Akaike's criterion chooses (den
    Haan and Levin, "A practitioner's guide to robust covariance matrix estimation", Handbook of Statistics 15, 1997);
    what correlation is left goes through a Bartlett kernel (Newey and West, Econometrica 55, 1987, with the lag
    of their Rev. Econ. Stud. 61, 1994). High orders are needed: an oscillating sensitivity times a slow residual is
    an oscillation, which a first-order filter mistakes for a trend.

    Args:
        series: Scores of each record, [(T, p)], each column of mean zero.
    """
    if not series[0].shape[1]:  # the records tell nothing
        return np.zeros((0, 0))
    chunk = max(max(len(s) for s in series) // _CHUNKS, 1)
    sums = [np.add.reduceat(s, np.arange(0, len(s), chunk)) for s in series]
    size = np.sqrt(np.sum([np.sum(s**2, axis=0) for s in sums], axis=0))
    size = np.where(size > 0, size, 1.0)  # columns may differ by decades
    sums = [s / size for s in sums]
    count = sum(len(s) for s in sums)

    largest = min(_LARGEST_ORDER, max(len(s) for s in sums) // 5)  # a short record among long ones says less
    correlation = np.stack([np.diag(_lagged_products(sums, k)) for k in range(largest + 1)])
    filters = [_whitening_filter(column, count) for column in correlation.T]
    white = [
        np.stack([np.convolve(f, s[:, k])[largest : len(s)] for k, f in enumerate(filters)], axis=1)
        for s in sums
    ]
    lag = _newey_west_lag(white)
    total = _lagged_products(white, 0)
    for k in range(1, lag + 1):
        term = _lagged_products(white, k)
        total = total + (1 - k / (lag + 1)) * (term + term.T)
    recolour = size / np.array([f.sum() for f in filters])
    return total * np.outer(recolour, recolour) * count / sum(len(w) for w in white)


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


def jackknife_covariance(
    jacobian: Arrays, residual: Arrays, *, prior_precision: np.ndarray | None = None
) -> Covariance:
    """Delete-a-block jackknife, each estimate moved by one exact Gauss-Newton step of the reduced data.

    ``V = (B - 1) / B sum_b d_b d_b'`` with ``d_b = -(H - H_b)^-1 g_b``. It corrects for the part of the residuals
    that the fit itself absorbed, which the sandwich estimate misses on one record of slowly varying residuals.
    Sources: J. G. MacKinnon, H. White, J. Econometrics 29 (1985), for single samples; J. G. MacKinnon, M. O. Nielsen,
    M. D. Webb, "Cluster-robust inference: a guide to empirical practice", J. Econometrics 232 (2023), for blocks (CR3).

    Arguments are those of :func:`covariance`.
    """
    records, hessian, prior, inverse, determined = _normal_equations(jacobian, residual, prior_precision)
    samples, pieces = sum(len(r) for _, r in records), []
    for j, r in records:
        share = max(1, round(BLOCKS * len(r) / samples))
        pieces += zip(np.array_split(j, share), np.array_split(r, share), strict=True)
    gradients = np.stack([np.einsum("tyi,ty->i", j, r) for j, r in pieces])
    hessians = np.stack([np.einsum("tyi,tyj->ij", j, j) for j, _ in pieces])
    # axes in which the information is the identity: directions that the records do not tell are left out
    scale, values, vectors, kept = scaled_eigen(hessian + prior)
    axes = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
    rest = np.eye(axes.shape[1]) - np.einsum("ik,bij,jl->bkl", axes, hessians, axes, optimize=True)
    floor = 1e-3 * np.eye(axes.shape[1])  # a block that alone identifies a direction leaves nothing of it
    steps = np.linalg.solve(rest + floor, (gradients @ axes)[..., None])[..., 0]
    drawn = axes.T @ prior @ axes  # the prior's mean counts as one more measurement
    matrix = axes @ ((len(pieces) - 1) / len(pieces) * steps.T @ steps + drawn) @ axes.T
    return Covariance(matrix, _std_error(matrix, determined), noise_variance_of(records), inverse)


def autocorrelation_robust(
    jacobian: Arrays, residual: Arrays, *, prior_precision: np.ndarray | None = None
) -> Covariance:
    """The larger of the long-run (`uncertainty.robust_covariance`) and the jackknife covariance.

    Both hold asymptotically; on one record each is too small in its own way, the first where the fit absorbs slow
    residuals, the second where residuals stay correlated for longer than a block.
    """
    pair = [
        estimate(jacobian, residual, prior_precision=prior_precision)
        for estimate in (robust_covariance, jackknife_covariance)
    ]
    finite = np.isfinite(pair[0].std_error) & (pair[0].std_error > 0)
    sizes = [float(np.sum(np.log(np.maximum(c.std_error[finite], 1e-300)))) for c in pair]
    if not finite.any():  # no parameter on its own: compare what is known of their combinations
        sizes = [
            float(np.trace(c.matrix / np.maximum(np.diag(pair[0].matrix), 1e-300)[:, None])) for c in pair
        ]
    return pair[int(np.argmax(sizes))]


def block_bootstrap(
    jacobian: Arrays,
    residual: Arrays,
    *,
    block: int | Literal["auto", "record"] = "auto",
    prior_precision: np.ndarray | None = None,
    replicates: int = 1000,
    seed: int = 0,
) -> np.ndarray:
    """Standard errors (p,) from blocks drawn with replacement, each draw moved by one Gauss-Newton step.

    ``θ* = θ̂ + (Σ m_b H_b + P)⁻¹ (Σ m_b g_b + P (θ_0* - θ_0))`` with m_b the number of times that block b was drawn and
    θ_0* drawn from the prior. Milliseconds instead of a fit for each replicate, and right as long as the model
    is nearly linear over the spread of the replicates. An error is half of the middle 68 % of the replicates, so that
    single wild ones do not count; inf for a parameter that the data do not determine.

    Args:
        jacobian: Weighted Jacobian of one record or of several (convention: `uncertainty`).
        residual: Weighted residuals alike.
        block: Samples in a block, blocks of a record being of nearly equal length and without overlap; "record" for
            one block a record; "auto" for Carlstein's length (Ann. Stat. 14, 1986)
            ``(√6 ρ / (1 - ρ²))^(2/3) T^(1/3)`` with the largest first autocorrelation ρ of the scores.
        prior_precision: P, (p, p) or its diagonal (p,), in the unit of the weighted residuals.
        replicates: Number of draws.
        seed: Seed of the draws.
    """
    records = as_records(jacobian, residual)
    scores = [np.einsum("tyi,ty->ti", j, r) for j, r in records]
    if block == "auto":
        products = np.sum([np.sum(s[1:] * s[:-1], axis=0) for s in scores], axis=0)
        squares = np.sum([np.sum(s[:-1] ** 2, axis=0) for s in scores], axis=0)
        rho = float(np.clip(np.max(products / np.where(squares > 0, squares, 1.0)), 0.0, 0.995))
        longest = max(len(r) for _, r in records)
        carlstein = (np.sqrt(6) * rho / (1 - rho**2)) ** (2 / 3) * longest ** (1 / 3)
        plenty = sum(len(r) for _, r in records) / _MOST_BLOCKS
        block = max(int(min(max(carlstein, plenty), longest / 8)), 1)
    block_gradients, block_hessians = [], []
    for (j, r), score in zip(records, scores, strict=True):
        n_blocks = 1 if block == "record" else max(len(r) // block, 1)
        starts = np.linspace(0, len(r), n_blocks, endpoint=False).astype(int)
        block_gradients.append(np.add.reduceat(score, starts))
        block_hessians.append(np.add.reduceat(np.einsum("tyi,tyj->tij", j, j), starts))
    gradients, hessians = np.concatenate(block_gradients), np.concatenate(block_hessians)
    n_blocks, n_parameters = gradients.shape
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(n_blocks, np.full(n_blocks, 1 / n_blocks), size=replicates).astype(float)
    prior = prior_matrix(prior_precision, n_parameters)
    values, vectors = np.linalg.eigh(prior)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # P (θ_0* - θ_0) has covariance P
    pull = rng.standard_normal((replicates, n_parameters)) @ root.T

    scale, values, vectors, _ = scaled_eigen(hessians.sum(axis=0) + prior)
    axes = vectors[:, values > 1e-10] / scale[:, None]
    gradient = (counts @ gradients + pull) @ axes
    hessian = np.einsum("bij,ik,jl->bkl", hessians, axes, axes, optimize=True)
    hessian = np.tensordot(counts, hessian, axes=1) + axes.T @ prior @ axes
    # A draw may miss every block that identifies one direction; the smallest ridge keeps it finite.
    step = np.linalg.solve(hessian + 1e-9 * np.eye(axes.shape[1]), gradient[..., None])[..., 0]
    _, determined = scaled_inverse(hessians.sum(axis=0) + prior)
    minus, plus = np.quantile(step @ axes.T, [0.15866, 0.84134], axis=0)
    return np.where(determined, (plus - minus) / 2, np.inf)
