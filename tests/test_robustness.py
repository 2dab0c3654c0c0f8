"""Hostile and damaged files, a full disk, two runs at once: one sentence, never a traceback, nothing lost.

The mutations are seeded; `--hypothesis-seed` has no part in them. Long fuzzing is the same loop with a larger count.
"""

import gzip
import json
import os
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.io import savemat

from hybrid_id.cli import folder as folders
from hybrid_id.cli.folder import live_folder
from hybrid_id.config import StudyConfig, load_config
from hybrid_id.errors import InputError
from hybrid_id.identification.keep import read_checkpoint
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.readers.unpack import FREE
from hybrid_id.systems import one_link
from hybrid_id.systems.model_file import load_model, save_model

COUNT = int(os.environ.get("HYBRID_ID_FUZZ", "40"))
TOKENS = [
    b"nan", b"inf", b"1e999", b"-", b"\0", b'"', b",", b"\n\n", b"\xff\xfe", b"!!python/object:os.system", b"&a", b"*a",
    b"[", b"}", b"true", b"null", b"{{", b": :", b"../../",
]  # fmt: skip
HEAD = "name: a\ninputs: [{name: u1, unit: V}]\noutputs: [{name: q_m1, unit: rad}]\n"
BAM = "name: a\ninputs: [{name: goal1, unit: rad}]\noutputs: [{name: q_m1, unit: rad}]\n"
FILES = ("a.csv", "a.csv.gz", "a.parquet", "a.mat", "a.json")


def mutated(content: bytes, draw: random.Random) -> bytes:
    """Cut short, bytes changed, rubbish put in, a piece taken out, or a token that means something to a parser."""
    data, kind = bytearray(content), draw.randrange(5)
    i, j = sorted(draw.randrange(len(data)) for _ in range(2))
    if kind == 0:
        return bytes(data[:i])
    if kind == 1:
        for _ in range(draw.randrange(1, 20)):
            data[draw.randrange(len(data))] = draw.randrange(256)
    elif kind == 2:
        data[i:i] = draw.randbytes(draw.randrange(1, 64))
    elif kind == 3:
        del data[i:j]
    else:
        data[i : i + draw.randrange(3)] = draw.choice(TOKENS)
    return bytes(data)


def survives(read: Callable[[], object], file: Path, content: bytes) -> None:
    """Read many mutations of a file: each is taken, or refused in a sentence."""
    draw = random.Random(file.name)
    for _ in range(COUNT):
        file.write_bytes(mutated(content, draw))
        try:
            read()
        except InputError as error:
            assert len(str(error)) < 1500


@pytest.fixture
def records(tmp_path: Path) -> Path:
    """A folder with the same short record in every format."""
    t = np.arange(0, 0.4, 0.002)
    u, q = np.sin(9 * t), np.cumsum(np.sin(9 * t)) * 0.01
    frame = pd.DataFrame({"t": t, "u1": u, "q_m1": q})
    frame.to_csv(tmp_path / "a.csv", index=False)
    frame.to_csv(tmp_path / "a.csv.gz", index=False)
    frame.to_parquet(tmp_path / "a.parquet")
    savemat(tmp_path / "a.mat", {"t": t, "u1": u, "q_m1": q}, do_compression=True)
    names = (
        "timestamp",
        "position",
        "speed",
        "goal_position",
        "load",
        "input_volts",
        "temp",
        "torque_enable",
    )
    entries = [
        dict(zip(names, (a, b, 0.0, 0.1, 12, 7.4, 30, True), strict=True)) for a, b in zip(t, q, strict=True)
    ]
    (tmp_path / "a.json").write_text(json.dumps({"kp": 8, "entries": entries}))
    return tmp_path


def describe(folder: Path, name: str) -> None:
    text = (
        BAM + "records: [{file: a.json, format: bam}]\n"
        if name == "a.json"
        else f"{HEAD}records: [{{file: {name}}}]\n"
    )
    (folder / "dataset.yaml").write_text(text)


@pytest.mark.parametrize("name", FILES)
def test_damaged_records(records: Path, name: str) -> None:
    describe(records, name)
    Dataset.load(records)
    survives(lambda: Dataset.load(records), records / name, (records / name).read_bytes())


def test_damaged_descriptions(records: Path, drive_model: Path) -> None:
    describe(records, "a.csv")
    survives(lambda: Dataset.load(records), records / "dataset.yaml", (records / "dataset.yaml").read_bytes())
    survives(lambda: load_model(drive_model), drive_model, drive_model.read_bytes())
    study = records / "study.yaml"
    study.write_text(
        "dataset: .\nmodel: model.yaml\nidentification: {starts: 2, loss: huber}\noutput: {folder: x}\n"
    )
    survives(lambda: load_config(study), study, study.read_bytes())


@pytest.fixture
def drive_model(tmp_path: Path) -> Path:
    save_model(one_link(156.0, vertical=True), tmp_path / "model.yaml")
    return tmp_path / "model.yaml"


class Evil:
    """What a hostile pickle does when it is loaded."""

    def __reduce__(self) -> tuple:
        return os.system, ("touch evil",)


def test_hostile_and_damaged_checkpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "checkpoint.pt"
    torch.save({"identity": ["a"], "state": Evil()}, file)
    with pytest.raises(InputError, match="no checkpoint of a training"):
        read_checkpoint(file, ["a"], dict, torch.device("cpu"))
    assert not (tmp_path / "evil").exists()
    torch.save({"identity": ["a"], "state": {"x": torch.zeros(9)}}, file)
    survives(lambda: read_checkpoint(file, ["a"], dict, torch.device("cpu")), file, file.read_bytes())


def gzip_bomb(file: Path) -> None:
    with gzip.open(file, "wb") as stream:
        stream.write(b"t,u1,q_m1\n")
        for _ in range(FREE // 500_000):
            stream.write(b"0" * 1_000_000)


def second_member(file: Path) -> None:
    """A bomb behind a harmless table: gzip files may be joined."""
    gzip_bomb(file)
    table = b"t,u1,q_m1\n" + b"".join(b"%d,0,%d\n" % (k, k) for k in range(100_000))
    file.write_bytes(gzip.compress(table) + file.read_bytes())


def mat_bomb(file: Path) -> None:
    """One compressed variable of zeros, by the format's letter (MATLAB, MAT-File Format, R2024a, chapter 1)."""
    count = FREE // 4
    flags, shape = struct.pack("<IIII", 6, 8, 6, 0), struct.pack("<IIii", 5, 8, count, 1)
    matrix = flags + shape + struct.pack("<HH4s", 1, 1, b"t\0\0\0") + struct.pack("<II", 9, 8 * count)
    engine = zlib.compressobj()
    packed = engine.compress(struct.pack("<II", 14, len(matrix) + 8 * count) + matrix)
    packed += b"".join(engine.compress(bytes(count)) for _ in range(8)) + engine.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + struct.pack("<HH", 0x0100, 0x4D49)
    file.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


def parquet_bomb(file: Path) -> None:
    """A page that repeats one number needs no more than the number and how often."""
    pd.DataFrame(dict.fromkeys(("t", "u1", "q_m1"), np.zeros(FREE // 20))).to_parquet(file)
    assert file.stat().st_size < FREE // 1000


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("b.csv.gz", gzip_bomb),
        ("c.csv.gz", second_member),
        ("b.json.gz", gzip_bomb),
        ("b.mat", mat_bomb),
        ("b.parquet", parquet_bomb),
    ],
)
def test_bombs_are_refused_before_they_unpack(
    tmp_path: Path, name: str, make: Callable[[Path], None]
) -> None:
    make(tmp_path / name)
    describe(tmp_path, name)
    with pytest.raises(InputError, match="unpacks to more than 100 times its size"):
        Dataset.load(tmp_path)


def test_a_long_record_is_no_bomb(tmp_path: Path) -> None:
    count = FREE // 20
    still = {"t": 0.002 * np.arange(count), "u1": np.zeros(count), "q_m1": np.arange(count) % 7.0}
    pd.DataFrame(still).to_parquet(tmp_path / "a.parquet")
    describe(tmp_path, "a.parquet")
    assert Dataset.load(tmp_path).records[0].n_samples == count


@pytest.mark.parametrize("file", ["../a.csv", "/etc/passwd", "x/../../a.csv", "..\\\\a.csv"])
def test_files_outside_the_folder_are_refused(records: Path, file: str) -> None:
    inside = records / "inside"
    inside.mkdir()
    (inside / "dataset.yaml").write_text(f'{HEAD}records: [{{file: "{file}"}}]\n')
    with pytest.raises(InputError, match="inside the dataset's folder"):
        Dataset.load(inside)


@pytest.mark.parametrize("name", ["../evil", "a/b", ".hidden", "..", "x" * 300])
def test_names_that_would_leave_the_folder_are_refused(records: Path, name: str) -> None:
    (records / "dataset.yaml").write_text(f'{HEAD}records: [{{file: a.csv, name: "{name}"}}]\n')
    with pytest.raises(InputError, match="cannot be a file name"):
        Dataset.load(records)


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_numbers_that_are_none_are_refused_with_their_row(records: Path, number: str, column: int) -> None:
    lines = (records / "a.csv").read_text().splitlines()
    cells = lines[7].split(",")
    lines[7] = ",".join([*cells[:column], number, *cells[column + 1 :]])
    (records / "a.csv").write_text("\n".join(lines))
    describe(records, "a.csv")
    with pytest.raises(InputError, match=r"row (7|8)"):
        Dataset.load(records)


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
