"""Time series of a topic as arrays: the messages' bytes are read in place, a few thousand at a time.

Messages of one length whose strings and sequences have the same lengths have all numbers in the same places, so that
one message tells the layout of all its like, and numpy reads them as the rows of a table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.cdr import Cursor

__all__ = ["FIXED", "JOINTS", "JointSeries", "Series", "batches", "joint_series", "series"]

BATCH, BATCH_BYTES = 4096, 4 * 1024 * 1024
BEARABLE, MOST_UNFOLDED = 64 * 1024 * 1024, 50  # [bytes] of a series, and what it may take beside, in sizes of the file
LAYOUT = 30.0  # [us] of work on messages of one layout in a row
MOST_FRAMES = 1024 * 1024  # [characters] of the names of all frames on one topic
JOINTS = "sensor_msgs/msg/JointState"
#: type -> (column, unit) of the numbers behind its header
FIXED = {
    "geometry_msgs/msg/PoseStamped": (
        [(f"position_{a}", "m") for a in "xyz"] + [(f"orientation_{a}", "") for a in "xyzw"]
    ),
    "geometry_msgs/msg/WrenchStamped": [(f"force_{a}", "n") for a in "xyz"] + [(f"torque_{a}", "n_m") for a in "xyz"],
    # the deflection: a small displacement and rotation in place of velocities
    "geometry_msgs/msg/TwistStamped": [(f"linear_{a}", "") for a in "xyz"] + [(f"angular_{a}", "") for a in "xyz"],
}


class Layout(NamedTuple):
    """Where the numbers of one message are, and which bytes must be equal for another to have them there."""

    structure: tuple[tuple[int, int], ...]  # ranges of bytes
    frame: tuple[int, int]
    blocks: tuple[tuple[int, int], ...]  # (offset, count) of doubles
    names: tuple[str, ...] = ()


class Rows(NamedTuple):
    """Consecutive messages of one layout: times [ns] (n,), frames and a table of doubles (n, columns)."""

    log_time: np.ndarray
    stamp: np.ndarray
    frame_ids: list[str]
    layout: Layout
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Series:
    """A topic of one of the FIXED types; all arrays are read-only."""

    topic: str
    type: str
    log_time: np.ndarray  #: [ns], (n,) int64
    stamp: np.ndarray  #: [ns], (n,) int64
    frame_ids: tuple[str, ...]  # every frame that occurs, in order of appearance
    values: np.ndarray  #: SI units, (n, 7) position and quaternion x y z w, or (n, 6) translations before rotations


@dataclass(frozen=True, eq=False)
class JointSeries:
    """Joint states; what a message leaves out is NaN."""

    topic: str
    log_time: np.ndarray  #: [ns], (n,) int64
    stamp: np.ndarray  #: [ns], (n,) int64
    names: tuple[str, ...]
    position: np.ndarray  #: [rad], (n, joints)
    velocity: np.ndarray  #: [rad/s], (n, joints)
    effort: np.ndarray  #: [N m], (n, joints)


def _header(cursor: Cursor) -> tuple[int, int]:
    """Step over the header; where its frame begins, with the length, and ends."""
    cursor.number("i"), cursor.number("I")
    start = cursor.offset
    cursor.string()
    return start, cursor.offset


def _fixed_layout(count: int) -> Callable[[bytes], Layout]:
    def layout(data: bytes) -> Layout:
        cursor = Cursor(data)
        frame = _header(cursor)
        cursor.align(8)
        values = cursor.skip(8 * count)
        cursor.finish()
        return Layout(((0, 2), (frame[0], frame[0] + 4)), frame, ((values, count),))

    return layout


def _joint_layout(data: bytes) -> Layout:
    cursor = Cursor(data)
    frame = _header(cursor)
    begin, names = cursor.offset, cursor.strings()
    structure = [(0, 2), (frame[0], frame[0] + 4), (begin, cursor.offset)]
    blocks = []
    for _ in range(3):
        begin = cursor.offset
        offset, count = cursor.doubles()
        blocks.append((offset, count))
        structure.append((begin, offset))
        if count not in (0, len(names)):
            raise ValueError("a list is not as long as that of the names")
    cursor.finish()
    return Layout(tuple(structure), frame, tuple(blocks), names)


def batches(recording, topic: str) -> Iterator[Rows]:
    """The messages of a topic as they were written, in tables of up to 4096 rows or 4 MB.

    Raises RecordingError where one is not what its type says.
    """
    about = recording.topics().get(topic)
    if about is None:
        raise RecordingError(recording.path, f"has no topic {topic}")
    if about.encoding != "cdr" or (about.type not in FIXED and about.type != JOINTS):
        raise RecordingError(recording.path, f"{topic} is {about.type or 'of no type'}, which is no series of numbers")
    layout_of = _joint_layout if about.type == JOINTS else _fixed_layout(len(FIXED[about.type]))
    waiting: list = []
    for message in recording.messages([topic], as_written=True):
        size = len(message.data)
        full = len(waiting) == BATCH or (len(waiting) + 1) * size > BATCH_BYTES
        if waiting and (full or size != len(waiting[0].data)):
            yield from _tables(recording, topic, waiting, layout_of)
            waiting = []
        waiting.append(message)
    if waiting:
        yield from _tables(recording, topic, waiting, layout_of)


def _tables(recording, topic: str, messages: list, layout_of) -> Iterator[Rows]:
    """Messages of one length as tables; rows of another layout begin a new one."""
    width = len(messages[0].data)
    table = np.frombuffer(b"".join(m.data for m in messages), np.uint8).reshape(len(messages), width)
    times = np.array([m.log_time for m in messages], np.uint64).astype(np.int64)
    begin = 0
    while begin < len(messages):
        recording.spend(LAYOUT)
        try:
            layout = layout_of(messages[begin].data)
        except ValueError as error:
            what = recording.topics()[topic].type
            raise RecordingError(recording.path, f"a message on {topic} is not a {what}: {error}") from error
        same = np.ones(len(messages) - begin, bool)
        for low, high in layout.structure:
            same &= (table[begin:, low:high] == table[begin, low:high]).all(axis=1)
        end = len(messages) if same.all() else begin + int(np.argmin(same))
        yield _rows(table[begin:end], times[begin:end], layout)
        begin = end


def _rows(table: np.ndarray, times: np.ndarray, layout: Layout) -> Rows:
    order = "<" if table[0, 1] else ">"

    def read(offset: int, count: int, kind: str) -> np.ndarray:
        size = np.dtype(kind).itemsize
        return np.ascontiguousarray(table[:, offset : offset + size * count]).view(order + kind)

    stamp = read(4, 1, "i4")[:, 0].astype(np.int64) * 10**9 + read(8, 1, "u4")[:, 0]
    values = np.hstack([read(offset, count, "f8") for offset, count in layout.blocks]).astype(float)
    frames = _frames(table[:, layout.frame[0] + 4 : layout.frame[1]])
    return Rows(times, stamp, frames, layout, values)


def _frames(names: np.ndarray) -> list[str]:
    """The frame of every row from the bytes of the names with their closing NUL, (n, length)."""
    if (names == names[0]).all():
        return [names[0, :-1].tobytes().decode("utf-8", "replace")] * len(names)
    return [name[:-1].tobytes().decode("utf-8", "replace") for name in names]


def series(recording, topic: str) -> Series:
    """A PoseStamped, WrenchStamped or TwistStamped topic as arrays."""
    about = recording.topics().get(topic)
    if about is None or about.type not in FIXED:
        raise RecordingError(recording.path, f"{topic} is no topic with poses, wrenches or twists in it")
    frames: dict[str, None] = {}
    tables, length, size = [], 0, 0
    for rows in batches(recording, topic):
        new = dict.fromkeys(frame for frame in rows.frame_ids if frame not in frames)
        frames.update(new)
        length += sum(map(len, new))
        if length > MOST_FRAMES:
            raise RecordingError(recording.path, f"{topic} names frames of more than {MOST_FRAMES} characters in all")
        tables.append((rows.log_time, rows.stamp, rows.values))
        size += rows.values.nbytes
        if size > BEARABLE + MOST_UNFOLDED * recording.size:
            reason = f"{topic} unfolds into more than {size} bytes, {MOST_UNFOLDED} times the size of the file"
            raise RecordingError(recording.path, reason)
    log_time, stamp, values = zip(*tables, strict=True) if tables else ((), (), ())
    times = [_joined(list(column), (0,), np.int64) for column in (log_time, stamp)]
    return Series(topic, about.type, *times, tuple(frames), _joined(list(values), (0, len(FIXED[about.type]))))


def joint_series(recording, topic: str) -> JointSeries:
    """A JointState topic as arrays; raises RecordingError if the joints' names change on the way."""
    if getattr(recording.topics().get(topic), "type", "") != JOINTS:
        raise RecordingError(recording.path, f"{topic} is no topic with joint states in it")
    tables = list(batches(recording, topic))
    names = tables[0].layout.names if tables else ()
    if any(rows.layout.names != names for rows in tables):
        raise RecordingError(recording.path, f"the joints on {topic} change their names")
    parts = [joint_parts(rows) for rows in tables]
    values = [_joined([part[i] for part in parts], (0, len(names))) for i in range(3)]
    times = [_joined([getattr(rows, key) for rows in tables], (0,), np.int64) for key in ("log_time", "stamp")]
    return JointSeries(topic, *times, names, *values)


def joint_parts(rows: Rows) -> list[np.ndarray]:
    """Position, velocity and effort of joint states, (n, joints) each; NaN where the message has none."""
    found, at = [], 0
    for _, count in rows.layout.blocks:
        missing = np.full((len(rows.values), len(rows.layout.names)), np.nan)
        found.append(rows.values[:, at : at + count] if count else missing)
        at += count
    return found


def _joined(pieces: list[np.ndarray], empty: tuple, kind=float) -> np.ndarray:
    whole = np.concatenate(pieces) if pieces else np.empty(empty, kind)
    whole.setflags(write=False)
    return whole
