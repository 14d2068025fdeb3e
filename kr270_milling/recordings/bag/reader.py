"""An open recording: its topics, attachments and metadata, and its messages one by one.

Reading needs memory for one unpacked chunk and about 100 MB more, whatever the size of the file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Schema, Statistics

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.chunks import (
    Chunk,
    ChunkContent,
    RawMessage,
    chunk_at,
    open_chunk,
)
from kr270_milling.recordings.bag.decode import RecordedTopic, make_decoder
from kr270_milling.recordings.bag.records import (
    HEAD,
    MAGIC,
    NO_RECORD,
    PRIVATE,
    Damage,
    RecordPlace,
    attachment_at,
    checksum,
    mcap_file,
    open_to_read,
    parsed,
    record_at,
    walk,
)
from kr270_milling.recordings.bag.remap import own_name

__all__ = ["Attachment", "RawMessage", "RecordedTopic", "Recording"]

FOOTER = HEAD.pack(Opcode.FOOTER, 20)
FOOTER_SIZE = len(FOOTER) + 20 + len(MAGIC)
RUN = 1024 * 1024  # [bytes] of messages outside of chunks that are read together
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")


class Attachment(NamedTuple):
    """Name, type and size [bytes] of an attachment, and the place of its record."""

    name: str
    media_type: str
    size: int
    place: RecordPlace


class Recording:
    """An open recording. Raises RecordingError for a file that is not MCAP or is damaged.

    ``cut_off``: its writer did not finish the file; the file is read up to its last whole chunk.
    progress: called with (bytes read, bytes in all). on_damage: receives each damage and the bytes that are skipped
    (None: the summary); reading continues after them. By default the first damage raises RecordingError.
    remap: our names -> recorded names, see ``remapping``.
    """

    def __init__(
        self, path, progress: Callable[[int, int], None] | None = None,
        on_damage: Callable[[Damage, RecordPlace | None], None] | None = None,
        remap: Mapping[str, str] = MappingProxyType({}),
    ):  # fmt: skip
        self.path = mcap_file(path)
        self.remap = remap
        self._recorded: set[str] = set()  # names of the topics in the file
        self.stream = open_to_read(self.path)
        self.size = os.fstat(self.stream.fileno()).st_size
        self.profile: str | None = None  #: None: the file has no header
        self.library = ""
        self.counts: Counter[int] = Counter()  #: channel -> messages
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[Chunk] = []
        self.attachments: list[Attachment] = []
        self.statistics: Statistics | None = None  #: of the summary, if the summary defines every channel
        self.ended = False  #: the end of the data section was reached
        self._known: list[int] = []  # offsets of chunks and attachments by the summary
        self._metadata: dict[str, dict[str, str]] = {}
        self._on_damage = on_damage
        try:
            self.footer = self._find_footer()
            self.cut_off = self.footer is None
            with self._damage_as_error():
                self._open(progress)
            self._check_remap()
        except RecordingError:
            self.close()
            raise
        self._topics = self._list_topics()

    @contextlib.contextmanager
    def _damage_as_error(self) -> Iterator[None]:
        try:
            yield
        except Damage as damage:
            hint = "; recover may save the rest" if damage.offset else ""
            raise RecordingError(self.path, damage.reason + hint, damage.offset) from damage

    @contextlib.contextmanager
    def _reporting(self, place: RecordPlace | None) -> Iterator[None]:
        """Give a damage to ``on_damage``, with the offset of the record and not of a definition in its chunk."""
        try:
            yield
        except Damage as damage:
            damage.offset = place.offset if place else damage.offset
            if not self._on_damage:
                raise
            self._on_damage(damage, place)

    def _find_footer(self) -> RecordPlace | None:
        """Return the last record; None if the file does not end as a finished file ends."""
        at = self.size - FOOTER_SIZE
        self.stream.seek(max(at, 0))
        end = self.stream.read(FOOTER_SIZE)
        whole = at >= len(MAGIC) and end.startswith(FOOTER) and end.endswith(MAGIC)
        return RecordPlace(Opcode.FOOTER, at, self.size - len(MAGIC)) if whole else None

    def _open(self, progress) -> None:
        self.stream.seek(0)
        begin = self.stream.read(len(MAGIC))
        if begin != MAGIC and not self._on_damage:
            part = begin and MAGIC.startswith(begin)
            raise Damage("the file ends in its first bytes" if part else "this is not an MCAP file", 0)
        with self._reporting(None):
            self._read_summary()
        for place in walk(self.stream, len(MAGIC), self.footer.offset if self.footer else self.size, self._known):
            self.ended = place.opcode == Opcode.DATA_END
            with self._reporting(place):
                self._take(place)
            if progress:
                progress(place.end, self.size)
        if self.profile is None and not self._on_damage:
            raise Damage("the file ends before its header", len(MAGIC))
        stated = self.statistics
        if stated and stated.chunk_count not in (0, len(self.chunks)) and not self._on_damage:
            raise Damage(f"has {len(self.chunks)} chunks, but its summary counts {stated.chunk_count}", len(MAGIC))

    def _read_summary(self) -> None:
        """Read the definitions and the counts at the end of a finished file."""
        if self.footer is None:
            return
        footer = record_at(self.stream, self.footer)
        start = footer.summary_start
        if not start:
            return
        if not len(MAGIC) <= start <= self.footer.offset:
            raise Damage("the footer points to an impossible place", self.footer.offset)
        if footer.summary_crc not in (0, checksum(self.stream, start, self.footer.end - 4)):
            raise Damage("the summary at the end does not fit its checksum", start)
        for record in parsed(self.stream, start, self.size):
            if isinstance(record, Statistics):
                self.statistics = record
            elif isinstance(record, (Schema, Channel)):
                self._define(record)
            elif isinstance(record, ChunkIndex):
                self._known.append(record.chunk_start_offset)
            elif isinstance(record, AttachmentIndex):
                self._known.append(record.offset)
        self._known.sort()
        if self.statistics and set(self.statistics.channel_message_counts) <= set(self.channels):
            self.counts.update(self.statistics.channel_message_counts)
        else:
            self.statistics = None

    def _take(self, place: RecordPlace) -> None:
        """Take one record of the data section. Raises Damage."""
        if place.opcode == Opcode.CHUNK:
            chunk = chunk_at(self.stream, place)
            if not self.statistics:
                content = self.open_chunk(chunk)
                for definition in content.definitions:
                    self._define(record_at(content.stream(), definition))
                self.counts.update(content.counts)
            self.chunks.append(chunk)
        elif place.opcode == Opcode.MESSAGE:
            self._take_message(place)
        elif place.opcode == Opcode.HEADER:
            header = record_at(self.stream, place)
            self.profile, self.library = header.profile, header.library
        elif place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            self._define(record_at(self.stream, place))
        elif place.opcode == Opcode.ATTACHMENT:
            record = attachment_at(self.stream, place)
            self.attachments.append(Attachment(record.name, record.media_type, len(record.data), place))
        elif place.opcode > Opcode.DATA_END and place.opcode < PRIVATE:
            raise Damage("a record has an unknown opcode", place.offset)
        elif place.opcode == NO_RECORD and not self.cut_off:
            raise Damage("these bytes are not a whole record", place.offset)

    def _take_message(self, place: RecordPlace) -> None:
        """Take a message outside of chunks; consecutive messages are read together."""
        message = record_at(self.stream, place)
        last = self.chunks[-1] if self.chunks else None
        chunked = self.statistics.chunk_count if self.statistics else last and last.packed_at != last.offset
        if message.channel_id not in self.channels or chunked:
            raise Damage("a message is outside of the chunks", place.offset)
        if not self.statistics:
            self.counts[message.channel_id] += 1
        offset, first, latest = place.offset, message.log_time, message.log_time
        if last and last.end == offset and place.end - last.offset <= RUN:
            offset, first, latest = last.offset, min(last.first_time, first), max(last.last_time, latest)
            self.chunks.pop()
        self.chunks.append(Chunk(offset, place.end, first, latest, place.end - offset, "", offset))

    def _define(self, record) -> None:
        """Take a schema, a channel or metadata; a later definition replaces an earlier one."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self._recorded.add(record.topic)
            record.topic = own_name(record.topic, self.remap)
            self.channels[record.id] = record
        else:
            self._metadata[record.name] = record.metadata

    def _check_remap(self) -> None:
        for recorded in self.remap.values():
            if not any(topic.endswith("/" + recorded.lstrip("/")) for topic in self._recorded):
                listed = ", ".join(sorted(self._recorded)) or "no topic"
                raise RecordingError(self.path, f"has no topic {recorded}, but {listed}")

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
    def first_log_time(self) -> int | None:
        return min((chunk.first_time for chunk in self.chunks), default=None)

    @property
    def last_log_time(self) -> int | None:
        return max((chunk.last_time for chunk in self.chunks), default=None)

    def topics(self) -> dict[str, RecordedTopic]:
        """Topic name -> type, count and definition, in the order of appearance. Channels of one topic are one topic."""
        return self._topics

    def schema_of(self, channel: Channel) -> Schema:
        return self.schemas.get(channel.schema_id, NO_SCHEMA)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self._metadata)

    def attachment(self, name: str) -> bytes:
        """The bytes of an attachment. Raises RecordingError."""
        for about in self.attachments:
            if about.name == name:
                with self._damage_as_error():
                    return attachment_at(self.stream, about.place).data
        raise RecordingError(self.path, f"has no attachment {name!r}")

    def open_chunk(self, chunk: Chunk) -> ChunkContent:
        """The messages of a chunk. Raises Damage."""
        return open_chunk(self.stream, chunk)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """All messages, or those of some topics, in the order in which they were written."""
        names = {n: c.topic for n, c in self.channels.items() if topics is None or c.topic in topics}
        with self._damage_as_error():
            for chunk in self.chunks:
                yield from self._defined(chunk).messages(names)  # no name keeps a chunk while the next one is unpacked

    def _defined(self, chunk: Chunk) -> ChunkContent:
        """The messages of a chunk, all on known channels. Raises Damage."""
        content = self.open_chunk(chunk)
        for channel in content.counts:
            if channel not in self.channels:
                raise Damage(f"a message belongs to channel {channel}, which is not defined", chunk.offset)
        return content

    def decoded(self, topics: Collection[str] | None = None) -> Iterator[tuple[RawMessage, Any]]:
        """Messages with their fields as attributes: slow, but for any type of the "ros2msg" kind."""
        decoders = {}
        for message in self.messages(topics):
            if message.topic not in decoders:
                decoders[message.topic] = self.decoder(message.topic)
            yield message, decoders[message.topic](message.data)

    def decoder(self, topic: str) -> Callable[[bytes], Any]:
        """A function from the bytes of a topic's messages to an object. Raises RecordingError."""
        return make_decoder(self.path, topic, self.topics()[topic])

    def close(self) -> None:
        self.stream.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()
