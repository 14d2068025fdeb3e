"""Time series of a topic as arrays."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.cdr import layout_of, unpack_alike, unpack_stamped

__all__ = ["FIXED", "Series", "series", "several", "stamped"]

BEARABLE, MOST_UNFOLDED = 64 * 1024 * 1024, 50  # [bytes] of a series, and what it may take beside, in sizes of the file
TOGETHER = 1024 * 1024  # [bytes] of messages
#: type -> (column, unit) of the numbers behind its header
FIXED = {
    "geometry_msgs/msg/PoseStamped": (
        [(f"position_{a}", "m") for a in "xyz"] + [(f"orientation_{a}", "") for a in "xyzw"]
    ),
    "geometry_msgs/msg/WrenchStamped": [(f"force_{a}", "n") for a in "xyz"] + [(f"torque_{a}", "n_m") for a in "xyz"],
    # the deflection: a small displacement and rotation in place of velocities
    "geometry_msgs/msg/TwistStamped": [(f"linear_{a}", "") for a in "xyz"] + [(f"angular_{a}", "") for a in "xyz"],
}


class Series(NamedTuple):
    """A topic of one of the FIXED types; its arrays are read-only."""

    stamp: np.ndarray  #: [ns], (n,) int64
    values: np.ndarray  #: SI units, (n, 7) position and quaternion x y z w, or (n, 6) translations before rotations


def series(recording, topic: str) -> Series:
    """A PoseStamped, WrenchStamped or TwistStamped topic as arrays. Raises RecordingError."""
    return several(recording, [topic])[0]


def several(recording, topics: Sequence[str], others: Mapping[str, Callable[[bytes], object]] = MappingProxyType({})
            ) -> list[Series]:  # fmt: skip
    """Topics of the FIXED types as arrays, all out of one pass through the file.

    others: what takes each message of further topics. Raises RecordingError.
    """
    widths = {topic: _width(recording, topic) for topic in topics}
    rows = {topic: _Rows(recording, topic, width) for topic, width in widths.items()}
    for message in recording.messages({*topics, *others}, as_written=True):
        (others.get(message.topic) or rows[message.topic].add)(message.data)
    return [rows[topic].series() for topic in topics]


class _Rows:
    """Gathers a topic. Messages of one layout that follow each other are taken apart together."""

    def __init__(self, recording, topic: str, width: int):
        self.recording, self.topic, self.width = recording, topic, width
        self.most = (BEARABLE + MOST_UNFOLDED * recording.size) // 8  # numbers
        self.layout: tuple = ()
        self.waiting: list[bytes] = []
        self.count = 0  # of numbers
        self.stamps, self.values = [np.empty(0, np.int64)], [np.empty((0, width))]

    def add(self, data: bytes) -> None:
        if (layout := layout_of(data)) != self.layout or len(self.waiting) * len(data) > TOGETHER:
            self._unpack()
            self.layout = layout
        self.waiting.append(data)

    def _unpack(self) -> None:
        if not self.waiting:
            return
        with _told(self.recording, self.topic):
            stamps, values = unpack_alike(self.waiting, self.width)
        self.waiting.clear()
        self.stamps.append(stamps)
        self.values.append(values)
        self.count += values.size
        if self.count > self.most:
            size = f"{8 * self.most} bytes, {MOST_UNFOLDED} times the size of the file"
            raise RecordingError(self.recording.path, f"{self.topic} unfolds into more than {size}")

    def series(self) -> Series:
        self._unpack()
        found = Series(np.concatenate(self.stamps), np.concatenate(self.values))
        for column in found:
            column.setflags(write=False)
        return found


def stamped(recording, topic: str) -> Iterator[tuple[int, int, str, list[float]]]:
    """Log time [ns], stamp [ns], frame and numbers of every message of a topic as they were written.

    Raises RecordingError where one is not what its type says.
    """
    width = _width(recording, topic)
    for message in recording.messages([topic], as_written=True):
        with _told(recording, topic):
            found = unpack_stamped(message.data, width, alone=True)
        yield message.log_time, *found


def _width(recording, topic: str) -> int:
    about = recording.topics().get(topic)
    if about is None:
        raise RecordingError(recording.path, f"has no topic {topic}")
    if about.encoding != "cdr" or about.type not in FIXED:
        raise RecordingError(recording.path, f"{topic} is {about.type or 'of no type'}, which is no series of numbers")
    return len(FIXED[about.type])


@contextlib.contextmanager
def _told(recording, topic: str) -> Iterator[None]:
    """A ValueError of a message as a RecordingError."""
    try:
        yield
    except ValueError as error:
        kind = recording.topics()[topic].type
        raise RecordingError(recording.path, f"a message on {topic} is not a {kind}: {error}") from error
