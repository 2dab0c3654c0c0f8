"""Parquet tables; a column of time stamps of the day becomes seconds since the first one."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import Table, require_columns
from hybrid_id.records.readers.unpack import refuse_growth


def read_parquet(path: Path, wanted: Collection[str]) -> Table:
    """Read the wanted columns of a Parquet file.

    Raises:
        InputError: for a damaged file, one that unpacks beyond any record, a missing column, or one without numbers.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        require_columns(path, wanted, pq.read_schema(path).names)
        refuse_growth(path, path.stat().st_size, 8 * len(wanted) * pq.read_metadata(path).num_rows)
        table = pq.read_table(path, columns=list(wanted))
    except (pa.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise InputError(f"{path} is not a readable Parquet file ({reason}); write it again") from None
    columns = {}
    for name in wanted:
        column = table[name].combine_chunks()
        if pa.types.is_timestamp(column.type):
            stamps = column.cast(pa.timestamp("ns"), safe=False).to_numpy(zero_copy_only=False)
            columns[name] = (stamps - stamps[:1]) / np.timedelta64(1, "s")
        elif (
            pa.types.is_integer(column.type)
            or pa.types.is_floating(column.type)
            or pa.types.is_boolean(column.type)
        ):
            columns[name] = column.to_numpy(zero_copy_only=False).astype(np.float64)
        else:
            raise InputError(f"{path}: column '{name}' is of type {column.type}; write it as numbers")
    return Table(path, columns, lambda k: f"row {k + 1} of the table")
