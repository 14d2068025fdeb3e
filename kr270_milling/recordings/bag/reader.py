"""An open recording: its topics, attachments and metadata, and its messages one by one.

Reading needs memory for one unpacked chunk and 100 MB more, whatever the size of the file.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Schema, Statistics

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.chunks import ChunkReader, RawMessage
from kr270_milling.recordings.bag.decode import RecordedTopic, make_decoder
from kr270_milling.recordings.bag.records import (
    HEAD,
    MAGIC,
    ChunkPlace,
    Damage,
    RecordPlace,
    attachment_at,
    checksum,
    chunk_at,
    mcap_file,
    open_to_read,
    place_at,
    read_bytes,
    record_at,
    walk,
)

__all__ = ["BEGIN", "END", "INDEXES", "Attachment", "MessagePlace", "RawMessage", "RecordedTopic", "Recording",
           "chunk_of"]  # fmt: skip

MessagePlace = tuple[int, int]  # of a message: offset of its chunk, offset in the unpacked chunk
BEGIN, END = (0, 0), (2**64, 0)  # before the first message, after the last message
FOOTER = HEAD.pack(Opcode.FOOTER, 20)
FOOTER_SIZE = len(FOOTER) + 20 + len(MAGIC)
RUN = 1024 * 1024  # [bytes] of messages outside of chunks that are read together
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")


class Attachment(NamedTuple):
    """Name, type and size [bytes] of an attachment, and the place of its record."""

    name: str
    media_type: str
    size: int
    offset: int
    end: int


class Recording:
    """An open recording. Raises RecordingError for a file that is not MCAP or is damaged.

    ``cut_off``: its writer did not finish the file; the file is read up to its last whole chunk.
    progress: called with (bytes read, bytes in all) while a file without a complete summary is scanned.
    """

    def __init__(self, path, progress: Callable[[int, int], None] | None = None):
        self.path = mcap_file(path)
        self.stream = open_to_read(self.path)
        self.size = os.fstat(self.stream.fileno()).st_size
        self.cut_off = True
        self.profile: str | None = None  #: None: the file has no header
        self.library = ""
        self.counts: Counter[int] = Counter()  #: channel -> messages
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, McapChannel] = {}
        self.chunks: list[ChunkPlace] = []
        self.attachments: list[Attachment] = []
        self.read_chunk = ChunkReader(self.stream, self.channels)
        self._metadata: dict[str, dict[str, str]] = {}
        try:
            with self._damage_as_error():
                self._open(progress)
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

    def _open(self, progress) -> None:
        begin = self.stream.read(len(MAGIC))
        if begin != MAGIC:
            part = begin and MAGIC.startswith(begin)
            raise Damage("the file ends in its first bytes" if part else "this is not an MCAP file", 0)
        header = place_at(self.stream, len(MAGIC), self.size)
        if header is None:
            raise Damage("the file ends before its header", len(MAGIC))
        footer = self.footer()
        self.cut_off = footer is None
        if footer is not None and self._read_summary(footer):
            self._take(header)
            return
        if self._scan(self.size, progress) is None and footer is not None:
            raise Damage("a record claims more bytes than the file has", self.chunks[-1].end if self.chunks else 8)

    def footer(self) -> RecordPlace | None:
        """The last record; None if the file does not end as a finished file ends."""
        at = self.size - FOOTER_SIZE
        end = read_bytes(self.stream, at, FOOTER_SIZE) if at >= len(MAGIC) else b""
        whole = end.startswith(FOOTER) and end.endswith(MAGIC)
        return RecordPlace(Opcode.FOOTER, at, self.size - len(MAGIC)) if whole else None

    def _read_summary(self, footer: RecordPlace) -> bool:
        """Read the summary at the end of a finished file. Return whether it lists everything in the file."""
        record = record_at(self.stream, footer)
        start = record.summary_start
        if not start:
            return False
        if not len(MAGIC) <= start <= footer.offset:
            raise Damage("the footer points to an impossible place", footer.offset)
        if record.summary_crc not in (0, checksum(self.stream, start, footer.end - 4)):
            raise Damage("the summary at the end does not fit its checksum", start)
        statistics: list[Statistics] = []
        indexes: Counter[int] = Counter()

        def visit(place: RecordPlace) -> None:
            if place.opcode == Opcode.STATISTICS:
                statistics.append(record_at(self.stream, place))
            elif place.opcode in INDEXES:
                indexes[place.opcode] += 1
                self._take_index(place)
            else:
                self._take(place)

        walk(self.stream, start, footer.offset, visit)
        if not statistics:
            return False
        counted = statistics[-1]
        self.counts.update(counted.channel_message_counts)
        counts = (counted.chunk_count, counted.attachment_count, counted.metadata_count)
        complete = counts == tuple(indexes[opcode] for opcode in INDEXES)
        return complete and set(self.counts) <= set(self.channels) and (not counted.message_count or bool(self.chunks))

    def _take_index(self, place: RecordPlace) -> None:
        """Take what the summary says of a chunk, an attachment or metadata."""
        index = record_at(self.stream, place)
        if place.opcode == Opcode.CHUNK_INDEX:
            self._add_chunk(chunk_of(index))
        elif place.opcode == Opcode.ATTACHMENT_INDEX:
            end = index.offset + index.length
            self.attachments.append(Attachment(index.name, index.media_type, index.data_size, index.offset, end))
        else:
            metadata = place_at(self.stream, index.offset, self.size)
            if metadata is None or metadata.opcode != Opcode.METADATA:
                raise Damage("the index of metadata points to another record", place.offset)
            self._take(metadata)

    def _scan(
        self,
        end: int,
        progress: Callable[[int, int], None] | None = None,
        resume: Callable[[Damage, RecordPlace | None], int] | None = None,
    ) -> RecordPlace | None:
        """Read all records of the data section instead of the summary; return the end of the data section.

        The definitions of an incomplete summary stay.
        """
        self.chunks.clear()
        self.attachments.clear()
        self._metadata.clear()
        self.counts.clear()

        def visit(place: RecordPlace) -> None:
            self._take(place)
            if progress:
                progress(place.end, self.size)

        return walk(self.stream, len(MAGIC), end, visit, resume)

    def _take(self, place: RecordPlace) -> None:
        """Take one record of the data section, or a definition. Raises Damage."""
        if place.opcode == Opcode.CHUNK:
            chunk, _ = chunk_at(self.stream, place)
            content = self.read_chunk(chunk)
            self._add_chunk(chunk)
            for definition in content.definitions:
                self._define(record_at(content.stream(), definition))
            self.counts.update(content.counts)
        elif place.opcode == Opcode.MESSAGE:
            self._take_message(place)
        elif place.opcode == Opcode.HEADER:
            header = record_at(self.stream, place)
            self.profile, self.library = header.profile, header.library
        elif place.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            self._define(record_at(self.stream, place))
        elif place.opcode == Opcode.ATTACHMENT:
            record = attachment_at(self.stream, place)
            about = Attachment(record.name, record.media_type, len(record.data), place.offset, place.end)
            self.attachments.append(about)

    def _take_message(self, place: RecordPlace) -> None:
        """Take a message outside of chunks; consecutive messages are read together."""
        message = record_at(self.stream, place)
        self.counts[message.channel_id] += 1
        first = last = message.log_time
        offset, before = place.offset, self.chunks[-1] if self.chunks else None
        if before and before.opcode == place.opcode and before.end == offset and place.end - before.offset <= RUN:
            offset, first, last = before.offset, min(before.first_time, first), max(before.last_time, last)
            self.chunks.pop()
        self._add_chunk(ChunkPlace(place.opcode, offset, place.end, first, last, place.end - offset))

    def _add_chunk(self, chunk: ChunkPlace) -> None:
        if self.chunks and self.chunks[-1].opcode != chunk.opcode:  # no writer mixes both; an opcode is damaged
            raise Damage("the file has messages in chunks and outside of chunks", chunk.offset)
        self.chunks.append(chunk)

    def _define(self, record) -> None:
        """Take a schema, a channel or metadata; a later definition replaces an earlier one."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, McapChannel):
            self.channels[record.id] = record
        else:
            self._metadata[record.name] = record.metadata

    def _list_topics(self) -> dict[str, RecordedTopic]:
        topics: dict[str, RecordedTopic] = {}
        texts = {number: schema.data.decode("utf-8", "replace") for number, schema in self.schemas.items()}
        for number, channel in self.channels.items():
            name, schema = channel.topic, self.schema_of(channel)
            count = self.counts[number] + (topics[name].count if name in topics else 0)
            text = texts.get(channel.schema_id, "")
            encoding, metadata = channel.message_encoding, channel.metadata
            topics[name] = RecordedTopic(schema.name, count, encoding, text, schema.encoding, metadata)
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

    def schema_of(self, channel: McapChannel) -> Schema:
        return self.schemas.get(channel.schema_id, NO_SCHEMA)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self._metadata)

    def attachment(self, name: str) -> bytes:
        """The bytes of an attachment. Raises RecordingError."""
        for about in self.attachments:
            if about.name == name:
                with self._damage_as_error():
                    return self.read_attachment(about).data
        raise RecordingError(self.path, f"has no attachment {name!r}")

    def read_attachment(self, about: Attachment):
        """The record of an attachment. Raises Damage."""
        return attachment_at(self.stream, RecordPlace(Opcode.ATTACHMENT, about.offset, about.end))

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None, end: int | None = None, *,
        as_written: bool = False, within: tuple[MessagePlace, MessagePlace] = (BEGIN, END),
    ) -> Iterator[RawMessage]:  # fmt: skip
        """All messages, or those of some topics with ``start`` <= log time < ``end`` [ns].

        The order is that of the log times. A file that is cut off is read in its own order, and any file
        ``as_written``, which keeps its passes apart. within: place of the first message, and the place after the last.
        """
        low, high = start or 0, 2**64 if end is None else end
        first, after = within
        names = {n: c.topic for n, c in self.channels.items() if topics is None or c.topic in topics}
        chunks = [c for c in self.chunks if c.last_time >= low and c.first_time < high
                  and first[0] <= c.offset <= after[0]]  # fmt: skip
        ordered = self.read_chunk.in_file_order if self.cut_off or as_written else self.read_chunk.in_time_order
        with self._damage_as_error():
            for message in ordered(chunks, names):
                if low <= message.log_time < high and first <= message.place < after:
                    yield message
                del message  # before the next message is copied

    def decoded(self, topics: Collection[str] | None = None, **limits) -> Iterator[tuple[RawMessage, Any]]:
        """Messages with their fields as attributes: slow, but for any type of the "ros2msg" kind."""
        decoders = {}
        for message in self.messages(topics, **limits):
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


def chunk_of(index: ChunkIndex) -> ChunkPlace:
    """The chunk that an index in the summary describes."""
    begin, end = index.chunk_start_offset, index.chunk_start_offset + index.chunk_length
    first, last = index.message_start_time, index.message_end_time
    return ChunkPlace(
        Opcode.CHUNK, begin, end, first, last, index.uncompressed_size, index.compression, index.compressed_size
    )


INDEXES = {Opcode.CHUNK_INDEX: "chunks", Opcode.ATTACHMENT_INDEX: "attachments", Opcode.METADATA_INDEX: "metadata"}
