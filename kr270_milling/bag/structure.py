"""The records of an MCAP file, found without trusting any number in it [MCAP].

A record is one byte of type, eight bytes of length and its content. Every length is held against the file and a
limit before anything of that size is read; the content is then read by mcap's own record classes.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import NamedTuple

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

__all__ = [
    "LIMIT", "MAGIC", "Attachment", "Chunk", "Damage", "Part", "attached", "attachment", "checksum", "chunk", "content",
    "exactly", "inner", "next_chunk", "parsed", "parts",
]  # fmt: skip

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, unpacked bytes, checksum, length of the packing's name
LIMIT = 256 * 1024 * 1024  # [bytes] of one attachment or one unpacked chunk
SMALL = 32 * 1024 * 1024  # [bytes] of any other record
RUN = 1024 * 1024  # [bytes]; messages outside of chunks are taken together up to this size
CHUNK_MARK = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
READERS = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
    Opcode.CHUNK_INDEX: records.ChunkIndex.read,
    Opcode.DATA_END: records.DataEnd.read,
    Opcode.FOOTER: records.Footer.read,
}


class Damage(ValueError):
    """Something in the file that cannot be; offset: where."""

    def __init__(self, reason: str, offset: int):
        self.reason = reason
        self.offset = offset
        super().__init__(reason)


class Part(NamedTuple):
    """One record of the file's top level, or a run of messages (type MESSAGE) without a chunk around them."""

    type: int
    offset: int  # of the record
    start: int  # of its content
    size: int  # of its content

    @property
    def end(self) -> int:
        return self.start + self.size


class Chunk(NamedTuple):
    """Where messages are: a chunk, or a run of messages outside of chunks (compression "run")."""

    offset: int
    first_time: int  # [ns], smallest and largest log time
    last_time: int
    unpacked: int  # [bytes]
    crc: int
    compression: str
    start: int  # of the packed bytes
    size: int


class Attachment(NamedTuple):
    """What is attached: name, kind and where its bytes are."""

    name: str
    media_type: str
    offset: int  # of the record's content
    start: int  # of the attached bytes
    size: int


class Fields(ReadDataStream):
    """mcap's reader of fields, which refuses to run over the end of the record."""

    def __init__(self, data: bytes, offset: int):
        super().__init__(BytesIO(data))
        self.offset = offset

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise Damage("a record ends in the middle of a field", self.offset)
        return data


def parts(stream, begin: int, end: int) -> Iterator[Part]:
    """The whole records between two offsets of a file; stops before the first one that is not all there.

    Messages outside of chunks come in runs of up to 1 MB. A record type 0, as zeros behind a power failure have it,
    ends the file too.
    """
    run = None
    while begin + HEAD.size <= end:
        stream.seek(begin)
        kind, size = HEAD.unpack(exactly(stream, HEAD.size, begin))
        start = begin + HEAD.size
        if kind == 0 or start + size > end:
            break
        if run is not None and (kind != Opcode.MESSAGE or start + size - run > RUN):
            yield Part(Opcode.MESSAGE, run, run, begin - run)
            run = None
        if kind != Opcode.MESSAGE:
            yield Part(kind, begin, start, size)
        elif run is None:
            run = begin
        begin = start + size
    if run is not None:
        yield Part(Opcode.MESSAGE, run, run, begin - run)


def exactly(stream, size: int, offset: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise Damage("the file became shorter while it was read", offset)
    return data


def checksum(stream, end: int) -> int:
    """Of everything before an offset, as the end of the data states it."""
    crc, left = 0, end
    stream.seek(0)
    while left and (data := stream.read(min(left, RUN))):
        crc, left = zlib.crc32(data, crc), left - len(data)
    return crc


def content(stream, part: Part, limit: int = SMALL) -> bytes:
    """The bytes of a record that is small by nature or by the limit."""
    if part.size > limit:
        raise Damage(f"a record claims {part.size} bytes, more than the limit of {limit}", part.offset)
    stream.seek(part.start)
    return exactly(stream, part.size, part.offset)


def parsed(kind: int, data: bytes, offset: int):
    """The content of a record of one of the READERS as mcap's record; offset: where it stands."""
    try:
        return READERS[kind](Fields(data, offset))
    except (EndOfFile, struct.error):
        raise Damage("a record ends in the middle of a field", offset) from None
    except UnicodeDecodeError:
        raise Damage("a name is not UTF-8 text", offset) from None


def inner(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Type, begin and size of the content of every record in a chunk's bytes; ``offset``: of the chunk."""
    at, end = 0, len(data)
    while at < end:
        if at + HEAD.size > end:
            raise Damage("a chunk ends in the middle of a record", offset)
        kind, size = HEAD.unpack_from(data, at)
        at += HEAD.size
        if at + size > end or (kind == Opcode.MESSAGE and size < MESSAGE_HEAD.size):
            raise Damage("a record in a chunk has an impossible length", offset)
        yield kind, at, size
        at += size


def chunk(stream, part: Part) -> Chunk:
    """What a chunk says of itself, without reading its messages."""
    if part.type == Opcode.MESSAGE:
        data = content(stream, part, LIMIT)
        times = [MESSAGE_HEAD.unpack_from(data, at)[2] for _, at, _ in inner(data, part.offset)]
        return Chunk(part.offset, min(times), max(times), part.size, 0, "run", part.start, part.size)
    stream.seek(part.start)
    head = exactly(stream, min(part.size, 128), part.offset)
    fields = Fields(head, part.offset)
    try:
        first, last, unpacked, crc, length = CHUNK_HEAD.unpack(fields.read(CHUNK_HEAD.size))
        name = fields.read(min(length, 17)).decode("ascii", "replace")
        size = fields.read8()
    except EndOfFile:
        raise Damage("a chunk ends in its head", part.offset) from None
    if length > 16:
        raise Damage("a chunk names no known compression", part.offset)
    if fields.count + size != part.size or max(size, unpacked) > LIMIT:
        reason = f"a chunk of {part.size} bytes claims {size} bytes that unpack to {unpacked} (limit {LIMIT})"
        raise Damage(reason, part.offset)
    return Chunk(part.offset, first, last, unpacked, crc, name, part.start + fields.count, size)


def attachment(stream, part: Part) -> Attachment:
    stream.seek(part.start)
    fields = Fields(exactly(stream, min(part.size, 65536), part.offset), part.offset)
    try:
        fields.read(16)  # log time, time of creation
        name, media_type = fields.read_prefixed_string(), fields.read_prefixed_string()
        size = fields.read8()
    except (EndOfFile, UnicodeDecodeError):
        raise Damage("an attachment has no name that can be read", part.offset) from None
    if fields.count + size + 4 != part.size:
        raise Damage("an attachment has an impossible length", part.offset)
    return Attachment(name, media_type, part.start, part.start + fields.count, size)


def attached(stream, about: Attachment) -> bytes:
    """The bytes of an attachment, held against their checksum."""
    if about.size > LIMIT:
        raise Damage(f"an attachment claims {about.size} bytes, more than the limit of {LIMIT}", about.offset)
    stream.seek(about.offset)
    data = exactly(stream, about.start + about.size + 4 - about.offset, about.offset)
    (crc,) = struct.unpack("<I", data[-4:])
    if crc and zlib.crc32(data[:-4]) != crc:
        raise Damage(f"the attachment {about.name} does not fit its checksum", about.offset)
    return data[about.start - about.offset : -4]


def next_chunk(stream, begin: int, end: int) -> int | None:
    """Where the next packed chunk begins behind a damaged place: its two lengths must agree."""
    at, window = begin, 4 * RUN
    while at < end:
        stream.seek(at)
        data = stream.read(min(window, end - at))
        for match in CHUNK_MARK.finditer(data):
            head = match.start() - HEAD.size - CHUNK_HEAD.size + 4
            if head < 0 or match.end() + 8 > len(data) or data[head] != Opcode.CHUNK:
                continue
            (size,) = struct.unpack_from("<Q", data, head + 1)
            (packed,) = struct.unpack_from("<Q", data, match.end())
            if size == match.end() - head - HEAD.size + 8 + packed and at + head + HEAD.size + size <= end:
                return at + head
        if not data or at + len(data) >= end:
            return None
        at += len(data) - 64  # a mark may lie across the border
    return None
