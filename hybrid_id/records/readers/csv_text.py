"""Plain text tables, `.csv`, `.tsv` and `.txt`, also gzip-compressed.

The delimiter (comma, semicolon, tab or runs of blanks) is seen from the header line. Numbers beside
semicolons or tabs may have a decimal comma. Blanks around column names, quotes and a leading `#` (as
`numpy.savetxt` writes it) are ignored, lines that begin with `#` or `%` before the header are skipped. A
file with no header line has columns called `1`, `2`, ...
"""

import csv
import gzip
import math
from collections.abc import Collection, Generator, Iterator
from contextlib import closing, nullcontext
from dataclasses import dataclass
from itertools import chain, count, islice
from pathlib import Path
from typing import NoReturn, TextIO

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import (
    PIECE,
    Table,
    TimeRange,
    parsing,
    refuse_excess,
    require_columns,
)

HEADER_LIMIT = 200  # lines in which the header must come
LONGEST_LINE = 1_000_000  # signs
_KIND = "text table in UTF-8"
DECIMAL_COMMA = (";", "\t")  # delimiters beside which a comma may be the decimal sign


def read_csv(path: Path, wanted: Collection[str], time_range: TimeRange | None = None) -> Table:
    """Read the wanted columns of a text table, of the rows in a time range only where one is given.

    Raises:
        InputError: naming file, row and column, for a missing column, a cell that is no finite number, rows
            of unequal length, or a damaged file.
    """
    with parsing(path, _KIND, "save it as CSV, or give its 'format'"):
        with _open(path) as file:
            layout = _Layout.of(file, path)
        if not layout.has_header and not set(wanted) <= set(layout.names):
            raise InputError(
                f"{path} has no header line, so its columns are called {', '.join(layout.names)}; "
                "name them under 'columns' in the dataset file"
            )
        require_columns(path, wanted, layout.names)
        with closing(_pieces(path, layout, wanted, None if time_range is None else PIECE)) as pieces:
            values, kept = (next(pieces), None) if time_range is None else time_range.gather(pieces)
    return Table(
        path, values, lambda k: f"row {_file_row(path, layout, k if kept is None else int(kept[k]))}"
    )


def csv_names(path: Path) -> list[str]:
    """Names of all columns of a text table, as its header gives them."""
    with parsing(path, _KIND, "save it as CSV"), _open(path) as file:
        return _Layout.of(file, path).names


@dataclass(frozen=True)
class _Layout:
    """How the lines of one text table are cut."""

    names: list[str]
    has_header: bool
    delimiter: str
    skipped: int  # lines before the data
    decimal: str

    @classmethod
    def of(cls, file: TextIO, path: Path) -> "_Layout":
        """See the layout from the first lines of a file."""
        remark = None
        text, number, lines = "", 0, _lines(file, path)
        for line in islice(lines, HEADER_LIMIT):
            text, number = line.strip(), number + 1
            if text.startswith(("#", "%")):
                remark = text.lstrip("#% ") or remark
            elif text:
                break
        else:
            raise InputError(f"{path} holds no table; its first line names the columns, data follow")
        delimiter = next((d for d in (";", "\t", ",") if d in text), " ")
        first = _cut(text, delimiter)
        decimal = "."
        if not _is_number(first[0].replace(",", ".") if delimiter in DECIMAL_COMMA else first[0]):
            names, has_header, skipped, text = first, True, number, ""
        elif remark and len(_cut(remark, delimiter)) == len(first):
            names, has_header, skipped = _cut(remark, delimiter), True, number - 1
        else:
            names, has_header, skipped = [str(i + 1) for i in range(len(first))], False, number - 1
        refuse_excess(path, names)
        below = [text, *islice(lines, HEADER_LIMIT)]
        if not any(_is_number(cell.replace(",", ".")) for line in below for cell in _cut(line, delimiter)):
            raise InputError(f"{path} holds 0 samples, for no number follows its first line; give a record")
        refuse_excess(path, _cut(next(line for line in below if line.strip()), delimiter))
        numbers = "".join(below)
        if delimiter in DECIMAL_COMMA and "," in numbers and "." not in numbers:
            decimal = ","
        return cls(names, has_header, delimiter, skipped, decimal)


def _pieces(
    path: Path, layout: _Layout, wanted: Collection[str], size: int | None
) -> Generator[dict[str, np.ndarray]]:
    """Read the wanted columns by pandas, so many rows at once; where it fails, find the cell that is at fault."""
    import pandas as pd  # costs a third of a second, so only those who read text pay it

    index = {name: layout.names.index(name) for name in wanted}
    try:
        read = pd.read_csv(
            path,
            sep=r"\s+" if layout.delimiter == " " else layout.delimiter,
            decimal=layout.decimal,
            skiprows=layout.skipped,
            header=None,
            # No `names` or `usecols`: with them, pandas drops the surplus cells of a long row in silence.
            dtype=dict.fromkeys(index.values(), np.float64),
            low_memory=False,
            skipinitialspace=True,
            encoding="utf-8-sig",
            chunksize=size,
        )
        with nullcontext([read]) if isinstance(read, pd.DataFrame) else read as frames:
            for frame in frames:
                surplus = frame.iloc[:, len(layout.names) :]  # a delimiter at the end of each row is harmless
                if frame.shape[1] <= max(index.values()) or bool(surplus.notna().to_numpy().any()):
                    _raise_for_bad_cell(path, layout, wanted, "rows and header differ in length")
                columns = {name: frame[i].to_numpy() for name, i in index.items()}
                if not all(np.isfinite(values).all() for values in columns.values()):
                    _raise_for_bad_cell(path, layout, wanted, "a value is missing")
                yield columns
    except pd.errors.EmptyDataError:
        yield {name: np.empty(0) for name in wanted}
    except UnicodeDecodeError:
        raise
    except ValueError as error:  # text in a number's place, or a row longer than the first
        if "out of memory" in str(error):
            raise MemoryError from None
        _raise_for_bad_cell(path, layout, wanted, error)


def _raise_for_bad_cell(
    path: Path, layout: _Layout, wanted: Collection[str], otherwise: Exception | str
) -> NoReturn:
    """Raise InputError for the first cell of the wanted columns that is not a finite number."""
    for row, cells in _rows(path, layout):
        if len(cells) > len(layout.names) and any(cells[len(layout.names) :]):
            raise InputError(
                f"{path}, row {row}: it has {len(cells)} cells where the header has {len(layout.names)}; "
                "correct the row"
            )
        for name in wanted:
            index = layout.names.index(name)
            cell = cells[index].strip() if index < len(cells) else ""
            if not _is_number(cell.replace(layout.decimal, ".")):
                found = f"holds '{cell[:40]}', which is not a finite number" if cell else "is empty"
                raise InputError(f"{path}, row {row}: column '{name}' {found}; correct it or remove the row")
    raise InputError(
        f"{path} cannot be read as a table ({' '.join(str(otherwise).split())[:120]}); correct it"
    )


def _rows(path: Path, layout: _Layout) -> Iterator[tuple[int, list[str]]]:
    """Yield (1-based line of the file, cells) of every data row."""
    with _open(path) as file:
        for row, line in enumerate(_lines(file, path), start=1):
            if row > layout.skipped and line.strip():
                yield row, _cut(line, layout.delimiter)


def _lines(file: TextIO, path: Path) -> Iterator[str]:
    """Lines of a file, none of which is longer than any row of a table."""
    for row in count(1):
        line = file.readline(LONGEST_LINE + 1)
        if len(line) > LONGEST_LINE:
            raise InputError(
                f"{path}, row {row}: longer than {LONGEST_LINE} signs, so this is no table; give a record"
            )
        if not line:
            return
        yield line


def _file_row(path: Path, layout: _Layout, sample: int) -> int:
    """Return the 1-based line of the file that holds sample k."""
    return next(islice(chain((row for row, _ in _rows(path, layout)), [0]), sample, None), 0)


def _cut(line: str, delimiter: str) -> list[str]:
    """Cut one line into cells, without the blanks around them."""
    if delimiter == " ":
        return line.split()
    return [
        cell.strip()
        for cell in next(csv.reader([line.strip("\r\n")], delimiter=delimiter, skipinitialspace=True))
    ]


def _is_number(cell: str) -> bool:
    try:  # Python reads 1_000 and digits of other scripts, which the parser of tables does not
        return cell.isascii() and "_" not in cell and math.isfinite(float(cell))
    except ValueError:
        return False


def _open(path: Path) -> TextIO:
    """Open a text file, compressed or not; a byte-order mark at its start is dropped."""
    if path.suffix == ".gz":
        return gzip.open(path, "rt", encoding="utf-8-sig")
    return path.open(encoding="utf-8-sig")
