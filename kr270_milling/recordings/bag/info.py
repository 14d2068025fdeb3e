"""Summary of a recording, as a dict for ``--json`` and as text."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from kr270_milling.base.errors import one_line
from kr270_milling.recordings.bag.gaps import SHARED, GapCounter, PassStarts
from kr270_milling.recordings.bag.playback import is_latched
from kr270_milling.recordings.bag.reader import RawMessage, RecordedTopic, Recording
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.definitions import starts_with_stamp

__all__ = ["info", "info_text"]


def info(recording: Recording, progress: Callable[[int, int], None] | None = None) -> dict:
    """Return duration, counts, rates, sizes, gaps, metadata and attachments of a recording; read all its messages."""
    starts = PassStarts()
    topics = {name: _TopicCount(about, starts.of(name)) for name, about in recording.topics().items()}
    for number, message in enumerate(recording.messages()):
        starts.take(message.topic, stamp_of(message.data))
        topics[message.topic].add(message)
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
        topics={name: topic.as_dict() for name, topic in topics.items()},
        missing=sum(topic.gaps.missing for topic in topics.values()),
        metadata={k: v for k, v in recording.metadata().items() if k != "rosbag2"},
        attachments=[dict(name=a.name, media_type=a.media_type, size_bytes=a.size) for a in recording.attachments],
        profile=recording.profile or "",
        library=recording.library,
    )


class _TopicCount:
    """Size, gaps and duration of the messages of a topic."""

    def __init__(self, about: RecordedTopic, starts: Sequence[int]):
        self._about = about
        self._stamped = about.schema_encoding == "ros2msg" and about.type not in SHARED
        self._stamped = self._stamped and starts_with_stamp(about.schema)
        self.gaps = GapCounter(starts, is_latched(about))
        self._size = 0
        self._times: tuple[int, int] | None = None  # [ns], first and last log time

    def add(self, message: RawMessage) -> None:
        first, last = self._times or (message.log_time, message.log_time)
        self._times = min(first, message.log_time), max(last, message.log_time)
        self._size += len(message.data)
        if self._stamped and (stamp := stamp_of(message.data)) is not None:
            self.gaps.add(stamp)

    def as_dict(self) -> dict:
        first, last = self._times or (0, 0)
        return dict(
            type=self._about.type,
            count=self._about.count,
            size_bytes=self._size,
            rate_hz=(self._about.count - 1) / ((last - first) / 1e9) if last > first else None,
            gaps=self.gaps.finish().as_dict() if self._stamped else None,
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
        rate = f"{topic['rate_hz']:10.1f} Hz" if topic["rate_hz"] else " " * 13
        lines.append(f"  {name:{width}}  {topic['count']:8d} {rate}  {topic['type']}{_gap_text(topic['gaps'])}")
    for name, entries in data["metadata"].items():
        lines += [f"  {name}: {key} = {value}" for key, value in entries.items()]
    lines += [f"  attached: {a['name']} ({a['size_bytes']} bytes)" for a in data["attachments"]]
    # text in a file must not control the terminal
    return "\n".join(map(one_line, lines))


def _gap_text(gaps: dict | None) -> str:
    if not gaps or not (gaps["missing"] or gaps["repeated"] or gaps["backwards"]):
        return ""
    return f"; {gaps['missing']} missing in {gaps['gaps']} gaps, {gaps['repeated']} repeated, {gaps['backwards']} back"
