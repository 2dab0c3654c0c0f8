"""Files that are whole under their names or not there at all, and values as strict JSON holds them."""

from __future__ import annotations

import fcntl
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import begin_to_write

HIDDEN = "hybrid-id-"
"""In the name of a hidden folder of this program."""


def plain(value: Any) -> Any:
    """Mappings, lists, numbers and words in place of arrays and tuples; None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def natural_order(name: str) -> list[tuple[int, str]]:
    """Key by which `run2` comes before `run10`."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file under a temporary name beside its own and rename it; text as UTF-8. What fails leaves nothing.

    Raises:
        OSError: there is no room, or no right to write there.
    """
    write_together({path: content})


def write_together(contents: Mapping[Path, str | bytes]) -> None:
    """Write files that belong together as :func:`write_whole` does, and rename them once all are complete.

    Raises:
        InputError: the running command reads one of them.
        OSError: there is no room, or no right to write there.
    """
    for path in contents:
        begin_to_write(path)
    made: list[tuple[str, Path]] = []
    try:
        for path, content in contents.items():
            handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
            made.append((temporary, path))
            with os.fdopen(handle, "wb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())  # else a loss of power may leave the new name with nothing in it
            os.chmod(temporary, 0o644)  # mkstemp makes files that nobody else may read
        for temporary, path in made:
            os.replace(temporary, path)
    except BaseException:
        for temporary, _ in made:
            Path(temporary).unlink(missing_ok=True)
        raise


@contextmanager
def hidden_beside(place: Path) -> Iterator[Path]:
    """Yield an empty hidden folder beside a place, for what takes that name once it is complete.

    It is gone afterwards. One that a killed process has left goes, too; if that one was just replacing what stood at
    the place, it is brought back first: it is called ``old`` inside.
    """
    begin = f".{place.name}.{HIDDEN}"
    for left in [path for path in place.parent.iterdir() if path.name.startswith(begin)]:
        with suppress(OSError), locked(left):
            if (left / "old").exists() and not place.exists():
                (left / "old").replace(place)
            shutil.rmtree(left)
    with ExitStack() as stack:
        made = None
        while made is None or not made.exists():  # another process may take it away before it is locked
            made = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=place.parent, prefix=begin)))
            with suppress(BlockingIOError, FileNotFoundError):
                stack.enter_context(locked(made))
        yield made


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep others who ask for it out of a folder; a process that ends, however it ends, keeps nobody out.

    Raises:
        BlockingIOError: somebody else is in it.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def write_json(path: Path, content: Any) -> None:
    """Write values as JSON, whole."""
    write_whole(path, json.dumps(plain(content), indent=1) + "\n")


def make_folder(path: Path) -> Path:
    """Make a folder that a run fills bit by bit, where it is not there; returns it.

    Raises:
        InputError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be made ({error.strerror}); give another folder") from None
    return path
