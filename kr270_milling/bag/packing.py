"""What a chunk says of itself, and its bytes, unpacked out of the file so that there is no second copy of them.

Beside them are 2 MB, and with zstd what takes less: the packed bytes, or the window that its frame names (8 MB for most
levels, 128 MB at most). Only the window will do where the frame does not say how many bytes it holds: zstandard gives
no way to unpack such a one without it.
"""

from __future__ import annotations

import struct
from io import BytesIO
from typing import IO, NamedTuple, cast

import lz4.frame
import zstandard

from kr270_milling.bag.structure import ODD, UNEVEN, Damage, exactly

__all__ = ["Packed"]

WINDOW = 128 * 1024 * 1024  # [bytes]; zstd's own program takes no more without being told to
FRAME_HEAD = 18  # [bytes] of a zstd frame at most before its first block, by RFC 8878
PIECE = 1024 * 1024  # [bytes] that are unpacked at once; of packed ones a 16th
BEFORE = struct.Struct("<BQQQQII")  # type and length; first and last time, unpacked, checksum, length of the name
SIZE = struct.Struct("<Q")


class Packed(NamedTuple):
    """A chunk's own words; its packed bytes stand in the file at ``begin``."""

    first_time: int  # [ns], smallest and largest log time
    last_time: int
    unpacked: int  # [bytes]
    checksum: int  # CRC-32 of the unpacked bytes; 0: none
    packing: str
    begin: int
    size: int  # [bytes]

    @classmethod
    def of(cls, stream, offset: int, size: int) -> Packed:
        """Of the chunk whose record lies there. Raises Damage."""
        name, end = offset + BEFORE.size, offset + size
        if name + SIZE.size > end:
            raise Damage(ODD, offset)
        _, _, first, last, unpacked, crc, length = BEFORE.unpack(exactly(stream, offset, BEFORE.size))
        begin = name + length + SIZE.size
        if begin > end:
            raise Damage(ODD, offset)
        try:
            packing = exactly(stream, name, length).decode()
        except UnicodeDecodeError:
            raise Damage(ODD, offset) from None
        (packed,) = SIZE.unpack(exactly(stream, begin - SIZE.size, SIZE.size))
        if begin + packed != end:
            raise Damage(ODD if begin + packed > end else UNEVEN, offset)
        return cls(first, last, unpacked, crc, packing, begin, packed)

    def unpack(self, stream, offset: int) -> bytes:
        """At most one byte more than it announces, which mcap's breakup_chunk does not see to; offset: of the chunk.
        Raises Damage."""
        section = _Section(stream, self.begin, self.size)
        if self.packing not in ("", "zstd", "lz4"):
            raise Damage(f"a chunk is packed with {self.packing[:16]!r}, which is not known here", offset)
        if not self.packing or not self.size:
            return section.read(self.size)
        try:
            return (_zstd if self.packing == "zstd" else _lz4)(section, self.unpacked + 1)
        except (zstandard.ZstdError, RuntimeError, EOFError) as error:
            raise Damage("a chunk cannot be unpacked", offset) from error


class _Section:
    """The bytes from ``begin`` on of a file, to be read one after the other."""

    def __init__(self, stream, begin: int, size: int):
        self._stream, self._at, self.left = stream, begin, size

    def peek(self, size: int) -> bytes:
        return exactly(self._stream, self._at, min(size, self.left))

    def read(self, size: int) -> bytes:
        data = self.peek(size)
        self._at += len(data)
        self.left -= len(data)
        return data


def _zstd(section: _Section, most: int) -> bytes:
    """The bytes of its first frame. All packed bytes at once are unpacked without a window."""
    frame = zstandard.get_frame_parameters(section.peek(FRAME_HEAD))
    at_once = frame.content_size < most and section.left <= frame.window_size
    source = section.read(section.left) if at_once else cast(IO[bytes], section)
    unpacker = zstandard.ZstdDecompressor(max_window_size=WINDOW)
    with unpacker.stream_reader(source, closefd=False) as reader:
        return reader.read(most)


def _lz4(section: _Section, most: int) -> bytes:
    """The bytes of its first frame. BytesIO grows where it is and gives what it holds without a copy."""
    frame, unpacked = lz4.frame.LZ4FrameDecompressor(), BytesIO()
    while not frame.eof and unpacked.tell() < most:
        packed = section.read(PIECE // 16) if frame.needs_input else b""
        piece = frame.decompress(packed, max_length=min(PIECE, most - unpacked.tell()))
        if not packed and not piece:
            break
        unpacked.write(piece)
    return unpacked.getvalue()
