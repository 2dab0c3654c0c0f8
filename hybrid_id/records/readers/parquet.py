"""Parquet tables; a column of time stamps of the day becomes seconds since the first one."""

from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import PIECE, Table, TimeRange, parsing, require_columns
from hybrid_id.records.readers.unpack import refuse_growth

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_MOST_FOOTER = 64_000_000
"""Bytes that say how a file is laid out; they grow with its columns times its groups of rows."""


def read_parquet(path: Path, wanted: Collection[str], time_range: TimeRange | None = None) -> Table:
    """Read the wanted columns of a Parquet file, of the rows in a time range only where one is given.

    Raises:
        InputError: for a damaged file, one that unpacks beyond any record, a missing column, or one without numbers.
    """
    import pyarrow as pa

    kept = None
    try:
        file = open_parquet(path)
        require_columns(path, wanted, file.schema_arrow.names)
        if time_range is None or not file.metadata.num_rows:  # an empty file comes in no pieces at all
            refuse_growth(path, path.stat().st_size, 8 * len(wanted) * file.metadata.num_rows)
            columns = next(_pieces(path, [file.read(list(wanted))], wanted))
        else:
            batches = (pa.Table.from_batches([b]) for b in file.iter_batches(PIECE, columns=list(wanted)))
            columns, kept = time_range.gather(_pieces(path, batches, wanted))
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise InputError(f"{path} is not a readable Parquet file ({reason}); write it again") from None
    stamps = frozenset(n for n in columns if pa.types.is_timestamp(file.schema_arrow.field(n).type))
    return Table(path, columns, _row(kept), stamps=stamps)


def parquet_names(path: Path) -> list[str]:
    """Names of all columns of a Parquet file."""
    with parsing(path, "Parquet file"):
        return list(open_parquet(path).schema_arrow.names)


def open_parquet(path: Path) -> "pq.ParquetFile":
    """Open a Parquet file whose layout can be read without being a burden.

    Raises:
        InputError: it has more columns, or pieces of them, than any record.
    """
    import pyarrow.parquet as pq

    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - 8, 0))
        footer = int.from_bytes(file.read(4), "little")
    if _MOST_FOOTER < footer < size:  # a longer one than the file is refused by the library
        raise InputError(
            f"{path} has more columns or groups of rows than any record; leave out what is not needed"
        )
    return pq.ParquetFile(path)


def _row(kept: np.ndarray | None) -> Callable[[int], str]:
    """Words for the place of each sample, of a table or of the rows that were kept of it."""
    return lambda k: f"row {(k if kept is None else int(kept[k])) + 1} of the table"


def _pieces(
    path: Path, tables: "Iterable[pa.Table]", wanted: Collection[str]
) -> Iterator[dict[str, np.ndarray]]:
    """Columns of numbers of each table; time stamps count from the first one of all."""
    import pyarrow as pa

    starts: dict[str, np.ndarray] = {}
    for table in tables:
        columns = {}
        for name in wanted:
            column = table[name].combine_chunks()
            if pa.types.is_timestamp(column.type):
                stamps = column.cast(pa.timestamp("ns"), safe=False).to_numpy(zero_copy_only=False)
                columns[name] = (stamps - starts.setdefault(name, stamps[:1])) / np.timedelta64(1, "s")
            elif (
                pa.types.is_integer(column.type)
                or pa.types.is_floating(column.type)
                or pa.types.is_boolean(column.type)
            ):
                columns[name] = column.to_numpy(zero_copy_only=False).astype(np.float64)
            else:
                lists = pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type)
                remedy = "give 'format: lerobot' if this is an episode" if lists else "write it as numbers"
                raise InputError(f"{path}: column '{name}' is of type {column.type}; {remedy}")
        yield columns
