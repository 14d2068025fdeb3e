from __future__ import annotations

import io
import os
import struct

import numpy as np
import pytest
from budget import budget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from test_recording_samples import POSE, STORE, TOPICS, pose, raw, record

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series
from kr270_milling.recordings.bag.verify import findings
from kr270_milling.recordings.messages.definitions import definition

RELAXED = settings(max_examples=budget(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


class Whole(tuple):
    """Bytes and messages; hypothesis prints its arguments, so the text is short."""

    def __repr__(self):
        return "whole"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A small file with several chunks, its bytes and what is in it."""
    directory = tmp_path_factory.mktemp("whole") / "a"
    written = record(directory, 40, topics=["/tool_pose", "/wrench", "/robot_description"],
                     attachments={"cell.yaml": "a: 1\n" * 50}, chunk_size=2000)  # fmt: skip
    return Whole(((directory / "a.mcap").read_bytes(), written))


def read(path) -> tuple[list, bool]:
    with Recording(path) as recording:
        return [(m.topic, m.log_time, m.data) for m in recording.messages()], recording.cut_off


def write_mcap(path, messages, compression=CompressionType.ZSTD, finish=True, encoding="cdr", **options):
    """A file by mcap's own writer; messages: (log time, bytes)."""
    with open(path, "wb") as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start("ros2")
        schema = writer.register_schema(POSE, "ros2msg", definition(POSE).encode())
        channel = writer.register_channel("/tool_pose", encoding, schema)
        for log_time, data in messages:
            writer.add_message(channel, log_time, data, log_time)
        if finish:
            writer.finish()
    return path


def poses(times) -> list[tuple[int, bytes]]:
    return [(int(t), raw(pose(int(t), np.arange(7) + i))) for i, t in enumerate(times)]


def test_what_was_written_is_read_byte_by_byte(whole, tmp_path):
    data, written = whole
    (tmp_path / "a.mcap").write_bytes(data)
    messages, cut_off = read(tmp_path / "a.mcap")
    assert not cut_off
    assert sorted(messages) == sorted(written)


@pytest.mark.parametrize("kind", list(CompressionType))
def test_messages_come_in_the_order_of_their_log_times_from_every_packing(tmp_path, kind):
    times = np.random.default_rng(2).permutation(3000)
    path = write_mcap(tmp_path / "a.mcap", poses(times), kind, chunk_size=20_000)
    with Recording(path) as recording:
        messages = list(recording.messages())
    assert len(recording.chunks) > 10
    assert [m.log_time for m in messages] == list(range(3000))


def test_equal_log_times_keep_the_order_of_the_file(tmp_path):
    messages = [(i // 50, data) for i, (_, data) in enumerate(poses(range(500)))]
    path = write_mcap(tmp_path / "a.mcap", messages, chunk_size=3000)
    assert [data for _, _, data in read(path)[0]] == [data for _, data in messages]


def test_overlapping_chunks_are_merged_within_the_memory_for_chunks(tmp_path, monkeypatch):
    times = np.arange(2000).reshape(20, 100).T.ravel()  # every chunk reaches over all times
    path = write_mcap(tmp_path / "a.mcap", poses(times), chunk_size=10_000)
    monkeypatch.setattr("kr270_milling.recordings.bag.chunks.CACHE", 50_000)
    with Recording(path) as recording:
        assert [m.log_time for m in recording.messages()] == list(range(2000))
        assert recording.read_chunk.used <= 50_000 + 50_000
    monkeypatch.setattr("kr270_milling.recordings.bag.chunks.SORTED", 10_000)
    with Recording(path) as recording:
        with pytest.raises(RecordingError, match="chunks overlap in time"):
            list(recording.messages())
        assert sorted(m.log_time for m in recording.messages(as_written=True)) == list(range(2000))


def test_topics_and_times_can_be_chosen(whole, tmp_path):
    data, written = whole
    (tmp_path / "a.mcap").write_bytes(data)
    with Recording(tmp_path / "a.mcap") as recording:
        found = list(recording.messages(["/wrench"], start=10 * 500_000, end=13 * 500_000))
    assert [m.data for m in found] == [d for t, at, d in written if t == "/wrench" and 10 <= at / 500_000 < 13]


def test_files_without_chunks_are_read(tmp_path):
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/tool_pose", POSE, typestore=STORE)
        for log_time, data in poses(range(100)):
            writer.write(connection, log_time, data)
    messages, cut_off = read(tmp_path / "bag")
    assert not cut_off
    assert [(t, d) for _, t, d in messages] == poses(range(100))


def test_files_without_index_and_summary_are_read(tmp_path):
    bare = dict(use_statistics=False, repeat_channels=False, repeat_schemas=False, use_summary_offsets=False)
    messages = poses(range(99, -1, -1))
    path = write_mcap(tmp_path / "a.mcap", messages, chunk_size=2000, index_types=IndexType.NONE, **bare)
    assert [t for _, t, _ in read(path)[0]] == list(range(100))


def test_a_file_cut_off_anywhere_gives_a_beginning_of_it_or_one_sentence(whole, tmp_path):
    """Every place where a record begins, one byte before and behind it, and many between."""
    data, written = whole
    expected = [data for _, _, data in written]
    path = tmp_path / "a.mcap"
    places, at = {0, 1, 7, 8}, 8
    while at < len(data) - 8:
        places |= {at - 1, at, at + 1, at + 5, at + 9, at + 10}
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    counts = []
    for place in sorted(p for p in places | set(range(0, len(data), 997)) if p < len(data)):
        path.write_bytes(data[:place])
        try:
            messages, cut_off = read(path)
        except RecordingError as error:
            assert "\n" not in str(error) and place < 60  # only where not even the header is whole
            continue
        assert cut_off
        assert [d for _, _, d in messages] == expected[: len(messages)]
        counts.append(len(messages))
    assert counts == sorted(counts)  # a longer file has never fewer messages
    assert counts[0] == 0 and counts[-1] == len(expected)


@given(place=st.integers(0, 10**6), bit=st.integers(0, 7))
@RELAXED
def test_a_flipped_bit_is_an_error_or_harmless_to_the_messages(whole, tmp_path, place, bit):
    data, written = whole
    path = tmp_path / "a.mcap"
    flipped = bytearray(data)
    flipped[place % len(data)] ^= 1 << bit
    path.write_bytes(flipped)
    try:
        messages, cut_off = read(path)
    except RecordingError as error:
        assert "\n" not in str(error)
        return
    # what was read is what was written; a file that looks cut off now may have lost its end
    good = set(written)
    assert all(message in good for message in messages)
    assert cut_off or len(messages) == len(written)


@given(place=st.integers(0, 10**6), bit=st.integers(0, 7))
@RELAXED
def test_verify_finds_every_flipped_bit(whole, tmp_path, place, bit):
    data, _ = whole
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with Recording(path) as recording:
        assert findings(recording) == []
    flipped = bytearray(data)
    flipped[place % len(data)] ^= 1 << bit
    path.write_bytes(flipped)
    assert is_told(path)


def is_told(path) -> bool:
    """Whether a damaged file is called damaged or cut off."""
    try:
        with Recording(path) as recording:
            return bool(findings(recording))
    except RecordingError:
        return True


@given(st.binary(max_size=300), st.booleans())
@RELAXED
def test_garbage_is_one_sentence(tmp_path, garbage, with_magic):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" * with_magic + garbage)
    try:
        with Recording(path) as recording:
            list(recording.messages())
    except RecordingError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b"", "not an MCAP file"), (b"\x89MCA", "ends in its first bytes"), (b"#!/bin/sh\necho", "not an MCAP file"),
     (b"\x89MCAP0\r\n", "before its header"), (b"\x89MCAP0\r\n\x01\x05\0", "before its header")],
)  # fmt: skip
def test_what_is_no_recording_says_why(tmp_path, content, sentence):
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=sentence):
        Recording(tmp_path / "a.mcap")


def test_paths_without_a_recording_say_why(tmp_path):
    (tmp_path / "empty").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "none.mcap", tmp_path / "empty", tmp_path / "pipe", "a\0b"):
        with pytest.raises(RecordingError):
            Recording(path)


def test_a_foreign_schema_is_listed_and_its_bytes_are_read_but_not_decoded(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("Thing", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/thing", "json", schema)
        bare = writer.register_channel("/bare", "", 0)
        writer.add_message(channel, 1, b'{"a": 1}', 1)
        writer.add_message(bare, 2, b"xyz", 2)
        writer.finish()
    with Recording(tmp_path / "a.mcap") as recording:
        assert [m.data for m in recording.messages()] == [b'{"a": 1}', b"xyz"]
        assert recording.topics()["/thing"].schema_encoding == "jsonschema"
        for topic in ("/thing", "/bare"):
            with pytest.raises(RecordingError, match="only cdr with ros2msg"):
                list(recording.decoded([topic]))
            with pytest.raises(RecordingError):
                series(recording, topic)


@pytest.mark.parametrize(
    "text", ["float64", "A a\n" + "=" * 80 + "\nMSG: x/A\nA a\n", "string[ a", "int32 Bad-Name", "Missing m", "\0\0"]
)
@pytest.mark.parametrize("data", [b"", b"\0\x01\0\0", b"\0\x01\0\0" + b"\xff" * 40])
def test_a_broken_definition_or_message_is_one_sentence(tmp_path, text, data):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema("x/msg/T", "ros2msg", text.encode()))
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    with Recording(tmp_path / "a.mcap") as recording:
        try:
            list(recording.decoded())
        except RecordingError as error:
            assert "\n" not in str(error)


def test_decoded_messages_have_the_fields_of_the_definition(tmp_path):
    record(tmp_path / "a", 3)
    with Recording(tmp_path / "a") as recording:
        decoded = {m.topic: d for m, d in recording.decoded()}
    assert set(decoded) == set(TOPICS)
    assert decoded["/tool_pose"].pose.position.y == 2.1
    assert decoded["/diagnostics"].status[1].message == "äußerst gut"


def test_mcap_finds_no_fault_with_the_structure(whole):
    from mcap.reader import make_reader

    data, written = whole
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
    assert sorted(found) == sorted(written)
    assert reader.get_summary().statistics.message_count == len(written)
