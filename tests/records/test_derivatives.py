"""Adaptive local polynomials: exact where they must be, close to the best fixed window where noise rules."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from hybrid_id.errors import InputError
from hybrid_id.records.derivatives import noise_level, smooth_derivatives

STEP = 0.002
TIME = STEP * np.arange(4000)


def stop_and_go():
    """A motion that rests for a second, moves with a jump in acceleration, and rests again."""
    moving = (TIME > 1) & (TIME < 6)
    phase = np.where(moving, TIME - 1, 0.0)
    omega = 2 * np.pi * 1.2
    value = np.where(TIME < 1, 0.0, np.where(moving, 1 - np.cos(omega * phase), 1 - np.cos(omega * 5)))
    return value, np.where(moving, omega * np.sin(omega * phase), 0.0)


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


@given(coefficients=st.lists(st.floats(-2, 2), min_size=4, max_size=4))
def test_a_cubic_comes_back_exactly_up_to_both_ends(coefficients):
    time = TIME[:300]
    cubic = np.poly1d(coefficients)
    value, slope, curvature = smooth_derivatives(cubic(time), STEP, noise_std=1e-3)
    np.testing.assert_allclose(value, cubic(time), atol=1e-9)
    np.testing.assert_allclose(slope, cubic.deriv()(time), atol=1e-8)
    np.testing.assert_allclose(curvature, cubic.deriv(2)(time), atol=1e-5)


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
def test_close_to_the_best_fixed_window_which_nobody_knows(noise, rng):
    truth, speed = stop_and_go()
    y = truth + noise * rng.standard_normal(TIME.size)
    value, slope, _ = smooth_derivatives(y, STEP)
    best = [
        min(
            rms(savgol_filter(y, 2 * half + 1, 3, deriv=d, delta=STEP) - true)
            for half in (4, 8, 15, 27, 48, 88)
        )
        for d, true in enumerate((truth, speed))
    ]
    assert rms(value - truth) < 1.5 * best[0]
    assert rms(slope - speed) < 1.3 * best[1]


def test_coarse_encoder_gives_no_spikes():
    truth, speed = stop_and_go()
    quantum = 2 * np.pi / 4096
    _, slope, _ = smooth_derivatives(np.round(truth / quantum) * quantum, STEP)
    assert rms(slope - speed) < 0.01 * rms(speed)


def test_noise_level_is_the_truth_and_motion_does_not_raise_it(rng):
    truth, _ = stop_and_go()
    assert noise_level(truth + 3e-3 * rng.standard_normal(TIME.size)) == pytest.approx(3e-3, rel=0.1)
    assert noise_level(np.round(truth / 0.01) * 0.01) == pytest.approx(0.005)
    assert noise_level(np.zeros(100)) == 0.0


def test_batch_equals_loop_with_one_noise_each(rng):
    truth, _ = stop_and_go()
    noise = np.array([[1e-4], [3e-3]])
    y = truth + noise * rng.standard_normal((2, TIME.size))
    together = smooth_derivatives(y, STEP, noise[:, 0])
    for row in range(2):
        alone = smooth_derivatives(y[row], STEP, noise[row, 0])
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_allclose(a[row], b, atol=1e-9)


def test_jittered_stamps_cost_little_accuracy(rng):
    stamps = TIME + rng.uniform(-0.1, 0.1, TIME.size) * STEP
    truth, speed = (np.interp(stamps, TIME, x) for x in stop_and_go())
    y = truth + 1e-3 * rng.standard_normal(TIME.size)
    _, on_stamps, _ = smooth_derivatives(y, stamps)
    _, as_if_uniform, _ = smooth_derivatives(y, STEP, noise_std=1e-3)
    assert rms(on_stamps - speed) < 1.2 * rms(as_if_uniform - speed)


def test_too_few_samples_are_refused():
    with pytest.raises(InputError, match="too few"):
        smooth_derivatives(np.zeros(4), STEP)


@pytest.mark.parametrize("stamps", [STEP, np.cumsum(np.linspace(0.5, 1.5, 50)) * STEP])
def test_a_constant_record_is_at_rest(stamps):
    y = np.stack([np.full(50, -0.37), np.sin(np.arange(50.0))])
    value, slope, curvature = smooth_derivatives(y, stamps)
    assert np.all(value[0] == -0.37) and not slope[0].any() and not curvature[0].any()
    assert np.all(slope[1] != 0.0)
