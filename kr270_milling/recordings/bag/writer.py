"""Write serialised messages into a recording: a directory with one MCAP file and rosbag2's ``metadata.yaml``."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.files import write_files
from kr270_milling.base.version import __version__
from kr270_milling.recordings.bag import files
from kr270_milling.recordings.bag.info import SHARED, GapCounter
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.definitions import definition, starts_with_stamp, type_hash


class MessageRefused(RecordingError):
    """A message that cannot be recorded; the recording continues with the next message."""


@dataclass
class WrittenChannel:
    """A topic during writing."""

    id: int
    topic: str
    type: str
    encoding: str
    qos: list[dict]
    hash: str
    stamped: bool
    gaps: GapCounter
    count: int = 0
    refused: int = 0


class RecordingFile:
    """A new file for mcap's Writer, without a buffer: a written chunk is in the kernel and survives a SIGKILL.

    The first error of the file system ends the file, which stays readable up to its last whole chunk; every later call
    raises the same RecordingError.
    """

    def __init__(self, path: Path):
        self.path = path
        self.error: RecordingError | None = None
        self.count = self.saved = 0  #: messages given to mcap's Writer, and messages in the file
        folder = path.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if folder.is_symlink():
                raise RecordingError(folder, "is a symbolic link; a recording is not written through links")
            if os.path.lexists(folder / "metadata.yaml"):
                raise RecordingError(folder, "has a recording already, which is not overwritten")
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115 - closed by ``close``
            self.tell = self._file.tell
        except FileExistsError as error:
            raise RecordingError(error.filename, "exists already and is not overwritten") from None
        except OSError as error:
            raise RecordingError(path, f"cannot be created: {error.strerror}") from error

    def check(self) -> None:
        """Raise RecordingError after an error or after the end."""
        if self._file.closed:
            raise self.error or RecordingError(self.path, "the recording is closed")

    def write(self, data) -> int:
        """Write all bytes. Raises RecordingError."""
        self.check()
        view, written = memoryview(data), 0
        try:
            while written < len(view):
                written += self._file.write(view[written:])
        except OSError as error:
            lost = self.count - self.saved
            reason = f"writing ended with an error ({error.strerror or error}); {self.saved} messages are safe, "
            self.error = RecordingError(self.path, f"{reason}the last {lost} are lost")
            self.close()
            raise self.error from error
        if view and view[0] == Opcode.CHUNK:
            self.saved = self.count
        return written

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def close(self) -> None:
        with suppress(OSError):
            self._file.close()

    @property
    def closed(self) -> bool:
        return self._file.closed


class BagWriter:
    """Writes ``directory/<name>.mcap`` and, when closed, ``directory/metadata.yaml``.

    attachments: name -> text or bytes, such as {"cell.yaml": ...}; metadata: key -> text, such as seed and command
    line; both are at the begin of the file, with the version of this package. The first error of the file system ends
    the file: its content stays readable, and every later call raises the same RecordingError. A message that cannot be
    recorded raises MessageRefused and is counted.
    """

    def __init__(
        self,
        directory,
        name: str | None = None,
        *,
        attachments: Mapping[str, bytes | str] | None = None,
        metadata: Mapping[str, object] | None = None,
        chunk_size: int = 1024 * 1024,
    ):
        folder = Path(os.path.abspath(directory))
        self.path = folder / f"{folder.name if name is None else name}.mcap"
        if self.path.parent != folder:
            raise RecordingError(folder, f"{name!r} is not the name of a file in this directory")
        self.output = RecordingFile(self.path)
        # the checksum of the data section also covers the bytes outside of the chunks
        self._mcap = Writer(cast(IO[bytes], self.output), chunk_size, CompressionType.ZSTD, enable_data_crcs=True)
        self.topics: dict[str, int] = {}
        self.channels: dict[int, WrittenChannel] = {}
        self.start: int | None = None  #: [ns], smallest and largest log time
        self.end = 0
        self._last_chunk: float | None = None  # [s]
        self._starts: dict[str, list[int]] = {}
        self._custom = {"kr270_milling_version": __version__, **{k: str(v) for k, v in (metadata or {}).items()}}
        self._schemas: dict[tuple, int] = {}
        self._mcap.start("ros2", f"kr270_milling/{__version__}")
        self.add_metadata("kr270_milling", self._custom)
        for attached, content in (attachments or {}).items():
            self.add_attachment(attached, content)

    @property
    def count(self) -> int:
        """Number of messages given to the file."""
        return self.output.count

    def add_attachment(self, name: str, content: bytes | memoryview | str) -> None:
        data = content.encode() if isinstance(content, str) else bytes(content)
        kind = "application/yaml" if name.endswith((".yaml", ".yml")) else "application/octet-stream"
        self._mcap.add_attachment(0, 0, name, kind, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._mcap.add_metadata(name, {str(k): str(v) for k, v in values.items()})

    def add_topic(self, topic: str, type_name: str, qos: Iterable = ()) -> int:
        """Prepare a topic with an installed message type; qos: profiles of its publishers, of rclpy.

        A known topic stays unchanged.
        """
        if topic in self.topics:
            known = self.channels[self.topics[topic]].type
            if known != type_name:
                raise RecordingError(self.path, f"{topic} is recorded as {known} and cannot be {type_name} as well")
            return self.topics[topic]
        about = {"offered_qos_profiles": files.qos_text(qos), "topic_type_hash": type_hash(type_name)}
        return self.add_channel(topic, (type_name, "ros2msg", definition(type_name).encode()), "cdr", about)

    def add_channel(self, topic: str, schema: tuple[str, str, bytes], encoding: str, about: dict) -> int:
        """Prepare a channel: schema (name, encoding, data), message encoding, metadata of the channel."""
        self.output.check()
        if schema not in self._schemas:
            self._schemas[schema] = self._mcap.register_schema(*schema) if schema[0] else 0
        number = self._mcap.register_channel(topic, encoding, self._schemas[schema], about)
        stamped = schema[1] == "ros2msg" and starts_with_stamp(schema[2].decode("utf-8", "replace"))
        profiles = files.read_qos(about.get("offered_qos_profiles", ""))
        digest = about.get("topic_type_hash", "")
        gaps = GapCounter(topic, self._starts, files.is_latched(about))
        self.channels[number] = WrittenChannel(number, topic, schema[0], encoding, profiles, digest, stamped, gaps)
        self.topics.setdefault(topic, number)
        return number

    def write(self, topic: str, data: bytes, publish_time: int, log_time: int | None = None) -> None:
        """Append one serialised message; times in ns. log_time: of its receipt, by default the publish time.

        Raises MessageRefused, RecordingError.
        """
        self.output.check()
        if topic not in self.topics:
            raise MessageRefused(self.path, f"{topic} is written to, but it was not added")
        channel = self.channels[self.topics[topic]]
        self.write_raw(channel.id, data, publish_time, publish_time if log_time is None else log_time, channel.count)

    def write_raw(self, channel_id: int, data: bytes, publish_time: int, log_time: int, sequence: int) -> None:
        """Append a message with given times and sequence. Raises MessageRefused, RecordingError."""
        channel = self.channels[channel_id]
        for time in (publish_time, log_time):
            if not 0 <= time < 2**63:
                channel.refused += 1
                raise MessageRefused(self.path, f"have the time {time} ns, which is not between 1970 and 2262")

        channel.count += 1
        self.output.check()
        self.output.count += 1
        self._mcap.add_message(channel.id, log_time, data, publish_time, sequence)
        self.start = log_time if self.start is None else min(self.start, log_time)
        self.end = max(self.end, log_time)
        stamp = stamp_of(data, channel.stamped)
        if stamp is not None and channel.type not in SHARED:
            channel.gaps.add(stamp)

    def tick(self, now: float) -> None:
        """Close the chunk after 0.2 s; now [s]: any clock that does not go back."""
        chunk_period = 0.2  # [s]; a SIGKILL loses the messages of this time
        self._last_chunk = min(now, now if self._last_chunk is None else self._last_chunk)
        if now - self._last_chunk >= chunk_period:
            self._last_chunk = now
            self.flush()

    def flush(self) -> None:
        """Write all messages into the file."""
        if not self.output.closed and self.output.saved < self.output.count:
            self._mcap.flush()

    def report(self) -> dict:
        """Return the counts of each topic: messages, missing messages by their stamps, refused messages."""
        counts: dict[str, dict] = {}
        for channel in self.channels.values():
            counts[channel.topic] = {"count": channel.count, **(channel.gaps.as_dict() if channel.stamped else {})}
            if channel.refused:
                counts[channel.topic]["refused"] = channel.refused
        return counts

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; a second call, or a call after an error, does nothing."""
        if self.output.closed:
            return
        for channel in self.channels.values():
            channel.gaps.finish()
        about = files.bag_information(self.path.name, self.channels.values(), self.start or 0, self.end, self._custom)
        self.flush()
        self.add_metadata("kr270_milling.counts", {k: json.dumps(v) for k, v in self.report().items()})
        self.add_metadata("rosbag2", {"serialized_metadata": files.yaml_text(about)})
        self._mcap.finish()
        self.output.close()
        neighbour = self.path.with_name("metadata.yaml")
        text = files.yaml_text({"rosbag2_bagfile_information": about})
        try:
            write_files({neighbour: (text.encode(),)})
        except InputError as error:
            raise RecordingError(neighbour, error.reason) from error

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        self.close()
