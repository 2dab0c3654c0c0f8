"""ROS 1 bags (`.bag`), ROS 2 bags (a folder, `.mcap` or `.db3`) by the library `rosbags`.

| message | columns of the topic `/state` |
| --- | --- |
| sensor_msgs/JointState | `/state/position/JOINT`, `velocity`, `effort` |
| control_msgs/JointTrajectoryControllerState | `/state/feedback/positions/JOINT`, other fields of the message alike |
| std_msgs/Float64MultiArray | `/state/data/0`, `/state/data/1` ... |
| std_msgs/Float64 | `/state/data` |

The topic's name alone is the column of its stamps, in seconds since the first one: those of the messages that hold the
first of the topic's wanted columns. A column that other messages hold has its own stamps in `Table.times`. A stamp is
that of the message's header, or the time of recording where a topic has no header or leaves all its stamps at zero.

Messages are decoded by the definitions below and never by those that a bag carries, from which the library would
generate code.
"""

import re
import sqlite3
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hybrid_id.errors import InputError, listed
from hybrid_id.reading import size_of
from hybrid_id.records.files import natural_order
from hybrid_id.records.readers.table import Table, parsing, require_columns

JOINT_STATE = "sensor_msgs/msg/JointState"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
ARRAY, NUMBER = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float64"
KINDS = (JOINT_STATE, CONTROLLER, ARRAY, NUMBER)

_STORAGES = re.compile(r"\.(mcap|db3)(\.zstd)?$")
_ZSTD = b"\x28\xb5\x2f\xfd"
_POINT, _MULTI = "trajectory_msgs/JointTrajectoryPoint", "trajectory_msgs/MultiDOFJointTrajectoryPoint"
# Layouts of the controller's state: single joints, joints of several degrees of freedom. Each is longer than the last.
_GENERATIONS = {
    "Desired": (("desired", "actual", "error"), ()),
    "Reference": (("reference", "feedback", "error", "output"),) * 2,
    "Both": (("reference", "feedback", "error", "output", "desired", "actual"),) * 2,
}
_POINT_FIELDS = ("positions", "velocities", "accelerations", "effort")
_MOST_VALUES = 10_000  # in one message
_MOST_COLUMNS = 1000  # of one topic, in what a message lists
_LONGEST = 200  # signs of a joint's name
_PEEKED = 50  # messages of each topic that are looked at for the names of its columns


def is_bag_folder(path: Path) -> bool:
    """Whether a folder holds the files of a ROS 2 bag."""
    return path.is_dir() and any(_STORAGES.search(file.name) for file in path.iterdir())


def read_bag(path: Path, wanted: Collection[str]) -> Table:
    """Read the wanted columns of a bag; the name of a topic stands for its stamps.

    Raises:
        InputError: for a damaged bag, a message type that is not read, or a missing column.
    """
    with _opened(path) as (readers, kinds):
        from rosbags.rosbag1 import Reader as Reader1

        topics = _topics(path, wanted, kinds)
        for topic in topics.values():
            for reader in readers:
                topic.add(reader, isinstance(reader, Reader1), path)
        for topic in topics.values():
            require_columns(path, topic.missing(), _available(readers, topic, path))
    # one zero of time: the first stamp of the topic whose stamps are wanted
    times, stamps_of = {}, {name: topic.stamps() for name, topic in topics.items()}
    columns = {
        name: np.array(column.values) for topic in topics.values() for name, column in topic.columns.items()
    }
    clocks = [name for name in wanted if name in topics]
    rows = {}
    for name, topic in topics.items():
        first = next(iter(topic.columns.values()), None)
        rows[name] = np.arange(len(topic.logged)) if first is None else np.array(first.rows)
    clock = clocks[0] if clocks else next(iter(topics))
    zero = stamps_of[clock][rows[clock][0]]
    for name, topic in topics.items():
        for key, column in topic.columns.items():
            own = np.array(column.rows)
            if name != clock or not np.array_equal(own, rows[clock]):
                times[key] = 1e-9 * (stamps_of[name][own] - zero)
    columns |= {name: 1e-9 * (stamps_of[name][rows[name]] - zero) for name in clocks}
    return Table(
        path,
        {name: columns[name] for name in wanted},
        lambda k: f"message {rows[clock][k] + 1} of {clock}",
        stamps=frozenset(clocks),
        times=times,
    )


def bag_names(path: Path) -> list[str]:
    """Names of all columns of a bag: of each topic that is read its own, for its stamps, and those of its values."""
    found: list[str] = []
    with _opened(path) as (readers, kinds):
        for topic, kind in kinds.items():
            if kind in KINDS:
                found += [topic, *_available(readers, _Topic(topic, kind), path)]
    return found


@contextmanager
def _opened(path: Path) -> Iterator[tuple[list[Any], dict[str, str]]]:
    """Readers of a bag's files, and the type of each topic's messages."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise InputError(
            f"{path}: reading a ROS bag needs rosbags; install it with pip install 'hybrid_id[logs]'."
        ) from None
    with parsing(path, "bag", "record or copy it again, or recover its index"), ExitStack() as stack:
        # open every storage file of a bag
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2

        files = [path]
        if path.is_dir():
            files = sorted(
                (file for file in path.iterdir() if _STORAGES.search(file.name)),
                key=lambda file: natural_order(file.name),
            )
            if not files:
                raise InputError(f"{path} is a folder without .mcap or .db3 files; name a ROS 2 bag's folder")
        readers = []
        for file in files:
            size_of(file)
            if file.suffix == ".zstd":
                folder = Path(stack.enter_context(TemporaryDirectory()))
                (folder / file.stem).write_bytes(_zstd().decompress(file.read_bytes()))
                file = folder / file.stem
            kind = file.suffix.lower()
            if kind not in (".bag", ".mcap", ".db3"):
                raise InputError(
                    f"{path} is no bag that is read; give a .bag, .mcap or .db3 file, or a ROS 2 bag's folder"
                )
            if kind == ".db3":
                _refuse_code(file, path)
            reader = (Reader1 if kind == ".bag" else Reader2)(file)
            stack.enter_context(reader)
            readers.append(reader)
        yield readers, {c.topic: c.msgtype for reader in readers for c in reader.connections}


def _refuse_code(file: Path, bag: Path) -> None:
    """Refuse a database whose tables are views, triggers or computed columns: such run what their author wrote."""
    connection = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    try:
        rows = connection.execute("SELECT type, sql FROM sqlite_master LIMIT 1000").fetchall()
    finally:
        connection.close()
    for kind, text in rows:
        if kind not in ("table", "index") or re.search(r"\b(AS|VIRTUAL)\b", text or "", re.IGNORECASE):
            raise InputError(f"{bag}: its database holds a {kind} that no recorder writes; record it anew")


def _zstd() -> Any:
    try:
        from compression import zstd  # pyright: ignore[reportMissingImports]
    except ImportError:
        from backports import zstd  # pyright: ignore[reportMissingImports]
    return zstd


def _topics(path: Path, wanted: Collection[str], kinds: Mapping[str, str]) -> "dict[str, _Topic]":
    """Sort the wanted columns by their topics."""
    topics: dict[str, _Topic] = {}
    for name in wanted:
        parts = name.split("/")
        starts = ("/".join(parts[:k]) for k in range(len(parts), 0, -1))
        topic = next((start for start in starts if start in kinds), None)
        if topic is None:
            rule = (
                "name the topic whose stamps count, 'columns: {t: /joint_states}'"
                if name == "t"
                else "name the right one under 'columns' in the dataset file"
            )
            found = listed(
                f"{topic} ({_short(kind)})" for topic, kind in sorted(kinds.items())[:_MOST_COLUMNS]
            )
            raise InputError(f"{path} has no topic for column '{name}' (topics are {found[:150]}); {rule}")
        if kinds[topic] not in KINDS:
            raise InputError(
                f"{path}: topic '{topic[:80]}' is of type {_short(kinds[topic])[:80]}, which is not read (read are "
                f"{', '.join(_short(kind).split('/')[1] for kind in KINDS)}); record one of those, or write a CSV file"
            )
        place = topics.setdefault(topic, _Topic(topic, kinds[topic]))
        if name != topic:
            # see what a column's name asks of a message
            parts = name[len(topic) + 1 :].split("/", 2)
            kind = kinds[topic]
            if kind == NUMBER and parts == ["data"]:
                place.columns[name] = _Column(("data",), "")
            elif kind == ARRAY and len(parts) == 2 and parts[0] == "data":
                place.columns[name] = _Column(("data",), parts[1])
            elif kind == JOINT_STATE and len(parts) >= 2 and parts[0] in ("position", "velocity", "effort"):
                place.columns[name] = _Column((parts[0],), "/".join(parts[1:]))
            elif kind == CONTROLLER and len(parts) == 3 and parts[1] in _POINT_FIELDS:
                place.columns[name] = _Column((parts[0], parts[1]), parts[2])
            else:
                forms = {
                    NUMBER: "/data",
                    ARRAY: "/data/0",
                    JOINT_STATE: "/position/JOINT, /velocity/JOINT and /effort/JOINT",
                    CONTROLLER: "/feedback/positions/JOINT and the like",
                }
                raise InputError(
                    f"{path}: column '{name}' is none of a {_short(kind)}, whose columns are the topic's name and "
                    f"{forms[kind]}; name one of them under 'columns' in the dataset file"
                )
    return topics


@dataclass
class _Column:
    """Where a column's number lies in a message, and what was found there."""

    fields: tuple[str, ...]
    key: str
    rows: list[int] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def add(self, row: int, message: Any, places: Mapping[str, int]) -> None:
        """Take the number of one message, where it holds one."""
        for name in self.fields:
            message = getattr(message, name, None)
        if message is None:
            return
        if self.key:
            place = places.get(self.key, -1)
            if not 0 <= place < len(message):
                return
            message = message[place]
        self.rows.append(row)
        self.values.append(float(message))


@dataclass
class _Topic:
    """What is read of one topic."""

    name: str
    kind: str
    columns: dict[str, _Column] = field(default_factory=dict)
    logged: list[int] = field(default_factory=list)  # ns
    stamped: list[int] = field(default_factory=list)  # ns

    def add(self, reader: Any, ros1: bool, path: Path) -> None:
        """Read all messages of one file."""
        for row, (log_time, stamp, message, places) in enumerate(
            _messages(reader, self.name, self.kind, ros1, path), start=len(self.logged)
        ):
            self.logged.append(log_time)
            self.stamped.append(stamp)
            for column in self.columns.values():
                column.add(row, message, places)

    def missing(self) -> list[str]:
        """The columns that no message holds, or the topic itself where it has no messages."""
        if not self.logged:
            return [*self.columns] or [self.name]
        return [name for name, column in self.columns.items() if not column.rows]

    def stamps(self) -> np.ndarray:
        """Stamps of all messages, (N,), ns."""
        return np.array(self.stamped if any(self.stamped) else self.logged, dtype=np.int64)


def _messages(
    reader: Any, topic: str, kind: str, ros1: bool, path: Path
) -> Iterator[tuple[int, int, Any, Mapping[str, int]]]:
    """Log time and header stamp (ns), message, and place of each joint or element, of every message of a topic."""
    connections = [c for c in reader.connections if c.topic == topic]
    if not connections:
        return
    if any(c.msgtype != kind for c in connections):
        raise InputError(f"{path}: topic '{topic}' has messages of several types; record it anew")
    decode, names, places = _decoder(kind, ros1), None, {}
    for row, (_, log_time, raw) in enumerate(reader.messages(connections=connections)):
        raw = bytes(raw)  # which a recorder may have packed one by one
        try:
            message = decode(_zstd().decompress(raw) if raw.startswith(_ZSTD) else raw)
        except ValueError as error:
            raise InputError(
                f"{path}: message {row + 1} of '{topic}' cannot be decoded as {_short(kind)} ({error}); record it anew"
            ) from None
        stamp = 0
        if kind in (JOINT_STATE, CONTROLLER):
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            found = message.name if kind == JOINT_STATE else message.joint_names
            if found != names or not found:
                names = found
                if any(len(name) > _LONGEST for name in names):
                    raise InputError(
                        f"{path}: topic '{topic}' names a joint in more than {_LONGEST} signs; shorten the name"
                    )
                places = {name: k for k, name in enumerate(names)} or _numbered(
                    len(message.position) if kind == JOINT_STATE else 0
                )
        elif kind == ARRAY and len(message.data) != len(places):
            places = _numbered(len(message.data))
        yield log_time, stamp, message, places


def _numbered(count: int) -> dict[str, int]:
    return {str(k): k for k in range(count)}


def _decoder(kind: str, ros1: bool) -> Callable[[bytes], Any]:
    """The function that decodes messages of a kind, by whichever of its layouts fits to the last byte."""
    store = _typestore(ros1)
    read = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    layouts = [f"{CONTROLLER}{name}" for name in _GENERATIONS] if kind == CONTROLLER else [kind]

    def decode(raw: bytes) -> Any:
        reason = ""
        for k, layout in enumerate(layouts):
            try:
                message = read(raw, layout)
            except Exception as error:  # what is no such message can make the parser stumble in any way
                reason = " ".join(str(error).split())[:80]
                continue
            layouts.insert(0, layouts.pop(k))
            return message
        raise ValueError(reason)

    return decode


@cache
def _typestore(ros1: bool) -> Any:
    """The library's own definitions, and those of control_msgs, which it lacks."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store.max_sequence_length = _MOST_VALUES
    for name, (points, multi) in _GENERATIONS.items():
        lines = ["std_msgs/Header header", "string[] joint_names", *(f"{_POINT} {point}" for point in points)]
        if multi:
            lines += ["string[] multi_dof_joint_names", *(f"{_MULTI} multi_dof_{point}" for point in multi)]
        store.register(get_types_from_msg("\n".join(lines), f"{CONTROLLER}{name}"))
    return store


def _available(readers: Sequence[Any], topic: _Topic, path: Path) -> list[str]:
    """Names of the columns that the first messages of a topic have, where one is missing."""
    from rosbags.rosbag1 import Reader as Reader1

    found: dict[str, None] = {}
    for reader in readers if topic.missing() else ():
        messages = _messages(reader, topic.name, topic.kind, isinstance(reader, Reader1), path)
        for _, (_, _, message, places) in zip(range(_PEEKED), messages, strict=False):
            found |= dict.fromkeys(_names(topic.name, topic.kind, message, places)[:_MOST_COLUMNS])
    return [*found]


def _names(topic: str, kind: str, message: Any, places: Mapping[str, int]) -> list[str]:
    """Names of the columns of one message."""
    if kind == NUMBER:
        return [f"{topic}/data"]
    if kind == ARRAY:
        return [f"{topic}/data/{key}" for key in places]
    groups = {
        group: getattr(message, group) for group in ("position", "velocity", "effort") if kind == JOINT_STATE
    }
    if kind == CONTROLLER:
        points = [point for point in _GENERATIONS["Both"][0] if hasattr(message, point)]
        groups = {f"{p}/{f}": getattr(getattr(message, p), f) for p in points for f in _POINT_FIELDS}
    return [
        f"{topic}/{group}/{key}"
        for group, values in groups.items()
        for key, k in places.items()
        if k < len(values)
    ]


def _short(kind: str) -> str:
    """The type's name as ROS 1 writes it, which both generations of users know."""
    return kind.replace("/msg/", "/")
