"""A whole recording out of one that was cut off or damaged."""

from __future__ import annotations

import os
import shutil
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from kr270_milling.bag import scan, unpack
from kr270_milling.bag.reader import find_file
from kr270_milling.bag.scan import MAGIC, Damage, Part
from kr270_milling.bag.writer import BagWriter
from kr270_milling.base.errors import RecordingError

__all__ = ["Recovered", "recover"]

KNOWN = frozenset(range(0x01, 0x10))  # the record types of the format
PRIVATE = 0x80  # types from here on belong to applications


@dataclass
class Recovered:
    """What was kept and what was lost; ``dropped``: one sentence per damaged place."""

    source: str
    directory: str = ""
    whole: bool = False  # the source was complete and without damage
    messages: int = 0
    topics: dict[str, int] = field(default_factory=dict)
    first_log_time: int | None = None
    last_log_time: int | None = None
    attachments: list[str] = field(default_factory=list)
    lost_bytes: int = 0
    lost_messages: int | None = None  # None: not known, where no count is left in the source
    dropped: list[str] = field(default_factory=list)

    def as_dict(self) -> dict:
        return asdict(self)


def recover(
    source, target=None, progress: Callable[[int, int], None] | None = None, leave_whole: bool = False
) -> Recovered:
    """Write what is readable of ``source`` into the new directory ``target`` (default: beside the source, which may be
    a file or a recording's directory, under its name with "_recovered").

    The source is not touched. The target appears at once when it is complete; it must not exist before.
    leave_whole: nothing is written for a source that is whole; ``directory`` is then where it is.
    """
    file = find_file(source)
    place = Path(os.path.abspath(source))
    name = place.name if place.is_dir() else place.stem
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        result = _copy(file, part, target.name, progress)
        if result.whole and leave_whole:
            target = place if place.is_dir() else place.parent
        else:
            os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    result.directory = str(target)
    return result


def _copy(file: Path, directory: Path, name: str, progress) -> Recovered:
    with _opened(file) as stream, BagWriter(directory, name) as writer:
        copy = _Copy(stream, os.fstat(stream.fileno()).st_size, writer, Recovered(str(file)))
        copy.run(progress)
        if not copy.found_anything:
            raise RecordingError(file, "nothing in it can be recovered")
        writer.add_metadata("recovered", {"source": file.name, "dropped": "\n".join(copy.result.dropped) or "nothing"})
        return copy.finish()


def _opened(file: Path):
    try:
        if not file.is_file():
            raise RecordingError(file, "is not a file")
        return open(file, "rb")
    except OSError as error:
        raise RecordingError(file, f"cannot be read: {error.strerror}") from error


class _Copy:
    """The walk through a source, with what is known so far."""

    def __init__(self, stream, size: int, writer: BagWriter, result: Recovered):
        self.stream, self.size, self.writer, self.result = stream, size, writer, result
        self.schemas: dict[int, scan.SchemaInfo] = {}
        self.channels: dict[int, scan.ChannelInfo] = {}
        self.numbers: dict[int, int] = {}  # channel in the source -> channel in the copy
        self.unknown: Counter[int] = Counter()
        self.claimed: int | None = None
        self.ended = self.footer = self.found_anything = False

    def run(self, progress) -> None:
        self._read_summary()
        for part in self._parts():
            try:
                self._take(part)
            except Damage as damage:
                self._drop(part.offset, part.size + 9, damage.reason)
            if progress:
                progress(part.start + part.size, self.size)
        for number, count in self.unknown.items():
            self.result.dropped.append(f"{count} messages of channel {number}, whose definition is lost")

    def _read_summary(self) -> None:
        """Channels and counts from the end of the file, if it is there: they help where a chunk is lost."""
        if self.size < 37 + len(MAGIC):
            return
        self.stream.seek(self.size - 37)
        footer = self.stream.read(37)
        (start,) = struct.unpack_from("<Q", footer, 9)
        self.footer = footer.endswith(MAGIC) and footer[0] == scan.FOOTER
        if not self.footer or not len(MAGIC) <= start <= self.size - 37:
            return
        try:
            for part in scan.parts(self.stream, start, self.size - 37):
                if part.type in (scan.SCHEMA, scan.CHANNEL):
                    self._define(part.type, scan.content(self.stream, part))
                elif part.type == scan.STATISTICS:
                    (self.claimed,) = scan.content(self.stream, part).unpack("Q")
        except Damage as damage:
            self.result.dropped.append(f"the summary: {damage.reason}")

    def _parts(self) -> Iterator[Part]:
        """The records of the data section; behind a place that makes no sense from the next chunk on."""
        self.stream.seek(0)
        begin = len(MAGIC) if self.stream.read(len(MAGIC)) == MAGIC else 0
        if begin == 0:
            self.result.dropped.append("the first bytes are not those of an MCAP file")
            begin = scan.next_chunk(self.stream, 0, self.size) or self.size
        while begin < self.size:
            end = begin
            for part in scan.parts(self.stream, begin, self.size):
                if not self._plausible(part):
                    break
                end = part.start + part.size
                if part.type == scan.DATA_END:
                    self.ended = True
                    return
                yield part
            begin = scan.next_chunk(self.stream, end + 1, self.size) or self.size
            if end < self.size:
                here = "the end of the file" if begin == self.size else f"byte {begin}"
                self._drop(end, begin - end, f"no whole record up to {here}")

    def _plausible(self, part: Part) -> bool:
        """Whether the lengths in a record agree: if not, where the next one begins is not known."""
        try:
            if part.type == scan.CHUNK:
                scan.chunk(self.stream, part)
            elif part.type == scan.ATTACHMENT:
                scan.attachment(self.stream, part)
            elif part.type == scan.METADATA:
                fields = scan.content(self.stream, part)
                fields.text(), fields.mapping()
            elif part.type == scan.MESSAGE_INDEX:
                return scan.content(self.stream, part).unpack("HI")[1] + 6 == part.size
        except Damage:
            return False
        return part.type in KNOWN or part.type >= PRIVATE

    def _drop(self, offset: int, size: int, reason: str) -> None:
        self.result.lost_bytes += size
        self.result.dropped.append(f"{size} bytes at byte {offset}: {reason}")

    def _define(self, kind: int, fields: scan.Fields) -> None:
        if kind == scan.SCHEMA:
            self.schemas.update([scan.schema(fields)])
        else:
            self.channels.update([scan.channel(fields)])

    def _take(self, part: Part) -> None:
        if part.type in (scan.CHUNK, scan.MESSAGE):
            self._messages(unpack.messages(self.stream, scan.chunk(self.stream, part)))
        elif part.type in (scan.SCHEMA, scan.CHANNEL):
            self._define(part.type, scan.content(self.stream, part))
        elif part.type == scan.ATTACHMENT:
            about = scan.attachment(self.stream, part)
            self.writer.add_attachment(about.name, scan.attached(self.stream, about))
            self.result.attachments.append(about.name)
        elif part.type == scan.METADATA:
            fields = scan.content(self.stream, part)
            name, entries = fields.text(), fields.mapping()
            if name != "rosbag2":  # the copy gets its own
                self.writer.add_metadata(name, entries)
        self.found_anything |= part.type in (scan.HEADER, scan.CHUNK, scan.MESSAGE, scan.METADATA, scan.ATTACHMENT)

    def _messages(self, found: unpack.Messages) -> None:
        self.schemas.update(found.schemas)
        self.channels.update(found.channels)
        for log_time, begin, end, channel, publish_time, sequence in found.index:
            if channel not in self.channels:
                self.unknown[channel] += 1
                continue
            if channel not in self.numbers:
                self.numbers[channel] = self._channel(self.channels[channel])
            number = self.numbers[channel]
            self.writer.write_raw(number, found.data[begin:end], publish_time, log_time, sequence)

    def _channel(self, about: scan.ChannelInfo) -> int:
        schema = self.schemas.get(about.schema_id, scan.SchemaInfo("", "", b""))
        return self.writer.add_channel(
            about.topic, (schema.name, schema.encoding, schema.data), about.encoding, about.metadata
        )

    def finish(self) -> Recovered:
        result, writer = self.result, self.writer
        for number, about in self.channels.items():  # a topic without messages belongs to the recording too
            if number not in self.numbers:
                self._channel(about)
        result.messages, result.first_log_time = writer.count, writer.start
        result.last_log_time = writer.end if writer.count else None
        for channel in writer.channels.values():
            result.topics[channel.topic] = result.topics.get(channel.topic, 0) + channel.count
        result.whole = self.ended and self.footer and not result.dropped
        result.lost_messages = 0 if self.ended and not result.dropped else None
        if self.claimed is not None:
            result.lost_messages = max(self.claimed - writer.count, 0)
        return result
