"""Time series of a topic as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.cdr import unpack_stamped

__all__ = ["FIXED", "Series", "series", "several", "stamped"]

BEARABLE, MOST_UNFOLDED = 64 * 1024 * 1024, 50  # [bytes] of a series, and what it may take beside, in sizes of the file
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
    stamps = {topic: array("q") for topic in topics}
    values = {topic: array("d") for topic in topics}
    most = (BEARABLE + MOST_UNFOLDED * recording.size) // 8
    for message in recording.messages({*topics, *others}, as_written=True):
        topic = message.topic
        if topic in others:
            others[topic](message.data)
            continue
        stamp, _, numbers = _unpacked(recording, message, widths[topic])
        stamps[topic].append(stamp)
        values[topic].extend(numbers)
        if len(values[topic]) > most:
            size = f"{8 * most} bytes, {MOST_UNFOLDED} times the size of the file"
            raise RecordingError(recording.path, f"{topic} unfolds into more than {size}")
    found = [Series(np.array(stamps[t]), np.array(values[t]).reshape(-1, widths[t])) for t in topics]
    for one in (one for pair in found for one in pair):
        one.setflags(write=False)
    return found


def stamped(recording, topic: str) -> Iterator[tuple[int, int, str, list[float]]]:
    """Log time [ns], stamp [ns], frame and numbers of every message of a topic as they were written.

    Raises RecordingError where one is not what its type says.
    """
    width = _width(recording, topic)
    for message in recording.messages([topic], as_written=True):
        yield message.log_time, *_unpacked(recording, message, width)


def _width(recording, topic: str) -> int:
    about = recording.topics().get(topic)
    if about is None:
        raise RecordingError(recording.path, f"has no topic {topic}")
    if about.encoding != "cdr" or about.type not in FIXED:
        raise RecordingError(recording.path, f"{topic} is {about.type or 'of no type'}, which is no series of numbers")
    return len(FIXED[about.type])


def _unpacked(recording, message, width: int) -> tuple[int, str, list[float]]:
    try:
        return unpack_stamped(message.data, width, alone=True)
    except ValueError as error:
        kind = recording.topics()[message.topic].type
        raise RecordingError(recording.path, f"a message on {message.topic} is not a {kind}: {error}") from error
