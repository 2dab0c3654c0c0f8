"""Angles filtered by the Fourier transform, as a setting of every command that fits (paper, section II.E)."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.fourier import fourier
from hybrid_id.records.record import Record

STEP, NOISE = 0.002, 1e-3


def dataset(periods: float, rng: np.random.Generator) -> tuple[Dataset, np.ndarray, np.ndarray]:
    """A noisy angle of three tones over so many periods of the lowest, its true value and its true speed."""
    time = STEP * np.arange(round(periods / 0.5 / STEP))
    tones = [(1.0, 0.5, 0.3), (0.4, 1.5, 1.0), (0.1, 4.0, 2.0)]
    angle = sum(a * np.sin(2 * np.pi * f * time + p) for a, f, p in tones)
    speed = sum(2 * np.pi * f * a * np.cos(2 * np.pi * f * time + p) for a, f, p in tones)
    read = angle + NOISE * rng.standard_normal(len(time))
    record = Record("run", time, {"u1": 0 * time}, {"q_m1": read})
    return (
        Dataset("tones", (Channel("u1", "V"),), (Channel("q_m1", "rad", NOISE),), (record,), STEP),
        angle,
        speed,
    )


@pytest.mark.parametrize("periods", [4.0, 4.3])
def test_noise_outside_the_band_is_dropped_and_speeds_are_found(
    periods: float, rng: np.random.Generator
) -> None:
    data, angle, speed = dataset(periods, rng)
    found = fourier(data, (0.0, 8.0), speeds=True)
    (record,) = found.records
    assert [c.name for c in found.outputs] == ["q_m1", "v_m1"] and found.outputs[1].unit == "rad/s"
    rows = np.searchsorted(data.records[0].time, record.time)
    assert (len(rows) == len(angle)) == (periods == 4.0)
    assert np.std(record.outputs["q_m1"] - angle[rows]) < 0.35 * NOISE
    assert np.std(record.outputs["v_m1"] - speed[rows]) < 0.02


def test_speeds_of_a_slide_are_in_metres(rng: np.random.Generator) -> None:
    data, _, _ = dataset(4.0, rng)
    slide = replace(data, outputs=(Channel("q_m1", "m"),))
    assert fourier(slide, speeds=True).outputs[1].unit == "m/s"


def test_measured_speeds_stay_and_without_speeds_nothing_is_added(rng: np.random.Generator) -> None:
    data, _, speed = dataset(4.0, rng)
    assert [c.name for c in fourier(data).outputs] == ["q_m1"]
    (record,) = data.records
    record = replace(record, outputs={**record.outputs, "v_m1": speed})
    both = replace(data, outputs=(*data.outputs, Channel("v_m1", "rad/s")), records=(record,))
    (kept,) = fourier(both, speeds=True).records
    assert np.array_equal(kept.outputs["v_m1"], speed)


def test_jittered_stamps_and_impossible_bands_are_refused(rng: np.random.Generator) -> None:
    data, _, _ = dataset(4.0, rng)
    (record,) = data.records
    jittered = replace(record, time=record.time + 0.4 * STEP * rng.random(record.n_samples))
    with pytest.raises(InputError, match=r"run.*uniform stamps; add 'resample: true'"):
        fourier(replace(data, records=(jittered,), sample_time=None))
    with pytest.raises(InputError, match=r"run.*q_m1.*band 0 to 900 Hz"):
        fourier(data, (0.0, 900.0))
