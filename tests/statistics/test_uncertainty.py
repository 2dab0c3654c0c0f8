"""Covariances against linear regressions whose covariance is known."""

# pyright: reportCallIssue=false

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from hybrid_id.statistics.uncertainty import (
    autocorrelation_robust,
    block_bootstrap,
    covariance,
    jackknife_covariance,
    normal_interval,
    robust_covariance,
)


def test_plain_is_the_textbook_for_white_noise(regression, least_squares):
    design, noise, truth = regression(n_samples=2000)
    result = covariance(design, least_squares(design, noise[0])[1])
    np.testing.assert_allclose(result.matrix, truth, rtol=0.1, atol=1e-6)
    assert result.noise_variance == pytest.approx(1, rel=0.1)


ROBUST = pytest.mark.parametrize("way", [robust_covariance, jackknife_covariance])


@ROBUST
@pytest.mark.parametrize("correlation", [0.7, 0.95, 0.98])
def test_plain_is_too_confident_for_correlated_noise_and_robust_is_right(
    correlation, regression, least_squares, way
):
    design, noise, truth = regression(correlation=correlation, replicates=20)
    residuals = [least_squares(design, e)[1] for e in noise]
    true_error = np.sqrt(np.diag(truth))
    plain = np.mean([covariance(design, r).std_error for r in residuals], axis=0) / true_error
    robust = np.mean([way(design, r).std_error for r in residuals], axis=0) / true_error
    assert plain.max() < 1.1 * np.sqrt((1 - correlation) / (1 + correlation))
    np.testing.assert_allclose(robust, 1, atol=0.2)


def test_intervals_cover_as_often_as_they_say_under_correlation(regression, least_squares):
    design, noise, _ = regression(correlation=0.9, replicates=200, seed=1)
    robust, plain = [], []
    for e in noise:
        estimate, residual = least_squares(design, e)
        for found, way in ((robust, robust_covariance), (plain, covariance)):
            lower, upper = normal_interval(estimate, way(design, residual).std_error, 0.95).T
            found.append((lower < 0) & (upper > 0))
    assert 0.90 < np.mean(robust) < 0.98
    assert np.mean(plain) < 0.6


def test_an_oscillating_sensitivity_is_not_mistaken_for_a_slow_one():
    """Slow residuals hardly touch a fast sensitivity; a first-order filter would say 3 times too much."""
    rng = np.random.default_rng(3)
    time = np.arange(4000)
    design = np.stack([np.ones(4000), np.cos(2 * np.pi * time / 100)], axis=1)
    noise = lfilter([np.sqrt(1 - 0.99**2)], [1, -0.99], rng.standard_normal((60, 8000)), axis=1)[:, 4000:]
    estimates, errors = [], []
    for e in noise:
        estimate = np.linalg.lstsq(design, e, rcond=None)[0]
        estimates.append(estimate)
        errors.append(robust_covariance(design, e - design @ estimate).std_error)
    np.testing.assert_allclose(np.mean(errors, axis=0) / np.std(estimates, axis=0), 1, atol=0.35)


@given(scales=st.lists(st.floats(-6, 6), min_size=2, max_size=2))
def test_units_do_not_matter(scales, regression):
    design, noise, _ = regression(n_samples=500, correlation=0.5)
    unit = 10.0 ** np.array(scales)
    for way in (covariance, robust_covariance):
        np.testing.assert_allclose(
            way(design * unit, noise[0]).std_error * unit, way(design, noise[0]).std_error, rtol=1e-6
        )


def test_undetermined_parameters_have_infinite_errors_and_the_others_keep_theirs(rng):
    column = rng.standard_normal((400, 2))
    jacobian = np.column_stack([column[:, 0], 3 * column[:, 0], column[:, 1]])
    for way in (covariance, robust_covariance, jackknife_covariance):
        error = way(jacobian, rng.standard_normal(400)).std_error
        assert np.isinf(error[:2]).all()
        assert error[2] == pytest.approx(1 / 20, rel=0.2)


def test_perfect_residuals_do_not_break_it(regression):
    design, _, _ = regression(n_samples=100)
    assert np.all(np.isfinite(robust_covariance(design, np.zeros(100)).std_error))


def test_records_that_tell_nothing_leave_no_standard_error():
    result = robust_covariance(np.zeros((10, 3)), np.linspace(-1, 1, 10))
    assert np.all(np.isinf(result.std_error))


@pytest.mark.parametrize("scale", [0.3, 3.0], ids=["less noise than declared", "more"])
def test_beside_a_prior_errors_are_those_of_the_fit_that_weighs_noise_as_declared(scale, rng):
    """Estimates of many simulated records, each with a prior whose mean is drawn, against every way of the package."""
    design = rng.standard_normal((400, 2)) @ np.array([[1.0, 0.9], [0.0, 0.3]])
    prior = np.array([600.0, 0.0])
    hessian = design.T @ design
    inverse = np.linalg.inv(hessian + np.diag(prior))
    noise = scale * rng.standard_normal((3000, 400))
    means = rng.standard_normal((3000, 2)) * np.array([prior[0] ** -0.5, 0.0])
    found = (noise @ design + means * prior) @ inverse
    scatter = found.std(axis=0)
    residual = noise[0] - design @ found[0]
    for way in (covariance, robust_covariance, jackknife_covariance):
        error = way(design, residual, prior_precision=prior).std_error
        np.testing.assert_allclose(error, scatter, rtol=0.25 if way is not covariance else 0.08)
    drawn = block_bootstrap(design, residual, block=10, prior_precision=prior)
    np.testing.assert_allclose(drawn, scatter, rtol=0.25)


def test_the_larger_of_the_two_robust_ways_is_used(regression, least_squares):
    design, noise, _ = regression(n_samples=1500, correlation=0.9)
    residual = least_squares(design, noise[0])[1]
    both = [way(design, residual).std_error for way in (robust_covariance, jackknife_covariance)]
    used = autocorrelation_robust(design, residual).std_error
    assert any(np.array_equal(used, one) for one in both)
    assert np.prod(used) >= max(np.prod(one) for one in both) - 1e-30


@pytest.mark.filterwarnings("error")
def test_parameter_that_moves_nothing_is_not_told(rng):
    jacobian = rng.normal(size=(200, 1, 3))
    jacobian[..., 1] = 0.0
    told = jackknife_covariance(jacobian, rng.normal(size=(200, 1)))
    assert np.isinf(told.std_error[1])
    assert np.isfinite(told.std_error[[0, 2]]).all()
