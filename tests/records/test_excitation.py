"""Multisine design: the crest factor is low, honest between the samples, and inside the limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid_id.errors import InputError
from hybrid_id.records.excitation import (
    Multisine,
    design_multisine,
    schroeder_phases,
    usual_tones,
)

FAST = {"sample_time": 0.01, "duration": 10.0, "amplitude_limits": 10.0, "starts": 2}


def crest_factor(harmonics, phases, points=200):
    time = np.arange(points * max(harmonics)) / (points * max(harmonics))
    signal = np.cos(2 * np.pi * np.outer(time, harmonics) + phases).sum(axis=1)
    return np.abs(signal).max() / np.sqrt(np.mean(signal**2))


def on_fine_grid(design: Multisine) -> np.ndarray:
    """One period at 200 points per period of the highest tone."""
    return design.at(np.arange(0, design.period, 1 / (200 * design.frequencies[-1])))


@pytest.mark.parametrize("highest", [2.0, 3.9], ids=["all", "odd"])
def test_twenty_flat_tones_reach_1_42(highest):
    design = design_multisine((0.1, highest), tones=20, **{**FAST, "starts": 150})
    np.testing.assert_allclose(design.frequencies, np.linspace(0.1, highest, 20))
    signal = on_fine_grid(design)
    assert np.abs(signal).max() / np.sqrt(np.mean(signal**2)) <= 1.42
    assert design.crest_factor <= 1.42


def test_start_and_random_phases_are_as_bad_as_published():
    harmonics = np.arange(1, 21)
    rng = np.random.default_rng(0)
    random = np.median([crest_factor(harmonics, rng.uniform(0, 2 * np.pi, 20)) for _ in range(50)])
    assert 1.7 < crest_factor(harmonics, schroeder_phases(np.ones(20))) < 1.8
    assert random > 2.5


def test_schroeder_of_equal_powers_is_the_closed_form():
    k = np.arange(1, 13)
    np.testing.assert_allclose(schroeder_phases(np.ones(12)), -np.pi * k * (k - 1) / 12)


def test_signal_holds_the_tones_that_were_asked_for_and_no_others():
    design = design_multisine((0.1, 2.0), **FAST)
    spectrum = np.abs(np.fft.rfft(design.signal)) / (len(design.signal) / 2)
    tones = np.round(design.frequencies * 10).astype(int)
    np.testing.assert_allclose(spectrum[tones], design.amplitudes, rtol=1e-9)
    assert np.delete(spectrum, tones).max() < 1e-10
    np.testing.assert_allclose(design.at(design.time), design.signal, atol=1e-9)


def test_limits_may_lie_to_one_side():
    design = design_multisine((0.1, 2.0), **{**FAST, "amplitude_limits": (2.0, 10.0)})
    assert design.offset == 6.0
    signal = on_fine_grid(design)
    assert signal.min() >= 2.0 and signal.max() <= 10.0
    assert np.abs(signal - 6.0).max() > 0.995 * 4.0


def test_predicted_speed_keeps_its_limit_and_the_peak_bound_is_honest():
    def speed(frequency):
        return 40.0 / (1 + 2j * np.pi * frequency * 0.5)

    free = design_multisine((0.1, 2.0), **FAST, predicted=[(speed, 1e6)])
    tight = design_multisine((0.1, 2.0), **FAST, predicted=[(speed, 60.0)])
    response = speed(tight.frequencies) * tight.amplitudes * np.exp(1j * tight.phases)
    time = np.linspace(0, tight.period, 40_000)
    predicted = np.exp(2j * np.pi * np.outer(time, tight.frequencies)) @ response
    assert 0.995 * 60.0 < np.abs(predicted.real).max() <= 60.0
    assert free.peak == pytest.approx(10.0) and tight.peak < 10.0


def test_spectrum_is_kept():
    design = design_multisine((0.1, 2.0), **FAST, spectrum="flat rate")
    np.testing.assert_allclose(design.amplitudes / design.amplitudes[0], 0.1 / design.frequencies)


def test_same_seed_same_signal():
    first, second = (design_multisine((0.1, 2.0), **FAST, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.signal, second.signal)


@settings(max_examples=20)
@given(lowest=st.floats(0.05, 2.0), width=st.floats(1.0, 10.0), tones=st.integers(1, 8))
def test_never_outside_band_or_limit(lowest, width, tones):
    design = design_multisine((lowest, lowest + width), **FAST, tones=tones)
    assert len(design.frequencies) == tones
    assert lowest - 1e-9 <= design.frequencies[0] and design.frequencies[-1] <= lowest + width + 1e-9
    assert np.abs(on_fine_grid(design)).max() <= 10.0 * (1 + 1e-12)


@settings(max_examples=20, deadline=None)
@given(lowest=st.floats(0.0, 2.0), width=st.floats(0.6, 5.0), duration=st.floats(2.0, 12.0))
def test_the_usual_number_of_tones_is_one_that_the_band_holds(lowest, width, duration):
    band, duration = (lowest, lowest + width), round(duration / 0.01) * 0.01
    held = [k for k in range(1, 800) if band[0] * duration - 1e-9 <= k <= band[1] * duration + 1e-9]
    assert usual_tones(band, duration) == min(20, len(held))
    design = design_multisine(band, sample_time=0.01, duration=duration, amplitude_limits=1.0, starts=1)
    assert len(design.frequencies) == min(20, len(held))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"band": (0.1, 0.5), "tones": 20}, "fewer than 20 tones"),
        ({"band": (1.0, 60.0)}, "half the sampling frequency"),
        ({"band": (0.1, 2.0), "amplitude_limits": 0.0}, "amplitude limit"),
        ({"band": (0.1, 2.0), "duration": 0.001}, "no two samples"),
    ],
)
def test_what_cannot_be_built_is_refused_in_words(change, words):
    with pytest.raises(InputError, match=words):
        design_multisine(**{**FAST, **change})
