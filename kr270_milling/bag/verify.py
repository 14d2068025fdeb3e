"""Every byte of a recording checked: all checksums, and the indexes against the messages that they point to."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable

import numpy as np
import yaml
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from kr270_milling.bag.chunks import Chunk
from kr270_milling.bag.reader import Recording
from kr270_milling.bag.structure import FOOTER_SIZE, HEAD, MAGIC, Damage, Part, checksum, parts

__all__ = ["findings"]

MOST = 20  # sentences
INDEX = struct.Struct("<BQHI")  # type and length; channel, bytes of the entries that follow
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
MOST_YAML = 256 * 1024  # [bytes] of metadata.yaml; the YAML reader takes some seconds for them


def findings(recording: Recording, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """One sentence for each damage that is found, up to 20; none where the recording is whole.

    A file whose writer left out a checksum or an index is whole without it. Nothing is raised for damage.
    """
    check = _Check(recording)
    check.guard(check.run, progress)
    return (check.found + _metadata_file(recording))[:MOST]


class _Check:
    def __init__(self, recording: Recording):
        self.recording, self.stream = recording, recording.stream
        self.found: list[str] = []
        self.counts: Counter[int] = Counter()
        self.indexes: dict[int, ChunkIndex | None] = {}  # chunk -> what the summary must say of it; None: damaged

    def guard(self, call: Callable, *args) -> None:
        """A call whose damage becomes one more sentence."""
        try:
            call(*args)
        except Damage as damage:
            self.found.append(f"{damage.reason} (at byte {damage.offset})")

    def run(self, progress) -> None:
        recording, end = self.recording, self.recording.data_end
        for about in recording.attachments:
            self.guard(recording.attached, about)
        for chunk in recording.chunks:
            self.guard(self._check_chunk, chunk)
            if progress:
                progress(chunk.end, recording.size)
        if not recording.data_crc:  # with one, this cannot go unseen
            self.guard(self._check_stray_indexes, end)
        if recording.cut_off:
            self.found.insert(0, "it is cut off: its writer did not finish it")
            return
        if recording.data_crc not in (0, checksum(self.stream, 0, end)):
            self.found.append("the data do not fit the checksum at their end")
        if +self.counts != +(recording.counts or Counter()):
            self.found.append("the counts of messages at the end are not those of the messages")
        behind = end + HEAD.size + 4  # of the record that ends the data
        for part in parts(self.stream, behind, recording.size):
            self.guard(self._check_summary, part, behind)

    def _check_chunk(self, chunk: Chunk) -> None:
        """Its messages, and the indexes of them that follow it."""
        if chunk.type == Opcode.CHUNK:
            self.indexes[chunk.offset] = None
        found = self.recording.unpack(chunk)
        self.counts += found.counts
        unknown = set(found.counts) - set(self.recording.channels)
        if unknown:
            raise Damage(f"messages belong to channel {min(unknown)}, which is not defined", chunk.offset)
        if found.packed is None:
            return
        offsets, behind = {}, chunk.end
        times, places = np.frombuffer(found.times, np.uint64), np.frombuffer(found.places, np.uint32)
        channels, lacking = np.frombuffer(found.channels, np.uint16), set(found.counts)
        for part in parts(self.stream, behind, self.recording.data_end):
            if part.type != Opcode.MESSAGE_INDEX:
                break
            channel, index = _message_index(part)
            offsets[channel], behind = part.offset, part.end
            here = channels == channel
            if not _same(index, np.stack([times[here], places[here].astype(np.uint64)], axis=1)):
                raise Damage("an index points to other messages than its chunk holds", part.offset)
            lacking.discard(channel)
        if offsets and lacking:
            raise Damage(f"a chunk has no index for channel {min(lacking)}", chunk.offset)
        self.indexes[chunk.offset] = ChunkIndex(
            chunk_length=chunk.size,
            chunk_start_offset=chunk.offset,
            compression=found.packed.packing,
            compressed_size=found.packed.size,
            message_end_time=chunk.last_time,
            message_index_length=behind - chunk.end,
            message_index_offsets=offsets,
            message_start_time=chunk.first_time,
            uncompressed_size=chunk.unpacked,
        )

    def _check_stray_indexes(self, end: int) -> None:
        behind_chunk = False
        for part in parts(self.stream, len(MAGIC), end):
            is_index = part.type == Opcode.MESSAGE_INDEX
            if is_index and not behind_chunk:
                raise Damage("an index of messages belongs to no chunk", part.offset)
            behind_chunk = part.type == Opcode.CHUNK or (is_index and behind_chunk)

    def _check_summary(self, part: Part, behind: int) -> None:
        """The index of a chunk, against what is there, and the footer; behind: where the summary begins."""
        at = self.recording.size - FOOTER_SIZE
        if part.type == Opcode.CHUNK_INDEX:
            index = part.record()
            if self.indexes.get(index.chunk_start_offset, ()) not in (None, index):
                raise Damage("the index of chunks says another thing than the chunk", part.offset)
        elif part.offset == at and part.record().summary_start != (0 if behind == at else behind):
            raise Damage("the footer does not point to the end of the data", at)


def _message_index(part: Part) -> tuple[int, np.ndarray]:
    """Channel of an index of messages, and log time and place of each of them, (n, 2)."""
    data = part.data()
    if len(data) < INDEX.size:
        raise Damage("an index of messages has an impossible length", part.offset)
    _, _, channel, size = INDEX.unpack_from(data)
    if size != len(data) - INDEX.size or size % 16:
        raise Damage("an index of messages has an impossible length", part.offset)
    return channel, np.frombuffer(data, "<u8", offset=INDEX.size).reshape(-1, 2)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether they hold the same rows in any order."""
    return np.array_equal(one, other) or np.array_equal(_sorted(one), _sorted(other))


def _sorted(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))]


def _metadata_file(recording: Recording) -> list[str]:
    """Whether ``metadata.yaml`` beside the file, if there is one, counts the same messages."""
    path = recording.path.with_name("metadata.yaml")
    if not path.is_file() or path.stat().st_size > MOST_YAML:
        return []
    try:
        tree = yaml.load(path.read_bytes(), Loader=LOADER)  # noqa: S506 - a safe one
        about = tree["rosbag2_bagfile_information"]
        counts = {t["topic_metadata"]["name"]: t["message_count"] for t in about["topics_with_message_count"]}
        files, count = about["relative_file_paths"], about["message_count"]
    except (yaml.YAMLError, LookupError, TypeError, ValueError, RecursionError, OSError):
        return [f"{path.name} beside it cannot be read"]
    if files != [recording.path.name]:
        return []  # of several files, or of another one
    same = count == recording.count and counts == {name: about.count for name, about in recording.topics().items()}
    return [] if same else [f"{path.name} beside it counts other messages"]
