"""A whole recording out of one that was cut off or damaged: what can be read is written again by our own writer."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from mcap.opcode import Opcode

from kr270_milling.bag.chunks import Chunk, Unpacker
from kr270_milling.bag.contents import Contents
from kr270_milling.bag.reader import Recording, find_file, open_file
from kr270_milling.bag.structure import FOOTER_SIZE, MAGIC, Damage, Part, footer, next_chunk, parts
from kr270_milling.bag.verify import findings
from kr270_milling.bag.writer import BagWriter, MessageRefused
from kr270_milling.base.errors import RecordingError

__all__ = ["Recovered", "recover"]

KNOWN = frozenset(range(0x01, 0x10))  # the record types of the format
WRITE = 10.0  # [us] of work on a message
PRIVATE = 0x80  # types from here on belong to applications
HOLDING = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX)  # they hold lengths of their own


@dataclass
class Recovered:
    """What was saved and what was lost; ``dropped``: one sentence per damaged place."""

    source: str
    directory: str = ""  # of the whole recording: the source's own, where nothing had to be written
    whole: bool = False  # the source was complete and without damage
    messages: int = 0
    topics: dict[str, int] = field(default_factory=dict)
    first_log_time: int | None = None
    last_log_time: int | None = None
    attachments: list[str] = field(default_factory=list)
    lost_bytes: int = 0
    lost_messages: int | None = None  # None: not known, where no count is left in the source
    dropped: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)  # what was found; in a place without messages nothing is lost

    def as_dict(self) -> dict:
        return asdict(self)


def recover(source, target=None, progress: Callable[[int, int], None] | None = None) -> Recovered:
    """Write what is readable of ``source`` into the new directory ``target`` (default: beside the source, which may be
    a file or a recording's directory, under its name with "_recovered").

    The source is not touched. The target appears at once when it is complete; it must not exist before. A source that
    is whole is left alone: it is written again only where a target is named.
    """
    file, place = find_file(source), Path(os.path.abspath(source))
    name = place.name if place.is_dir() else place.stem
    whole, damage = _judged(file)
    if whole and target is None:
        return whole
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with open_file(file) as stream, BagWriter(part, target.name) as writer:
            rescue = _Rescue(stream, writer, file)
            rescue.run(progress)
        with Recording(part) as copy:
            result = _described(copy)
        os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return replace(
        result, source=str(file), directory=str(target), whole=whole is not None and not rescue.dropped,
        lost_bytes=rescue.lost_bytes, lost_messages=rescue.lost_messages, dropped=rescue.dropped, damage=damage,
    )  # fmt: skip


def _judged(file: Path) -> tuple[Recovered | None, list[str]]:
    """What a whole recording holds, or None and what is wrong with it."""
    try:
        with Recording(file) as recording:
            damage = findings(recording)
            return None if damage else _described(recording), damage
    except RecordingError as error:
        return None, [error.reason]


def _described(recording: Recording) -> Recovered:
    """What a whole recording holds."""
    return Recovered(
        source=str(recording.path),
        directory=os.path.abspath(recording.path.parent),
        whole=True,
        messages=recording.count,
        topics={name: about.count for name, about in recording.topics().items()},
        first_log_time=recording.first_log_time,
        last_log_time=recording.last_log_time,
        attachments=[about.name for about in recording.attachments],
        lost_messages=0,
    )


class _Rescue:
    """The walk through a source that may be damaged anywhere."""

    def __init__(self, stream, writer: BagWriter, file: Path):
        self.stream, self.writer, self.file = stream, writer, file
        self.size = os.fstat(stream.fileno()).st_size
        self.unpack, self.contents = Unpacker(stream, self.size), Contents()
        self.numbers: dict[int, int] = {}  # channel in the source -> channel in the copy
        self.lost_bytes = 0
        self.lost_messages: int | None = None
        self.dropped: list[str] = []
        self._lost: Counter[str] = Counter()  # reason -> messages
        self._ended = False

    def run(self, progress) -> None:
        self._read_summary()
        empty = True
        for part, found in self._records():
            try:
                self._copy(part, found)
                empty = empty and part.type not in (Opcode.HEADER, Opcode.MESSAGE, *HOLDING[:3])
            except Damage as damage:
                self._drop(part.offset, part.end, damage.reason)
            if progress:
                progress(part.end, self.size)
        if empty:
            raise RecordingError(self.file, "nothing in it can be recovered")
        for number in self.contents.channels:  # a topic without messages belongs to the recording too
            self._number(number)
        self.dropped += [f"{count} messages {reason}" for reason, count in self._lost.items()]
        if self.contents.counts is not None:
            self.lost_messages = max(self.contents.counts.total() - self.writer.count, 0)
        elif self._ended and not self.dropped:
            self.lost_messages = 0
        dropped = "\n".join(self.dropped) or "nothing"
        self.writer.add_metadata("recovered", {"source": self.file.name, "dropped": dropped})

    def _read_summary(self) -> None:
        """Channels and counts from the end of the file, if it is there: they help where a chunk is lost."""
        end = footer(self.stream, self.size)
        try:
            if end is not None and end.summary_start >= len(MAGIC):
                self.contents.take_summary(self.stream, end.summary_start, self.size - FOOTER_SIZE)
        except Damage as damage:
            self.dropped.append(f"the summary: {damage.reason}")

    def _records(self) -> Iterator[tuple[Part, object]]:
        """The records of the data section; behind a place that makes no sense from the next chunk on."""
        self.stream.seek(0)
        begin = len(MAGIC)
        if self.stream.read(begin) != MAGIC:
            self.dropped.append("the first bytes are not those of an MCAP file")
            begin = next_chunk(self.stream, 0, self.size)
        while begin < self.size:
            end = begin
            for part in parts(self.stream, begin, self.size):
                try:
                    found = self._taken(part)
                except Damage as damage:
                    if part.type not in KNOWN or part.type in HOLDING:
                        break  # its length may be wrong too, so that nobody knows where the next one begins
                    self._drop(part.offset, part.end, damage.reason)
                else:
                    yield part, found
                end = part.end
                if part.type == Opcode.DATA_END:
                    self._ended = True
                    return
            begin = next_chunk(self.stream, end + 1, self.size)
            if end < self.size:
                self._drop(end, begin, f"no whole record up to byte {begin}")

    def _taken(self, part: Part):
        if part.type not in KNOWN and part.type < PRIVATE:
            raise Damage("a record is of no known type", part.offset)
        index = part.type == Opcode.MESSAGE_INDEX
        if index and int.from_bytes(part.data[11:15], "little") + 15 != len(part.data):
            raise Damage("an index of messages has an impossible length", part.offset)
        return self.contents.take(part)

    def _drop(self, begin: int, end: int, reason: str) -> None:
        self.lost_bytes += end - begin
        self.dropped.append(f"{end - begin} bytes at byte {begin}: {reason}")

    def _copy(self, part: Part, found) -> None:
        if isinstance(found, Chunk):
            self._messages(found)
        elif part.type == Opcode.ATTACHMENT:
            self.writer.add_attachment(found.name, part.attached())
        elif part.type == Opcode.METADATA and found.name != "rosbag2":  # the copy gets its own
            self.writer.add_metadata(found.name, found.metadata)

    def _messages(self, chunk: Chunk) -> None:
        found = self.unpack(chunk)
        self.unpack.spend(WRITE * len(found), chunk.offset)
        for record in found.definitions:
            self.contents.define(record, chunk.offset)
        for entry in map(found.entry, range(len(found))):
            if entry.channel not in self.contents.channels:
                self._lost[f"of channel {entry.channel}, whose definition is lost"] += 1
                continue
            try:
                self.writer.write_raw(self._number(entry.channel), found.data[entry.begin : entry.end],
                                      entry.publish_time, entry.log_time, entry.sequence)  # fmt: skip
            except MessageRefused as refused:
                self._lost[f"that {refused.reason}"] += 1

    def _number(self, channel: int) -> int:
        """The channel in the copy for one of the source."""
        if channel not in self.numbers:
            about = self.contents.channels[channel]
            schema = self.contents.schema_of(about)
            self.numbers[channel] = self.writer.add_channel(
                about.topic, (schema.name, schema.encoding, schema.data), about.message_encoding, about.metadata
            )
        return self.numbers[channel]
