"""C code as a library: compiled for this machine, kept in the user's cache for other processes and later runs.

What an environment's shipped systems need may be compiled ahead, for all who use it (:func:`kept_ahead`).
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path

from torch import Tensor

from hybrid_id.errors import InputError, MachineError
from hybrid_id.records.files import write_together, write_whole

FLAGS = ("-O2", "-ftree-vectorize", "-march=native", "-std=gnu11", "-fPIC")
MOST_KEPT = 8000
"""Libraries in the user's cache, about 20 kB each."""
AHEAD = Path(sys.prefix) / "share" / "hybrid_id"
"""Where an environment's libraries are that were compiled ahead."""
DIGEST = ".sha256"
"""Ending of the file that holds a library's digest."""


_KEPT_IN: ContextVar[Path | None] = ContextVar("kept in", default=None)
"""Where libraries are kept in place of the user's cache."""


@contextlib.contextmanager
def kept_ahead() -> Iterator[Path]:
    """Keep what is compiled within for all who use this environment, in the folder that is given.

    Raises:
        InputError: nobody but its owner may write there.
    """
    try:
        if not AHEAD.exists():
            AHEAD.mkdir(parents=True)
            AHEAD.chmod(0o755)  # others read, whatever the umask
    except OSError as error:
        raise InputError(
            f"Nothing can be kept in {AHEAD} ({error.strerror}); give its owner's rights."
        ) from None
    if not os.access(AHEAD, os.W_OK) or not _trusted(AHEAD):
        raise InputError(
            f"{AHEAD} is not for this user to write, or for others, too; give its owner's rights."
        )
    library.cache_clear()
    token = _KEPT_IN.set(AHEAD)
    try:
        yield AHEAD
    finally:
        _KEPT_IN.reset(token)
        library.cache_clear()


def compiler() -> str | None:
    """Name of the C compiler here, None where there is none."""
    return next((c for c in ("gcc", "clang", "cc") if shutil.which(c)), None)


@functools.cache
def library(source: str, names: tuple[str, ...], flags: Sequence[str] = FLAGS) -> ctypes.CDLL:
    """The library that a C compiler makes of a source, kept for other processes and later runs.

    Args:
        source: the C code.
        names: functions of it that will be called; a kept library that lacks one is built again.
        flags: of the compiler.

    Raises:
        InputError: there is no compiler or it fails.
    """
    found = compiler()
    if found is None:
        raise InputError("Compiled steps need a C compiler; install gcc, or leave 'compiled' off.")
    cache, name = _cache(), _name(source, found, flags)
    for place in _places():
        if _is_whole(place / name) and (known := _loaded(place / name, names)) is not None:
            return known
    kept = None if cache is None else cache / name
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
                if kept is not None:
                    with contextlib.suppress(OSError):  # a cache that cannot be written to is no cache
                        # with its digest: others, and those after a loss of power, see both whole or none
                        content = built.read_bytes()
                        write_together({kept: content, kept.with_suffix(DIGEST): _digest(content)})
                        if (
                            len(os.listdir(kept.parent)) > 2 * MOST_KEPT
                        ):  # the older half; who has loaded one keeps it
                            for old in sorted(kept.parent.iterdir(), key=os.path.getmtime)[:MOST_KEPT]:
                                old.unlink(missing_ok=True)
                # the new file first: under the kept one's name the loader may still know a library without the names
                for path in (built, kept):
                    if path is not None and (made := _loaded(path, names)) is not None:
                        return made
                raise MachineError(
                    f"Nothing compiled may be run from {folder}; set TMPDIR, or leave 'compiled' off."
                )
        # killed for want of memory, or without room: another model would fail as well
        kind = MachineError if re.search("Killed|No space left", done.stderr) else InputError
        raise kind(f"The C compiler {found} failed, leave 'compiled' off: {done.stderr.strip()[-300:]}")


def note(about: Sequence[str], source: str, constants: Sequence[float], flags: Sequence[str] = FLAGS) -> None:
    """Keep which library was made for something, and with which constants, for :func:`noted` of later runs.

    Args:
        about: all that decides source and constants.
        source: of the library.
        constants: to be kept with it.
        flags: of the compiler.
    """
    cache, found = _cache(), compiler()
    if cache is not None and found is not None:
        text = json.dumps({"library": _name(source, found, flags), "constants": list(constants)})
        with contextlib.suppress(OSError):
            write_whole(cache / f"{_key(*about)}.json", text)


def noted(about: Sequence[str], names: tuple[str, ...]) -> tuple[ctypes.CDLL, list[float]] | None:
    """The library that an earlier run has made for something, and its constants; None where there is none.

    Neither its source nor a compiler is needed.
    """
    for place in _places():
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            told = json.loads((place / f"{_key(*about)}.json").read_text(encoding="utf-8"))
            kept, constants = place / Path(told["library"]).name, [float(c) for c in told["constants"]]
            if _is_whole(kept) and (known := _loaded(kept, names)) is not None:
                return known, constants
    return None


def _loaded(path: Path, names: Sequence[str]) -> ctypes.CDLL | None:
    """A library; None where it is not there, lacks a function, or lies where nothing may be run."""
    try:
        code = ctypes.CDLL(str(path))
    except OSError:
        return None
    return code if all(hasattr(code, name) for name in names) else None


def _is_whole(kept: Path) -> bool:
    """Whether a kept library is the one whose digest stands beside it: to load a damaged one ends the process."""
    try:
        return _digest(kept.read_bytes()) == kept.with_suffix(DIGEST).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _places() -> list[Path]:
    """Folders in which libraries may be found: the user's cache first."""
    cache = _cache()
    return [*([] if cache is None else [cache]), *([AHEAD] if cache != AHEAD and _trusted(AHEAD) else [])]


def _trusted(folder: Path) -> bool:
    """Whether a folder is the user's own or root's, and nobody else may write there: what lies in it is run."""
    try:
        about = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(about.st_mode) and about.st_uid in (0, os.geteuid()) and not about.st_mode & 0o022


def _cache() -> Path | None:
    """Folder of libraries in the user's cache, made where it is not there; None where no trusted one can be.

    A relative XDG_CACHE_HOME counts as none, as its specification demands.
    """
    if (ahead := _KEPT_IN.get()) is not None:
        return ahead
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        folder = (Path(given) if Path(given).is_absolute() else Path.home() / ".cache") / "hybrid_id"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        own = folder.lstat().st_uid == os.geteuid()
    except (OSError, RuntimeError, ValueError):  # a user without a home, a file in the way
        return None
    return folder if own and _trusted(folder) and folder.is_absolute() else None


@functools.cache
def _machine() -> str:
    """What code for this processor depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = next((line for line in lines if line.lower().startswith(("flags", "features"))), "")
    system = os.uname()  # platform.platform() starts another program, which takes longer than all else here
    libc = os.confstr("CS_GNU_LIBC_VERSION") if "CS_GNU_LIBC_VERSION" in os.confstr_names else ""
    return f"{system.sysname} {system.machine} {libc} {features or system.nodename}"


def _name(source: str, compiler: str, flags: Sequence[str]) -> str:
    return f"{_key(source, compiler, *flags)}.so"


def _key(*parts: str) -> str:
    return hashlib.sha256("\0".join((_machine(), *parts)).encode()).hexdigest()[:32]


def address(code: ctypes.CDLL, name: str) -> int:
    """Where something that a library exports lies."""
    return ctypes.addressof(ctypes.c_char.in_dll(code, name))


def call(code: ctypes.CDLL, name: str, *arguments: Tensor | int) -> None:
    """Call a function of a library with arrays (contiguous) and whole numbers."""
    values = [ctypes.c_void_p(a.data_ptr()) if isinstance(a, Tensor) else ctypes.c_long(a) for a in arguments]
    getattr(code, name)(*values)
