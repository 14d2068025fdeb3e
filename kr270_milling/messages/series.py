"""Time series of a topic as arrays: the messages' bytes are read in place, a few thousand at a time.

Messages of one length whose frames have names of one length have all numbers in the same places, so that numpy reads
them as the rows of a table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.cdr import places_behind_header

__all__ = ["FIXED", "Series", "batches", "series", "several"]

BEARABLE, MOST_UNFOLDED = 64 * 1024 * 1024, 50  # [bytes] of a series, and what it may take beside, in sizes of the file
LAYOUT = 30.0  # [us] of work on messages of one layout in a row
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


class Series(NamedTuple):
    """A topic of one of the FIXED types; its arrays are read-only."""

    stamp: np.ndarray  #: [ns], (n,) int64
    values: np.ndarray  #: SI units, (n, 7) position and quaternion x y z w, or (n, 6) translations before rotations


def batches(recording, topic: str) -> Iterator[Rows]:
    """The messages of a topic as they were written, in tables of up to 4096 rows or 4 MB.

    Raises RecordingError where one is not what its type says.
    """
    _check(recording, topic)
    for _, times, table in recording.tables([topic]):
        yield from _tables(recording, topic, times, table)


def _check(recording, topic: str) -> None:
    about = recording.topics().get(topic)
    if about is None:
        raise RecordingError(recording.path, f"has no topic {topic}")
    if about.encoding != "cdr" or about.type not in FIXED:
        raise RecordingError(recording.path, f"{topic} is {about.type or 'of no type'}, which is no series of numbers")


def _tables(recording, topic: str, times: np.ndarray, table: np.ndarray) -> Iterator[Rows]:
    """Messages of one length, (n, width); rows of another layout begin a new table."""
    kind, begin = recording.topics()[topic].type, 0
    while begin < len(table):
        recording.spend(LAYOUT)
        try:
            places = places_behind_header(table[begin].tobytes(), len(FIXED[kind]))
        except ValueError as error:
            raise RecordingError(recording.path, f"a message on {topic} is not a {kind}: {error}") from error
        # byte order and length of the frame's name
        same = (table[begin:, [0, 1, 12, 13, 14, 15]] == table[begin, [0, 1, 12, 13, 14, 15]]).all(axis=1)
        end = len(table) if same.all() else begin + int(np.argmin(same))
        yield _rows(table[begin:end], times[begin:end], *places)
        begin = end


def _rows(table: np.ndarray, times: np.ndarray, order: str, text: slice, numbers: slice) -> Rows:
    def read(where: slice, kind: str) -> np.ndarray:
        return np.ascontiguousarray(table[:, where]).view(order + kind)

    stamp = read(slice(4, 8), "i4")[:, 0].astype(np.int64) * 10**9 + read(slice(8, 12), "u4")[:, 0]
    names = table[:, text]
    few = names[:1] if (names == names[0]).all() else names
    frames = [name.tobytes().decode("utf-8", "replace") for name in few] * (len(names) // len(few))
    return Rows(times, stamp, frames, read(numbers, "f8").astype(float))


def series(recording, topic: str) -> Series:
    """A PoseStamped, WrenchStamped or TwistStamped topic as arrays. Raises RecordingError."""
    return several(recording, [topic])[0]


def several(recording, topics: Sequence[str], others: Mapping[str, Callable[[bytes], object]] = MappingProxyType({})
            ) -> list[Series]:  # fmt: skip
    """Topics of the FIXED types as arrays, all out of one pass through the file.

    others: what takes each message of further topics. Raises RecordingError.
    """
    for topic in topics:
        _check(recording, topic)
    found: dict[str, list[Series]] = {topic: [] for topic in topics}
    sizes = dict.fromkeys(topics, 0)
    for topic, times, table in recording.tables({**found, **others}):
        for row in table if topic in others else ():
            others[topic](row.tobytes())
        for rows in _tables(recording, topic, times, table) if topic in found else ():
            found[topic].append(Series(rows.stamp, rows.values))
            sizes[topic] += rows.values.nbytes
            if sizes[topic] > BEARABLE + MOST_UNFOLDED * recording.size:
                most = f"{sizes[topic]} bytes, {MOST_UNFOLDED} times the size of the file"
                raise RecordingError(recording.path, f"{topic} unfolds into more than {most}")
    return [_joined(found[topic], len(FIXED[recording.topics()[topic].type])) for topic in topics]


def _joined(rows: list[Series], width: int) -> Series:
    stamps = np.concatenate([np.empty(0, np.int64), *(part.stamp for part in rows)])
    found = Series(stamps, np.concatenate([np.empty((0, width)), *(part.values for part in rows)]))
    for array in found:
        array.setflags(write=False)
    return found
