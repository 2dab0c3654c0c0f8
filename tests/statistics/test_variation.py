"""std/mean over experiments and the interval of the mean."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_id.statistics.variation import error_of_mean, prior_variances, variation

SETS = np.array([[9.0, 1.0, 5.0], [10.0, 2.0, 5.0], [11.0, 3.0, 5.0]])
NAMES = ["J", "f_3", "P_m1"]


def test_by_hand():
    result = variation(SETS, NAMES, held=["P_m1"])
    np.testing.assert_allclose(result.mean, [10, 2, 5])
    np.testing.assert_allclose(result.std, [1, 1, 0])
    np.testing.assert_allclose(result.percent, [10, 50, 0])
    np.testing.assert_array_equal(result.acceptable, [True, False, False])


def test_failed_experiments_are_left_out():
    result = variation(np.vstack([SETS, np.full(3, np.nan)]), NAMES)
    np.testing.assert_allclose(result.mean, [10, 2, 5])


def test_one_experiment_says_nothing_about_scatter():
    result = variation(SETS[:1], NAMES)
    assert np.isnan(result.percent).all() and not result.acceptable.any()


def test_no_experiment_at_all():
    result = variation(np.full((2, 3), np.nan), NAMES)
    assert not result.acceptable.any()


def test_mean_of_zero_is_infinite_percent():
    assert variation(np.array([[-1.0], [1.0]]), ["x"]).percent[0] == np.inf


@given(scale=st.floats(1e-6, 1e6), sign=st.sampled_from([-1, 1]))
def test_percent_does_not_depend_on_unit_or_sign(scale, sign):
    np.testing.assert_allclose(
        variation(sign * scale * SETS, NAMES).percent, [10, 50, 0], rtol=1e-9, atol=1e-9
    )


def test_error_of_the_mean_is_what_the_scatter_says(rng):
    samples = 3.0 + rng.standard_normal((5, 4000))  # 4000 "parameters", 5 experiments each
    error = error_of_mean(samples)
    assert np.mean(error**2) == pytest.approx(1 / 5, rel=0.05)
    assert np.isnan(error_of_mean(SETS[:1])).all()


def test_what_a_prior_is_off_by_does_not_average_out(rng):
    """Sets of one parameter each, from data of information H beside a prior of information P, simulated."""
    H, P, n, draws = 4.0, 6.0, 5, 40_000
    off = rng.standard_normal(draws) / np.sqrt(P)
    data = rng.standard_normal((draws, n)) / np.sqrt(H)
    means = ((H * data + P * off[:, None]) / (H + P)).mean(1)
    own, shared = prior_variances([np.array([[1 / (H + P)]])] * n, np.array([P]))
    expected = (1 / (H + P) - own[0, 0]) / n + shared[0]
    assert means.var() == pytest.approx(expected, rel=0.03)


def test_without_a_prior_nothing_is_shared():
    own, shared = prior_variances([np.eye(2)] * 3, np.zeros(2))
    assert not own.any() and not shared.any()
