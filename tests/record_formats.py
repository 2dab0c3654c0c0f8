"""One record of a drive in every format that is read, and the dataset file of each."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

JOINTS = ("shoulder_pan", "elbow")
TIME = np.arange(200) / 50.0
VOLTS = np.where(TIME < 0.1, 0.0, 3.0 * np.sin(5.0 * TIME))
ANGLE = 0.4 * np.sin(1.3 * TIME) + 0.1
NANOSECONDS = 1_700_000_000_000_000_000 + np.round(1e9 * TIME).astype(np.int64)


def write_yaml(folder: Path, file: str, columns: dict, **entry: object) -> Path:
    """Write the dataset file of one record; return the folder."""
    values = {
        "name": "drive",
        "inputs": [{"name": "u1", "unit": "V"}],
        "outputs": [{"name": "q_m1", "unit": "rad"}],
        "columns": columns,
        "records": [{"file": file, **entry}],
    }
    (folder / "dataset.yaml").write_text(yaml.safe_dump(values))
    return folder


def write_lerobot(
    folder: Path,
    episodes: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    names: Mapping[str, object],
    version: str = "v3.0",
    fps: int = 50,
) -> str:
    """Write episodes as a LeRobot dataset; return the file of the last.

    Args:
        folder: the dataset's.
        episodes: time ``(T,)``, states and actions ``(T, n)`` of each.
        names: of the elements of `observation.state` and of `action`.
        version: of the layout; before 3.0 each episode has a file of its own.
        fps: frames a second.
    """
    (folder / "meta").mkdir(parents=True)
    size = episodes[0][1].shape[1]
    features = {name: {"dtype": "float32", "shape": [size], "names": own} for name, own in names.items()}
    info = {"codebase_version": version, "fps": fps, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    one_file = version == "v3.0"
    vector = pa.list_(pa.float32(), size) if one_file else pa.list_(pa.float32())
    tables = [
        pa.table(
            {
                "observation.state": pa.array(states.astype("f4").tolist(), vector),
                "action": pa.array(actions.astype("f4").tolist(), vector),
                "timestamp": pa.array(time.astype("f4")),
                "frame_index": pa.array(np.arange(len(time))),
                "episode_index": pa.array(np.full(len(time), number)),
                "task": pa.array(["turn"] * len(time)),
            }
        )
        for number, (time, states, actions) in enumerate(episodes)
    ]
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    if one_file:
        pq.write_table(pa.concat_tables(tables), data / "file-000.parquet", row_group_size=150)
        return "data/chunk-000/file-000.parquet"
    for number, table in enumerate(tables):
        pq.write_table(table, data / f"episode_{number:06d}.parquet")
    return f"data/chunk-000/episode_{len(tables) - 1:06d}.parquet"
