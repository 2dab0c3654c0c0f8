"""Two encoders on one joint: their ratio is the gear's, whatever play, compliance and noise do for a while."""

from dataclasses import replace

import numpy as np
import pytest

from hybrid_id.records.dataset import Channel, Dataset
from hybrid_id.records.quality import Finding
from hybrid_id.records.record import Record
from hybrid_id.study.checks import check_encoders

TIME = 0.002 * np.arange(3000)
LINK = 0.4 * np.sin(5 * TIME) + 0.1 * np.sin(17 * TIME)
RATIOS = (100.0, 80.0)


def dataset(**changes: np.ndarray) -> Dataset:
    """Two records of two joints, the second of which moves half as far; outputs replaced by name."""
    draw, records = np.random.default_rng(0), []
    for k in range(2):
        outputs = {"q_a1": LINK + k, "q_m1": 100 * LINK, "q_a2": 0.5 * LINK[::-1], "q_m2": 40 * LINK[::-1]}
        outputs = {n: q + 1e-4 * draw.standard_normal(len(q)) for n, q in (outputs | changes).items()}
        records.append(Record(f"r{k}", TIME, {"u1": LINK, "u2": LINK}, outputs))
    inputs = Channel("u1", "V"), Channel("u2", "V")
    return Dataset("two", inputs, tuple(Channel(n, "rad") for n in records[0].outputs), tuple(records), 0.002)


def checked(data: Dataset, ratios: tuple[float, float]) -> list[Finding]:
    return list(check_encoders(data, dict(enumerate(ratios, 1))))


def test_a_right_gear_is_silent() -> None:
    assert checked(dataset(), RATIOS) == []
    assert checked(dataset(q_m1=100 * LINK + 0.5 * np.sign(np.cos(5 * TIME))), RATIOS) == []


@pytest.mark.parametrize(
    ("ratios", "words"),
    [
        ((80.0, 80.0), "joint 1: q_m1 moves 100 times q_a1 in the records, but the model's gear ratio is 80"),
        (
            (100.0, 0.0125),
            "joint 2: q_m2 moves 80 times q_a2 in the records, but the model's gear ratio is 0.0125",
        ),
        ((-100.0, 80.0), "joint 1: q_m1 moves 100 times q_a1"),
    ],
)
def test_a_wrong_ratio_means_nothing_can_be_fitted(ratios: tuple[float, float], words: str) -> None:
    (found,) = checked(dataset(), ratios)
    assert found.severity == "error" and found.message.startswith(words)


def test_a_small_difference_is_a_warning() -> None:
    (found,) = checked(dataset(), (104.0, 80.0))
    assert found.severity == "warning" and "q_m1 moves 100 times q_a1" in found.message


def test_degrees_for_radians_and_a_link_counted_from_the_base() -> None:
    (degrees,) = checked(dataset(q_a2=28.6 * LINK[::-1]), RATIOS)
    assert degrees.severity == "error" and "moves 1.399 times q_a2" in degrees.message
    (base,) = checked(dataset(q_a2=0.5 * LINK[::-1] + 2 * LINK), RATIOS)
    assert base.severity == "warning" and "the angle between this link and the one before it" in base.message


def test_a_joint_that_stands_or_has_one_encoder_has_no_ratio() -> None:
    still = np.zeros_like(TIME)
    assert checked(dataset(q_a2=still, q_m2=still), (100.0, 5.0)) == []
    records = tuple(replace(r, outputs={"q_m1": r.outputs["q_m1"]}) for r in dataset())
    one = Dataset("one", dataset().inputs, (Channel("q_m1", "rad"),), records, 0.002)
    assert checked(one, (5.0, 80.0)) == []
