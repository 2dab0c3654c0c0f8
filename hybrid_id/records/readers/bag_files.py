"""Storage files of ROS bags, walked through before a library reads them.

Every record must end within the file, every chunk must unpack to a size that a record may have, and the index may
name no chunk that the walk has not met.
"""

import bz2
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

from hybrid_id.errors import InputError
from hybrid_id.records.readers.unpack import refuse_growth

STORAGES = re.compile(r"\.(mcap|db3)(\.zstd)?$")
_PIECE = 1 << 20
_ZSTD = b"\x28\xb5\x2f\xfd"
_MCAP = b"\x89MCAP0\r\n"
_CHUNK_HEAD = 32  # bytes of a chunk record before the name of its compression


def is_bag_folder(path: Path) -> bool:
    """Whether a folder holds the files of a ROS 2 bag."""
    return path.is_dir() and any(STORAGES.search(file.name) for file in path.iterdir())


def check_storage(file: Path, bag: Path) -> None:
    """Raise InputError for a file that is cut short, unpacks beyond any record, or runs code of its own.

    Args:
        file: A `.bag`, `.mcap` or `.db3` file.
        bag: The bag that the user named, for the message.
    """
    kind = file.suffix.lower()
    if kind == ".db3":
        _check_database(file, bag)
    elif kind in (".bag", ".mcap"):
        with file.open("rb") as stream:
            (_check_bag if kind == ".bag" else _check_mcap)(stream, file.stat().st_size, bag)
    else:
        raise InputError(
            f"{bag} is no bag that is read; give a .bag, .mcap or .db3 file, or a ROS 2 bag's folder"
        )


def unpack_storage(file: Path, folder: Path) -> Path:
    """Unpack a `.zstd` file into a folder, as far as a record may go."""
    target, size, total = folder / file.stem, file.stat().st_size, 0
    with target.open("wb") as out:
        for piece in _pieces(_engine("zstd"), file.read_bytes()):
            total += len(piece)
            refuse_growth(file, size, total)
            out.write(piece)
    return target


def message_bytes(raw: Any, bag: Path) -> bytes:
    """The bytes of a message, unpacked where the recorder has packed each one by itself."""
    raw = bytes(raw)
    if not raw.startswith(_ZSTD):
        return raw
    found, total = [], 0
    for piece in _pieces(_engine("zstd"), raw):
        total += len(piece)
        refuse_growth(bag, len(raw), total)
        found.append(piece)
    return b"".join(found)


def _check_mcap(stream: BinaryIO, size: int, bag: Path) -> None:
    """Walk through the records of an MCAP file."""
    if stream.read(len(_MCAP)) != _MCAP:
        raise InputError(f"{bag} is no MCAP file; give the right file or its 'format'")
    met, total, place = set(), 0, len(_MCAP)
    while place + 9 <= size - len(_MCAP):
        stream.seek(place)
        kind, length = struct.unpack("<BQ", stream.read(9))
        if length > size - place - 9:
            raise _cut_short(bag)
        if kind == 0x06:
            content = stream.read(length)
            packing, packed = _mcap_chunk(content, bag)
            met.add((place, packing, len(packed)))
            total = _unpacked(packing, packed, total, size, bag)
        elif kind == 0x08:
            start, *named = _mcap_index(stream.read(length), bag)
            if (start, *named) not in met:
                raise InputError(f"{bag}: its index names a chunk that is not there; recover its index")
        place += 9 + length
    stream.seek(max(size - len(_MCAP), 0))
    if place != size - len(_MCAP) or stream.read() != _MCAP:
        raise _cut_short(bag)


def _mcap_chunk(content: bytes, bag: Path) -> tuple[str, bytes]:
    """Compression and contents of a chunk."""
    try:
        (length,) = struct.unpack_from("<I", content, _CHUNK_HEAD - 4)
        packing = content[_CHUNK_HEAD : _CHUNK_HEAD + length].decode()
        (count,) = struct.unpack_from("<Q", content, _CHUNK_HEAD + length)
    except (struct.error, UnicodeDecodeError):
        raise _cut_short(bag) from None
    packed = content[_CHUNK_HEAD + length + 8 :]
    if len(packed) != count:
        raise _cut_short(bag)
    return packing, packed


def _mcap_index(content: bytes, bag: Path) -> tuple[int, str, int]:
    """Start, compression and packed size of the chunk that an index record names."""
    try:
        (start,) = struct.unpack_from("<Q", content, 16)
        (offsets,) = struct.unpack_from("<I", content, 32)
        place = 36 + offsets + 8
        (length,) = struct.unpack_from("<I", content, place)
        packing = content[place + 4 : place + 4 + length].decode()
        (packed,) = struct.unpack_from("<Q", content, place + 4 + length)
    except (struct.error, UnicodeDecodeError):
        raise _cut_short(bag) from None
    return start, packing, packed


def _check_bag(stream: BinaryIO, size: int, bag: Path) -> None:
    """Walk through the records of a ROS 1 bag."""
    first = stream.readline(20)
    if first != b"#ROSBAG V2.0\n":
        raise InputError(f"{bag} is no ROS 1 bag of version 2.0; give the right file or its 'format'")
    met, total, place = set(), 0, len(first)
    while place < size:
        stream.seek(place)
        head, start = _block(stream, place, size, bag)
        fields = _fields(head)
        length, _ = _length(stream, start, size, bag)
        if fields.get(b"op") == b"\x05":
            packing = fields.get(b"compression", b"").decode(errors="replace")
            met.add(place)
            total = _unpacked("" if packing == "none" else packing, stream.read(length), total, size, bag)
        elif (
            fields.get(b"op") == b"\x06"
            and int.from_bytes(fields.get(b"chunk_pos", b""), "little") not in met
        ):
            raise InputError(f"{bag}: its index names a chunk that is not there; run 'rosbag reindex' on it")
        place = start + 4 + length
    if place != size:
        raise _cut_short(bag)


def _length(stream: BinaryIO, place: int, size: int, bag: Path) -> tuple[int, int]:
    """Length of a block of a ROS 1 bag, and where its contents begin."""
    stream.seek(place)
    data = stream.read(4)
    length = int.from_bytes(data, "little")
    if len(data) < 4 or length > size - place - 4:
        raise _cut_short(bag)
    return length, place + 4


def _block(stream: BinaryIO, place: int, size: int, bag: Path) -> tuple[bytes, int]:
    """Contents of a block, and where it ends."""
    length, start = _length(stream, place, size, bag)
    return stream.read(length), start + length


def _fields(head: bytes) -> dict[bytes, bytes]:
    """Fields of a record's header."""
    found, place = {}, 0
    while place + 4 <= len(head):
        length = int.from_bytes(head[place : place + 4], "little")
        name, _, value = head[place + 4 : place + 4 + length].partition(b"=")
        found[name] = value
        place += 4 + length
    return found


def _check_database(file: Path, bag: Path) -> None:
    """Refuse a database whose tables are views, triggers or computed columns: such run what their author wrote."""
    try:
        connection = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            rows = connection.execute("SELECT type, sql FROM sqlite_master LIMIT 1000").fetchall()
        finally:
            connection.close()
    except sqlite3.Error as error:
        reason = " ".join(str(error).split())[:80]
        raise InputError(f"{bag} is not a readable bag ({reason}); record or copy it again") from None
    for kind, text in rows:
        if kind not in ("table", "index") or re.search(r"\b(AS|VIRTUAL)\b", text or "", re.IGNORECASE):
            raise InputError(f"{bag}: its database holds a {kind} that no recorder writes; record it anew")


def _unpacked(packing: str, packed: bytes, total: int, size: int, bag: Path) -> int:
    """Add to a total what a chunk unpacks to, none of which is kept."""
    if not packing:
        return total + len(packed)
    try:
        for piece in _pieces(_engine(packing), packed):
            total += len(piece)
            refuse_growth(bag, size, total)
    except InputError:
        raise
    except Exception as error:  # each of three libraries has errors of its own
        raise InputError(f"{bag} is damaged ({' '.join(str(error).split())[:80]}); copy it again") from None
    return total


def _engine(packing: str) -> Callable[[], Any]:
    """Maker of decompressors that unpack piece by piece."""
    if packing == "bz2":
        return bz2.BZ2Decompressor
    if packing == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # pyright: ignore[reportMissingImports]

        return LZ4FrameDecompressor
    if packing == "zstd":
        try:
            from compression import zstd  # pyright: ignore[reportMissingImports]
        except ImportError:
            from backports import zstd  # pyright: ignore[reportMissingImports]
        return zstd.ZstdDecompressor
    raise ValueError(f"unknown compression '{packing[:20]}'")


def _pieces(make: Callable[[], Any], data: bytes) -> Iterator[bytes]:
    """Unpack data that may hold several streams, one behind the other."""
    while data:
        engine, piece = make(), data
        while True:
            piece = engine.decompress(piece, _PIECE)
            yield piece
            if engine.eof or engine.needs_input:
                break
            piece = b""
        data = engine.unused_data if engine.eof else b""


def _cut_short(bag: Path) -> InputError:
    return InputError(f"{bag} is damaged or cut short; copy it again, or recover its index")
