"""What every reader returns: columns of numbers, and words for the place of each sample."""

import difflib
import gzip
import re
import resource
import threading
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import LONGEST_NAME, MOST_COLUMNS


@dataclass(frozen=True)
class Table:
    """Columns read from one file.

    Attributes:
        path: The file.
        columns: Column name -> values as the file holds them, float64, (T,).
        place: Sample k -> words for a message, such as `row 17` (1-based line of the file).
        meta: Facts from the file's header, name -> number or text.
        stamps: Columns of dates, given in seconds since the first one.
        times: Columns that are stamped apart from the column of time -> their own stamps, on its clock [s]; their
            length is that of these stamps.
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    place: Callable[[int], str]
    meta: Mapping[str, float | str] = field(default_factory=dict)
    stamps: frozenset[str] = frozenset()
    times: Mapping[str, np.ndarray] = field(default_factory=dict)


PIECE = 1_000_000
"""Rows that are in memory at once while a part of a file is read."""


@dataclass(frozen=True)
class TimeRange:
    """The rows that a reader keeps, so that no more than a part of a long file is ever in memory.

    Attributes:
        column: The column of time stamps.
        low: First stamp, as the file has it.
        high: Last stamp.
    """

    column: str
    low: float
    high: float

    def gather(self, pieces: Iterable[Mapping[str, np.ndarray]]) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Columns of the rows inside, and their numbers in the file; nothing is read beyond the range's end."""
        found: list[dict[str, np.ndarray]] = []
        kept, first = [np.empty(0, int)], 0
        for piece in pieces:
            time = piece[self.column]
            rows = np.flatnonzero(
                ~((time < self.low) | (time > self.high))
            )  # a missing stamp stays, to be refused
            found.append({name: values[rows] for name, values in piece.items()})
            kept.append(first + rows)
            first += len(time)
            if len(time) and time.min() > self.high:
                break
        columns = {
            name: np.concatenate([part[name] for part in found]) for name in (found[0] if found else ())
        }
        return columns, np.concatenate(kept)


def require_columns(path: Path, wanted: Collection[str], available: Iterable[str]) -> None:
    """Raise InputError for the first wanted column that a file does not have, or has twice."""
    available = list(available)
    refuse_excess(path, available)
    for name in wanted:
        if available.count(name) > 1:
            raise InputError(
                f"{path}: column '{name}' occurs {available.count(name)} times; rename one of them"
            )
        if name not in available:
            by_case = {column.lower(): column for column in available}
            close = [
                by_case[key] for key in difflib.get_close_matches(name.lower(), by_case, n=1, cutoff=0.7)
            ]
            hint = f"did you mean '{close[0]}'? " if close else ""
            shown = ", ".join(available[:30]) + (", ..." if len(available) > 30 else "")
            raise InputError(
                f"{path} has no column '{name}' ({hint}it has {shown or 'none'}); "
                "name the right one under 'columns' in the dataset file"
            )


def refuse_excess(path: Path, names: Collection[str]) -> None:
    """Raise InputError for more columns, or longer names of them, than any record has."""
    if len(names) > MOST_COLUMNS:
        raise InputError(
            f"{path} has {len(names)} columns, where {MOST_COLUMNS} are read; leave out the others"
        )
    if long := next((name for name in names if len(name) > LONGEST_NAME), ""):
        words = f"'{long[:40]}...' has {len(long)} signs, where {LONGEST_NAME} are read"
        raise InputError(f"{path}: the name of column {words}; rename it")


MOST_MEMORY, MEMORY_RATIO = 1_000_000_000, 100
"""Bytes of memory that reading any file may take, and beyond those bytes for one of the file.

Tables of numbers unpack to 20 times their size at most; deflate's limit is 1032, and formats that repeat a number know
none.
"""
_ONE_AT_A_TIME = threading.RLock()


@contextmanager
def parsing(path: Path, kind: str, remedy: str = "write it again") -> Iterator[None]:
    """Bound the memory that a file's parser gets, and say of a damaged file that it is not readable.

    A damaged file can make its parser stumble in any way, and a hostile one is made to unpack to any size. The bound is
    the operating system's (``RLIMIT_DATA``), of this whole process while the file is read; where there is no ``/proc``
    there is none.

    Args:
        path: The file, or a bag's folder.
        kind: What it should be, `Parquet file`.
        remedy: What to do.

    Raises:
        InputError: as it came, or in place of any other error but those of reaching the file.
    """
    try:
        with _bounded_memory(path):
            yield
    except (InputError, FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except MemoryError:
        raise InputError(
            f"{path} unpacks to more than fits into memory, or than {MEMORY_RATIO} times its size and "
            f"{MOST_MEMORY / 1e6:g} MB, which no record does; bring it uncompressed if it is one"
        ) from None
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise InputError(f"{path} is damaged or cut short ({error}); copy it again") from None
    except Exception as error:
        reason = " ".join((str(error) or type(error).__name__).split()).replace(str(path), "it").rstrip(".")
        raise InputError(f"{path} is not a readable {kind} ({reason[:120]}); {remedy}") from None


@contextmanager
def _bounded_memory(path: Path) -> Iterator[None]:
    statm = Path("/proc/self/statm")
    if not statm.exists():
        yield
        return
    size = sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else (path,)))
    with _ONE_AT_A_TIME:
        before = resource.getrlimit(resource.RLIMIT_DATA)
        used = int(statm.read_text().split()[5]) * resource.getpagesize()
        limits = [limit for limit in before if limit != resource.RLIM_INFINITY]
        most = min(used + MOST_MEMORY + MEMORY_RATIO * size, *limits, 2**62)
        resource.setrlimit(resource.RLIMIT_DATA, (most, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_DATA, before)


def record_name(path: Path) -> str:
    """Return a record's name for a file: `rec_00.csv.gz` -> `rec_00`; signs that no name may have become `_`."""
    name = re.sub(r"\.gz$", "", path.name)
    name = re.sub(r"\.(csv|txt|tsv|json|parquet|mat|npz|bag|mcap|db3)$", "", name, flags=re.IGNORECASE)
    return re.sub(r"^\W|[^\w .+@,=()-]", "_", name)
