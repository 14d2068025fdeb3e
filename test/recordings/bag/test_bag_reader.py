"""Reading recordings, here and in readers by other people: rosbags, mcap and Foxglove's packages."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from recording_samples import PERIOD, POSE, STORE, TOPICS, poses, raw, read, record, sample, whole_recording, write_mcap
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover


@pytest.mark.parametrize("kind", list(CompressionType))
def test_messages_come_in_the_order_of_the_file_from_every_packing(tmp_path, kind):
    messages = poses(np.random.default_rng(2).permutation(3000))
    path = write_mcap(tmp_path / "a.mcap", messages, kind, chunk_size=20_000)
    with Recording(path) as recording:
        assert len(recording.chunks) > 10
        assert [(m.log_time, m.data) for m in recording.messages()] == messages


def test_files_without_chunks_or_without_index_and_summary_are_read(tmp_path):
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/tool_pose", POSE, typestore=STORE)
        for log_time, data in poses(range(100)):
            writer.write(connection, log_time, data)
    messages, cut_off = read(tmp_path / "bag")
    assert not cut_off
    assert [(t, d) for _, t, d in messages] == poses(range(100))
    bare = dict(use_statistics=False, repeat_channels=False, repeat_schemas=False, use_summary_offsets=False)
    messages = poses(range(99, -1, -1))
    path = write_mcap(tmp_path / "a.mcap", messages, chunk_size=2000, index_types=IndexType.NONE, **bare)
    assert [(t, d) for _, t, d in read(path)[0]] == messages


def test_a_file_cut_off_anywhere_gives_a_beginning_of_it_or_one_sentence(tmp_path):
    """Every begin of a record, one byte before, one byte after, and many places between."""
    data, written, _ = whole_recording()
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


PACKAGES = ("@mcap/core", "@foxglove/rosmsg", "@foxglove/rosmsg2-serialization", "fzstd")


def order(messages) -> list:
    return sorted(messages, key=lambda m: (m[1], m[0]))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    directory = tmp_path_factory.mktemp("bag") / "pass_1"
    written = record(directory, 25, attachments={"cell.yaml": "a: 1\n"}, chunk_size=20_000)
    return directory, written


@pytest.mark.parametrize("part", ["", "pass_1.mcap"])
def test_rosbags_reads_the_same_bytes_and_decodes_them_with_the_definitions_in_the_file(bag, part):
    directory, written = bag
    with Reader(directory / part) as reader:
        actual = [(c.topic, t, bytes(d)) for c, t, d in reader.messages()]
        assert (reader.start_time, reader.end_time) == (0, 24 * PERIOD + 1)
        assert {k: (v.msgtype, v.msgcount) for k, v in reader.topics.items()} == {k: (v, 25) for k, v in TOPICS.items()}
        assert reader.ros_distro == (None if part else "jazzy")
        profiles = [connection.ext.offered_qos_profiles for connection in reader.connections]
        assert {(one.depth, one.durability.name) for (one,) in profiles} == {(1, "TRANSIENT_LOCAL")}
    assert order(actual) == order(written)
    with AnyReader([directory / part]) as reader:  # builds its types from the schemas in the file
        for connection, stamp, data in reader.messages():
            expected = sample(connection.topic, stamp // PERIOD)
            again = reader.typestore.serialize_cdr(reader.deserialize(data, connection.msgtype), connection.msgtype)
            assert bytes(again) == raw(expected)


def run_node(mode: str, file: Path) -> list:
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    places = os.environ.get("NODE_PATH", "").split(os.pathsep)
    if not any(all(Path(place, name).is_dir() for name in PACKAGES) for place in places):
        pytest.skip(f"set NODE_PATH to a node_modules with {', '.join(PACKAGES)}")
    command = ["node", str(Path(__file__).with_name("foxglove.js")), mode, str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def hashed(messages) -> list:
    return order([topic, at, hashlib.sha256(data).hexdigest()] for topic, at, data in messages)


def test_foxglove_reads_the_same_bytes_and_numbers(bag):
    directory, written = bag
    *lines, attachments = run_node("indexed", directory / "pass_1.mcap")
    assert attachments == ["cell.yaml"]
    assert [at for _, at, *_ in lines] == sorted(at for _, at, _ in written)
    assert order(line[:3] for line in lines) == hashed(written)
    values = {(topic, at // PERIOD): value for topic, at, _, value in lines}
    assert values["/tool_pose", 3]["pose"]["position"] == dict(x=3.0, y=3.1, z=3.2)
    assert values["/joint_states", 2]["position"] == (2 + 0.1 * np.arange(6)).tolist()
    assert values["/workpiece", 24]["data"] == [i % 101 for i in range(1000)]
    assert values["/diagnostics", 7]["status"][1]["values"] == [dict(key="correction", value="7")]
    assert values["/target_trajectory", 4]["points"][1]["transforms"][0]["rotation"] == dict(x=0, y=1, z=0, w=0)


def test_foxglove_reads_a_cut_off_file_and_the_recovered_one(bag, tmp_path):
    directory, written = bag
    whole = (directory / "pass_1.mcap").read_bytes()
    with Recording(directory) as recording:
        last = recording.chunks[-1]
    (tmp_path / "cut.mcap").write_bytes(whole[: (last.offset + last.end) // 2])
    result = recover(tmp_path / "cut.mcap")
    assert 0 < result.messages < len(written)
    expected = hashed(written[: result.messages])
    assert order(line[:3] for line in run_node("streamed", tmp_path / "cut.mcap")) == expected
    *lines, _ = run_node("indexed", tmp_path / "cut_recovered" / "cut_recovered.mcap")
    assert order(line[:3] for line in lines) == expected
