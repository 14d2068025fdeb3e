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
from typing import IO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Chunk

from kr270_milling.recordings.bag.records import HEAD, SMALL_LIMIT, Damage, RecordPlace, read_bytes, record_at, unpack

__all__ = ["ChunkMessages", "ChunkPlace", "ChunkReader", "RawMessage"]

CACHE = 32 * 1024 * 1024  # [bytes] of unpacked chunks that stay in memory
SORTED = 64 * 1024 * 1024  # [bytes] that sorting by log time may take
MOST_MESSAGES, MOST_DEFINITIONS = 4_000_000, 10_000  # of one chunk
MESSAGE = struct.Struct("<BQHIQQ")  # opcode and length; channel, sequence, log time, publish time
HEAD_SIZE, MESSAGE_HEAD = HEAD.size, MESSAGE.size - HEAD.size  # [bytes] of opcode and length, of the other fields


class ChunkPlace(NamedTuple):
    """A chunk, or a run of messages outside of chunks."""

    opcode: int  #: CHUNK or MESSAGE
    offset: int
    end: int
    first_time: int  #: [ns], smallest and largest log time
    last_time: int
    unpacked: int  #: [bytes]

    @property
    def size(self) -> int:
        return self.end - self.offset


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

    def __init__(self, data: bytes, offset: int, compression: str = "", packed: int = 0):
        self.data, self.offset = data, offset
        self.compression, self.packed = compression, packed  #: name, and size of the packed data [bytes]
        self.offsets, self.times, self.channels = array("I"), array("Q"), array("H")
        self.definitions: list[RecordPlace] = []  #: places of schemas and channels in the bytes
        try:
            self._index()
        except struct.error:
            raise Damage("a chunk ends in the middle of a record", offset) from None
        self.counts = Counter(self.channels)  #: channel -> messages
        self.memory = len(data) + 14 * len(self.times)  # [bytes]
        if self.times and self.last_time >= 2**63:
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
                if length > SMALL_LIMIT:
                    raise Damage(f"a definition has {length} bytes, more than {SMALL_LIMIT}", self.offset)
                self.definitions.append(RecordPlace(opcode, at, end))
                if len(self.definitions) > MOST_DEFINITIONS:
                    raise Damage(f"a chunk has more than {MOST_DEFINITIONS} definitions", self.offset)
            at = end
        if len(self.times) > MOST_MESSAGES:
            raise Damage(f"a chunk has more than {MOST_MESSAGES} messages", self.offset)
        if at != size:
            raise Damage("a record in a chunk has an impossible length", self.offset)

    def __len__(self) -> int:
        return len(self.times)

    def stream(self) -> IO[bytes]:
        """The unpacked bytes as a stream, without a copy."""
        return io.BytesIO(self.data)

    @property
    def first_time(self) -> int:
        return min(self.times, default=0)

    @property
    def last_time(self) -> int:
        return max(self.times, default=0)

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

    def by_time(self, topics: dict[int, str]) -> list[np.ndarray]:
        """Log times [ns] and indexes of the messages on these channels, ascending; equal times as in the file."""
        times, channels = np.frombuffer(self.times, np.uint64), np.frombuffer(self.channels, np.uint16)
        chosen = np.flatnonzero(np.isin(channels, list(topics))).astype(np.uint32)
        chosen = chosen[np.argsort(times[chosen], kind="stable")]
        return [times[chosen], chosen]


class ChunkReader:
    """Reads the chunks of a file and remembers the last ones, up to CACHE bytes."""

    def __init__(self, stream: IO[bytes], channels: Container[int]):
        self._stream, self._channels = stream, channels
        self.used = 0  #: [bytes] in memory
        self._remembered: OrderedDict[int, ChunkMessages] = OrderedDict()

    def __call__(self, place: ChunkPlace) -> ChunkMessages:
        """The messages of a chunk. Raises Damage."""
        content = self._remembered.get(place.offset)
        if content is not None:
            self._remembered.move_to_end(place.offset)
            return content
        self._make_room(place.unpacked)
        content = self._remembered[place.offset] = self._read(place)
        self.used += content.memory
        return content

    def _make_room(self, size: int) -> None:
        """Forget the oldest chunks before the next chunk takes its memory [bytes]."""
        while self._remembered and self.used + size > CACHE:
            self.used -= self._remembered.popitem(last=False)[1].memory

    def _read(self, place: ChunkPlace) -> ChunkMessages:
        if place.opcode == Opcode.MESSAGE:
            return ChunkMessages(read_bytes(self._stream, place.offset, place.size), place.offset)
        chunk = record_at(self._stream, RecordPlace(place.opcode, place.offset, place.end))
        if not isinstance(chunk, Chunk) or chunk.uncompressed_size != place.unpacked:
            raise Damage("the index of chunks does not fit the chunk", place.offset)
        data, compression, packed = unpack(chunk, place.offset), chunk.compression, len(chunk.data)
        del chunk  # before the index of the messages takes memory
        content = ChunkMessages(data, place.offset, compression, packed)
        if len(content) and (content.first_time, content.last_time) != (place.first_time, place.last_time):
            raise Damage("a chunk has other log times than it states", place.offset)
        return content

    def survey(self, place: RecordPlace) -> tuple[ChunkPlace, ChunkMessages]:
        """Size and log times of a chunk as its record states them, and its messages. Raises Damage."""
        self._make_room(place.end - place.offset)
        chunk = record_at(self._stream, place)
        first, last, unpacked = chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size
        del chunk  # it is large
        described = ChunkPlace(*place, first, last, unpacked)
        return described, self(described)

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

        A chunk is opened at its first log time. Of a chunk that waits only the order of its messages stays in memory;
        its bytes are unpacked again if the cache lost them. Raises Damage.
        """
        waiting: list[tuple] = [(place.first_time, place.offset, -1, place, iter(())) for place in places]
        heapq.heapify(waiting)
        memory = 0  # [bytes] of the orders
        while waiting:
            _, offset, index, place, order = waiting[0]
            content = self._defined(place)
            if index < 0:
                times, indexes = content.by_time(topics)
                memory += 12 * len(content)
                if memory > SORTED:
                    raise Damage("too many chunks overlap in time to sort their messages", offset)
                order = zip(times.data, indexes.data, strict=True)
            else:
                yield content.message(index, topics)
            following = next(order, None)
            if following is None:
                heapq.heappop(waiting)
                memory -= 12 * len(content)
            else:
                heapq.heapreplace(waiting, (following[0], offset, following[1], place, order))
            del content
