"""Files of a user: each is opened here, and what bounds hold before a library parses it is said here.

A file is a regular one, no larger than its kind may be, and nested no deeper than people nest. Parsers recurse, and
hold many bytes for one that they read, so they get to see nothing beyond.
"""

import errno
import json
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any

from hybrid_id.errors import InputError

MOST_DEPTH = 60
"""Levels that settings, results and descriptions may nest."""
MOST_VALUES = 5_000_000
"""Values of one JSON file."""
MOST_GROUPS = 1_000_000
"""Lists and mappings of one JSON file, which cost a parser ten times what a number does."""
MOST_COLUMNS = 10_000
"""Columns of one table."""
LONGEST_NAME = 200
"""Signs of the name of a column, a key or an element."""
LARGEST_RESULT = 200_000_000
"""Bytes of a file that the program itself has written."""
PLAIN_NAME = re.compile(r"\w[\w .+@,=()-]{0,99}")
"""Of a record or a case: a file or folder may have that name, and it leads nowhere else."""
_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"?', re.DOTALL)
_STEPS = {ord("["): 1, ord("{"): 1, ord("]"): -1, ord("}"): -1}
_NO_BRACKET = bytes(set(range(256)) - _STEPS.keys())


@dataclass
class _Apart:
    """Files of one command.

    Attributes:
        read: what it has read, but for what it has made itself.
        announced: what it is going to write.
        made: what it has written.
    """

    read: set[Path] = field(default_factory=set)
    announced: set[Path] = field(default_factory=set)
    made: set[Path] = field(default_factory=set)


_APART: ContextVar[_Apart | None] = ContextVar("_APART", default=None)


@contextmanager
def reading_and_writing_apart() -> Iterator[None]:
    """Let nothing that is done inside write to a file that was read inside; outside of it nothing is watched."""
    token = _APART.set(_Apart())
    try:
        yield
    finally:
        _APART.reset(token)


def announce(path: Path) -> None:
    """Say that a file is going to be written, before the work begins: from here on it is not read any more.

    Raises:
        InputError: it has been read.
    """
    if (apart := _APART.get()) is not None:
        apart.announced.add(path.resolve())
        _refuse_both(path, path.resolve() in apart.read)


def begin_to_write(path: Path) -> None:
    """Say that a file is being written.

    Raises:
        InputError: it has been read, and is not the command's own.
    """
    if (apart := _APART.get()) is not None:
        _refuse_both(path, path.resolve() in apart.read)
        apart.made.add(path.resolve())


def read_below(folder: Path) -> list[Path]:
    """Files below a folder that have been read."""
    apart, home = _APART.get(), folder.resolve()
    return sorted(path for path in (apart.read if apart else ()) if path.is_relative_to(home))


def _is_read(path: Path) -> None:
    if (apart := _APART.get()) is not None and (place := path.resolve()) not in apart.made:
        apart.read.add(place)
        _refuse_both(path, place in apart.announced)


def _refuse_both(path: Path, both: bool) -> None:
    if both:
        raise InputError(
            f"{path} is read by this command, which would also write to it; write to another name"
        )


def size_of(path: Path, *, own: bool = False) -> int:
    """Bytes of a regular file, links to it followed; it counts as read.

    Args:
        path: the file.
        own: the program has written it, and may write it again.

    Raises:
        InputError: it is a pipe, a device or a socket, or its links lead in a circle.
        OSError: it is not there, a folder, or out of reach.
    """
    try:
        found = path.stat()
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise InputError(f"{path} is a link that leads in a circle; give the file itself") from None
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(path))
    if not stat.S_ISREG(found.st_mode):
        raise InputError(
            f"{path} is a pipe or a device, which is read once only; write its contents to a file"
        )
    if not own:
        _is_read(path)
    return found.st_size


def read_bytes(path: Path, most: int, kind: str, *, own: bool = False) -> bytes:
    """Contents of a regular file.

    Args:
        path: the file.
        most: bytes that it may have.
        kind: what it should be, ``settings file``.
        own: see :func:`size_of`.

    Raises:
        InputError: it is larger, or no regular file.
        OSError: see :func:`size_of`.
    """
    if size_of(path, own=own) <= most:
        with path.open("rb") as file:
            content = file.read(most + 1)  # files of /proc say that they are empty
        if len(content) <= most:
            return content
    raise InputError(f"{path} is larger than {most / 1e6:g} MB, so it is no {kind}; give the right file")


def read_json(path: Path, kind: str, most: int = LARGEST_RESULT, *, own: bool = False) -> Any:
    """Values of a JSON file; see :func:`read_bytes` for what is raised, and :func:`parse_json`."""
    return parse_json(read_bytes(path, most, kind, own=own), path)


def parse_json(content: bytes, path: Path) -> Any:
    """Values of JSON text, its depth and width seen first; ``path`` is for messages.

    Raises:
        InputError: it is no JSON, or beyond the bounds of this module.
    """
    bare = _STRING.sub(b"", content)
    groups = bare.count(b"[") + bare.count(b"{")
    depth = max(accumulate(map(_STEPS.__getitem__, bare.translate(None, _NO_BRACKET))), default=0)
    if groups > MOST_GROUPS or groups + bare.count(b",") > MOST_VALUES:
        raise InputError(f"{path} holds more values than any file of this program; give the right file")
    if depth > MOST_DEPTH:
        raise InputError(
            f"{path} is nested {depth} levels deep, where {MOST_DEPTH} are read; give the right file"
        )
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        reason = str(error).split(";")[0][:120]
        raise InputError(f"{path} is not valid JSON ({reason}); bring it again") from None


def read_object(path: Path, kind: str) -> dict[str, Any]:
    """Keys and values of a JSON file that the program has written; see :func:`read_json`.

    Raises:
        InputError: it holds something else, too.
    """
    found = read_json(path, kind, own=True)
    if not isinstance(found, dict):
        raise InputError(f"{path} is no {kind}; give the right file")
    return found


@contextmanager
def as_written(source: Path | str, remedy: str) -> Iterator[None]:
    """Say of files that the program has written, but somebody else has changed, what is wrong while they are used.

    Raises:
        InputError: in place of a key that lacks, or a value that is none of that key.
    """
    try:
        yield
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        what = (
            f"lacks key {error}" if isinstance(error, KeyError) else f"holds values that do not fit ({error})"
        )
        raise InputError(f"{source} {what}; {remedy}") from error


def refuse_outside(path: Path, folder: Path, what: str, remedy: str) -> None:
    """Raise InputError where a path, its links followed, leads out of a folder.

    Args:
        path: of the file.
        folder: in which it has to lie.
        what: words for the file, at the start of the message.
        remedy: what to do.
    """
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):
        raise InputError(f"{what} is a link that leads in a circle; {remedy}") from None
    except ValueError:  # no file can have that name
        inside = False
    if not inside:
        raise InputError(f"{what} leads out of the folder {folder}; {remedy}")
