"""The records of an MCAP file, read without trusting any number in it [MCAP].

A record is one byte of type, eight bytes of length and its content. Every length is held against the file and a
limit before anything of that size is read.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["MAGIC", "Attachment", "Chunk", "ChannelInfo", "Damage", "Part", "SchemaInfo", "parts", "records"]

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, STATISTICS, METADATA, DATA_END = (
    1, 2, 3, 4, 5, 6, 7, 9, 0x0B, 0x0C, 0x0F)  # fmt: skip
HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
CHUNK_HEAD = struct.Struct("<QQQII")
LIMIT = 256 * 1024 * 1024  # [bytes] of one record or one unpacked chunk
RUN = 1024 * 1024  # [bytes]; messages outside of chunks are taken together up to this size
CHUNK_MARK = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")


class Damage(ValueError):
    """Something in the file that cannot be; offset: where."""

    def __init__(self, reason: str, offset: int):
        self.reason, self.offset = reason, offset
        super().__init__(reason)


class Part(NamedTuple):
    """One record of the file's top level, or a run of messages (type MESSAGE) without a chunk around them."""

    type: int
    offset: int  # of the record
    start: int  # of its content
    size: int  # of its content


@dataclass(frozen=True)
class Chunk:
    """Where messages are: a chunk, or a run of messages outside of chunks (compression "run")."""

    offset: int
    first_time: int  # [ns], smallest and largest log time
    last_time: int
    unpacked: int  # [bytes]
    crc: int
    compression: str
    start: int  # of the packed bytes
    size: int


@dataclass(frozen=True)
class SchemaInfo:
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class ChannelInfo:
    topic: str
    schema_id: int
    encoding: str
    metadata: dict[str, str]


@dataclass(frozen=True)
class Attachment:
    """What is attached: name, kind and where its bytes are."""

    name: str
    media_type: str
    log_time: int
    create_time: int
    offset: int  # of the record's content
    start: int  # of the attached bytes
    size: int


class Fields:
    """The fields of one record one after the other."""

    def __init__(self, data: bytes, offset: int):
        self.data, self.at, self.offset = data, 0, offset

    def take(self, size: int) -> bytes:
        start, self.at = self.at, self.at + size
        if self.at > len(self.data):
            raise Damage("a record ends in the middle of a field", self.offset)
        return self.data[start : self.at]

    def unpack(self, code: str) -> tuple:
        return struct.unpack("<" + code, self.take(struct.calcsize("<" + code)))

    def text(self) -> str:
        try:
            return self.take(self.unpack("I")[0]).decode()
        except UnicodeDecodeError:
            raise Damage("a name is not UTF-8 text", self.offset) from None

    def mapping(self) -> dict[str, str]:
        end = self.unpack("I")[0] + self.at
        found = {}
        while self.at < end:
            key = self.text()
            found[key] = self.text()
        return found


def parts(stream, begin: int, end: int) -> Iterator[Part]:
    """The whole records between two offsets of a file; stops before the first one that is not all there.

    Messages outside of chunks come in runs of up to 1 MB. A record type 0, as zeros behind a power failure have it,
    ends the file too.
    """
    run = None
    while begin + HEAD.size <= end:
        stream.seek(begin)
        kind, size = HEAD.unpack(_exactly(stream, HEAD.size, begin))
        start = begin + HEAD.size
        if kind == 0 or start + size > end:
            break
        if run and (kind != MESSAGE or begin + size - run > RUN):
            yield Part(MESSAGE, run, run, begin - run)
            run = None
        if kind != MESSAGE:
            yield Part(kind, begin, start, size)
        elif run is None:
            run = begin
        begin = start + size
    if run:
        yield Part(MESSAGE, run, run, begin - run)


def _exactly(stream, size: int, offset: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise Damage("the file became shorter while it was read", offset)
    return data


def content(stream, part: Part) -> Fields:
    """The fields of a record that is small by nature or by the limit."""
    if part.size > LIMIT:
        raise Damage(f"a record claims {part.size} bytes, more than the limit of {LIMIT}", part.offset)
    stream.seek(part.start)
    return Fields(_exactly(stream, part.size, part.offset), part.offset)


def chunk(stream, part: Part) -> Chunk:
    """What a chunk says of itself, without reading its messages."""
    if part.type == MESSAGE:
        data = content(stream, part).data
        times = [MESSAGE_HEAD.unpack_from(data, at)[2] for kind, at, _ in records(data, part.offset) if kind == MESSAGE]
        return Chunk(part.offset, min(times), max(times), part.size, 0, "run", part.start, part.size)
    stream.seek(part.start)
    fields = Fields(_exactly(stream, min(part.size, 128), part.offset), part.offset)
    first, last, unpacked, crc, length = fields.unpack("QQQII")
    if length > 16:
        raise Damage("a chunk names no known compression", part.offset)
    name = fields.take(length).decode("ascii", "replace")
    (size,) = fields.unpack("Q")
    if fields.at + size != part.size or max(size, unpacked) > LIMIT:
        reason = f"a chunk of {part.size} bytes claims {size} bytes that unpack to {unpacked} (limit {LIMIT})"
        raise Damage(reason, part.offset)
    return Chunk(part.offset, first, last, unpacked, crc, name, part.start + fields.at, size)


def records(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Type, begin and size of the content of every record in a chunk's bytes; ``offset``: of the chunk."""
    at, end = 0, len(data)
    while at < end:
        if at + HEAD.size > end:
            raise Damage("a chunk ends in the middle of a record", offset)
        kind, size = HEAD.unpack_from(data, at)
        at += HEAD.size
        if at + size > end or (kind == MESSAGE and size < MESSAGE_HEAD.size):
            raise Damage("a record in a chunk has an impossible length", offset)
        yield kind, at, size
        at += size


def schema(fields: Fields) -> tuple[int, SchemaInfo]:
    (number,) = fields.unpack("H")
    return number, SchemaInfo(fields.text(), fields.text(), fields.take(fields.unpack("I")[0]))


def channel(fields: Fields) -> tuple[int, ChannelInfo]:
    number, schema_id = fields.unpack("HH")
    return number, ChannelInfo(fields.text(), schema_id, fields.text(), fields.mapping())


def attachment(stream, part: Part) -> Attachment:
    stream.seek(part.start)
    fields = Fields(_exactly(stream, min(part.size, 65536), part.offset), part.offset)
    log_time, create_time = fields.unpack("QQ")
    name, media_type = fields.text(), fields.text()
    (size,) = fields.unpack("Q")
    if fields.at + size + 4 != part.size:
        raise Damage("an attachment has an impossible length", part.offset)
    return Attachment(name, media_type, log_time, create_time, part.start, part.start + fields.at, size)


def attached(stream, about: Attachment) -> bytes:
    """The bytes of an attachment, held against their checksum."""
    if about.size > LIMIT:
        raise Damage(f"an attachment claims {about.size} bytes, more than the limit of {LIMIT}", about.offset)
    stream.seek(about.offset)
    data = _exactly(stream, about.start + about.size + 4 - about.offset, about.offset)
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
            if head < 0 or match.end() + 8 > len(data) or data[head] != CHUNK:
                continue
            (size,) = struct.unpack_from("<Q", data, head + 1)
            (packed,) = struct.unpack_from("<Q", data, match.end())
            if size == match.end() - head - HEAD.size + 8 + packed and at + head + HEAD.size + size <= end:
                return at + head
        if not data or at + len(data) >= end:
            return None
        at += len(data) - 64  # a mark may lie across the border
    return None
