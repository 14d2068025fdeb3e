"""Messages of a playback and their times, and the clock. No ROS."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from kr270_milling.base.units import SECOND
from kr270_milling.recordings.bag.bagmeta import all_latched, read_qos
from kr270_milling.recordings.bag.reader import RawMessage, RecordedTopic, Recording

__all__ = ["PlayClock", "is_latched", "playback", "span"]


class PlayClock:
    """Position of a playback [ns of log time], from readings [s] of any clock that does not go back."""

    def __init__(self, start: int, rate: float, now: float, paused: bool = False):
        self.rate, self.paused = rate, paused
        self._position, self._since = start, now

    def position(self, now: float) -> int:
        if self.paused:
            return self._position
        return self._position + int(max(now - self._since, 0.0) * self.rate * 1e9)

    def pause(self, now: float) -> None:
        self._position, self.paused = self.position(now), True

    def resume(self, now: float) -> None:
        self._position, self._since, self.paused = self.position(now), now, False


def is_latched(about: RecordedTopic) -> bool:
    """Return whether every publisher of a recorded topic repeats its last message for late subscribers."""
    return all_latched(read_qos(about.metadata.get("offered_qos_profiles", "")))


def span(recording: Recording, start_offset: float, duration: float | None) -> tuple[int, int]:
    """Return first and last log time [ns] of a playback; offset and duration (None: to the end) in s."""
    first = next((message.log_time for message in recording.messages()), 0)
    start, last = first + round(start_offset * SECOND), recording.last_log_time or 0
    return start, last if duration is None else min(last, start + round(duration * SECOND))


def playback(recording: Recording, topics: Collection[str], start: int, end: int) -> Iterator[RawMessage]:
    """Yield the messages of some topics with log times from ``start`` to ``end``, in the order of the file.

    The last message before on each latched topic comes first, as for a late subscriber. The times never decrease, also
    where messages of another recorder are not in the order of their log times. Raises RecordingError.
    """
    known, latest = recording.topics(), 0
    before: dict[str, RawMessage] = {}  # the last message before the start, of latched topics
    for message in recording.messages(topics):
        latest = max(latest, message.log_time)
        if latest > end:
            break
        if latest >= start:
            yield from before.values()
            before.clear()
            yield message._replace(log_time=latest)
        elif is_latched(known[message.topic]):
            before[message.topic] = message
    yield from before.values()
