"""Validation records: read, kept apart from the train records, and left alone by what only fits and tests."""

from dataclasses import replace
from pathlib import Path

import pytest
from gapcase import small_case
from typer.testing import CliRunner

from hybrid_id import Dataset, save_model
from hybrid_id.cli.app import app
from hybrid_id.records.dataset_file import write_dataset

ROLES = ("train", "train", "validation", "test")


def chosen() -> Dataset:
    dataset, _ = small_case()
    records = (replace(r, role=role) for r, role in zip(dataset.records, ROLES, strict=True))
    return replace(dataset, records=tuple(records))


def test_the_reader_takes_the_role(tmp_path: Path) -> None:
    write_dataset(chosen(), tmp_path)
    found = Dataset.load(tmp_path / "dataset.yaml")
    assert [r.role for r in found.records] == list(ROLES)
    assert [len(s) for s in (found.train, found.validation, found.test)] == [2, 1, 1]


@pytest.mark.parametrize("command", ["check", "identify"])
def test_other_commands_neither_fit_nor_test_with_validation_records(command: str, tmp_path: Path) -> None:
    write_dataset(chosen(), tmp_path)
    save_model(small_case()[1], tmp_path / "model.yaml")
    files = [str(tmp_path / "dataset.yaml")]
    files += ["--out", str(tmp_path / "out")] if command == "identify" else []
    found = CliRunner().invoke(app, [command, *files])
    assert found.exit_code == 0, found.output
    lines = [line for line in found.output.splitlines() if "run_2" in line]
    assert not any(" train" in line or " test" in line for line in lines), lines
    if command == "identify":
        assert "1 validation record is not fitted by identify" in found.output
