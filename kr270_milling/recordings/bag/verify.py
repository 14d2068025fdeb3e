"""Every checksum, every count and every index of a recording, compared with the records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Statistics

from kr270_milling.recordings.bag.chunks import ChunkMessages
from kr270_milling.recordings.bag.reader import INDEXES, Recording, chunk_of
from kr270_milling.recordings.bag.records import (
    HEAD,
    MAGIC,
    ChunkPlace,
    Damage,
    RecordPlace,
    attachment_at,
    checksum,
    chunk_at,
    read_bytes,
    record_at,
    walk,
)

__all__ = ["findings"]

MOST = 20  # sentences
INDEX_HEAD = HEAD.size + 2 + 4  # [bytes] of a message index before its entries: channel, size of the entries


def findings(recording: Recording, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """One sentence for each damage, at most 20; none for a whole recording. Damage raises no error.

    A file whose writer left out a checksum or an index is whole without it.
    """
    return _Check(recording, progress).run()[:MOST]


class _Check:
    """One walk through the file.

    expected: opcode of an index -> offset of the record -> what the index must contain; None for a damaged record.
    """

    def __init__(self, recording: Recording, progress: Callable[[int, int], None] | None):
        self.recording, self.stream, self.progress = recording, recording.stream, progress
        self.sentences: list[str] = []
        self.expected: dict[int, dict[int, Any]] = {opcode: {} for opcode in INDEXES}
        self.counts: Counter[int] = Counter()  # channel -> messages
        self.listed: Counter[int] = Counter()  # opcode of an index -> number in the summary
        self.times: list[int] = []  # [ns], of the first and the last message of each chunk
        self.chunk: tuple[ChunkPlace, ChunkMessages] | None = None  # to which the following message indexes belong
        self.indexes: dict[int, int] = {}  # channel -> offset of its message index

    def run(self) -> list[str]:
        size = self.recording.size
        end = walk(self.stream, len(MAGIC), size, self._check_record, self._resume)
        self._finish_chunk()
        footer = self.recording.footer()
        if footer is None:
            self.sentences.insert(0, "it is cut off: its writer did not finish it")
        elif end is not None:
            if record_at(self.stream, end).data_section_crc not in (0, checksum(self.stream, 0, end.offset)):
                self.sentences.append(f"the data do not fit the checksum at their end (at byte {end.offset})")
            if record_at(self.stream, footer).summary_start != (0 if end.end == footer.offset else end.end):
                self.sentences.append(f"the footer does not point to the end of the data (at byte {footer.offset})")
            walk(self.stream, end.end, footer.offset, self._check_summary, self._resume)
            for opcode, number in self.listed.items():
                if number != len(self.expected[opcode]):
                    self.sentences.append(f"the index of {INDEXES[Opcode(opcode)]} is not complete")
        return self.sentences

    def _resume(self, damage: Damage, place: RecordPlace | None) -> int:
        self.sentences.append(f"{damage.reason} (at byte {damage.offset})")
        return place.end if place else self.recording.size

    def _check_record(self, place: RecordPlace) -> None:
        """One record of the data section."""
        if place.opcode == Opcode.MESSAGE_INDEX:
            self._check_message_index(place)
            return
        self._finish_chunk()
        size = place.end - place.offset
        if place.opcode == Opcode.CHUNK:
            self._check_chunk(place)
        elif place.opcode == Opcode.ATTACHMENT:
            self.expected[Opcode.ATTACHMENT_INDEX][place.offset] = None
            about = attachment_at(self.stream, place)
            self.expected[Opcode.ATTACHMENT_INDEX][place.offset] = size, about.name, len(about.data)
        elif place.opcode == Opcode.METADATA:
            self.expected[Opcode.METADATA_INDEX][place.offset] = None
            self.expected[Opcode.METADATA_INDEX][place.offset] = size, record_at(self.stream, place).name
        else:
            record = record_at(self.stream, place)
            if place.opcode == Opcode.MESSAGE:
                self.counts[record.channel_id] += 1
                self.times.append(record.log_time)
        if self.progress:
            self.progress(place.end, self.recording.size)

    def _check_chunk(self, place: RecordPlace) -> None:
        self.expected[Opcode.CHUNK_INDEX][place.offset] = None
        chunk, _ = chunk_at(self.stream, place)
        content = self.recording.read_chunk(chunk)
        self.counts.update(content.counts)
        self.times += [content.first_time, content.last_time] * bool(len(content))
        unknown = set(content.counts) - set(self.recording.channels)
        if unknown:
            raise Damage(f"messages belong to channel {min(unknown)}, which is not defined", place.offset)
        self.chunk = chunk, content

    def _check_message_index(self, place: RecordPlace) -> None:
        """An index of the messages of the chunk before it; read by numpy, since mcap makes an object of each entry."""
        data = read_bytes(self.stream, place.offset, place.end - place.offset)
        entries = int.from_bytes(data[INDEX_HEAD - 4 : INDEX_HEAD], "little")
        if len(data) != INDEX_HEAD + entries or entries % 16:
            raise Damage("an index of messages has an impossible length", place.offset)
        if self.chunk is None:
            if None not in self.expected[Opcode.CHUNK_INDEX].values():
                raise Damage("an index of messages belongs to no chunk", place.offset)
            return  # the chunk before is damaged, which is a finding already
        _, content = self.chunk
        channel = int.from_bytes(data[HEAD.size : HEAD.size + 2], "little")
        self.indexes[channel] = place.offset
        here = np.frombuffer(content.channels, np.uint16) == channel
        times, offsets = np.frombuffer(content.times, np.uint64)[here], np.frombuffer(content.offsets, np.uint32)[here]
        listed, inside = np.frombuffer(data, "<u8", offset=INDEX_HEAD).reshape(-1, 2), np.stack([times, offsets], 1)
        if not np.array_equal(listed, inside) and not np.array_equal(_sorted(listed), _sorted(inside)):
            raise Damage("an index points to other messages than its chunk holds", place.offset)

    def _finish_chunk(self) -> None:
        """After the indexes of a chunk: if there are indexes, each channel has one."""
        if self.chunk is None:
            return
        chunk, content = self.chunk
        self.expected[Opcode.CHUNK_INDEX][chunk.offset] = chunk, self.indexes
        missing = set(content.counts) - set(self.indexes)
        if self.indexes and missing:
            self.sentences.append(f"a chunk has no index for channel {min(missing)} (at byte {chunk.offset})")
        self.chunk, self.indexes = None, {}

    def _check_summary(self, place: RecordPlace) -> None:
        """One record between the end of the data and the footer."""
        record = record_at(self.stream, place)
        if place.opcode == Opcode.STATISTICS:
            self._check_statistics(record)
        if place.opcode not in INDEXES:
            return
        self.listed[place.opcode] += 1
        listed: tuple
        if place.opcode == Opcode.CHUNK_INDEX:
            offset, listed = record.chunk_start_offset, (chunk_of(record), record.message_index_offsets)
        elif place.opcode == Opcode.ATTACHMENT_INDEX:
            offset, listed = record.offset, (record.length, record.name, record.data_size)
        else:
            offset, listed = record.offset, (record.length, record.name)
        if self.expected[place.opcode].get(offset, ()) not in (None, listed):
            raise Damage(f"the index of {INDEXES[Opcode(place.opcode)]} does not fit the record", place.offset)

    def _check_statistics(self, statistics: Statistics) -> None:
        chunks, attachments, metadata = (len(self.expected[opcode]) for opcode in INDEXES)
        counted = Statistics(
            attachment_count=attachments,
            channel_count=len(self.recording.channels),
            channel_message_counts=dict(+self.counts),
            chunk_count=chunks,
            message_count=self.counts.total(),
            message_end_time=max(self.times, default=0),
            message_start_time=min(self.times, default=0),
            metadata_count=metadata,
            schema_count=len(self.recording.schemas),
        )
        statistics.channel_message_counts = dict(+Counter(statistics.channel_message_counts))
        if counted != statistics:
            self.sentences.append("the counts of messages at the end are not those of the messages")


def _sorted(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]
