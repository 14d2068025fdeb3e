"""What to play of a recording and when: its passes one after the other, and the clock of a playback. No ROS.

The nodes may be started again while one recorder runs, and then time begins again: each time is a pass of its own.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from typing import NamedTuple

from kr270_milling.bag.bagmeta import read_qos
from kr270_milling.bag.play_options import MOST, PlayOptions
from kr270_milling.bag.reader import BEGIN, END, Place, RawMessage, Recording, Topic
from kr270_milling.bag.stamps import SHARED, Passes
from kr270_milling.base.errors import InputError

__all__ = ["Part", "PlayClock", "is_latched", "opening", "parts", "passage", "span"]


class Part(NamedTuple):
    """One pass."""

    within: tuple[Place, Place]  #: place of its first message and the one behind its last
    first: int  #: [ns], smallest and largest log time
    last: int
    shift: int  #: [ns], what brings its log times behind those of the pass before


@functools.lru_cache(maxsize=8)
def parts(recording: Recording) -> tuple[Part, ...]:
    """The passes in the order of the file: one begins with the first topic whose time goes back to 0. A recording
    without any is one part, as is one on a clock that does not begin at 0. Raises RecordingError."""
    whole = Part((BEGIN, END), recording.first_log_time or 0, recording.last_log_time or 0, 0)
    if whole.first > 0 or not recording.count:
        return (whole,)
    passes = {name: Passes() for name, about in recording.topics().items() if about.type not in SHARED}
    spans: list[tuple[Place, int, int]] = []  # place of the first message, smallest and largest log time
    begin, first, last = BEGIN, 2**63, 0
    with recording.sentences():
        for entry in recording.entries(recording.chunks, True):
            counted, time = passes.get(recording.channels[entry.channel].topic), entry.log_time
            if counted and counted.begins(time) and counted.number > len(spans):
                spans.append((begin, first, last))
                begin, first, last = entry.place, time, time
            first, last = min(first, time), max(last, time)
    spans.append((begin, first, last))
    found, shift = [], 0
    ends = [*(place for place, _, _ in spans[1:]), END]
    for (begin, first, last), end in zip(spans, ends, strict=True):
        found.append(Part((begin, end), first, last, shift))
        shift += last + 1
    return tuple(found)


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
        if begin >= behind:
            continue
        at_first = recording.messages(latched, start=begin, end=begin + 1, within=part.within) if latched else ()
        rest = (m for m in recording.messages(topics, start=begin, end=behind, within=part.within)
                if m.log_time > begin or m.topic not in latched)  # fmt: skip
        for message in itertools.chain(at_first, rest):
            yield message._replace(log_time=message.log_time + part.shift)
