"""Missing messages of each pass, counted by the stamps in the headers."""

from __future__ import annotations

import bisect
from collections.abc import Sequence

__all__ = ["SHARED", "GapCounter", "PassStarts"]

#: types of topics with many publishers: their stamps are several series
SHARED = frozenset(["diagnostic_msgs/msg/DiagnosticArray"])


class PassStarts:
    """Starts of passes [ns], which the reference trajectories of each namespace state in their headers."""

    def __init__(self):
        self._starts: dict[str, list[int]] = {}

    def of(self, topic: str) -> list[int]:
        """Return the starts in the namespace of a topic, ascending; the list grows with each reference."""
        return self._starts.setdefault(topic.rpartition("/")[0], [])

    def take(self, topic: str, stamp: int | None) -> None:
        """Take the stamp of the next message of a topic."""
        starts = self.of(topic) if topic.endswith("/reference_trajectory") else None
        if starts is not None and stamp is not None and stamp not in starts:
            bisect.insort(starts, stamp)


class GapCounter:
    """Counts the gaps in a series of stamps [ns].

    The period is the smallest of the first 20 differences, if all of them are multiples of it within a quarter and most
    of them equal it. A series without a period has no gaps. The time between two passes is no gap: a pass begins at a
    start, or when the stamp returns to 0. Other backward stamps and repeated stamps are counted separately, and so a
    second publisher shows.

    starts: of the passes; latched: a late subscriber receives the last message again, which is no repeated stamp.
    """

    def __init__(self, starts: Sequence[int] = (), latched: bool = False):
        self._starts, self._latched = starts, latched
        self.period_ns: int | None = None  #: 0: the series has no period
        self.missing = self.gaps = self.repeated = self.backwards = 0
        self.last: int | None = None  #: last stamp [ns]
        self._differences: list[int] = []  # until the period is known

    def add(self, stamp: int) -> None:
        last = self.last
        difference = 0 if last is None else stamp - last
        if last is None or self._begins(last, stamp):
            self.last = stamp
        elif difference == 0:
            self.repeated += not self._latched
        elif difference < 0:
            self.backwards += 1
        elif difference < 365 * 86_400 * 10**9:  # a year; larger differences come from another clock
            self.last = stamp
            self._take(difference)

    def _begins(self, last: int, stamp: int) -> bool:
        """Return whether a pass begins between two stamps."""
        if not self._starts:
            return stamp == 0 and last > 0
        return bisect.bisect_right(self._starts, stamp) > bisect.bisect_right(self._starts, last) or (
            stamp == 0 == self._starts[0] and last > 0
        )

    def _take(self, difference: int) -> None:
        if self.period_ns is not None:
            self._count(difference)
            return
        self._differences.append(difference)
        if len(self._differences) == 20:
            self._learn()

    def _count(self, difference: int) -> None:
        period = self.period_ns
        if period and 2 * difference >= 3 * period:
            self.missing += (difference + period // 2) // period - 1
            self.gaps += 1

    def _learn(self) -> None:
        differences, period = self._differences, min(self._differences)
        off = [abs(d - period * ((d + period // 2) // period)) for d in differences]
        single = sum(2 * d < 3 * period for d in differences)
        self.period_ns = period if 4 * max(off) <= period and 2 * single > len(differences) else 0
        for difference in differences:
            self._count(difference)

    def finish(self) -> GapCounter:
        """Learn the period of a short series; it needs three differences."""
        if self.period_ns is None and len(self._differences) >= 3:
            self._learn()
        return self

    def as_dict(self) -> dict:
        """Return the counts; ``period_ns`` is None without a period."""
        return dict(
            period_ns=self.period_ns or None,
            missing=self.missing,
            gaps=self.gaps,
            repeated=self.repeated,
            backwards=self.backwards,
        )
