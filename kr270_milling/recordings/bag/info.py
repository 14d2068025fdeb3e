"""Summary of a recording, as a dict for ``--json`` and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from kr270_milling.base.errors import one_line
from kr270_milling.recordings.bag.gaps import SHARED, GapCounter, PassStarts
from kr270_milling.recordings.bag.playback import is_latched
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.definitions import starts_with_stamp

__all__ = ["info", "info_text"]


def info(recording: Recording, progress: Callable[[int, int], None] | None = None) -> dict:
    """Return duration, counts, rates, sizes, gaps, metadata and attachments of a recording; read all its messages."""
    known, starts = recording.topics(), PassStarts()
    stamped = {n for n, t in known.items() if t.schema_encoding == "ros2msg" and starts_with_stamp(t.schema)}
    gaps = {
        name: GapCounter(starts.of(name), is_latched(known[name])) for name in stamped if known[name].type not in SHARED
    }
    sizes: Counter[str] = Counter()
    times: dict[str, tuple[int, int]] = {}  # topic -> first and last log time [ns]
    for number, message in enumerate(recording.messages()):
        name, stamp = message.topic, stamp_of(message.data)
        starts.take(name, stamp)
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
        attachments=[dict(name=a.name, media_type=a.media_type, size_bytes=a.size) for a in recording.attachments],
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
