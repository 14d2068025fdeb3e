"""Every byte of a recording checked: all checksums, and the indexes against the messages that they point to."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable

import numpy as np
import yaml
from mcap.opcode import Opcode

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
    walk = _Walk(recording)
    if recording.cut_off:
        walk.found.append("it is cut off: its writer did not finish it")
    walk.guard(walk.run, progress)
    return (walk.found + _metadata_file(recording))[:MOST]


class _Walk:
    """Once through the file, record by record."""

    def __init__(self, recording: Recording):
        self.recording, self.stream = recording, recording.stream
        self.found: list[str] = []
        self.counts: Counter[int] = Counter()
        self.chunks = {chunk.offset: chunk for chunk in recording.chunks}
        self.indexed: dict[int, list] = {}  # chunk -> what its entry in the index of chunks must say

    def guard(self, call, *args):
        """The result of a call, or None and one more sentence."""
        try:
            return call(*args)
        except Damage as damage:
            self.found.append(f"{damage.reason} (at byte {damage.offset})")
            return None

    def run(self, progress) -> None:
        recording, end = self.recording, self.recording.data_end
        chunk: int | None = None
        expected: dict = {}
        for part in parts(self.stream, len(MAGIC), end):
            if part.type == Opcode.MESSAGE_INDEX:
                self.guard(self._check_index, part, chunk, expected)
                continue
            self.guard(self._check_left_out, chunk, expected)
            chunk, expected = None, {}
            if part.type == Opcode.ATTACHMENT:
                self.guard(part.attached)
            elif part.offset in self.chunks:
                chunk, expected = part.offset, self.guard(self._messages, part) or {}
            if progress:
                progress(part.end, recording.size)
        self.guard(self._check_left_out, chunk, expected)
        crc = recording.contents.data_crc
        if crc and not recording.cut_off and checksum(self.stream, end) != crc:
            self.found.append("the data do not fit the checksum at their end")
        if not recording.cut_off:
            self._check_summary(end)

    def _messages(self, part: Part) -> dict[int, np.ndarray]:
        """Channel -> (log time, offset) of its messages in a chunk."""
        if part.type == Opcode.CHUNK:
            record = part.record()
            self.indexed[part.offset] = [
                len(part.data), record.message_start_time, record.message_end_time, record.compression,
                len(record.data), record.uncompressed_size, {},
            ]  # fmt: skip
        found = self.recording.unpack(self.chunks[part.offset])
        self.counts += found.counts
        unknown = set(found.counts) - set(self.recording.contents.channels)
        if unknown:
            raise Damage(f"messages belong to channel {min(unknown)}, which is not defined", part.offset)
        channel, rows = found.table()
        return {number: rows[channel == number] for number in found.counts}

    def _check_index(self, part: Part, chunk: int | None, expected: dict[int, np.ndarray]) -> None:
        if chunk not in self.indexed or len(part.data) < INDEX.size:
            raise Damage("an index of messages belongs to no chunk", part.offset)
        _, _, channel, size = INDEX.unpack_from(part.data)
        if size != len(part.data) - INDEX.size or size % 16:
            raise Damage("an index of messages has an impossible length", part.offset)
        rows, messages = np.frombuffer(part.data, "<u8", offset=INDEX.size).reshape(-1, 2), expected.pop(channel, None)
        self.indexed[chunk][-1][channel] = part.offset
        if messages is None and not len(rows):
            return
        if messages is None or not np.array_equal(_sorted(rows), _sorted(messages)):
            raise Damage("an index points to other messages than its chunk holds", part.offset)

    def _check_left_out(self, chunk: int | None, expected: dict) -> None:
        if expected and chunk in self.indexed and self.indexed[chunk][-1]:
            raise Damage(f"a chunk has no index for channel {min(expected)}", chunk)

    def _check_summary(self, end: int) -> None:
        """The index of chunks and the counts, against what is there."""
        at = self.recording.size - FOOTER_SIZE
        behind = end + HEAD.size + 4  # of the record that ends the data
        if +self.counts != +(self.recording.contents.counts or Counter()):
            self.found.append("the counts of messages at the end are not those of the messages")
        for part in parts(self.stream, behind, self.recording.size):
            if part.type == Opcode.CHUNK_INDEX:
                self.guard(self._check_chunk_index, part)
            elif part.offset == at and part.record().summary_start != (0 if behind == at else behind):
                self.found.append(f"the footer does not point to the end of the data (at byte {at})")

    def _check_chunk_index(self, part: Part) -> None:
        index = part.record()
        if index.chunk_start_offset not in self.indexed:
            raise Damage("the index of chunks points to a place without a chunk", part.offset)
        says = [index.chunk_length, index.message_start_time, index.message_end_time, index.compression,
                index.compressed_size, index.uncompressed_size, index.message_index_offsets]  # fmt: skip
        if says != self.indexed[index.chunk_start_offset]:
            raise Damage("the index of chunks says another thing than the chunk", part.offset)


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
