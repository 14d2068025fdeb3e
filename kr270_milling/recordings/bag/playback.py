"""Messages of a playback and their times, and the clock. No ROS."""

from __future__ import annotations

from collections.abc import Iterator

from kr270_milling.base.errors import InputError
from kr270_milling.recordings.bag.bagmeta import all_latched, read_qos
from kr270_milling.recordings.bag.play_options import MOST, PlayOptions
from kr270_milling.recordings.bag.reader import RawMessage, RecordedTopic, Recording

__all__ = ["PlayClock", "is_latched", "opening", "passage", "span", "timeline"]


def timeline(recording: Recording) -> Iterator[RawMessage]:
    """Yield the messages in the order of the file, with the log times [ns] at which they are played.

    These times never decrease, also where messages of another recorder are not in the order of their log times. Raises
    RecordingError.
    """
    latest = 0
    for message in recording.messages():
        latest = max(latest, message.log_time)
        yield message._replace(log_time=latest)


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


def _ns(option: str, seconds: float) -> int:
    if not 0.0 <= seconds <= MOST:
        raise InputError(option, f"{seconds:g} s is not a time in a recording; allowed are 0 to {MOST:g} s")
    return round(seconds * 1e9)


def span(recording: Recording, options: PlayOptions) -> tuple[int, int]:
    """First time of a playback and the time after its last [ns]. Raises InputError, RecordingError."""
    first = next((message.log_time for message in timeline(recording)), 0)
    start = first + _ns("--start-offset", options.start_offset)
    last = recording.last_log_time or 0
    if options.playback_duration is not None:
        last = min(last, start + _ns("--playback-duration", options.playback_duration))
    return start, last + 1


def _latched(recording: Recording, topics: set[str]) -> set[str]:
    return {t for t, about in recording.topics().items() if t in topics and is_latched(about)}


def opening(recording: Recording, start: int, topics: set[str]) -> list[RawMessage]:
    """The last message up to ``start`` on each latched topic: what a late subscriber receives at that time."""
    latched = _latched(recording, topics)
    last: dict[str, RawMessage] = {}
    for message in timeline(recording) if latched else ():
        if message.log_time > start:
            break
        if message.topic in latched:
            last[message.topic] = message
    return list(last.values())


def passage(recording: Recording, start: int, end: int, topics: set[str]) -> Iterator[RawMessage]:
    """The messages of a playback from ``start`` on, after those of ``opening``, up to ``end``."""
    latched = _latched(recording, topics)
    for message in timeline(recording):
        time = message.log_time
        if time >= end:
            return
        if message.topic in topics and (time > start or (time == start and message.topic not in latched)):
            yield message
