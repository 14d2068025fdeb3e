"""A whole recording from a damaged file: everything that can be read is written again."""

from __future__ import annotations

import bisect
import contextlib
import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from mcap.opcode import Opcode

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.records import ChunkPlace, Damage, RecordPlace, mcap_file
from kr270_milling.recordings.bag.verify import findings
from kr270_milling.recordings.bag.writer import BagWriter, MessageRefused

__all__ = ["Recovered", "recover"]

KNOWN = frozenset(range(0x01, 0x10))  # opcodes of the format
PRIVATE = 0x80  # opcodes from here on belong to applications


@dataclass
class Recovered:
    """Saved and lost content of a file; ``dropped``: one sentence for each damaged place."""

    source: str
    directory: str = ""  # of the whole recording; the directory of the source if nothing had to be written
    whole: bool = False  # the source was complete and without damage
    messages: int = 0
    topics: dict[str, int] = field(default_factory=dict)
    first_log_time: int | None = None
    last_log_time: int | None = None
    attachments: list[str] = field(default_factory=list)
    lost_bytes: int = 0
    lost_messages: int | None = None  # None: the source does not contain the count
    dropped: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)  # findings in the source, also where no message is lost

    def as_dict(self) -> dict:
        return asdict(self)


def recover(source, target=None, progress: Callable[[int, int], None] | None = None) -> Recovered:
    """Write the readable content of ``source``, a file or the directory of a recording, into a new directory.

    target: by default the path of the source with "_recovered". The source is not changed. The target appears when it
    is complete; it must not exist before. A whole source is copied only if a target is given. Raises RecordingError.
    """
    file, place = mcap_file(source), Path(os.path.abspath(source))
    name = place.name if place.is_dir() else place.stem
    whole, damage = _examine(file)
    if whole and target is None:
        return whole
    target = Path(os.path.abspath(target or place.with_name(f"{name}_recovered")))
    if os.path.lexists(target):
        raise RecordingError(target, "exists already and is not overwritten")
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with contextlib.closing(Salvage(file)) as salvage, BagWriter(part, target.name) as writer:
            _copy(salvage, writer, progress)
            lost_messages = salvage.lost_messages(writer.count)
        with Recording(part) as copy:
            result = _describe(copy)
        os.rename(part, target)
    except OSError as error:
        raise RecordingError(target, f"cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return replace(
        result, source=str(file), directory=str(target), whole=whole is not None and not salvage.dropped,
        lost_bytes=salvage.lost_bytes, lost_messages=lost_messages, dropped=salvage.dropped, damage=damage,
    )  # fmt: skip


def _examine(file: Path) -> tuple[Recovered | None, list[str]]:
    """The content of a whole recording, or None and its damage."""
    try:
        with Recording(file) as recording:
            damage = findings(recording)
            return None if damage else _describe(recording), damage
    except RecordingError as error:
        return None, [error.reason]


def _describe(recording: Recording) -> Recovered:
    """The content of a whole recording."""
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
    """The readable content of a file that may be damaged anywhere; ``dropped``: a sentence for each lost place.

    After a damaged record reading continues at the next record that an undamaged summary lists. Without a summary it
    continues where the length of the damaged record ends.
    """

    def _open(self, progress) -> None:
        self.dropped: list[str] = []
        self.lost_bytes = 0
        self._total: int | None = None  # messages by the summary
        self._indexed: list[int] = []  # offsets of chunks and attachments by the summary
        footer = self.footer()
        self.cut_off = footer is None
        try:
            if footer is not None and self._read_summary(footer):
                self._total = self.count
                self._indexed = sorted(
                    [*(chunk.offset for chunk in self.chunks), *(about.offset for about in self.attachments)]
                )
        except Damage as damage:
            self.dropped.append(f"the summary: {damage.reason}")
        in_summary = len(self.dropped)  # this damage costs no message
        ended = self._scan(footer.offset if footer else self.size, resume=self._resume) is not None
        if self._total is None and ended and len(self.dropped) == in_summary:
            self._total = self.count
        if self.profile is None and not (self.chunks or self.attachments or self._metadata):
            raise Damage("nothing in it can be recovered", 0)

    def _resume(self, damage: Damage, place: RecordPlace | None) -> int:
        """Offset of the record after a damaged one, or the end."""
        position = bisect.bisect_right(self._indexed, damage.offset)
        if position < len(self._indexed):
            after = min(self._indexed[position], self.size)
        else:
            after = place.end if place and place.opcode in KNOWN else self.size
        self.drop(damage.offset, after, damage.reason)
        return after

    def _take_index(self, place: RecordPlace) -> None:
        if place.opcode != Opcode.METADATA_INDEX:  # metadata may be damaged; the walk reads them
            super()._take_index(place)

    def _take(self, place: RecordPlace) -> None:
        if place.opcode not in KNOWN and place.opcode < PRIVATE:
            raise Damage("a record has an unknown opcode", place.offset)
        if place.opcode == Opcode.MESSAGE and self.chunks and self.chunks[-1].opcode == Opcode.CHUNK:
            raise Damage("a message is outside of the chunks", place.offset)
        super()._take(place)

    def drop(self, begin: int, end: int, reason: str) -> None:
        self.lost_bytes += end - begin
        self.dropped.append(f"{end - begin} bytes at byte {begin}: {reason}")

    def lost_messages(self, written: int) -> int | None:
        """Number of lost messages, if the file states how many it had."""
        return None if self._total is None else max(self._total - written, 0)


def _copy(source: Salvage, writer: BagWriter, progress: Callable[[int, int], None] | None) -> None:
    """Write everything that can be read."""
    for about in source.attachments:
        writer.add_attachment(about.name, source.read_attachment(about).data)
    for name, values in source.metadata().items():
        if name != "rosbag2":  # the writer adds a new one
            writer.add_metadata(name, values)
    numbers = {}  # channel in the source -> channel in the copy
    for number, channel in source.channels.items():
        schema = source.schema_of(channel)
        parsed = (schema.name, schema.encoding, schema.data)
        numbers[number] = writer.add_channel(channel.topic, parsed, channel.message_encoding, channel.metadata)
    lost: Counter[str] = Counter()  # reason -> messages
    for chunk in source.chunks:
        _copy_chunk(source, writer, chunk, numbers, lost)
        if progress:
            progress(chunk.end, source.size)
    source.dropped += [f"{count} messages {reason}" for reason, count in lost.items()]
    writer.add_metadata("recovered", {"source": source.path.name, "dropped": "\n".join(source.dropped) or "nothing"})


def _copy_chunk(
    source: Salvage, writer: BagWriter, chunk: ChunkPlace, numbers: dict[int, int], lost: Counter[str]
) -> None:
    """Write the messages of a chunk; numbers: channel in the source -> channel in the copy."""
    try:
        content = source.read_chunk(chunk)
    except Damage as damage:
        source.drop(chunk.offset, chunk.end, damage.reason)
        return
    topics = {number: channel.topic for number, channel in source.channels.items()}
    for number in set(content.counts) - set(topics):
        lost[f"of channel {number}, whose definition is lost"] += content.counts[number]
    for message in content.messages(topics):
        number = numbers[message.channel]
        try:
            writer.write_raw(number, message.data, message.publish_time, message.log_time, message.sequence)
        except MessageRefused as refused:
            lost[f"that {refused.reason}"] += 1
        del message  # before the next message is copied
