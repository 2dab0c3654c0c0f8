"""Files that somebody made to break a reader: each is refused in one short sentence, at once, without its contents.

A class of faults each: bounds before a library parses, devices and pipes, archives and folders of runs, links, and the
descriptions of robots. A test here that hangs or ends the process is the fault that it is about.
"""

import hashlib
import io
import json
import os
import struct
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from malformed import SOUND, change_yaml, write_sound_dataset
from scipy.io import savemat

from hybrid_id.baselines.keep import load as load_diagnosis
from hybrid_id.baselines.keep import read_run
from hybrid_id.baselines.run import read_case
from hybrid_id.errors import LONGEST_MESSAGE, InputError
from hybrid_id.identification.keep import Kept
from hybrid_id.machines.seal import open_answers, read_manifest, refuse_reachable
from hybrid_id.reading import LONGEST_NAME, MOST_COLUMNS, MOST_DEPTH, parse_json
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.readers import column_names, load_any
from hybrid_id.records.yaml_file import MAX_VALUES, parse_yaml, read_yaml
from hybrid_id.robots.description import load_tree
from hybrid_id.systems.model_file import load_model

quick = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], database=None
)
HERE = Path("settings.yaml")


def refused(read: Callable[[], object], *words: str) -> str:
    """The sentence by which something is refused; it holds all of the words and fits on a screen."""
    with pytest.raises(InputError) as caught:
        read()
    message = str(caught.value)
    assert len(message) <= LONGEST_MESSAGE
    for word in words:
        assert word in message, message
    return message


def needs_pipes() -> None:
    if not hasattr(os, "mkfifo"):
        pytest.skip("there are no pipes here")


# ---- bounds before a library parses (class 1) ----


@given(st.one_of(st.binary(max_size=60), st.text('[]{}",:\\ 1eE.-tn\ud7ff', max_size=60).map(str.encode)))
@quick
def test_json_is_what_the_library_reads_or_refused(content: bytes) -> None:
    try:
        expected = json.loads(content)
    except (ValueError, RecursionError):
        refused(lambda: parse_json(content, HERE), "settings.yaml")
    else:
        assert repr(parse_json(content, HERE)) == repr(expected)


@given(st.text("[]{}:,-?&*!|>'\"#%@`ab1 \n", max_size=40))
@quick
def test_yaml_is_what_the_library_reads_or_refused(text: str) -> None:
    try:
        found = parse_yaml(text, HERE)
    except InputError as error:
        assert str(error).startswith("settings.yaml")
    else:
        assert found == yaml.safe_load(text)


@pytest.mark.parametrize("level", ["[", '{"a":', '[{"]]]]":['])
@pytest.mark.parametrize("count", [MOST_DEPTH + 1, 100_000])
def test_json_is_not_followed_into_the_deep(level: str, count: int) -> None:
    refused(lambda: parse_json((level * count).encode(), HERE), "levels deep")


@pytest.mark.parametrize("level", ["[", "{", "- ", "? ", "[a: ", "{a: "])
@pytest.mark.parametrize("count", [MOST_DEPTH + 1, 200_000])
def test_yaml_is_not_followed_into_the_deep(level: str, count: int) -> None:
    refused(lambda: parse_yaml(level * count, HERE), "settings.yaml, row 1", "levels deep")


@pytest.mark.parametrize(
    ("read", "content", "word"),
    [
        (parse_json, b"[" + b"{}," * 2_000_000 + b"1]", "more values than any file"),
        (parse_json, b"[" + b"0," * 6_000_000 + b"0]", "more values than any file"),
        (parse_yaml, "a: [" + "1," * (MAX_VALUES + 1) + "]", f"more than {MAX_VALUES} values"),
        (parse_yaml, f"{'x' * (LONGEST_NAME + 1)}: 1", "row 1: a key is longer"),
        (parse_yaml, "a: {? [b]: 1}", "no name"),
        # numbers that YAML reads in its own way
        (parse_yaml, "name: x\nsample_time: 1:30", "settings.yaml, row 2"),
        (parse_yaml, "name: x\nsample_time: -2:30.5", "settings.yaml, row 2"),
        (parse_yaml, "name: x\nsample_time: 0100", "settings.yaml, row 2"),
        (parse_yaml, f"name: x\nsample_time: {'9' * 5000}", "settings.yaml, row 2"),
    ],
    ids=[
        "groups",
        "values",
        "YAML's values",
        "name",
        "list for a key",
        "minutes",
        "parts",
        "octal",
        "digits",
    ],
)
def test_settings_have_bounds(read: Callable, content: str | bytes, word: str) -> None:
    refused(lambda: read(content, HERE), word)


def nested_cells(file: Path, depth: int) -> None:
    """A MATLAB file whose last variable is a cell in a cell in a cell ... (MAT-File Format, R2024a, chapter 1)."""

    def cell(length: int, name: bytes) -> bytes:
        head = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1)
        head += struct.pack("<II", 1, len(name)) + name.ljust(-(-len(name) // 8) * 8, b"\0")
        return struct.pack("<II", 14, len(head) + length) + head

    parts, length = [struct.pack("<II", 14, 0)], 8
    for level in range(depth):
        parts.append(cell(length, b"c" if level == depth - 1 else b""))
        length += len(parts[-1])
    savemat(file, {"t": range(9), "u1": range(9)})
    file.write_bytes(file.read_bytes() + b"".join(reversed(parts)))


def test_cells_of_a_matlab_file_are_not_followed(tmp_path: Path) -> None:
    nested_cells(tmp_path / "a.mat", 60_000)
    assert column_names(tmp_path / "a.mat", "mat") == ["t", "u1"]
    assert load_any(tmp_path / "a.mat", ["u1"]).columns["u1"].tolist() == list(range(9))
    refused(lambda: load_any(tmp_path / "a.mat", ["c"]), "no column 'c' (it has t, u1)")


WIDE = MOST_COLUMNS + 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t," + ",".join(map(str, range(1_000_000))) + "\n1,2\n", ("row 1: longer than 1000000 signs",)),
        ("c," * WIDE + "\n" + "1," * WIDE + "\n", (f"where {MOST_COLUMNS} are read",)),
        ("t,u1\n" + "1," * WIDE + "\n", (f"where {MOST_COLUMNS} are read",)),
        ("t" * 20_000_000, ("row 1: longer than",)),
        ("t,u1," + "x" * (LONGEST_NAME + 1) + "\n1,2,3\n", ("the name of column 'xxx", "rename it")),
        ("t,u1\n" + "1,2\n" * 500 + "1," * 2_000_000, ("row 502: longer than",)),
        ("\0" * 3_000_000, ("row 1: longer than",)),
    ],
    ids=["million columns", "columns", "cells", "first line", "name", "last line", "zeros"],
)
def test_tables_have_bounds(tmp_path: Path, content: str, words: tuple[str, ...]) -> None:
    (tmp_path / "a.csv").write_text(content)
    refused(lambda: load_any(tmp_path / "a.csv", ["t", "u1"]), "a.csv", *words)


# ---- devices and pipes (class 5) ----


@pytest.mark.parametrize("make", ["pipe", "device"])
@pytest.mark.parametrize(
    "name", ["dataset.yaml", "model.yaml", "arm.xml", "a.csv", "a.mat", "bag/a.mcap", "a.json"]
)
def test_what_is_no_regular_file_is_not_opened(tmp_path: Path, name: str, make: str) -> None:
    needs_pipes()
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    if make == "pipe":
        os.mkfifo(file)
    else:
        file.symlink_to("/dev/zero")
    readers: dict[str, Callable[[], object]] = {
        "dataset.yaml": lambda: Dataset.load(tmp_path),
        "model.yaml": lambda: load_model(file),
        "arm.xml": lambda: load_tree(file),
        "bag/a.mcap": lambda: load_any(file.parent, ["/a"]),
    }
    refused(readers.get(name, lambda: load_any(file, ["t"])), name, "is a pipe or a device")


def test_thousands_of_faults_take_no_longer_than_their_file(tmp_path: Path) -> None:
    parts = [{"kind": "stribeck_friction", f"key_{k}": 1} for k in range(5000)]
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump({"system": "one_link", "components": parts}))
    refused(lambda: load_model(path), "(and 9999 more)")


def test_a_link_in_a_circle_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").symlink_to("a.csv")
    refused(lambda: load_any(tmp_path / "a.csv", ["t"]), "in a circle")


# ---- archives and folders of runs (class 9) ----

HASH = "0" * 64
CASES = {"names": ["c001"], "answers": {"sha256": HASH}, "seed": 1, "asked": 1, "options": {}, "commit": "c"}
RUN = {"method": "bic", "commit": "c", "started": "today", "cases": CASES}
SHEET = b"family: none\neffects: []\n"


def archive(file: Path, *entries: tarfile.TarInfo) -> str:
    """Write an archive of entries, regular ones with a ground truth in them; return its hash."""
    with tarfile.open(file, "w", format=tarfile.USTAR_FORMAT) as made:
        for entry in entries:
            entry.size = len(SHEET) if entry.isreg() else 0
            made.addfile(entry, io.BytesIO(SHEET))
    return hashlib.sha256(file.read_bytes()).hexdigest()


def entry(name: str, kind: bytes = tarfile.REGTYPE, target: str = "") -> tarfile.TarInfo:
    found = tarfile.TarInfo(name)
    found.type, found.linkname = kind, target
    return found


@pytest.mark.parametrize(
    "odd",
    [
        entry("../c002.yaml"),
        entry("/tmp/c002.yaml"),
        entry("a/c002.yaml"),
        entry("c002.txt"),
        entry("c002.yaml", tarfile.SYMTYPE, "/etc/passwd"),
        entry("c002.yaml", tarfile.LNKTYPE, "c002.yaml"),
        entry("c002.yaml", tarfile.LNKTYPE, "c001.yaml"),
        entry("c002.yaml", tarfile.FIFOTYPE),
        entry("c002.yaml", tarfile.CHRTYPE),
        entry("c002.yaml", tarfile.DIRTYPE),
    ],
    ids=lambda odd: f"{odd.name} of type {odd.type.decode()}",
)
def test_archives_of_answers_hold_answers_only(tmp_path: Path, odd: tarfile.TarInfo) -> None:
    sha256 = archive(tmp_path / "a.tar", entry("c001.yaml"), odd)
    refused(lambda: open_answers(tmp_path / "a.tar", sha256), "which is no answer")
    assert [path.name for path in tmp_path.iterdir()] == ["a.tar"]


@pytest.mark.parametrize("name", ["../x", "a/b", "/etc", ".", "..", ".c001", "", 3, None, "x\0"])
def test_names_of_cases_lead_nowhere_else(tmp_path: Path, name: object) -> None:
    about = {"names": ["c001", name], "answers": {"sha256": HASH}}
    (tmp_path / "manifest.json").write_text(json.dumps(about))
    refused(lambda: read_manifest(tmp_path), "no list of names of cases")
    (tmp_path / "run.json").write_text(json.dumps(RUN | {"cases": about}))
    refused(lambda: read_run(tmp_path), "no list of names of cases")


def test_junk_in_a_folder_of_runs_is_not_waited_for(tmp_path: Path) -> None:
    needs_pipes()
    cases, runs = tmp_path / "cases", tmp_path / "deep" / "runs"
    for folder in (cases / "c001", runs / "c001"):
        folder.mkdir(parents=True)
    os.mkfifo(cases / "c001" / "pipe")
    os.mkfifo(runs / "c001" / "diagnosis.json")
    (cases / "c001" / "circle").symlink_to("circle")
    (cases / "above").symlink_to(tmp_path, target_is_directory=True)
    refuse_reachable(cases, runs, {"names": ["c001"], "answers": {"sha256": HASH}})
    assert load_diagnosis(runs, "c001") is None
    (runs / "c001" / "diagnosis.json").unlink()
    (runs / "c001" / "diagnosis.json").write_text("[" * 100_000)
    assert load_diagnosis(runs, "c001") is None


def test_a_case_holds_no_file_from_elsewhere(tmp_path: Path) -> None:
    case = tmp_path / "cases" / "c001"
    case.mkdir(parents=True)
    (case / "dataset.yaml").write_text("name: a\n")
    assert set(read_case(case).files) == {"dataset.yaml"}
    (tmp_path / "secret").write_text("hunter2")
    (case / "more.csv").symlink_to(tmp_path / "secret")
    assert "hunter2" not in refused(lambda: read_case(case), "more.csv leads out of the folder")


@pytest.mark.parametrize("junk", [b"", b"PK\x03\x04 cut short", b"\x93NUMPY", bytes(99)])
def test_a_kept_fit_that_is_damaged_is_made_again(tmp_path: Path, junk: bytes) -> None:
    import numpy as np

    kept, made = Kept(tmp_path, "program"), []

    def fit() -> float:
        made.append(1)
        return 3.0

    def get() -> float:
        return kept.of("this", fit, lambda value: {"a": np.array(value)}, lambda arrays: float(arrays["a"]))

    assert get() == get() == 3.0 and len(made) == 1
    next(tmp_path.glob("*.npz")).write_bytes(junk)
    assert get() == get() == 3.0 and len(made) == 2


# ---- links, and what messages may not say (class 11) ----


@pytest.fixture
def elsewhere(tmp_path: Path) -> tuple[Path, Path]:
    """A sound dataset's folder, and another folder with a record in it."""
    home, other = tmp_path / "home", tmp_path / "other"
    home.mkdir()
    other.mkdir()
    write_sound_dataset(home)
    (home / "rec_0.csv").rename(other / "rec_0.csv")
    return home, other


@pytest.mark.parametrize("file", ["rec_0.csv", "sub/rec_0.csv", "rec_[0].csv", "*/rec_0.csv"])
def test_links_out_of_the_folder_are_refused_unless_asked_for(
    elsewhere: tuple[Path, Path], file: str
) -> None:
    home, other = elsewhere
    if "/" in file:
        (home / "sub").symlink_to(other, target_is_directory=True)
    else:
        (home / "rec_0.csv").symlink_to(other / "rec_0.csv")
    change_yaml(home, lambda found: found["records"][0].update(file=file))
    refused(
        lambda: Dataset.load(home), "key 'records[0].file'", "leads out of the folder", "follow_links: true"
    )
    change_yaml(home, lambda found: found.update(follow_links=True))
    assert len(Dataset.load(home).records) == 2


def test_links_inside_the_folder_and_to_the_folder_are_followed(elsewhere: tuple[Path, Path]) -> None:
    home, other = elsewhere
    (home / "logs").mkdir()
    (other / "rec_0.csv").rename(home / "logs" / "rec_0.csv")
    (home / "rec_0.csv").symlink_to("logs/rec_0.csv")
    (other / "dataset").symlink_to(home, target_is_directory=True)
    assert len(Dataset.load(home).records) == len(Dataset.load(other / "dataset").records) == 2


def test_a_dataset_file_that_is_a_link_is_refused_unless_asked_for(elsewhere: tuple[Path, Path]) -> None:
    home, other = elsewhere
    (other / "rec_0.csv").rename(home / "rec_0.csv")
    (home / "dataset.yaml").rename(other / "dataset.yaml")
    (home / "dataset.yaml").symlink_to(other / "dataset.yaml")
    refused(lambda: Dataset.load(home), "dataset.yaml leads out of the folder")
    change_yaml(other, lambda found: found.update(follow_links=True))
    assert Dataset.load(home).records[0].source == str(home / "rec_0.csv")


secrets = st.lists(st.text("ghijkqwz:=-+/", min_size=12, max_size=60), min_size=1, max_size=6)


@given(secrets, st.booleans())
@quick
def test_messages_quote_nothing_of_what_is_no_record(tmp_path: Path, lines: list[str], newline: bool) -> None:
    content = "\n".join(lines) + "\n" * newline
    (tmp_path / "dataset.yaml").write_text(yaml.safe_dump(SOUND))
    for name in ("rec_0.csv", "model.yaml", "arm.xml", "a.json", "run.json"):
        (tmp_path / name).write_text(content)
    readers: tuple[Callable[[], object], ...] = (
        lambda: Dataset.load(tmp_path),
        lambda: load_model(tmp_path / "model.yaml"),
        lambda: load_tree(tmp_path / "arm.xml"),
        lambda: load_any(tmp_path / "a.json", ["t"]),
        lambda: read_run(tmp_path),
    )
    for read in readers:
        message = refused(read).replace(str(tmp_path), "")
        assert not any(line[:12] in message for line in lines), message


# ---- descriptions of robots (class 12) ----

BODY = '<body name="arm"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="j" axis="0 0 1"/>{}</body>'


def mjcf(inside: str = "", before: str = "") -> str:
    return f"<mujoco>{before}<worldbody>{BODY.format(inside)}</worldbody></mujoco>"


def mesh(name: str, compiler: str = "") -> str:
    asset = f'{compiler}<asset><mesh name="m" file="{name}"/></asset>'
    return mjcf('<geom type="mesh" mesh="m"/>', asset)


FLOOR = '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('<!DOCTYPE a [<!ENTITY b "c">]>' + mjcf("&b;"), "<!DOCTYPE is not read"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd">' + mjcf(), "<!DOCTYPE is not read"),
        (mjcf("&undeclared;"), "undefined entity"),
        (mjcf(before='<include file="../out.xml"/>'), "leads out of the folder"),
        (mjcf(before='<include file="linked.xml"/>'), "leads out of the folder"),
        (mjcf(before='<include file="arm.xml"/>'), "included twice or in a circle"),
        (mjcf(before='<include file="one.xml"/>'), "included twice or in a circle"),
        (mjcf(before='<include file="pipe"/>'), "is a pipe or a device"),
        (mesh("../out.stl"), "leads out of the folder"),
        (mesh("out.stl", '<compiler meshdir=".."/>'), "leads out of the folder"),
        (mesh("/dev/zero"), "leads out of the folder"),
        (mesh("pipe"), "is a pipe or a device"),
        (mjcf(before='<asset><texture name="t" type="2d" file="pipe"/></asset>'), "is a pipe or a device"),
        (mjcf("<geom size='1'/>" * 1_000_000), "more than 20000 elements"),
        (mjcf('<replicate count="1000"><replicate count="1000"><site/></replicate></replicate>'), "elements"),
        (mjcf('<flexcomp name="f" type="grid" count="99 99 99" spacing="1 1 1"/>'), "elements"),
        (mjcf("<body>" * 5000 + "</body>" * 5000), "nested deeper"),
        (mjcf("".join(f'<joint name="j{k}"/>' for k in range(999))), "300 joints"),
        (mjcf(before='<asset><texture name="t" builtin="flat" width="60000" height="60000"/></asset>'), "entries"),
        (mjcf(before='<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>'), "entries"),
        (mjcf(before='<size nuserdata="2000000000"/>'), "entries"),
        (mjcf().replace('"j"', f'"{"j" * 1_000_000}"'), "more than 200 signs"),
        ('<robot name="r"><link name="w" a:b="1"/></robot>', "unbound prefix"),
        (mjcf().replace('mass="1"', 'mass="nan"'), "'mass' of <inertial>"),
        (mjcf().replace('mass="1"', 'mass="inf"'), "'mass' of <inertial>"),
        (mjcf().replace('mass="1"', 'mass="1e300"'), "'mass' of <inertial>"),
        (mjcf().replace('axis="0 0 1"', 'range="-1 nan"'), "'range' of <joint> 'j'"),
        ("root:x:0:0", "row 1: no XML"),
        ("<html/>", "neither <mujoco> nor <robot>"),
    ],
)  # fmt: skip
def test_descriptions_that_reach_out_or_explode_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, word: str
) -> None:
    needs_pipes()
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)  # MuJoCo writes MUJOCO_LOG.TXT there, unless a file is refused before
    for name in ("out.xml", "out.stl"):
        (tmp_path / name).write_text(FLOOR)
    (home / "linked.xml").symlink_to(tmp_path / "out.xml")
    (home / "one.xml").write_text('<mujoco><include file="two.xml"/></mujoco>')
    (home / "two.xml").write_text('<mujoco><include file="one.xml"/></mujoco>')
    (home / "sub").mkdir()
    os.mkfifo(home / "pipe")
    (home / "arm.xml").write_text(text)
    refused(lambda: load_tree(home / "arm.xml"), str(home), word)
    assert not (home / "MUJOCO_LOG.TXT").exists()


@pytest.mark.parametrize("name", ["../out.stl", "gone\\..\\..\\out.stl"])
@pytest.mark.parametrize("urdf", [False, True])
def test_meshes_that_reach_out_are_refused_as_written(tmp_path: Path, name: str, *, urdf: bool) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "out.stl").write_bytes(b"solid")
    shape = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    text = f'<robot name="r"><link name="w"/><link name="a">{shape}</link></robot>' if urdf else mesh(name)
    (home / "arm.urdf").write_text(text)
    refused(lambda: load_tree(home / "arm.urdf"), str(home), "leads out of the folder")


def test_files_of_a_description_that_lie_beside_it_are_read(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "floor.xml").write_text(FLOOR)
    (tmp_path / "arm.xml").write_text(
        mesh("gone.stl").replace("<asset>", '<include file="parts/floor.xml"/><asset>')
    )
    assert load_tree(tmp_path / "arm.xml").names == ("j",)


def test_settings_as_large_as_any_are_still_read(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("a: [" + "0.25, " * 20_000 + "1]\nb: " + "[" * 50 + "]" * 50)
    assert len(read_yaml(tmp_path / "a.yaml")["a"]) == 20_001
