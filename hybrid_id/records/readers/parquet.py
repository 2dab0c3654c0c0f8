"""Parquet tables; a column of time stamps of the day becomes seconds since the first one."""

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import PIECE, Table, TimeRange, parsing, require_columns

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


def read_parquet(path: Path, wanted: Collection[str], time_range: TimeRange | None = None) -> Table:
    """Read the wanted columns of a Parquet file, of the rows in a time range only where one is given.

    Raises:
        InputError: for a damaged file, one that unpacks beyond any record, a missing column, or one without numbers.
    """
    import pyarrow as pa

    kept = None
    with parsing(path, "Parquet file"):
        file = open_parquet(path)
        require_columns(path, wanted, file.schema_arrow.names)
        if time_range is None or not file.metadata.num_rows:  # an empty file comes in no pieces at all
            columns = next(_pieces(path, [file.read(list(wanted), use_threads=False)], wanted))
        else:
            batches = file.iter_batches(PIECE, columns=list(wanted), use_threads=False)
            tables = (pa.Table.from_batches([batch]) for batch in batches)
            columns, kept = time_range.gather(_pieces(path, tables, wanted))
    stamps = frozenset(n for n in columns if pa.types.is_timestamp(file.schema_arrow.field(n).type))
    return Table(
        path,
        columns,
        lambda k: f"row {(k if kept is None else int(kept[k])) + 1} of the table",
        stamps=stamps,
    )


def parquet_names(path: Path) -> list[str]:
    """Names of all columns of a Parquet file."""
    with parsing(path, "Parquet file"):
        return list(open_parquet(path).schema_arrow.names)


def open_parquet(path: Path) -> "pq.ParquetFile":
    """Open a Parquet file; its columns are read one after the other, for each thread would take memory of its own."""
    import pyarrow.parquet as pq

    return pq.ParquetFile(path, pre_buffer=False)


def is_number(kind: "pa.DataType") -> bool:
    """Whether a type is one of single numbers, or of truth."""
    import pyarrow as pa

    return pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)


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
            elif is_number(column.type):
                columns[name] = column.to_numpy(zero_copy_only=False).astype(np.float64)
            else:
                lists = pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type)
                remedy = "give 'format: lerobot' if this is an episode" if lists else "write it as numbers"
                raise InputError(f"{path}: column '{name}' is of type {column.type}; {remedy}")
        yield columns
