"""Block and record bootstrap against known covariances and against full re-fits."""

import numpy as np
import pytest

from hybrid_id.statistics.uncertainty import (
    block_contributions,
    covariance,
    one_step_bootstrap,
)


def test_blocks_see_autocorrelation_and_single_samples_do_not(regression, least_squares):
    design, noise, truth = regression(n_samples=2000, correlation=0.9, replicates=6)
    true_error = np.sqrt(np.diag(truth))
    ratios = {"auto": [], 1: []}
    for e in noise:
        estimate, residual = least_squares(design, e)
        for block, found in ratios.items():
            blocks = block_contributions(design, residual, block=block)
            found.append(one_step_bootstrap(estimate, blocks).std_error / true_error)
    np.testing.assert_allclose(np.mean(ratios["auto"], axis=0), 1, atol=0.2)
    assert np.max(np.mean(ratios[1], axis=0)) < 0.4


def test_one_step_equals_full_refits_for_a_linear_model(rng, least_squares):
    jacobians = [rng.standard_normal((60, 2)) for _ in range(12)]
    ys = [j @ [1.0, 2.0] + rng.standard_normal(60) for j in jacobians]
    estimate, _ = least_squares(np.concatenate(jacobians), np.concatenate(ys))
    residuals = [y - j @ estimate for y, j in zip(ys, jacobians, strict=True)]

    def refit(indices):
        return least_squares(
            np.concatenate([jacobians[k] for k in indices]), np.concatenate([ys[k] for k in indices])
        )[0]

    full = np.array([refit(rng.integers(12, size=12)) for _ in range(1000)])
    cheap = one_step_bootstrap(
        estimate, block_contributions(jacobians, residuals, block="record"), replicates=4000
    )
    minus, plus, upper = np.quantile(full, [0.15866, 0.84134, 0.975], axis=0)
    assert cheap.n_blocks == 12
    np.testing.assert_allclose(cheap.std_error, (plus - minus) / 2, rtol=0.1)
    np.testing.assert_allclose(cheap.upper, upper, atol=0.03)


def test_record_blocks_see_parameters_that_differ_from_record_to_record(rng):
    jacobians = [rng.standard_normal((200, 1)) for _ in range(15)]
    residuals = [j[:, 0] * 0.3 * rng.standard_normal() + rng.standard_normal(200) for j in jacobians]
    total = (
        sum(float((j[:, 0] @ r) / (j[:, 0] @ j[:, 0])) for j, r in zip(jacobians, residuals, strict=True))
        / 15
    )
    residuals = [r - j[:, 0] * total for j, r in zip(jacobians, residuals, strict=True)]
    records = one_step_bootstrap(np.zeros(1), block_contributions(jacobians, residuals, block="record"))
    samples = one_step_bootstrap(np.zeros(1), block_contributions(jacobians, residuals, block=10))
    assert records.std_error[0] == pytest.approx(np.hypot(0.3, 1 / np.sqrt(200)) / np.sqrt(15), rel=0.4)
    assert records.std_error[0] > 2 * samples.std_error[0]


def test_prior_holds_what_the_blocks_do_not_tell(rng):
    jacobian = np.column_stack([rng.standard_normal(300), np.zeros(300)])
    blocks = block_contributions(jacobian, rng.standard_normal(300), block=1)
    alone = one_step_bootstrap(np.array([1.0, 5.0]), blocks)
    assert np.isinf(alone.std_error[1]) and np.isfinite(alone.std_error[0])
    held = one_step_bootstrap(
        np.array([1.0, 5.0]), blocks, prior_precision=np.array([0, 4.0]), replicates=4000
    )
    assert held.std_error[1] == pytest.approx(0.5, rel=0.1)
    assert held.std_error[0] == pytest.approx(alone.std_error[0], rel=0.15)


def test_same_seed_same_replicates_and_blocks_cover_every_sample(regression):
    design, noise, _ = regression(n_samples=503)
    blocks = block_contributions([design, design[:101]], [noise[0], noise[0, :101]], block=50)
    np.testing.assert_allclose(blocks.hessians.sum(axis=0), design.T @ design + design[:101].T @ design[:101])
    first, second = (one_step_bootstrap(np.zeros(2), blocks, replicates=20, seed=7).samples for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_automatic_block_is_one_sample_for_white_noise(regression, least_squares):
    design, noise, _ = regression(n_samples=1500)
    residual = least_squares(design, noise[0])[1]
    assert block_contributions(design, residual).block_length <= 3
    errors = one_step_bootstrap(np.zeros(2), block_contributions(design, residual), replicates=2000).std_error
    np.testing.assert_allclose(errors, covariance(design, residual).std_error, rtol=0.15)
