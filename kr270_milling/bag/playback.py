"""What to play of a recording and when: options, order and the clock of a playback. No ROS."""

from __future__ import annotations

from collections.abc import Iterator

from kr270_milling.bag.bagmeta import read_qos
from kr270_milling.bag.parts import parts
from kr270_milling.bag.play_options import MOST, PlayOptions
from kr270_milling.bag.reader import RawMessage, Recording
from kr270_milling.base.errors import InputError
from kr270_milling.messages.decode import Topic

__all__ = ["PlayClock", "is_latched", "opening", "passage", "span"]


class PlayClock:
    """Where a playback is [ns of log time], from readings [s] of any clock that does not go back."""

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


def is_latched(about: Topic) -> bool:
    """Whether every publisher of a recorded topic kept its last message for who comes late."""
    profiles = read_qos(about.metadata.get("offered_qos_profiles", ""))
    # rosbag2 writes words since Jazzy and the numbers of the middleware before
    return bool(profiles) and all(p.get("durability") in ("transient_local", 1) for p in profiles)


def _ns(option: str, seconds: float) -> int:
    if not 0.0 <= seconds <= MOST:
        raise InputError(option, f"{seconds:g} s is no time in a recording, which are those from 0 to {MOST:g} s")
    return round(seconds * 1e9)


def span(recording: Recording, options: PlayOptions) -> tuple[int, int]:
    """First time and the one behind the last [ns] of what is played; passes follow each other. Raises InputError."""
    found = parts(recording)
    start = found[0].first + _ns("--start-offset", options.start_offset)
    end = found[-1].last + found[-1].shift + 1
    if options.playback_duration is not None:
        end = min(end, start + _ns("--playback-duration", options.playback_duration) + 1)
    return start, end


def _latched(recording: Recording, topics: set[str]) -> set[str]:
    return {t for t, about in recording.topics().items() if t in topics and is_latched(about)}


def opening(recording: Recording, start: int, topics: set[str]) -> list[RawMessage]:
    """The last message from before ``start`` of each latched topic: what a late joiner would have got then."""
    latched = _latched(recording, topics)
    last: dict[str, RawMessage] = {}
    for part in parts(recording) if latched else ():
        if part.first + part.shift < start:
            for message in recording.messages(latched, end=start - part.shift, within=part.within):
                last[message.topic] = message
    return list(last.values())


def passage(recording: Recording, start: int, end: int, topics: set[str]) -> Iterator[RawMessage]:
    """What is played, one pass after the other; log times go on from pass to pass. Latched topics come first where
    several stand at the first moment."""
    latched = _latched(recording, topics)
    for part in parts(recording):
        begin, behind = max(start - part.shift, part.first), end - part.shift
        for message in _of_part(recording, part.within, begin, behind, topics, latched):
            yield message._replace(log_time=message.log_time + part.shift)


def _of_part(recording: Recording, within, begin: int, end: int, topics: set[str], latched: set[str]):
    if begin >= end:
        return
    if latched:
        yield from recording.messages(latched, start=begin, end=begin + 1, within=within)
    for message in recording.messages(topics, start=begin, end=end, within=within):
        if message.log_time > begin or message.topic not in latched:
            yield message
