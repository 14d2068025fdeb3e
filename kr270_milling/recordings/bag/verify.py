"""Every checksum, every count and every index of a recording, compared with the records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import yaml
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex, Statistics, SummaryOffset

from kr270_milling.recordings.bag.chunks import ChunkMessages
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.records import (
    HEAD,
    MAGIC,
    Damage,
    RecordPlace,
    attachment_at,
    checksum,
    places,
    read_bytes,
    record_at,
)

__all__ = ["findings"]

MOST = 20  # sentences
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
YAML_LIMIT = 256 * 1024  # [bytes] of metadata.yaml; the YAML reader takes seconds for them
INDEX_HEAD = HEAD.size + 2 + 4  # [bytes] of a message index before its entries: channel, size of the entries
INDEXES = {Opcode.CHUNK_INDEX: "chunks", Opcode.ATTACHMENT_INDEX: "attachments", Opcode.METADATA_INDEX: "metadata"}


def findings(recording: Recording, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """One sentence for each damage, at most 20; none for a whole recording. Damage raises no error.

    A file whose writer left out a checksum or an index is whole without it.
    """
    check = _Check(recording)
    check.attempt(check.run, progress)
    return (check.sentences + _metadata_file(recording))[:MOST]


class _Check:
    """One pass through the file. ``expected``: the indexes that the summary must contain, by opcode and offset."""

    def __init__(self, recording: Recording):
        self.recording, self.stream = recording, recording.stream
        self.sentences: list[str] = []
        self.expected: dict[int, dict[int, object]] = {opcode: {} for opcode in INDEXES}
        self.counts: Counter[int] = Counter()  # channel -> messages
        self.times: list[int] = []  # [ns], of the first and the last message of each chunk
        self.chunk: ChunkIndex | None = None  # to which the following indexes of messages belong
        self.content: ChunkMessages | None = None

    def attempt(self, call: Callable, *args) -> None:
        """Call a function; its damage becomes a sentence."""
        try:
            call(*args)
        except Damage as damage:
            self.sentences.append(f"{damage.reason} (at byte {damage.offset})")

    def run(self, progress) -> None:
        end = None
        for place in places(self.stream, len(MAGIC), self.recording.size):
            if place.opcode != Opcode.MESSAGE_INDEX:
                self.attempt(self._finish_chunk)
            if place.opcode == Opcode.DATA_END:
                end = place
                break
            self.attempt(self._check_record, place)
            if progress:
                progress(place.end, self.recording.size)
        self.attempt(self._finish_chunk)
        footer = self.recording.footer()
        if footer is None:
            self.sentences.insert(0, "it is cut off: its writer did not finish it")
        elif end is None:
            self.sentences.append("a record in the data has an impossible length")
        else:
            if self._record(end).data_section_crc not in (0, checksum(self.stream, 0, end.offset)):
                self.sentences.append(f"the data do not fit the checksum at their end (at byte {end.offset})")
            self._check_summary(end.end, footer)

    def _record(self, place: RecordPlace):
        return record_at(self.stream, place)

    def _check_record(self, place: RecordPlace) -> None:
        """One record of the data section."""
        if place.opcode == Opcode.CHUNK:
            self._check_chunk(place)
        elif place.opcode == Opcode.MESSAGE_INDEX:
            self._check_message_index(place)
        elif place.opcode == Opcode.ATTACHMENT:
            self.expected[Opcode.ATTACHMENT_INDEX][place.offset] = None
            a = attachment_at(self.stream, place)
            size = place.end - place.offset
            self.expected[Opcode.ATTACHMENT_INDEX][place.offset] = AttachmentIndex(
                place.offset, size, a.log_time, a.create_time, len(a.data), a.name, a.media_type
            )
        elif place.opcode == Opcode.METADATA:
            self.expected[Opcode.METADATA_INDEX][place.offset] = None
            index = MetadataIndex(place.offset, place.end - place.offset, self._record(place).name)
            self.expected[Opcode.METADATA_INDEX][place.offset] = index
        elif place.opcode == Opcode.MESSAGE:
            message = self._record(place)
            self.counts[message.channel_id] += 1
            self.times += [message.log_time]
        else:
            self._record(place)

    def _check_chunk(self, place: RecordPlace) -> None:
        self.expected[Opcode.CHUNK_INDEX][place.offset] = None
        chunk, content = self.recording.read_chunk.survey(place)
        self.counts.update(content.counts)
        self.times += [content.first_time, content.last_time] * bool(len(content))
        unknown = set(content.counts) - set(self.recording.channels)
        if unknown:
            raise Damage(f"messages belong to channel {min(unknown)}, which is not defined", place.offset)
        self.content = content
        self.chunk = ChunkIndex(
            chunk_length=chunk.size,
            chunk_start_offset=chunk.offset,
            compression=content.compression,
            compressed_size=content.packed,
            message_end_time=chunk.last_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.first_time,
            uncompressed_size=chunk.unpacked,
        )

    def _check_message_index(self, place: RecordPlace) -> None:
        """An index of the messages of the chunk before it; read by numpy, since mcap makes an object of each entry."""
        data = read_bytes(self.stream, place.offset, place.end - place.offset)
        if len(data) < INDEX_HEAD or (len(data) - INDEX_HEAD) % 16:
            raise Damage("an index of messages has an impossible length", place.offset)
        channel = int.from_bytes(data[HEAD.size : HEAD.size + 2], "little")
        if int.from_bytes(data[INDEX_HEAD - 4 : INDEX_HEAD], "little") != len(data) - INDEX_HEAD:
            raise Damage("an index of messages has an impossible length", place.offset)
        if self.chunk is None or self.content is None:
            if not self.expected[Opcode.CHUNK_INDEX] or next(reversed(self.expected[Opcode.CHUNK_INDEX].values())):
                raise Damage("an index of messages belongs to no chunk", place.offset)
            return  # the chunk before is damaged, which is a finding already
        self.chunk.message_index_offsets[channel] = place.offset
        self.chunk.message_index_length += place.end - place.offset
        here = np.frombuffer(self.content.channels, np.uint16) == channel
        times = np.frombuffer(self.content.times, np.uint64)[here]
        offsets = np.frombuffer(self.content.offsets, np.uint32)[here].astype(np.uint64)
        if not _same_rows(np.frombuffer(data, "<u8", offset=INDEX_HEAD).reshape(-1, 2), np.stack([times, offsets], 1)):
            raise Damage("an index points to other messages than its chunk holds", place.offset)

    def _finish_chunk(self) -> None:
        """After the indexes of a chunk: none is missing if there are any."""
        chunk, content, self.chunk, self.content = self.chunk, self.content, None, None
        if chunk is None or content is None:
            return
        self.expected[Opcode.CHUNK_INDEX][chunk.chunk_start_offset] = chunk
        missing = set(content.counts) - set(chunk.message_index_offsets)
        if chunk.message_index_offsets and missing:
            raise Damage(f"a chunk has no index for channel {min(missing)}", chunk.chunk_start_offset)

    def _check_summary(self, start: int, footer: RecordPlace) -> None:
        """Indexes, counts and offsets between the end of the data and the footer."""
        groups: dict[int, list[int]] = {}  # opcode -> begin and end of its records
        offsets: list[tuple[int, SummaryOffset]] = []
        indexed: Counter[int] = Counter()
        for place in places(self.stream, start, footer.offset):
            groups.setdefault(place.opcode, [place.offset, place.end])[1] = place.end
            if place.opcode in INDEXES:
                indexed[place.opcode] += 1
                self.attempt(self._check_index, place)
            elif place.opcode == Opcode.STATISTICS:
                self._check_statistics(self._record(place))
            elif place.opcode == Opcode.SUMMARY_OFFSET:
                offsets.append((place.offset, self._record(place)))
        for opcode, number in indexed.items():
            if number != len(self.expected[opcode]):
                self.sentences.append(f"the index of {INDEXES[Opcode(opcode)]} is not complete")
        for offset, entry in offsets:
            begin, end = groups.get(entry.group_opcode, (0, 0))
            if entry.group_length and (entry.group_start, entry.group_length) != (begin, end - begin):
                self.sentences.append(f"the summary has a wrong offset (at byte {offset})")
        record = self._record(footer)
        first = offsets[0][0] if offsets else footer.offset
        if record.summary_start != (0 if start == footer.offset else start):
            raise Damage("the footer does not point to the end of the data", footer.offset)
        if record.summary_offset_start not in (0, first):
            raise Damage("the footer does not point to the offsets of the summary", footer.offset)

    def _check_index(self, place: RecordPlace) -> None:
        index = self._record(place)
        offset = index.chunk_start_offset if place.opcode == Opcode.CHUNK_INDEX else index.offset
        # None: the record is damaged itself
        if self.expected[place.opcode].get(offset, ()) not in (None, index):
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


def _same_rows(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether both hold the same rows in any order."""
    return np.array_equal(one, other) or np.array_equal(_sorted_rows(one), _sorted_rows(other))


def _sorted_rows(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]


def _metadata_file(recording: Recording) -> list[str]:
    """Compare the counts in a ``metadata.yaml`` in the same directory."""
    path = recording.path.with_name("metadata.yaml")
    if not path.is_file() or path.stat().st_size > YAML_LIMIT:
        return []
    try:
        tree = yaml.load(path.read_bytes(), Loader=LOADER)  # noqa: S506 - a safe loader
        about = tree["rosbag2_bagfile_information"]
        counts = {t["topic_metadata"]["name"]: t["message_count"] for t in about["topics_with_message_count"]}
        files, count = about["relative_file_paths"], about["message_count"]
    except (yaml.YAMLError, LookupError, TypeError, ValueError, RecursionError, OSError):
        return [f"{path.name} in its directory cannot be read"]
    if files != [recording.path.name]:
        return []  # of several files, or of another one
    same = count == recording.count and counts == {name: about.count for name, about in recording.topics().items()}
    return [] if same else [f"{path.name} in its directory counts other messages"]
