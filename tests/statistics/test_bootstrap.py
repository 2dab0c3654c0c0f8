"""Block and record bootstrap against known covariances and against full re-fits."""

import numpy as np
import pytest

from hybrid_id.statistics.uncertainty import block_bootstrap, covariance


def test_blocks_see_autocorrelation_and_single_samples_do_not(regression, least_squares):
    design, noise, truth = regression(n_samples=2000, correlation=0.9, replicates=6)
    residuals = [least_squares(design, e)[1] for e in noise]
    ratios = {
        block: np.mean([block_bootstrap(design, r, block=block) for r in residuals], 0)
        / np.diag(truth) ** 0.5
        for block in ("auto", 1)
    }
    np.testing.assert_allclose(ratios["auto"], 1, atol=0.2)
    assert np.max(ratios[1]) < 0.4


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
    minus, plus = np.quantile(full, [0.15866, 0.84134], axis=0)
    cheap = block_bootstrap(jacobians, residuals, block="record", replicates=4000)
    np.testing.assert_allclose(cheap, (plus - minus) / 2, rtol=0.1)


def test_record_blocks_see_parameters_that_differ_from_record_to_record(rng):
    jacobians = [rng.standard_normal((200, 1)) for _ in range(15)]
    residuals = [j[:, 0] * 0.3 * rng.standard_normal() + rng.standard_normal(200) for j in jacobians]
    total = np.mean([(j[:, 0] @ r) / (j[:, 0] @ j[:, 0]) for j, r in zip(jacobians, residuals, strict=True)])
    residuals = [r - j[:, 0] * total for j, r in zip(jacobians, residuals, strict=True)]
    (records,), (samples,) = (block_bootstrap(jacobians, residuals, block=block) for block in ("record", 10))
    assert records == pytest.approx(np.hypot(0.3, 1 / np.sqrt(200)) / np.sqrt(15), rel=0.4)
    assert records > 2 * samples


def test_blocks_of_white_noise_agree_with_the_plain_covariance_and_a_seed_repeats(regression, least_squares):
    design, noise, _ = regression(n_samples=1500)
    residual = least_squares(design, noise[0])[1]
    first, second = (block_bootstrap(design, residual, replicates=2000, seed=7) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(first, covariance(design, residual).std_error, rtol=0.15)
