"""Chunks of a file, unpacked, and their messages in the order of the file.

mcap's ``Chunk`` and ``breakup_chunk`` copy every byte of a chunk three times. Here a chunk is unpacked out of the file,
and each message is copied when its turn comes.
"""

from __future__ import annotations

import io
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import IO, NamedTuple, cast

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from kr270_milling.recordings.bag.records import HEAD, LIMIT, Damage, RecordPlace, Section, read_bytes

__all__ = ["Chunk", "ChunkContent", "RawMessage", "chunk_at", "open_chunk"]

CHUNK_HEAD = struct.Struct("<BQQQQII")  # and first time, last time, size, checksum, length of the compression's name
MESSAGE = struct.Struct("<BQHIQQ")  # opcode and length; channel, sequence, log time, publish time


class RawMessage(NamedTuple):
    """One message as it was recorded."""

    topic: str
    log_time: int  #: [ns]
    publish_time: int  #: [ns]
    data: bytes
    channel: int = 0
    sequence: int = 0


class Chunk(NamedTuple):
    """A chunk as its first bytes describe it, or a run of messages outside of chunks."""

    offset: int
    end: int
    first_time: int  #: [ns], smallest and largest log time
    last_time: int
    unpacked: int  #: [bytes]
    compression: str
    packed_at: int  #: offset of the packed bytes, which reach to the end
    crc: int = 0


def chunk_at(stream: IO[bytes], place: RecordPlace) -> Chunk:
    """Describe a chunk without its content. Raises Damage."""
    try:
        head = read_bytes(stream, place.offset, min(CHUNK_HEAD.size, place.end - place.offset))
        _, _, first, last, unpacked, crc, length = CHUNK_HEAD.unpack(head)
        compression = read_bytes(stream, place.offset + CHUNK_HEAD.size, min(length, 32)).decode()
    except (struct.error, UnicodeDecodeError):
        raise Damage("a chunk cannot be parsed", place.offset) from None
    packed_at = place.offset + CHUNK_HEAD.size + length + 8
    packed = int.from_bytes(read_bytes(stream, packed_at - 8, 8), "little") if packed_at <= place.end else -1
    if packed_at + packed != place.end:
        raise Damage("a chunk has lengths that do not agree", place.offset)
    return Chunk(place.offset, place.end, first, last, unpacked, compression, packed_at, crc)


def _unpack(stream: IO[bytes], chunk: Chunk) -> bytes:
    """Unpack a chunk out of the file. Raises Damage."""
    if chunk.unpacked > LIMIT:
        reason = f"a chunk claims {chunk.unpacked} unpacked bytes, more than the limit of {LIMIT}"
        raise Damage(reason, chunk.offset)
    packed = cast(IO[bytes], Section(stream, chunk.packed_at, chunk.end))
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(packed).read(chunk.unpacked + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.open(packed).read(chunk.unpacked + 1)
        elif chunk.compression == "":
            data = packed.read()
        else:
            raise Damage(f"a chunk has the unknown compression {chunk.compression[:16]!r}", chunk.offset)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise Damage("a chunk cannot be unpacked", chunk.offset) from error
    if len(data) != chunk.unpacked:
        raise Damage(f"a chunk does not unpack to the {chunk.unpacked} bytes that it announces", chunk.offset)
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise Damage("a chunk does not fit its checksum", chunk.offset)
    return data


def open_chunk(stream: IO[bytes], chunk: Chunk) -> ChunkContent:
    """Unpack a chunk and list its messages. Raises Damage."""
    content = ChunkContent(_unpack(stream, chunk), chunk.offset)
    if len(content) and (content.first_time, content.last_time) != (chunk.first_time, chunk.last_time):
        raise Damage("a chunk has other log times than it states", chunk.offset)
    return content


class ChunkContent:
    """The unpacked bytes of a chunk, with a list of its messages and its definitions. Raises Damage."""

    def __init__(self, data: bytes, offset: int):
        self.data, self.offset = data, offset
        self.offsets, self.times, self.channels = array("I"), array("Q"), array("H")  #: of each message
        self.definitions: list[RecordPlace] = []  #: places of schemas and channels in the bytes
        try:
            at = self._list_records()
        except struct.error:
            raise Damage("a chunk ends in the middle of a record", offset) from None
        if at != len(data):
            raise Damage("a record in a chunk has an impossible length", offset)
        self.counts = Counter(self.channels)  #: channel -> messages
        self.first_time, self.last_time = min(self.times, default=0), max(self.times, default=0)  #: [ns]
        if self.last_time >= 2**63:
            raise Damage(f"a log time of {self.last_time} ns is after the year 2262", offset)

    def _list_records(self) -> int:
        at, size = 0, len(self.data)
        while at < size:
            opcode, length = HEAD.unpack_from(self.data, at)
            end = at + HEAD.size + length
            if opcode == Opcode.MESSAGE:
                _, _, channel, _, log_time, _ = MESSAGE.unpack_from(self.data, at)
                if end < at + MESSAGE.size:
                    raise Damage("a message in a chunk has an impossible length", self.offset)
                self.offsets.append(at)
                self.times.append(log_time)
                self.channels.append(channel)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.definitions.append(RecordPlace(opcode, at, end))
            at = end
        return at

    def __len__(self) -> int:
        return len(self.times)

    def stream(self) -> IO[bytes]:
        """The unpacked bytes as a stream, without a copy."""
        return io.BytesIO(self.data)

    def messages(self, topics: Mapping[int, str]) -> Iterator[RawMessage]:
        """The messages on some channels, in the order of the file; topics: channel -> topic."""
        for at, channel in zip(self.offsets, self.channels, strict=True):
            if channel in topics:
                _, length, _, sequence, log_time, publish_time = MESSAGE.unpack_from(self.data, at)
                data = self.data[at + MESSAGE.size : at + HEAD.size + length]
                yield RawMessage(topics[channel], log_time, publish_time, data, channel, sequence)
