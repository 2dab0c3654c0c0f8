"""Malformed datasets, each with the words that its error must hold; for the readers and for the commands.

Use: `for case in malformed_datasets(): path = case.build(tmp_path)`, then load `path` and expect an InputError (or
exit code 2 from a command) whose one sentence holds every string of `case.names`.
"""

import gzip
import json
from collections.abc import Callable
from dataclasses import dataclass
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
    for name in names:
        assert name in lines[0]


def contents(folder: Path) -> set[Path]:
    """Everything below a folder."""
    return set(folder.rglob("*"))


@dataclass(frozen=True)
class Malformed:
    """One malformed dataset.

    Attributes:
        name: Id of the case.
        names: Strings that the message must hold: the place of the fault.
        spoil: Turns the sound dataset in a folder into the malformed one; may return another path to load.
    """

    name: str
    names: tuple[str, ...]
    spoil: Callable[[Path], Path | None]

    def build(self, folder: Path) -> Path:
        """Write the malformed dataset into an empty folder; return the path to load."""
        write_sound_dataset(folder)
        return self.spoil(folder) or folder


def write_sound_dataset(folder: Path) -> Path:
    """Write a small dataset with nothing wrong: two CSV records of 300 samples at 500 Hz."""
    for index in range(2):
        time = np.round(0.002 * np.arange(300), 6)
        voltage = np.sin((3 + index) * 2 * np.pi * time)
        frame = pd.DataFrame({"t": time, "u1": voltage, "q_m1": 0.5 - 0.5 * np.cos(20 * time)})
        frame.to_csv(folder / f"rec_{index}.csv", index=False)
    change_yaml(folder, lambda values: values.update(SOUND))
    return folder


SOUND = {
    "name": "sound",
    "sample_time": 0.002,
    "inputs": [{"name": "u1", "unit": "V"}],
    "outputs": [{"name": "q_m1", "unit": "rad", "noise_std": 0.001}],
    "records": [{"file": "rec_0.csv", "role": "train"}, {"file": "rec_1.csv", "role": "test"}],
}


def change_yaml(folder: Path, change: Callable[[dict], object]) -> None:
    """Apply a change to the values of dataset.yaml."""
    file = folder / "dataset.yaml"
    values = yaml.safe_load(file.read_text()) if file.exists() else {}
    change(values)
    file.write_text(yaml.safe_dump(values, sort_keys=False))


def in_yaml(change: Callable[[dict], object]) -> Callable[[Path], None]:
    return lambda folder: change_yaml(folder, change)


def set_key(*path: str | int, to: object) -> Callable[[Path], None]:
    """Set one key of dataset.yaml, `set_key("records", 1, "role", to="tset")`."""

    def change(values: dict) -> None:
        part = values
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = to

    return in_yaml(change)


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


def write(name: str, contents: str | bytes) -> Callable[[Path], None]:
    data = contents.encode() if isinstance(contents, str) else contents

    def change(folder: Path) -> None:
        (folder / name).write_bytes(data)

    return change


def both(*steps: Callable[[Path], None]) -> Callable[[Path], None]:
    return lambda folder: [step(folder) for step in steps] and None


def other_file(name: str, contents: bytes, **entry: object) -> Callable[[Path], None]:
    """Take the first record from another file."""
    return both(write(name, contents), set_key("records", 0, to={"file": name, **entry}))


def truncated_gzip(folder: Path) -> None:
    whole = gzip.compress((folder / "rec_0.csv").read_bytes())
    other_file("rec_0.csv.gz", whole[: len(whole) // 2])(folder)


def folder_without_yaml(folder: Path) -> None:
    (folder / "dataset.yaml").unlink()


def mat_without_voltage(folder: Path) -> None:
    scipy.io.savemat(folder / "a.mat", {"t": np.arange(9.0), "q_m1": np.arange(9.0)})
    set_key("records", 0, to={"file": "a.mat"})(folder)


def parquet_of_text(folder: Path) -> None:
    pd.read_csv(folder / "rec_0.csv").assign(u1="high").to_parquet(folder / "a.parquet")
    set_key("records", 0, to={"file": "a.parquet"})(folder)


def bam_log(*, spoil: Callable[[list[dict]], object]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        entries = [
            {"timestamp": 0.005 * k, "position": 0.01 * k, "speed": 2.0, "goal_position": 0.1, "load": 3}
            for k in range(20)
        ]
        spoil(entries)
        log = json.dumps({"kp": 100, "entries": entries}).encode()
        other_file("a.json", log, columns={"u1": {"column": "duty1", "scale": 12}})(folder)

    return change


def three_times(frame: pd.DataFrame) -> pd.DataFrame:
    """Stretch the stamps from sample 100 on."""
    time = frame["t"].to_numpy().copy()
    time[100:] += 0.05
    return frame.assign(t=time)


_YAML_BOMB = "a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]\n"


def malformed_datasets() -> list[Malformed]:
    """Every malformed dataset of the table."""
    csv, settings = "rec_0.csv", "dataset.yaml"
    return [
        # what lies in the folder
        Malformed("no such path", ("nowhere", "does not exist"), lambda folder: folder / "nowhere"),
        Malformed("no dataset.yaml", ("rec_0.csv", settings), folder_without_yaml),
        Malformed(
            "missing file", ("gone.csv", "does not exist"), set_key("records", 0, "file", to="gone.csv")
        ),
        Malformed(
            "path traversal",
            (settings, "records[0].file", "../secret.csv"),
            set_key("records", 0, "file", to="../secret.csv"),
        ),
        Malformed(
            "pattern of nothing",
            ("records[0].file", "run*.csv"),
            set_key("records", 0, "file", to="run*.csv"),
        ),
        Malformed("unknown ending", ("rec_0.xyz", "format"), other_file("rec_0.xyz", b"t,u1,q_m1\n")),
        # dataset.yaml itself
        Malformed("not YAML", (settings, "row 2"), write(settings, "name: a\nrecords: ]\n")),
        Malformed(
            "hostile tag",
            (settings, "row 1", "python"),
            write(settings, "name: !!python/object/apply:os.system [echo]\n"),
        ),
        Malformed("alias bomb", (settings, "row 2", "alias"), write(settings, _YAML_BOMB)),
        Malformed(
            "key twice", (settings, "row 3", "'name'"), write(settings, "name: a\noutputs: []\nname: b\n")
        ),
        Malformed(
            "unknown key", (settings, "records[1].fiel", "'file'"), set_key("records", 1, "fiel", to="a.csv")
        ),
        Malformed("no records", (settings, "records"), set_key("records", to=[])),
        Malformed(
            "wrong unit", (settings, "inputs[0]", "'rad'", "u1"), set_key("inputs", 0, "unit", to="rad")
        ),
        Malformed(
            "scale of nothing",
            (settings, "columns.u1", "0 leaves nothing"),
            set_key("columns", to={"u1": {"column": "u1", "scale": 0}}),
        ),
        Malformed(
            "channel twice",
            ("sound", "'u1'"),
            set_key("inputs", to=[{"name": "u1", "unit": "V"}, {"name": "u1", "unit": "V"}]),
        ),
        Malformed("record name twice", ("sound", "'rec_0'", csv), set_key("records", 1, "file", to=csv)),
        Malformed("wrong sample time", (csv, "sample_time", "0.001"), set_key("sample_time", to=0.001)),
        Malformed(
            "two sample times",
            (settings, "resample.sample_time"),
            set_key("resample", to={"sample_time": 0.004}),
        ),
        Malformed("empty window", (csv, "between 8 s and 9 s"), set_key("records", 0, "between", to=[8, 9])),
        # text tables
        Malformed(
            "NaN",
            (csv, "row 12", "'u1'", "nan"),
            in_frame(lambda f: f.assign(u1=f["u1"].astype(object).where(f.index != 10, "nan"))),
        ),
        Malformed(
            "empty cell",
            (csv, "row 3", "'q_m1'"),
            in_frame(lambda f: f.assign(q_m1=f["q_m1"].where(f.index != 1))),
        ),
        Malformed("long row", (csv, "row 9", "cells"), in_row(9, ",", ",1,")),
        Malformed(
            "missing column",
            (csv, "'u1'", "voltage"),
            in_frame(lambda f: f.rename(columns={"u1": "voltage"})),
        ),
        Malformed("column twice", (csv, "'u1'", "2 times"), in_row(1, "q_m1", "u1,q_m1")),
        Malformed("no samples", (csv, "0 samples"), in_frame(lambda f: f.iloc[:0])),
        Malformed("empty file", (csv, "no table"), write(csv, b"")),
        Malformed("binary file", (csv, "UTF-8"), write(csv, bytes(range(256)) * 4)),
        Malformed("truncated gzip", ("rec_0.csv.gz", "damaged"), truncated_gzip),
        # what the numbers say
        Malformed(
            "time runs backwards",
            (csv, "row 252", "increase"),
            in_frame(lambda f: f.iloc[[*range(250), *range(9)]]),
        ),
        Malformed(
            "gap", (csv, "0.198 s", "max_gap"), both(in_frame(three_times), set_key("resample", to=True))
        ),
        Malformed(
            "step of a nanosecond",
            (csv, "1e-09 s", "give a longer one"),
            both(set_key("sample_time", to=None), set_key("resample", to={"sample_time": 1e-9})),
        ),
        Malformed("truth for a number", ("key 'sample_time' is true",), set_key("sample_time", to=True)),
        Malformed(
            "absurd number",
            (csv, "row 12", "'u1'", "1e+300", "no sensor reads"),
            in_frame(lambda f: f.assign(u1=f["u1"].where(f.index != 10, 1e300))),
        ),
        Malformed("output never changes", (csv, "'q_m1'", "0.25"), in_frame(lambda f: f.assign(q_m1=0.25))),
        # other formats
        Malformed("no MATLAB file", ("a.mat", "MATLAB file"), other_file("a.mat", b"MATLAB?" * 40)),
        Malformed("MATLAB variable missing", ("a.mat", "'u1'"), mat_without_voltage),
        Malformed("Parquet of text", ("a.parquet", "'u1'"), parquet_of_text),
        Malformed("JSON of another kind", ("a.json", "entries"), other_file("a.json", b'{"samples": []}')),
        Malformed(
            "entry without number",
            ("a.json", "entry 8", "'position'"),
            bam_log(spoil=lambda e: e[7].pop("position")),
        ),
    ]
