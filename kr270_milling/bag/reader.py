"""A recording read back, in the order of its log times or, cut off or asked for, in the order of the file.

Nothing is read at once that grows with the file: messages come one by one out of at most 64 MB of unpacked chunks
beside the one that is being read.
"""

from __future__ import annotations

import heapq
import os
import stat
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode

from kr270_milling.bag.chunks import CACHE, Entry, Messages, Unpacker
from kr270_milling.bag.contents import Contents
from kr270_milling.bag.structure import MAGIC, SMALL, Attachment, Chunk, Damage, attached, checksum, parsed, parts
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.decode import Topic, make_decoder

__all__ = ["BEGIN", "END", "Place", "RawMessage", "Recording", "Topic", "find_file", "open_file"]

FOOTER_SIZE = 9 + 20 + len(MAGIC)
Place = tuple[int, float]  # of a message in its file: offset of the chunk, offset in the unpacked chunk
BEGIN, END = (0, 0), (2**64, 0)  # no message stands before and none behind


class RawMessage(NamedTuple):
    """One message as it was recorded; times [ns]."""

    topic: str
    log_time: int
    publish_time: int
    data: bytes


def find_file(path) -> Path:
    """The MCAP file itself, or the one in a recording's directory."""
    path = Path(path)
    if not path.is_dir():
        return path
    files = sorted(path.glob("*.mcap"))
    if len(files) != 1:
        raise RecordingError(path, f"holds {len(files)} MCAP files where a recording has one")
    return files[0]


def open_file(path: Path):
    """A regular file, opened to be read. Raises RecordingError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not make us wait
    except (OSError, ValueError) as error:
        raise RecordingError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise RecordingError(path, "is not a file")
    return os.fdopen(file, "rb", buffering=65536)


class Recording:
    """An open recording. ``cut_off`` tells that its writer did not finish it; then ``last_log_time`` is that of the
    last complete message. Raises RecordingError for what is no MCAP file or is damaged.

    progress: called with (bytes read, bytes in all) while a file without an index is looked through.
    """

    def __init__(self, path, progress: Callable[[int, int], None] | None = None):
        self.path = find_file(path)
        self.stream = open_file(self.path)
        self.size = os.fstat(self.stream.fileno()).st_size
        self.unpack = Unpacker(self.stream)
        self.contents = Contents(self.stream)
        self.cut_off = True
        self.data_end = len(MAGIC)  #: offset behind the last whole record of the data section
        try:
            self._read(progress)
        except Damage as damage:
            self.close()
            raise self.error(damage) from damage
        self.profile = self.contents.profile
        self.library = self.contents.library

    def _read(self, progress) -> None:
        self._check_magic()
        summary = self._read_summary()
        self._read_data(summary or self.size)
        self._check_loose()
        if self.contents.counts is None:
            self._survey(progress)
        if self.cut_off and self.is_finished():
            raise Damage("a record claims more bytes than the file has", self.data_end)

    def _check_loose(self) -> None:
        """Messages beside chunks are rare: in most files they are another record, with a flipped bit in its type."""
        loose = {chunk.compression == "run" for chunk in self.chunks}
        crc = self.contents.data_crc
        if len(loose) == 2 and not self.cut_off and crc and checksum(self.stream, self.data_end) != crc:
            raise Damage("the data do not fit the checksum at their end", self.data_end)

    def _check_magic(self) -> None:
        begin = self.stream.read(len(MAGIC))
        if begin != MAGIC:
            cut = begin and MAGIC.startswith(begin)
            raise Damage("the file ends in its first bytes" if cut else "this is not an MCAP file", 0)

    def is_finished(self) -> bool:
        """Whether the file ends as a writer ends it: with a footer."""
        self.stream.seek(max(self.size - FOOTER_SIZE, 0))
        end = self.stream.read(FOOTER_SIZE)
        return end.endswith(MAGIC) and end[:9] == bytes([Opcode.FOOTER, 20]) + bytes(7)

    def _read_summary(self) -> int | None:
        """Schemas, channels and counts from the end of the file; returns where the summary begins."""
        if self.size < len(MAGIC) + FOOTER_SIZE or not self.is_finished():
            return None
        at = self.size - FOOTER_SIZE
        self.stream.seek(at + 9)
        footer = parsed(Opcode.FOOTER, self.stream.read(20), at)
        start = footer.summary_start
        if not start:
            return None
        if not len(MAGIC) <= start <= at or at - start > SMALL:
            raise Damage("the footer points to an impossible place", at)
        self.stream.seek(start)
        summary = self.stream.read(at + 25 - start)  # the checksum includes the footer up to itself
        if footer.summary_crc and zlib.crc32(summary) != footer.summary_crc:
            raise Damage("the summary at the end does not fit its checksum", start)
        for part in parts(self.stream, start, at):
            if part.type in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                self.contents.take(part)
        return start

    def _read_data(self, end: int) -> None:
        """Where everything is; the messages themselves are not read."""
        for part in parts(self.stream, len(MAGIC), end):
            self.contents.take(part)
            if part.type == Opcode.DATA_END:
                self.cut_off = not self.is_finished()
                break
            self.data_end = part.end
        if self.data_end == len(MAGIC):
            raise Damage("the file ends before its header", self.data_end)

    def _survey(self, progress) -> None:
        """Look through all chunks of a file without a summary: channels and counts."""
        counts: Counter[int] = Counter()
        for chunk in self.contents.chunks:
            found = self.unpack(chunk)
            for record in found.definitions:
                self.contents.define(record, chunk.offset)
            counts.update(found.counts)
            if progress:
                progress(chunk.start + chunk.size, self.size)
        self.contents.counts = counts

    def error(self, damage: Damage) -> RecordingError:
        hint = "; recover may save the rest" if damage.offset else ""
        return RecordingError(self.path, damage.reason + hint, damage.offset)

    @property
    def attachments(self) -> list[Attachment]:
        return self.contents.attachments

    @property
    def chunks(self) -> list[Chunk]:
        return self.contents.chunks

    @property
    def count(self) -> int:
        return sum(self.contents.counts.values())

    @property
    def first_log_time(self) -> int | None:
        return min((c.first_time for c in self.chunks), default=None)

    @property
    def last_log_time(self) -> int | None:
        return max((c.last_time for c in self.chunks), default=None)

    def topics(self) -> dict[str, Topic]:
        """Topic name -> what it carries, in the order of first appearance. Channels of one topic are one topic."""
        return self.contents.topics()

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self.contents.metadata)

    def attachment(self, name: str) -> bytes:
        for about in self.attachments:
            if about.name == name:
                try:
                    return attached(self.stream, about)
                except Damage as damage:
                    raise self.error(damage) from damage
        raise RecordingError(self.path, f"nothing named {name!r} is attached")

    def messages(
        self, topics: Collection[str] | None = None, start: int | None = None, end: int | None = None, *,
        as_written: bool = False, within: tuple[Place, Place] | None = None,
    ) -> Iterator[RawMessage]:  # fmt: skip
        """All messages, or those of some topics with ``start`` <= log time < ``end`` [ns]. In log-time order; a file
        that is cut off in its own order, and any file ``as_written``, so that its passes stay apart. within: the place
        of the first message and the one behind the last."""
        low, high = start or 0, 2**64 if end is None else end
        first, behind = within or (BEGIN, END)
        names = {n: c.topic for n, c in self.contents.channels.items() if topics is None or c.topic in topics}
        chunks = [c for c in self.chunks if c.last_time >= low and c.first_time < high
                  and first[0] <= c.offset <= behind[0]]  # fmt: skip
        try:
            for entry, found in self._entries(chunks, as_written):
                if not low <= entry.log_time < high or not first <= (entry.chunk, entry.begin) < behind:
                    continue
                if entry.channel in names:
                    data = bytes(found.data[entry.begin : entry.end])
                    yield RawMessage(names[entry.channel], entry.log_time, entry.publish_time, data)
                elif entry.channel not in self.contents.channels:
                    raise Damage(f"a message belongs to channel {entry.channel}, which is not defined", entry.chunk)
        except Damage as damage:
            raise self.error(damage) from damage

    def places(self) -> Iterator[tuple[Place, str, int]]:
        """Place, topic and log time of every message as written."""
        channels = self.contents.channels
        try:
            for entry, _ in self._entries(self.chunks, True):
                if entry.channel in channels:
                    yield (entry.chunk, entry.begin), channels[entry.channel].topic, entry.log_time
        except Damage as damage:
            raise self.error(damage) from damage

    def _entries(self, chunks: list[Chunk], as_written: bool) -> Iterator[tuple[Entry, Messages]]:
        if not self.cut_off and not as_written:
            yield from self._merged(chunks)
            return
        for chunk in chunks:
            found = self.unpack(chunk)
            for entry in found.entries():
                yield entry, found

    def _merged(self, chunks: list[Chunk]) -> Iterator[tuple[Entry, Messages]]:
        """By log times. A chunk is opened when its first time has come; of one that waits for its next message only
        the order is held, and it is unpacked again where it was forgotten meanwhile."""
        waiting = sorted(chunks, key=lambda c: (c.first_time, c.offset), reverse=True)
        lanes: list[tuple[int, int, int, Chunk, Iterator]] = []
        held, begun = 0, self.unpack.work
        bearable, work = CACHE + 2 * self.size, 20 * (CACHE + sum(chunk.unpacked for chunk in chunks))
        while waiting or lanes:
            while waiting and (not lanes or waiting[-1].first_time <= lanes[0][0]):
                chunk = waiting.pop()
                times, order = self.unpack(chunk).by_time()
                held += times.nbytes + order.nbytes
                self._advance(lanes, chunk, zip(times, order, strict=True))
            if held > bearable or self.unpack.work - begun > work:
                raise Damage("its chunks overlap in time so much that their messages cannot be sorted", len(MAGIC))
            if not lanes:
                return
            _, _, k, chunk, rest = heapq.heappop(lanes)
            found = self.unpack(chunk)
            yield found.entry(k), found
            if not self._advance(lanes, chunk, rest):
                held -= 12 * len(found)

    @staticmethod
    def _advance(lanes: list, chunk: Chunk, rest: Iterator) -> bool:
        """Put the next message of a chunk among the next ones of all; False where there is no more."""
        following = next(rest, None)
        if following is not None:
            heapq.heappush(lanes, (int(following[0]), chunk.offset, int(following[1]), chunk, rest))
        return following is not None

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

    def close(self) -> None:
        self.stream.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()
