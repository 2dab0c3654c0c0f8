"""DFT differentiation: exact for whole periods, ends dealt with and said elsewhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_id.errors import InputError
from hybrid_id.records.derivatives import differentiate

STEP = 0.002
TIME = STEP * np.arange(5000)  # 10 s


def sine(frequency, phase=0.3):
    """Value, first and second derivative (3, T)."""
    omega = 2 * np.pi * frequency
    angle = omega * TIME + phase
    return np.stack([np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)])


def relative_errors(result, truth, where=slice(None)):
    found = np.stack([result.position, result.velocity, result.acceleration])
    error = (found - truth)[:, where]
    return np.sqrt(np.mean(error**2, axis=1)) / np.std(truth, axis=1)


def test_whole_periods_are_exact_and_all_valid():
    result = differentiate(sine(1.2)[0], STEP, band=(0, 10))
    assert result.periodic
    assert np.all(result.valid)
    assert relative_errors(result, sine(1.2)).max() < 1e-12


def test_part_of_a_period_is_recognised_and_said():
    truth = sine(1.237)
    result = differentiate(truth[0], STEP, band=(0, 10))
    assert not result.periodic
    np.testing.assert_array_equal(np.flatnonzero(~result.valid), np.r_[:100, 4900:5000])
    assert np.all(relative_errors(result, truth, result.valid) < [1e-4, 1e-3, 2e-3])


def test_trend_and_sine_are_both_differentiated():
    trend = np.stack([TIME + 0.1 * TIME**2, 1 + 0.2 * TIME, np.full(TIME.size, 0.2)])
    truth = sine(1.237) + trend
    result = differentiate(truth[0], STEP, band=(0, 10))
    assert np.all(relative_errors(result, truth, result.valid) < [1e-5, 1e-3, 2e-3])
    # and what is marked is marked for a reason
    assert (
        relative_errors(result, truth, ~result.valid)[2]
        > 10 * relative_errors(result, truth, result.valid)[2]
    )


def test_a_lowest_frequency_takes_the_trend_away():
    y = sine(1.237)[0] + 0.2 * TIME + 0.02 * TIME**2
    result = differentiate(y, STEP, band=(0.5, 10))
    assert np.all(relative_errors(result, sine(1.237), result.valid) < [0.03, 0.01, 0.01])
    unfiltered = differentiate(y, STEP, band=(0, 10))
    assert relative_errors(unfiltered, sine(1.237), result.valid)[0] > 1


def test_out_of_band_tones_are_dropped_exactly_from_a_periodic_record():
    slow, wanted, fast = sine(0.2), sine(1.2), sine(30.0)
    result = differentiate(slow[0] + wanted[0] + 0.1 * fast[0], STEP, band=(0.5, 10))
    assert relative_errors(result, wanted).max() < 1e-12


def test_noise_that_remains_is_the_share_of_the_band(rng):
    noise = 1e-2 * rng.standard_normal((40, TIME.size))
    truth = sine(1.2)
    result = differentiate(truth[0] + noise, STEP, band=(0, 10))
    share = 2 * 10 * STEP
    speed_gain = 2 * np.pi * 10 / np.sqrt(3)
    assert np.std(result.position - truth[0]) == pytest.approx(1e-2 * np.sqrt(share), rel=0.05)
    assert np.std(result.velocity - truth[1]) == pytest.approx(1e-2 * np.sqrt(share) * speed_gain, rel=0.05)


def test_noise_does_not_spoil_the_ends_of_valid_samples(rng):
    truth = sine(1.237)
    noise = 1e-3 * rng.standard_normal((20, TIME.size))
    result = differentiate(truth[0] + noise, STEP, band=(0, 10))
    error = np.sqrt(np.mean((result.acceleration - truth[2]) ** 2, axis=0))
    near, middle = error[[105, 4894]].mean(), error[2000:3000].mean()
    assert near < 2 * middle


def test_band_is_found_from_the_noise_floor(rng):
    y = sine(1.237)[0] + 1e-3 * rng.standard_normal(TIME.size)
    result = differentiate(y, STEP)
    assert 1.3 < result.band[1] < 8
    assert np.all(relative_errors(result, sine(1.237), result.valid) < [1e-3, 2e-3, 1e-2])


def test_batch_equals_loop_and_each_record_is_judged_by_itself():
    y = np.stack([sine(1.2)[0], sine(1.237)[0]])
    together = differentiate(y, STEP, band=(0, 10))
    np.testing.assert_array_equal(together.periodic, [True, False])
    for row in range(2):
        alone = differentiate(y[row], STEP, band=(0, 10))
        np.testing.assert_allclose(together.acceleration[row], alone.acceleration, atol=1e-9)
        np.testing.assert_array_equal(together.valid[row], alone.valid)


@given(periods=st.integers(2, 40), phase=st.floats(0, 6), excess=st.floats(0.1, 0.9))
def test_whole_and_broken_numbers_of_periods_are_told_apart(periods, phase, excess):
    assert differentiate(sine(periods / 10, phase)[0], STEP, band=(0, 10)).periodic
    assert not differentiate(sine((periods + excess) / 10, phase)[0], STEP, band=(0, 10)).periodic


@pytest.mark.parametrize(
    ("samples", "band", "words"),
    [(8, None, "too few"), (100, (5, 5), "empty"), (100, (0, 300), "leaves 0 to 250")],
)
def test_bad_input_is_refused_in_words(samples, band, words):
    with pytest.raises(InputError, match=words):
        differentiate(np.zeros(samples), STEP, band=band)
