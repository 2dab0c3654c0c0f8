"""One uniform record, written as a ROS 1 bag, as MCAP, as a LeRobot dataset and as CSV, gives one and the same fit."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from drives import make_records, multisine, rigid_drive

from hybrid_id.records.dataset import Dataset
from hybrid_id.records.readers.bag import ARRAY, JOINT_STATE, _typestore
from hybrid_id.records.record import Record
from hybrid_id.study import identify

HELD = ("P_m1", "P_m2")
"""Parameters that voltage and angle leave open beside the others."""
APART = 0.01
"""Standard errors by which the fits may differ."""
FPS = 500
"""Samples a second of the record."""


def as_csv(folder: Path, record: Record) -> dict:
    frame = pd.DataFrame(
        {"time_ms": 1e3 * record.time, "volts": record.inputs["u1"], "q": record.outputs["q_m1"]}
    )
    frame.to_csv(folder / "run.csv", index=False)
    columns = {"t": {"column": "time_ms", "unit": "ms"}, "u1": "volts", "q_m1": "q"}
    return {"columns": columns, "records": [{"file": "run.csv"}]}


def as_lerobot(folder: Path, record: Record) -> dict:
    names = {"observation.state": ["elbow.pos"], "action": ["elbow.volts"]}
    features = {name: {"dtype": "float32", "shape": [1], "names": own} for name, own in names.items()}
    (folder / "meta").mkdir()
    info = {"codebase_version": "v3.0", "fps": FPS, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    vector = pa.list_(pa.float32(), 1)
    values = {"observation.state": record.outputs["q_m1"], "action": record.inputs["u1"]}
    rows = {name: pa.array(one.astype("f4")[:, None].tolist(), vector) for name, one in values.items()}
    rows |= {
        "frame_index": np.arange(record.n_samples),
        "episode_index": np.zeros(record.n_samples, dtype=int),
    }
    (folder / "data").mkdir()
    pq.write_table(pa.table(rows), folder / "data" / "file-000.parquet")
    columns = {"u1": "action/elbow.volts", "q_m1": "observation.state/elbow.pos"}
    return {"format": "lerobot", "columns": columns, "records": [{"file": "data/file-000.parquet"}]}


def as_bag(folder: Path, record: Record, ros1: bool) -> dict:
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    store = _typestore(ros1)
    types, name = store.types, "run.bag" if ros1 else "run"
    writer = (
        Writer1(folder / name)
        if ros1
        else Writer2(folder / name, version=9, storage_plugin=StoragePlugin.MCAP)
    )
    pack = store.serialize_ros1 if ros1 else store.serialize_cdr
    layout, none = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), np.empty(0)
    with writer:
        topics = {"/joint_states": JOINT_STATE, "/commands": ARRAY}
        at = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        for time, volts, angle in zip(record.time, record.inputs["u1"], record.outputs["q_m1"], strict=True):
            stamp = 1_700_000_000_000_000_000 + round(1e9 * time)
            parts = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
            header = types["std_msgs/msg/Header"](**({"seq": 0} if ros1 else {}), stamp=parts, frame_id="")
            state = types[JOINT_STATE](
                header=header, name=["elbow"], position=np.array([angle]), velocity=none, effort=none
            )
            command = types[ARRAY](layout=layout, data=np.array([volts]))
            writer.write(at["/commands"], stamp, pack(command, ARRAY))
            writer.write(at["/joint_states"], stamp, pack(state, JOINT_STATE))
    columns = {"t": "/joint_states", "u1": "/commands/data/0", "q_m1": "/joint_states/position/elbow"}
    return {"columns": columns, "records": [{"file": name if ros1 else "run/run.mcap"}]}


WRITERS: dict[str, Callable[[Path, Record], dict]] = {
    "lerobot": as_lerobot,
    "bag": lambda folder, record: as_bag(folder, record, True),
    "mcap": lambda folder, record: as_bag(folder, record, False),
}


def fitted(
    folder: Path, write: Callable[[Path, Record], dict], record: Record
) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and their standard errors."""
    folder.mkdir()
    channels = {
        "name": "drive",
        "inputs": [{"name": "u1", "unit": "V"}],
        "outputs": [{"name": "q_m1", "unit": "rad"}],
    }
    (folder / "dataset.yaml").write_text(yaml.safe_dump(channels | write(folder, record)))
    model = rigid_drive().with_values({"F_c": 0.014, "J": 2.5e-5})
    model = model.with_specs({name: replace(model.parameter(name).spec, estimate=False) for name in HELD})
    study = identify(Dataset.load(folder), model)
    return np.ravel(study.values), study.standard_errors(0)


@pytest.fixture(scope="module")
def record() -> Record:
    return make_records(rigid_drive(), [multisine(3, samples=1000, amplitude=8.0)], noise={"q_m1": 0.01})[0]


@pytest.fixture(scope="module")
def from_csv(record: Record, tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    return fitted(tmp_path_factory.mktemp("csv") / "csv", as_csv, record)


@pytest.mark.parametrize("kind", WRITERS)
def test_same_fit(tmp_path: Path, record: Record, from_csv: tuple[np.ndarray, np.ndarray], kind: str) -> None:
    values, errors = from_csv
    found, _ = fitted(tmp_path / kind, WRITERS[kind], record)
    assert np.all((errors > 0) & np.isfinite(errors))
    assert np.max(np.abs(found - values) / errors) <= APART


def test_a_sample_late_is_seen(
    tmp_path: Path, record: Record, from_csv: tuple[np.ndarray, np.ndarray]
) -> None:
    """What a reader that pairs the wrong samples would cost: the limit above is far below it."""
    late = Record(
        "late", record.time[1:], {"u1": record.inputs["u1"][:-1]}, {"q_m1": record.outputs["q_m1"][1:]}
    )
    values, errors = from_csv
    found, _ = fitted(tmp_path / "late", as_csv, late)
    assert np.max(np.abs(found - values) / errors) > 100 * APART
