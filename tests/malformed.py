"""Malformed datasets, each with the words that its error must hold.

Use: `for case in malformed_datasets(): path = case.build(tmp_path)`, then load `path` and expect an InputError (or
exit code 2 from a command) whose one sentence holds every string of `case.names`.
"""

import gzip
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io
import yaml


def refused(outcome: Any, *names: str) -> None:
    """Hold a command's refusal to its form: exit code 2, one sentence that holds the names."""
    assert outcome.code == 2, outcome.err
    lines = [line for line in outcome.err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("Error: ")
    assert lines[0].endswith((".", "?"))
    assert not lines[0].endswith("?.")
    assert len(lines[0]) < 700, lines[0]
    for name in names:
        assert name in lines[0]


def contents(folder: Path) -> set[Path]:
    """Everything below a folder."""
    return set(folder.rglob("*"))


def write_sound_dataset(folder: Path) -> Path:
    """Write a small dataset with nothing wrong: two CSV records of 300 samples at 500 Hz."""
    for index in range(2):
        time = np.round(0.002 * np.arange(300), 6)
        voltage = np.sin((3 + index) * 2 * np.pi * time)
        frame = pd.DataFrame({"t": time, "u1": voltage, "q_m1": 0.5 - 0.5 * np.cos(20 * time)})
        frame.to_csv(folder / f"rec_{index}.csv", index=False)
    change_yaml(folder, lambda values: values.update(SOUND))
    return folder


@dataclass(frozen=True)
class Malformed:
    """One malformed file.

    Attributes:
        name: Id of the case.
        names: Strings that the message must hold: the place of the fault.
        spoil: Turns the sound files in a folder into malformed ones.
        sound: Writes the sound files into an empty folder, and returns the path to load.
    """

    name: str
    names: tuple[str, ...]
    spoil: Callable[[Path], object]
    sound: Callable[[Path], Path] = write_sound_dataset

    def build(self, folder: Path) -> Path:
        """Write the malformed files into an empty folder; return the path to load."""
        path = self.sound(folder)
        self.spoil(folder)
        return path


SOUND = {
    "name": "sound",
    "sample_time": 0.002,
    "inputs": [{"name": "u1", "unit": "V"}],
    "outputs": [{"name": "q_m1", "unit": "rad", "noise_std": 0.001}],
    "records": [{"file": "rec_0.csv", "role": "train"}, {"file": "rec_1.csv", "role": "test"}],
}


def change_yaml(folder: Path, change: Callable[[dict], object], name: str = "dataset.yaml") -> None:
    """Apply a change to the values of a file, by default dataset.yaml."""
    file = folder / name
    values = yaml.safe_load(file.read_text()) if file.exists() else {}
    change(values)
    file.write_text(yaml.safe_dump(values, sort_keys=False))


def put(*path: str | int, to: object) -> Callable[[dict], None]:
    """Set one value, `put("records", 1, "role", to="tset")`."""

    def change(values: dict) -> None:
        part: Any = values
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = to

    return change


def set_key(*path: str | int, to: object) -> Callable[[Path], None]:
    """Set one key of dataset.yaml."""
    return lambda folder: change_yaml(folder, put(*path, to=to))


def column(channel: str, source: str = "", **more: object) -> Callable[[Path], None]:
    """Take a channel from another column, or scaled."""
    return set_key("columns", to={channel: {"column": source or channel, **more}})


def in_row(row: int, old: str, new: str) -> Callable[[Path], None]:
    """Replace text in one line (1-based) of rec_0.csv."""

    def change(folder: Path) -> None:
        lines = (folder / "rec_0.csv").read_text().splitlines()
        assert old in lines[row - 1]
        lines[row - 1] = lines[row - 1].replace(old, new, 1)
        (folder / "rec_0.csv").write_text("\n".join(lines) + "\n")

    return change


def in_frame(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[Path], None]:
    """Rewrite rec_0.csv from its table."""
    return lambda folder: change(pd.read_csv(folder / "rec_0.csv")).to_csv(folder / "rec_0.csv", index=False)


def cell(row: int, name: str, value: object) -> Callable[[Path], None]:
    """Set one cell in a line (1-based) of rec_0.csv."""
    return in_frame(lambda f: f.assign(**{name: f[name].astype(object).where(f.index != row - 2, value)}))


def write(name: str, contents: str | bytes) -> Callable[[Path], object]:
    data = contents.encode() if isinstance(contents, str) else contents
    return lambda folder: (folder / name).write_bytes(data)


def both(*steps: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda folder: [step(folder) for step in steps]


def other_file(
    name: str, contents: bytes | Callable[[Path], object], **entry: object
) -> Callable[[Path], object]:
    """Take the first record from another file, given by its bytes or by what writes it."""
    made = write(name, contents) if isinstance(contents, bytes) else lambda folder: contents(folder / name)
    return both(made, set_key("records", 0, to={"file": name, **entry}))


def truncated_gzip(path: Path) -> None:
    whole = gzip.compress((path.parent / "rec_0.csv").read_bytes())
    path.write_bytes(whole[: len(whole) // 2])


def parquet_of_text(path: Path) -> None:
    pd.read_csv(path.parent / "rec_0.csv").assign(u1="high").to_parquet(path)


def bam_without_position() -> bytes:
    entry = {"speed": 2.0, "goal_position": 0.1, "load": 3}
    entries = [entry | {"timestamp": 0.005 * k, "position": 0.01 * k} for k in range(20)]
    del entries[7]["position"]
    return json.dumps({"kp": 100, "entries": entries}).encode()


def later(frame: pd.DataFrame) -> pd.DataFrame:
    """Put off the stamps from sample 100 on."""
    return frame.assign(t=frame["t"] + 0.05 * (frame.index >= 100))


def malformed_datasets() -> list[Malformed]:
    """Every malformed dataset of the table."""
    csv, settings = "rec_0.csv", "dataset.yaml"
    file, voltage = partial(set_key, "records", 0, "file"), {"name": "u1", "unit": "V"}
    bam = {"u1": {"column": "duty1", "scale": 12}}
    without = {"t": np.arange(9.0), "q_m1": np.arange(9.0)}
    rows: list[tuple[str, tuple[str, ...], Callable[[Path], object]]] = [
        # what lies in the folder
        ("no dataset.yaml", (csv, settings), lambda folder: (folder / settings).unlink()),
        ("missing file", ("gone.csv", "does not exist"), file(to="gone.csv")),
        ("path traversal", (settings, "records[0].file", "../secret.csv"), file(to="../secret.csv")),
        ("pattern of nothing", ("records[0].file", "run*.csv"), file(to="run*.csv")),
        ("name of 300 signs", ("records[0].file", "longer than the name of any"), file(to="r" * 300 + ".csv")),
        ("path of 6000 signs", ("records[0].file", "longer than the name of any"), file(to="a/" * 3000 + "r.csv")),
        ("unknown ending", ("rec_0.xyz", "format"), other_file("rec_0.xyz", b"t,u1,q_m1\n")),
        # dataset.yaml itself
        ("not YAML", (settings, "row 2"), write(settings, "name: a\nrecords: ]\n")),
        ("hostile tag", (settings, "row 1", "python"),
         write(settings, "name: !!python/object/apply:os.system [echo]\n")),
        ("alias bomb", (settings, "row 2", "alias"), write(settings, "a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]\n")),
        ("key twice", (settings, "row 3", "'name'"), write(settings, "name: a\noutputs: []\nname: b\n")),
        ("unknown key", (settings, "records[1].fiel", "'file'"), set_key("records", 1, "fiel", to="a.csv")),
        ("no records", (settings, "records"), set_key("records", to=[])),
        ("wrong unit", (settings, "inputs[0]", "'rad'", "u1"), set_key("inputs", 0, "unit", to="rad")),
        ("scale of nothing", (settings, "columns.u1", "0 leaves nothing"), column("u1", scale=0)),
        ("channel twice", ("sound", "'u1'"), set_key("inputs", to=[voltage, dict(voltage)])),
        ("record name twice", ("sound", "'rec_0'", csv), set_key("records", 1, "file", to=csv)),
        ("wrong sample time", (csv, "sample_time", "0.001"), set_key("sample_time", to=0.001)),
        ("two sample times", (settings, "resample.sample_time"), set_key("resample", to={"sample_time": 0.004})),
        ("empty window", (csv, "between 8 s and 9 s"), set_key("records", 0, "between", to=[8, 9])),
        ("truth for a number", ("key 'sample_time' is true",), set_key("sample_time", to=True)),
        # text tables
        ("NaN", (csv, "row 12", "'u1'", "nan"), cell(12, "u1", "nan")),
        ("number of Python's", (csv, "row 12", "'u1'", "not a finite number"), cell(12, "u1", "1_000")),
        ("other digits", (csv, "row 12", "'u1'", "not a finite number"), cell(12, "u1", "\u0661\u0662")),
        ("empty cell", (csv, "row 3", "'q_m1'"), cell(3, "q_m1", "")),
        ("absurd number", (csv, "row 12", "'u1'", "1e+300", "no sensor reads"), cell(12, "u1", 1e300)),
        ("long row", (csv, "row 9", "cells"), in_row(9, ",", ",1,")),
        ("missing column", (csv, "'u1'", "voltage"), in_row(1, "u1", "voltage")),
        ("column twice", (csv, "'u1'", "2 times"), in_row(1, "q_m1", "u1,q_m1")),
        ("no samples", (csv, "0 samples"), in_frame(lambda f: f.iloc[:0])),
        ("empty file", (csv, "no table"), write(csv, b"")),
        ("binary file", (csv, "UTF-8"), write(csv, bytes(range(256)) * 4)),
        ("truncated gzip", ("rec_0.csv.gz", "damaged"), other_file("rec_0.csv.gz", truncated_gzip)),
        # what the numbers say
        ("time runs backwards", (csv, "row 252", "increase"), in_frame(lambda f: f.iloc[[*range(250), *range(9)]])),
        ("gap", (csv, "0.198 s", "max_gap"), both(in_frame(later), set_key("resample", to=True))),
        ("step of a nanosecond", (csv, "1e-09 s", "give a longer one"),
         both(set_key("sample_time", to=None), set_key("resample", to={"sample_time": 1e-9}))),
        ("nanoseconds as seconds", ("rec_0", "samples are 2e+06 s apart", "ns"),
         both(set_key("sample_time", to=None), column("t", scale=1e9))),
        ("output never changes", (csv, "'q_m1'", "0.25"), in_frame(lambda f: f.assign(q_m1=0.25))),
        ("nothing left of a column", (csv, "'u1'", "scale"), column("u1", scale=1e-300)),
        ("input from the output's column", (settings, "'columns'", "'u1'", "'q_m1'"), column("u1", "q_m1")),
        ("input from the stamps", ("'columns'", "'u1'", "'t'"), column("u1", "t")),
        ("output from the stamps", ("'q_m1'", "'t'"), column("q_m1", "t", scale=2.0)),
        ("one record's stamps", ("records[1].columns", "'u1'"), set_key("records", 1, "columns", to={"u1": "t"})),
        # other formats
        ("no MATLAB file", ("a.mat", "MATLAB file"), other_file("a.mat", b"MATLAB?" * 40)),
        ("MATLAB variable missing", ("a.mat", "'u1'"),
         other_file("a.mat", lambda path: scipy.io.savemat(path, without))),
        ("Parquet of text", ("a.parquet", "'u1'"), other_file("a.parquet", parquet_of_text)),
        ("JSON of another kind", ("a.json", "entries"), other_file("a.json", b'{"samples": []}')),
        ("entry without number", ("a.json", "entry 8", "'position'"),
         other_file("a.json", bam_without_position(), columns=bam)),
    ]  # fmt: skip
    return [Malformed(*row) for row in rows]


AFRESH = """
import sys
from pathlib import Path
from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.readers import load_any, table
table.MOST_MEMORY = 50_000_000
path, *wanted = sys.argv[1:]
try:
    load_any(Path(path), wanted) if wanted else Dataset.load(path)
except InputError as error:
    print(error)
"""


def read_afresh(path: Path, *wanted: str) -> str:
    """What a new process with little memory says of a file or dataset; one that has freed much would find room."""
    done = subprocess.run(
        [sys.executable, "-c", AFRESH, path, *wanted], capture_output=True, text=True, check=True
    )
    return done.stdout
