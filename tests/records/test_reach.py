"""Test records that go farther than the train records are told, with channel and sizes."""

from dataclasses import replace

import numpy as np
from gapcase import small_case

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import beyond


def with_test(dataset: Dataset, **changed) -> Dataset:
    """The dataset with another test record."""
    other = replace(dataset.test[0], **changed)
    return replace(dataset, records=(*dataset.train, other))


def test_a_test_record_with_larger_commands_is_told_with_channel_and_sizes() -> None:
    dataset, _ = small_case()
    assert list(beyond(dataset)) == []
    test, train = dataset.test[0], dataset.train
    most = max(np.abs(record.inputs["u1"]).max() for record in train)
    u1 = test.inputs["u1"] * 3.0 * most / np.abs(test.inputs["u1"]).max()
    (words,) = beyond(with_test(dataset, inputs={"u1": u1}))
    assert words.startswith(f"test record {test.name} goes where no train record has been (u1 ")
    assert f"u1 {3.0 * most:.3g} against {most:.3g} V" in words


def test_a_faster_test_record_is_told() -> None:
    dataset, _ = small_case()
    (words,) = beyond(with_test(dataset, outputs={"q_m1": 20.0 * dataset.test[0].outputs["q_m1"]}))
    assert "speed of q_m1" in words and "rad/s" in words
