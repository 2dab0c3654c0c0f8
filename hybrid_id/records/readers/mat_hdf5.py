"""MATLAB files of version 7.3 (`save(..., '-v7.3')`), which are HDF5, by the library `h5py`.

Only plain numbers that lie in the file itself are read: structures, cells and objects are refused, and so are links to
other files.
"""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.records.readers.table import parsing

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_STARTS = (0, 512)  # MATLAB puts a header of its own before the HDF5 file
NUMBERS = {"double", "single", "logical"} | {f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64)}
_DEFLATE, _SHUFFLE, _FLETCHER = 1, 2, 3  # filters by their HDF5 numbers
MOST_VARIABLES = 10_000
_MOST_COLUMNS = 1000  # of one matrix


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, as MATLAB files of version 7.3 are."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_STARTS[-1] + len(_SIGNATURE))
    return any(head.startswith(_SIGNATURE, start) for start in _STARTS)


def load_hdf5(path: Path, wanted: Collection[str]) -> tuple[dict[str, np.ndarray], list[str]]:
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
        if len(file) > MOST_VARIABLES:
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
    if item.dtype.kind not in "fiub" or (kind and kind not in NUMBERS):
        return f"of class {kind[:40] or item.dtype.name[:40]}"
    if item.ndim > 2 or (item.ndim == 2 and 1 not in item.shape and len(item) > _MOST_COLUMNS):
        return f"an array of shape {item.shape[::-1]}"
    if item.is_virtual or item.external:
        return "kept in another file"
    plan = item.id.get_create_plist()
    codes = {plan.get_filter(k)[0] for k in range(plan.get_nfilters())}
    return f"packed by HDF5 filter {max(codes)}" if codes - {_DEFLATE, _SHUFFLE, _FLETCHER} else ""
