"""Serialised messages (CDR, version 1) read where they lie, without building objects.

Behind four bytes that tell the byte order every number stands at a multiple of its own size, counted from there.
A string is its length with the closing NUL (uint32) and its bytes, a sequence is its length (uint32) and its items.
"""

from __future__ import annotations

import struct

__all__ = ["Cursor", "stamp_of"]

STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}


def stamp_of(data: bytes, schema_has_header: bool = True) -> int | None:
    """The stamp [ns] that a message begins with; None where there is none or it is not a time after 1970."""
    if not schema_has_header or len(data) < 12 or data[1] > 1:
        return None
    seconds, nanoseconds = STAMP[data[1]].unpack_from(data, 4)
    if seconds < 0 or nanoseconds >= 1_000_000_000:
        return None
    return seconds * 1_000_000_000 + nanoseconds


class Cursor:
    """Walks through one message and knows where it is; raises ValueError where the message ends too early."""

    def __init__(self, data: bytes):
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise ValueError("not plain CDR of version 1")
        self.data, self.offset = data, 4
        self.order = "<" if data[1] else ">"

    def align(self, size: int) -> int:
        self.offset += (4 - self.offset) % size  # counted from byte 4; 4 is 0 there
        return self.offset

    def skip(self, size: int) -> int:
        """Step over ``size`` bytes and return where they begin."""
        start = self.offset
        if start + size > len(self.data):
            raise ValueError("the message ends too early")
        self.offset += size
        return start

    def number(self, code: str):
        size = struct.calcsize(code)
        self.align(size)
        return struct.unpack_from(self.order + code, self.data, self.skip(size))[0]

    def string(self) -> str:
        start = self.skip(length := self.number("I"))
        return bytes(self.data[start : start + max(length - 1, 0)]).decode("utf-8", "replace")

    def strings(self) -> tuple[str, ...]:
        count = self.number("I")
        if 4 * count > len(self.data):
            raise ValueError("the message ends too early")
        return tuple(self.string() for _ in range(count))

    def finish(self) -> None:
        """Refuse a message that goes on behind its last field, but for padding: it is of another type."""
        if len(self.data) - self.offset >= 8:
            raise ValueError("the message is longer than its type")
