"""Serialised messages (CDR, version 1) read where they lie, without building objects.

Four bytes state the byte order. Every number is aligned to a multiple of its size, counted from the fifth byte.
A string is its length with the closing NUL (uint32) and its bytes, a sequence is its length (uint32) and its items.
Trajectories become arrays, however many points they have [s, m, rad].
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.units import SECOND

STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}
FRAME_AT = 16  #: offset of the frame's name in a message that begins with a Header; the length of the name comes first
BIG, LITTLE = b"\0\0\0\0", b"\0\1\0\0"  #: the first four bytes of plain CDR, by byte order


#: type -> (column, unit) of the numbers after its header
FIXED = {
    "geometry_msgs/msg/PoseStamped": (
        [(f"position_{a}", "m") for a in "xyz"] + [(f"orientation_{a}", "") for a in "xyzw"]
    ),
    "geometry_msgs/msg/WrenchStamped": [(f"force_{a}", "n") for a in "xyz"] + [(f"torque_{a}", "n_m") for a in "xyz"],
    # the deflection: a small displacement and rotation in the fields of velocities
    "geometry_msgs/msg/TwistStamped": [(f"linear_{a}", "") for a in "xyz"] + [(f"angular_{a}", "") for a in "xyz"],
}


def stamp_of(data: bytes, schema_has_header: bool = True) -> int | None:
    """The stamp [ns] that a message begins with; None where there is none or it is not a time after 1970."""
    if not schema_has_header or len(data) < 12 or data[1] > 1:
        return None
    seconds, nanoseconds = STAMP[data[1]].unpack_from(data, 4)
    if seconds < 0 or nanoseconds >= SECOND:
        return None
    return seconds * SECOND + nanoseconds


@functools.lru_cache(maxsize=64)
def _layout(begin: bytes, length: bytes, count: int) -> struct.Struct:
    """Layout of a Header and ``count`` doubles; begin: the first two bytes of the message; length: as it has that of
    the frame's name, with its closing NUL. Raises ValueError."""
    if begin not in (BIG[:2], LITTLE[:2]) or len(length) != 4:
        raise ValueError("not plain CDR of version 1 with a header")
    order, name = ("<", int.from_bytes(length, "little")) if begin[1] else (">", int.from_bytes(length, "big"))
    return struct.Struct(f"{order}4siII{name}s{-(FRAME_AT - 4 + name) % 8}x{count}d")


@functools.lru_cache(maxsize=64)
def _packing(frame: str, count: int) -> tuple[Callable, bytes]:
    """Return the function that packs a message, and the encoded name of its frame."""
    name = frame.encode() + b"\0"
    return _layout(LITTLE[:2], len(name).to_bytes(4, "little"), count).pack, name


def pack_stamped(stamp_ns: int, frame: str, values: list[float]) -> bytes:
    """A message that is a Header and doubles, such as a WrenchStamped, without a gap."""
    pack, name = _packing(frame, len(values))
    return pack(LITTLE, stamp_ns // SECOND, stamp_ns % SECOND, len(name), name, *values)


def unpack_stamped(data: bytes, count: int, alone: bool = False) -> tuple[int, str, list[float]]:
    """Stamp [ns], frame and the ``count`` doubles of such a message; raises ValueError where it is none.

    alone: only padding may follow.
    """
    layout = _layout(data[:2], data[12:FRAME_AT], count)
    if len(data) < layout.size:
        raise ValueError("the message ends too early")
    if alone and len(data) >= layout.size + 8:
        raise ValueError("the message is longer than its type")
    _, seconds, nanoseconds, _, frame, *values = layout.unpack_from(data)
    return seconds * SECOND + nanoseconds, frame[:-1].decode("utf-8", "replace"), values


def layout_of(data: bytes) -> tuple[int, bytes, bytes]:
    """Return length, byte order and frame with its length: equal in messages with the same offsets and frame."""
    order = "little" if data[1:2] == b"\1" else "big"
    return len(data), data[:2], data[12 : FRAME_AT + int.from_bytes(data[12:FRAME_AT], order)]  # type: ignore[arg-type]


def unpack_alike(messages: Sequence[bytes], count: int) -> tuple[str, np.ndarray, np.ndarray]:
    """Frame, stamps [ns], (n,) int64, and doubles, (n, count), of messages with one ``layout_of``.

    As ``unpack_stamped``.
    """
    _, frame, _ = unpack_stamped(messages[0], count, alone=True)
    size, begin, named = layout_of(messages[0])
    order, first = "<" if begin[1] else ">", _layout(begin, named[:4], count).size - 8 * count
    formats = [f"{order}i4", f"{order}u4", f"({count},){order}f8"]
    fields = {"names": ["s", "ns", "values"], "formats": formats, "offsets": [4, 8, first], "itemsize": size}
    kind: np.dtype = np.dtype(fields)  # type: ignore[call-overload]
    table = np.frombuffer(b"".join(messages), kind)
    return frame, table["s"].astype(np.int64) * SECOND + table["ns"], table["values"].astype(float)


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


TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
WIDTHS = (7, 6, 6)  # doubles of a transform, a velocity, an acceleration


@dataclass(frozen=True, eq=False)
class TrajectoryRecord:
    """A MultiDOFJointTrajectory of p points with j bodies each; quantities that a point leaves out are NaN."""

    stamp: int | None  #: [ns]
    frame_id: str
    names: tuple[str, ...]
    time: np.ndarray  #: [ns] from the start, (p,) int64
    position: np.ndarray  #: [m], (p, j, 3)
    quaternion: np.ndarray  #: x y z w, (p, j, 4)
    velocity: np.ndarray  #: [m/s, rad/s], (p, j, 6)
    acceleration: np.ndarray  #: [m/s^2, rad/s^2], (p, j, 6)


def read_trajectory(data: bytes) -> TrajectoryRecord:
    """The content of one serialised message; raises ValueError where it is none."""
    cursor = Cursor(data)
    cursor.number("i"), cursor.number("I")
    frame_id, names = cursor.string(), tuple(cursor.string() for _ in range(cursor.number("I")))
    count = cursor.number("I")
    if 20 * count > len(data):  # a point without any content has 20 bytes
        raise ValueError("the message ends too early")
    if 8 * count * len(names) > len(data):  # points may leave lists out, but the room for them is made for all
        raise ValueError(f"its {count} points leave out most of the {len(names)} bodies")
    times = np.empty(count, np.int64)
    tables = [np.full((count, len(names), width), np.nan) for width in WIDTHS]
    at = 0
    while at < count:
        points = _alike(cursor, len(names), min(1000, count - at))  # a layout that changes all the time takes no hours
        rows = slice(at, at + len(points))
        times[rows] = points["seconds"].astype(np.int64) * 10**9 + points["nanoseconds"]
        for k, table in enumerate(tables):
            if points[f"values_{k}"].size:
                table[rows] = points[f"values_{k}"]
        at = rows.stop
    if len(data) - cursor.offset >= 8:  # more than padding
        raise ValueError("the message is longer than its type")
    for table in (times, *tables):
        table.setflags(write=False)
    return TrajectoryRecord(stamp_of(data), frame_id, names, times, *np.split(tables[0], [3], axis=2), *tables[1:])


def _alike(cursor: Cursor, bodies: int, window: int) -> np.ndarray:
    """Step over the next point, and those of the next ``window`` that have the same layout: a table of them."""
    begin, order = cursor.offset, cursor.order
    fields: dict[str, tuple] = {}  # name -> type, offset in the point
    for k, width in enumerate(WIDTHS):
        items = cursor.number("I")
        fields[f"length_{k}"] = f"{order}u4", cursor.offset - 4 - begin
        if items not in (0, bodies):
            raise ValueError(f"a point has {items} entries for {bodies} names")
        if items:
            cursor.align(8)
        fields[f"values_{k}"] = (f"{order}f8", (items, width)), cursor.skip(8 * width * items) - begin
    cursor.align(4)
    fields["seconds"] = f"{order}i4", cursor.skip(4) - begin
    fields["nanoseconds"] = f"{order}u4", cursor.skip(4) - begin
    formats, offsets = zip(*fields.values(), strict=True)
    stride = cursor.offset - begin
    fixed = {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": stride}
    layout: np.dtype = np.dtype(fixed)  # type: ignore[call-overload]
    # where the stride is a multiple of 8 the numbers of the next point have the same offsets
    rows = 1 if stride % 8 else min(window, (len(cursor.data) - begin) // stride)
    points = np.frombuffer(cursor.data, layout, rows, begin)
    other = np.any([points[f"length_{k}"] != points[f"length_{k}"][0] for k in range(len(WIDTHS))], axis=0)
    points = points[: int(np.argmax(other))] if other.any() else points
    cursor.offset = begin + len(points) * stride
    return points
