"""Summary of a recording as a dict for ``--json`` and as text; missing messages of each pass, by the stamps."""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Callable

from kr270_milling.base.errors import one_line
from kr270_milling.recordings.bag.files import is_latched
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.definitions import starts_with_stamp

#: types of topics with many publishers: their stamps are several series
SHARED = frozenset(["diagnostic_msgs/msg/DiagnosticArray"])


class GapCounter:
    """Counts the gaps in a series of stamps [ns].

    The period is the smallest of the first 20 differences, if all of them are multiples of it within a quarter and most
    of them equal it. A series without a period has no gaps. The time between two passes is no gap: a pass begins at a
    start, or when the stamp returns to 0. Other backward stamps and repeated stamps are counted separately, and so a
    second publisher shows.

    starts: namespace -> starts of its passes, which the reference trajectories state in their headers. A late
    subscriber receives a latched message again, which is no repeated stamp.
    """

    def __init__(self, topic: str = "", starts: dict[str, list[int]] | None = None, latched: bool = False):
        namespace, _, name = topic.rpartition("/")
        self._starts: list[int] = [] if starts is None else starts.setdefault(namespace, [])
        self._latched, self._is_reference = latched, name == "reference_trajectory"
        self.period_ns: int | None = None  #: 0: the series has no period
        self.missing = self.gaps = self.repeated = self.backwards = 0
        self.last: int | None = None  #: last stamp [ns]
        self._differences: list[int] = []  # until the period is known

    def add(self, stamp: int) -> None:
        last = self.last
        if self._is_reference and stamp not in self._starts:
            bisect.insort(self._starts, stamp)
        difference = 0 if last is None else stamp - last
        if last is None or self._begins(last, stamp):
            self.last = stamp
        elif difference == 0:
            self.repeated += not self._latched
        elif difference < 0:
            self.backwards += 1
        elif difference < 365 * 86_400 * 10**9:  # a year; larger differences come from another clock
            self.last = stamp
            if self.period_ns is not None:
                self._count(difference)
            else:
                self._differences.append(difference)
                if len(self._differences) == 20:
                    self._learn()

    def _begins(self, last: int, stamp: int) -> bool:
        """Return whether a pass begins between two stamps."""
        if not self._starts:
            return stamp == 0 and last > 0
        return bisect.bisect_right(self._starts, stamp) > bisect.bisect_right(self._starts, last) or (
            stamp == 0 == self._starts[0] and last > 0
        )

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


def info(recording: Recording, progress: Callable[[int, int], None] | None = None) -> dict:
    """Return duration, counts, rates, sizes, gaps, metadata and attachments of a recording; read all its messages."""
    known = recording.topics()
    starts: dict[str, list[int]] = {}
    stamped = {n for n, t in known.items() if t.schema_encoding == "ros2msg" and starts_with_stamp(t.schema)}
    gaps = {
        name: GapCounter(name, starts, is_latched(known[name].metadata))
        for name in stamped
        if known[name].type not in SHARED
    }
    sizes: Counter[str] = Counter()
    times: dict[str, tuple[int, int]] = {}  # topic -> first and last log time [ns]
    for number, message in enumerate(recording.messages()):
        name, stamp = message.topic, stamp_of(message.data)
        if name in gaps and stamp is not None:
            gaps[name].add(stamp)
        sizes[name] += len(message.data)
        first, last = times.get(name, (message.log_time, message.log_time))
        times[name] = min(first, message.log_time), max(last, message.log_time)
        if progress and number % 10_000 == 0:
            progress(number, recording.count)
    counted = {name: gaps[name].finish().as_dict() if name in gaps else None for name in known}
    topics = {}
    for name, about in known.items():
        first, last = times.get(name, (0, 0))
        topics[name] = dict(
            type=about.type,
            count=about.count,
            size_bytes=sizes[name],
            rate_hz=(about.count - 1) / ((last - first) / 1e9) if last > first else None,
            gaps=counted[name],
        )
    start, end = recording.first_log_time, recording.last_log_time
    return dict(
        file=str(recording.path),
        size_bytes=recording.size,
        cut_off=recording.cut_off,
        messages=recording.count,
        start_ns=start,
        end_ns=end,
        duration_s=((end or 0) - (start or 0)) / 1e9 if recording.count else 0.0,
        topics=topics,
        missing=sum(counter.missing for counter in gaps.values()),
        metadata={k: v for k, v in recording.metadata().items() if k != "rosbag2"},
        attachments=[dict(name=a.name, media_type=a.media_type, size_bytes=a.data_size) for a in recording.attachments],
        profile=recording.profile or "",
        library=recording.library,
    )


def info_text(data: dict) -> str:
    """Format the dict of ``info`` for a terminal."""
    lines = [
        f"{data['file']}: {data['size_bytes'] / 1e6:.2f} MB, {data['messages']} messages, {data['duration_s']:.3f} s"
    ]
    if data["cut_off"]:
        lines.append(
            "cut off: its writer did not finish it; the following was written before "
            f"(last log time {data['end_ns']} ns)"
        )
    lines.append(f"written by {data['library'] or 'unknown'}, profile {data['profile'] or 'none'}")
    width = max((len(name) for name in data["topics"]), default=0)
    for name, topic in data["topics"].items():
        counts, gaps = topic["gaps"] or {}, ""
        if any(counts.get(key) for key in ("missing", "repeated", "backwards")):
            gaps = "; {missing} missing in {gaps} gaps, {repeated} repeated, {backwards} back".format(**counts)
        rate = f"{topic['rate_hz']:10.1f} Hz" if topic["rate_hz"] else " " * 13
        lines.append(f"  {name:{width}}  {topic['count']:8d} {rate}  {topic['type']}{gaps}")
    for name, entries in data["metadata"].items():
        own = name == "kr270_milling.counts"  # of the writer: the lines above have the same, but for what was refused
        shown = {key: value for key, value in entries.items() if value and (not own or '"refused"' in value)}
        lines += [f"  {name}: {key} = {value}" for key, value in shown.items()]
    lines += [f"  attached: {a['name']} ({a['size_bytes']} bytes)" for a in data["attachments"]]
    # text in a file must not control the terminal
    return "\n".join(map(one_line, lines))
