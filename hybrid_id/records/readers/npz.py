"""NumPy archives (`numpy.savez`, `numpy.savez_compressed`): arrays by their names, never pickled objects.

An array `x` of shape (T,) or (T, 1) is the column `x`; one of shape (T, m) gives `x/0` to `x/m-1`. Single numbers
become `meta`.
"""

import math
import zipfile
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import Table, parsing, require_columns

_MOST_ARRAYS = 10_000
_MOST_COLUMNS = 1000  # of one array
_ENDING = ".npy"


def read_npz(path: Path, wanted: Collection[str]) -> Table:
    """Read the wanted columns of an archive.

    Raises:
        InputError: for a damaged archive, one that unpacks beyond any record, a pickled array, or a missing column.
    """
    needed = {*wanted, *(name.rpartition("/")[0] for name in wanted)}
    columns: dict[str, np.ndarray] = {}
    available: list[str] = []
    meta: dict[str, float | str] = {}
    with parsing(path, ".npz file"), zipfile.ZipFile(path) as archive:
        for item, name, shape, dtype in _arrays(path, archive):
            if not _is_read(shape, dtype):
                if name in needed:
                    found = "pickled objects" if dtype.hasobject else f"{dtype.name[:40]} of shape {shape}"
                    raise InputError(
                        f"{path}: array '{name}' holds {found}, which is not read; save numbers, one row a sample"
                    )
                continue
            single = math.prod(shape) == 1
            if not single:
                available += [f"{name}/{k}" for k in range(shape[1])] if len(shape) == 2 else []
                available += [name] if len(shape) < 2 or shape[1] == 1 else []
                if name not in needed:
                    continue
            with archive.open(item) as file:
                values = npy.read_array(file, allow_pickle=False).astype(np.float64)
            if single:
                if np.isfinite(values).all():
                    meta[name] = float(values.ravel()[0])
                continue
            if values.ndim == 2:
                columns |= {f"{name}/{k}": values[:, k] for k in range(values.shape[1])}
            if values.ndim == 1 or values.shape[1] == 1:
                columns[name] = values.ravel()
    require_columns(path, wanted, available)
    return Table(path, {name: columns[name] for name in wanted}, lambda k: f"sample {k}", meta)


def npz_names(path: Path) -> list[str]:
    """Names of all columns of an archive; single numbers and objects are none."""
    found: list[str] = []
    with parsing(path, ".npz file"), zipfile.ZipFile(path) as archive:
        for _, name, shape, dtype in _arrays(path, archive):
            if _is_read(shape, dtype) and math.prod(shape) > 1:
                width = shape[1] if len(shape) == 2 else 1
                found += [name] if width == 1 else [f"{name}/{k}" for k in range(width)]
    return found


def _arrays(
    path: Path, archive: zipfile.ZipFile
) -> Iterator[tuple[zipfile.ZipInfo, str, tuple[int, ...], np.dtype]]:
    """Entry, name, shape and type of each array, from its header alone."""
    items = [item for item in archive.infolist() if item.filename.endswith(_ENDING)]
    if len(items) > _MOST_ARRAYS:
        raise InputError(f"{path} holds {len(items)} arrays; save the few that are needed")
    for item in items:
        with archive.open(item) as file:
            version = npy.read_magic(file)
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, _, dtype = read(file)
        yield item, item.filename.removesuffix(_ENDING), shape, dtype


def _is_read(shape: tuple[int, ...], dtype: np.dtype) -> bool:
    return dtype.kind in "fiub" and len(shape) <= 2 and (len(shape) < 2 or shape[1] <= _MOST_COLUMNS)
