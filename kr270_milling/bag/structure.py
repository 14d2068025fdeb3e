"""The MCAP file of a recording and its records, found without trusting any number in it [MCAP].

A record is one byte of type, eight bytes of length and its content. Every length is held against the file and a
limit before anything of that size is read; the content is then read by mcap's StreamReader. That of a chunk is not
(packing.py), as mcap copies it.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, NamedTuple, cast

from mcap.data_stream import RecordBuilder
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Schema
from mcap.stream_reader import StreamReader

from kr270_milling.base.errors import RecordingError

__all__ = [
    "FOOTER_SIZE", "HEAD", "LIMIT", "MAGIC", "MESSAGE", "ODD", "SMALL", "UNEVEN", "Damage", "Part", "checksum",
    "exactly", "footer", "inner", "mcap_file", "next_chunk", "open_to_read", "parts", "record_of",
]  # fmt: skip

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
FOOTER_SIZE = HEAD.size + 20 + len(MAGIC)  # with the magic behind it
MESSAGE = struct.Struct("<BQHIQQ")  # type and length; channel, sequence, log time, publish time
LIMIT = 256 * 1024 * 1024  # [bytes] of one attachment, one message or one chunk, packed and unpacked
SMALL = 32 * 1024 * 1024  # [bytes] of any other record
LARGE = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.MESSAGE)
RUN = 1024 * 1024  # [bytes]; messages outside of chunks are taken together up to this size
BEFORE_NAME = 9 + 8 + 8 + 8 + 4  # [bytes] of a chunk before the name of its compression
ODD = "a record ends in the middle of a field or has a name that is not UTF-8 text"
UNEVEN = "a record has lengths that do not agree"
CHUNK_MARK = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")


class Damage(ValueError):
    """Something in the file that cannot be; offset: where."""

    def __init__(self, reason: str, offset: int):
        self.reason = reason
        self.offset = offset
        super().__init__(reason)


class Strict:
    """Bytes that mcap cannot read over the end of; what it reads is no copy of them."""

    def __init__(self, data: bytes):
        self._view, self._at = memoryview(data), 0

    def read(self, size: int) -> memoryview:
        begin, self._at = self._at, self._at + size
        if self._at > len(self._view):
            raise EndOfFile
        return self._view[begin : self._at]


def record_of(data: bytes, offset: int):
    """A record but a chunk as mcap's; the data of an Attachment are a view of its bytes. Raises Damage."""
    try:
        record = next(StreamReader(cast(IO[bytes], Strict(data)), skip_magic=True).records)
    except (McapError, struct.error, UnicodeDecodeError):
        raise Damage(ODD, offset) from None
    if isinstance(record, Schema):
        record.data = bytes(record.data)
    if isinstance(record, Attachment):
        replace(record, data=b"").write(builder := RecordBuilder())
        if builder.count + len(record.data) != len(data):
            raise Damage(UNEVEN, offset)
    return record


class Part(NamedTuple):
    """One record of the file's top level, or a run of messages (type MESSAGE) without a chunk around them."""

    type: int
    offset: int
    size: int  # [bytes] of all of it
    stream: IO[bytes]

    @property
    def end(self) -> int:
        return self.offset + self.size

    def data(self) -> bytes:
        """All of it, out of the file. Raises Damage."""
        return exactly(self.stream, self.offset, self.size)

    def record(self):
        """As mcap's record. Raises Damage."""
        return record_of(self.data(), self.offset)

    def attached(self) -> Attachment:
        """As mcap's record, held against its checksum. Raises Damage."""
        data = self.data()
        record, crc = record_of(data, self.offset), int.from_bytes(data[-4:], "little")
        if crc and zlib.crc32(memoryview(data)[HEAD.size : -4]) != crc:
            raise Damage(f"the attachment {record.name} does not fit its checksum", self.offset)
        return record


def mcap_file(path) -> Path:
    """The MCAP file itself, or the one in a recording's directory. Raises RecordingError."""
    path = Path(path)
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise RecordingError(path, f"holds {len(files)} MCAP files where a recording has one")
    return files[0]


def open_to_read(path: Path):
    """A regular file, opened to be read. Raises RecordingError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not make us wait
    except (OSError, ValueError) as error:
        raise RecordingError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise RecordingError(path, "is not a file")
    return os.fdopen(file, "rb", buffering=65536)


def parts(stream, begin: int, end: int) -> Iterator[Part]:
    """The whole records between two offsets of a file; stops before the first one that is not all there.

    Messages outside of chunks come in runs of up to 1 MB. A record type 0, as zeros behind a power failure have it,
    ends the file too.
    """
    while begin + HEAD.size <= end:
        kind, size = HEAD.unpack(exactly(stream, begin, HEAD.size))
        behind = begin + HEAD.size + size
        if kind == 0 or behind > end:
            return
        if size > (limit := LIMIT if kind in LARGE else SMALL):
            raise Damage(f"a record claims {size} bytes, more than the limit of {limit}", begin)
        while kind == Opcode.MESSAGE and behind + HEAD.size <= end:
            following, size = HEAD.unpack(exactly(stream, behind, HEAD.size))
            if following != Opcode.MESSAGE or behind + HEAD.size + size > min(end, begin + RUN):
                break
            behind += HEAD.size + size
        yield Part(kind, begin, behind - begin, stream)
        begin = behind


def footer(stream, size: int) -> Part | None:
    """The last record of a file of that size; None: it does not end as a writer ends it."""
    at = size - FOOTER_SIZE
    end = exactly(stream, at, FOOTER_SIZE) if at >= len(MAGIC) else b""
    whole = end.startswith(HEAD.pack(Opcode.FOOTER, 20)) and end.endswith(MAGIC)
    return Part(Opcode.FOOTER, at, len(end) - len(MAGIC), stream) if whole else None


def exactly(stream, begin: int, size: int) -> bytes:
    """The bytes of a file from an offset on."""
    stream.seek(begin)
    data = stream.read(size)
    if len(data) != size:
        raise Damage("the file became shorter while it was read", begin)
    return data


def checksum(stream, begin: int, end: int) -> int:
    """CRC-32 of the bytes between two offsets."""
    crc = 0
    for at in range(begin, end, RUN):
        crc = zlib.crc32(exactly(stream, at, min(RUN, end - at)), crc)
    return crc


def inner(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Type, begin and end of every record in the bytes of a chunk or a run; ``offset``: of the chunk."""
    at, end = 0, len(data)
    while at < end:
        if at + HEAD.size > end:
            raise Damage("a chunk ends in the middle of a record", offset)
        kind, size = HEAD.unpack_from(data, at)
        behind = at + HEAD.size + size
        if behind > end or (kind == Opcode.MESSAGE and behind < at + MESSAGE.size):
            raise Damage("a record in a chunk has an impossible length", offset)
        yield kind, at, behind
        at = behind


def next_chunk(stream, begin: int, end: int) -> int:
    """Where the next packed chunk begins behind a damaged place, or the end: its two lengths must agree."""
    for at in range(begin, end, 4 * RUN - 64):  # a mark may lie across the border
        data = exactly(stream, at, min(4 * RUN, end - at))
        for match in CHUNK_MARK.finditer(data):
            head = match.start() - BEFORE_NAME
            if head < 0 or match.end() + 8 > len(data) or data[head] != Opcode.CHUNK:
                continue
            (size,) = struct.unpack_from("<Q", data, head + 1)
            (packed,) = struct.unpack_from("<Q", data, match.end())
            if size == match.end() - head - HEAD.size + 8 + packed and at + head + HEAD.size + size <= end:
                return at + head
    return end
