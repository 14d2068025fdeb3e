"""Messages of unpacked chunks, in the order of the file or in the order of their log times.

mcap's ``breakup_chunk`` copies every message of a chunk at once: it needs twice the memory and more time.
The loops below keep an index of the messages and copy one message at a time.
"""

from __future__ import annotations

import heapq
import io
import struct
from array import array
from collections import Counter, OrderedDict
from collections.abc import Container, Iterator
from itertools import repeat
from typing import IO, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from kr270_milling.recordings.bag.records import HEAD, ChunkPlace, Damage, RecordPlace, chunk_at, read_bytes, unpack

__all__ = ["ChunkMessages", "ChunkReader", "RawMessage"]

CACHE = 32 * 1024 * 1024  # [bytes] of unpacked chunks that stay in memory
MESSAGE = struct.Struct("<BQHIQQ")  # opcode and length; channel, sequence, log time, publish time
HEAD_SIZE, MESSAGE_HEAD = HEAD.size, MESSAGE.size - HEAD.size  # [bytes] of opcode and length, of the other fields


class RawMessage(NamedTuple):
    """One message as it was recorded."""

    topic: str
    log_time: int  #: [ns]
    publish_time: int  #: [ns]
    data: bytes
    channel: int = 0
    sequence: int = 0
    place: tuple[int, int] = (0, 0)  #: offset of the chunk in the file, offset of the message in the unpacked chunk


class ChunkMessages:
    """The unpacked bytes of a chunk, with an index of its messages and its definitions."""

    def __init__(self, data: bytes, offset: int):
        self.data, self.offset = data, offset
        self.offsets, self.times, self.channels = array("I"), array("Q"), array("H")
        self.definitions: list[RecordPlace] = []  #: places of schemas and channels in the bytes
        try:
            self._index()
        except struct.error:
            raise Damage("a chunk ends in the middle of a record", offset) from None
        self.counts = Counter(self.channels)  #: channel -> messages
        self.first_time, self.last_time = min(self.times, default=0), max(self.times, default=0)  #: [ns]
        if self.last_time >= 2**63:
            raise Damage(f"a log time of {self.last_time} ns is after the year 2262", offset)

    def _index(self) -> None:
        data, at, size = self.data, 0, len(self.data)
        add_offset, add_time, add_channel = self.offsets.append, self.times.append, self.channels.append
        unpack_head, unpack_message, message = HEAD.unpack_from, MESSAGE.unpack_from, int(Opcode.MESSAGE)
        while at < size:
            opcode, length = unpack_head(data, at)
            end = at + HEAD_SIZE + length
            if opcode == message:
                _, _, channel, _, log_time, _ = unpack_message(data, at)
                if length < MESSAGE_HEAD:
                    raise Damage("a message in a chunk has an impossible length", self.offset)
                add_offset(at)
                add_time(log_time)
                add_channel(channel)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.definitions.append(RecordPlace(opcode, at, end))
            at = end
        if at != size:
            raise Damage("a record in a chunk has an impossible length", self.offset)

    def __len__(self) -> int:
        return len(self.times)

    def stream(self) -> IO[bytes]:
        """The unpacked bytes as a stream, without a copy."""
        return io.BytesIO(self.data)

    def message(self, index: int, topics: dict[int, str]) -> RawMessage:
        """The message with an index in the order of the file; topics: channel -> topic."""
        at = self.offsets[index]
        _, length, channel, sequence, log_time, publish_time = MESSAGE.unpack_from(self.data, at)
        data = self.data[at + MESSAGE.size : at + HEAD.size + length]
        return RawMessage(topics[channel], log_time, publish_time, data, channel, sequence, (self.offset, at))

    def messages(self, topics: dict[int, str]) -> Iterator[RawMessage]:
        """The messages on these channels, in the order of the file; every reader uses this loop."""
        data, chunk, unpack_message = self.data, self.offset, MESSAGE.unpack_from
        begin = MESSAGE.size
        for at, channel in zip(self.offsets, self.channels, strict=True):
            if channel in topics:
                _, length, _, sequence, log_time, publish_time = unpack_message(data, at)
                content = data[at + begin : at + HEAD_SIZE + length]
                yield RawMessage(topics[channel], log_time, publish_time, content, channel, sequence, (chunk, at))
                del content  # before the next message is copied

    def by_time(self, topics: dict[int, str]) -> tuple[np.ndarray, np.ndarray]:
        """Log times [ns] and indexes of the messages on these channels, ascending; equal times as in the file."""
        times, channels = np.frombuffer(self.times, np.uint64), np.frombuffer(self.channels, np.uint16)
        chosen = np.flatnonzero(np.isin(channels, list(topics))).astype(np.uint32)
        chosen = chosen[np.argsort(times[chosen], kind="stable")]
        return times[chosen], chosen


class ChunkReader:
    """Reads the chunks of a file and remembers the last ones, up to CACHE bytes."""

    def __init__(self, stream: IO[bytes], channels: Container[int]):
        self._stream, self._channels = stream, channels
        self._remembered: OrderedDict[int, ChunkMessages] = OrderedDict()

    def __call__(self, place: ChunkPlace) -> ChunkMessages:
        """The messages of a chunk. Raises Damage."""
        content = self._remembered.get(place.offset)
        if content is not None:
            self._remembered.move_to_end(place.offset)
            return content
        while self._remembered and self.used + place.unpacked > CACHE:
            self._remembered.popitem(last=False)
        content = self._remembered[place.offset] = self._read(place)
        return content

    @property
    def used(self) -> int:
        """[bytes] of chunks in memory."""
        return sum(len(content.data) for content in self._remembered.values())

    def _read(self, place: ChunkPlace) -> ChunkMessages:
        if place.opcode == Opcode.MESSAGE:
            return ChunkMessages(read_bytes(self._stream, place.offset, place.size), place.offset)
        described, crc = chunk_at(self._stream, RecordPlace(*place[:3]))
        if described != place:
            raise Damage("the index of chunks does not fit the chunk", place.offset)
        content = ChunkMessages(unpack(self._stream, place, crc), place.offset)
        if len(content) and (content.first_time, content.last_time) != (place.first_time, place.last_time):
            raise Damage("a chunk has other log times than it states", place.offset)
        return content

    def _defined(self, place: ChunkPlace) -> ChunkMessages:
        """The messages of a chunk, all on known channels. Raises Damage."""
        content = self(place)
        for channel in content.counts:
            if channel not in self._channels:
                raise Damage(f"a message belongs to channel {channel}, which is not defined", place.offset)
        return content

    def in_file_order(self, places: list[ChunkPlace], topics: dict[int, str]) -> Iterator[RawMessage]:
        """Messages of some chunks on some channels. Raises Damage."""
        for place in places:
            yield from self._defined(place).messages(topics)  # no name keeps a chunk while the next one is unpacked

    def in_time_order(self, places: list[ChunkPlace], topics: dict[int, str]) -> Iterator[RawMessage]:
        """The same messages by log time.

        Of a chunk that waits only the order of its messages stays in memory; its bytes are unpacked again if the
        cache lost them. Raises Damage.
        """
        chunks = {place.offset: place for place in places}
        for _, offset, index in heapq.merge(*(self._order(place, topics) for place in places)):
            if index >= 0:
                yield self(chunks[offset]).message(index, topics)

    def _order(self, place: ChunkPlace, topics: dict[int, str]) -> Iterator[tuple[int, int, int]]:
        """Log time, offset of the chunk and index of each message, ascending."""
        yield place.first_time, place.offset, -1  # the chunk is opened when its first log time comes
        times, indexes = self._defined(place).by_time(topics)
        yield from zip(times.data, repeat(place.offset), indexes.data)
