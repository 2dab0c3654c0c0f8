"""Bags of ROS 1 and ROS 2, written by the library that reads them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_formats import JOINTS

from hybrid_id.records.readers import bag
from hybrid_id.records.readers.bag import CONTROLLER, JOINT_STATE, _typestore

pytest.importorskip("rosbags")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

Message = tuple[str, int, Any]
STORE = {ros1: _typestore(ros1) for ros1 in (False, True)}


def header(stamp: int, ros1: bool) -> Any:
    types = STORE[ros1].types
    time = types["builtin_interfaces/msg/Time"](sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
    return types["std_msgs/msg/Header"](**({"seq": 0} if ros1 else {}), stamp=time, frame_id="")


def joint_state(stamp: int, joints: dict[str, float], ros1: bool = False, velocity: bool = True) -> Any:
    position = np.array([*joints.values()])
    return STORE[ros1].types[JOINT_STATE](
        header=header(stamp, ros1),
        name=[*joints],
        position=position,
        velocity=2 * position if velocity else np.empty(0),
        effort=np.empty(0),
    )


def array(values: list[float], ros1: bool = False) -> Any:
    types = STORE[ros1].types
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return types[bag.ARRAY](layout=layout, data=np.array(values))


def number(value: float, ros1: bool = False) -> Any:
    return STORE[ros1].types[bag.NUMBER](data=value)


def controller(stamp: int, generation: str, value: float, ros1: bool = False) -> Any:
    types = STORE[ros1].types
    points, multi = bag._GENERATIONS[generation]
    duration = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
    empty = np.empty(0)

    def point(k: int) -> Any:
        return types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array([value + k, -value]), velocities=empty, accelerations=empty, effort=empty,
            time_from_start=duration,
        )  # fmt: skip

    fields = {name: point(k) for k, name in enumerate(points)}
    if multi:
        fields["multi_dof_joint_names"] = []
    for name in multi:
        fields[f"multi_dof_{name}"] = types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"](
            transforms=[], velocities=[], accelerations=[], time_from_start=duration
        )
    return types[f"{CONTROLLER}{generation}"](header=header(stamp, ros1), joint_names=[*JOINTS], **fields)


def write_bag(
    path: Path, messages: list[Message], *, kind: str = "mcap", names: dict[str, str] | None = None
) -> Path:
    """Write messages (topic, log time [ns], message) into a new bag; `names` are types that the bag claims."""
    ros1, packing = kind.startswith("ros1"), kind.partition(" ")[2]
    if ros1:
        writer = Writer1(path)
        if packing:
            writer.set_compression(Writer1.CompressionFormat[packing.upper()])
    else:
        writer = Writer2(
            path, version=9, storage_plugin=StoragePlugin.MCAP if "mcap" in kind else StoragePlugin.SQLITE3
        )
        if packing:
            writer.set_compression(CompressionMode[packing.upper()], CompressionFormat.ZSTD)
    store, connections = STORE[ros1], {}
    with writer:
        for topic, stamp, message in messages:
            written = message.__msgtype__
            if topic not in connections:
                text = {"msgdef": "float64 x", "rihs01": "x", "md5sum": "0" * 32}
                extra = {k: text[k] for k in (("msgdef", "md5sum") if ros1 else ("msgdef", "rihs01"))}
                claimed = (names or {}).get(topic, CONTROLLER if written.startswith(CONTROLLER) else written)
                connections[topic] = writer.add_connection(topic, claimed, **extra)
            raw = store.serialize_ros1(message, written) if ros1 else store.serialize_cdr(message, written)
            writer.write(connections[topic], int(stamp), raw)
    return path
