"""A recording read back, in the order of its log times or, cut off or asked for, in the order of the file.

Nothing is read at once that grows with the file: messages come one by one out of at most 64 MB of unpacked chunks.
"""

from __future__ import annotations

import heapq
import os
import stat
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from kr270_milling.bag import scan
from kr270_milling.bag.find import find_file
from kr270_milling.bag.scan import MAGIC, Attachment, Chunk, Damage
from kr270_milling.bag.unpack import Unpacker
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.decode import Topic, make_decoder

__all__ = ["RawMessage", "Recording", "Topic", "find_file"]

FOOTER_SIZE = 9 + 20 + len(MAGIC)
Place = tuple[int, float]  # of a message in its file: offset of the chunk, offset in the unpacked chunk
BEGIN, END = (0, 0), (2**64, 0)  # no message stands before and none behind


class RawMessage(NamedTuple):
    """One message as it was recorded; times [ns]."""

    topic: str
    log_time: int
    publish_time: int
    data: bytes


class Recording:
    """An open recording. ``cut_off`` tells that its writer did not finish it; then ``last_log_time`` is that of the
    last complete message. Raises RecordingError for what is no MCAP file or is damaged.

    progress: called with (bytes read, bytes in all) while a file without an index is looked through.
    """

    def __init__(self, path, progress: Callable[[int, int], None] | None = None):
        self.path = find_file(path)
        self._stream = self._open()
        try:
            self._read_structure(progress)
        except Damage as damage:
            self.close()
            raise self._error(damage) from damage
        except RecordingError:
            self.close()
            raise

    def _open(self):
        try:
            file = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not make us wait
        except (OSError, ValueError) as error:
            raise RecordingError(self.path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
        if not stat.S_ISREG(os.fstat(file).st_mode):
            os.close(file)
            raise RecordingError(self.path, "is not a file")
        self.size = os.fstat(file).st_size
        return os.fdopen(file, "rb", buffering=65536)

    def _read_structure(self, progress) -> None:
        self.schemas: dict[int, scan.SchemaInfo] = {}
        self.channels: dict[int, scan.ChannelInfo] = {}
        self.chunks: list[Chunk] = []
        self.attachments: list[Attachment] = []
        self._metadata: list[tuple[str, dict[str, str]]] = []
        self.profile = self.library = ""
        self.cut_off = True
        self.data_crc = self._data_end = 0
        self._check_magic()
        self._counts: Counter[int] | None = None
        self._unpack = Unpacker(self._stream)
        summary = self._read_summary()
        self._read_data(summary or self.size)
        if self._counts is None:
            self._survey(progress)
        if self.cut_off and self._is_whole():
            raise Damage("a record claims more bytes than the file has", self._end)

    def _check_magic(self) -> None:
        begin = self._stream.read(len(MAGIC))
        if begin != MAGIC:
            cut = begin and MAGIC.startswith(begin)
            raise Damage("the file ends in its first bytes" if cut else "this is not an MCAP file", 0)

    def _is_whole(self) -> bool:
        self._stream.seek(max(self.size - FOOTER_SIZE, 0))
        end = self._stream.read(FOOTER_SIZE)
        return end.endswith(MAGIC) and end[:9] == scan.HEAD.pack(scan.FOOTER, 20)

    def _read_summary(self) -> int | None:
        """Schemas, channels and counts from the end of the file; returns where the summary begins."""
        if self.size < len(MAGIC) + FOOTER_SIZE or not self._is_whole():
            return None
        self._stream.seek(footer := self.size - FOOTER_SIZE)
        start, _, crc = struct.unpack("<QQI", self._stream.read(FOOTER_SIZE)[9:29])
        if not start:
            return None
        if not len(MAGIC) <= start <= footer or footer - start > scan.LIMIT:
            raise Damage("the footer points to an impossible place", footer)
        self._stream.seek(start)
        summary = self._stream.read(footer + 25 - start)  # the checksum includes the footer up to itself
        if crc and zlib.crc32(summary) != crc:
            raise Damage("the summary at the end does not fit its checksum", start)
        for part in scan.parts(self._stream, start, footer):
            self._take(part)
            if part.type == scan.STATISTICS:
                self._counts = self._read_counts(part)
        return start

    def _read_counts(self, part: scan.Part) -> Counter[int]:
        fields = scan.content(self._stream, part)
        fields.unpack("QHIIIIQQ")
        pairs = fields.take(fields.unpack("I")[0])
        return Counter(dict(struct.iter_unpack("<HQ", pairs[: len(pairs) // 10 * 10])))

    def _read_data(self, end: int) -> None:
        """Where everything is; the messages themselves are not read."""
        self._end = len(MAGIC)
        for part in scan.parts(self._stream, len(MAGIC), end):
            self._end = part.start + part.size
            self._take(part)
            if part.type == scan.DATA_END:
                (self.data_crc,), self._data_end = scan.content(self._stream, part).unpack("I"), part.offset
                self.cut_off = not self._is_whole()
                break
        if not self.profile and not self.library and self._end == len(MAGIC):
            raise Damage("the file ends before its header", self._end)

    def _take(self, part: scan.Part) -> None:
        if part.type in (scan.CHUNK, scan.MESSAGE):
            self.chunks.append(scan.chunk(self._stream, part))
        elif part.type == scan.ATTACHMENT:
            self.attachments.append(scan.attachment(self._stream, part))
        elif part.type == scan.SCHEMA:
            self.schemas.update([scan.schema(scan.content(self._stream, part))])
        elif part.type == scan.CHANNEL:
            self.channels.update([scan.channel(scan.content(self._stream, part))])
        elif part.type == scan.METADATA:
            fields = scan.content(self._stream, part)
            self._metadata.append((fields.text(), fields.mapping()))
        elif part.type == scan.HEADER:
            fields = scan.content(self._stream, part)
            self.profile, self.library = fields.text(), fields.text()

    def _survey(self, progress) -> None:
        """Look through all chunks of a file without a summary: channels and counts."""
        self._counts = Counter()
        for chunk in self.chunks:
            found = self._unpack(chunk)
            self.schemas.update(found.schemas)
            self.channels.update(found.channels)
            self._counts.update(entry[3] for entry in found.index)
            if progress:
                progress(chunk.start + chunk.size, self.size)

    def _error(self, damage: Damage) -> RecordingError:
        hint = "; recover may save the rest" if damage.offset else ""
        return RecordingError(self.path, damage.reason + hint, damage.offset)

    @property
    def count(self) -> int:
        return sum(self._counts.values())

    @property
    def first_log_time(self) -> int | None:
        return min((c.first_time for c in self.chunks), default=None)

    @property
    def last_log_time(self) -> int | None:
        return max((c.last_time for c in self.chunks), default=None)

    def topics(self) -> dict[str, Topic]:
        """Topic name -> what it carries, in the order of first appearance. Channels of one topic are one topic."""
        found: dict[str, Topic] = {}
        for number, channel in self.channels.items():
            schema = self.schemas.get(channel.schema_id, scan.SchemaInfo("", "", b""))
            count = self._counts[number] + (found[channel.topic].count if channel.topic in found else 0)
            text = schema.data.decode("utf-8", "replace")
            found[channel.topic] = Topic(schema.name, count, channel.encoding, text, schema.encoding, channel.metadata)
        return found

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self._metadata)

    def attachment(self, name: str) -> bytes:
        for about in self.attachments:
            if about.name == name:
                try:
                    return scan.attached(self._stream, about)
                except Damage as damage:
                    raise self._error(damage) from damage
        raise RecordingError(self.path, f"nothing named {name!r} is attached")

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None, end: int | None = None, *,
        as_written: bool = False, within: tuple[Place, Place] | None = None,
    ) -> Iterator[RawMessage]:  # fmt: skip
        """All messages, or those of some topics with ``start`` <= log time < ``end`` [ns]. In log-time order; a file
        that is cut off in its own order, and any file ``as_written``, so that its passes stay apart. within: the place
        of the first message and the one behind the last."""
        low, high = start or 0, 2**64 if end is None else end
        names = {n: c.topic for n, c in self.channels.items() if topics is None or c.topic in topics}
        first, behind = within or (BEGIN, END)
        chunks = [c for c in self.chunks if c.last_time >= low and c.first_time < high
                  and first[0] <= c.offset <= behind[0]]  # fmt: skip
        try:
            for log_time, at, begin, stop, channel, publish_time, _, chunk in self._entries(chunks, as_written):
                if not first <= (at, begin) < behind:
                    continue
                if channel in names and low <= log_time < high:
                    yield RawMessage(names[channel], log_time, publish_time, self._unpack(chunk).data[begin:stop])
                elif channel not in self.channels:
                    raise Damage(f"a message belongs to channel {channel}, which is not defined", chunk.offset)
        except Damage as damage:
            raise self._error(damage) from damage

    def places(self) -> Iterator[tuple[Place, str, int]]:
        """Place, topic and log time of every message as written."""
        try:
            for log_time, at, begin, _, channel, _, _, _ in self._entries(self.chunks, True):
                if channel in self.channels:
                    yield (at, begin), self.channels[channel].topic, log_time
        except Damage as damage:
            raise self._error(damage) from damage

    def _entries(self, chunks: list[Chunk], as_written: bool) -> Iterator[tuple]:
        if self.cut_off or as_written:
            for chunk in chunks:
                yield from self._chunk_entries(chunk, ordered=False)
            return
        lanes = [self._lane(chunk) for chunk in sorted(chunks, key=lambda c: c.first_time)]
        yield from (entry for entry in heapq.merge(*lanes) if entry[2] >= 0)

    def _lane(self, chunk: Chunk) -> Iterator[tuple]:
        """A chunk's messages by time; the first entry only keeps its place, so that the chunk is unpacked late."""
        yield chunk.first_time, chunk.offset, -1
        yield from self._chunk_entries(chunk, ordered=True)

    def _chunk_entries(self, chunk: Chunk, ordered: bool) -> Iterator[tuple]:
        index = self._unpack(chunk).index
        for time, begin, stop, channel, publish, sequence in sorted(index) if ordered else index:
            yield time, chunk.offset, begin, stop, channel, publish, sequence, chunk

    def decoded(self, topics: Collection[str] | None = None, **limits) -> Iterator[tuple[RawMessage, object]]:
        """Messages with their fields as attributes; the slow way for any type of the "ros2msg" kind."""
        decoders = {}
        for message in self.messages(topics, **limits):
            if message.topic not in decoders:
                decoders[message.topic] = self.decoder(message.topic)
            yield message, decoders[message.topic](message.data)

    def decoder(self, topic: str) -> Callable[[bytes], object]:
        """A function from the bytes of a topic's messages to an object; raises RecordingError where it cannot."""
        return make_decoder(self.path, topic, self.topics()[topic])

    def verify(self) -> bool:
        """Read the whole file against all its checksums; True where it has one over everything, else False (only the
        chunks were checked). Raises RecordingError at the first damage."""
        for _ in self.messages():
            pass
        for about in self.attachments:
            self.attachment(about.name)
        if not self.data_crc:
            return False
        crc, left = 0, self._data_end
        self._stream.seek(0)
        while left:
            data = self._stream.read(min(left, 1 << 20))
            crc, left = zlib.crc32(data, crc), left - len(data)
            if not data:
                break
        if crc != self.data_crc:
            raise RecordingError(self.path, "the data do not fit the checksum at the end of the file")
        return True

    def close(self) -> None:
        self._stream.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()
