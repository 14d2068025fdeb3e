"""A whole recording out of one that was cut off or damaged: what can be read is written again by our own writer."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from mcap.opcode import Opcode

from kr270_milling.bag.chunks import Chunk
from kr270_milling.bag.reader import Attachment, Recording
from kr270_milling.bag.structure import MAGIC, Damage, Part, exactly, mcap_file, next_chunk, parts
from kr270_milling.bag.verify import findings
from kr270_milling.bag.writer import BagWriter, MessageRefused
from kr270_milling.base.errors import RecordingError

__all__ = ["Recovered", "recover"]

KNOWN = frozenset(range(0x01, 0x10))  # the record types of the format
PRIVATE = 0x80  # types from here on belong to applications
HOLDING = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX)  # they hold lengths of their own
WRITE = 10.0  # [us] of work on a message


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
    file, place = mcap_file(source), Path(os.path.abspath(source))
    name = place.name if place.is_dir() else place.stem
    whole, damage = _judged(file)
    if whole and target is None:
        return whole
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with contextlib.closing(Salvage(file)) as rest, BagWriter(part, target.name) as writer:
            _copy(rest, writer, progress)
            lost_messages = rest.lost_messages(writer.count)
        with Recording(part) as copy:
            result = _described(copy)
        os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return replace(
        result, source=str(file), directory=str(target), whole=whole is not None and not rest.dropped,
        lost_bytes=rest.lost_bytes, lost_messages=lost_messages, dropped=rest.dropped, damage=damage,
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


class Salvage(Recording):
    """A file that may be damaged anywhere, with what can be read of it; ``dropped`` says what cannot."""

    def _read(self, progress) -> None:
        self.dropped: list[str] = []
        self.lost_bytes = 0
        self._ended = False
        try:
            self._read_summary()  # it helps where a chunk with definitions is lost
        except Damage as damage:
            self.counts = None  # any bit of them may be the wrong one
            self.dropped.append(f"the summary: {damage.reason}")
        self._beside = len(self.dropped)  # what is lost so far holds no message
        self._walk()
        self.attachments = [about for about in self.attachments if self._can_be_read(about, self.attached)]
        self.chunks = [chunk for chunk in self.chunks if self._can_be_read(chunk, self._defined_in)]
        if self.profile is None and not (self.chunks or self.attachments or self._metadata):
            raise Damage("nothing in it can be recovered", 0)

    def _walk(self) -> None:
        """Take the records of the data section; behind a place that makes no sense go on with the next chunk."""
        begin = len(MAGIC)
        if exactly(self.stream, 0, min(begin, self.size)) != MAGIC:
            self.dropped.append("the first bytes are not those of an MCAP file")
            begin = next_chunk(self.stream, 0, self.size)
        while begin < self.size:
            end = begin
            for part in parts(self.stream, begin, self.size):
                try:
                    self._take(part)
                except Damage as damage:
                    if part.type not in KNOWN or part.type in HOLDING:
                        break  # its length may be wrong too, so that nobody knows where the next one begins
                    self.drop(part.offset, part.end, damage.reason)
                end = part.end
                if part.type == Opcode.DATA_END:
                    self._ended = True
                    return
            begin = next_chunk(self.stream, end + 1, self.size)
            if end < self.size:
                self.drop(end, begin, f"no whole record up to byte {begin}")

    def _take(self, part: Part) -> None:
        if part.type not in KNOWN and part.type < PRIVATE:
            raise Damage("a record is of no known type", part.offset)
        index = part.type == Opcode.MESSAGE_INDEX
        if index and int.from_bytes(part.data()[11:15], "little") + 15 != part.size:
            raise Damage("an index of messages has an impossible length", part.offset)
        super()._take(part)

    def _can_be_read(self, place: Attachment | Chunk, read: Callable) -> bool:
        try:
            read(place)
        except Damage as damage:
            self.drop(place.offset, place.end, damage.reason)
            return False
        return True

    def drop(self, begin: int, end: int, reason: str) -> None:
        self.lost_bytes += end - begin
        self.dropped.append(f"{end - begin} bytes at byte {begin}: {reason}")

    def lost_messages(self, written: int) -> int | None:
        """How many, as far as the file tells how many it had."""
        if self.counts is not None:
            return max(self.counts.total() - written, 0)
        return 0 if self._ended and len(self.dropped) == self._beside else None


def _copy(source: Salvage, writer: BagWriter, progress: Callable[[int, int], None] | None) -> None:
    """Write everything that can be read."""
    for about in source.attachments:
        writer.add_attachment(about.name, source.attached(about))
    for name, values in source.metadata().items():
        if name != "rosbag2":  # the copy gets its own
            writer.add_metadata(name, values)
    numbers = {}  # of a channel in the source: that in the copy
    for number, channel in source.channels.items():
        schema = source.schema_of(channel)
        parsed = (schema.name, schema.encoding, schema.data)
        numbers[number] = writer.add_channel(channel.topic, parsed, channel.message_encoding, channel.metadata)
    lost: Counter[str] = Counter()
    for chunk in source.chunks:
        _copy_chunk(source, writer, chunk, numbers, lost)
        if progress:
            progress(chunk.end, source.size)
    source.dropped += [f"{count} messages {reason}" for reason, count in lost.items()]
    writer.add_metadata("recovered", {"source": source.path.name, "dropped": "\n".join(source.dropped) or "nothing"})


def _copy_chunk(source: Salvage, writer: BagWriter, chunk: Chunk, numbers: dict[int, int], lost: Counter[str]) -> None:
    """Its messages; numbers: of a channel in the source: that in the copy; lost: reason -> messages."""
    try:
        found = source.unpack(chunk)
        source.unpack.spend(WRITE * len(found), chunk.offset)
    except Damage as damage:
        source.drop(chunk.offset, chunk.end, damage.reason)
        return
    for entry in found:
        if entry.channel not in numbers:
            lost[f"of channel {entry.channel}, whose definition is lost"] += 1
            continue
        try:
            writer.write_raw(numbers[entry.channel], entry.data, entry.publish_time, entry.log_time, entry.sequence)
        except MessageRefused as refused:
            lost[f"that {refused.reason}"] += 1
