"""Bags of ROS 1 and ROS 2, written by the library that reads them."""

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import Message, array, controller, joint_state, number, write_bag
from malformed import read_afresh
from record_formats import ANGLE, JOINTS, NANOSECONDS, TIME, VOLTS, write_yaml

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.logs import find_logs, read_log
from hybrid_id.records.readers import bag, load_any
from hybrid_id.records.readers.bag import JOINT_STATE

COLUMNS = {"t": "/joint_states", "q_m1": "/joint_states/position/shoulder_pan", "u1": "/commands/data/0"}


def uniform(ros1: bool = False) -> Iterator[Message]:
    """The record of `record_formats.py`: joints in changing order, a header's stamps, log times a little later."""
    for k, stamp in enumerate(NANOSECONDS):
        joints = {JOINTS[0]: ANGLE[k], JOINTS[1]: -1.0}
        if k % 3 == 1:
            joints = dict(reversed(joints.items()))
        yield "/commands", stamp, array([VOLTS[k], 7.0], ros1)
        yield "/joint_states", stamp + 1000, joint_state(stamp, joints, ros1)


@pytest.mark.parametrize(
    "kind",
    ["mcap", "mcap storage", "sqlite3", "sqlite3 file", "sqlite3 message", "ros1", "ros1 bz2", "ros1 lz4"],
)
def test_every_kind_of_bag_gives_the_record(tmp_path: Path, kind: str) -> None:
    name = "run.bag" if kind.startswith("ros1") else "run"
    write_bag(tmp_path / name, list(uniform(kind.startswith("ros1"))), kind=kind)
    (record,) = Dataset.load(write_yaml(tmp_path, name, COLUMNS)).records
    assert record.name == "run"
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    np.testing.assert_array_equal(record.inputs["u1"], VOLTS)
    np.testing.assert_array_equal(record.outputs["q_m1"], ANGLE)


@pytest.mark.parametrize(("kind", "ending"), [("mcap", "mcap"), ("sqlite3", "db3")])
def test_bag_without_its_metadata(tmp_path: Path, kind: str, ending: str) -> None:
    write_bag(tmp_path / "run", list(uniform()), kind=kind)
    (tmp_path / "run" / "metadata.yaml").unlink()
    for file in ("run", f"run/run.{ending}"):
        (record,) = Dataset.load(write_yaml(tmp_path, file, COLUMNS)).records
        np.testing.assert_array_equal(record.outputs["q_m1"], ANGLE)


def test_a_pattern_finds_folders_of_bags(tmp_path: Path) -> None:
    for name in ("run_1", "run_2"):
        write_bag(tmp_path / name, list(uniform())[:20])
    (tmp_path / "run_3").mkdir()
    assert [record.name for record in Dataset.load(write_yaml(tmp_path, "run_*", COLUMNS)).records] == [
        "run_1",
        "run_2",
    ]


def test_topics_of_other_stamps_are_held_and_interpolated(tmp_path: Path) -> None:
    """Commands at a third of the rate are held; the link's angle, a straight line, is read off between samples."""
    messages: list[Message] = []
    for k, stamp in enumerate(NANOSECONDS):
        messages.append(("/joint_states", stamp, joint_state(stamp, {"a": ANGLE[k]})))
        if k % 3 == 2:
            messages.append(("/volts", stamp, number(float(k))))
        late = stamp + 7_000_000
        messages.append(("/link", late, joint_state(late, {"a": 2.0 * (TIME[k] + 0.007)})))
    write_bag(tmp_path / "run", messages)
    folder = write_yaml(
        tmp_path, "run", {"t": "/joint_states", "u1": "/volts/data", "q_m1": "/link/position/a"}
    )
    (record,) = Dataset.load(folder).records
    np.testing.assert_allclose(record.time, TIME[2:], atol=1e-9)
    np.testing.assert_array_equal(record.inputs["u1"], [k - (k + 1) % 3 for k in range(2, 200)])
    np.testing.assert_allclose(record.outputs["q_m1"], 2.0 * TIME[2:], atol=1e-9)


def test_joints_in_subsets(tmp_path: Path) -> None:
    """Two nodes publish on one topic, each its own joints: the first channel's messages give the stamps."""
    messages = [
        ("/joint_states", stamp + shift, joint_state(stamp + shift, {joint: float(k)}))
        for k, stamp in enumerate(NANOSECONDS)
        for joint, shift in (("a", 0), ("b", 10_000_000))
    ]
    write_bag(tmp_path / "run", messages)
    table = load_any(
        tmp_path / "run", ["/joint_states", "/joint_states/position/a", "/joint_states/position/b"]
    )
    np.testing.assert_array_equal(table.columns["/joint_states/position/b"], np.arange(200.0))
    np.testing.assert_allclose(table.columns["/joint_states"], TIME, atol=1e-9)
    assert [*table.times] == ["/joint_states/position/b"]
    np.testing.assert_allclose(table.times["/joint_states/position/b"], TIME + 0.01, atol=1e-9)
    assert table.place(3) == "message 7 of /joint_states"


@pytest.mark.parametrize("generation", ["Desired", "Reference", "Both"])
@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_controller_states_of_every_generation(tmp_path: Path, generation: str, kind: str) -> None:
    path = tmp_path / ("run.bag" if kind == "ros1" else "run")
    messages = [
        ("/state", stamp, controller(stamp, generation, ANGLE[k], kind == "ros1"))
        for k, stamp in enumerate(NANOSECONDS)
    ]
    write_bag(path, messages, kind=kind)
    for k, field in enumerate(bag._GENERATIONS[generation][0]):
        column = f"/state/{field}/positions/shoulder_pan"
        np.testing.assert_array_equal(load_any(path, ["/state", column]).columns[column], ANGLE + k)


def test_log_time_stands_in_for_empty_headers(tmp_path: Path) -> None:
    write_bag(tmp_path / "run", [("/j", stamp, joint_state(0, {"a": 1.0})) for stamp in NANOSECONDS])
    np.testing.assert_allclose(
        load_any(tmp_path / "run", ["/j", "/j/position/a"]).columns["/j"], TIME, atol=1e-9
    )


def changed(change: Callable[[Path], object], kind: str = "mcap", **columns: str) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        file = "run.bag" if kind.startswith("ros1") else "run"
        write_bag(folder / file, list(uniform(kind.startswith("ros1"))), kind=kind)
        change(folder / file)
        return write_yaml(folder, file, COLUMNS | columns)

    return build


def cut(ending: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        file = path / f"run.{ending}" if ending != "bag" else path
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])

    return change


def run_sql(text: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with sqlite3.connect(path / "run.db3") as connection:
            connection.executescript(text)

    return change


def other_bag(messages: Callable[[], list[Message]], **options: Any) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        write_bag(folder / "run", messages(), **options)
        return write_yaml(folder, "run", COLUMNS)

    return build


def nothing(path: Path) -> None:
    del path


def gap() -> list[Message]:
    return [("/joint_states", s, joint_state(s, {"shoulder_pan": 1.0})) for s in NANOSECONDS] + [
        ("/commands", s + 5 * 10**12, array([1.0])) for s in NANOSECONDS
    ]


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (changed(cut("mcap")), ("run", "not a readable bag")),
        (changed(cut("db3"), "sqlite3"), ("run", "not a readable bag")),
        (changed(nothing, u1="/volts/data/0"), ("no topic for column '/volts/data/0'", "/commands (std_msgs/Float64M")),
        (changed(nothing, t="t"), ("no topic for column 't'", "{t: /joint_states}")),
        (changed(nothing, q_m1="/joint_states/position/elbwo"), ("'/joint_states/position/elbow'", "did you mean")),
        (changed(nothing, q_m1="/joint_states/angle/elbow"), ("is none of a sensor_msgs/JointState",)),
        (changed(nothing, u1="/commands/data/2"), ("no column '/commands/data/2'", "/commands/data/1")),
        (changed(run_sql("CREATE VIEW v AS SELECT 1;"), "sqlite3"), ("holds a view",)),
        (other_bag(lambda: list(uniform()), names={"/commands": "my_msgs/msg/Volts"}), ("my_msgs/Volts", "not read")),
        (other_bag(lambda: [("/joint_states", 1, array([1.0])), *uniform()], names={"/joint_states": JOINT_STATE}),
         ("message 1 of '/joint_states' cannot be decoded as sensor_msgs/JointState",)),
        (other_bag(lambda: [("/joint_states", 5, joint_state(5, {"a" * 900: 1.0})), ("/commands", 5, array([1.0]))]),
         ("names a joint in more than 200 signs",)),
        (other_bag(gap), ("'u1' is stamped from", "another clock")),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_bag_is_said(
    tmp_path: Path, build: Callable[[Path], Path], words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        Dataset.load(build(tmp_path))
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert "\n" not in message
    assert len(message.replace(str(tmp_path), "")) < 320, message


def test_a_bag_that_unpacks_to_more_than_fits_is_refused(tmp_path: Path) -> None:
    message = ("/blob", NANOSECONDS[0], array([0.0] * 14_000_000))
    write_bag(tmp_path / "run", [*uniform(), message], kind="mcap storage")
    assert (tmp_path / "run" / "run.mcap").stat().st_size < 1_000_000
    assert "unpacks to more than" in read_afresh(write_yaml(tmp_path, "run", COLUMNS))


def test_gaps_of_an_interpolated_topic_are_refused(tmp_path: Path) -> None:
    messages: list[Message] = [("/commands", s, array([VOLTS[k]])) for k, s in enumerate(NANOSECONDS)]
    messages += [
        ("/joint_states", s + 10**6, joint_state(s + 10**6, {JOINTS[0]: ANGLE[k]}))
        for k, s in enumerate(NANOSECONDS)
        if not 100 < k < 110
    ]
    write_bag(tmp_path / "run", messages)
    with pytest.raises(InputError, match=r"after 2.001 s 'q_m1' has no sample for 200 ms"):
        Dataset.load(write_yaml(tmp_path, "run", COLUMNS | {"t": "/commands"}))
    folder = write_yaml(tmp_path, "run", COLUMNS | {"t": "/commands"}, between=[0.1, 1.9])
    assert Dataset.load(folder).records[0].duration > 1.7


def test_an_interpolated_angle_that_jumps_by_a_turn_is_refused_and_seen_by_its_jumps(tmp_path: Path) -> None:
    turning = np.mod(8.0 * TIME / TIME[-1] + np.pi, 2 * np.pi) - np.pi
    messages = [*uniform()]
    for k, stamp in enumerate(NANOSECONDS):
        own = stamp + 7_000_000
        messages.append(("/link", own, joint_state(own, {"link": turning[k]}, velocity=False)))
    path = write_bag(tmp_path / "run", sorted(messages, key=lambda one: one[1]))
    columns = COLUMNS | {"q_m1": "/link/position/link"}
    with pytest.raises(InputError, match=r"run: 'q_m1' jumps by a turn, first at .* s"):
        Dataset.load(write_yaml(tmp_path, "run", columns))
    log = read_log(find_logs([path])[0])
    steps = np.abs(np.diff(log.columns["/link/position/link"]))
    assert ((steps > 0.8 * 2 * np.pi) | (steps < 1.0)).all() and (steps > 6.0).any()


def test_the_library_is_asked_for_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag1", None)
    (tmp_path / "run.bag").touch()
    with pytest.raises(InputError, match=r"needs rosbags; install it with pip install 'hybrid_id\[logs\]'"):
        load_any(tmp_path / "run.bag", ["/a"])
