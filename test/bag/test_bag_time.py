"""Small files made to keep a reader busy for minutes are refused after a bounded amount of work."""

from __future__ import annotations

import struct
import time

import pytest
from mcap.writer import IndexType, Writer
from test_recording_reader import write_mcap

from kr270_milling.bag import chunks
from kr270_milling.bag.export import export
from kr270_milling.bag.info import info
from kr270_milling.bag.reader import Recording
from kr270_milling.bag.recover import recover
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.codec import serialise
from kr270_milling.messages.series import series

POSE = "geometry_msgs/msg/PoseStamped"


def many_messages(path, count: int) -> None:
    """All the same; 70,000 of them to a chunk of 9 MB, which is packed into about 1 kB."""
    pose = serialise(POSE, {})
    write_mcap(path, ((0, pose) for _ in range(count)), chunk_size=9_000_000, index_types=IndexType.NONE)


def many_layouts(path, count: int) -> None:
    """Poses whose frames have other lengths from one to the next."""
    poses = [serialise(POSE, {"header": {"frame_id": name}}) for name in ("", "12345678")]
    write_mcap(path, ((0, poses[i % 2]) for i in range(count)), chunk_size=9_000_000, index_types=IndexType.NONE)


def many_topics(path, count: int) -> None:
    """Each is looked for among the messages of all."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=20_000_000, index_types=IndexType.NONE)
        writer.start("ros2")
        schema = writer.register_schema("a/msg/B", "ros2msg", b"int8 x")
        channels = [writer.register_channel(f"/{i}", "cdr", schema) for i in range(count)]
        for _ in range(count):
            for channel in channels:
                writer.add_message(channel, 0, b"\0\1\0\0\0", 0)
        writer.finish()


def many_texts(path, count: int) -> None:
    data = b"\0\1\0\0" + struct.pack("<I", count) + struct.pack("<I4x", 1) * count
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channel = writer.register_channel("/t", "cdr", writer.register_schema("a/msg/S", "ros2msg", b"string[] data\n"))
        for i in range(20):
            writer.add_message(channel, i, data, 0)
        writer.finish()


def many_definitions(path, count: int) -> None:
    with open(path, "wb") as stream:
        writer = Writer(stream, repeat_schemas=False, repeat_channels=False)
        writer.start("ros2")
        for i in range(20):
            text = "".join(f"int8 x{k}\n" for k in range(count)) + f"int8 y{i}\n"
            channel = writer.register_channel(
                f"/{i}", "cdr", writer.register_schema("a/msg/S", "ros2msg", text.encode())
            )
            writer.add_message(channel, i, bytes(4 + count + 1), 0)
        writer.finish()


def read_all(path, directory) -> None:
    with Recording(path) as recording:
        info(recording)
        if recording.topics().get("/tool_pose"):
            series(recording, "/tool_pose")
        for sentence in export(recording, directory).refused.values():
            raise RecordingError(path, sentence)


@pytest.mark.parametrize(("make", "count"), [
    (many_messages, 30_000), (many_layouts, 15_000), (many_topics, 50), (many_texts, 15_000), (many_definitions, 40),
])  # fmt: skip
def test_work_that_the_size_of_a_file_does_not_explain_is_refused(tmp_path, monkeypatch, make, count):
    """With a two-hundredth of the allowance; with all of it the same file is read."""
    make(tmp_path / "a.mcap", count)
    assert (tmp_path / "a.mcap").stat().st_size < 40_000
    read_all(tmp_path / "a.mcap", tmp_path / "csv")
    monkeypatch.setattr(chunks, "FREE", chunks.FREE / 200)
    monkeypatch.setattr(chunks, "PER_BYTE", 0.0)
    begin = time.process_time()
    with pytest.raises(RecordingError, match="more work than a file of its size can need"):
        read_all(tmp_path / "a.mcap", tmp_path / "less")
    assert time.process_time() - begin < 0.5  # 0.025 s are counted


def test_recover_ends_in_time_too(tmp_path, monkeypatch):
    many_messages(tmp_path / "a.mcap", 30_000)
    assert recover(tmp_path / "a.mcap", tmp_path / "all").messages == 30_000
    monkeypatch.setattr(chunks, "FREE", chunks.FREE / 100)
    monkeypatch.setattr(chunks, "PER_BYTE", 0.0)
    found = recover(tmp_path / "a.mcap", tmp_path / "less")
    assert found.messages == 0 and "more work than" in found.dropped[0]
