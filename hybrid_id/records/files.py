"""Files that are whole under their names or not there at all, and values as strict JSON holds them."""

from __future__ import annotations

import json
import math
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_id.errors import InputError
from hybrid_id.reading import begin_to_write


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
