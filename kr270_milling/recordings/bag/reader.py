"""An open recording: its topics, attachments and metadata, and its messages one by one.

Reading needs memory for one chunk, packed and unpacked, and about 100 MB more, whatever the size of the file.
A definition in a file is not trusted: its size and its arrays are limited.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mcap.records import AttachmentIndex, Channel, Schema

from kr270_milling.base.errors import InputError, RecordingError, nearest
from kr270_milling.base.units import SECOND
from kr270_milling.recordings.bag.files import find_recording, is_latched, is_rosbag, yaml_text
from kr270_milling.recordings.bag.mcap_file import LATEST, McapFile, OnDamage, RawMessage
from kr270_milling.recordings.messages.definitions import (
    RecordedTopic,
    definition,
    make_decoder,
)
from kr270_milling.recordings.messages.topics import TOPICS


class RosbagFile:
    """The content of a recording, with the attributes of an ``McapFile``. Raises RecordingError."""

    cut_off = False
    profile = "ros2"
    attachments: tuple[AttachmentIndex, ...] = ()  # rosbag2 has none

    def __init__(self, path: Path):
        from rosbags.rosbag2 import Reader
        from rosbags.rosbag2.metadata import dump_qos_v9

        self.path = path
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:
            raise RecordingError(path, f"cannot be read: {error}") from error
        self._connections = list(self._reader.connections)
        files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
        self.size = sum(file.stat().st_size for file in files)
        self.library = f"rosbag2 {self._reader.ros_distro or ''}".strip()
        self.counts = Counter({c.id: c.msgcount for c in self._connections})
        self.schemas = {c.id: Schema(c.id, *_definition_of(c)) for c in self._connections}
        self.channels = {}
        for c in self._connections:  # metadata as rosbag2 writes them into an MCAP file
            profiles = yaml_text(dump_qos_v9(c.ext.offered_qos_profiles)).strip()  # type: ignore[union-attr]
            about = {"offered_qos_profiles": profiles, "topic_type_hash": c.digest}
            self.channels[c.id] = Channel(c.id, c.topic, "cdr", about, c.id)
        custom = self._reader.storage.metadata.custom or {}
        self.metadata = {"custom_data": {str(key): str(value) for key, value in custom.items()}} if custom else {}
        count = self._reader.message_count
        self.first = self._reader.start_time if count else None
        self.last = self._reader.end_time - 1 if count else None

    def close(self) -> None:
        self._reader.close()

    def attachment(self, about: AttachmentIndex) -> bytes:
        raise RecordingError(self.path, f"has no attachment {about.name!r}")

    def messages(self, names: Mapping[int, str], on_damage: OnDamage | None = None) -> Iterator[RawMessage]:
        """Yield the messages on some channels in the order of their times in each file. Raises RecordingError."""
        chosen = [c for c in self._connections if c.id in names]
        try:
            for c, time, data in self._reader.messages(chosen) if chosen else ():
                if not 0 <= time < LATEST:
                    raise ValueError(f"a time of {time} ns is not between 1970 and 2262")
                yield RawMessage(names[c.id], time, time, bytes(data), c.id)
        except Exception as error:
            reason = f"cannot be read to its end: {error}"
            if on_damage is None or on_damage(reason, 0, 0):
                raise RecordingError(self.path, reason) from error


def _definition_of(connection) -> tuple[bytes, str, str]:
    """Return data, encoding and name of a type; a database of an old version has no definitions."""
    text, kind = connection.msgdef.data, connection.msgdef.format.name
    if kind == "NONE":
        try:
            text, kind = definition(connection.msgtype), "MSG"
        except RecordingError:
            text = ""
    encoding = {"MSG": "ros2msg", "IDL": "ros2idl"}.get(kind, "")
    return text.encode(), encoding, connection.msgtype


OWN = tuple(topic.name for topic in TOPICS if not topic.name.startswith("/"))


class Recording:
    """An open recording: an MCAP file, or what rosbag2 wrote. Raises RecordingError where it cannot be read.

    ``cut_off``: its writer did not finish the file; the file is read up to its last whole chunk.
    progress: called with (bytes read, bytes in all) where the file has no summary. on_damage: receives each damage, see
    ``OnDamage``; by default the first damage raises RecordingError.
    remap: our names -> recorded names, see ``remapping``.
    """

    def __init__(
        self,
        path,
        progress: Callable[[int, int], None] | None = None,
        on_damage: OnDamage | None = None,
        remap: Mapping[str, str] = MappingProxyType({}),
    ):
        self.path = find_recording(path)
        self.remap = remap
        bag = is_rosbag(self.path)
        self._file = RosbagFile(self.path) if bag else McapFile(self.path, progress, on_damage)
        self.size, self.cut_off = self._file.size, self._file.cut_off
        self.profile, self.library = self._file.profile, self._file.library
        self.channels, self.schemas, self.counts = self._file.channels, self._file.schemas, self._file.counts
        self.first_log_time, self.last_log_time = self._file.first, self._file.last
        self.attachments = self._file.attachments
        try:
            self._rename()
        except RecordingError:
            self.close()
            raise
        self._topics = self._list_topics()

    def _rename(self) -> None:
        """Give the channels our names of their topics."""
        recorded = {channel.topic for channel in self.channels.values()}
        # a topic with one of our names may be that of a robot
        spaces = {space for space, _, name in (topic.rpartition("/") for topic in recorded) if name in OWN}
        for name in self.remap.values():
            exact = {name} if name.startswith("/") else {f"{space}/{name}" for space in spaces}
            if not exact & recorded:
                listed = ", ".join(sorted(recorded)) or "no topic"
                raise RecordingError(self.path, f"has no topic {name}, but {listed}")
        for channel in self.channels.values():
            channel.topic = own_name(channel.topic, self.remap, spaces)

    def _list_topics(self) -> dict[str, RecordedTopic]:
        topics: dict[str, RecordedTopic] = {}
        texts = {number: schema.data.decode("utf-8", "replace") for number, schema in self.schemas.items()}
        for number, channel in self.channels.items():
            name, schema = channel.topic, self.schema_of(channel)
            text = texts.get(channel.schema_id, "")
            encoding, metadata = channel.message_encoding, channel.metadata
            about = RecordedTopic(schema.name, self.counts[number], encoding, text, schema.encoding, metadata)
            other = topics.get(name)
            if other is not None:  # a topic with two types has the type of the channel with more messages
                chosen = other if other.count > about.count else about
                about = dataclasses.replace(chosen, count=other.count + about.count)
            topics[name] = about
        return topics

    @property
    def count(self) -> int:
        return self.counts.total()

    @property
    def statistics(self):
        """The counts that the summary of an MCAP file states, or None."""
        return getattr(self._file, "statistics", None)

    def topics(self) -> dict[str, RecordedTopic]:
        """Topic name -> type, count and definition, in the order of appearance. Channels of one topic are one topic."""
        return self._topics

    def schema_of(self, channel: Channel) -> Schema:
        return self.schemas.get(channel.schema_id, Schema(id=0, data=b"", encoding="", name=""))

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self._file.metadata)

    def attachment(self, name: str) -> bytes:
        """The bytes of an attachment. Raises RecordingError."""
        for about in self.attachments:
            if about.name == name:
                return self._file.attachment(about)
        raise RecordingError(self.path, f"has no attachment {name!r}")

    def messages(
        self, topics: Collection[str] | None = None, on_damage: OnDamage | None = None
    ) -> Iterator[RawMessage]:
        """All messages, or those of some topics, in the order in which they were written.

        on_damage: receives each damage, and reading continues after the damage. Raises RecordingError.
        """
        names = {n: c.topic for n, c in self.channels.items() if topics is None or c.topic in topics}
        return self._file.messages(names, on_damage)

    def decoder(self, topic: str) -> Callable[[bytes], Any]:
        """A function from the bytes of a topic's messages to an object. Raises RecordingError."""
        return make_decoder(self.path, topic, self.topics()[topic])

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()


def remapping(rules: Iterable[str]) -> dict[str, str]:
    """Return our name -> recorded name of rules such as ``wrench:=force/measured``; raise InputError.

    Names are relative to the namespace of a robot. Where one of the two begins with a slash, both are absolute.
    """
    result = {}
    for rule in rules:
        own, colon, recorded = rule.partition(":=")
        if not (colon and own and recorded.strip("/")):
            raise InputError("--remap", f"{rule!r} is not NAME:=RECORDED, for example wrench:=force/measured")
        name = own.rpartition("/")[2]
        if name not in OWN or (own != name and not own.startswith("/")):
            raise InputError("--remap", f"{own!r} is not one of {', '.join(OWN)}{nearest(name, OWN)}")
        absolute = own.startswith("/") or recorded.startswith("/")
        result["/" + own.lstrip("/") if absolute else own] = "/" + recorded.lstrip("/") if absolute else recorded
    return result


def own_name(topic: str, remap: Mapping[str, str], namespaces: Collection[str]) -> str:
    """Return our name of a recorded topic; a recorded topic that has our name by chance gets the other one.

    A relative name belongs to each of the namespaces of robots.
    """
    for own, recorded in remap.items():
        for space in [""] if recorded.startswith("/") else namespaces:
            names = [f"{space}/{name.lstrip('/')}" for name in (recorded, own)]
            if topic in names:
                return names[topic == names[0]]
    return topic


def span(recording: Recording, start_offset: float, duration: float | None) -> tuple[int, int]:
    """Return first and last log time [ns] of a playback; offset and duration (None: to the end) in s."""
    first = next((message.log_time for message in recording.messages()), 0)
    start, last = first + round(start_offset * SECOND), recording.last_log_time or 0
    return start, last if duration is None else min(last, start + round(duration * SECOND))


def playback(recording: Recording, topics: Collection[str], start: int, end: int) -> Iterator[RawMessage]:
    """Yield the messages of some topics with log times from ``start`` to ``end``, in the order of the file.

    The last message before on each latched topic comes first, as for a late subscriber. The times never decrease, also
    where messages of another recorder are not in the order of their log times. Raises RecordingError.
    """
    known, latest = recording.topics(), 0
    before: dict[str, RawMessage] = {}  # the last message before the start, of latched topics
    for message in recording.messages(topics):
        latest = max(latest, message.log_time)
        if latest > end:
            break
        if latest >= start:
            yield from before.values()
            before.clear()
            yield message._replace(log_time=latest)
        elif is_latched(known[message.topic].metadata):
            before[message.topic] = message
    yield from before.values()
