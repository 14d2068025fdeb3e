"""Records of an MCAP file [MCAP], parsed by mcap's StreamReader, with limits on size and on memory.

A record is an opcode (one byte), a length (eight bytes) and its content. No function here reads a content before the
length is compared with the end of the file and with the limit of its type.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream

from kr270_milling.base.errors import RecordingError

__all__ = ["HEAD", "MAGIC", "SMALL_LIMIT", "Damage", "RecordPlace", "attachment_at", "checksum", "mcap_file",
           "open_to_read", "place_at", "places", "read_bytes", "record_at", "unpack"]  # fmt: skip

MB = 1024 * 1024
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode and length of a record
LARGE_LIMIT = 256 * MB  # of a chunk, an attachment or a message
SMALL_LIMIT = 32 * MB  # of any other record
CHUNK_MEMORY = 400 * MB  # of a packed chunk and its unpacked content together
LARGE = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.MESSAGE)
UNREADABLE = (McapError, struct.error, UnicodeDecodeError, StopIteration)


class Damage(ValueError):
    """A fault in the file; offset: its place [bytes]."""

    def __init__(self, reason: str, offset: int):
        self.reason = reason
        self.offset = offset
        super().__init__(reason)


class RecordPlace(NamedTuple):
    """Opcode, first byte and the byte after the last one of a record in its file."""

    opcode: int
    offset: int
    end: int


class _Bounded:
    """The bytes of one record as a stream: a damaged length in the record cannot read beyond its end."""

    def __init__(self, stream: IO[bytes], place: RecordPlace):
        self._stream = stream
        self._left = place.end - place.offset
        stream.seek(place.offset)

    def read(self, size: int) -> bytes:
        if size > self._left:
            raise EndOfFile
        self._left -= size
        return self._stream.read(size)


def mcap_file(path) -> Path:
    """Return the MCAP file itself, or the MCAP file in the directory of a recording. Raises RecordingError."""
    path = Path(path)
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise RecordingError(path, f"holds {len(files)} MCAP files where a recording has one")
    return files[0]


def open_to_read(path: Path) -> IO[bytes]:
    """Open a regular file. Raises RecordingError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a pipe must not block
    except (OSError, ValueError) as error:
        raise RecordingError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise RecordingError(path, "is not a file")
    return os.fdopen(file, "rb", buffering=65536)


def read_bytes(stream: IO[bytes], begin: int, size: int) -> bytes:
    """Read ``size`` bytes from an offset. Raises Damage."""
    stream.seek(begin)
    data = stream.read(size)
    if len(data) != size:
        raise Damage("the file became shorter while it was read", begin)
    return data


def checksum(stream: IO[bytes], begin: int, end: int) -> int:
    """CRC-32 of the bytes between two offsets."""
    crc = 0
    for at in range(begin, end, MB):
        crc = zlib.crc32(read_bytes(stream, at, min(MB, end - at)), crc)
    return crc


def place_at(stream: IO[bytes], offset: int, end: int) -> RecordPlace | None:
    """The record that begins at an offset; None if the record does not end before ``end``.

    Opcode 0 does not exist: zeros follow the last record after a power failure. Raises Damage above the limits.
    """
    if offset + HEAD.size > end:
        return None
    opcode, length = HEAD.unpack(read_bytes(stream, offset, HEAD.size))
    if opcode == 0 or offset + HEAD.size + length > end:
        return None
    limit = LARGE_LIMIT if opcode in LARGE else SMALL_LIMIT
    if length > limit:
        raise Damage(f"a record claims {length} bytes, more than the limit of {limit}", offset)
    return RecordPlace(opcode, offset, offset + HEAD.size + length)


def places(stream: IO[bytes], begin: int, end: int) -> Iterator[RecordPlace]:
    """All whole records between two offsets. Raises Damage."""
    while (place := place_at(stream, begin, end)) is not None:
        yield place
        begin = place.end


def record_at(stream: IO[bytes], place: RecordPlace) -> Any:
    """Parse one record with mcap; None for an opcode that mcap does not know. Raises Damage."""
    bounded = cast(IO[bytes], _Bounded(stream, place))
    reader = StreamReader(bounded, skip_magic=True, emit_chunks=True, record_size_limit=LARGE_LIMIT)
    try:
        record = next(reader.records)
    except EndOfFile:
        if place.opcode >= 0x80:  # an opcode of an application; mcap skips the record
            return None
        raise Damage("a record ends in the middle of a field", place.offset) from None
    except UNREADABLE:
        raise Damage("a record cannot be parsed", place.offset) from None
    if isinstance(record, Chunk) and _chunk_size(record) != place.end - place.offset:
        raise Damage("a chunk has lengths that do not agree", place.offset)
    return record


def _chunk_size(chunk: Chunk) -> int:
    """[bytes] of the record: opcode, length, two times, size, checksum, name of the compression, length of the data."""
    return HEAD.size + 8 + 8 + 8 + 4 + 4 + len(chunk.compression.encode()) + 8 + len(chunk.data)


def attachment_at(stream: IO[bytes], place: RecordPlace) -> Any:
    """Parse an attachment and compare its checksum, which mcap does not do. Raises Damage."""
    record = record_at(stream, place)
    if place.opcode != Opcode.ATTACHMENT or record is None:
        raise Damage("the index of attachments points to another record", place.offset)
    crc = int.from_bytes(read_bytes(stream, place.end - 4, 4), "little")
    if crc and checksum(stream, place.offset + HEAD.size, place.end - 4) != crc:
        raise Damage(f"the attachment {record.name} does not fit its checksum", place.offset)
    size = sum(len(text.encode()) for text in (record.name, record.media_type)) + len(record.data)
    if HEAD.size + 8 + 8 + 4 + 4 + 8 + 4 + size != place.end - place.offset:
        raise Damage("an attachment has lengths that do not agree", place.offset)
    return record


def unpack(chunk: Chunk, offset: int) -> bytes:
    """Unpack a chunk by mcap, after a check that memory suffices; offset: of the chunk. Raises Damage."""
    size, packed = chunk.uncompressed_size, len(chunk.data)
    if chunk.compression not in ("", "zstd", "lz4"):
        raise Damage(f"a chunk has the unknown compression {chunk.compression[:16]!r}", offset)
    memory = {"": 0, "zstd": packed + size, "lz4": packed + 2 * size}[chunk.compression]  # lz4 copies its result
    if size > LARGE_LIMIT or memory > CHUNK_MEMORY:
        raise Damage(f"a chunk of {packed} bytes claims {size} unpacked bytes, more than memory allows", offset)
    if not size:
        return b""
    try:
        if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) not in (-1, size):
            raise Damage(f"a chunk does not unpack to the {size} bytes that it announces", offset)
        if chunk.compression == "lz4":  # mcap unpacks lz4 without a limit
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
            chunk = replace(chunk, compression="", data=data)
        stream, unpacked = get_chunk_data_stream(chunk, validate_crc=True)
    except CRCValidationError:
        raise Damage("a chunk does not fit its checksum", offset) from None
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise Damage("a chunk cannot be unpacked", offset) from error
    if unpacked != size:
        raise Damage(f"a chunk does not unpack to the {size} bytes that it announces", offset)
    return stream.read(size)
