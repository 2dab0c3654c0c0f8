"""C code as a library: compiled for this machine, kept in the user's cache for other processes and later runs."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

from hybrid_id.errors import InputError, MachineError

FLAGS = ("-O2", "-ftree-vectorize", "-march=native", "-std=gnu11", "-fPIC")
MOST_KEPT = 8000
"""Libraries in the user's cache, about 20 kB each."""


def compiler() -> str | None:
    """Name of the C compiler here, None where there is none."""
    return next((c for c in ("gcc", "clang", "cc") if shutil.which(c)), None)


@functools.cache
def library(source: str, flags: Sequence[str] = FLAGS) -> ctypes.CDLL:
    """The library that a C compiler makes of a source, kept for other processes and later runs.

    Raises:
        InputError: there is no compiler or it fails.
    """
    found = compiler()
    if found is None:
        raise InputError("Compiled steps need a C compiler; install gcc, or leave 'compiled' off.")
    kept = _cache() / f"{_key(source, found, *flags)}.so"
    if (known := _loaded(kept)) is not None:
        return known
    with tempfile.TemporaryDirectory() as folder:
        code, built = Path(folder) / "steps.c", Path(folder) / "steps.so"
        code.write_text(source)
        vectors = ["-lmvec"] if "gcc" in found else []
        for extra in (vectors, []):
            done = subprocess.run(
                [found, *flags, "-shared", str(code), "-o", str(built), *extra, "-lm"],
                capture_output=True, text=True,
            )  # fmt: skip
            if done.returncode == 0:
                with contextlib.suppress(OSError):  # a cache that cannot be written to is no cache
                    _put(built, kept)
                if (made := _loaded(kept) or _loaded(built)) is not None:
                    return made
                raise MachineError(
                    f"Nothing compiled may be run from {folder}; set TMPDIR, or leave 'compiled' off."
                )
        # killed for want of memory, or without room: another model would fail as well
        kind = MachineError if re.search("Killed|No space left", done.stderr) else InputError
        raise kind(f"The C compiler {found} failed, leave 'compiled' off: {done.stderr.strip()[-300:]}")


def _loaded(path: Path) -> ctypes.CDLL | None:
    """A library; None where it is not there, is damaged, or lies where nothing may be run."""
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        return None


def _cache() -> Path:
    """Folder of libraries in the user's cache; one that cannot be for a user without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hybrid_id"
    except RuntimeError:
        return Path(os.devnull) / "hybrid_id"


@functools.cache
def _machine() -> str:
    """What code for this processor depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = next((line for line in lines if line.lower().startswith(("flags", "features"))), "")
    return f"{platform.platform()} {platform.machine()} {features or platform.node()}"


def _key(*parts: str) -> str:
    return hashlib.sha256("\0".join((_machine(), *parts)).encode()).hexdigest()[:32]


def _put(built: Path, kept: Path) -> None:
    """Copy under a name of its own, then rename: other processes see a whole library or none."""
    kept.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = kept.with_suffix(f".{os.getpid()}")
    shutil.copyfile(built, part)
    part.replace(kept)
    if len(os.listdir(kept.parent)) > MOST_KEPT:  # the older half; who has loaded one of them keeps it
        for old in sorted(kept.parent.glob("*.so"), key=os.path.getmtime)[: MOST_KEPT // 2]:
            old.unlink(missing_ok=True)


def call(code: ctypes.CDLL, name: str, *arguments: Tensor | int) -> None:
    """Call a function of a library with arrays (contiguous) and whole numbers."""
    values = [ctypes.c_void_p(a.data_ptr()) if isinstance(a, Tensor) else ctypes.c_long(a) for a in arguments]
    getattr(code, name)(*values)
