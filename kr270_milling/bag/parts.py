"""The passes of a recording: the nodes may be started again while one recorder runs, and then time begins again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from kr270_milling.bag.gaps import SHARED, Passes
from kr270_milling.bag.reader import BEGIN, END, Place, Recording

__all__ = ["Part", "parts"]


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
    topics = {number: channel.topic for number, channel in recording.contents.channels.items()}
    begin, first, last, number = BEGIN, None, 0, 0
    with recording.sentences():
        for entry, _ in recording.entries(recording.chunks, True):
            topic, log_time = topics[entry.channel], entry.log_time
            if topic in passes and passes[topic].begins(log_time) and passes[topic].number > number:
                yield begin, first or 0, last
                begin, first, last, number = (entry.chunk, entry.begin), None, 0, number + 1
            first, last = log_time if first is None else min(first, log_time), max(last, log_time)
    if first is not None:
        yield begin, first, last
