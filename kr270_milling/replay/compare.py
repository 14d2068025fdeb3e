"""Recorded messages against recomputed ones, topic by topic, bit for bit."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from kr270_milling.bag.errors import RecordingError
from kr270_milling.bag.gaps import GapCounter, Passes
from kr270_milling.messages.decode import plain
from kr270_milling.messages.encode import Encoded

__all__ = ["Channel", "Difference", "first_difference"]


@dataclass(frozen=True)
class Difference:
    """The first message of a topic that is not what the models make."""

    topic: str
    index: int  #: of the message on its topic, from 0
    stamp_ns: int
    field: str
    recorded: object
    recomputed: object  #: None: nothing was to be published then
    order: tuple = ()  #: sorts the differences of several topics by time and by cause

    def __str__(self) -> str:
        return (
            f"{self.topic}, message {self.index} at {self.stamp_ns * 1e-9:.6f} s: {self.field} is {self.recorded!r} "
            f"in the recording and {self.recomputed!r} recomputed"
        )


class Heard(NamedTuple):
    order: tuple
    index: int
    stamp: int
    data: bytes


class Made(NamedTuple):
    order: tuple
    stamp: int
    message: Encoded


class Channel:
    """One topic: what was recorded and what is recomputed, each in its own order, matched by pass and stamp.

    The two need not come in step: whoever is ahead waits. rank: place of the topic in the chain of causes.
    """

    def __init__(self, topic: str, rank: int = 0, decode: Callable[[bytes], object] | None = None):
        self.topic, self.rank, self._decode = topic, rank, decode
        self.compared = self.differing = 0
        self.missing = 0  #: recomputed, but not in the recording
        self.repeated = 0  #: the same message once more: a retry
        self.given = 0  #: taken as they are, because their cause is not in the recording
        self.first: Difference | None = None
        self._heard: deque[Heard] = deque()
        self._made: deque[Made] = deque()
        self._heard_passes, self._made_passes = Passes(), Passes()
        self._index, self._last, self._last_made = -1, b"", None
        self.holes = GapCounter()  #: told by the recorded stamps alone
        self._skipped = 0  # missing although later ones of the same pass are there
        self._tails: list[tuple[int, int]] = []  # (pass, stamp) of those behind the last recorded one of their pass
        self._ends: dict[int, int] = {}  # pass -> latest recomputed stamp

    def heard(self, stamp: int, data: bytes) -> None:
        """Take the next recorded message."""
        self._index += 1
        self._heard_passes.begins(stamp)
        self.holes.add(stamp)
        self._heard.append(Heard((self._heard_passes.number, stamp), self._index, stamp, data))
        self._match()

    def take(self, data: bytes) -> None:
        """Take the next recorded message as it is."""
        self._index += 1
        self.given += 1
        self._last = data

    def made(self, stamp: int, message: Encoded) -> None:
        """Take the next recomputed message."""
        self._made_passes.begins(stamp)
        self._ends[self._made_passes.number] = stamp
        self._made.append(Made((self._made_passes.number, stamp), stamp, message))
        self._match()

    @property
    def pending(self) -> bool:
        """Whether a recomputed message waits for the recorded one."""
        return bool(self._made)

    @property
    def waiting(self) -> int:
        """Recorded messages that nothing recomputed has come for."""
        return len(self._heard)

    def _match(self) -> None:
        while self._heard and self._made:
            heard, made = self._heard[0], self._made[0]
            if heard.order > made.order:
                self._miss(tail=heard.order[0] > made.order[0])
            elif heard.order == made.order and made.message.same(heard.data):
                self.compared += 1
                self._next(both=True)
            elif heard.data == self._last:
                self.repeated += 1
                self._next(both=False)
            else:
                self._differ(heard, made if heard.order == made.order else None)

    def _miss(self, tail: bool) -> None:
        """The next recomputed message is not in the recording; a repeated answer need not be there."""
        made, before = self._made.popleft(), self._last_made
        self._last_made = made.message
        if made.message == before:
            return
        self.missing += 1
        if tail:
            self._tails.append(made.order)
        else:
            self._skipped += 1

    def _next(self, both: bool) -> None:
        self._last = self._heard.popleft().data
        if both:
            self._last_made = self._made.popleft().message

    def _differ(self, heard: Heard, made: Made | None) -> None:
        found = ("the message", "there", None)
        if made is not None:
            found = first_difference(self._decode, heard.data, made.message.data)
        self.compared += made is not None
        self._next(both=made is not None)
        if found is None:  # other bytes, the same content: another byte order, or bytes behind the end
            return
        self.differing += 1
        if self.first is None:
            self.first = Difference(self.topic, heard.index, heard.stamp, *found, (*heard.order, self.rank))

    def finish(self) -> None:
        """No more will come: what is repeated at the end is not waiting for anything, what is not there is missing."""
        while self._heard and self._heard[0].data == self._last:
            self.repeated += 1
            self._heard.popleft()
        while self._made:
            self._miss(tail=True)
        self.holes.finish()

    @property
    def leftover(self) -> int | None:
        """Stamp [ns] of the first recorded message that nothing recomputed has come for."""
        return self._heard[0].stamp if self._heard else None

    def lacking(self, under_way: int, done: bool, iterations: int = 1) -> int:
        """Recomputed messages that the recording should have: no hole in its stamps tells of them, and they were not
        made in the last ``under_way`` [ns] of a pass that may have broken off. done: the last pass did not.
        iterations: messages of one stamp."""
        whole = self._made_passes.number if done else -1
        ends = sum(number == whole or stamp < self._ends[number] - under_way for number, stamp in self._tails)
        return ends + max(0, self._skipped - iterations * self.holes.missing)

    def as_dict(self) -> dict:
        return dict(compared=self.compared, differing=self.differing, missing=self.missing, repeated=self.repeated,
                    given=self.given, not_compared=self.waiting)  # fmt: skip


def first_difference(decode: Callable | None, recorded: bytes, recomputed: bytes) -> tuple | None:
    """(field, recorded value, recomputed value) of the first field with other bits; None if there is none."""
    try:
        if decode is None:
            raise RecordingError("", "no definition")
        return _difference("", plain(decode(recorded)), plain(decode(recomputed)))
    except RecordingError:
        at = next((i for i, (a, b) in enumerate(zip(recorded, recomputed, strict=False)) if a != b), None)
        if at is None:
            return "length in bytes", len(recorded), len(recomputed)
        return f"byte {at}", recorded[at], recomputed[at]


def _difference(path: str, a, b) -> tuple | None:
    if isinstance(a, dict) and isinstance(b, dict):
        pairs = [(f"{path}.{key}".lstrip("."), a[key], b.get(key)) for key in a]
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            return f"length of {path}", len(a), len(b)
        pairs = [(f"{path}[{i}]", x, y) for i, (x, y) in enumerate(zip(a, b, strict=True))]
    else:
        return None if _bits(a) == _bits(b) else (path, a, b)
    return next((found for pair in pairs if (found := _difference(*pair)) is not None), None)


def _bits(value):
    return struct.pack("<d", value) if isinstance(value, float) else value
