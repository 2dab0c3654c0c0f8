"""Bootstrap over blocks of samples or over records: cheap by one Gauss-Newton step, or by full re-fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hybrid_id.statistics.long_run import lag_one_correlation
from hybrid_id.statistics.uncertainty import (
    Arrays,
    as_records,
    diagonal_scale,
    prior_matrix,
    scaled_inverse,
)

_MOST_BLOCKS = 1000  # more of them cost time and tell no more


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Replicates of an estimate.

    Attributes:
        samples: (n_replicates, p).
        std_error: (p,), from the middle 68 % of the replicates, so that single wild ones do not count; inf for
            parameters that the data do not determine.
        lower, upper: Percentile interval (p,) at `level`.
        level: Confidence.
        n_blocks: Number of blocks that were drawn from.
    """

    samples: np.ndarray
    std_error: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    level: float
    n_blocks: int


@dataclass(frozen=True, eq=False)
class BlockContributions:
    """What each block adds to the normal equations at the estimate.

    Attributes:
        gradients: ``Σ Jᵀ r`` of each block (n_blocks, p).
        hessians: ``Σ Jᵀ J`` of each block (n_blocks, p, p).
        block_length: Samples in a block; 0 for whole records.
    """

    gradients: np.ndarray
    hessians: np.ndarray
    block_length: int


def block_contributions(
    jacobian: Arrays, residual: Arrays, *, block: int | Literal["auto", "record"] = "auto"
) -> BlockContributions:
    """Cuts records into blocks that do not overlap, of nearly equal length.

    Args:
        jacobian: Weighted Jacobian of one record or of several (convention: `uncertainty`).
        residual: Weighted residuals alike.
        block: Samples in a block; "record" for one block a record; "auto" for Carlstein's length (Ann. Stat. 14,
            1986) ``(√6 ρ / (1 - ρ²))^(2/3) T^(1/3)`` with the largest first autocorrelation ρ of the scores.
    """
    records = as_records(jacobian, residual)
    longest = max(len(r) for _, r in records)
    if block == "auto":
        scores = [np.einsum("tyi,ty->ti", j, r) for j, r in records]
        rho = float(np.clip(np.max(lag_one_correlation(scores)), 0.0, 0.995))
        carlstein = (np.sqrt(6) * rho / (1 - rho**2)) ** (2 / 3) * longest ** (1 / 3)
        plenty = sum(len(r) for _, r in records) / _MOST_BLOCKS
        block = max(int(min(max(carlstein, plenty), longest / 8)), 1)
    gradients, hessians = [], []
    for j, r in records:
        n_blocks = 1 if block == "record" else max(len(r) // block, 1)
        starts = np.linspace(0, len(r), n_blocks, endpoint=False).astype(int)
        gradients.append(np.add.reduceat(np.einsum("tyi,ty->ti", j, r), starts))
        hessians.append(np.add.reduceat(np.einsum("tyi,tyj->tij", j, j), starts))
    gradients, hessians = np.concatenate(gradients), np.concatenate(hessians)
    return BlockContributions(gradients, hessians, 0 if block == "record" else block)


def one_step_bootstrap(
    estimate: np.ndarray,
    blocks: BlockContributions,
    *,
    prior_information: np.ndarray | None = None,
    prior_mean: np.ndarray | None = None,
    replicates: int = 1000,
    level: float = 0.95,
    seed: int = 0,
) -> Bootstrap:
    """Blocks drawn with replacement, each replicate moved by one Gauss-Newton step from the estimate.

    ``θ* = θ̂ + (Σ m_b H_b + P)⁻¹ (Σ m_b g_b + P (θ_0* - θ̂))`` with m_b the number of times that block b was drawn and
    θ_0* drawn from the prior. Milliseconds instead of a fit for each replicate, and right as long as the model
    is nearly linear over the spread of the replicates.

    Args:
        estimate: θ̂ (p,).
        blocks: From `block_contributions`.
        prior_information: P, (p, p) or its diagonal (p,), in the unit of the weighted residuals.
        prior_mean: θ_0 (p,); the estimate where absent.
        replicates: Number of draws.
        level: Confidence of the percentile interval.
        seed: Seed of the draws.
    """
    estimate = np.asarray(estimate, float)
    n_blocks, n_parameters = blocks.gradients.shape
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(n_blocks, np.full(n_blocks, 1 / n_blocks), size=replicates).astype(float)
    prior = prior_matrix(prior_information, n_parameters)
    centre = estimate if prior_mean is None else np.asarray(prior_mean, float)
    values, vectors = np.linalg.eigh(prior)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # P (θ_0* - θ_0) has covariance P
    pull = (centre - estimate) @ prior + rng.standard_normal((replicates, n_parameters)) @ root.T

    information = blocks.hessians.sum(axis=0) + prior
    scale = diagonal_scale(information)
    directions = np.linalg.eigh(information / np.outer(scale, scale))
    kept = directions.eigenvectors[:, directions.eigenvalues > 1e-10] / scale[:, None]
    gradient = (counts @ blocks.gradients + pull) @ kept
    hessian = np.einsum("bij,ik,jl->bkl", blocks.hessians, kept, kept, optimize=True)
    hessian = np.tensordot(counts, hessian, axes=1) + kept.T @ prior @ kept
    # A draw may miss every block that tells one direction; the smallest ridge keeps it finite.
    step = np.linalg.solve(hessian + 1e-9 * np.eye(kept.shape[1]), gradient[..., None])[..., 0]
    _, determined = scaled_inverse(information)
    return _summarise(estimate + step @ kept.T, level, n_blocks, determined)


def refit_bootstrap(
    refit: Callable[[np.ndarray], np.ndarray],
    n_blocks: int,
    *,
    replicates: int = 200,
    level: float = 0.95,
    seed: int = 0,
) -> Bootstrap:
    """Blocks (records, say) drawn with replacement, each replicate fitted anew.

    Args:
        refit: ``refit(indices)`` -> estimate (p,) from the blocks with these numbers (n_blocks,); values that are not
            finite mark a failed fit, which is left out.
        n_blocks: Number of blocks.
        replicates: Number of draws.
        level: Confidence of the percentile interval.
        seed: Seed of the draws.
    """
    rng = np.random.default_rng(seed)
    samples = np.stack([refit(rng.integers(n_blocks, size=n_blocks)) for _ in range(replicates)])
    samples = samples[np.all(np.isfinite(samples), axis=1)]
    return _summarise(samples, level, n_blocks, np.full(samples.shape[1], True))


def _summarise(samples: np.ndarray, level: float, n_blocks: int, determined: np.ndarray) -> Bootstrap:
    quantiles = [0.5 - level / 2, 0.15866, 0.84134, 0.5 + level / 2]
    lower, minus, plus, upper = np.quantile(samples, quantiles, axis=0)
    std_error = np.where(determined, (plus - minus) / 2, np.inf)
    return Bootstrap(samples, std_error, lower, upper, level, n_blocks)
