"""MCAP's conformance data and bags of rosbag2 that are not one plain MCAP file."""

import itertools
import shutil
import struct
import zlib

import pytest
import yaml
import zstandard
from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from samples.recording_samples import POSE, STORE, poses, write_mcap

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.export import rows
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import findings, recover

MAGIC = b"\x89MCAP0\r\n"
SCHEMA = mcap.Schema(id=1, name="Example", encoding="c", data=bytes([4, 5, 6]))
CHANNEL = mcap.Channel(1, "example", "a", {"foo": "bar"}, 1)
SCHEMALESS = mcap.Channel(1, "example", "text", {}, 0)
ATTACHMENT = mcap.Attachment(1, 2, "myFile", "application/octet-stream", bytes([1, 2, 3]))


def message(log_time: int, publish_time: int, sequence: int) -> mcap.Message:
    return mcap.Message(1, log_time, bytes([1, 2, 3]), publish_time, sequence)


#: name of the conformance data -> its records
INPUTS = {
    "NoData": [],
    "OneAttachment": [ATTACHMENT],
    "OneMetadata": [mcap.Metadata("myMetadata", {"foo": "bar"})],
    "OneMessage": [SCHEMA, CHANNEL, message(2, 1, 10)],
    "OneSchemalessMessage": [SCHEMALESS, message(2, 1, 10)],
    "TenMessages": [SCHEMA, CHANNEL, *(message(t, t, k) for k, t in enumerate([0, 2, 1, 3, 3, 5, 4, 7, 8, 9]))],
}
FEATURES = ("ch", "chx", "mx", "st", "rsh", "rch", "ax", "mdx", "sum", "pad")
UNPADDED = (mcap.Footer, mcap.Message, mcap.Chunk, mcap.DataEnd)


def packed(record, pad: bool = False) -> bytes:
    """The bytes of a record, with three more as a later version of the format may have; no reader may use them."""
    builder = RecordBuilder()
    record.write(builder)
    data = bytes(builder.end())
    if pad and not isinstance(record, UNPADDED):
        data = data[:1] + struct.pack("<Q", len(data) - 9 + 3) + data[9:] + b"\x01\xff\xff"
    return data


def variants():
    """Name, records and features of each file of the conformance data."""
    for name, records in INPUTS.items():
        kinds = {type(record) for record in records}
        needs = {"ax": mcap.Attachment, "mdx": mcap.Metadata, "rsh": mcap.Schema, "rch": mcap.Channel,
                 "ch": mcap.Message, "chx": mcap.Message, "mx": mcap.Message}  # fmt: skip
        for chosen in itertools.product((False, True), repeat=len(FEATURES)):
            on = {feature for feature, used in zip(FEATURES, chosen, strict=True) if used}
            if any(needs[feature] not in kinds for feature in on & set(needs)):
                continue
            if on & {"chx", "mx"} and "ch" not in on or ("sum" in on and not on & set(FEATURES[1:8]) - {"mx"}):
                continue
            yield "-".join([name, *sorted(on)]), records, on


def file_of(records, on) -> bytes:
    """The file that a writer makes of records with some features."""
    pad, out = "pad" in on, bytearray(MAGIC + packed(mcap.Header("", ""), "pad" in on))
    inside = [r for r in records if isinstance(r, (mcap.Schema, mcap.Channel, mcap.Message))]
    times = [r.log_time for r in inside if isinstance(r, mcap.Message)] or [0]
    kinds = "SCHEMA", "CHANNEL", "STATISTICS", "METADATA_INDEX", "ATTACHMENT_INDEX", "CHUNK_INDEX"
    summary: dict[int, list] = {Opcode[kind]: [] for kind in kinds}
    counted = mcap.Attachment, mcap.Channel, mcap.Message, mcap.Metadata, mcap.Schema
    counts = [sum(isinstance(r, kind) for r in records) for kind in counted]
    if "ch" in on:
        rows, body = [], b""
        for record in inside:
            if isinstance(record, mcap.Message):
                rows.append((record.log_time, len(body)))
            body += packed(record)
        offset = len(out)
        out += packed(mcap.Chunk("", body, max(times), min(times), zlib.crc32(body), len(body)))
        length, indexed = len(out) - offset, {1: len(out)} if "mx" in on else {}
        index = packed(mcap.MessageIndex(1, rows), pad) if indexed else b""
        out += index
        if "chx" in on:
            summary[Opcode.CHUNK_INDEX] = [mcap.ChunkIndex(
                length, offset, "", len(body), max(times), len(index), indexed, min(times), len(body)
            )]  # fmt: skip
    for record in records if "ch" not in on else ():
        offset, data = len(out), packed(record, pad)
        out += data
        if isinstance(record, mcap.Attachment) and "ax" in on:
            size = len(record.data)
            summary[Opcode.ATTACHMENT_INDEX] = [
                mcap.AttachmentIndex(offset, len(data), 2, 1, size, record.name, record.media_type)
            ]
        if isinstance(record, mcap.Metadata) and "mdx" in on:
            summary[Opcode.METADATA_INDEX] = [mcap.MetadataIndex(offset, len(data), record.name)]
    out += packed(mcap.DataEnd(zlib.crc32(out)))
    start, offsets = len(out), []
    if "rsh" in on:
        summary[Opcode.SCHEMA] = [SCHEMA]
    if "rch" in on:
        summary[Opcode.CHANNEL] = [r for r in records if isinstance(r, mcap.Channel)]
    if "st" in on:
        per_channel = {1: counts[2]} if counts[2] else {}
        numbers = counts[0], counts[1], per_channel, int("ch" in on), counts[2], max(times), min(times), *counts[3:]
        summary[Opcode.STATISTICS] = [mcap.Statistics(*numbers)]
    for kind, group in summary.items():
        begin = len(out)
        for record in group:
            out += packed(record, pad)
        if group:
            offsets.append(mcap.SummaryOffset(kind, begin, len(out) - begin))
    here = len(out) if "sum" in on else 0
    for record in offsets if here else ():
        out += packed(record, pad)
    begin = start if len(out) > start else 0
    footer = packed(mcap.Footer(begin, here, 0))
    crc = zlib.crc32(out[start:] + footer[:-4])
    return bytes(out + packed(mcap.Footer(begin, here, crc)) + MAGIC)


def test_all_416_variants_of_the_conformance_data_are_read_and_sound(tmp_path):
    """The checksums follow from the JSON files of github.com/foxglove/mcap, tests/conformance/data."""
    total, count = 0, 0
    for name, records, on in sorted(variants(), key=lambda variant: variant[0]):
        data = file_of(records, on)
        total, count = zlib.crc32(data, total), count + 1
        (tmp_path / "a.mcap").write_bytes(data)
        with Recording(tmp_path / "a.mcap") as recording:
            assert findings(recording) == [], name
            actual = [(m.log_time, m.publish_time, m.sequence, m.data) for m in recording.messages()]
            expected = [r for r in records if isinstance(r, mcap.Message)]
            assert actual == [(r.log_time, r.publish_time, r.sequence, r.data) for r in expected], name
            assert recording.count == len(expected)
            assert [recording.attachment(a.name) for a in recording.attachments] == [
                r.data for r in records if isinstance(r, mcap.Attachment)
            ]
            assert list(recording.metadata().values()) == [r.metadata for r in records if isinstance(r, mcap.Metadata)]
    assert (count, total) == (416, 3_408_284_205)


def bag(directory, messages, plugin: StoragePlugin, mode=CompressionMode.NONE):
    """A recording by rosbags, which writes what rosbag2 writes."""
    writer = RosbagsWriter(directory, version=9, storage_plugin=plugin)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/tool_pose", POSE, typestore=STORE)
        for log_time, data in messages:
            writer.write(connection, log_time, data)
    return directory


def split(directory, messages):
    """A recording in two files, as rosbag2 writes it with a largest size of a file."""
    directory.mkdir()
    for number, part in enumerate((messages[:20], messages[20:])):
        write_mcap(directory / f"bag_{number}.mcap", part)
    about = yaml.safe_load((bag(directory.parent / "one", messages, StoragePlugin.MCAP) / "metadata.yaml").read_text())
    about["rosbag2_bagfile_information"]["relative_file_paths"] = ["bag_0.mcap", "bag_1.mcap"]
    (directory / "metadata.yaml").write_text(yaml.safe_dump(about))
    return directory


BAGS = {
    "db3": lambda place, messages: bag(place, messages, StoragePlugin.SQLITE3),
    "db3 file": lambda place, messages: next(bag(place, messages, StoragePlugin.SQLITE3).glob("*.db3")),
    "db3 zstd": lambda place, messages: bag(place, messages, StoragePlugin.SQLITE3, CompressionMode.FILE),
    "db3 messages": lambda place, messages: bag(place, messages, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "mcap zstd": lambda place, messages: bag(place, messages, StoragePlugin.MCAP, CompressionMode.FILE),
    "mcap messages": lambda place, messages: bag(place, messages, StoragePlugin.MCAP, CompressionMode.MESSAGE),
    "mcap split": split,
}


@pytest.mark.parametrize("kind", list(BAGS))
def test_a_bag_of_rosbag2_in_any_packing_gives_its_messages(tmp_path, kind):
    messages = poses(range(0, 4000, 100))
    path = BAGS[kind](tmp_path / "bag", messages)
    with Recording(path) as recording:
        assert [(m.log_time, m.data) for m in recording.messages()] == messages
        assert findings(recording) == [] and not recording.cut_off
        about = info(recording)
        assert about["topics"]["/tool_pose"]["type"] == POSE and about["messages"] == 40
        assert (about["start_ns"], about["end_ns"]) == (0, 3900)
        assert len(list(rows(recording, "/tool_pose"))) == 40


@pytest.mark.parametrize("kind", list(BAGS))
def test_a_damaged_bag_gives_one_sentence(tmp_path, kind):
    path = BAGS[kind](tmp_path / "bag", poses(range(40)))
    file = max(
        [path] if path.is_file() else path.iterdir(), key=lambda file: (file.suffix != ".yaml", file.stat().st_size)
    )
    data = file.read_bytes()
    for size in (0, 20, len(data) // 3, len(data) - 5):
        file.write_bytes(data[:size])
        try:
            with Recording(path) as recording:
                assert findings(recording) or len(list(recording.messages())) == 40
        except RecordingError as error:
            assert "\n" not in str(error)


def test_a_packed_file_alone_is_read_and_recovered_and_a_database_is_not(tmp_path):
    messages = poses(range(40))
    packed_file = tmp_path / "a.mcap.zstd"
    packed_file.write_bytes(zstandard.compress(write_mcap(tmp_path / "a.mcap", messages).read_bytes()[:-10]))
    with Recording(packed_file) as recording:
        assert recording.cut_off and [(m.log_time, m.data) for m in recording.messages()] == messages
    assert recover(packed_file).messages == 40 and (tmp_path / "a_recovered").is_dir()
    packed_file.write_bytes(b"\0" * 50)
    with pytest.raises(RecordingError, match="zstd -d"):
        Recording(packed_file)
    shutil.rmtree(tmp_path / "a_recovered")
    with pytest.raises(RecordingError, match="only such a file can be recovered"):
        recover(bag(tmp_path / "bag", messages, StoragePlugin.SQLITE3))
