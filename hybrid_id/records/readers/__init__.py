"""Readers, one file a format; each takes a path and the names of the wanted columns and returns a `Table`."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from hybrid_id.errors import InputError
from hybrid_id.reading import size_of
from hybrid_id.records.readers.bag import bag_names, is_bag_folder, read_bag
from hybrid_id.records.readers.bam import bam_names, read_bam
from hybrid_id.records.readers.csv_text import csv_names, read_csv
from hybrid_id.records.readers.lerobot import in_lerobot, lerobot_episodes, lerobot_names, read_lerobot
from hybrid_id.records.readers.mat import mat_names, read_mat
from hybrid_id.records.readers.npz import npz_names, read_npz
from hybrid_id.records.readers.parquet import parquet_names, read_parquet
from hybrid_id.records.readers.table import Table, TimeRange, record_name, refuse_excess

READERS: dict[str, tuple[Callable[..., Table], Callable[[Path], list[str]], tuple[str, ...]]] = {
    "csv": (read_csv, csv_names, (".csv", ".tsv", ".txt")),
    "parquet": (read_parquet, parquet_names, (".parquet",)),
    "mat": (read_mat, mat_names, (".mat",)),
    "bam": (read_bam, bam_names, (".json",)),
    "bag": (read_bag, bag_names, (".bag", ".mcap", ".db3")),
    "npz": (read_npz, npz_names, (".npz",)),
    "lerobot": (read_lerobot, lerobot_names, ()),
}
"""Of each format what reads a file, what names its columns, and the endings of its files."""
_IN_PIECES = ("csv", "parquet")

__all__ = [
    "READERS",
    "Table",
    "TimeRange",
    "column_names",
    "format_of",
    "in_lerobot",
    "is_bag_folder",
    "lerobot_episodes",
    "load_any",
    "record_name",
]


def format_of(path: Path) -> str | None:
    """The format of a file by its ending, or of a bag's folder; None where nothing reads it."""
    if is_bag_folder(path):
        return "bag"
    return next((name for name, (*_, endings) in READERS.items() if _ending(path) in endings), None)


def _ending(path: Path) -> str:
    return Path(path.name.removesuffix(".gz")).suffix.lower()


def column_names(path: Path, file_format: str) -> list[str]:
    """Names of all columns that a file has, in its order.

    Raises:
        InputError: when the file is missing or damaged.
    """
    with _reaching(path, file_format, "the path"):
        names = READERS[file_format][1](path)
        refuse_excess(path, names)
        return names


def load_any(
    path: str | Path,
    wanted: Collection[str],
    *,
    file_format: str | None = None,
    time_range: TimeRange | None = None,
    episode: int | None = None,
) -> Table:
    """Read the wanted columns of a file of any known format.

    Args:
        path: The file.
        wanted: Names of the columns, as the file has them.
        file_format: A key of `READERS`; None takes it from the file's ending.
        time_range: Rows to keep where the format can be read in pieces (CSV, Parquet); the others come whole.
        episode: Number of the episode of a LeRobot dataset; None where its file holds one only.

    Raises:
        InputError: when the file is missing, its format unknown, or its contents are at fault.
    """
    path = Path(path)
    try:
        file_format = file_format or format_of(path)
    except PermissionError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give a readable folder") from None
    if file_format not in READERS:
        raise InputError(
            f"{path}: ending '{_ending(path)}' is unknown; give its 'format' ({', '.join(READERS)})"
        )
    if episode is not None and file_format != "lerobot":
        raise InputError(
            f"{path}: 'episode' chooses a part of a LeRobot dataset; give 'format: lerobot' or remove it"
        )
    with _reaching(path, file_format, "'file'"):
        part = episode if file_format not in _IN_PIECES else time_range
        return READERS[file_format][0](path, wanted, *(() if part is None else (part,)))


@contextmanager
def _reaching(path: Path, file_format: str, where: str) -> Iterator[None]:
    """Refuse a file that is not there or cannot be read; ``where`` says what names it."""
    try:
        if not (file_format == "bag" and path.is_dir()):
            size_of(path)
        yield
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; correct {where} or bring the file") from None
    except (IsADirectoryError, PermissionError) as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); give a readable file") from None
