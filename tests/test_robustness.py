"""Hostile and damaged files, two runs at once: one sentence, never a traceback, nothing lost."""

import gzip
import os
import struct
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from fuzz import TARGETS, Files, bounds, examples, read_files
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from malformed import read_afresh

from hybrid_id.cli import folder as folders
from hybrid_id.cli.folder import live_folder
from hybrid_id.config import StudyConfig
from hybrid_id.errors import InputError
from hybrid_id.identification.keep import read_checkpoint
from hybrid_id.records.dataset import Dataset

HEAD = "name: a\ninputs: [{name: u1, unit: V}]\noutputs: [{name: q_m1, unit: rad}]\n"
MANY = int(os.environ.get("FUZZ", "0"))
"""Examples of each reader that `make fuzz` tries, which draws others every time."""
SOME = settings(
    max_examples=MANY or 25, deadline=None, database=None, derandomize=not MANY,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip


@cache
def sound(name: str) -> Files:
    files = TARGETS[name].sound()
    read_files(TARGETS[name], files)  # what it imports counts for no example
    return files


@pytest.mark.parametrize("name", TARGETS)
@given(st.data())
@SOME
def test_every_reader_takes_changed_files_or_refuses_them(name: str, data: st.DataObject) -> None:
    files = data.draw(examples(TARGETS[name], sound(name)))
    with bounds(files) if MANY else nullcontext():
        read_files(TARGETS[name], files)


class Evil:
    """What a hostile pickle does when it is loaded."""

    def __reduce__(self) -> tuple:
        return os.system, ("touch evil",)


def test_a_checkpoint_runs_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "checkpoint.pt"
    torch.save({"identity": ["a"], "state": Evil()}, file)
    with pytest.raises(InputError, match="no checkpoint of a training"):
        read_checkpoint(file, ["a"], dict, torch.device("cpu"))
    assert not (tmp_path / "evil").exists()


def gzip_bomb(file: Path) -> None:
    with gzip.open(file, "wb") as stream:
        stream.write(b"t,u1,q_m1\n")
        for _ in range(200):
            stream.write(b"0" * 1_000_000)


def rows_bomb(file: Path) -> None:
    """Rows without a fault, which take a thousandth of their size."""
    file.write_bytes(gzip.compress(b"t,u1,q_m1\n" + b"0,0,0\n" * 20_000_000, 1))


def second_member(file: Path) -> None:
    """A bomb behind a harmless table: gzip files may be joined."""
    gzip_bomb(file)
    table = b"t,u1,q_m1\n" + b"".join(b"%d,0,%d\n" % (k, k) for k in range(100_000))
    file.write_bytes(gzip.compress(table) + file.read_bytes())


def mat_bomb(file: Path) -> None:
    """One compressed variable of zeros, by the format's letter (MATLAB, MAT-File Format, R2024a, chapter 1)."""
    count = 25_000_000
    flags, shape = struct.pack("<IIII", 6, 8, 6, 0), struct.pack("<IIii", 5, 8, count, 1)
    matrix = flags + shape + struct.pack("<HH4s", 1, 1, b"t\0\0\0") + struct.pack("<II", 9, 8 * count)
    engine = zlib.compressobj()
    packed = engine.compress(struct.pack("<II", 14, len(matrix) + 8 * count) + matrix)
    packed += b"".join(engine.compress(bytes(count)) for _ in range(8)) + engine.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + struct.pack("<HH", 0x0100, 0x4D49)
    file.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


def parquet_bomb(file: Path) -> None:
    """A page that repeats one number needs no more than the number and how often."""
    pd.DataFrame(dict.fromkeys(("t", "u1", "q_m1"), np.zeros(5_000_000))).to_parquet(file)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("b.csv.gz", gzip_bomb),
        ("c.csv.gz", second_member),
        ("d.csv.gz", rows_bomb),
        ("b.json.gz", gzip_bomb),
        ("b.mat", mat_bomb),
        ("b.parquet", parquet_bomb),
    ],
)
def test_bombs_get_no_memory(tmp_path: Path, name: str, make: Callable[[Path], None]) -> None:
    make(tmp_path / name)
    (tmp_path / "dataset.yaml").write_text(f"{HEAD}records: [{{file: {name}}}]\n")
    words = ("unpacks to more than", "longer than 1000000 signs", "not a finite number")
    said = read_afresh(tmp_path)
    assert any(word in said for word in words), said


def test_a_long_record_is_no_bomb(tmp_path: Path) -> None:
    count = 5_000_000
    still = {"t": 0.002 * np.arange(count), "u1": np.zeros(count), "q_m1": np.arange(count) % 7.0}
    pd.DataFrame(still).to_parquet(tmp_path / "a.parquet")
    (tmp_path / "dataset.yaml").write_text(f"{HEAD}records: [{{file: a.parquet}}]\n")
    assert Dataset.load(tmp_path).records[0].n_samples == count


def test_results_folder_of_two_runs_at_once(tmp_path: Path) -> None:
    home = tmp_path / "out"
    of_ours = '{"program": "hybrid_id 0", "run": "%s"}'
    with pytest.raises(InputError, match="is not empty"), folders.results_folder(home, force=False) as first:
        (first / "result.json").write_text(of_ours % "first")
        with folders.results_folder(home, force=False) as second:
            (second / "result.json").write_text(of_ours % "second")
    assert "second" in (home / "result.json").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_training_folder_has_one_writer(tmp_path: Path) -> None:
    home, config = tmp_path / "out", StudyConfig(dataset=tmp_path, model=tmp_path / "model.yaml")
    with live_folder(home, config, force=False, resume=False):
        with pytest.raises(InputError, match="another run is writing"), folders.sole_writer(home):
            pass
        (home / "checkpoint.pt").write_text("half")
        with (
            pytest.raises(InputError, match="another run is writing"),
            live_folder(home, config, force=True, resume=False),
        ):
            pass
    assert (home / "checkpoint.pt").read_text() == "half"
    with folders.sole_writer(home):
        pass
