"""A whole recording out of one that was cut off or damaged: what can be read is written again by our own writer."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from mcap.opcode import Opcode

from kr270_milling.bag.chunks import unpacked
from kr270_milling.bag.contents import Contents
from kr270_milling.bag.reader import FOOTER_SIZE, Recording, find_file, open_file
from kr270_milling.bag.structure import MAGIC, Attachment, Chunk, Damage, Part, attached, content, next_chunk, parts
from kr270_milling.bag.verify import findings
from kr270_milling.bag.writer import BagWriter, MessageRefused
from kr270_milling.base.errors import RecordingError

__all__ = ["Recovered", "recover"]

KNOWN = frozenset(range(0x01, 0x10))  # the record types of the format
PRIVATE = 0x80  # types from here on belong to applications


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
    file = find_file(source)
    place = Path(os.path.abspath(source))
    name = place.name if place.is_dir() else place.stem
    whole, damage = _judged(file)
    if whole and target is None:
        return whole
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        result = _written(file, part, target.name, progress)
        os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    result.directory = str(target)
    result.damage = damage
    result.whole = whole is not None and not result.dropped
    return result


def _judged(file: Path) -> tuple[Recovered | None, list[str]]:
    """What a whole recording holds, or None and what is wrong with it."""
    try:
        with Recording(file) as recording:
            damage = findings(recording)
            if damage:
                return None, damage
            found = Recovered(str(file), os.path.abspath(file.parent), True, recording.count, lost_messages=0)
            found.topics = {name: about.count for name, about in recording.topics().items()}
            found.first_log_time, found.last_log_time = recording.first_log_time, recording.last_log_time
            found.attachments = [about.name for about in recording.attachments]
            return found, []
    except RecordingError as error:
        return None, [error.reason]


def _written(file: Path, directory: Path, name: str, progress) -> Recovered:
    with open_file(file) as stream, BagWriter(directory, name) as writer:
        rescue = _Rescue(stream, writer, Recovered(str(file)))
        rescue.run(progress)
        if not rescue.found_anything:
            raise RecordingError(file, "nothing in it can be recovered")
        dropped = "\n".join(rescue.result.dropped) or "nothing"
        writer.add_metadata("recovered", {"source": file.name, "dropped": dropped})
        return rescue.finish()


class _Rescue:
    """The walk through a source that may be damaged anywhere."""

    def __init__(self, stream, writer: BagWriter, result: Recovered):
        self.stream, self.writer, self.result = stream, writer, result
        self.size = os.fstat(stream.fileno()).st_size
        self.contents = Contents(stream)
        self.numbers: dict[int, int] = {}  # channel in the source -> channel in the copy
        self.lost: Counter[str] = Counter()  # reason -> messages
        self.ended = self.found_anything = False

    def run(self, progress) -> None:
        self._read_summary()
        for part in self._parts():
            try:
                self._take(part)
            except Damage as damage:
                self._drop(part.offset, part.end - part.offset, damage.reason)
            if progress:
                progress(part.end, self.size)
        self.result.dropped += [f"{count} messages {reason}" for reason, count in self.lost.items()]

    def _read_summary(self) -> None:
        """Channels and counts from the end of the file, if it is there: they help where a chunk is lost."""
        if self.size < FOOTER_SIZE + len(MAGIC):
            return
        self.stream.seek(self.size - FOOTER_SIZE)
        footer = self.stream.read(FOOTER_SIZE)
        start = int.from_bytes(footer[9:17], "little")
        whole = footer.endswith(MAGIC) and footer[0] == Opcode.FOOTER
        if not whole or not len(MAGIC) <= start <= self.size - FOOTER_SIZE:
            return
        try:
            for part in parts(self.stream, start, self.size - FOOTER_SIZE):
                if part.type in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                    self.contents.take(part)
        except Damage as damage:
            self.result.dropped.append(f"the summary: {damage.reason}")

    def _parts(self) -> Iterator[Part]:
        """The records of the data section; behind a place that makes no sense from the next chunk on."""
        self.stream.seek(0)
        begin = len(MAGIC) if self.stream.read(len(MAGIC)) == MAGIC else 0
        if begin == 0:
            self.result.dropped.append("the first bytes are not those of an MCAP file")
            begin = next_chunk(self.stream, 0, self.size) or self.size
        while begin < self.size:
            end = begin
            for part in parts(self.stream, begin, self.size):
                if not self._plausible(part):
                    break
                end = part.end
                if part.type == Opcode.DATA_END:
                    self.ended = True
                    return
                yield part
            begin = next_chunk(self.stream, end + 1, self.size) or self.size
            if end < self.size:
                here = "the end of the file" if begin == self.size else f"byte {begin}"
                self._drop(end, begin - end, f"no whole record up to {here}")

    def _plausible(self, part: Part) -> bool:
        """Whether the lengths in a record agree: if not, where the next one begins is not known."""
        try:
            if part.type in (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA):
                Contents(self.stream).take(part)
            elif part.type == Opcode.MESSAGE_INDEX:
                return int.from_bytes(content(self.stream, part)[2:6], "little") + 6 == part.size
        except Damage:
            return False
        return part.type in KNOWN or part.type >= PRIVATE

    def _drop(self, offset: int, size: int, reason: str) -> None:
        self.result.lost_bytes += size
        self.result.dropped.append(f"{size} bytes at byte {offset}: {reason}")

    def _take(self, part: Part) -> None:
        found = self.contents.take(part)
        if isinstance(found, Chunk):
            self._messages(found)
        elif isinstance(found, Attachment):
            self.writer.add_attachment(found.name, attached(self.stream, found))
            self.result.attachments.append(found.name)
        elif part.type == Opcode.METADATA and found.name != "rosbag2":  # the copy gets its own
            self.writer.add_metadata(found.name, found.metadata)
        self.found_anything |= part.type in (
            Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE, Opcode.METADATA, Opcode.ATTACHMENT,
        )  # fmt: skip

    def _messages(self, chunk: Chunk) -> None:
        found = unpacked(self.stream, chunk)
        for record in found.definitions:
            self.contents.define(record, chunk.offset)
        for entry in found.entries():
            if entry.channel not in self.contents.channels:
                self.lost[f"of channel {entry.channel}, whose definition is lost"] += 1
                continue
            try:
                self.writer.write_raw(self._number(entry.channel), bytes(found.data[entry.begin : entry.end]),
                                      entry.publish_time, entry.log_time, entry.sequence)  # fmt: skip
            except MessageRefused as refused:
                self.lost[f"that {refused.reason}"] += 1

    def _number(self, channel: int) -> int:
        """The channel in the copy for one of the source."""
        if channel not in self.numbers:
            about = self.contents.channels[channel]
            schema = self.contents.schema_of(about)
            self.numbers[channel] = self.writer.add_channel(
                about.topic, (schema.name, schema.encoding, schema.data), about.message_encoding, about.metadata
            )
        return self.numbers[channel]

    def finish(self) -> Recovered:
        result, writer = self.result, self.writer
        for number in self.contents.channels:  # a topic without messages belongs to the recording too
            self._number(number)
        result.messages, result.first_log_time = writer.count, writer.start
        result.last_log_time = writer.end if writer.count else None
        for channel in writer.channels.values():
            result.topics[channel.topic] = result.topics.get(channel.topic, 0) + channel.count
        result.lost_messages = 0 if self.ended and not result.dropped else None
        if self.contents.counts is not None:
            result.lost_messages = max(self.contents.counts.total() - writer.count, 0)
        return result
