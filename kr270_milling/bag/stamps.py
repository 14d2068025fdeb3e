"""What stamps tell: where a pass begins, what is missing, and the log time of every message on one clock."""

from __future__ import annotations

__all__ = ["SHARED", "GapCounter", "LogTimes", "Passes"]

LEARN = 20  # differences that are looked at before a period is believed
#: types of topics that many nodes publish on: their stamps are several series in one, and none of them tells a pass
SHARED = frozenset(["diagnostic_msgs/msg/DiagnosticArray"])
YEAR = 365 * 86_400 * 10**9  # [ns]; stamps that are further apart are of different clocks
#: types whose stamps may come from any clock beside that of the pass, so that they do not tell which one counts
BESIDE = ("diagnostic_msgs/", "rcl_interfaces/")


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

    The time between two messages is learned, as the smallest of the first 20 differences, if these are all multiples
    of it within a quarter and most of them are the period itself. A series that is not periodic has no gaps. A stamp
    that goes back to 0 begins a new pass, which is counted like the one before; other backward stamps, and repeated
    ones, are counted on their own and do not move the series.
    """

    def __init__(self):
        self.period_ns: int | None = None  #: 0: there is none
        self.missing = self.gaps = self.repeated = self.backwards = 0
        self.last: int | None = None
        self.passes = Passes()
        self._differences: list[int] = []  # that wait for a period

    def add(self, stamp: int) -> None:
        if self.passes.begins(stamp) or self.last is None:
            self.last = stamp
            return
        difference = stamp - self.last
        self.repeated += difference == 0
        self.backwards += difference < 0
        if difference <= 0:
            return
        self.last = stamp
        if self.period_ns is not None:
            self._count(difference)
            return
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
        """Count what a short series allows: three differences are enough for a period, fewer say nothing."""
        if self.period_ns is None and len(self._differences) >= 3:
            self._learn()
        return self

    def as_dict(self) -> dict:
        """The counts; ``period_ns`` is None where none is known."""
        return dict(period_ns=self.period_ns or None, missing=self.missing, gaps=self.gaps, repeated=self.repeated,
                    backwards=self.backwards)  # fmt: skip


class LogTimes:
    """Gives the log time [ns] of each message: its own stamp, or the latest stamp where it has none that tells.

    The first stamp that tells decides the clock of the recording: time of the pass, counted from 0, or wall clock. A
    stamp of another clock counts as none; one such log time would make the recording last for decades. Before that
    first stamp there is no time to give (None), until ``begin`` says that no stamp is to be waited for.
    """

    def __init__(self):
        self.latest: int | None = None
        self._offset: int | None = None  #: from log time to stamp; None: no stamp that tells has come yet
        self._by_wall = False

    def begin(self, latest: int, by_wall: bool = False) -> None:
        """Wait no longer, where nothing told the time yet; by_wall: until a stamp does, it is the publish time."""
        if self.latest is None:
            self.latest, self._by_wall = latest, by_wall

    def of(self, kind: str, stamp: int | None, publish_time: int) -> int | None:
        if stamp == 0 and kind.startswith("trajectory_msgs/"):
            stamp = None  # it means "start at once" and says nothing of when it was published
        tells = stamp is not None and not kind.startswith(BESIDE)
        latest = stamp if self.latest is None and tells else self.latest
        if latest is None:
            return None
        if self._offset is None and tells and stamp is not None:  # what was begun without a stamp goes on from there
            self._offset = 0 if abs(stamp - latest) < YEAR else stamp - latest
        if self._offset is None and self._by_wall:
            latest = max(latest, publish_time)
        time = None if stamp is None else stamp - (self._offset or 0)
        usable = time is not None and time >= 0 and abs(time - latest) < YEAR
        self.latest = latest if time is None or not usable else max(latest, time)
        return time if usable else latest
