"""Episodes of LeRobot datasets, versions 2.1 (one Parquet file an episode) and 3.0 (several in one file).

| column | from | unit |
| --- | --- | --- |
| `t` | `frame_index / fps`, `fps` from `meta/info.json` | s |
| `observation.state/NAME`, `action/NAME` | the element that `meta/info.json` names so | as recorded |
| `observation.state/0` | the element by its number | as recorded |
| `timestamp` and other single numbers | as they are | as recorded |

Source: github.com/huggingface/lerobot. Vectors are float32 there; they become float64 with the same values.
"""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import read_json
from hybrid_id.records.readers.parquet import is_number, open_parquet
from hybrid_id.records.readers.table import PIECE, Table, parsing, require_columns

if TYPE_CHECKING:
    import pyarrow as pa

_INFO = Path("meta") / "info.json"
_ABOVE = 4  # folders above the file in which `meta` may lie
_MOST_BYTES = 5_000_000  # of the JSON file
_WIDEST = 1000  # elements of one vector
_ROWS = PIECE // 100
_EPISODE, _FRAME = "episode_index", "frame_index"


def read_lerobot(path: Path, wanted: Collection[str], episode: int | None = None) -> Table:
    """Read the wanted columns of one episode.

    Args:
        path: The Parquet file, inside the dataset's folder.
        wanted: Names of the columns.
        episode: The episode's number; None where the file holds one only.

    Raises:
        InputError: for a damaged file, an episode that it does not hold, or a missing column.
    """
    info, source = _read_info(path)
    with parsing(path, "Parquet file"):
        file = open_parquet(path)
        fields = [name for name in file.schema_arrow.names if not file.schema_arrow.names.count(name) > 1]
        for name in (_EPISODE, _FRAME):
            if name not in fields:
                raise InputError(
                    f"{path} has no column '{name}', so it is no LeRobot episode; give its 'format'"
                )
        # field of the file and element for each wanted column but the time
        places: dict[str, tuple[str, int]] = {}
        available = ["t"]
        for name, names in _numbers(file.schema_arrow, info, source):
            if names is None:
                available.append(name)
                places[name] = (name, 0)
                continue
            available += [f"{name}/{element}" for element in names] or [f"{name}/0"]
            prefix = f"{name}/"
            for column in (column for column in wanted if column.startswith(prefix)):
                element = column.removeprefix(prefix)
                if element in names:
                    places[column] = (name, names.index(element))
                elif element.isascii() and element.isdecimal() and len(element) <= 3:
                    places[column] = (name, int(element))
        missing = [column for column in wanted if column not in places and column != "t"]
        require_columns(path, missing, available)
        columns = {column: places[column] for column in wanted if column != "t"}
        found = _rows(path, file, sorted({_FRAME, *(field for field, _ in columns.values())}), episode)
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 1e6:
        raise InputError(
            f"{source}: key 'fps' is {str(fps)[:40]}, but frames a second are needed; correct it"
        )
    values = {"t": found[_FRAME][:, 0] / (float(fps))}
    for name, (field, element) in columns.items():
        width = found[field].shape[1]
        if element >= width:
            raise InputError(
                f"{path}: column '{name}' is beyond the {width} elements of '{field}'; correct it"
            )
        values[name] = found[field][:, element]
    return Table(path, {name: values[name] for name in wanted}, lambda k: f"frame {found[_FRAME][k, 0]:.0f}")


def lerobot_names(path: Path) -> list[str]:
    """Names of all columns of an episode's file, elements of vectors by their own."""
    info, source = _read_info(path)
    found = ["t"]
    with parsing(path, "Parquet file"):
        file = open_parquet(path)
        for name, names in _numbers(file.schema_arrow, info, source):
            if names is None:
                found.append(name)
                continue
            first = next(file.iter_batches(1, columns=[name], use_threads=False), None)
            width = 0 if first is None else len(first[name][0])
            found += [f"{name}/{names[k] if len(names) == width else k}" for k in range(min(width, _WIDEST))]
    return found


def lerobot_episodes(path: Path) -> list[int]:
    """Numbers of the episodes that a file holds."""
    with parsing(path, "LeRobot episode", "bring the whole dataset"):
        file = open_parquet(path)
        parts = [
            np.unique(_matrix(path, batch[_EPISODE], _EPISODE))
            for batch in file.iter_batches(columns=[_EPISODE], use_threads=False)
        ]
    return sorted({int(number) for part in parts for number in part if np.isfinite(number)})


def in_lerobot(path: Path) -> Path | None:
    """The folder of the LeRobot dataset that a file or folder lies in, if it does."""
    folders = [path.resolve(), *path.resolve().parents][: _ABOVE + 1]
    return next((folder for folder in folders if (folder / _INFO).is_file()), None)


def _read_info(path: Path) -> tuple[dict[str, Any], Path]:
    """Read `meta/info.json` of the dataset that a file belongs to."""
    if not path.is_file():
        raise FileNotFoundError(path)
    folder = in_lerobot(path)
    if folder is None:
        raise InputError(
            f"{path} lies beside no meta/info.json, which holds the frame rate; bring the whole dataset"
        )
    source = folder / _INFO
    info = read_json(source, "description of a dataset", _MOST_BYTES)
    if not isinstance(info, dict):
        raise InputError(f"{source} is no description of a LeRobot dataset; bring it again")
    return info, source


def _numbers(
    schema: "pa.Schema", info: Mapping[str, Any], source: Path
) -> Iterator[tuple[str, list[str] | None]]:
    """Fields of numbers: None beside a single one, and beside a vector what `info.json` names its elements."""
    import pyarrow as pa

    for name in schema.names:
        kind = schema.field(name).type
        if is_number(kind):
            yield name, None
            continue
        vector = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
        if vector and (pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type)):
            yield name, _names(info, name, source)


def _names(info: Mapping[str, Any], field: str, source: Path) -> list[str]:
    """Names of a vector's elements; older datasets group them under one key."""
    features = info.get("features")
    feature = features.get(field) if isinstance(features, dict) else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict) and len(names) == 1:
        names = next(iter(names.values()))
    if not isinstance(names, list):
        return []
    if len(names) > _WIDEST or not all(isinstance(name, str) and len(name) <= 200 for name in names):
        raise InputError(
            f"{source}: the names of '{field}' are no list of at most {_WIDEST} short names; correct it"
        )
    return names


def _rows(path: Path, file: Any, fields: list[str], episode: int | None) -> dict[str, np.ndarray]:
    """Rows of one episode, field -> (T, width)."""
    parts: dict[str, list[np.ndarray]] = {name: [] for name in fields}
    met: set[int] = set()
    for batch in file.iter_batches(_ROWS, columns=sorted({_EPISODE, *fields}), use_threads=False):
        numbers = _matrix(path, batch[_EPISODE], _EPISODE)[:, 0]
        met |= {int(number) for number in np.unique(numbers[np.isfinite(numbers)])}
        rows = np.ones(len(numbers), bool) if episode is None else numbers == episode
        if rows.any() and (episode is not None or len(met) == 1):
            for name in fields:
                parts[name].append(_matrix(path, batch[name], name)[rows])
    if episode is None and len(met) > 1:
        raise InputError(
            f"{path} holds {len(met)} episodes, {min(met)} to {max(met)}; choose one by 'episode' in the record's entry"
        )
    if not parts[_FRAME]:
        have = f"holds episodes {min(met)} to {max(met)}" if met else "holds no episode"
        raise InputError(f"{path} {have}, not {episode}; name another file or 'episode'")
    try:
        return {name: np.concatenate(values) for name, values in parts.items()}
    except ValueError:
        raise InputError(f"{path} has vectors of changing length; write it again") from None


def _matrix(path: Path, column: "pa.Array", name: str) -> np.ndarray:
    """Values of a field as float64, (rows, width)."""
    import pyarrow as pa

    vectors = isinstance(column, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray)
    kind = column.type.value_type if vectors else column.type
    if not is_number(kind):
        raise InputError(f"{path}: column '{name}' is of type {str(column.type)[:60]}; write it as numbers")
    if not vectors:
        return column.to_numpy(zero_copy_only=False).astype(np.float64)[:, None]
    lengths = np.unique(column.value_lengths().to_numpy(zero_copy_only=False))
    if column.null_count or len(lengths) > 1 or not 0 < lengths[0] <= _WIDEST:
        raise InputError(
            f"{path}: vectors of '{name}' are missing, of changing length, or longer than {_WIDEST}; write it again"
        )
    return column.flatten().to_numpy(zero_copy_only=False).astype(np.float64).reshape(len(column), -1)
