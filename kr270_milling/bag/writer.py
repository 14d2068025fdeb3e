"""Serialised messages into a recording: a directory with one MCAP file and rosbag2's ``metadata.yaml`` beside it."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from mcap.writer import CompressionType, Writer

from kr270_milling import __version__
from kr270_milling.bag import bagmeta
from kr270_milling.bag.gaps import SHARED, GapCounter
from kr270_milling.bag.logtime import LogTimes
from kr270_milling.bag.sink import Sink, open_directory, plain_name, write_new
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.cdr import stamp_of
from kr270_milling.messages.definitions import definition, starts_with_stamp, type_hash

__all__ = ["BagWriter", "Channel"]

CHUNK_SIZE = 1024 * 1024  # [bytes] before compression
CHUNK_PERIOD = 0.2  # [s]; what a SIGKILL can lose
HOLD_PERIOD = 0.5  # [s] that messages wait for the first stamp, and what a SIGKILL can lose until it has come
HOLD_SIZE = 256 * 1024  # [bytes] of them that may wait


@dataclass
class Channel:
    """A topic while it is written."""

    id: int
    topic: str
    type: str
    encoding: str
    qos: list[dict]
    hash: str
    stamped: bool
    gaps: GapCounter = field(default_factory=GapCounter)
    count: int = 0


class BagWriter:
    """Writes ``directory/<name>.mcap`` and, when closed, ``directory/metadata.yaml``.

    attachments: name -> text or bytes, such as {"cell.yaml": ...}; metadata: key -> text, such as seed and command
    line; they stand at the begin of the file, the package's version with them. The first error of the file system
    ends the file: what is in it stays readable, and every later call raises the same RecordingError.
    Messages without a stamp wait for the first stamp, to take it as their log time; start_time [ns]: they do not
    wait, but have this log time until then.
    """

    def __init__(
        self,
        directory,
        name: str | None = None,
        *,
        attachments: Mapping[str, bytes | str] | None = None,
        metadata: Mapping[str, object] | None = None,
        start_time: int | None = None,
        chunk_size: int = CHUNK_SIZE,
        chunk_period: float = CHUNK_PERIOD,
    ):
        self.directory = Path(os.path.abspath(directory))
        name = plain_name(self.directory, name or self.directory.name)
        self.path = self.directory / f"{name}.mcap"
        self.topics: dict[str, int] = {}
        self.channels: dict[int, Channel] = {}
        self.error: RecordingError | None = None
        self.start, self.end, self.count, self.kept = None, 0, 0, 0
        self._chunk_period, self._last_tick = chunk_period, None
        self._times, self._held, self._held_size, self._held_since = LogTimes(start_time), deque(), 0, None
        self._custom = {"kr270_milling_version": __version__, **{k: str(v) for k, v in (metadata or {}).items()}}
        self._schemas: dict[tuple, int] = {}
        self._directory = open_directory(self.directory)
        self._open = True
        try:
            self._refuse_old_metadata()
            self._sink = Sink(self._directory, self.path)
        except RecordingError:
            os.close(self._directory)
            raise
        # the checksum over the whole data section shows a flipped bit also outside of the chunks
        self._mcap = Writer(self._sink, chunk_size, CompressionType.ZSTD, enable_data_crcs=True)
        self._guard(self._begin, attachments or {})

    def _refuse_old_metadata(self) -> None:
        if os.path.lexists(self.directory / "metadata.yaml"):
            raise RecordingError(self.directory, "holds a recording already, which is not overwritten")

    def _begin(self, attachments: Mapping[str, bytes | str]) -> None:
        self._mcap.start(profile="ros2", library=f"kr270_milling/{__version__}")
        self._mcap.add_metadata("kr270_milling", self._custom)
        for name, content in attachments.items():
            self._attach(name, content)

    def _attach(self, name: str, content: bytes | str) -> None:
        data = content.encode() if isinstance(content, str) else bytes(content)
        kind = "application/yaml" if name.endswith((".yaml", ".yml")) else "application/octet-stream"
        self._mcap.add_attachment(0, 0, name, kind, data)

    def add_attachment(self, name: str, content: bytes | str) -> None:
        self._guard(self._attach, name, content)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._guard(self._mcap.add_metadata, name, {str(k): str(v) for k, v in values.items()})

    def add_topic(self, topic: str, type_name: str, qos: Iterable = (), period_ns: int | None = None) -> int:
        """Prepare a topic with an installed message type; qos: its publishers' profiles (see describe_qos).

        period_ns: the time between its stamps, if known, for the counting of gaps. A known topic is left as it is.
        """
        if topic in self.topics:
            known = self.channels[self.topics[topic]].type
            if known != type_name:
                raise RecordingError(self.path, f"{topic} is recorded as {known} and cannot be {type_name} as well")
            return self.topics[topic]
        text = definition(type_name)
        profiles = [bagmeta.describe_qos(profile) for profile in qos]
        about = {"offered_qos_profiles": bagmeta.qos_text(profiles), "topic_type_hash": type_hash(type_name)}
        return self.add_channel(topic, (type_name, "ros2msg", text.encode()), "cdr", about, period_ns)

    def add_channel(
        self, topic: str, schema: tuple[str, str, bytes], encoding: str, about: dict, period_ns: int | None = None
    ) -> int:
        """Prepare a channel as it is given: schema (name, encoding, data), message encoding, channel metadata."""
        if schema not in self._schemas:
            self._schemas[schema] = self._guard(self._mcap.register_schema, *schema) if schema[0] else 0
        number = self._guard(self._mcap.register_channel, topic, encoding, self._schemas[schema], about)
        stamped = schema[1] == "ros2msg" and starts_with_stamp(schema[2].decode("utf-8", "replace"))
        profiles = bagmeta.read_qos(about.get("offered_qos_profiles", ""))
        kind, digest = schema[0], about.get("topic_type_hash", "")
        channel = Channel(number, topic, kind, encoding, profiles, digest, stamped, GapCounter(period_ns))
        self.channels[number] = channel
        self.topics.setdefault(topic, number)
        return number

    def write(self, topic: str, data: bytes, publish_time: int, log_time: int | None = None) -> None:
        """Append one serialised message; times in ns. log_time: by default the message's own stamp, and the latest
        stamp in the recording for a message that has none."""
        if topic not in self.topics:
            raise RecordingError(self.path, f"{topic} is written to, but it was not added")
        channel = self.channels[self.topics[topic]]
        stamp = stamp_of(data, channel.stamped)
        if log_time is None:
            self._check_times(publish_time)
            log_time = self._times.of(channel.type, stamp, publish_time)
        if log_time is None:
            self._hold(channel, data, publish_time, stamp)
            return
        self._release(log_time)
        self._append(channel, data, publish_time, log_time, channel.count, stamp)

    def _hold(self, channel: Channel, data: bytes, publish_time: int, stamp: int | None) -> None:
        """Keep a message until a stamp has told the time; bounded, for a graph in which none comes."""
        self._guard(lambda: None)
        self._held.append((channel, data, publish_time, stamp))
        self._held_size += len(data)
        if self._held_size > HOLD_SIZE:
            self._release()
            self.flush()

    def _release(self, first: int = 0) -> None:
        """Append what was held, in its order. Where no stamp has come, log times begin at ``first``, or are publish
        times if there is not even a topic with stamps."""
        if not self._held:
            return
        by_wall = first == 0 and not any(channel.stamped for channel in self.channels.values())
        self._times.begin(self._held[0][2] if by_wall else first, by_wall)
        while self._held:
            channel, data, publish_time, stamp = self._held.popleft()
            log_time = self._times.of(channel.type, stamp, publish_time)
            self._append(channel, data, publish_time, log_time, channel.count, stamp)
        self._held_size, self._held_since = 0, None

    def write_raw(self, channel_id: int, data: bytes, publish_time: int, log_time: int, sequence: int) -> None:
        """Append a message with everything given."""
        channel = self.channels[channel_id]
        self._append(channel, data, publish_time, log_time, sequence, stamp_of(data, channel.stamped))

    def _append(self, channel: Channel, data, publish_time: int, log_time: int, sequence: int, stamp: int | None):
        self._check_times(log_time, publish_time)
        if self.error is None and self._open:
            channel.count += 1
            self.count += 1
        chunks = self._sink.chunks
        self._guard(self._mcap.add_message, channel.id, log_time, data, publish_time, sequence)
        if self._sink.chunks != chunks:
            self.kept = self.count
        self.start = log_time if self.start is None else min(self.start, log_time)
        self.end = max(self.end, log_time)
        if stamp is not None:
            self._take_stamp(channel, stamp, log_time)

    def _take_stamp(self, channel: Channel, stamp: int, log_time: int) -> None:
        """Count gaps, and follow the time of the pass, which goes back to 0 when the next one begins."""
        if channel.type in SHARED:
            return
        before = channel.gaps.passes.number
        channel.gaps.add(stamp)
        if channel.gaps.passes.number > before:
            self._times.latest = log_time

    def _check_times(self, *times: int) -> None:
        for time in times:
            if not 0 <= time < 2**63:
                raise RecordingError(self.path, f"{time} ns is not a time after 1970")

    def tick(self, now: float) -> None:
        """Close the chunk when it is ``chunk_period`` old, and wait no longer than HOLD_PERIOD for a first stamp;
        now [s]: any clock that does not go back."""
        if self._held and (self._held_since is None or now < self._held_since):
            self._held_since = now
        if self._held and now - self._held_since >= HOLD_PERIOD:
            self._release()
            self.flush()
        if self._last_tick is None or now < self._last_tick:
            self._last_tick = now
        if now - self._last_tick >= self._chunk_period:
            self._last_tick = now
            self.flush()

    def flush(self) -> None:
        """Put everything that was written so far into the file, but for what waits for the first stamp."""
        if self._open and self.kept < self.count:
            self._guard(self._mcap.flush)
            self.kept = self.count

    def _guard(self, call, *args):
        """Run something that writes; at the first error keep the whole records and never write again."""
        if self.error is not None:
            raise self.error
        if not self._open:
            raise RecordingError(self.path, "the recording is closed")
        chunks = self._sink.chunks
        try:
            return call(*args)
        except OSError as error:
            if self._sink.chunks != chunks:  # the chunk is in, only its index is not
                self.kept = self.count
            self._sink.close(keep=self._sink.position)
            os.close(self._directory)
            self._open = False
            text = (
                f"writing ended with an error ({error.strerror or error}); {self.kept} messages in "
                f"{self._sink.position} bytes are safe, the last {self.count - self.kept + len(self._held)} are lost"
            )
            self.error = RecordingError(self.path, text)
            raise self.error from error

    def report(self) -> dict:
        """Counts per topic: messages and what is missing by their stamps."""
        return {c.topic: dict(count=c.count, **(c.gaps.as_dict() if c.stamped else {})) for c in self.channels.values()}

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; nothing happens the second time or after an error."""
        if not self._open:
            return
        self._release()
        for channel in self.channels.values():
            channel.gaps.finish()
        topics = [dict(name=c.topic, type=c.type, encoding=c.encoding, qos=c.qos, hash=c.hash, count=c.count)
                  for c in self.channels.values()]  # fmt: skip
        about = bagmeta.bag_information(self.path.name, topics, self.start or 0, self.end, self._custom)
        self.flush()
        self.add_metadata("kr270_milling.counts", {k: json.dumps(v) for k, v in self.report().items()})
        self.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(about, sort_keys=False)})
        self._guard(self._mcap.finish)
        self._open = False
        self._sink.close()
        try:
            text = yaml.safe_dump({"rosbag2_bagfile_information": about}, sort_keys=False)
            write_new(self._directory, self.directory, "metadata.yaml", text.encode())
        finally:
            os.close(self._directory)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_) -> None:
        self.close()
