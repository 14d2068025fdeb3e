"""MultiDOFJointTrajectory messages as arrays, however many points they have [s, m, rad]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.messages.cdr import Cursor, stamp_of

__all__ = ["TRAJECTORY", "TrajectoryRecord", "read_trajectory"]

TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
WIDTHS = (7, 6, 6)  # doubles of a transform, a velocity, an acceleration


@dataclass(frozen=True, eq=False)
class TrajectoryRecord:
    """One message; for p points with j bodies each. What a point leaves out is NaN."""

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
    frame_id, names = cursor.string(), cursor.strings()
    count = cursor.number("I")
    if 20 * count > len(data):  # a point without any content has 20 bytes
        raise ValueError("the message ends too early")
    if 8 * count * len(names) > len(data):  # points may leave lists out, but the room for them is made for all
        raise ValueError(f"its {count} points leave out most of the {len(names)} bodies")
    times = np.empty(count, np.int64)
    tables = [np.full((count, len(names), width), np.nan) for width in WIDTHS]
    done, window = 0, 16
    while done < count:
        rows = _alike(cursor, done, min(window, count - done), times, tables)
        # as far ahead as it went well: a message made to change its layout all the time costs no more than its size
        done, window = done + rows, 4 * window if rows == window else 16
    cursor.finish()
    for table in (times, *tables):
        table.setflags(write=False)
    return TrajectoryRecord(stamp_of(data), frame_id, names, times, *np.split(tables[0], [3], axis=2), *tables[1:])


def _point(cursor: Cursor, bodies: int) -> tuple[list[tuple[int, int, int]], int]:
    """Step over one point: (offset of the length, of the numbers, their count) per list, and where its time is."""
    lists = []
    for width in WIDTHS:
        items = cursor.number("I")
        length_at = cursor.offset - 4
        if items not in (0, bodies):
            raise ValueError(f"a point has {items} entries for {bodies} names")
        if items:
            cursor.align(8)
        lists.append((length_at, cursor.skip(8 * width * items), items))
    cursor.align(4)
    return lists, cursor.skip(8)


def _alike(cursor: Cursor, done: int, window: int, times: np.ndarray, tables: list[np.ndarray]) -> int:
    """Read the next point, and with it those of the next ``window`` that have the same layout; how many these are."""
    begin, data = cursor.offset, cursor.data
    lists, time_at = _point(cursor, tables[0].shape[1])
    stride = cursor.offset - begin
    rows = 1
    if stride % 8 == 0:  # the next point's numbers then stand at the same distance
        rows = min(window, (len(data) - begin) // stride)
        table = np.frombuffer(data, np.uint8, rows * stride, begin).reshape(rows, stride)
        same = np.ones(rows, bool)
        for length_at, _, _ in lists:
            at = length_at - begin
            same &= (table[:, at : at + 4] == table[0, at : at + 4]).all(axis=1)
        rows = rows if same.all() else int(np.argmin(same))
    table = np.frombuffer(data, np.uint8, rows * stride, begin).reshape(rows, stride)

    def read(offset: int, items: int, kind: str) -> np.ndarray:
        at, size = offset - begin, np.dtype(kind).itemsize
        return np.ascontiguousarray(table[:, at : at + items * size]).view(cursor.order + kind)

    seconds, nanoseconds = read(time_at, 1, "i4")[:, 0], read(time_at + 4, 1, "u4")[:, 0]
    times[done : done + rows] = seconds.astype(np.int64) * 10**9 + nanoseconds
    for target, width, (_, offset, items) in zip(tables, WIDTHS, lists, strict=True):
        if items:
            target[done : done + rows] = read(offset, items * width, "f8").reshape(rows, items, width)
    cursor.offset = begin + rows * stride
    return rows
