"""Malformed datasets are refused by one sentence that names the place."""

import re

import pytest
from malformed import Malformed, malformed_datasets, write_sound_dataset

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset

CASES = malformed_datasets()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_malformed_dataset_is_refused(case: Malformed, tmp_path) -> None:
    path = case.build(tmp_path)
    with pytest.raises(InputError) as caught:
        Dataset.load(path)
    message = str(caught.value)
    for words in case.names:
        assert words in message, message
    assert "\n" not in message
    assert not re.search(r"\. [A-Z]", message), f"more than one sentence: {message}"
    assert len(message.replace(str(tmp_path), "")) < 320, message


def test_table_is_broad_and_its_sound_dataset_is_sound(tmp_path) -> None:
    assert len(CASES) >= 18
    assert len({case.name for case in CASES}) == len(CASES)
    assert len(Dataset.load(write_sound_dataset(tmp_path))) == 2
