"""The one walk over the records of an MCAP file [MCAP]; mcap's StreamReader parses each record.

A record is an opcode (one byte), a length (eight bytes) and its content. No function here reads a content before the
length is compared with the end of the file and with the limit.
"""

from __future__ import annotations

import bisect
import os
import stat
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from kr270_milling.base.errors import RecordingError

__all__ = ["HEAD", "LIMIT", "MAGIC", "NO_RECORD", "Damage", "RecordPlace", "Section", "attachment_at", "checksum",
           "mcap_file", "open_to_read", "parsed", "read_bytes", "record_at", "walk"]  # fmt: skip

MB = 1024 * 1024
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode and length of a record
LIMIT = 256 * MB  # of a record, and of an unpacked chunk
NO_RECORD = 0  # an opcode that does not exist: zeros follow the last record after a power failure
NAMED = 8  # recordings that an error message names
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


class Section:
    """The bytes between two offsets as a stream: a damaged length cannot read beyond the end."""

    def __init__(self, stream: IO[bytes], begin: int, end: int):
        self._stream = stream
        self._left = end - begin
        stream.seek(begin)

    def read(self, size: int = -1) -> bytes:
        data = self._stream.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(data)
        return data


class _WholeFields(Section):
    def read(self, size: int = -1) -> bytes:
        """Read exactly ``size`` bytes, as mcap expects."""
        data = super().read(size)
        if len(data) < size:
            raise McapError("a record ends in the middle of a field")
        return data


def mcap_file(path) -> Path:
    """Return the MCAP file itself, or the MCAP file in the directory of a recording. Raises RecordingError."""
    path = Path(path)
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if len(files) == 1:
        return files[0]
    several = [str(file) for file in files] or sorted({str(file.parent) for file in path.glob("*/*.mcap")})
    if several:
        more = f" and {len(several) - NAMED} more" if len(several) > NAMED else ""
        reason = f"is no recording; name one of those in it: {', '.join(several[:NAMED])}{more}"
        raise RecordingError(path, reason)
    raise RecordingError(path, "holds no recording (.mcap)")


def open_to_read(path: Path) -> IO[bytes]:
    """Open a regular file. Raises RecordingError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a pipe must not block
    except (OSError, ValueError) as error:
        raise RecordingError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise RecordingError(path, "is not a file")
    return os.fdopen(file, "rb")


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


def walk(stream: IO[bytes], begin: int, end: int, known: Sequence[int] = ()) -> Iterator[RecordPlace]:
    """Yield the place of each record between two offsets, up to the end of the data section.

    known: offsets of some records, ascending. A length that leads beyond the next of them is damaged. Bytes that are no
    whole record of at most 256 MB have the opcode NO_RECORD; they end at the next known offset, or at ``end``.
    """
    while begin < end:
        following = bisect.bisect_right(known, begin)
        after = known[following] if following < len(known) else end
        whole = begin + HEAD.size <= after
        opcode, length = HEAD.unpack(read_bytes(stream, begin, HEAD.size)) if whole else (NO_RECORD, 0)
        place = RecordPlace(opcode, begin, begin + HEAD.size + length)
        if opcode == NO_RECORD or length > LIMIT or place.end > after:
            place = RecordPlace(NO_RECORD, begin, after)
        yield place
        if opcode == Opcode.DATA_END and place.opcode == opcode:
            return
        begin = place.end


def parsed(stream: IO[bytes], begin: int, end: int) -> Iterator[Any]:
    """Parse the records between two offsets by mcap, up to a footer. Raises Damage."""
    section = cast(IO[bytes], _WholeFields(stream, begin, end))
    try:
        yield from StreamReader(section, skip_magic=True, emit_chunks=True, record_size_limit=LIMIT).records
    except (McapError, struct.error, UnicodeDecodeError):
        raise Damage("a record cannot be parsed", begin) from None


def record_at(stream: IO[bytes], place: RecordPlace) -> Any:
    """Parse one record; return None for a record of an application. Raises Damage."""
    if place.opcode >= PRIVATE:
        return None
    record = next(parsed(stream, place.offset, place.end), None)
    if record is None:
        raise Damage("a record has an unknown opcode", place.offset)
    return record


def attachment_at(stream: IO[bytes], place: RecordPlace) -> Any:
    """Parse an attachment and compare its checksum, which mcap does not do. Raises Damage."""
    record = record_at(stream, place)
    crc = int.from_bytes(read_bytes(stream, place.end - 4, 4), "little")
    if crc and checksum(stream, place.offset + HEAD.size, place.end - 4) != crc:
        raise Damage(f"the attachment {record.name} does not fit its checksum", place.offset)
    return record
