from dataclasses import replace

import numpy as np
import pytest

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.measures import (
    estimate_noise,
    quantisation_step,
    rest_samples,
)
from hybrid_id.records.quality import check_dataset, check_record
from hybrid_id.records.record import Record
from hybrid_id.records.resample import resample_record

T = 3000
TIME = 0.002 * np.arange(T)
VOLTAGE = np.where(TIME < 0.1, 0.0, 3 * np.sin(8 * TIME) + 2 * np.sin(21 * TIME))


def motion() -> np.ndarray:
    """A smooth motion from rest at 0.4 rad, with reversals."""
    moved = np.clip(TIME - 0.1, 0, None)
    return 0.4 + 2 * (1 - np.cos(6 * moved)) + 0.5 * (1 - np.cos(15 * moved))


def record(name: str = "a", noise: float = 1e-3, seed: int = 1, **changes) -> Record:
    q = motion() + noise * np.random.default_rng(seed).normal(size=T)
    return replace(Record(name, TIME, {"u1": VOLTAGE}, {"q_m1": q}), **changes)


def codes(findings) -> set[str]:
    return {finding.code for finding in findings}


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_noise_of_a_moving_signal(noise: float) -> None:
    values = motion() + noise * np.random.default_rng(0).normal(size=T)
    assert estimate_noise(values) == pytest.approx(noise, rel=0.1)
    values[500:520] += 3.0  # an outlier does not spoil it
    assert estimate_noise(values) == pytest.approx(noise, rel=0.15)


def test_noise_and_step_of_a_quantised_signal() -> None:
    step = 2 * np.pi / 4096
    values = step * np.round(motion() / step)
    assert quantisation_step(values) == pytest.approx(step)
    assert step / np.sqrt(12) <= estimate_noise(values) < step
    assert quantisation_step(motion()) == 0.0
    assert quantisation_step(np.ones(10)) == 0.0


def test_the_samples_before_the_first_motion_are_at_rest() -> None:
    assert rest_samples(record(noise=0.01)) == 50


def test_an_arm_let_go_without_voltage_is_not_at_rest_for_long() -> None:
    q = np.cos(5 * TIME) + 1e-3 * np.random.default_rng(2).normal(size=T)
    rec = record(inputs={"u1": np.zeros(T)}, outputs={"q_m1": q})
    assert 1 <= rest_samples(rec) < 10


def spike(q: np.ndarray) -> np.ndarray:
    q[[700, 1400]] += 0.5
    return q


def end_stop(q: np.ndarray) -> np.ndarray:
    return np.minimum(q, 3.0)


def test_a_record_on_a_finer_grid_has_no_spikes() -> None:
    """Between its samples it has neither noise nor resolution, so that every turn of the motion stands out of them."""
    slow = replace(record(), time=TIME[::8], inputs={"u1": VOLTAGE[::8]}, outputs={"q_m1": motion()[::8]})
    finer, _ = resample_record(slow, 0.002)
    assert "spikes" not in codes(check_record(finer))


def follows(goal: np.ndarray, stop: float) -> Record:
    """A joint that follows its goal with a lag and by counts, up to an end stop."""
    q = np.zeros(T)
    for k in range(1, T):
        q[k] = min(q[k - 1] + 0.04 * (goal[k - 1] - q[k - 1]), stop)
    return Record("a", TIME, {"goal1": goal}, {"q_a1": 0.002 * np.round(q / 0.002)})


@pytest.mark.parametrize(
    ("goal", "stop", "clipped"),
    [
        (np.clip(3.0 * np.abs((TIME % 3.0) - 1.5) - 1.0, 0.0, 2.0), 9.0, False),  # it arrives, and holds
        (np.clip(3.0 * np.abs((TIME % 3.0) - 1.5) - 1.0, 0.0, 2.0), 1.2, True),
        (np.interp(TIME, [0.0, 0.3, 0.5], [0.0, 0.0, 1.0]), 0.99, False),  # it moves once, and arrives
        (1.6 * (TIME % 2.0 > 1.0), 1.0, True),  # the goal rests, but not where the joint stops
        (1.5 * np.sin(3.0 * np.floor(TIME / 0.02) * 0.02), 1.0, True),  # a goal that is sent every 20 ms
    ],
)
def test_a_joint_that_has_arrived_is_at_no_end_stop(goal: np.ndarray, stop: float, clipped: bool) -> None:
    assert ("clipped" in codes(check_record(follows(goal, stop)))) == clipped


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (motion() / 57.3, True),  # in another unit
        (0.4 + 1e-18 * np.sin(TIME), False),  # at rest, but for rounding
        (0.4 + 1e-3 * np.random.default_rng(5).normal(size=T), False),  # at rest in its noise
    ],
)
def test_a_joint_that_rests_in_one_record_has_no_wrong_unit(values: np.ndarray, said: bool) -> None:
    rest = record("rest", outputs={"q_m1": values})
    jump = record("jump", outputs={"q_m1": motion() + 20.0 * (TIME > 3.0)})
    channels = ((Channel("u1", "V"),), (Channel("q_m1", "rad"),))
    data = Dataset("d", *channels, (record("a"), record("b", seed=2), jump, rest))
    found = [one for one in check_dataset(data) if one.code == "scale" and one.record == "rest"]
    assert bool(found) == said


@pytest.mark.parametrize("change", [0.0, 3e-16 * np.sin(TIME)])
def test_a_joint_that_always_rests_has_no_wrong_unit(change: np.ndarray) -> None:
    """The spread of one number read many times is rounding, and so is what is left of it between samples."""
    rests = [record(str(k), outputs={"q_m1": motion(), "q_m2": np.full(T, 0.25)}) for k in range(3)]
    rests.append(record("rest", outputs={"q_m1": motion(), "q_m2": np.full(T, 0.7) + change}))
    channels = ((Channel("u1", "V"),), (Channel("q_m1", "rad"), Channel("q_m2", "rad")))
    assert "scale" not in codes(check_dataset(Dataset("d", *channels, tuple(rests))))


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (spike, "spikes"),
        (end_stop, "clipped"),
        (lambda q: (3 * q + np.pi) % (2 * np.pi) - np.pi, "wrapped"),
        (lambda q: np.full(T, 0.3), "constant"),
        (lambda q: 0.5 * np.round(q / 0.5), "coarse"),
        (lambda q: q + 0.5 * np.random.default_rng(3).normal(size=T), "noisy"),
        (lambda q: 0.4 + np.clip(TIME - 0.1, 0, None) ** 2, "one_direction"),
    ],
)
def test_faults_of_an_output(change, code: str) -> None:
    q = change(record().outputs["q_m1"].copy())
    findings = check_record(record(outputs={"q_m1": q}))
    finding = next(finding for finding in findings if finding.code == code)
    assert finding.severity in ("warning", "error")
    assert finding.message.startswith("a, q_m1: ")


def test_faults_of_sampling() -> None:
    keep = np.r_[0:1000, 1010:T]
    part = {"time": TIME[keep], "inputs": {"u1": VOLTAGE[keep]}, "outputs": {"q_m1": motion()[keep]}}
    found = {finding.code: finding for finding in check_record(Record("a", **part))}
    assert found["gap"].severity == "error"
    assert "jitter" not in found  # whose cure, 'resample: true', bridges no gap
    assert "missing at 1 place, first after 1.998 s for 22 ms" in found["gap"].message
    assert "'resample: {max_gap: 12}'" in found["gap"].message
    assert "short" in codes(check_record(record().between(1.0, 1.1)))


@pytest.mark.parametrize(
    ("factor", "severity", "words"),
    [
        (1e3, "error", "2 s apart, too far for most drives; if its stamps are in ms, set 't: {column"),
        (1e6, "error", "in us, set 't: {column: t, unit: us}' under 'columns' in the dataset file"),
        (1e9, "error", "in ns, set 't: {column: t, scale: 1.0e-9}'"),
        (150.0, "warning", "its samples are 0.3 s apart"),  # a slow drive may be meant
        (1e-3, "error", "its samples are 2e-06 s apart, closer than any drive is sampled; correct 'unit'"),
        (5e-3, "", ""),
        (50.0, "", ""),
    ],
)
def test_stamps_in_another_unit(factor: float, severity: str, words: str) -> None:
    steps = [f for f in check_record(record(time=factor * TIME)) if f.code in ("slow_step", "fast_step")]
    assert [f.severity for f in steps] == ([severity] if severity else [])
    assert all(words in f.message for f in steps)


def test_faults_of_excitation() -> None:
    assert "no_excitation" in codes(check_record(record(inputs={"u1": np.full(T, 2.0)})))
    ramp = record(inputs={"u1": TIME}, outputs={"q_m1": 0.1 * TIME**2})
    assert "slow" in codes(check_record(ramp))
    assert "clipped_input" in codes(check_record(record(inputs={"u1": np.clip(VOLTAGE, -4, 4)})))


def test_moving_start_is_seen_and_an_accelerating_one_is_not() -> None:
    noise = 1e-5 * np.random.default_rng(0).normal(size=T)
    voltage = {"u1": 3 * np.cos(8 * TIME)}
    moving = record(inputs=voltage, outputs={"q_m1": np.sin(6 * TIME) + noise})
    starting = record(inputs=voltage, outputs={"q_m1": 5 * (1 - np.cos(6 * TIME)) + noise})
    assert "start_motion" in codes(check_record(moving))
    assert "start_motion" not in codes(check_record(starting))


def dataset(*records: Record, noise_std: float | None = 1e-3) -> Dataset:
    return Dataset(
        "d", (Channel("u1", "V"),), (Channel("q_m1", "rad", noise_std),), records, sample_time=0.002
    )


def test_good_dataset_has_nothing_to_warn_of() -> None:
    data = dataset(record("a"), record("b", seed=2), record("c", seed=3, role="test"))
    assert {finding.severity for finding in check_dataset(data)} == {"info"}


@pytest.mark.parametrize(
    ("data", "code", "severity"),
    [
        (dataset(record("a")), "one_train", "warning"),
        (dataset(record("a")), "no_test", "info"),
        (dataset(record("a", role="test")), "no_train", "error"),
        (dataset(record("a"), record("b")), "repeated", "warning"),
        (dataset(record("a"), record("b", role="test")), "repeated", "error"),
        (dataset(record("a"), noise_std=0.1), "noise_std", "warning"),
        (dataset(record("a"), noise_std=1e6), "noise_std", "error"),
        (
            dataset(record("a"), record("b", seed=2), record("c", outputs={"q_m1": 60 * motion()})),
            "scale",
            "warning",
        ),
    ],
)
def test_faults_of_a_dataset(data: Dataset, code: str, severity: str) -> None:
    assert (code, severity) in {(finding.code, finding.severity) for finding in check_dataset(data)}


def test_a_slow_record_is_a_fault_only_where_no_train_record_is_faster() -> None:
    ramp = record("slow", inputs={"u1": TIME}, outputs={"q_m1": 0.1 * TIME**2})
    for others, severity in (
        ((record("fast"),), "info"),
        ((), "warning"),
        ((record("fast", role="test"),), "warning"),
    ):
        (said,) = (f for f in check_dataset(dataset(ramp, *others)) if f.code == "slow")
        assert said.severity == severity and said.message.startswith("slow: under two turning points")
        assert ("add a faster record" in said.message) == (severity == "warning")


def test_steps_that_differ_name_the_record() -> None:
    data = replace(dataset(record("a")), sample_time=None, records=(record("a"), record("b", time=20 * TIME)))
    (finding,) = (f for f in check_dataset(data) if f.code == "unequal_steps")
    assert finding.message.startswith("b: its samples are 40 ms apart where those of a are 2 ms apart")


def test_an_input_that_never_changes_in_training_is_an_error() -> None:
    still = {"u1": np.full(T, 2.0)}
    dead = dataset(record("a", inputs=still), record("b", seed=2, role="test"))
    assert "dead_input" in codes(check_dataset(dead))
    one_moves = dataset(record("a", inputs=still), record("b", seed=2))
    assert "dead_input" not in codes(check_dataset(one_moves))


def test_what_many_records_share_is_said_once() -> None:
    data = dataset(*(record(name, seed=seed) for seed, name in enumerate("abcd")))
    noise = [finding for finding in check_dataset(data) if finding.code == "noise"]
    assert len(noise) == 1
    assert "likewise in 3 more records: b, c, d" in noise[0].message
