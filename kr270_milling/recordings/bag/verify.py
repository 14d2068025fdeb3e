"""Every checksum, every count and every index of a recording, compared with the records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex, Statistics

from kr270_milling.recordings.bag.chunks import ChunkContent, chunk_at
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.records import (
    HEAD,
    MAGIC,
    NO_RECORD,
    Damage,
    RecordPlace,
    attachment_at,
    checksum,
    parsed,
    read_bytes,
    record_at,
    walk,
)

__all__ = ["findings"]

MOST = 20  # sentences
INDEX_HEAD = HEAD.size + 2 + 4  # [bytes] of a message index before its entries: channel, size of the entries
INDEXES = {ChunkIndex: "chunks", AttachmentIndex: "attachments", MetadataIndex: "metadata"}


def findings(recording: Recording, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """One sentence for each damage, at most 20; none for a whole recording. Damage raises no error.

    A file whose writer left out a checksum or an index is whole without it.
    """
    check, footer, end = _Check(recording), recording.footer, None
    for place in walk(recording.stream, len(MAGIC), footer.offset if footer else recording.size):
        try:
            check.record(place)
        except Damage as damage:
            check.add(damage.reason, place.offset)
        end = place if place.opcode == Opcode.DATA_END else None
        if progress:
            progress(place.end, recording.size)
    if footer is None:
        check.sentences.insert(0, "it is cut off: its writer did not finish it")
    elif end is not None:
        try:
            check.end(end, footer)
        except Damage as damage:
            check.add(damage.reason, damage.offset)
    return check.sentences[:MOST]


class _Check:
    """What the end of the file must state of the records before it."""

    def __init__(self, recording: Recording):
        self.recording, self.stream = recording, recording.stream
        self.sentences: list[str] = []
        self._indexes: list[ChunkIndex | AttachmentIndex | MetadataIndex] = []
        self._counts: Counter[int] = Counter()  # channel -> messages
        self._times: list[int] = []  # [ns], of the first and the last message of each chunk
        self._chunk: tuple[ChunkIndex, ChunkContent] | None = None  # to which the following message indexes belong

    def add(self, reason: str, offset: int) -> None:
        self.sentences.append(f"{reason} (at byte {offset})")

    def record(self, place: RecordPlace) -> None:
        """Check one record of the data section. Raises Damage."""
        if place.opcode == Opcode.MESSAGE_INDEX:
            self._message_index(place)
            return
        self._finish_chunk()
        size = place.end - place.offset
        if place.opcode == NO_RECORD:
            raise Damage("these bytes are not a whole record", place.offset)
        if place.opcode == Opcode.CHUNK:
            self._open_chunk(place)
        elif place.opcode == Opcode.ATTACHMENT:
            one = attachment_at(self.stream, place)
            index = AttachmentIndex(
                place.offset, size, one.log_time, one.create_time, len(one.data), one.name, one.media_type
            )
            self._indexes.append(index)
        elif place.opcode == Opcode.METADATA:
            self._indexes.append(MetadataIndex(place.offset, size, record_at(self.stream, place).name))
        else:
            record = record_at(self.stream, place)
            if place.opcode == Opcode.MESSAGE:
                self._counts[record.channel_id] += 1
                self._times.append(record.log_time)

    def _open_chunk(self, place: RecordPlace) -> None:
        chunk = chunk_at(self.stream, place)
        content = self.recording.open_chunk(chunk)
        self._counts.update(content.counts)
        self._times += [content.first_time, content.last_time] * bool(len(content))
        index = ChunkIndex(
            chunk.end - chunk.offset, chunk.offset, chunk.compression, chunk.end - chunk.packed_at, chunk.last_time,
            0, {}, chunk.first_time, chunk.unpacked,
        )  # fmt: skip
        self._indexes.append(index)
        self._chunk = index, content
        unknown = set(content.counts) - set(self.recording.channels)
        if unknown:
            raise Damage(f"messages belong to channel {min(unknown)}, which is not defined", place.offset)

    def _message_index(self, place: RecordPlace) -> None:
        """Compare an index with the chunk before it; read by numpy, since mcap makes an object of each entry."""
        data = read_bytes(self.stream, place.offset, place.end - place.offset)
        entries = int.from_bytes(data[INDEX_HEAD - 4 : INDEX_HEAD], "little")
        if len(data) != INDEX_HEAD + entries or entries % 16:
            raise Damage("an index of messages has an impossible length", place.offset)
        if self._chunk is None and self.sentences:
            return  # the chunk before is damaged, which is a finding already
        if self._chunk is None:
            raise Damage("an index of messages belongs to no whole chunk", place.offset)
        index, content = self._chunk
        channel = int.from_bytes(data[HEAD.size : HEAD.size + 2], "little")
        index.message_index_offsets[channel] = place.offset
        index.message_index_length += len(data)
        here = np.frombuffer(content.channels, np.uint16) == channel
        times, offsets = np.frombuffer(content.times, np.uint64)[here], np.frombuffer(content.offsets, np.uint32)[here]
        listed, inside = np.frombuffer(data, "<u8", offset=INDEX_HEAD).reshape(-1, 2), np.stack([times, offsets], 1)
        if not np.array_equal(_sorted(listed), _sorted(inside)):
            raise Damage("an index points to other messages than its chunk holds", place.offset)

    def _finish_chunk(self) -> None:
        """After the indexes of a chunk: if there are indexes, each channel has one."""
        if self._chunk is not None:
            index, content = self._chunk
            missing = set(content.counts) - set(index.message_index_offsets)
            if index.message_index_offsets and missing:
                self.add(f"a chunk has no index for channel {min(missing)}", index.chunk_start_offset)
        self._chunk = None

    def end(self, end: RecordPlace, footer: RecordPlace) -> None:
        """Check the end of the data section, the summary and the footer. Raises Damage."""
        if record_at(self.stream, end).data_section_crc not in (0, checksum(self.stream, 0, end.offset)):
            self.add("the data do not fit the checksum at their end", end.offset)
        if record_at(self.stream, footer).summary_start != (0 if end.end == footer.offset else end.end):
            self.add("the footer does not point to the end of the data", footer.offset)
        summary = list(parsed(self.stream, end.end, self.recording.size))
        for kind, name in INDEXES.items():
            listed = [record for record in summary if isinstance(record, kind)]
            if listed and listed != [index for index in self._indexes if isinstance(index, kind)]:
                self.add(f"the index of {name} does not fit the records", end.end)
        for statistics in summary:
            if isinstance(statistics, Statistics) and self._statistics(statistics) != statistics:
                self.add("the counts of messages at the end are not those of the messages", end.end)

    def _statistics(self, stated: Statistics) -> Statistics:
        """Return the statistics of the records; a channel without messages is counted only if it is stated."""
        chunks, attachments, metadata = (sum(isinstance(index, kind) for index in self._indexes) for kind in INDEXES)
        return Statistics(
            attachment_count=attachments,
            channel_count=len(self.recording.channels),
            channel_message_counts=dict.fromkeys(stated.channel_message_counts, 0) | self._counts,
            chunk_count=chunks,
            message_count=self._counts.total(),
            message_end_time=max(self._times, default=0),
            message_start_time=min(self._times, default=0),
            metadata_count=metadata,
            schema_count=len(self.recording.schemas),
        )


def _sorted(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]
