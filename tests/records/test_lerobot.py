"""Episodes of LeRobot datasets of both layouts."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from record_formats import ANGLE, JOINTS, TIME, VOLTS, write_lerobot, write_yaml

from hybrid_id.errors import InputError
from hybrid_id.records.dataset import Dataset
from hybrid_id.records.readers import load_any

NAMES = [f"{joint}.pos" for joint in JOINTS]
COLUMNS = {"u1": "action/0", "q_m1": "observation.state/shoulder_pan.pos"}


def write_dataset(folder: Path, version: str, names: object = NAMES) -> str:
    """Write three episodes of the record, the first two backwards and at half size; return the file of the third."""
    episodes = [
        (TIME, np.column_stack([angle, 0 * angle]), np.column_stack([VOLTS, -VOLTS]))
        for angle in (-ANGLE, ANGLE / 2, ANGLE)
    ]
    return write_lerobot(folder, episodes, {"observation.state": names, "action": names}, version)


@pytest.mark.parametrize("names", [NAMES, {"motors": NAMES}])
@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episode_gives_the_record(tmp_path: Path, version: str, names: object) -> None:
    file = write_dataset(tmp_path, version, names)
    chosen = {"episode": 2} if version == "v3.0" else {}
    (record,) = Dataset.load(write_yaml(tmp_path, file, COLUMNS, format="lerobot", **chosen)).records
    assert record.name == ("file-000_episode_2" if chosen else "episode_000002")
    np.testing.assert_allclose(record.time, TIME, rtol=1e-15)
    np.testing.assert_array_equal(record.inputs["u1"], VOLTS.astype("f4").astype("f8"))
    np.testing.assert_array_equal(record.outputs["q_m1"], ANGLE.astype("f4").astype("f8"))
    table = load_any(tmp_path / file, ["timestamp"], file_format="lerobot", episode=2)
    np.testing.assert_array_equal(table.columns["timestamp"], TIME.astype("f4"))
    assert table.place(3) == "frame 3"


def change_info(**values: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "meta" / "info.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | values))

    return change


def cut_short(folder: Path) -> None:
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.write_bytes(path.read_bytes()[:1000])


def replace_column(name: str, values: Callable[[int], pa.Array]) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "data" / "chunk-000" / "file-000.parquet"
        table = pq.read_table(path)
        table = table.drop_columns([name]).append_column(name, values(len(table)))
        pq.write_table(table, path)

    return change


def bomb(folder: Path) -> None:
    count = 20_000_000
    rows = {
        "observation.state": pa.array([[0.0]] * 9),
        "action": pa.array([[0.0]] * 9),
        "episode_index": [2] * 9,
    }
    table = pa.table(rows | {"frame_index": range(9)})
    large = pa.ListArray.from_arrays(pa.array([0, *[count] * 9], pa.int32()), pa.array(np.zeros(count, "f4")))
    pq.write_table(
        table.set_column(1, "action", large),
        folder / "data" / "chunk-000" / "file-000.parquet",
        compression="zstd",
    )


def nothing(folder: Path) -> None:
    del folder


@pytest.mark.parametrize(
    ("change", "entry", "columns", "words"),
    [
        (nothing, {}, {}, ("holds 3 episodes, 0 to 2", "'episode'")),
        (nothing, {"episode": 7}, {}, ("holds episodes 0 to 2, not 7",)),
        (nothing, {"episode": 2}, {"u1": "action/5"}, ("'action/5' is beyond the 2 elements",)),
        (nothing, {"episode": 2}, {"u1": "action/elbow"}, ("no column 'action/elbow'", "action/elbow.pos")),
        (nothing, {"episode": 2, "format": "parquet"}, {}, ("'episode' chooses", "'format: lerobot'")),
        (nothing, {"format": "parquet"}, dict(t="timestamp", u1="action", q_m1="observation.state"),
         ("of type fixed_size_list", "give 'format: lerobot'")),
        (change_info(fps=0), {"episode": 2}, {}, ("info.json", "key 'fps' is 0")),
        (lambda f: (f / "meta" / "info.json").write_text("[" * 100_000), {"episode": 2}, {}, ("levels deep",)),
        (lambda f: (f / "meta" / "info.json").unlink(), {"episode": 2}, {}, ("beside no meta/info.json",)),
        (cut_short, {"episode": 2}, {}, ("file-000.parquet is not a readable Parquet file",)),
        (lambda f: (f / "data/chunk-000/file-000.parquet").unlink(), {"episode": 2}, {}, ("does not exist",)),
        (replace_column("frame_index", lambda n: pa.array([0] * n)), {"episode": 2}, {}, ("frame 0", "must increase")),
        (replace_column("action", lambda n: pa.array([[1.0]] * (n - 1) + [[1.0, 2.0]])), {"episode": 2}, {},
         ("vectors of 'action' are missing, of changing length",)),
        (replace_column("episode_index", lambda n: pa.array(["2"] * n)), {"episode": 2}, {}, ("is of type string",)),
        (bomb, {"episode": 2}, {}, ("file-000.parquet",)),
    ],
)  # fmt: skip
def test_what_is_wrong_with_an_episode_is_said(
    tmp_path: Path, change: Callable[[Path], object], entry: dict, columns: dict, words: tuple[str, ...]
) -> None:
    file = write_dataset(tmp_path, "v3.0")
    change(tmp_path)
    with pytest.raises(InputError) as caught:
        Dataset.load(write_yaml(tmp_path, file, COLUMNS | columns, **{"format": "lerobot"} | entry))
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert "\n" not in message
    assert len(message.replace(str(tmp_path), "")) < 320, message
