"""A single file of results: complete under its name, or not there at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hybrid_id.cli.folder import RESULTS, make_parents
from hybrid_id.errors import InputError


@contextmanager
def result_file(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a temporary file that takes the name `path` when it is written."""
    refuse_file(path, force=force)
    make_parents(path)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix)
    os.close(handle)
    try:
        yield Path(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    finally:
        Path(temporary).unlink(missing_ok=True)


def refuse_file(path: Path, *, force: bool) -> None:
    """Raise InputError where a result cannot take the name of a file; what belongs to a folder of results stays."""
    if path.is_dir() or (path.exists() and not force):
        what = (
            "is a folder; give the name of a file"
            if path.is_dir()
            else "exists; give another name, or --force"
        )
        raise InputError(f"{path} {what}")
    if path.name in (*RESULTS, "model.yaml") and path.exists():
        raise InputError(f"{path} belongs to earlier results, which nothing replaces; give another name")
