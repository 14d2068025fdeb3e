"""Messages of a playback and their times: the passes one after the other, and the clock. No ROS.

A recorder may run while the nodes restart. Then time returns to 0, and each time is a separate pass.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from typing import NamedTuple

from kr270_milling.base.errors import InputError
from kr270_milling.recordings.bag.bagmeta import read_qos
from kr270_milling.recordings.bag.chunks import BEGIN, END, MessagePlace
from kr270_milling.recordings.bag.play_options import MOST, PlayOptions
from kr270_milling.recordings.bag.reader import RawMessage, RecordedTopic, Recording
from kr270_milling.recordings.bag.stamps import SHARED, Passes

__all__ = ["PassSpan", "PlayClock", "is_latched", "opening", "pass_spans", "passage", "span"]


class PassSpan(NamedTuple):
    """The messages of one pass in a recording."""

    within: tuple[MessagePlace, MessagePlace]  #: place of the first message, and the place after the last
    first: int  #: [ns], smallest and largest log time
    last: int
    shift: int  #: [ns], added to its log times so that they follow those of the pass before


@functools.lru_cache(maxsize=8)
def pass_spans(recording: Recording) -> tuple[PassSpan, ...]:
    """The passes in the order of the file: a pass begins with the first topic whose time returns to 0.

    A recording without messages, or on a clock that does not begin at 0, is one span. Raises RecordingError.
    """
    whole = PassSpan((BEGIN, END), recording.first_log_time or 0, recording.last_log_time or 0, 0)
    if whole.first > 0 or not recording.count:
        return (whole,)
    counters = {name: Passes() for name, about in recording.topics().items() if about.type not in SHARED}
    bounds: list[tuple[MessagePlace, int, int]] = []  # place of the first message, smallest and largest log time
    begin, first, last = BEGIN, 2**63, 0
    for message in recording.messages(as_written=True):
        counter, time = counters.get(message.topic), message.log_time
        if counter and counter.begins(time) and counter.number > len(bounds):
            bounds.append((begin, first, last))
            begin, first, last = message.place, time, time
        first, last = min(first, time), max(last, time)
    bounds.append((begin, first, last))
    spans, shift = [], 0
    ends = [*(place for place, _, _ in bounds[1:]), END]
    for (begin, first, last), end in zip(bounds, ends, strict=True):
        spans.append(PassSpan((begin, end), first, last, shift))
        shift += last + 1
    return tuple(spans)


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
    """Whether every publisher of a recorded topic repeats its last message for late subscribers."""
    profiles = read_qos(about.metadata.get("offered_qos_profiles", ""))
    # rosbag2 writes words since Jazzy and the numbers of the middleware before
    return bool(profiles) and all(p.get("durability") in ("transient_local", 1) for p in profiles)


def _ns(option: str, seconds: float) -> int:
    if not 0.0 <= seconds <= MOST:
        raise InputError(option, f"{seconds:g} s is not a time in a recording; allowed are 0 to {MOST:g} s")
    return round(seconds * 1e9)


def span(recording: Recording, options: PlayOptions) -> tuple[int, int]:
    """First time of a playback and the time after its last [ns]; passes follow each other. Raises InputError."""
    spans = pass_spans(recording)
    start = spans[0].first + _ns("--start-offset", options.start_offset)
    end = spans[-1].last + spans[-1].shift + 1
    if options.playback_duration is not None:
        end = min(end, start + _ns("--playback-duration", options.playback_duration) + 1)
    return start, end


def _latched(recording: Recording, topics: set[str]) -> set[str]:
    return {t for t, about in recording.topics().items() if t in topics and is_latched(about)}


def opening(recording: Recording, start: int, topics: set[str]) -> list[RawMessage]:
    """The last message before ``start`` on each latched topic: what a late subscriber receives at that time."""
    latched = _latched(recording, topics)
    last: dict[str, RawMessage] = {}
    for one in pass_spans(recording) if latched else ():
        if one.first + one.shift < start:
            for message in recording.messages(latched, end=start - one.shift, within=one.within):
                last[message.topic] = message
    return list(last.values())


def passage(recording: Recording, start: int, end: int, topics: set[str]) -> Iterator[RawMessage]:
    """The messages of a playback, pass after pass, with log times that increase from pass to pass.

    Of several messages at the first moment, those on latched topics come first.
    """
    latched = _latched(recording, topics)
    for one in pass_spans(recording):
        begin, after = max(start - one.shift, one.first), end - one.shift
        if begin >= after:
            continue
        at_first = recording.messages(latched, start=begin, end=begin + 1, within=one.within) if latched else ()
        rest = (m for m in recording.messages(topics, start=begin, end=after, within=one.within)
                if m.log_time > begin or m.topic not in latched)  # fmt: skip
        for message in itertools.chain(at_first, rest):
            yield message._replace(log_time=message.log_time + one.shift)
