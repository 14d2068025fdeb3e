"""A recording read back, in the order of its log times or, cut off or asked for, in the order of the file.

Nothing is read at once that grows with the file: messages come one by one out of at most 64 MB of unpacked chunks
beside the one that is being read.
"""

from __future__ import annotations

import contextlib
import heapq
import os
import stat
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from kr270_milling.bag.chunks import CACHE, READ, Chunk, Entry, Messages, Unpacker
from kr270_milling.bag.contents import Contents
from kr270_milling.bag.structure import FOOTER_SIZE, MAGIC, SMALL, Damage, checksum, exactly, footer, parts
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.decode import Topic, make_decoder

__all__ = ["BEGIN", "END", "Place", "RawMessage", "Recording", "Topic", "find_file", "open_file"]

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
        self.unpack = Unpacker(self.stream, self.size)
        self.contents = Contents()
        self.chunks = self.contents.chunks
        self.attachments = self.contents.attachments
        self.cut_off = True
        self.data_end = len(MAGIC)  #: offset behind the last whole record of the data section
        try:
            with self.sentences():
                self._read(progress)
        except RecordingError:
            self.close()
            raise
        self.profile, self.library = self.contents.profile, self.contents.library
        self._topics = self.contents.topics()

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

    def _read(self, progress) -> None:
        begin = self.stream.read(len(MAGIC))
        if begin != MAGIC:
            cut = begin and MAGIC.startswith(begin)
            raise Damage("the file ends in its first bytes" if cut else "this is not an MCAP file", 0)
        end = footer(self.stream, self.size)
        summary = self._read_summary(end) if end and end.summary_start else self.size
        self._read_data(summary, finished=end is not None)
        if self.contents.counts is None or not set(self.contents.counts) <= set(self.contents.channels):
            self._survey(progress)
        if self.cut_off and end is not None:
            raise Damage("a record claims more bytes than the file has", self.data_end)

    def _read_summary(self, end) -> int:
        """Schemas, channels and counts from the end of the file; returns where the summary begins."""
        at, start = self.size - FOOTER_SIZE, end.summary_start
        if not len(MAGIC) <= start <= at or at - start > SMALL:
            raise Damage("the footer points to an impossible place", at)
        summary = exactly(self.stream, start, at + 25 - start)  # the checksum includes the footer up to itself
        if end.summary_crc and zlib.crc32(summary) != end.summary_crc:
            raise Damage("the summary at the end does not fit its checksum", start)
        self.contents.take_summary(self.stream, start, at)
        return start

    def _read_data(self, end: int, finished: bool) -> None:
        """Where everything is; the messages themselves are not read."""
        for part in parts(self.stream, len(MAGIC), end):
            self.contents.take(part)
            if part.type == Opcode.DATA_END:
                self.cut_off = not finished
                break
            self.data_end = part.end
        if self.data_end == len(MAGIC):
            raise Damage("the file ends before its header", self.data_end)
        # messages beside chunks are rare: in most files they are another record, with a flipped bit in its type
        mixed = len({chunk.type for chunk in self.chunks}) == 2
        crc = self.contents.data_crc
        if mixed and not self.cut_off and crc and checksum(self.stream, self.data_end) != crc:
            raise Damage("the data do not fit the checksum at their end", self.data_end)

    def _survey(self, progress) -> None:
        """Look through all chunks of a file without a summary: channels and counts."""
        counts: Counter[int] = Counter()
        for chunk in self.chunks:
            found = self.unpack(chunk)
            for record in found.definitions:
                self.contents.define(record, chunk.offset)
            counts.update(found.counts)
            if progress:
                progress(chunk.offset + chunk.size, self.size)
        self.contents.counts = counts

    @property
    def count(self) -> int:
        return (self.contents.counts or Counter()).total()

    @property
    def first_log_time(self) -> int | None:
        return min((c.first_time for c in self.chunks), default=None)

    @property
    def last_log_time(self) -> int | None:
        return max((c.last_time for c in self.chunks), default=None)

    def topics(self) -> dict[str, Topic]:
        """Topic name -> what it carries, in the order of first appearance. Channels of one topic are one topic."""
        return self._topics

    def metadata(self) -> dict[str, dict[str, str]]:
        """Record name -> entries; of several records with one name the last."""
        return dict(self.contents.metadata)

    def attachment(self, name: str) -> bytes:
        for about in self.attachments:
            if about.name == name:
                with self.sentences():
                    (part,) = parts(self.stream, about.offset, about.end)
                    return part.attached()
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
        with self.sentences():
            for entry, found in self.entries(chunks, as_written):
                if not low <= entry.log_time < high or not first <= (entry.chunk, entry.begin) < behind:
                    continue
                if entry.channel in names:
                    data = found.data[entry.begin : entry.end]
                    yield RawMessage(names[entry.channel], entry.log_time, entry.publish_time, data)

    def tables(self, topics: Collection[str]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Topic, log times [ns] (k,) and contents (k, length) of messages, each topic's as they were written.

        All topics come out of one pass through the file. Raises RecordingError.
        """
        numbers = {t: {n for n, c in self.contents.channels.items() if c.topic == t} for t in topics}
        with self.sentences():
            for chunk in self.chunks:
                found = self.unpack(chunk)
                self.unpack.spend(READ * len(found), chunk.offset)
                for channel in found.counts.keys() - self.contents.channels:
                    raise Damage(f"a message belongs to channel {channel}, which is not defined", chunk.offset)
                for topic, channels in numbers.items():
                    for times, table in found.alike(channels):
                        yield topic, times, table

    def entries(self, chunks: list[Chunk], as_written: bool) -> Iterator[tuple[Entry, Messages]]:
        """Every message of some chunks and the chunk that it is in. Raises Damage."""
        merged = not self.cut_off and not as_written
        for found, k in self._by_time(chunks) if merged else self._by_place(chunks):
            entry = found.entry(k)
            if entry.channel not in self.contents.channels:
                raise Damage(f"a message belongs to channel {entry.channel}, which is not defined", entry.chunk)
            yield entry, found

    def _by_place(self, chunks: list[Chunk]) -> Iterator[tuple[Messages, int]]:
        for chunk in chunks:
            found = self.unpack(chunk)
            self.unpack.spend(READ * len(found), chunk.offset)
            for k in range(len(found)):
                yield found, k

    def _by_time(self, chunks: list[Chunk]) -> Iterator[tuple[Messages, int]]:
        """By log times. A chunk is opened when its first time has come; of one that waits for its next message only
        the order is held, and it is unpacked again where it was forgotten meanwhile."""
        # the next message of each
        lanes: list[tuple] = [(chunk.first_time, chunk.offset, -1, chunk, iter(())) for chunk in chunks]
        heapq.heapify(lanes)
        held, bearable = 0, CACHE + 2 * self.size
        while lanes:
            _, offset, k, chunk, rest = lanes[0]
            found = self.unpack(chunk)
            if k < 0:
                rest, held = found.by_time(), held + 12 * len(found)
                self.unpack.spend(READ * len(found), offset)
                if held > bearable:
                    raise Damage("its chunks overlap in time so much that their messages cannot be sorted", offset)
            else:
                yield found, k
            following = next(rest, None)
            if following is None:
                heapq.heappop(lanes)
                held -= 12 * len(found)
            else:
                heapq.heapreplace(lanes, (following[0], offset, following[1], chunk, rest))

    def decoded(self, topics: Collection[str] | None = None, **limits) -> Iterator[tuple[RawMessage, Any]]:
        """Messages with their fields as attributes; the slow way for any type of the "ros2msg" kind."""
        decoders = {}
        for message in self.messages(topics, **limits):
            if message.topic not in decoders:
                decoders[message.topic] = self.decoder(message.topic)
            yield message, decoders[message.topic](message.data)

    def decoder(self, topic: str) -> Callable[[bytes], object]:
        """A function from the bytes of a topic's messages to an object; raises RecordingError where it cannot."""
        return make_decoder(self, topic)

    def close(self) -> None:
        self.stream.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()
