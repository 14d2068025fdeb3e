"""What a recording holds, as a dict for ``--json`` and as text."""

from __future__ import annotations

from collections.abc import Callable

from kr270_milling.bag.gaps import SHARED, GapCounter, Passes
from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import one_line
from kr270_milling.messages.cdr import stamp_of
from kr270_milling.messages.definitions import starts_with_stamp

__all__ = ["info", "info_text"]


def info(recording: Recording, progress: Callable[[int, int], None] | None = None) -> dict:
    """Duration, counts, rates, bytes and gaps per topic, metadata, attachments and versions; reads all messages."""
    topics = recording.topics()
    stamped = {
        name for name, about in topics.items()
        if about.schema_encoding == "ros2msg" and about.type not in SHARED
        and starts_with_stamp(about.schema)
    }  # fmt: skip
    counters = {name: GapCounter() for name in stamped}
    sizes = dict.fromkeys(topics, 0)
    spans = {name: _Span() for name in topics}
    for number, message in enumerate(recording.messages(as_written=True)):
        sizes[message.topic] += len(message.data)
        spans[message.topic].add(message.log_time)
        if message.topic in stamped and (stamp := stamp_of(message.data)) is not None:
            counters[message.topic].add(stamp)
        if progress and number % 10_000 == 0:
            progress(number, recording.count)
    first, last = recording.first_log_time, recording.last_log_time
    return dict(
        file=str(recording.path),
        size_bytes=recording.size,
        cut_off=recording.cut_off,
        messages=recording.count,
        start_ns=first,
        end_ns=last,
        duration_s=((last or 0) - (first or 0)) / 1e9 if recording.count else 0.0,
        topics={name: _topic(about, sizes[name], spans[name], counters.get(name)) for name, about in topics.items()},
        missing=sum(counter.missing for counter in counters.values()),
        metadata={k: v for k, v in recording.metadata().items() if k != "rosbag2"},
        attachments=[dict(name=a.name, media_type=a.media_type, size_bytes=a.size) for a in recording.attachments],
        profile=recording.profile,
        library=recording.library,
    )


class _Span:
    """How long the messages of a topic take, each pass for itself."""

    def __init__(self):
        self._passes, self._before = Passes(), 0
        self._first: int | None = None
        self._last = 0

    def add(self, log_time: int) -> None:
        if self._passes.begins(log_time):
            self._before, self._first = self.length, None
        self._last = log_time if self._first is None else max(self._last, log_time)
        self._first = log_time if self._first is None else min(self._first, log_time)

    @property
    def length(self) -> int:
        """[ns]"""
        return self._before + (0 if self._first is None else self._last - self._first)

    def rate(self, count: int) -> float | None:
        """[Hz], of ``count`` messages."""
        return (count - 1 - self._passes.number) / (self.length / 1e9) if self.length else None


def _topic(about, size: int, span: _Span, counter: GapCounter | None) -> dict:
    rate = span.rate(about.count)
    gaps = counter.finish().as_dict() if counter else None
    return dict(type=about.type, count=about.count, size_bytes=size, rate_hz=rate, gaps=gaps)


def info_text(data: dict) -> str:
    """The dict of ``info`` for a terminal."""
    lines = [
        f"{data['file']}: {data['size_bytes'] / 1e6:.2f} MB, {data['messages']} messages, {data['duration_s']:.3f} s"
    ]
    if data["cut_off"]:
        lines.append("cut off: its writer did not finish it; what follows is what was written before "
                     f"(last log time {data['end_ns']} ns)")  # fmt: skip
    lines.append(f"written by {data['library'] or 'unknown'}, profile {data['profile'] or 'none'}")
    width = max((len(name) for name in data["topics"]), default=0)
    for name, topic in data["topics"].items():
        rate = f"{topic['rate_hz']:10.1f} Hz" if topic["rate_hz"] else " " * 13
        lines.append(f"  {name:{width}}  {topic['count']:8d} {rate}  {topic['type']}{_gap_text(topic['gaps'])}")
    for name, entries in data["metadata"].items():
        lines += [f"  {name}: {key} = {value}" for key, value in entries.items()]
    lines += [f"  attached: {a['name']} ({a['size_bytes']} bytes)" for a in data["attachments"]]
    # a file from elsewhere must not steer the terminal
    return "\n".join(map(one_line, lines))


def _gap_text(gaps: dict | None) -> str:
    if not gaps or not (gaps["missing"] or gaps["repeated"] or gaps["backwards"]):
        return ""
    return f"; {gaps['missing']} missing in {gaps['gaps']} gaps, {gaps['repeated']} repeated, {gaps['backwards']} back"
