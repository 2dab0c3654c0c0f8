"""NumPy archives (`numpy.savez`, `numpy.savez_compressed`): arrays by their names, never pickled objects.

An array `x` of shape (T,) or (T, 1) is the column `x`; one of shape (T, m) gives `x/0` to `x/m-1`. Single numbers
become `meta`.
"""

import math
import zipfile
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import Table, parsing, require_columns
from hybrid_id.records.readers.unpack import refuse_growth

_MOST_ARRAYS = 10_000
_MOST_COLUMNS = 1000  # of one array
_ENDING = ".npy"


def read_npz(path: Path, wanted: Collection[str]) -> Table:
    """Read the wanted columns of an archive.

    Raises:
        InputError: for a damaged archive, one that unpacks beyond any record, a pickled array, or a missing column.
    """
    with parsing(path, ".npz file"), zipfile.ZipFile(path) as archive:
        return _read(path, archive, wanted)


def npz_names(path: Path) -> list[str]:
    """Names of all columns of an archive; single numbers and objects are none."""
    found: list[str] = []
    with parsing(path, ".npz file"), zipfile.ZipFile(path) as archive:
        items = [item for item in archive.infolist() if item.filename.endswith(_ENDING)]
        for item in items[:_MOST_ARRAYS]:
            name, (shape, dtype) = item.filename.removesuffix(_ENDING), _header(archive, item)
            width = shape[-1] if len(shape) == 2 else 1
            if dtype.kind not in "fiub" or not 0 < len(shape) <= 2 or math.prod(shape) <= 1:
                continue
            if width <= _MOST_COLUMNS:
                found += [name] if width == 1 else [f"{name}/{k}" for k in range(width)]
    return found


def _read(path: Path, archive: zipfile.ZipFile, wanted: Collection[str]) -> Table:
    items = [item for item in archive.infolist() if item.filename.endswith(_ENDING)]
    if len(items) > _MOST_ARRAYS:
        raise InputError(f"{path} holds {len(items)} arrays; save the few that are needed")
    needed = {*wanted, *(name.rpartition("/")[0] for name in wanted)}
    columns: dict[str, np.ndarray] = {}
    available: list[str] = []
    meta: dict[str, float | str] = {}
    for item in items:
        name = item.filename.removesuffix(_ENDING)
        shape, dtype = _header(archive, item)
        single, width = math.prod(shape) == 1, shape[-1] if len(shape) == 2 else 1
        if dtype.kind not in "fiub" or len(shape) > 2 or width > _MOST_COLUMNS:
            if name in needed:
                found = "pickled objects" if dtype.hasobject else f"{dtype.name[:40]} of shape {shape}"
                raise InputError(
                    f"{path}: array '{name}' holds {found}, which is not read; save numbers, one row a sample"
                )
            continue
        if not single and len(shape) == 2:
            available += [f"{name}/{k}" for k in range(width)]
        if not single and width == 1:
            available.append(name)
        if not single and name not in needed:
            continue
        size = math.prod(shape) * dtype.itemsize
        refuse_growth(path, path.stat().st_size, size)
        if size > item.file_size:
            raise InputError(f"{path}: array '{name}' is cut short; write the file again")
        with archive.open(item) as file:
            values = npy.read_array(file, allow_pickle=False).astype(np.float64)
        if single:
            if np.isfinite(values).all():
                meta[name] = float(values.ravel()[0])
            continue
        columns |= {f"{name}/{k}": values[:, k] for k in range(values.shape[1])} if values.ndim == 2 else {}
        columns |= {name: values.ravel()} if values.ndim == 1 or values.shape[1] == 1 else {}
    require_columns(path, wanted, available)
    return Table(path, {name: columns[name] for name in wanted}, lambda k: f"sample {k}", meta)


def _header(archive: zipfile.ZipFile, item: zipfile.ZipInfo) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of an array, from its header alone."""
    with archive.open(item) as file:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read(file)
    return shape, dtype
