"""Part of a long file: only the rows that a record asks for are kept, and nothing is read beyond them."""

# pyright: reportCallIssue=false

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from malformed import change_yaml, put

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import check_dataset
from hybrid_id.records.readers import csv_text, parquet
from hybrid_id.records.yaml_file import write_yaml

ROWS, STEP, PIECE = 1000, 0.002, 64
PARTS = ((0.0, 0.4), (0.5, 1.3), (1.9, 9.0))

Write = Callable[[pd.DataFrame, Path], object]
WRITERS: dict[str, Write] = {
    "csv": lambda frame, path: frame.to_csv(path, index=False),
    "csv.gz": lambda frame, path: frame.to_csv(path, index=False),
    "txt": lambda frame, path: frame.to_csv(path, index=False, sep=";", decimal=","),
    "parquet": lambda frame, path: frame.to_parquet(path, row_group_size=150),
}


@pytest.fixture(autouse=True)
def pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_text, "PIECE", PIECE)
    monkeypatch.setattr(parquet, "PIECE", PIECE)


def table(rng: np.random.Generator) -> pd.DataFrame:
    time = STEP * np.arange(ROWS)
    return pd.DataFrame({"t": time, "u1": rng.standard_normal(ROWS), "q_m1": rng.standard_normal(ROWS)})


def described(folder: Path, file: str, unit: str = "s", parts: Sequence[tuple[float, float]] = PARTS) -> Path:
    """A dataset of parts of one file; by default three, and the whole file."""
    records = [{"file": file, "name": f"part_{k}", "between": list(part)} for k, part in enumerate(parts)]
    spec = {
        "name": "parts",
        "sample_time": STEP,
        "inputs": [{"name": "u1", "unit": "V"}],
        "outputs": [{"name": "q_m1", "unit": "rad"}],
        "columns": {"t": {"column": "t", "unit": unit}},
        "records": [*records, *([{"file": file, "name": "whole"}] if parts is PARTS else [])],
    }
    write_yaml(folder / "dataset.yaml", spec)
    return folder


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize(("unit", "skew"), [("s", 0.0), ("ms", 0.0), ("s", 0.003)])
def test_parts_are_those_of_the_whole(
    rng: np.random.Generator, tmp_path: Path, ending: str, unit: str, skew: float
) -> None:
    """In seconds and milliseconds, and of channels that are recorded late."""
    frame = table(rng)
    if unit == "ms":
        frame["t"] *= 1000.0
    WRITERS[ending](frame, tmp_path / f"long.{ending}")
    home = described(tmp_path, f"long.{ending}", unit)
    if skew:
        change_yaml(home, put("outputs", 0, "skew", to=skew))
    data = Dataset.load(home)
    for k, part in enumerate(PARTS):
        same, found = data["whole"].between(*part), data[f"part_{k}"]
        np.testing.assert_array_equal(found.time, same.time)
        np.testing.assert_array_equal(found.inputs["u1"], same.inputs["u1"])
        np.testing.assert_allclose(
            found.outputs["q_m1"], same.outputs["q_m1"], rtol=0, atol=1e-12 * (skew > 0)
        )


def test_stamps_of_the_day_count_from_the_files_first(rng: np.random.Generator, tmp_path: Path) -> None:
    frame = table(rng)
    frame["t"] = pd.Timestamp("2026-11-20 08:00") + pd.to_timedelta(frame["t"], unit="s")
    frame.to_parquet(tmp_path / "long.parquet", row_group_size=100)
    data = Dataset.load(described(tmp_path, "long.parquet"))
    assert data["part_1"].time[0] == pytest.approx(0.5)
    assert data["part_1"].time[-1] == pytest.approx(1.3)


def test_nothing_is_read_beyond_the_window(rng: np.random.Generator, tmp_path: Path) -> None:
    frame = table(rng).astype({"u1": object})
    frame.loc[900, "u1"] = "oops"
    frame.to_csv(tmp_path / "long.csv", index=False)
    assert Dataset.load(described(tmp_path, "long.csv", parts=PARTS[:1]))["part_0"].n_samples == 201


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_fault_is_told_by_its_row_in_the_file(
    rng: np.random.Generator, tmp_path: Path, ending: str
) -> None:
    frame = table(rng)
    frame.loc[400, "t"] = frame.loc[399, "t"]
    WRITERS[ending](frame, tmp_path / f"long.{ending}")
    row = 402 if ending == "csv" else 401  # a text file has a header, and its lines count from 1
    with pytest.raises(InputError, match=rf"row {row}\b"):
        Dataset.load(described(tmp_path, f"long.{ending}"))


def test_turns_are_counted_from_the_files_start(tmp_path: Path) -> None:
    time = STEP * np.arange(ROWS)
    angle = 900.0 * time  # degrees, five turns
    pd.DataFrame({"t": time, "u1": np.sin(time), "theta": angle % 360.0}).to_csv(
        tmp_path / "long.csv", index=False
    )
    home = described(tmp_path, "long.csv")
    change_yaml(home, put("columns", "q_m1", to={"column": "theta", "unwrap": 360, "unit": "deg"}))
    late = Dataset.load(home)["part_2"]
    assert late.outputs["q_m1"][0] == pytest.approx(np.deg2rad(900.0 * 1.9))


def test_an_output_may_stand_still_in_some_records(tmp_path: Path) -> None:
    """One joint of an arm may be held while the other moves; not all outputs, nor one of two sensors of a joint."""
    time = STEP * np.arange(ROWS)
    table = pd.DataFrame({"t": time, "u1": np.sin(time), "q_m1": np.sin(time), "q_m2": np.cos(time)})
    outputs = [{"name": name, "unit": "rad"} for name in ("q_m1", "q_m2")]
    spec = {
        "name": "arm",
        "inputs": [{"name": "u1", "unit": "V"}],
        "outputs": outputs,
        "records": [{"file": "r*.csv"}],
    }
    write_yaml(tmp_path / "dataset.yaml", spec)
    table.to_csv(tmp_path / "r1.csv", index=False)
    table.assign(q_m2=0.5).to_csv(tmp_path / "r2.csv", index=False)
    (found,) = (f for f in check_dataset(Dataset.load(tmp_path)) if f.code in ("constant", "rests"))
    assert found.severity == "warning" and "q_m2 in r2" in found.message
    table.assign(q_m1=0.1, q_m2=0.5).to_csv(tmp_path / "r2.csv", index=False)
    with pytest.raises(InputError, match=r"r2.csv: output 'q_m1' is 0.1 in every sample"):
        Dataset.load(tmp_path)
    (tmp_path / "r2.csv").unlink()
    table.assign(q_m2=0.1).to_csv(tmp_path / "r1.csv", index=False)  # a number whose mean is rounded
    (found,) = (f for f in check_dataset(Dataset.load(tmp_path)) if f.code in ("constant", "rests"))
    assert found.severity == "warning" and "q_m2 in every record" in found.message
    outputs.append({"name": "q_a2", "unit": "rad"})
    write_yaml(tmp_path / "dataset.yaml", spec)
    table.assign(q_m2=0.5, q_a2=table["q_m2"]).to_csv(tmp_path / "r1.csv", index=False)
    with pytest.raises(InputError, match="output 'q_m2' stands still in every record"):
        Dataset.load(tmp_path)


def test_a_window_counts_from_the_zero_of_time(rng: np.random.Generator, tmp_path: Path) -> None:
    frame = table(rng)
    frame["t"] += 100.0
    frame.to_csv(tmp_path / "long.csv", index=False)
    home = described(tmp_path, "long.csv", parts=[(0.0, 0.401)])
    change_yaml(home, put("columns", "t", to={"column": "t", "zero": 100.0}))
    (record,) = Dataset.load(home).records
    np.testing.assert_allclose(record.time, STEP * np.arange(201), atol=1e-9)
