"""Chunks unpacked: the messages of one chunk, with bounds on the memory that is held and on the work that is done."""

from __future__ import annotations

import heapq
import zlib
from array import array
from collections import Counter, OrderedDict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from kr270_milling.bag.packing import Packed
from kr270_milling.bag.structure import HEAD, LIMIT, MESSAGE, SMALL, Damage, Part, exactly, inner

__all__ = ["CACHE", "READ", "Chunk", "Entry", "Messages", "Unpacker"]

CACHE = 32 * 1024 * 1024  # [bytes] of unpacked chunks that are remembered, and as many that are sorted by time
MOST, MOST_DEFINITIONS = 1_000_000, 10_000  # records in a chunk, and those that define schemas and channels
# Work on a file is counted in rounded costs on one core and bounded by the file's size: a pass through a recording of
# this package costs 0.05 us a byte, and 27 kB can be made to unfold into 9,000,000 messages.
FREE, PER_BYTE = 5e6, 20.0  # [us], [us/byte]
UNPACK, READ, DEFINE = 2e-3, 1.0, 20.0  # [us] a byte that is unpacked, a record that is read, one that is parsed


class Chunk(NamedTuple):
    """Where messages are: a chunk, or a run of messages outside of chunks (``type`` MESSAGE)."""

    type: int
    offset: int
    size: int  # [bytes] of the record, or of all records of the run
    first_time: int  # [ns], smallest and largest log time
    last_time: int
    unpacked: int  # [bytes]

    @property
    def end(self) -> int:
        return self.offset + self.size

    @classmethod
    def of(cls, part: Part) -> Chunk:
        """What a chunk says of itself, without its messages. Raises Damage."""
        size = part.size
        if part.type == Opcode.MESSAGE:
            data = part.data()
            times = [MESSAGE.unpack_from(data, at)[4] for _, at, _ in inner(data, part.offset)]
            return cls(part.type, part.offset, size, min(times), max(times), size)
        packed = Packed.of(part.stream, part.offset, size)
        if packed.unpacked > LIMIT:
            raise Damage(f"a chunk claims {packed.unpacked} bytes, more than {LIMIT}", part.offset)
        return cls(part.type, part.offset, size, packed.first_time, packed.last_time, packed.unpacked)


class Entry(NamedTuple):
    """One message of a file."""

    log_time: int  # [ns]
    publish_time: int
    channel: int
    sequence: int
    place: tuple[int, int]  # offset of the chunk, offset in the unpacked chunk
    data: bytes


class Messages:
    """The content of a chunk: its bytes, where the messages are, and the definitions that it introduces."""

    def __init__(self, data: bytes, chunk: Chunk, packed: Packed | None = None):
        self.data, self.offset = data, chunk.offset
        self.packed = packed  #: None: there is no chunk around them
        #: of each message: offset in the bytes, log time [ns], channel
        self.places, self.times, self.channels = array("I"), array("Q"), array("H")
        self.definitions: list[tuple[int, int, int]] = []  #: schemas and channels: type, begin and end
        self.records = 0
        for kind, at, end in inner(data, chunk.offset):
            self.records += 1
            if kind == Opcode.MESSAGE:
                _, _, channel, _, log_time, _ = MESSAGE.unpack_from(data, at)
                self.places.append(at)
                self.times.append(log_time)
                self.channels.append(channel)
            elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                if end - at > SMALL:
                    raise Damage(f"a chunk has a definition of {end - at} bytes, more than {SMALL}", chunk.offset)
                self.definitions.append((kind, at, end))
            if self.records > MOST or len(self.definitions) > MOST_DEFINITIONS:
                reason = f"a chunk holds more than {MOST} records or {MOST_DEFINITIONS} definitions"
                raise Damage(reason, chunk.offset)
        self.counts = Counter(self.channels)  #: channel -> messages
        self.cost = len(data) + 14 * len(self.times)  #: [bytes] that this takes in memory

    def __len__(self) -> int:
        return len(self.times)

    def entry(self, k: int) -> Entry:
        """The message number k of the file's order."""
        at = self.places[k]
        _, size, channel, sequence, log_time, publish_time = MESSAGE.unpack_from(self.data, at)
        data = self.data[at + MESSAGE.size : at + HEAD.size + size]
        return Entry(log_time, publish_time, channel, sequence, (self.offset, at), data)

    def __iter__(self) -> Iterator[Entry]:
        return map(self.entry, range(len(self)))

    def by_time(self) -> Iterator[tuple[int, int]]:
        """Log time [ns] and number of every message in the order of the times; holds 12 bytes a message."""
        times = np.frombuffer(self.times, np.uint64)
        order = np.argsort(times, kind="stable").astype(np.uint32)
        return zip(times[order].data, order.data, strict=True)


class Unpacker:
    """Gives the messages of a file's chunks and remembers the last ones, up to a number of bytes."""

    def __init__(self, stream, size: int, cache: int = CACHE):
        self._stream, self._limit = stream, cache
        self._sorted = CACHE + 2 * size  # [bytes] that sorting by time may hold
        self.used = 0  #: [bytes] that are remembered
        self.left = FREE + PER_BYTE * size  #: [us] of work on this file
        self._remembered: OrderedDict[int, Messages] = OrderedDict()

    def spend(self, work: float, offset: int) -> None:
        """Count work [us] before it is done; raises Damage where a file of its size cannot need it."""
        self.left -= work
        if self.left < 0:
            raise Damage("to read it takes more work than a file of its size can need", offset)

    def __call__(self, chunk: Chunk) -> Messages:
        found = self._remembered.get(chunk.offset)
        if found is not None:
            self._remembered.move_to_end(chunk.offset)
            return found
        self.spend(UNPACK * chunk.unpacked, chunk.offset)
        self._forget(chunk.unpacked, 0)  # first, so that two large ones are never held
        found = self._remembered[chunk.offset] = _messages(self._stream, chunk)
        self.used += found.cost
        self.spend(READ * found.records + DEFINE * len(found.definitions), chunk.offset)
        self._forget(0, 1)
        return found

    def _forget(self, size: int, most: int) -> None:
        """Make room for so many bytes, but keep the last few."""
        while self.used + size > self._limit and len(self._remembered) > most:
            self.used -= self._remembered.popitem(last=False)[1].cost

    def in_file_order(self, chunks: list[Chunk]) -> Iterator[Entry]:
        """Every message of some chunks. Raises Damage."""
        for chunk in chunks:
            self.spend(READ * len(self(chunk)), chunk.offset)
            yield from self(chunk)  # no name holds it while the next one is unpacked

    def in_time_order(self, chunks: list[Chunk]) -> Iterator[Entry]:
        """The same by log times. A chunk is opened when its first time has come; of one that waits for its next message
        only the order is held, and it is unpacked again where it was forgotten meanwhile."""
        # the next message of each
        lanes: list[tuple] = [(chunk.first_time, chunk.offset, -1, chunk, iter(())) for chunk in chunks]
        heapq.heapify(lanes)
        held = 0
        while lanes:
            _, offset, k, chunk, rest = lanes[0]
            found = self(chunk)
            if k < 0:
                rest, held = found.by_time(), held + 12 * len(found)
                self.spend(READ * len(found), offset)
                if held > self._sorted:
                    raise Damage("its chunks overlap in time so much that their messages cannot be sorted", offset)
            else:
                yield found.entry(k)
            following = next(rest, None)
            if following is None:
                heapq.heappop(lanes)
                held -= 12 * len(found)
            else:
                heapq.heapreplace(lanes, (following[0], offset, following[1], chunk, rest))
            del found  # before another one is unpacked


def _messages(stream, chunk: Chunk) -> Messages:
    """Unpack one chunk and check it: size, checksum, the lengths in it, and that its times are those it announced."""
    at, packed = chunk.offset, None
    if chunk.type == Opcode.CHUNK:
        packed = Packed.of(stream, at, chunk.size)
        data = packed.unpack(stream, at)
        if len(data) != packed.unpacked:
            raise Damage(f"a chunk does not unpack to the {packed.unpacked} bytes that it announces", at)
        if packed.checksum and zlib.crc32(data) != packed.checksum:
            raise Damage("a chunk does not fit its checksum", at)
    else:
        data = exactly(stream, at, chunk.size)
    found = Messages(data, chunk, packed)
    if len(found) and (min(found.times), max(found.times)) != (chunk.first_time, chunk.last_time):
        raise Damage("a chunk holds other times than it says", at)
    if len(found) and chunk.last_time >= 2**63:
        raise Damage(f"a log time of {chunk.last_time} ns is beyond the year 2262", at)
    return found
