"""Recorded messages against the records that a protocol gives, topic by topic, bit for bit."""

from __future__ import annotations

import dataclasses
import os
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kr270_milling.recordings.bag.gaps import GapCounter
from kr270_milling.recordings.bag.stamps import PassCounter
from kr270_milling.recordings.messages.codec import deserialise, to_bytes, type_of

__all__ = ["Channel", "Difference", "difference"]

EXCERPT = 40  # characters of a long text that are shown
OPTIONS = slice(2, 4)  # of the encapsulation; a publisher of plain CDR leaves them 0


@dataclass(frozen=True)
class Difference:
    """The first message of a topic that is not what the protocol gives."""

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


class Recorded(NamedTuple):
    order: tuple[int, int]  # pass and stamp [ns]
    number: int  # of the message on its topic
    data: bytes
    refused: bool


class Expected(NamedTuple):
    order: tuple[int, int]
    record: object
    due: bool


class Channel:
    """One topic: what was recorded and what is recomputed, each in its own order, matched by pass and stamp.

    Recorded and expected messages may come in any order. rank: place of the topic in the chain of causes; starts: of
    the passes [ns], ascending.
    """

    def __init__(self, topic: str, rank: int = 0, starts: Sequence[int] = ()):
        self.topic = topic
        self.rank = rank
        self.compared = 0
        self.differing = 0
        self.missing = 0  #: recomputed, but not in the recording
        self.repeated = 0  #: the same message once more: a retry
        self.given = 0  #: not compared, because their cause is not in the recording
        self.refused = 0  #: that no node can have used
        self.first: Difference | None = None
        self._abandoned = 0  # recorded in a pass that could not be recomputed to its end
        self._holes = GapCounter(starts)  # from the recorded stamps alone
        self._recorded: deque[Recorded] = deque()
        self._expected: deque[Expected] = deque()
        self._recorded_passes = PassCounter(starts)
        self._expected_passes = PassCounter(starts)
        self._index = -1
        self._last = b""  # recorded
        self._last_expected: Expected | None = None
        self._skipped = 0  # missing although later ones of the same pass are there
        self._tails: list[tuple[int, int]] = []  # (pass, stamp) of missing messages after the last recorded one
        self._ends: dict[int, int] = {}  # pass -> latest recomputed stamp

    def recorded(self, stamp: int, data: bytes, refused: bool = False, number: int | None = None) -> None:
        """Take the next recorded message.

        refused: the message is compared only if it is the expected one; number: of its pass, where stamps do not
        show the pass.
        """
        self._index += 1
        if number is None:
            if not refused:
                self._recorded_passes.begins(stamp)
                self._holes.add(stamp)
            number = self._recorded_passes.index
        self._recorded.append(Recorded((number, stamp), self._index, data, refused))
        self._match()

    def take(self, data: bytes) -> None:
        """Take the next recorded message without a comparison."""
        self._index += 1
        self.given += 1
        self._last = data

    def expected(self, stamp: int, record, due: bool = True, number: int | None = None) -> None:
        """Take the next record of the protocol.

        due: False where the recording may lack the message; number: of its pass, where stamps do not show the pass.
        """
        if number is None:
            self._expected_passes.begins(stamp)
            number = self._expected_passes.index
        if due:
            self._ends[number] = stamp
        self._expected.append(Expected((number, stamp), record, due))
        self._match()

    def abandon(self, number: int | None = None) -> None:
        """What waits will not be recomputed: the pass ``number`` begins, or the file has ended."""
        while self._recorded and (number is None or self._recorded[0].order[0] < number):
            self._recorded.popleft()
            self._abandoned += 1

    def _match(self) -> None:
        while self._recorded and self._expected:
            recorded, expected = self._recorded[0], self._expected[0]
            alike = recorded.order == expected.order
            mismatch = difference(expected.record, recorded.data) if alike else ("the message", "there", None)
            if mismatch is None:
                self.compared += 1
                self._last = self._recorded.popleft().data
                self._last_expected = self._expected.popleft()
            elif recorded.refused:
                self.refused += 1
                self._recorded.popleft()
            elif recorded.order > expected.order:
                self._miss(tail=recorded.order[0] > expected.order[0])
            elif recorded.data == self._last:
                self.repeated += 1
                self._recorded.popleft()
            else:
                self.differing += 1
                self._last = self._recorded.popleft().data
                if alike:
                    self.compared += 1
                    self._last_expected = self._expected.popleft()
                self.first = self.first or self._difference(recorded, *mismatch)

    def _difference(self, recorded: Recorded, field: str, there: object, expected: object) -> Difference:
        order = (*recorded.order, self.rank)
        return Difference(self.topic, recorded.number, recorded.order[1], field, there, expected, order)

    def _miss(self, tail: bool) -> None:
        """The next expected message is not in the recording; a repeated answer need not be there."""
        expected, before = self._expected.popleft(), self._last_expected
        self._last_expected = expected
        repeated = before is not None and to_bytes(before.record) == to_bytes(expected.record)
        if not expected.due or repeated:
            return
        self.missing += 1
        if tail:
            self._tails.append(expected.order)
        else:
            self._skipped += 1

    def finish(self) -> None:
        """Complete the comparison: remaining recorded messages may be repeated, remaining expected ones are missing."""
        while self._recorded and (self._recorded[0].refused or self._recorded[0].data == self._last):
            refused = self._recorded.popleft().refused
            self.refused += refused
            self.repeated += not refused
        while self._expected:
            self._miss(tail=True)
        self._holes.finish()

    @property
    def count(self) -> int:
        """Recorded messages so far."""
        return self._index + 1

    @property
    def waiting(self) -> int:
        """Recorded messages that nothing recomputed has come for."""
        return len(self._recorded) + self._abandoned

    @property
    def leftover(self) -> int:
        """Stamp [ns] of the first of them that is not abandoned."""
        return self._recorded[0].order[1] if self._recorded else 0

    def lacking(self, under_way: int, done: bool, iterations: int = 1) -> int:
        """Return how many recomputed messages the recording lacks although its stamps show no gap.

        Messages of the last ``under_way`` [ns] of a pass that broke off do not count. done: the last pass is
        complete; iterations: messages of one stamp.
        """
        whole = self._expected_passes.index if done else -1
        ends = sum(number == whole or stamp < self._ends[number] - under_way for number, stamp in self._tails)
        return ends + max(0, self._skipped - iterations * self._holes.missing)

    def as_dict(self) -> dict:
        return dict(compared=self.compared, differing=self.differing, missing=self.missing, repeated=self.repeated,
                    given=self.given, refused=self.refused, not_compared=self.waiting)  # fmt: skip


def difference(record, data: bytes) -> tuple | None:
    """(field, recorded value, recomputed value) of the first field of a recorded message with other bits than the
    record's; None if there is none. Bytes between the fields do not count."""
    expected = to_bytes(record)
    if data == expected:
        return None
    if data[OPTIONS] != expected[OPTIONS]:
        return "options of the encapsulation", bytes(data[OPTIONS]), bytes(expected[OPTIONS])
    type_name = type_of(record)
    try:
        message = deserialise(type_name, data)
    except ValueError as error:
        return "the message", str(error), "readable"
    for (field, a), (_, b) in zip(_fields("", message), _fields("", deserialise(type_name, expected)), strict=False):
        if _bits(a) == _bits(b):
            continue
        if isinstance(a, str) and isinstance(b, str) and max(len(a), len(b)) > EXCERPT:
            at = len(os.path.commonprefix([a, b]))
            return f"{field}, from character {at} on,", a[at : at + EXCERPT], b[at : at + EXCERPT]
        return field, a, b
    return None


def _fields(path: str, value) -> Iterator[tuple[str, object]]:
    """Name and value of every number and text in a message, and the lengths of its lists before these."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _fields(f"{path}.{field.name}".lstrip("."), getattr(value, field.name))
    elif isinstance(value, (list, np.ndarray)):
        yield f"length of {path}", len(value)
        for i, item in enumerate(value if isinstance(value, list) else value.tolist()):
            yield from _fields(f"{path}[{i}]", item)
    else:
        yield path, value


def _bits(value):
    return struct.pack("<d", value) if isinstance(value, float) else value
