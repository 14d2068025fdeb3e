"""Records of an MCAP file [MCAP], parsed by mcap's StreamReader, and the one walk over them.

A record is an opcode (one byte), a length (eight bytes) and its content. No function here reads a content before the
length is compared with the end of the file and with the limit.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from kr270_milling.base.errors import RecordingError

__all__ = ["HEAD", "MAGIC", "ChunkPlace", "Damage", "RecordPlace", "attachment_at", "checksum", "chunk_at",
           "mcap_file", "open_to_read", "place_at", "read_bytes", "record_at", "unpack", "walk"]  # fmt: skip

MB = 1024 * 1024
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode and length of a record
CHUNK_HEAD = struct.Struct("<BQQQQII")  # and first time, last time, size, checksum, length of the compression's name
LIMIT = 256 * MB  # of a record, and of an unpacked chunk
PRIVATE = 0x80  # opcodes from here on belong to applications


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


class ChunkPlace(NamedTuple):
    """A chunk, or a run of messages outside of chunks, as its record or its index describes it."""

    opcode: int  #: CHUNK or MESSAGE
    offset: int
    end: int
    first_time: int  #: [ns], smallest and largest log time
    last_time: int
    unpacked: int  #: [bytes]
    compression: str = ""
    packed: int = 0  #: [bytes]

    @property
    def size(self) -> int:
        return self.end - self.offset


class _Bounded:
    """The bytes between two offsets as a stream: a damaged length cannot read beyond the end."""

    def __init__(self, stream: IO[bytes], begin: int, end: int):
        self._stream = stream
        self._left = end - begin
        stream.seek(begin)

    def read(self, size: int = -1) -> bytes:
        """Read up to ``size`` bytes, as decompressors expect."""
        data = self._stream.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(data)
        return data


class _Whole(_Bounded):
    def read(self, size: int = -1) -> bytes:
        """Read exactly ``size`` bytes, as mcap expects."""
        if size > self._left:
            raise EndOfFile
        return super().read(size)


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

    Opcode 0 does not exist: zeros follow the last record after a power failure. Raises Damage above the limit.
    """
    if offset + HEAD.size > end:
        return None
    opcode, length = HEAD.unpack(read_bytes(stream, offset, HEAD.size))
    if opcode == 0 or offset + HEAD.size + length > end:
        return None
    if length > LIMIT:
        raise Damage(f"a record claims {length} bytes, more than the limit of {LIMIT}", offset)
    return RecordPlace(opcode, offset, offset + HEAD.size + length)


def walk(
    stream: IO[bytes],
    begin: int,
    end: int,
    visit: Callable[[RecordPlace], object],
    resume: Callable[[Damage, RecordPlace | None], int] | None = None,
) -> RecordPlace | None:
    """Visit each whole record between two offsets; return the end of the data section, or None without one.

    resume: called with a Damage and the record, if its length is readable; returns the offset where the walk
    continues. Without ``resume`` the walk raises Damage, and ends before a record that is not whole.
    """
    while begin < end:
        place = None
        try:
            place = place_at(stream, begin, end)
            if place is None and resume:
                raise Damage("no whole record", begin)
            if place is None or place.opcode == Opcode.DATA_END:
                return place
            visit(place)
            begin = place.end
        except Damage as damage:
            damage.offset = begin  # of the record, not of a definition in its unpacked content
            if not resume:
                raise
            begin = resume(damage, place)
    return None


def record_at(stream: IO[bytes], place: RecordPlace) -> Any:
    """Parse one record with mcap; None for an opcode of an application. Raises Damage."""
    whole = cast(IO[bytes], _Whole(stream, place.offset, place.end))
    try:
        return next(StreamReader(whole, skip_magic=True, emit_chunks=True, record_size_limit=LIMIT).records)
    except EndOfFile:
        if place.opcode >= PRIVATE:  # mcap skips the record
            return None
        raise Damage("a record ends in the middle of a field", place.offset) from None
    except (McapError, struct.error, UnicodeDecodeError, StopIteration):
        raise Damage("a record cannot be parsed", place.offset) from None


def attachment_at(stream: IO[bytes], place: RecordPlace) -> Any:
    """Parse an attachment and compare its checksum, which mcap does not do. Raises Damage."""
    if place.opcode != Opcode.ATTACHMENT:
        raise Damage("the index of attachments points to another record", place.offset)
    record = record_at(stream, place)
    crc = int.from_bytes(read_bytes(stream, place.end - 4, 4), "little")
    if crc and checksum(stream, place.offset + HEAD.size, place.end - 4) != crc:
        raise Damage(f"the attachment {record.name} does not fit its checksum", place.offset)
    return record


def chunk_at(stream: IO[bytes], place: RecordPlace) -> tuple[ChunkPlace, int]:
    """Describe a chunk without its content; also return its checksum. Raises Damage.

    mcap would copy the content: packed and unpacked, a chunk of 200 MB would take 400 to 600 MB.
    """
    if place.opcode != Opcode.CHUNK:
        raise Damage("the index of chunks points to another record", place.offset)
    head = _Whole(stream, place.offset, place.end)
    try:
        _, _, first, last, unpacked, crc, length = CHUNK_HEAD.unpack(head.read(CHUNK_HEAD.size))
        compression = head.read(length).decode()
        packed = int.from_bytes(head.read(8), "little")
    except (EndOfFile, UnicodeDecodeError):
        raise Damage("a chunk ends in the middle of a field", place.offset) from None
    if CHUNK_HEAD.size + length + 8 + packed != place.end - place.offset:
        raise Damage("a chunk has lengths that do not agree", place.offset)
    return ChunkPlace(*place, first, last, unpacked, compression, packed), crc


def unpack(stream: IO[bytes], chunk: ChunkPlace, crc: int) -> bytes:
    """Unpack a chunk out of the file, without a second copy in memory. Raises Damage."""
    if chunk.unpacked > LIMIT:
        reason = f"a chunk claims {chunk.unpacked} unpacked bytes, more than the limit of {LIMIT}"
        raise Damage(reason, chunk.offset)
    packed = cast(IO[bytes], _Bounded(stream, chunk.end - chunk.packed, chunk.end))
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(packed).read(chunk.unpacked + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.open(packed).read(chunk.unpacked + 1)
        elif chunk.compression == "":
            data = packed.read(chunk.packed)
        else:
            raise Damage(f"a chunk has the unknown compression {chunk.compression[:16]!r}", chunk.offset)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise Damage("a chunk cannot be unpacked", chunk.offset) from error
    if len(data) != chunk.unpacked:
        raise Damage(f"a chunk does not unpack to the {chunk.unpacked} bytes that it announces", chunk.offset)
    if crc and zlib.crc32(data) != crc:
        raise Damage("a chunk does not fit its checksum", chunk.offset)
    return data
