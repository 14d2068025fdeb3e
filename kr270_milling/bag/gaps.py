"""Messages that are missing, counted from the stamps of those that came."""

from __future__ import annotations

__all__ = ["SHARED", "GapCounter", "Passes"]

LEARN = 20  # differences that are looked at before a period is believed
#: types of topics that many nodes publish on: their stamps are several series in one, and none of them tells a pass
SHARED = frozenset(["diagnostic_msgs/msg/DiagnosticArray"])


class Passes:
    """Counts passes in a row of stamps [ns]: one begins where the stamps go back to 0."""

    def __init__(self):
        self.number, self._last = 0, 0

    def begins(self, stamp: int) -> bool:
        again = stamp == 0 and self._last > 0
        self.number += again
        self._last = stamp
        return again


class GapCounter:
    """Counts the holes in a series of stamps [ns].

    period_ns: the time between two messages; None: learned, as the smallest of the first 20 differences, if these
    are all multiples of it within a quarter and most of them are the period itself. A series that is not periodic
    has no gaps. A stamp that goes back to 0 begins a new pass, which is counted like the one before; other backward
    stamps, and repeated ones, are counted on their own and do not move the series.
    """

    def __init__(self, period_ns: int | None = None):
        self.period_ns = period_ns
        self.missing = self.gaps = self.repeated = self.backwards = 0
        self.last: int | None = None
        self.passes = Passes()
        self._differences: list[int] | None = [] if period_ns is None else None

    def add(self, stamp: int) -> int:
        """Take the next stamp and return how many messages are known to be missing before it."""
        if self.passes.begins(stamp) or self.last is None:
            self.last = stamp
            return 0
        difference = stamp - self.last
        if difference <= 0:
            self.repeated += difference == 0
            self.backwards += difference < 0
            return 0
        self.last = stamp
        if self._differences is not None:
            self._differences.append(difference)
            return self._learn() if len(self._differences) >= LEARN else 0
        return self._count(difference)

    def _count(self, difference: int) -> int:
        period = self.period_ns
        if not period or 2 * difference < 3 * period:
            return 0
        missing = (difference + period // 2) // period - 1
        self.missing += missing
        self.gaps += 1
        return missing

    def _learn(self) -> int:
        differences, self._differences = self._differences or [], None
        period = min(differences)
        off = [abs(d - period * ((d + period // 2) // period)) for d in differences]
        single = sum(2 * d < 3 * period for d in differences)
        self.period_ns = period if 4 * max(off) <= period and 2 * single > len(differences) else 0
        return sum(self._count(d) for d in differences)

    def finish(self) -> GapCounter:
        """Count what a short series allows: three differences are enough for a period, fewer say nothing."""
        if self._differences is not None and len(self._differences) >= 3:
            self._learn()
        return self

    def as_dict(self) -> dict:
        """The counts; ``period_ns`` is None where none is known."""
        return dict(period_ns=self.period_ns or None, missing=self.missing, gaps=self.gaps, repeated=self.repeated,
                    backwards=self.backwards)  # fmt: skip
