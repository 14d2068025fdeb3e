"""The records of an MCAP file, found without trusting any number in it [MCAP].

A record is one byte of type, eight bytes of length and its content. Every length is held against the file and a
limit before anything of that size is read; the content is then read by mcap's StreamReader.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader

__all__ = [
    "LIMIT", "MAGIC", "Attachment", "Chunk", "Damage", "Part", "attached", "attachment", "checksum", "chunk", "content",
    "exactly", "inner", "next_chunk", "parsed", "parts",
]  # fmt: skip

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<BQHIQQ")  # type and length; channel, sequence, log time, publish time
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, unpacked bytes, checksum, length of the packing's name
LIMIT = 256 * 1024 * 1024  # [bytes] of one attachment or one unpacked chunk
SMALL = 32 * 1024 * 1024  # [bytes] of any other record
RUN = 1024 * 1024  # [bytes]; messages outside of chunks are taken together up to this size
CHUNK_MARK = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
BROKEN = (McapError, struct.error, UnicodeDecodeError)  # what mcap raises at a record that makes no sense


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
    """What is attached: name, kind, how many bytes, and where they begin in the record's content."""

    name: str
    media_type: str
    size: int
    part: Part
    begin: int


class Strict(BytesIO):
    """Bytes that mcap cannot read over the end of."""

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if len(data) != size:
            raise EndOfFile
        return data


def parts(stream, begin: int, end: int) -> Iterator[Part]:
    """The whole records between two offsets of a file; stops before the first one that is not all there.

    Messages outside of chunks come in runs of up to 1 MB. A record type 0, as zeros behind a power failure have it,
    ends the file too.
    """
    run = None
    while begin + HEAD.size <= end:
        kind, size = HEAD.unpack(exactly(stream, begin, HEAD.size))
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


def exactly(stream, begin: int, size: int) -> bytes:
    """The bytes of a file from an offset on."""
    stream.seek(begin)
    data = stream.read(size)
    if len(data) != size:
        raise Damage("the file became shorter while it was read", begin)
    return data


def checksum(stream, end: int) -> int:
    """Of everything before an offset, as the end of the data states it."""
    crc = 0
    for begin in range(0, end, RUN):
        crc = zlib.crc32(exactly(stream, begin, min(RUN, end - begin)), crc)
    return crc


def content(stream, part: Part, limit: int = SMALL) -> bytes:
    """The bytes of a record that is small by nature or by the limit."""
    if part.size > limit:
        raise Damage(f"a record claims {part.size} bytes, more than the limit of {limit}", part.offset)
    return exactly(stream, part.start, part.size)


def parsed(kind: int, data: bytes, offset: int):
    """The content of a record as mcap's record; offset: where it stands."""
    stream = Strict(HEAD.pack(kind, len(data)) + data)
    try:
        return next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
    except BROKEN:
        raise Damage("a record ends in the middle of a field or has a name that is not UTF-8 text", offset) from None


def inner(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Type, begin and size of the content of every record in a chunk's bytes; ``offset``: of the chunk."""
    at, end = 0, len(data)
    while at < end:
        if at + HEAD.size > end:
            raise Damage("a chunk ends in the middle of a record", offset)
        kind, size = HEAD.unpack_from(data, at)
        at += HEAD.size
        if at + size > end or (kind == Opcode.MESSAGE and size < MESSAGE.size - HEAD.size):
            raise Damage("a record in a chunk has an impossible length", offset)
        yield kind, at, size
        at += size


def chunk(stream, part: Part) -> Chunk:
    """What a chunk says of itself, without reading its messages."""
    if part.type == Opcode.MESSAGE:
        data = content(stream, part, LIMIT)
        times = [MESSAGE.unpack_from(data, at - HEAD.size)[4] for _, at, _ in inner(data, part.offset)]
        return Chunk(part.offset, min(times), max(times), part.size, 0, "run", part.start, part.size)
    head = exactly(stream, part.start, min(part.size, 128))
    try:
        first, last, unpacked, crc, length = CHUNK_HEAD.unpack_from(head)
        begin = CHUNK_HEAD.size + length + 8
        (size,) = struct.unpack_from("<Q", head, begin - 8)
    except struct.error:
        raise Damage("a chunk ends in its head", part.offset) from None
    if begin + size != part.size or max(size, unpacked) > LIMIT:
        reason = f"a chunk of {part.size} bytes claims {size} bytes that unpack to {unpacked} (limit {LIMIT})"
        raise Damage(reason, part.offset)
    name = head[CHUNK_HEAD.size : begin - 8].decode("ascii", "replace")
    return Chunk(part.offset, first, last, unpacked, crc, name, part.start + begin, size)


def attachment(stream, part: Part) -> Attachment:
    """What is attached, without reading it."""
    fields = ReadDataStream(Strict(exactly(stream, part.start, min(part.size, 65536))))
    try:
        fields.read(16)  # log time, time of creation
        name, kind, size = fields.read_prefixed_string(), fields.read_prefixed_string(), fields.read8()
    except BROKEN:
        raise Damage("an attachment has no name that can be read", part.offset) from None
    if fields.count + size + 4 != part.size:
        raise Damage("an attachment has an impossible length", part.offset)
    return Attachment(name, kind, size, part, fields.count)


def attached(stream, about: Attachment) -> bytes:
    """The bytes of an attachment, held against their checksum."""
    data = content(stream, about.part, LIMIT)
    if any(data[-4:]) and zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise Damage(f"the attachment {about.name} does not fit its checksum", about.part.offset)
    return data[about.begin : -4]


def next_chunk(stream, begin: int, end: int) -> int:
    """Where the next packed chunk begins behind a damaged place, or the end: its two lengths must agree."""
    for at in range(begin, end, 4 * RUN - 64):  # a mark may lie across the border
        data = exactly(stream, at, min(4 * RUN, end - at))
        for match in CHUNK_MARK.finditer(data):
            head = match.start() - HEAD.size - CHUNK_HEAD.size + 4
            if head < 0 or match.end() + 8 > len(data) or data[head] != Opcode.CHUNK:
                continue
            (size,) = struct.unpack_from("<Q", data, head + 1)
            (packed,) = struct.unpack_from("<Q", data, match.end())
            if size == match.end() - head - HEAD.size + 8 + packed and at + head + HEAD.size + size <= end:
                return at + head
    return end
