"""Time series of a topic as arrays: the messages' bytes are read in place, a few thousand at a time.

Messages of one length whose frames have names of one length have all numbers in the same places, so that numpy reads
them as the rows of a table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.cdr import Cursor

__all__ = ["FIXED", "Series", "batches", "series"]

BATCH, BATCH_BYTES = 4096, 4 * 1024 * 1024
BEARABLE, MOST_UNFOLDED = 64 * 1024 * 1024, 50  # [bytes] of a series, and what it may take beside, in sizes of the file
LAYOUT = 30.0  # [us] of work on messages of one layout in a row
MOST_FRAMES = 1024 * 1024  # [characters] of the names of all frames on one topic
#: type -> (column, unit) of the numbers behind its header
FIXED = {
    "geometry_msgs/msg/PoseStamped": (
        [(f"position_{a}", "m") for a in "xyz"] + [(f"orientation_{a}", "") for a in "xyzw"]
    ),
    "geometry_msgs/msg/WrenchStamped": [(f"force_{a}", "n") for a in "xyz"] + [(f"torque_{a}", "n_m") for a in "xyz"],
    # the deflection: a small displacement and rotation in place of velocities
    "geometry_msgs/msg/TwistStamped": [(f"linear_{a}", "") for a in "xyz"] + [(f"angular_{a}", "") for a in "xyz"],
}


class Rows(NamedTuple):
    """Consecutive messages of one layout: times [ns] (n,), frames and a table of doubles (n, columns)."""

    log_time: np.ndarray
    stamp: np.ndarray
    frame_ids: list[str]
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


def batches(recording, topic: str) -> Iterator[Rows]:
    """The messages of a topic as they were written, in tables of up to 4096 rows or 4 MB.

    Raises RecordingError where one is not what its type says.
    """
    about = recording.topics().get(topic)
    if about is None:
        raise RecordingError(recording.path, f"has no topic {topic}")
    if about.encoding != "cdr" or about.type not in FIXED:
        raise RecordingError(recording.path, f"{topic} is {about.type or 'of no type'}, which is no series of numbers")
    waiting: list = []
    for message in recording.messages([topic], as_written=True):
        size = len(message.data)
        full = len(waiting) == BATCH or (len(waiting) + 1) * size > BATCH_BYTES
        if waiting and (full or size != len(waiting[0].data)):
            yield from _tables(recording, topic, waiting)
            waiting = []
        waiting.append(message)
    if waiting:
        yield from _tables(recording, topic, waiting)


def _tables(recording, topic: str, messages: list) -> Iterator[Rows]:
    """Messages of one length as tables; rows of another layout begin a new one."""
    kind, width = recording.topics()[topic].type, len(messages[0].data)
    table = np.frombuffer(b"".join(m.data for m in messages), np.uint8).reshape(len(messages), width)
    times = np.array([m.log_time for m in messages], np.uint64).astype(np.int64)
    begin = 0
    while begin < len(messages):
        recording.spend(LAYOUT)
        try:
            text, numbers = _layout(messages[begin].data, len(FIXED[kind]))
        except ValueError as error:
            raise RecordingError(recording.path, f"a message on {topic} is not a {kind}: {error}") from error
        # byte order and length of the frame's name
        same = (table[begin:, [0, 1, 12, 13, 14, 15]] == table[begin, [0, 1, 12, 13, 14, 15]]).all(axis=1)
        end = len(messages) if same.all() else begin + int(np.argmin(same))
        yield _rows(table[begin:end], times[begin:end], text, numbers)
        begin = end


def _layout(data: bytes, count: int) -> tuple[slice, slice]:
    """Where the name of the frame and the numbers behind it stand; raises ValueError where they do not."""
    cursor = Cursor(data)
    cursor.number("i"), cursor.number("I")
    cursor.string()
    text = slice(16, cursor.offset - 1)  # without the closing NUL
    cursor.align(8)
    begin = cursor.skip(8 * count)
    cursor.finish()
    return text, slice(begin, cursor.offset)


def _rows(table: np.ndarray, times: np.ndarray, text: slice, numbers: slice) -> Rows:
    order = "<" if table[0, 1] else ">"

    def read(where: slice, kind: str) -> np.ndarray:
        return np.ascontiguousarray(table[:, where]).view(order + kind)

    stamp = read(slice(4, 8), "i4")[:, 0].astype(np.int64) * 10**9 + read(slice(8, 12), "u4")[:, 0]
    names = table[:, text]
    few = names[:1] if (names == names[0]).all() else names
    frames = [name.tobytes().decode("utf-8", "replace") for name in few] * (len(names) // len(few))
    return Rows(times, stamp, frames, read(numbers, "f8").astype(float))


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
    times, stamps = (_joined(list(column), (0,), np.int64) for column in (log_time, stamp))
    return Series(topic, about.type, times, stamps, tuple(frames), _joined(list(values), (0, len(FIXED[about.type]))))


def _joined(pieces: list[np.ndarray], empty: tuple, kind=float) -> np.ndarray:
    whole = np.concatenate(pieces) if pieces else np.empty(empty, kind)
    whole.setflags(write=False)
    return whole
