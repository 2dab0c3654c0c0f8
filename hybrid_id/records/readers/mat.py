"""MATLAB files by `scipy.io.loadmat`, or of version 7.3 by `h5py`: vectors, and columns of matrices.

A variable `x` of shape (T, 1) or (1, T) is the column `x`; a matrix of shape (T, m) gives `x(:,1)` to `x(:,m)`.
Structures, cells and objects are left aside: their contents are never interpreted.

Layout of the EMPS benchmark (Janot, Gautier, Brunot: "Data set and reference models of EMPS", Workshop on
Nonlinear System Identification Benchmarks, 2019): `t` (s), `qm` motor position (m), `qg` its reference (m), `vir`
drive command (V) and the scalar `gtau` (N/V). Such a file also has the columns `q_m1` = qm, `goal1` = qg and
`tau1` = gtau*vir, the force in newtons, so that it needs no column map.
"""

from collections import Counter
from collections.abc import Collection
from pathlib import Path

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import MOST_COLUMNS
from hybrid_id.records.readers.mat_hdf5 import MOST_VARIABLES, NUMBERS, is_hdf5, load_hdf5
from hybrid_id.records.readers.table import Table, parsing, refuse_excess, require_columns

_EMPS = ("qm", "qg", "vir", "gtau")


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
    if is_hdf5(path):
        variables, others = load_hdf5(path, [*wanted, *_EMPS])
    else:
        with parsing(path, "MATLAB file", "write it again with '-v7'"):
            # no cell or structure is so much as looked into: they lie in one another as deep as a file likes
            from scipy.io import loadmat, whosmat

            listed = whosmat(path)
            if len(listed) > MOST_VARIABLES:
                raise InputError(f"{path} holds {len(listed)} variables; save the few that are needed")
            plain = []
            counts = Counter(
                name for name, _, _ in listed
            )  # of two by one name, the library might follow the other
            for name, shape, kind in listed:
                small = len(shape) == 2 and (1 in shape or shape[1] <= MOST_COLUMNS)
                if kind in NUMBERS and small and counts[name] == 1:
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
