"""The MCAP file of a recording and its records, found without trusting any number in it [MCAP].

A record is one byte of type, eight bytes of length and its content. Every length is held against the file and a
limit before anything of that size is read; the content is then read by mcap's StreamReader.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

from kr270_milling.base.errors import RecordingError

__all__ = [
    "FOOTER_SIZE", "HEAD", "LIMIT", "MAGIC", "MESSAGE", "SMALL", "Damage", "Part", "checksum", "exactly", "footer",
    "inner", "mcap_file", "next_chunk", "open_to_read", "parts",
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
CHUNK_MARK = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")


class Damage(ValueError):
    """Something in the file that cannot be; offset: where."""

    def __init__(self, reason: str, offset: int):
        self.reason = reason
        self.offset = offset
        super().__init__(reason)


class Strict(BytesIO):
    """Bytes that mcap cannot read over the end of."""

    def read(self, size: int | None = -1, /) -> bytes:
        size = len(self.getbuffer()) - self.tell() if size is None or size < 0 else size
        data = super().read(min(size, 2**31))  # Python itself takes no size beyond 2^63
        if len(data) != size:
            raise EndOfFile
        return data


class Part(NamedTuple):
    """One record of the file's top level, or a run of messages (type MESSAGE) without a chunk around them."""

    type: int
    offset: int
    data: bytes  # all of it

    @property
    def end(self) -> int:
        return self.offset + len(self.data)

    def record(self):
        """As mcap's record. Raises Damage."""
        try:
            record = next(StreamReader(Strict(self.data), skip_magic=True, emit_chunks=True).records)
        except (McapError, struct.error, UnicodeDecodeError):
            reason = "a record ends in the middle of a field or has a name that is not UTF-8 text"
            raise Damage(reason, self.offset) from None
        if self.type in LARGE:
            record.write(builder := RecordBuilder())
            if builder.count != len(self.data):
                raise Damage("a record has lengths that do not agree", self.offset)
        return record

    def attached(self):
        """mcap's Attachment, held against its checksum. Raises Damage."""
        record, crc = self.record(), int.from_bytes(self.data[-4:], "little")
        if crc and zlib.crc32(self.data[HEAD.size : -4]) != crc:
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
        yield Part(kind, begin, exactly(stream, begin, behind - begin))
        begin = behind


def footer(stream, size: int) -> Part | None:
    """The last record of a file of that size; None: it does not end as a writer ends it."""
    at = size - FOOTER_SIZE
    end = exactly(stream, at, FOOTER_SIZE) if at >= len(MAGIC) else b""
    whole = end.startswith(HEAD.pack(Opcode.FOOTER, 20)) and end.endswith(MAGIC)
    return Part(Opcode.FOOTER, at, end[: -len(MAGIC)]) if whole else None


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
