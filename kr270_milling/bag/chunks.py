"""Chunks unpacked: the messages of one chunk, with a bound on what is held in memory."""

from __future__ import annotations

import zlib
from array import array
from collections import Counter, OrderedDict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from kr270_milling.bag.structure import HEAD, LIMIT, MESSAGE_HEAD, Chunk, Damage, exactly, inner, parsed

__all__ = ["CACHE", "Entry", "Messages", "Unpacker", "unpacked"]

CACHE = 32 * 1024 * 1024  # [bytes] of unpacked chunks that are remembered, and as many that are sorted by time
STEP = 1024 * 1024
MOST = 1_000_000  # messages in a chunk


class Entry(NamedTuple):
    """One message of a chunk; its bytes are those from ``begin`` to ``end``. In order of log times, then of places."""

    log_time: int
    chunk: int  # offset in the file
    begin: int
    end: int
    channel: int
    publish_time: int
    sequence: int


class Messages:
    """The content of a chunk: its bytes, where the messages are, and the definitions that it introduces."""

    def __init__(self, data: bytes | memoryview, chunk: Chunk):
        self.data = data
        self.offset = chunk.offset
        self.counts: Counter[int] = Counter()  #: channel -> messages
        self.definitions: list = []  #: mcap's Schema and Channel records
        self._begins, self._ends, self._times = array("I"), array("I"), array("Q")
        for kind, at, size in inner(data, chunk.offset):
            if kind == Opcode.MESSAGE:
                self._add(at, size)
            elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.definitions.append(parsed(kind, data[at : at + size], chunk.offset))

    def _add(self, at: int, size: int) -> None:
        channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(self.data, at)
        if len(self._times) == MOST:
            raise Damage(f"a chunk holds more than {MOST} messages", self.offset)
        self._begins.append(at + MESSAGE_HEAD.size)
        self._ends.append(at + size)
        self._times.append(log_time)
        self.counts[channel] += 1

    def __len__(self) -> int:
        return len(self._times)

    @property
    def cost(self) -> int:
        """[bytes] that this takes in memory."""
        return len(self.data) + 16 * len(self._times)

    @property
    def span(self) -> tuple[int, int]:
        """[ns], smallest and largest log time; of messages that there are."""
        return min(self._times), max(self._times)

    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Channel, log time [ns] and offset of the record in the unpacked chunk of every message, (n,) each."""
        raw, begins = np.frombuffer(self.data, np.uint8), np.frombuffer(self._begins, np.uint32)
        at = begins - MESSAGE_HEAD.size
        channel = raw[at] + 256 * raw[at + 1].astype(np.uint16)
        return channel, np.frombuffer(self._times, np.uint64), (at - HEAD.size).astype(np.uint64)

    def entry(self, k: int) -> Entry:
        """The message number k of the file's order."""
        begin = self._begins[k]
        channel, sequence, log_time, publish = MESSAGE_HEAD.unpack_from(self.data, begin - MESSAGE_HEAD.size)
        return Entry(log_time, self.offset, begin, self._ends[k], channel, publish, sequence)

    def entries(self) -> Iterator[Entry]:
        """The messages as they were written."""
        return map(self.entry, range(len(self)))

    def by_time(self) -> tuple[np.ndarray, np.ndarray]:
        """Log times [ns] in their order, and which messages have them, (n,) each; 12 bytes a message."""
        times = np.frombuffer(self._times, np.uint64)
        order = np.argsort(times, kind="stable").astype(np.uint32)
        return times[order], order


class Unpacker:
    """Gives the messages of chunks and remembers the last ones, up to a number of bytes."""

    def __init__(self, stream, cache: int = CACHE):
        self._stream = stream
        self._limit = cache
        self.used = 0  #: [bytes]
        self.work = 0  #: [bytes] that were unpacked, again and again where they were forgotten
        self._remembered: OrderedDict[int, Messages] = OrderedDict()

    def __call__(self, chunk: Chunk) -> Messages:
        found = self._remembered.get(chunk.offset)
        if found is not None:
            self._remembered.move_to_end(chunk.offset)
            return found
        found = self._remembered[chunk.offset] = unpacked(self._stream, chunk)
        self.used += found.cost
        self.work += found.cost
        while self.used > self._limit and len(self._remembered) > 1:
            self.used -= self._remembered.popitem(last=False)[1].cost
        return found


def unpacked(stream, chunk: Chunk) -> Messages:
    """Unpack one chunk and check it: size, checksum, the lengths in it, and that its times are those it announced."""
    stream.seek(chunk.start)
    data = _unpack(exactly(stream, chunk.size, chunk.offset), chunk)
    if len(data) != chunk.unpacked:
        raise Damage(f"a chunk unpacks to {len(data)} bytes and not to {chunk.unpacked}", chunk.offset)
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise Damage("a chunk does not fit its checksum", chunk.offset)
    found = Messages(data, chunk)
    if len(found) and found.span != (chunk.first_time, chunk.last_time):
        raise Damage("a chunk holds other times than it says", chunk.offset)
    if len(found) and chunk.last_time >= 2**63:
        raise Damage(f"a log time of {chunk.last_time} ns is beyond the year 2262", chunk.offset)
    return found


def _unpack(packed: bytes, chunk: Chunk) -> bytes | memoryview:
    """The bytes of a chunk; never many more than it announces, which mcap's breakup_chunk does not see to."""
    if chunk.compression in ("", "run"):
        return packed
    if chunk.compression == "zstd":
        return _unpack_zstd(packed, chunk)
    if chunk.compression == "lz4":
        return _unpack_lz4(packed, chunk)
    raise Damage(f"a chunk is packed with {chunk.compression!r}, which is not known here", chunk.offset)


def _unpack_zstd(packed: bytes, chunk: Chunk) -> memoryview:
    import zstandard

    data, size = memoryview(bytearray(chunk.unpacked)), 0  # zeros take no memory before they are written
    try:
        # in steps, so that memory follows what is really there and not what the file claims
        with zstandard.ZstdDecompressor(max_window_size=LIMIT).stream_reader(packed) as reader:
            while size < len(data) and (step := reader.readinto(data[size : size + STEP])):
                size += step
            if reader.read(1):
                raise Damage(f"a chunk unpacks to more than {chunk.unpacked} bytes", chunk.offset)
    except zstandard.ZstdError as error:
        raise Damage("a chunk cannot be unpacked", chunk.offset) from error
    return data[:size].toreadonly()


def _unpack_lz4(packed: bytes, chunk: Chunk) -> bytes:
    import lz4.frame

    try:
        return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=chunk.unpacked + 1)
    except (RuntimeError, EOFError) as error:
        raise Damage("a chunk cannot be unpacked", chunk.offset) from error
