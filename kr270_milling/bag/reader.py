"""A recording read back, in the order of its log times or, cut off or asked for, in the order of the file.

Nothing is read at once that grows with the file: messages come one by one out of one chunk, or out of several that take
32 MB together, with at most 64 MB beside; packing.py says where zstd takes more.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from kr270_milling.bag.chunks import Chunk, Entry, Unpacker
from kr270_milling.bag.structure import (
    MAGIC,
    SMALL,
    Damage,
    Part,
    checksum,
    footer,
    mcap_file,
    open_to_read,
    parts,
    record_of,
)
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.definitions import Topic, make_decoder

__all__ = ["BEGIN", "END", "Attachment", "Place", "RawMessage", "Recording", "Topic"]

Place = tuple[int, int]  # of a message in its file: offset of the chunk, offset in the unpacked chunk
BEGIN, END = (0, 0), (2**64, 0)  # no message stands before and none behind
MOST_DEFINED = 32 * 1024 * 1024  # [bytes] of names, definitions and metadata that are held
ENTRY = 150  # [bytes] that Python takes for an entry of a small record or mapping
MOST_CHUNKS = 250_000  # some 40 MB of places; 70 hours of a recorder that closes one every second
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")


class RawMessage(NamedTuple):
    """One message as it was recorded; times [ns]."""

    topic: str
    log_time: int
    publish_time: int
    data: bytes


class Attachment(NamedTuple):
    """What is attached, how many bytes it has, and where its record is."""

    name: str
    media_type: str
    size: int
    offset: int
    end: int


class Recording:
    """An open recording. ``cut_off`` tells that its writer did not finish it; then ``last_log_time`` is that of the
    last complete message. Raises RecordingError for what is no MCAP file or is damaged.

    progress: called with (bytes read, bytes in all) while a file without an index is looked through.
    """

    def __init__(self, path, progress: Callable[[int, int], None] | None = None):
        self.path = mcap_file(path)
        self.stream = open_to_read(self.path)
        self.size = os.fstat(self.stream.fileno()).st_size
        self.unpack = Unpacker(self.stream, self.size)
        self.profile: str | None = None  #: None: there is no header
        self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[Chunk] = []
        self.attachments: list[Attachment] = []
        self.counts: Counter[int] | None = None  #: channel -> messages; None: the file does not say it
        self.cut_off = True
        self.data_crc = 0
        self.data_end = len(MAGIC)  #: offset behind the last whole record of the data section
        self._metadata: dict[str, Metadata] = {}
        self._defined = 0  # [bytes]
        try:
            with self.sentences():
                self._read(progress)
        except RecordingError:
            self.close()
            raise
        self._topics = self._list_topics()

    @contextlib.contextmanager
    def sentences(self) -> Iterator[None]:
        """Turns Damage into a RecordingError of this file."""
        try:
            yield
        except Damage as damage:
            hint = "; recover may save the rest" if damage.offset else ""
            raise RecordingError(self.path, damage.reason + hint, damage.offset) from damage

    def spend(self, work: float) -> None:
        """Count work [us] on what the file holds; raises RecordingError where it is more than the size explains."""
        with self.sentences():
            self.unpack.spend(work, 0)

    # what the file says it holds

    def _read(self, progress) -> None:
        begin = self.stream.read(len(MAGIC))
        if begin != MAGIC:
            cut = begin and MAGIC.startswith(begin)
            raise Damage("the file ends in its first bytes" if cut else "this is not an MCAP file", 0)
        end = self._read_summary()
        for part in parts(self.stream, len(MAGIC), end or self.size):
            self._take(part)
            if part.type == Opcode.DATA_END:
                self.cut_off = not end
                break
            self.data_end = part.end
        if self.data_end == len(MAGIC):
            raise Damage("the file ends before its header", self.data_end)
        # messages beside chunks are rare: in most files they are another record, with a flipped bit in its type
        mixed = len({chunk.type for chunk in self.chunks}) == 2
        if mixed and not self.cut_off and self.data_crc not in (0, checksum(self.stream, 0, self.data_end)):
            raise Damage("the data do not fit the checksum at their end", self.data_end)
        if self.counts is None or not set(self.counts) <= set(self.channels):
            self._survey(progress)
        if self.cut_off and end:
            raise Damage("a record claims more bytes than the file has", self.data_end)

    def _read_summary(self) -> int:
        """Schemas, channels and counts from the end of the file, if it ends as a writer ends it; where that begins."""
        last = footer(self.stream, self.size)
        if last is None:
            return 0
        at, record = last.offset, last.record()
        start = record.summary_start
        if start:
            if not len(MAGIC) <= start <= at or at - start > SMALL:
                raise Damage("the footer points to an impossible place", at)
            for part in parts(self.stream, start, at):
                if part.type in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                    self._take(part)
            if record.summary_crc not in (0, checksum(self.stream, start, at + 25)):  # with the footer up to itself
                raise Damage("the summary at the end does not fit its checksum", start)
        return start or at

    def _take(self, part: Part) -> None:
        """One record of the top level, or a definition. Raises Damage, also where a file defines more than is
        bearable."""
        kind = part.type
        if kind in (Opcode.CHUNK, Opcode.MESSAGE):
            if len(self.chunks) == MOST_CHUNKS:
                raise Damage(f"the file has more than {MOST_CHUNKS} chunks", part.offset)
            self.chunks.append(Chunk.of(part))
        elif kind == Opcode.HEADER:
            header = part.record()
            self.profile, self.library = header.profile, header.library
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            self._define(kind, part.data(), part.offset)
        elif kind == Opcode.ATTACHMENT:
            record = part.record()
            self._bear(ENTRY + len(record.name), part.offset)
            self.attachments.append(Attachment(record.name, record.media_type, len(record.data), part.offset, part.end))
        elif kind == Opcode.STATISTICS:
            self.counts = Counter(part.record().channel_message_counts)
        elif kind == Opcode.DATA_END:
            self.data_crc = part.record().data_section_crc

    def _define(self, kind: int, data: bytes, offset: int) -> None:
        """Take a schema, a channel or metadata; one that was there already is replaced."""
        record = record_of(data, offset)
        key = record.name if kind == Opcode.METADATA else record.id
        known: dict = self._metadata
        if kind != Opcode.METADATA:
            known = self.schemas if kind == Opcode.SCHEMA else self.channels
        if known.get(key) != record:
            self._bear(len(data) + ENTRY * (1 + len(getattr(record, "metadata", ()))), offset)
            known[key] = record

    def _bear(self, size: int, offset: int) -> None:
        self._defined += size
        if self._defined > MOST_DEFINED:
            raise Damage(f"names, definitions and metadata take more than {MOST_DEFINED} bytes", offset)

    def _survey(self, progress) -> None:
        """Look through all chunks of a file without a summary: channels and counts."""
        self.counts = Counter()
        for chunk in self.chunks:
            self.counts += self._defined_in(chunk).counts
            if progress:
                progress(chunk.end, self.size)

    def _defined_in(self, chunk: Chunk):
        """The messages of a chunk, after its definitions were taken."""
        found = self.unpack(chunk)
        for kind, at, end in found.definitions:
            self._define(kind, found.data[at:end], chunk.offset)
        return found

    def _list_topics(self) -> dict[str, Topic]:
        found: dict[str, Topic] = {}
        counts = self.counts or Counter()
        texts = {number: schema.data.decode("utf-8", "replace") for number, schema in self.schemas.items()}
        for number, channel in self.channels.items():
            schema = self.schema_of(channel)
            count = counts[number] + (found[channel.topic].count if channel.topic in found else 0)
            text = texts.get(channel.schema_id, "")
            about = Topic(schema.name, count, channel.message_encoding, text, schema.encoding, channel.metadata)
            found[channel.topic] = about
        return found

    # what it holds, for its readers

    @property
    def count(self) -> int:
        return (self.counts or Counter()).total()

    @property
    def first_log_time(self) -> int | None:
        return min((c.first_time for c in self.chunks), default=None)

    @property
    def last_log_time(self) -> int | None:
        return max((c.last_time for c in self.chunks), default=None)

    def topics(self) -> dict[str, Topic]:
        """Topic name -> what it carries, in the order of first appearance. Channels of one topic are one topic."""
        return self._topics

    def schema_of(self, channel: Channel) -> Schema:
        return self.schemas.get(channel.schema_id, NO_SCHEMA)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return {name: record.metadata for name, record in self._metadata.items()}

    def attachment(self, name: str) -> bytes:
        for about in self.attachments:
            if about.name == name:
                with self.sentences():
                    return bytes(self.attached(about))
        raise RecordingError(self.path, f"nothing named {name!r} is attached")

    def attached(self, about: Attachment) -> bytes | memoryview:
        """The bytes of an attachment. Raises Damage where they do not fit their checksum."""
        (part,) = parts(self.stream, about.offset, about.end)
        return part.attached().data

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None, end: int | None = None, *,
        as_written: bool = False, within: tuple[Place, Place] = (BEGIN, END),
    ) -> Iterator[RawMessage]:  # fmt: skip
        """All messages, or those of some topics with ``start`` <= log time < ``end`` [ns]. In log-time order; a file
        that is cut off in its own order, and any file ``as_written``, so that its passes stay apart. within: the place
        of the first message and the one behind the last."""
        low, high = start or 0, 2**64 if end is None else end
        first, behind = within
        names = {n: c.topic for n, c in self.channels.items() if topics is None or c.topic in topics}
        chunks = [c for c in self.chunks if c.last_time >= low and c.first_time < high
                  and first[0] <= c.offset <= behind[0]]  # fmt: skip
        with self.sentences():
            for entry in self.entries(chunks, as_written):
                if entry.channel in names and low <= entry.log_time < high and first <= entry.place < behind:
                    yield RawMessage(names[entry.channel], entry.log_time, entry.publish_time, entry.data)
                del entry  # before the next one is made

    def entries(self, chunks: list[Chunk], as_written: bool) -> Iterator[Entry]:
        """Every message of some chunks. Raises Damage."""
        ordered = self.unpack.in_file_order if self.cut_off or as_written else self.unpack.in_time_order
        for entry in ordered(chunks):
            if entry.channel not in self.channels:
                raise Damage(f"a message belongs to channel {entry.channel}, which is not defined", entry.place[0])
            yield entry
            del entry

    def decoded(self, topics: Collection[str] | None = None, **limits) -> Iterator[tuple[RawMessage, Any]]:
        """Messages with their fields as attributes; the slow way for any type of the "ros2msg" kind."""
        decoders = {}
        for message in self.messages(topics, **limits):
            if message.topic not in decoders:
                decoders[message.topic] = self.decoder(message.topic)
            yield message, decoders[message.topic](message.data)

    def decoder(self, topic: str) -> Callable[[bytes], Any]:
        """A function from the bytes of a topic's messages to an object; raises RecordingError where it cannot."""
        return make_decoder(self, topic)

    def close(self) -> None:
        self.stream.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()
