"""Topics of a recording as arrays: messages that consist of a header and numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.mcap_file import OnDamage
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import layout_of, unpack_alike

__all__ = ["FIXED", "TopicSeries", "series", "several"]

#: type -> (column, unit) of the numbers after its header
FIXED = {
    "geometry_msgs/msg/PoseStamped": (
        [(f"position_{a}", "m") for a in "xyz"] + [(f"orientation_{a}", "") for a in "xyzw"]
    ),
    "geometry_msgs/msg/WrenchStamped": [(f"force_{a}", "n") for a in "xyz"] + [(f"torque_{a}", "n_m") for a in "xyz"],
    # the deflection: a small displacement and rotation in the fields of velocities
    "geometry_msgs/msg/TwistStamped": [(f"linear_{a}", "") for a in "xyz"] + [(f"angular_{a}", "") for a in "xyz"],
}


class TopicSeries(NamedTuple):
    """A topic of one of the FIXED types; the arrays are read-only."""

    stamp: np.ndarray  #: [ns], (n,) int64
    values: np.ndarray  #: SI units, (n, 7) position and quaternion x y z w, or (n, 6) translations before rotations


def series(recording: Recording, topic: str) -> TopicSeries:
    """Read a PoseStamped, WrenchStamped or TwistStamped topic as arrays. Raises RecordingError."""
    return several(recording, [topic])[0]


def several(
    recording: Recording,
    topics: Sequence[str],
    others: Mapping[str, Callable[[bytes], object]] = MappingProxyType({}),
    frame: str | None = None,
    on_damage: OnDamage | None = None,
) -> list[TopicSeries]:
    """Read topics of the FIXED types as arrays in one pass through the file.

    others: topic -> a function that receives each message of a further topic. A message that is not of the type of its
    topic, or not in ``frame`` if it is given, is left out. on_damage: see ``Recording.messages``. Raises RecordingError
    where no message of a topic can be read.
    """
    batches = {topic: _Batch(recording, topic, frame) for topic in topics}
    receivers = {**{topic: batch.add for topic, batch in batches.items()}, **others}
    known = recording.topics()
    fits = {n: recording.schema_of(c).name == known[c.topic].type for n, c in recording.channels.items()}
    for message in recording.messages(set(receivers), on_damage):
        if fits[message.channel]:
            receivers[message.topic](message.data)
    return [batches[topic].series() for topic in topics]


class _Batch:
    """Collects a topic and unpacks consecutive messages of one layout together."""

    def __init__(self, recording: Recording, topic: str, frame: str | None = None):
        self._recording, self._topic, self._width = recording, topic, _width(recording, topic)
        self._frame = frame
        self._layout: tuple = ()
        self._refused: ValueError | None = None
        self._waiting: list[bytes] = []
        self._stamps, self._values = [np.empty(0, np.int64)], [np.empty((0, self._width))]

    def add(self, data: bytes) -> None:
        if (layout := layout_of(data)) != self._layout or len(self._waiting) * len(data) > 1024 * 1024:  # a MB
            self._unpack()
            self._layout = layout
        self._waiting.append(data)

    def _unpack(self) -> None:
        if not self._waiting:
            return
        messages, self._waiting = self._waiting, []
        try:
            frame, stamps, values = unpack_alike(messages, self._width)
        except ValueError as error:  # of another publisher
            self._refused = error
            return
        if self._frame not in (None, frame):
            return
        self._stamps.append(stamps)
        self._values.append(values)

    def series(self) -> TopicSeries:
        self._unpack()
        if self._refused and len(self._stamps) == 1:
            kind = self._recording.topics()[self._topic].type
            reason = f"a message on {self._topic} is not a {kind}: {self._refused}"
            raise RecordingError(self._recording.path, reason) from self._refused
        result = TopicSeries(np.concatenate(self._stamps), np.concatenate(self._values))
        for column in result:
            column.setflags(write=False)
        return result


def _width(recording: Recording, topic: str) -> int:
    about = recording.topics().get(topic)
    if about is None:
        raise RecordingError(recording.path, f"has no topic {topic}")
    if about.encoding != "cdr" or about.type not in FIXED:
        raise RecordingError(recording.path, f"{topic} is {about.type or 'of no type'}, which is no series of numbers")
    return len(FIXED[about.type])
