"""Chunks unpacked: the messages of one chunk, with a bound on what is held in memory."""

from __future__ import annotations

import zlib
from collections import OrderedDict
from dataclasses import dataclass

from kr270_milling.bag import scan
from kr270_milling.bag.scan import LIMIT, MESSAGE, MESSAGE_HEAD, Chunk, Damage

__all__ = ["Messages", "Unpacker"]

CACHE = 64 * 1024 * 1024  # [bytes] of unpacked chunks held at a time
STEP = 1024 * 1024
MOST = 1_000_000  # messages in a chunk; their list takes more memory than a file made for it


@dataclass(frozen=True)
class Messages:
    """The content of a chunk: its bytes, per message (log time, begin, end, channel, publish time, sequence) in file
    order, and the schemas and channels that it introduces."""

    data: bytes
    index: list[tuple[int, int, int, int, int, int]]
    schemas: dict[int, scan.SchemaInfo]
    channels: dict[int, scan.ChannelInfo]

    @property
    def cost(self) -> int:
        return len(self.data) + 250 * len(self.index)


class Unpacker:
    """Gives the messages of chunks and remembers the last ones, up to a number of bytes."""

    def __init__(self, stream, cache: int = CACHE):
        self._stream, self._limit, self._used = stream, cache, 0
        self._kept: OrderedDict[int, Messages] = OrderedDict()

    def __call__(self, chunk: Chunk) -> Messages:
        found = self._kept.get(chunk.offset)
        if found is not None:
            self._kept.move_to_end(chunk.offset)
            return found
        found = self._kept[chunk.offset] = messages(self._stream, chunk)
        self._used += found.cost
        while self._used > self._limit and len(self._kept) > 1:
            self._used -= self._kept.popitem(last=False)[1].cost
        return found


def messages(stream, chunk: Chunk) -> Messages:
    """Unpack one chunk and check it: size, checksum, the lengths in it, and that its times are those it announced."""
    stream.seek(chunk.start)
    packed = stream.read(chunk.size)
    if len(packed) != chunk.size:
        raise Damage("the file became shorter while it was read", chunk.offset)
    data = _unpack(packed, chunk)
    if len(data) != chunk.unpacked:
        raise Damage(f"a chunk unpacks to {len(data)} bytes and not to {chunk.unpacked}", chunk.offset)
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise Damage("a chunk does not fit its checksum", chunk.offset)
    index, schemas, channels = [], {}, {}
    for kind, at, size in scan.records(data, chunk.offset):
        if kind == MESSAGE:
            channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(data, at)
            if len(index) == MOST:
                raise Damage(f"a chunk holds more than {MOST} messages", chunk.offset)
            index.append((log_time, at + MESSAGE_HEAD.size, at + size, channel, publish_time, sequence))
        elif kind == scan.SCHEMA:
            schemas.update([scan.schema(scan.Fields(data[at : at + size], chunk.offset))])
        elif kind == scan.CHANNEL:
            channels.update([scan.channel(scan.Fields(data[at : at + size], chunk.offset))])
    if index and (min(index)[0] != chunk.first_time or max(index)[0] != chunk.last_time):
        raise Damage("a chunk holds other times than it says", chunk.offset)
    if index and chunk.last_time >= 2**63:
        raise Damage(f"a log time of {chunk.last_time} ns is beyond the year 2262", chunk.offset)
    return Messages(data, index, schemas, channels)


def _unpack(packed: bytes, chunk: Chunk) -> bytes:
    if chunk.compression in ("", "run"):
        return packed
    if chunk.compression == "zstd":
        return _unpack_zstd(packed, chunk)
    if chunk.compression == "lz4":
        return _unpack_lz4(packed, chunk)
    raise Damage(f"a chunk is packed with {chunk.compression!r}, which is not known here", chunk.offset)


def _unpack_zstd(packed: bytes, chunk: Chunk) -> bytes:
    import zstandard

    pieces, size = [], 0
    try:
        # in steps, so that memory follows what is really there and not what the file claims
        with zstandard.ZstdDecompressor(max_window_size=LIMIT).stream_reader(packed) as reader:
            while piece := reader.read(STEP):
                pieces.append(piece)
                size += len(piece)
                if size > chunk.unpacked:
                    break
    except zstandard.ZstdError as error:
        raise Damage("a chunk cannot be unpacked", chunk.offset) from error
    return b"".join(pieces)


def _unpack_lz4(packed: bytes, chunk: Chunk) -> bytes:
    import lz4.frame

    try:
        return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=chunk.unpacked + 1)
    except (RuntimeError, EOFError) as error:
        raise Damage("a chunk cannot be unpacked", chunk.offset) from error
