"""What the records of a file say it holds: definitions, chunks, attachments, metadata. Messages are not read here."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from kr270_milling.bag.chunks import Chunk
from kr270_milling.bag.structure import Damage, Part, parts
from kr270_milling.messages.decode import Topic

__all__ = ["Attachment", "Contents"]

MOST_DEFINED = 32 * 1024 * 1024  # [bytes] of names, definitions and metadata that are held
ENTRY = 150  # [bytes] that Python takes for an entry of a small record or mapping
MOST_CHUNKS = 250_000  # some 40 MB of places; 70 hours of a recorder that closes one every second
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")
TAKEN = (Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.STATISTICS,
         Opcode.DATA_END)  # fmt: skip


class Attachment(NamedTuple):
    """What is attached, how many bytes it has, and where its record is."""

    name: str
    media_type: str
    size: int
    offset: int
    end: int


class Contents:
    """Filled record by record by ``take``. Raises Damage where a file defines more than is bearable."""

    def __init__(self):
        self.profile = self.library = ""
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.chunks: list[Chunk] = []
        self.attachments: list[Attachment] = []
        self.metadata: dict[str, dict[str, str]] = {}  #: of several records with one name the last
        self.counts: Counter[int] | None = None  #: channel -> messages, where the file says it
        self.data_crc = 0
        self._defined = 0

    def take(self, part: Part):
        """Take one record of the top level; returns a Chunk, an Attachment or mcap's record."""
        kind = part.type
        found: Any = None
        if kind in (Opcode.CHUNK, Opcode.MESSAGE):
            found = Chunk.of(part)
            if len(self.chunks) == MOST_CHUNKS:
                raise Damage(f"the file has more than {MOST_CHUNKS} chunks", part.offset)
            self.chunks.append(found)
        elif kind in TAKEN:
            found = part.record()
        if kind == Opcode.ATTACHMENT:
            found = Attachment(found.name, found.media_type, len(found.data), part.offset, part.end)
            self._bear(ENTRY + len(found.name), part.offset)
            self.attachments.append(found)
        elif kind == Opcode.METADATA:
            self._bear(len(part.data) + ENTRY * len(found.metadata), part.offset)
            self.metadata[found.name] = found.metadata
        elif kind == Opcode.HEADER:
            self.profile, self.library = found.profile, found.library
        elif kind == Opcode.STATISTICS:
            self.counts = Counter(found.channel_message_counts)
        elif kind == Opcode.DATA_END:
            self.data_crc = found.data_section_crc
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.define(found, part.offset)
        return found

    def take_summary(self, stream, begin: int, end: int) -> None:
        """Schemas, channels and counts of the summary between two offsets."""
        for part in parts(stream, begin, end):
            if part.type in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                self.take(part)

    def define(self, record, offset: int) -> None:
        """Take a Schema or a Channel; one that was there already is replaced."""
        known = self.schemas if isinstance(record, Schema) else self.channels
        if known.get(record.id) == record:
            return
        if isinstance(record, Schema):
            size = len(record.data) + len(record.name)
        else:
            size = len(record.topic) + sum(ENTRY + len(key) + len(value) for key, value in record.metadata.items())
        self._bear(ENTRY + size, offset)
        known[record.id] = record

    def _bear(self, size: int, offset: int) -> None:
        self._defined += size
        if self._defined > MOST_DEFINED:
            raise Damage(f"names, definitions and metadata take more than {MOST_DEFINED} bytes", offset)

    def schema_of(self, channel: Channel) -> Schema:
        return self.schemas.get(channel.schema_id, NO_SCHEMA)

    def topics(self) -> dict[str, Topic]:
        """Topic name -> what it carries, in the order of first appearance. Channels of one topic are one topic."""
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
