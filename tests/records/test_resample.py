from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hybrid_id.errors import InputError
from hybrid_id.records.record import Record
from hybrid_id.records.resample import find_gaps, resample_record, shift_channels, turns_back


def jittered(rng: np.random.Generator, n: int = 400, step: float = 0.01, jitter: float = 0.2) -> Record:
    time = step * (np.arange(n) + jitter * rng.uniform(-1, 1, n))
    inputs = {"u1": np.sin(7 * time), "enable1": (time > 2).astype(float), "gain1": np.full(n, 0.1)}
    return Record("a", time, inputs, {"q_m1": np.sin(5 * time)})


@given(n=st.integers(2, 60), step=st.floats(1e-4, 2.0), start=st.sampled_from([0.0, -3.0, 12.5]))
def test_uniform_record_is_left_as_it_is(n: int, step: float, start: float) -> None:
    time = start + step * np.arange(n)
    record = Record("a", time, {"u1": np.cos(time)}, {"q_m1": np.sin(time)})
    new, report = resample_record(record, step)
    assert new is record
    assert "left as it is" in report.message


def test_outputs_follow_the_signal_and_inputs_keep_their_impulse(rng) -> None:
    record = jittered(rng)
    new, report = resample_record(record, 0.01)
    assert new.is_uniform
    np.testing.assert_allclose(new.outputs["q_m1"], np.sin(5 * new.time), atol=2e-4)
    held = np.sum(record.inputs["u1"][:-1] * np.diff(record.time))
    kept = np.sum(new.inputs["u1"][:-1] * np.diff(new.time))
    assert kept == pytest.approx(held, abs=2 * 0.01)  # but for the last sample's share
    np.testing.assert_array_equal(new.inputs["gain1"], 0.1)
    assert set(new.inputs["enable1"]) == {0.0, 1.0}
    assert report.lost["q_m1"] < 1e-3


def test_an_angle_that_jumps_by_a_turn_is_read_off_between_no_samples() -> None:
    time = 0.004 * np.arange(300)
    angle = np.mod(9.0 * time + np.pi, 2 * np.pi) - np.pi
    record = Record("a", time, {"u1": np.cos(time)}, {"q_m1": angle, "v_m1": 9.0 + 0.1 * np.cos(time)})
    words = r"'q_m1' jumps by a turn, first at 0\.352 s.*set 'unwrap'"
    with pytest.raises(InputError, match=words):
        resample_record(record, 0.005)
    with pytest.raises(InputError, match=words):
        shift_channels(record, {"q_m1": 0.0015})
    assert shift_channels(record, {"v_m1": 0.0015}).n_samples == 299
    smooth = replace(record, outputs={"q_m1": np.unwrap(angle)})
    assert not turns_back(resample_record(smooth, 0.005)[0].outputs["q_m1"]).size
    assert turns_back(angle).size == 2 and not turns_back(angle[:1]).size


def test_average_of_a_held_input_by_hand() -> None:
    record = Record(
        "a", np.array([0.0, 1.0, 3.0, 4.0]), {"u1": np.array([1.0, 2.0, 5.0, 7.0])}, {"q_m1": np.arange(4.0)}
    )
    new, _ = resample_record(record, 2.0)
    np.testing.assert_allclose(new.inputs["u1"], [(1 + 2) / 2, (2 + 5) / 2, 7.0])
    new, _ = resample_record(record, 2.0, inputs="hold")
    np.testing.assert_array_equal(new.inputs["u1"], [1.0, 2.0, 7.0])


def test_a_held_input_is_not_late_where_stamps_count_from_1970() -> None:
    stamps = (1_700_000_000_123_456_789 + 1_000_000 * np.arange(4000)).astype(np.int64)
    time, count = stamps * 1.0e-9, np.arange(4000.0)
    record = Record(name="a", time=time, inputs={"u1": count}, outputs={"q_m1": np.sin(count / 50)})
    new, _ = resample_record(record, 0.002, inputs="hold")
    np.testing.assert_array_equal(new.inputs["u1"], count[::2])


def test_a_command_of_noughts_and_ones_is_no_switch() -> None:
    time = 0.001 * np.arange(200)
    pulses = (np.arange(200) % 7 == 3).astype(float)
    record = Record("a", time, {"duty1": pulses, "enable1": pulses}, {"q_m1": np.sin(20 * time)})
    new, _ = resample_record(record, 0.002)
    assert new.inputs["duty1"].mean() == pytest.approx(pulses.mean(), rel=0.05)
    assert np.unique(new.inputs["duty1"].round(6)).tolist() == [0.0, 0.5]
    assert set(new.inputs["enable1"]) <= {0.0, 1.0}


def test_longer_step_reports_what_is_lost() -> None:
    time = 0.001 * np.arange(2000)
    record = Record("a", time, {"u1": time}, {"q_m1": np.sin(2 * np.pi * 80 * time)})
    _, report = resample_record(record, 0.01)
    assert report.lost["q_m1"] > 0.3
    assert "lost between the new samples (RMS): q_m1 0." in report.message


def test_gaps_are_refused_or_reported(rng) -> None:
    record = jittered(rng)
    keep = np.r_[0:100, 106:400]
    record = Record("a", record.time[keep], {}, {"q_m1": record.outputs["q_m1"][keep]})
    assert len(find_gaps(record)) == 1
    with pytest.raises(InputError, match="samples are missing for"):
        resample_record(record)
    _, report = resample_record(record, max_gap=10)
    assert "bridged gaps" in report.message


def test_step_longer_than_the_record_is_refused(rng) -> None:
    with pytest.raises(InputError, match="shorten the step"):
        resample_record(jittered(rng), 100.0)
