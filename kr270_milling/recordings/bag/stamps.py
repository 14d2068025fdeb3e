"""Stamps of messages: begin of a pass, missing messages, and the log time of every message on one clock."""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["SHARED", "GapCounter", "LogTimes", "PassCounter", "PassStarts"]

LEARN = 20  # differences from which a period is learned
#: types of topics with many publishers: their stamps are several series and do not mark a pass
SHARED = frozenset(["diagnostic_msgs/msg/DiagnosticArray"])
YEAR = 365 * 86_400 * 10**9  # [ns]; stamps that differ more come from different clocks
#: types whose stamps may come from any clock; they do not decide the clock of the recording
BESIDE = ("diagnostic_msgs/", "rcl_interfaces/")
TIMELESS = ("trajectory_msgs/", "nav_msgs/")  #: types whose stamp may be 0 in a graph with another clock


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


class PassCounter:
    """Counts the passes in a series of stamps [ns]: a pass begins at a start, or when the stamp returns to 0."""

    def __init__(self, starts: Sequence[int] = ()):
        self.number, self._last = 0, 0
        self._returns = 0
        self._starts = starts

    def begins(self, stamp: int) -> bool:
        last, self._last = self._last, stamp
        if last <= 0:
            return False
        returned = stamp == 0 and (not self._starts or self._starts[0] == 0)
        again = returned or (bool(self._starts) and self._passed(stamp) > self._passed(last))
        self.number += again
        self._returns += returned
        return again

    @property
    def index(self) -> int:
        """Number of the pass among all starts, also where the first passes have no stamp in the series."""
        return self._returns + self._passed(self._last)

    def _passed(self, stamp: int) -> int:
        """Number of starts up to a stamp."""
        return bisect.bisect_right(self._starts, stamp)


class Gap(NamedTuple):
    """The last gap of a series, with the counts before it."""

    before: int
    after: int
    missing: int
    gaps: int


class GapCounter:
    """Counts the gaps in a series of stamps [ns].

    The period is the smallest of the first 20 differences, if all of them are multiples of it within a quarter and most
    of them equal it. A series without a period has no gaps. The time between two passes is no gap. Backward stamps and
    repeated stamps are counted separately.

    A gap in which the series continues soon is none: the stamps after it belong to another publisher, and they do not
    count while the series continues.

    starts: of the passes; latched: a late subscriber receives the last message again, which is no repeated stamp.
    """

    def __init__(self, starts: Sequence[int] = (), latched: bool = False):
        self._latched = latched
        self.period_ns: int | None = None  #: 0: the series has no period
        self.missing = self.gaps = self.repeated = self.backwards = 0
        self.last: int | None = None  #: of the series
        self.latest: int | None = None  #: of any message
        self.passes = PassCounter(starts)
        self._differences: list[int] = []  # until the period is known
        self._gap: Gap | None = None
        self._other: int | None = None  # from this stamp on, messages are of another publisher
        self._since = 0  # messages since the gap, or of the other publisher without one of the series

    def add(self, stamp: int) -> None:
        self.latest = stamp
        if self.passes.begins(stamp) or self.last is None:
            self.last, self._gap, self._other = stamp, None, None
        elif self._gap is self._other is None and self.period_ns and 0 < 2 * (stamp - self.last) < 3 * self.period_ns:
            self.last, self._since = stamp, self._since + 1  # the usual message, for speed
        elif self._other is not None and stamp >= self._other:
            self._since += 1
            if self._since > LEARN:  # the series itself
                self.last, self._other = stamp, None
        else:
            self._since = self._since + 1 if self._other is None else 0
            self._add(self.last, stamp)

    def _add(self, last: int, stamp: int) -> None:
        gap = self._gap if self._since <= LEARN else None
        if gap is not None and gap.before < stamp < gap.after:
            self.backwards += 1
            self._gap, self._other, self._since = None, gap.after, 0
            last, self.missing, self.gaps = gap.before, gap.missing, gap.gaps
        difference = stamp - last
        self.repeated += difference == 0 and not self._latched
        self.backwards += difference < 0
        if difference > YEAR:
            self._other, self._since = stamp, 0
        elif difference > 0 or (difference < 0 and self.period_ns is None):
            self.last = stamp
            self._take(last, difference)

    def _take(self, last: int, difference: int) -> None:
        if self.period_ns is not None:
            missing, gaps = self.missing, self.gaps
            self._count(difference)
            if self.gaps > gaps:
                self._gap, self._since = Gap(last, last + difference, missing, gaps), 0
        elif difference < 0:  # one of both is of another publisher
            self._differences.clear()
        else:
            self._differences.append(difference)
            if len(self._differences) == LEARN:
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
        return dict(period_ns=self.period_ns or None, missing=self.missing, gaps=self.gaps, repeated=self.repeated,
                    backwards=self.backwards)  # fmt: skip


class LogTimes:
    """Returns the log time [ns] of each message: its stamp, or the latest stamp for a message without a usable one.

    The first usable stamp decides the clock of the recording: time of the pass, counted from 0, or wall clock. A stamp
    of another clock is ignored, since such a log time would make the recording last for decades. Before the first
    usable stamp the log time is None, unless ``begin`` was called.
    """

    def __init__(self):
        self.latest: int | None = None
        self._offset: int | None = None  #: from log time to stamp; None: there was no usable stamp yet
        self._by_wall = False

    def begin(self, latest: int, by_wall: bool = False) -> None:
        """Set the latest time, if it is not known yet; by_wall: until a stamp is usable, use publish times."""
        if self.latest is None:
            self.latest, self._by_wall = latest, by_wall

    def of(self, kind: str, stamp: int | None, publish_time: int) -> int | None:
        if stamp == 0 and kind.startswith(TIMELESS):
            stamp = None  # it means "start at once", or the part before a pass, and is not the time of the message
        decides = stamp is not None and not kind.startswith(BESIDE)
        latest = stamp if self.latest is None and decides else self.latest
        if latest is None:
            return None
        if self._offset is None and decides and stamp is not None:  # continue from the time that ``begin`` set
            self._offset = 0 if abs(stamp - latest) < YEAR else stamp - latest
        if self._offset is None and self._by_wall:
            latest = max(latest, publish_time)
        time = None if stamp is None else stamp - (self._offset or 0)
        usable = time is not None and time >= 0 and abs(time - latest) < YEAR
        self.latest = latest if time is None or not usable else max(latest, time)
        return time if usable else latest
