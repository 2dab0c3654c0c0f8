import copy

import numpy as np
import pytest

from hybrid_id.errors import InputError
from hybrid_id.records.record import Record


def make(**changes) -> Record:
    time = 0.01 * np.arange(100)
    fields = {"name": "a", "time": time, "inputs": {"u1": np.sin(time)}, "outputs": {"q_m1": time**2}}
    return Record(**(fields | changes))


def test_properties() -> None:
    record = make()
    assert record.n_samples == 100
    assert record.duration == pytest.approx(0.99)
    assert record.sample_time == pytest.approx(0.01)
    assert record.is_uniform
    assert record.signal("u1") is record.inputs["u1"]
    with pytest.raises(InputError, match="has no channel 'u7'; it has u1, q_m1"):
        record.signal("u7")


def test_is_uniform_allows_one_per_cent() -> None:
    time = 0.01 * np.arange(100)
    time[50] += 0.00009
    assert make(time=time).is_uniform
    time[50] += 0.00002
    assert not make(time=time).is_uniform


def test_arrays_cannot_be_written_to_and_do_not_follow_their_source() -> None:
    source = np.ones(100)
    record = make(inputs={"u1": source})
    source[0] = 7.0
    assert record.inputs["u1"][0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        record.inputs["u1"][0] = 2.0
    with pytest.raises(TypeError):
        record.inputs["u2"] = source  # type: ignore[index]


def test_copies_survive_the_way_to_a_worker_process() -> None:
    record = make(role="test", note="step", meta={"mass": 0.5})
    other = copy.deepcopy(record)  # the same protocol as sending it
    assert (other.name, other.role, other.note, dict(other.meta)) == ("a", "test", "step", {"mass": 0.5})
    np.testing.assert_array_equal(other.outputs["q_m1"], record.outputs["q_m1"])


def test_between_keeps_stamps_and_both_ends() -> None:
    record = make(time=np.arange(100.0))
    part = record.between(10, 20)
    np.testing.assert_array_equal(part.time, np.arange(10.0, 21.0))
    np.testing.assert_array_equal(part.outputs["q_m1"], record.outputs["q_m1"][10:21])
    with pytest.raises(InputError, match="its stamps run from 0 s to 99 s"):
        record.between(200, 300)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time": np.arange(1.0), "inputs": {}, "outputs": {}}, "at least 2"),
        ({"time": np.zeros((50, 2))}, "one number a sample"),
        ({"outputs": {"q_m1": np.ones(99)}}, r"'q_m1' has shape \(99,\)"),
        ({"outputs": {"q_m1": np.full(100, np.inf)}}, "sample 0: 'q_m1' is inf"),
        ({"outputs": {"q_m1": ["x"] * 100}}, "not an array of numbers"),
        ({"time": np.full(100, 3.0)}, "sample 1: time goes from 3 s to 3 s"),
        ({"role": "validate"}, "'train', 'validation' or 'test'"),
        ({"name": "a/b"}, "file name"),
        ({"name": ""}, "file name"),
        ({"inputs": {"i1": np.ones(100)}, "outputs": {"i1": np.ones(100)}}, "an input and an output"),
    ],
)
def test_faults_are_refused(changes: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make(**changes)
