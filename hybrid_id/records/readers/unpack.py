"""Compressed files that unpack to far more than any record: refused before a parser has to hold them."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from hybrid_id.errors import InputError

FREE = 100_000_000
"""Bytes that any file may unpack to."""
RATIO = 100
"""Beyond those, bytes for one compressed byte: tables of numbers come to 20, deflate's limit is 1032."""
_LIMIT = 1032
_CHUNK = 1 << 20
_MAT_HEADER = 128
_MAT_COMPRESSED = 15


def refuse_bomb(path: Path) -> None:
    """Raise InputError where a gzip file, or a compressed variable of a MATLAB file, unpacks beyond the limits."""
    if not path.is_file() or not may_inflate(path.stat().st_size):
        return
    with path.open("rb") as file:
        for start, size, window in _streams(file, path):
            file.seek(start)
            unpacked, left = 0, size
            engine = zlib.decompressobj(window)
            while left > 0 and (data := file.read(min(_CHUNK, left))):
                left -= len(data)
                while data:
                    unpacked += _length(engine, data)
                    refuse_growth(path, size, unpacked)
                    data = engine.unused_data  # a gzip file may hold several, one behind the other
                    engine = zlib.decompressobj(window) if engine.eof else engine


def may_inflate(size: int) -> bool:
    """Whether so many bytes of a deflated stream can unpack to more than any file may."""
    return size * _LIMIT > FREE


def refuse_inflating(path: Path, data: bytes) -> None:
    """Raise InputError where a deflated stream unpacks beyond the limits."""
    engine, unpacked, rest = zlib.decompressobj(), 0, data
    try:
        while rest and not engine.eof:
            unpacked += len(engine.decompress(rest, _CHUNK))
            refuse_growth(path, len(data), unpacked)
            rest = engine.unconsumed_tail
    except zlib.error:
        pass  # a damaged stream is left to its reader


def refuse_growth(path: Path, size: int, unpacked: int) -> None:
    """Raise InputError where so many bytes unpack to so many more than any record's do."""
    if unpacked > FREE and unpacked > RATIO * size:
        raise InputError(
            f"{path} unpacks to more than {RATIO} times its size and over {FREE // 1_000_000} MB, which no record "
            "does; bring it uncompressed if it is one"
        )


def _streams(file: BinaryIO, path: Path) -> Iterator[tuple[int, int, int]]:
    """Start, size and zlib window of each compressed stream."""
    size = path.stat().st_size
    if path.suffix == ".gz":
        yield 0, size, zlib.MAX_WBITS + 16
        return
    start = _MAT_HEADER
    file.seek(_MAT_HEADER - 2)
    order = "<" if file.read(2) == b"IM" else ">"
    while start + 8 <= size:
        file.seek(start)
        kind, length = struct.unpack(f"{order}II", file.read(8))
        if kind == _MAT_COMPRESSED:
            yield start + 8, min(length, size - start - 8), zlib.MAX_WBITS
        start += 8 + length


def _length(engine: "zlib._Decompress", data: bytes) -> int:
    """Bytes that a piece unpacks to, none of which is kept; a damaged stream is left to its reader."""
    total = 0
    try:
        while data:
            total += len(engine.decompress(data, _CHUNK))
            data = b"" if engine.eof else engine.unconsumed_tail  # at the end that may hold what is unused
    except zlib.error:
        pass
    return total
