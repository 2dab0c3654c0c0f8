"""Covariance from leaving out one block of samples at a time."""

from __future__ import annotations

import numpy as np

from hybrid_id.statistics.uncertainty import (
    Arrays,
    Covariance,
    as_records,
    diagonal_scale,
    noise_variance_of,
    prior_matrix,
    robust_covariance,
    scaled_inverse,
)

BLOCKS = 30
"""Blocks that the records are cut into."""


def jackknife_covariance(
    jacobian: Arrays, residual: Arrays, *, prior_information: np.ndarray | None = None, blocks: int = BLOCKS
) -> Covariance:
    """Delete-a-block jackknife, each estimate moved by one exact Gauss-Newton step of the reduced data.

    ``V = (B - 1) / B sum_b d_b d_b'`` with ``d_b = -(H - H_b)^-1 g_b``. It corrects for the part of the residuals
    that the fit itself absorbed, which the sandwich estimate misses on one record of slowly varying residuals.
    Sources: J. G. MacKinnon, H. White, J. Econometrics 29 (1985), for single samples; J. G. MacKinnon, M. O. Nielsen,
    M. D. Webb, "Cluster-robust inference: a guide to empirical practice", J. Econometrics 232 (2023), for blocks (CR3).

    Args:
        jacobian: weighted Jacobian of one record or of several (convention: `uncertainty`).
        residual: weighted residuals alike.
        prior_information: inverse covariance of a Gaussian prior, (p, p) or its diagonal (p,).
        blocks: number of blocks over all records; no block spans two records.
    """
    records = as_records(jacobian, residual)
    samples = sum(len(r) for _, r in records)
    n_parameters, variance = records[0][0].shape[-1], noise_variance_of(records)
    pieces = []
    for j, r in records:
        share = max(1, round(blocks * len(r) / samples))
        pieces += zip(np.array_split(j, share), np.array_split(r, share), strict=True)
    gradients = np.stack([np.einsum("tyi,ty->i", j, r) for j, r in pieces])
    hessians = np.stack([np.einsum("tyi,tyj->ij", j, j) for j, _ in pieces])
    prior = prior_matrix(prior_information, n_parameters)
    information = hessians.sum(0) + prior
    inverse, determined = scaled_inverse(information)
    # axes in which the information is the identity: directions that the records do not tell are left out
    scale = diagonal_scale(information)
    values, vectors = np.linalg.eigh(inverse * np.outer(scale, scale))
    kept = values > 1e-12 * values.max()
    axes = vectors[:, kept] * np.sqrt(values[kept]) / scale[:, None]
    rest = np.eye(axes.shape[1]) - np.einsum("ik,bij,jl->bkl", axes, hessians, axes, optimize=True)
    floor = 1e-3 * np.eye(axes.shape[1])  # a block that tells a direction alone leaves nothing of it
    steps = np.linalg.solve(rest + floor, (gradients @ axes)[..., None])[..., 0]
    drawn = axes.T @ prior @ axes  # the prior's mean counts as one more measurement
    matrix = axes @ ((len(pieces) - 1) / len(pieces) * steps.T @ steps + drawn) @ axes.T
    std_error = np.where(determined, np.sqrt(np.maximum(np.diag(matrix), 0.0)), np.inf)
    longest = max(len(r) for _, r in pieces)
    return Covariance(matrix, std_error, variance, "jackknife", longest, inverse)


def autocorrelation_robust(
    jacobian: Arrays, residual: Arrays, *, prior_information: np.ndarray | None = None
) -> Covariance:
    """The larger of the long-run (`uncertainty.robust_covariance`) and the jackknife covariance.

    Both hold asymptotically; on one record each is too small in its own way, the first where the fit absorbs slow
    residuals, the second where residuals stay correlated for longer than a block.
    """
    pair = [
        estimate(jacobian, residual, prior_information=prior_information)
        for estimate in (robust_covariance, jackknife_covariance)
    ]
    finite = np.isfinite(pair[0].std_error) & (pair[0].std_error > 0)
    sizes = [float(np.sum(np.log(np.maximum(c.std_error[finite], 1e-300)))) for c in pair]
    if not finite.any():  # no parameter on its own: compare what is known of their combinations
        sizes = [
            float(np.trace(c.matrix / np.maximum(np.diag(pair[0].matrix), 1e-300)[:, None])) for c in pair
        ]
    return pair[int(np.argmax(sizes))]
