"""What to play of a recording and when: its passes one after the other, and the clock of a playback. No ROS.

The nodes may be started again while one recorder runs, and then time begins again: each time is a pass of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from kr270_milling.bag.bagmeta import read_qos
from kr270_milling.bag.play_options import MOST, PlayOptions
from kr270_milling.bag.reader import BEGIN, END, Place, RawMessage, Recording
from kr270_milling.bag.stamps import SHARED, Passes
from kr270_milling.base.errors import InputError
from kr270_milling.messages.definitions import Topic

__all__ = ["Part", "PlayClock", "is_latched", "opening", "parts", "passage", "span"]


@dataclass(frozen=True)
class Part:
    """One pass."""

    within: tuple[Place, Place]  #: place of its first message and the one behind its last
    first: int  #: [ns], smallest and largest log time
    last: int
    shift: int  #: [ns], what brings its log times behind those of the pass before


_known: WeakKeyDictionary[Recording, tuple[Part, ...]] = WeakKeyDictionary()


def parts(recording: Recording) -> tuple[Part, ...]:
    """The passes in the order of the file; a recording without any is one part. Raises RecordingError."""
    if recording not in _known:
        _known[recording] = _find(recording)
    return _known[recording]


def _find(recording: Recording) -> tuple[Part, ...]:
    whole = Part((BEGIN, END), recording.first_log_time or 0, recording.last_log_time or 0, 0)
    if whole.first > 0:  # on a clock that does not begin at 0 no pass begins there either
        return (whole,)
    found: list[Part] = []
    shift = 0
    begins = list(_beginnings(recording))
    ends = [*(begin for begin, _, _ in begins[1:]), END]
    for (begin, first, last), end in zip(begins, ends, strict=True):
        found.append(Part((begin, end), first, last, shift))
        shift += last + 1
    return tuple(found) or (whole,)


def _beginnings(recording: Recording) -> Iterator[tuple[Place, int, int]]:
    """Place, smallest and largest log time of every pass: one begins with the first topic whose time goes back to 0."""
    types = {name: about.type for name, about in recording.topics().items()}
    passes = {name: Passes() for name, kind in types.items() if kind not in SHARED}
    topics = {number: channel.topic for number, channel in recording.channels.items()}
    begin, first, last, number = BEGIN, None, 0, 0
    with recording.sentences():
        for entry in recording.entries(recording.chunks, True):
            topic, log_time = topics[entry.channel], entry.log_time
            if topic in passes and passes[topic].begins(log_time) and passes[topic].number > number:
                yield begin, first or 0, last
                begin, first, last, number = entry.place, None, 0, number + 1
            first, last = log_time if first is None else min(first, log_time), max(last, log_time)
    if first is not None:
        yield begin, first, last


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
