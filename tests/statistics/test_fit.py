"""Fit in %, by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hybrid_id.statistics.fit import fit_percent, nrmse, rmse


def test_perfect_mean_and_by_hand():
    y = np.array([0.0, 1.0, 2.0, 3.0])
    assert fit_percent(y, y) == 100
    assert fit_percent(y, np.full(4, 1.5)) == pytest.approx(0)
    # ‖error‖ = 0.2, ‖y - mean‖ = sqrt(5)
    assert fit_percent(y, y + 0.1) == pytest.approx(100 * (1 - 0.2 / np.sqrt(5)))


def test_divergence_is_minus_infinity_and_a_constant_measurement_has_no_fit():
    y = np.array([0.0, 1.0, 2.0])
    assert fit_percent(y, np.array([0.0, np.nan, 2.0])) == -np.inf
    assert fit_percent(y, np.array([0.0, np.inf, 2.0])) == -np.inf
    assert np.isnan(fit_percent(np.full(3, 0.1), y))


def test_a_joint_that_stays_within_a_count_of_its_encoder_stands_still():
    count, time = 2 * np.pi / 4096, np.arange(500)
    rests = 0.57 + count * (time % 97 > 80)
    assert np.isnan(nrmse(rests, np.full(500, 0.575)))
    moves = count * np.round(20 * np.sin(0.02 * time))
    assert nrmse(moves, moves + count) == pytest.approx(count / moves.std())
    both = nrmse(np.stack([rests, moves]), np.stack([rests, moves]))
    assert np.isnan(both[0]) and both[1] == 0.0


def test_many_simulations_face_one_measurement(rng):
    y, simulated = rng.standard_normal(50), rng.standard_normal((4, 50))
    np.testing.assert_allclose(nrmse(y, simulated), [nrmse(y, one) for one in simulated])


@given(y=arrays(float, 20, elements=st.floats(-10, 10)), scale=st.floats(0.1, 10), offset=st.floats(-5, 5))
def test_fit_does_not_depend_on_unit_or_origin(y, scale, offset):
    y = y + np.linspace(0, 1, 20)
    simulated = 0.9 * y
    before, after = fit_percent(y, simulated), fit_percent(scale * y + offset, scale * simulated + offset)
    assert after == pytest.approx(before, abs=1e-6) or np.std(y) < 1e-6


def test_rmse_is_in_the_unit_of_the_signal() -> None:
    measured = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0, 4.0]])
    off = np.array([[3.0, -3.0, 3.0, -3.0], [1.0, 2.0, 3.0, 6.0]])
    assert rmse(measured, off).tolist() == [3.0, 1.0]
    assert rmse(measured[0], np.array([0.0, np.nan, 0.0, 0.0])) == np.inf  # diverged
