"""MATLAB files by `scipy.io.loadmat`, or of version 7.3 by `h5py`: vectors, and columns of matrices.

A variable `x` of shape (T, 1) or (1, T) is the column `x`; a matrix of shape (T, m) gives `x(:,1)` to `x(:,m)`.
Structures, cells and objects are left aside: their contents are never interpreted. Of version 7.3
(`save(..., '-v7.3')`), which is HDF5, only plain numbers that lie in the file itself are read, and no links to other
files are followed.

Layout of the EMPS benchmark (Janot, Gautier, Brunot: "Data set and reference models of EMPS", Workshop on
Nonlinear System Identification Benchmarks, 2019): `t` (s), `qm` motor position (m), `qg` its reference (m), `vir`
drive command (V) and the scalar `gtau` (N/V). Such a file also has the columns `q_m1` = qm, `goal1` = qg and
`tau1` = gtau*vir, the force in newtons, so that it needs no column map.
"""

import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import MOST_COLUMNS
from hybrid_id.records.readers.table import Table, parsing, refuse_excess, require_columns

_EMPS = ("qm", "qg", "vir", "gtau")
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_STARTS = (0, 512)  # MATLAB puts a header of its own before the HDF5 file
_NUMBERS = {"double", "single", "logical"} | {f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64)}
_DEFLATE, _SHUFFLE, _FLETCHER = 1, 2, 3  # filters by their HDF5 numbers
_MOST_VARIABLES = 10_000
_MOST_COLUMNS = 1000  # of one matrix


def read_mat(path: Path, wanted: Collection[str]) -> Table:
    """Read the wanted columns of a MATLAB file; its numeric scalars become `meta`.

    Raises:
        InputError: for a damaged file, or a missing column.
    """
    columns, scalars, others = _columns(path, wanted)
    require_columns(path, wanted, [*columns, *others])
    return Table(path, {name: columns[name] for name in wanted}, lambda k: f"sample {k + 1}", scalars)


def mat_names(path: Path) -> list[str]:
    """Names of all columns of a MATLAB file."""
    columns, _, others = _columns(path, [])
    if others:  # of version 7.3: shapes are known once a variable is read
        columns = columns | _columns(path, others)[0]
    return list(columns)


def _columns(
    path: Path, wanted: Collection[str]
) -> tuple[dict[str, np.ndarray], dict[str, float | str], list[str]]:
    """Columns, single numbers, and in version 7.3 the variables that are left unread."""
    others: list[str] = []
    if _is_hdf5(path):
        variables, others = _load_hdf5(path, [*wanted, *_EMPS])
    else:
        with parsing(path, "MATLAB file", "write it again with '-v7'"):
            # no cell or structure is so much as looked into: they lie in one another as deep as a file likes
            from scipy.io import loadmat, whosmat

            listed = whosmat(path)
            if len(listed) > _MOST_VARIABLES:
                raise InputError(f"{path} holds {len(listed)} variables; save the few that are needed")
            plain = []
            counts = Counter(
                name for name, _, _ in listed
            )  # of two by one name, the library might follow the other
            for name, shape, kind in listed:
                small = len(shape) == 2 and (1 in shape or shape[1] <= MOST_COLUMNS)
                if kind in _NUMBERS and small and counts[name] == 1:
                    plain.append(name)
            variables = loadmat(path, variable_names=plain)
    columns: dict[str, np.ndarray] = {}
    scalars: dict[str, float | str] = {}
    for name, value in variables.items():
        if name.startswith("__") or not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
            continue
        if value.size == 1:
            if np.isfinite(value).all():
                scalars[name] = float(value.item())
        elif value.ndim == 2 and 1 in value.shape:
            columns[name] = value.ravel().astype(np.float64)
        elif value.ndim == 2:
            columns |= {f"{name}(:,{i + 1})": value[:, i].astype(np.float64) for i in range(value.shape[1])}
    refuse_excess(path, columns)
    if {"qm", "vir"} <= columns.keys():
        columns |= {new: columns[old] for new, old in (("q_m1", "qm"), ("goal1", "qg")) if old in columns}
        if isinstance(gain := scalars.get("gtau"), float):
            columns["tau1"] = gain * columns["vir"]
    return columns, scalars, others


def _is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, as MATLAB files of version 7.3 are."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_STARTS[-1] + len(_SIGNATURE))
    return any(head.startswith(_SIGNATURE, start) for start in _STARTS)


def _load_hdf5(path: Path, wanted: Collection[str]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Read the variables that wanted columns are part of, and all single numbers; name the others.

    Returns:
        Variable -> array of MATLAB's shape, and the names of the variables that are left unread.

    Raises:
        InputError: for a damaged file, a wanted variable that is no plain array of numbers, or where h5py is missing.
    """
    try:
        import h5py
    except ImportError:
        raise InputError(
            f"{path} is a MATLAB 7.3 file, which needs h5py; install it with pip install 'hybrid_id[logs]'."
        ) from None
    needed = {re.sub(r"\W.*", "", name) for name in wanted}
    variables, others = {}, []
    opened: Any = h5py.File
    with parsing(path, "MATLAB 7.3 file", "write it again, or with '-v7'"), opened(path, "r") as file:
        if len(file) > _MOST_VARIABLES:
            raise InputError(f"{path} holds {len(file)} variables; save the few that are needed")
        for name in file:
            fault = _fault(file, name)
            if fault and name in needed:
                raise InputError(
                    f"{path}: variable '{name}' is {fault}, which is not read; save plain vectors"
                )
            if not fault and (name in needed or file[name].size == 1):
                variables[name] = np.atleast_2d(file[name][()]).T  # MATLAB's columns are HDF5's rows
            elif not fault:
                others.append(name)
    return variables, others


def _fault(file: Any, name: str) -> str:
    """What a variable is, where that is no plain array of numbers."""
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return "a link to another place"
    item = file[name]
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
    if not isinstance(item, h5py.Dataset):
        return f"a {kind[:40] or 'group'}"
    if h5py.check_ref_dtype(item.dtype):
        return f"a {kind[:40] or 'list'} of object references"
    if item.dtype.kind not in "fiub" or (kind and kind not in _NUMBERS):
        return f"of class {kind[:40] or item.dtype.name[:40]}"
    if item.ndim > 2 or (item.ndim == 2 and 1 not in item.shape and len(item) > _MOST_COLUMNS):
        return f"an array of shape {item.shape[::-1]}"
    if item.is_virtual or item.external:
        return "kept in another file"
    plan = item.id.get_create_plist()
    codes = {plan.get_filter(k)[0] for k in range(plan.get_nfilters())}
    return f"packed by HDF5 filter {max(codes)}" if codes - {_DEFLATE, _SHUFFLE, _FLETCHER} else ""
