"""Delete-a-block jackknife: right for white residuals, and for slow ones, where plain is too confident."""

import numpy as np
import pytest

from hybrid_id.statistics.uncertainty import (
    autocorrelation_robust,
    covariance,
    jackknife_covariance,
    robust_covariance,
)


def regressions(rng, persistence, n_runs=200, n_samples=1500):
    """Estimates and jackknife standard errors of a regression on two slow sines with AR(1) noise."""
    time = np.arange(n_samples)
    jacobian = np.stack([np.sin(2 * np.pi * time / 97), np.cos(2 * np.pi * time / 41)], 1)
    for _ in range(n_runs):
        noise = np.zeros(n_samples)
        shocks = rng.normal(size=n_samples)
        for k in range(1, n_samples):
            noise[k] = persistence * noise[k - 1] + shocks[k]
        estimate = np.linalg.lstsq(jacobian, noise, rcond=None)[0]
        yield estimate, jacobian, noise - jacobian @ estimate


def test_white_residuals_give_the_plain_covariance(rng):
    ratios = [
        jackknife_covariance(j, r).std_error / covariance(j, r).std_error
        for _, j, r in regressions(rng, 0.0, n_runs=60)
    ]
    np.testing.assert_allclose(np.mean(ratios, 0), 1.0, atol=0.1)


def test_slow_residuals_are_covered(rng):
    found = list(regressions(rng, 0.9))
    estimates = np.array([e for e, *_ in found])
    errors = np.mean([jackknife_covariance(j, r).std_error for _, j, r in found], 0)
    np.testing.assert_allclose(errors, estimates.std(0), rtol=0.25)
    plain = np.mean([covariance(j, r).std_error for _, j, r in found], 0)
    assert np.all(plain < 0.7 * estimates.std(0))


def test_null_direction_and_prior(rng):
    column = rng.normal(size=(600, 1))
    jacobian, residual = np.hstack([column, column]), rng.normal(size=600)
    found = jackknife_covariance(jacobian, residual)
    assert np.all(np.isinf(found.std_error))
    assert np.isclose(np.ones(2) @ found.matrix @ np.ones(2), 1 / np.sum(column**2), rtol=0.6)
    held = jackknife_covariance(jacobian, residual, prior_precision=np.array([100.0, 0.0]))
    assert np.isclose(held.std_error[0], 0.1, rtol=0.2)


@pytest.mark.filterwarnings("error")
def test_parameter_that_moves_nothing_is_not_told(rng):
    jacobian = rng.normal(size=(200, 1, 3))
    jacobian[..., 1] = 0.0
    told = jackknife_covariance(jacobian, rng.normal(size=(200, 1)))
    assert np.isinf(told.std_error[1])
    assert np.isfinite(told.std_error[[0, 2]]).all()


def test_the_larger_of_the_two_is_used(rng):
    _, jacobian, residual = next(regressions(rng, 0.9, n_runs=1))
    both = [f(jacobian, residual).std_error for f in (robust_covariance, jackknife_covariance)]
    used = autocorrelation_robust(jacobian, residual).std_error
    assert any(np.array_equal(used, one) for one in both)
    assert np.prod(used) >= max(np.prod(one) for one in both) - 1e-30
