"""Files with any part that the MCAP format lets a writer leave out, and bags of rosbag2 that are not one plain file."""

import io
import itertools
import shutil

import pytest
import yaml
import zstandard
from mcap.writer import IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from samples.recording_samples import POSE, STORE, poses, write_mcap

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.export import rows
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import findings, recover

FLAGS = ("use_chunking", "use_statistics", "use_summary_offsets", "repeat_channels", "repeat_schemas", "enable_crcs")
INDEXES = (IndexType.NONE, IndexType.ATTACHMENT, IndexType.CHUNK, IndexType.MESSAGE, IndexType.METADATA, IndexType.ALL)
TIMES = [0, 2, 1, 3, 3, 5, 4, 7, 8, 9]


def file_of(index: IndexType, flags: dict[str, bool], full: bool) -> bytes:
    """A file of mcap's writer; full: with messages with and without a schema, an attachment and metadata."""
    stream = io.BytesIO()
    writer = Writer(stream, index_types=index, enable_data_crcs=flags["enable_crcs"], **flags)
    writer.start()
    if full:
        schema = writer.register_schema("Example", "c", bytes([4, 5, 6]))
        channels = [writer.register_channel(name, "a", number) for name, number in (("one", schema), ("two", 0))]
        for k, time in enumerate(TIMES):
            writer.add_message(channels[k % 2], time, bytes([k]), 2 * time, k)
        writer.add_attachment(1, 2, "myFile", "application/octet-stream", bytes([1, 2, 3]))
        writer.add_metadata("myMetadata", {"foo": "bar"})
    writer.finish()
    return stream.getvalue()


def test_a_file_without_any_part_that_a_writer_may_leave_out_is_read_and_sound(tmp_path):
    """768 files: each kind of index, and chunks, statistics, offsets, repeated definitions and checksums or not."""
    for index, full, *used in itertools.product(INDEXES, (True, False), *[(True, False)] * len(FLAGS)):
        flags = dict(zip(FLAGS, used, strict=True))
        (tmp_path / "a.mcap").write_bytes(file_of(index, flags, full))
        with Recording(tmp_path / "a.mcap") as recording:
            assert findings(recording) == [], (index, flags)
            actual = [(m.log_time, m.publish_time, m.sequence, m.data) for m in recording.messages()]
            assert actual == [(t, 2 * t, k, bytes([k])) for k, t in enumerate(TIMES)] * full, (index, flags)
            assert recording.count == 10 * full
            assert [recording.attachment(a.name) for a in recording.attachments] == [bytes([1, 2, 3])] * full
            assert recording.metadata() == ({"myMetadata": {"foo": "bar"}} if full else {})


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
