"""MultiDOFJointTrajectory messages as arrays, however many points they have [s, m, rad]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.recordings.messages.cdr import Cursor, stamp_of

__all__ = ["TRAJECTORY", "TrajectoryRecord", "read_trajectory"]

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
    frame_id, names = cursor.string(), cursor.strings()
    count = cursor.number("I")
    if 20 * count > len(data):  # a point without any content has 20 bytes
        raise ValueError("the message ends too early")
    if 8 * count * len(names) > len(data):  # points may leave lists out, but the room for them is made for all
        raise ValueError(f"its {count} points leave out most of the {len(names)} bodies")
    times = np.empty(count, np.int64)
    tables = [np.full((count, len(names), width), np.nan) for width in WIDTHS]
    count_read, window = 0, 16
    while count_read < count:
        points = _alike(cursor, len(names), min(window, count - count_read))
        rows = slice(count_read, count_read + len(points))
        times[rows] = points["seconds"].astype(np.int64) * 10**9 + points["nanoseconds"]
        for k, table in enumerate(tables):
            if points[f"values_{k}"].size:
                table[rows] = points[f"values_{k}"]
        # as far ahead as it went well: a message made to change its layout all the time costs no more than its size
        count_read, window = rows.stop, 4 * window if len(points) == window else 16
    cursor.finish()
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
    layout = np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": stride})
    # where the stride is a multiple of 8 the numbers of the next point have the same offsets
    rows = 1 if stride % 8 else min(window, (len(cursor.data) - begin) // stride)
    points = np.frombuffer(cursor.data, layout, rows, begin)
    other = np.any([points[f"length_{k}"] != points[f"length_{k}"][0] for k in range(len(WIDTHS))], axis=0)
    points = points[: int(np.argmax(other))] if other.any() else points
    cursor.offset = begin + len(points) * stride
    return points
