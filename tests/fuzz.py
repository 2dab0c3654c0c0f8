"""What is read is changed at random, and every reader takes it or refuses it in one sentence.

Hypothesis makes the files: sound ones with bytes changed, cut out, repeated or put in, and settings with other values.
`tests/test_robustness.py` reads them, a few in `make test` and many in `make fuzz`, where an example fails, too, that
takes longer than SECONDS, or whose memory grows by more than GROWTH times its files and SPARE.
"""

import gzip
import hashlib
import io
import json
import signal
import struct
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io
import torch
import yaml
from hypothesis import strategies as st
from malformed import SOUND
from malformed_models import write_sound_model

from hybrid_id.baselines.keep import load, read_run
from hybrid_id.cli.blind_runs import judge_run
from hybrid_id.config import load_config
from hybrid_id.errors import LONGEST_MESSAGE, InputError
from hybrid_id.identification.keep import read_checkpoint as read_kept
from hybrid_id.identification.keep import write_checkpoint
from hybrid_id.machines.seal import open_answers, read_manifest
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.quality import check_dataset
from hybrid_id.records.readers import column_names, load_any
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.model_file import load_model

SECONDS = 5.0
"""An example may take, on a computer that has other things to do, too."""
GROWTH, SPARE = 10, 96 * 2**20
"""Bytes of memory for one that is read, and beside that."""
Files = dict[str, bytes]


class TooLong(BaseException):
    """An example takes longer than it may."""


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes:
        sound: files that it takes, by name; the first one is changed most.
        read: reads them from a folder.
        words: what stands in such files, to be put in elsewhere.
    """

    sound: Callable[[], Files]
    read: Callable[[Path], object]
    words: tuple[bytes, ...] = ()


WORDS = (
    b"", b"\0", b"\n", b",", b"-", b"nan", b"inf", b"-1", b"1e309", b"9" * 400, b"true", b"null", b"[]", b"{}", b'"',
    b"[" * 5000, b"{" * 5000, b"a" * 5000, b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\x1b[2J", b"../",
    b"/etc/passwd", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff" * 8, b"\0" * 8, b"1,2,3\n" * 2000,
)  # fmt: skip
numbers = st.sampled_from(
    [0, -1, 1e300, -1e300, 1e-300, float("nan"), float("inf"), 2**63, int("9" * 400), 10**6]
)
odd: st.SearchStrategy[Any] = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.integers(), st.floats(), st.text(max_size=20),
              st.sampled_from(["../a", "/etc/passwd", "*", "**", "\x1b[2J", "\ud800", "a" * 5000, "1:40", "t", "u1"])),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=6,
)  # fmt: skip


@st.composite
def changed_bytes(draw: st.DrawFn, sound: bytes, words: tuple[bytes, ...]) -> bytes:
    """Bytes with a few changes."""
    content = bytearray(sound)
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, len(content)))
        end = min(at + draw(st.sampled_from([1, 2, 4, 8, 64, 4096])), len(content))
        how = draw(st.sampled_from(["cut", "end", "word", "over", "repeat", "number"]))
        if how == "cut":
            del content[at:end]
        elif how == "end":
            del content[at:]
        elif how == "word":
            content[at:at] = draw(st.sampled_from(WORDS + words) | st.binary(max_size=20))
        elif how == "over":
            word = draw(st.sampled_from(WORDS + words) | st.binary(max_size=20))
            content[at : at + len(word)] = word
        elif how == "repeat":
            content[at:end] = content[at:end] * draw(st.sampled_from([2, 100, 3000]))
        elif how == "number":
            size, order = draw(st.sampled_from("BHIQ")), draw(st.sampled_from("<>"))
            most = 256 ** struct.calcsize(size) - 1
            value = draw(st.integers(0, most) | st.sampled_from([0, 1, most // 2, most // 2 + 1, most]))
            content[at : at + struct.calcsize(size)] = struct.pack(order + size, value)
    return bytes(content[:2_000_000])


@st.composite
def changed_values(draw: st.DrawFn, sound: Any) -> Any:
    """Values with a few changes: others, fewer, more, and keys that are elsewhere."""
    values = json.loads(json.dumps(sound))
    for _ in range(draw(st.integers(1, 3))):
        places = list(_places(values))
        holder, key = draw(st.sampled_from(places))
        how = draw(st.sampled_from(["other", "gone", "again", "moved", "key"]))
        if how == "gone":
            del holder[key]
        elif how == "again" and isinstance(holder, list):
            holder.extend([holder[key]] * draw(st.sampled_from([1, 50, 1000])))
        elif how == "moved":
            other, place = draw(st.sampled_from(places))
            holder[key] = json.loads(json.dumps(other[place]))
        elif how == "key" and isinstance(holder, dict):
            holder[
                draw(st.text(max_size=10) | st.sampled_from([k for _, k in places if isinstance(k, str)]))
            ] = holder[key]
        else:
            holder[key] = draw(odd)
        if not list(_places(values)):
            break
    return values


def _places(values: Any) -> Iterator[tuple[Any, Any]]:
    """Every place in values: what holds it, and its key there."""
    for key in (
        list(values) if isinstance(values, dict) else range(len(values)) if isinstance(values, list) else ()
    ):
        yield values, key
        yield from _places(values[key])


@st.composite
def examples(draw: st.DrawFn, target: Target, sound: Files) -> Files:
    """Files, one or two of them changed."""
    files, names = dict(sound), list(sound)
    some = (
        [names[0]]
        if draw(st.integers(0, 3))
        else draw(st.lists(st.sampled_from(names), min_size=1, max_size=2))
    )
    for name in some:
        if name.endswith((".yaml", ".json")) and draw(st.booleans()):
            plain = yaml.safe_load(sound[name])
            made = draw(changed_values(plain))
            as_text = json.dumps if name.endswith(".json") else partial(yaml.safe_dump, allow_unicode=True)
            files[name] = as_text(made).encode("utf-8", "surrogatepass")
        else:
            files[name] = draw(changed_bytes(files[name], target.words))
    return files


# ---- readers ----


def table() -> dict[str, np.ndarray]:
    time = 0.002 * np.arange(40)
    return {"t": time, "u1": np.sin(20 * time), "q_m1": 0.5 - 0.5 * np.cos(20 * time)}


def csv() -> bytes:
    columns = table()
    rows = zip(*columns.values(), strict=True)
    return (
        ",".join(columns) + "\n" + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows)
    ).encode()


def written(write: Callable[[Path], object], name: str) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return {name: (Path(folder) / name).read_bytes()}


def parquet() -> Files:
    return written(lambda path: pd.DataFrame(table()).to_parquet(path), "a.parquet")


def mat(version: str) -> Files:
    values, small = table() | ({"s": {"b": [1, "x"]}} if version == "5" else {}), version == "5"
    return written(lambda path: scipy.io.savemat(path, values, format=version, do_compression=small), "a.mat")


def hdf5() -> Files:
    import h5py

    def write(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, column in table().items():
                file.create_dataset(name, data=column[None], chunks=True, compression="gzip")
        with path.open("r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")

    return written(write, "a.mat")


def npz() -> Files:
    return written(lambda path: np.savez_compressed(path, allow_pickle=False, **table()), "a.npz")


def bag(kind: str) -> Files:
    from bags import number, write_bag

    ros1 = kind == "ros1"
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / ("b.bag" if ros1 else "b")
        messages = [
            (topic, 10**9 + 2_000_000 * k, number(value, ros1))
            for topic in ("/u", "/q")
            for k, value in enumerate(table()["u1"])
        ]
        write_bag(place, messages, kind=kind)
        files = [place] if ros1 else sorted(place.iterdir(), key=lambda path: path.suffix == ".yaml")
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def bam() -> bytes:
    entry = {"position": 0.0, "speed": 2.0, "goal_position": 0.1, "load": 3, "input_voltage": 12.0}
    entries = [entry | {"timestamp": 0.005 * k, "position": 0.01 * k} for k in range(20)]
    return json.dumps({"kp": 100, "mass": 0.1, "entries": entries}).encode()


def dataset() -> Files:
    settings_ = SOUND | {
        "columns": {"u1": {"column": "u1", "scale": 1.0}},
        "resample": {"sample_time": 0.002},
    }
    return {"dataset.yaml": yaml.safe_dump(settings_).encode(), "rec_0.csv": csv(), "rec_1.csv": csv()}


def model() -> Files:
    with tempfile.TemporaryDirectory() as folder:
        return {"model.yaml": write_sound_model(Path(folder)).read_bytes()}


MJCF = b"""<mujoco><compiler angle="radian" meshdir="m"/><option gravity="0 0 -9.81"/>
<default><joint damping="0.1"/></default><asset><mesh name="m" file="a.stl"/></asset><worldbody><body name="a">
<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="j" axis="0 0 1" range="-1 1" armature="0.01"/>
<geom type="capsule" size="0.1" fromto="0 0 0 0 0 1"/><body name="b">
<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="k" type="slide" axis="1 0 0" frictionloss="0.1"/>
<site name="tip"/></body></body></worldbody><actuator>
<position joint="j" kp="3" ctrlrange="-1 1"/><motor joint="k" gear="2"/></actuator></mujoco>"""
URDF = b"""<robot name="r"><link name="w"/><link name="a"><inertial><mass value="1"/><origin xyz="0 0 0"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry><box size="1 1 1"/></geometry>
</visual></link><joint name="j" type="revolute"><parent link="w"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="3" velocity="4"/><dynamics damping="0.1" friction="0.2"/></joint></robot>"""
XML = (
    b'<include file="arm.xml"/>', b'<replicate count="100000">', b"<body>", b"</body>", b'<joint name="x"/>',
    b"</mujoco>", b"<!DOCTYPE a>", b"&lt;", b'<size nuserdata="999999"/>', b'count="9 9 9"', b'type="ball"',
    b"<freejoint/>", b"<equality/>", b'<flexcomp name="f" type="grid" count="9 9 9" spacing="1 1 1"/>',
    b'file="../a.stl"',
)  # fmt: skip


def robot_model() -> Files:
    values = {
        "robot": {"file": "arm.xml"}, "gear_ratio": [10.0, 1.0],
        "components": [{"place": "j/motor_friction", "kind": "stribeck_friction", "parameters": {"v_s": 0.1}},
                       {"place": "j/transmission", "kind": "backlash", "parameters": {"gap": {"nominal": 0.01}}}],
    }  # fmt: skip
    return {"model.yaml": yaml.safe_dump(values).encode(), "arm.xml": MJCF}


def study() -> Files:
    values = {
        "dataset": "data", "model": "model.yaml", "identification": {"pooled": True, "starts": 2, "window": 0.5},
        "training": {"windows": [[0.2, 4]], "fine": 8}, "preprocessing": {"between": [0.0, 1.0]},
        "hybrid": {"networks": [{"place": "joint1/motor", "inputs": ["speed"], "hidden": [8]}], "price": 1.0},
        "ablation": {"residual": ["static"], "seeds": 2}, "gap": {"max_effects": 2}, "output": {"report": False},
    }  # fmt: skip
    return {"study.yaml": yaml.safe_dump(values).encode()}


def checkpoint() -> Files:
    content = {"theta": torch.ones(5), "step": 3, "names": ["a"], "inner": {"b": torch.zeros(2, 2)}}
    return written(lambda path: write_checkpoint(path, content, ["kind", "print"]), "checkpoint.pt")


def read_checkpoint(folder: Path) -> None:
    read_kept(folder / "checkpoint.pt", ["kind", "print"], lambda content: content, torch.device("cpu"))


def archive() -> Files:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as made:
        for name in ("c001.yaml", "c002.yaml"):
            sheet = b"family: none\neffects: []\nshrink: 0.5\n"
            entry = tarfile.TarInfo(name)
            entry.size = len(sheet)
            made.addfile(entry, io.BytesIO(sheet))
    return {"answers.tar": file.getvalue()}


def open_archive(folder: Path) -> None:
    content = (folder / "answers.tar").read_bytes()
    open_answers(folder / "answers.tar", hashlib.sha256(content).hexdigest())


def runs() -> Files:
    sealed = archive()
    cases = {
        "names": ["c001", "c002"],
        "answers": {"sha256": hashlib.sha256(sealed["answers.tar"]).hexdigest()},
    }
    about = {"method": "diagnose", "commit": "c", "started": "today",
             "cases": cases | {"seed": 1, "asked": 2, "options": {}, "commit": "c"}}  # fmt: skip
    effect = {"name": "backlash", "where": "joint1/transmission", "probability": 0.9, "selected": True, "tied_with": [],
              "parameters": {"gap": 0.01}}  # fmt: skip
    errors = {"rmse": {"q_m1": 0.1}, "nrmse": 0.1}
    gap = {"nominal": errors, "refit": errors, "with_effect": errors, "noise_floor": 0.01, "shrink": 0.5,
           "shrink_interval": [0.4, 0.6], "by_output": {}}  # fmt: skip
    said = {"case": "c001", "verdict": "effects", "effects": [effect], "unknown": False, "no_gap": False, "gap": gap,
            "location": [], "ties": [], "next_experiments": [{"command": "u1"}],
            "run": {"commit": "c", "message": ""}}  # fmt: skip
    text = {
        "run.json": about,
        "c001/diagnosis.json": said,
        "c002/diagnosis.json": said,
        "manifest.json": cases,
    }
    return {name: json.dumps(value).encode() for name, value in text.items()} | sealed


def read_runs(folder: Path) -> None:
    for read in (lambda: read_manifest(folder), lambda: read_run(folder), lambda: load(folder, "c001"),
                 lambda: judge_run(folder, folder / "answers.tar")):  # fmt: skip
        try:
            read()
        except InputError as error:
            refused(error)


def lerobot() -> Files:
    from record_formats import write_lerobot

    names, angle = {"observation.state": ["pan.pos"], "action": ["pan.pos"]}, 0.2 * np.arange(20.0)[:, None]
    with tempfile.TemporaryDirectory() as folder:
        file = write_lerobot(Path(folder), [(np.arange(20) / 50, angle, 0.5 * angle)], names)
        return {name: (Path(folder) / name).read_bytes() for name in ("meta/info.json", file)}


def record(
    name: str, file_format: str, wanted: tuple[str, ...] = ("t", "u1", "q_m1")
) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        for step in (lambda: column_names(folder / name, file_format),
                     lambda: load_any(folder / name, wanted, file_format=file_format)):  # fmt: skip
            try:
                step()
            except InputError as error:
                refused(error)

    return read


def _load_dataset(folder: Path) -> None:
    check_dataset(Dataset.load(folder))


def _load_model(folder: Path) -> None:
    load_model(folder / "model.yaml")


def _load_study(folder: Path) -> None:
    load_config(folder / "study.yaml")


TARGETS: dict[str, Target] = {
    "csv": Target(lambda: {"a.csv": csv()}, record("a.csv", "csv"), (b";", b"\t", b"#", b'"t"', b"t,t\n")),
    "csv.gz": Target(lambda: {"a.csv.gz": gzip.compress(csv())}, record("a.csv.gz", "csv")),
    "parquet": Target(parquet, record("a.parquet", "parquet")),
    "mat 5": Target(lambda: mat("5"), record("a.mat", "mat")),
    "mat 4": Target(lambda: mat("4"), record("a.mat", "mat")),
    "mat 7.3": Target(hdf5, record("a.mat", "mat")),
    "npz": Target(npz, record("a.npz", "npz")),
    "bam": Target(lambda: {"a.json": bam()}, record("a.json", "bam", ("t", "q_m1", "duty1"))),
    "bag": Target(lambda: bag("ros1"), record("b.bag", "bag", ("/u/data", "/q/data"))),
    "mcap": Target(lambda: bag("mcap"), record("b", "bag", ("/u/data", "/q/data"))),
    "db3": Target(lambda: bag("sqlite3"), record("b", "bag", ("/u/data", "/q/data"))),
    "lerobot": Target(
        lerobot, record("data/chunk-000/file-000.parquet", "lerobot", ("action/0", "observation.state/0"))
    ),
    "dataset.yaml": Target(
        dataset, _load_dataset, (b"&a", b"*a", b"!!python/tuple []", b"? ", b"- ", b": ", b"!!float")
    ),
    "model.yaml": Target(
        model, _load_model, (b"&a", b"*a", b"!!binary", b"joint1/motor", b"kind: ", b"{nominal: 1}")
    ),
    "a robot's model.yaml": Target(robot_model, _load_model, XML),
    "study.yaml": Target(study, _load_study, (b"&a", b"<<: *a", b"!!set", b"identification:")),
    "checkpoint": Target(checkpoint, read_checkpoint),
    "archive of answers": Target(
        archive, open_archive, (b"../c.yaml", b"c003.yaml", b"ustar", b"effects: [[")
    ),
    "folder of runs": Target(runs, read_runs),
    "MJCF": Target(lambda: {"arm.xml": MJCF}, lambda folder: load_tree(folder / "arm.xml"), XML),
    "URDF": Target(lambda: {"arm.urdf": URDF}, lambda folder: load_tree(folder / "arm.urdf"), XML),
}


# ---- reading ----


def refused(error: InputError) -> None:
    """Hold a refusal to its form."""
    message = str(error)
    assert 0 < len(message) <= LONGEST_MESSAGE, f"a message of {len(message)} signs"
    assert "Traceback" not in message and "\n\n" not in message, message


def write_files(files: Files, folder: Path) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def read_files(target: Target, files: Files) -> None:
    """Read files, which the target takes or refuses in one sentence; all else is raised."""
    with tempfile.TemporaryDirectory() as folder:
        write_files(files, Path(folder))
        try:
            target.read(Path(folder))
        except InputError as error:
            refused(error)


def memory(key: str) -> int:
    """A number of bytes that Linux counts for this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(key))


@contextmanager
def bounds(files: Files) -> Iterator[None]:
    """Fail where reading files takes longer, or more memory, than it may."""

    def hangs(*_: object) -> None:
        raise TooLong(f"it hangs for {4 * SECONDS:g} s")

    Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
    before, start = memory("VmRSS"), time.process_time()
    signal.signal(signal.SIGALRM, hangs)
    signal.setitimer(signal.ITIMER_REAL, 4 * SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    seconds, grown = time.process_time() - start, memory("VmHWM") - before
    most = GROWTH * sum(map(len, files.values())) + SPARE
    assert seconds <= SECONDS, f"it takes {seconds:.1f} s"
    assert grown <= most, f"memory grows by {grown >> 20} MiB, where {most >> 20} MiB are fair"
