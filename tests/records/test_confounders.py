"""Facts of records that change together are said; what is varied by itself is not."""

import numpy as np
import pytest

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.quality import check_dataset, confounded_signals, record_conditions
from hybrid_id.records.record import Record


def record(number: int, meta: dict[str, float | str], **inputs: np.ndarray) -> Record:
    time = 0.01 * np.arange(50)
    inputs = {"u1": np.sin((1 + number) * time), **inputs}
    return Record(f"run_{number}", time, inputs, {"q_m1": np.cos(time + number)}, meta=meta)


def series(heat: list[float], gains: list[float]) -> list[Record]:
    return [
        record(k, {"gain": g, "heat": h, "site": "lab", "mass": 0.5})
        for k, (h, g) in enumerate(zip(heat, gains, strict=True))
    ]


@pytest.mark.parametrize(
    ("heat", "gains", "said"),
    [
        ([20.0, 21.0, 29.5, 31.0, 40.0], [100, 100, 400, 400, 800], ("gain", "heat", "rise together", "0.9")),
        ([40.0, 30.0, 20.0, 10.0], [1, 2, 3, 4], ("go opposite ways", "-1.00")),
        ([20.0, 40.0, 20.0, 40.0], [1, 1, 2, 2], ()),  # varied apart
        ([1.0, 2.0, 3.0], [1, 2, 3], ()),  # too few records
    ],
)
def test_facts_that_change_together_are_said(
    heat: list[float], gains: list[float], said: tuple[str, ...]
) -> None:
    found = list(confounded_signals(series(heat, gains)))
    assert len(found) == bool(said) and all(word in found[0] for word in said)


def test_what_is_the_same_everywhere_or_has_two_names_is_one_fact_or_none() -> None:
    records = [record(k, {"kp": float(k), "mass": 0.5}, gain1=np.full(50, float(k))) for k in range(4)]
    assert set(record_conditions(records)) == {"kp"}


def test_a_steady_channel_is_a_fact_and_a_moving_one_is_not() -> None:
    wave = np.sin(np.arange(50.0))
    records = [record(k, {}, load1=np.full(50, 1.0 + k) + 1e-3 * wave, other1=k + 3 * wave) for k in range(4)]
    assert set(record_conditions(records)) == {"load1"}


def test_the_check_of_a_dataset_says_so() -> None:
    channels = (Channel("u1", "V"),), (Channel("q_m1", "rad"),)
    for heat, told in (([20.0, 21.0, 30.0, 40.0], True), ([30.0, 21.0, 40.0, 29.0], False)):
        dataset = Dataset("servo", *channels, tuple(series(heat, [1, 1, 2, 3])))
        words = [f.message for f in check_dataset(dataset) if f.code == "together"]
        assert bool(words) == told
        assert not told or words[0].startswith(
            "these records cannot separate what gain does from what heat does"
        )
