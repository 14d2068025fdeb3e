from __future__ import annotations

import struct

import pytest
from budget import budget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from rosbags.rosbag2 import Reader
from test_recording_reader import Whole
from test_recording_samples import TOPICS, record

from kr270_milling.base.errors import RecordingError
from kr270_milling.cli import main
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover
from kr270_milling.recordings.bag.verify import findings

RELAXED = settings(max_examples=budget(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


PACKED = 9 + 3 * 8 + 4 + 8 + 8  # bytes of a chunk before its packed bytes: lengths, times, checksum, "zstd"


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """The bytes of a file with many chunks, and its messages."""
    directory = tmp_path_factory.mktemp("source") / "a"
    written = record(directory, 60, attachments={"cell.yaml": "a: 1\n"}, metadata={"seed": 1}, chunk_size=20_000)
    with Recording(directory) as recording:
        chunks = [(chunk, len(recording.read_chunk(chunk))) for chunk in recording.chunks]
    return Whole(((directory / "a.mcap").read_bytes(), written, chunks))


def kept(directory) -> list:
    with Recording(directory) as recording:
        assert not recording.cut_off and not findings(recording)
        return [(m.topic, m.log_time, m.data) for m in recording.messages()]


def test_a_whole_file_is_copied_with_everything(source, tmp_path):
    data, written, _ = source
    (tmp_path / "a.mcap").write_bytes(data)
    result = recover(tmp_path / "a.mcap", tmp_path / "b")
    assert result.whole and result.lost_messages == 0 and not result.dropped
    assert kept(tmp_path / "b") == written
    assert result.topics == dict.fromkeys(TOPICS, 60)
    with Recording(tmp_path / "a.mcap") as before, Recording(tmp_path / "b") as after:
        assert after.topics() == before.topics()
        assert after.attachment("cell.yaml") == before.attachment("cell.yaml")
        old = before.metadata()
        assert {k: v for k, v in after.metadata().items() if k in old and k != "rosbag2"} == {
            k: v for k, v in old.items() if k != "rosbag2"}  # fmt: skip


def test_rosbags_reads_what_was_recovered_but_not_the_cut_off_file(source, tmp_path):
    data, written, _ = source
    (tmp_path / "a.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(Exception, match="magic"), Reader(tmp_path / "a.mcap"):
        pass
    result = recover(tmp_path / "a.mcap")
    assert result.directory == str(tmp_path / "a_recovered")
    with Reader(tmp_path / "a_recovered") as reader:
        found = [(c.topic, t, d) for c, t, d in reader.messages()]
    assert len(found) == result.messages and set(found) == set(written[: len(found)])
    assert (tmp_path / "a.mcap").read_bytes() == data[: len(data) // 2]


def test_a_recordings_directory_gets_its_copy_beside_it_and_stays_as_it_was(source, tmp_path, monkeypatch):
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "a.mcap").write_bytes(source[0][:-20])
    monkeypatch.chdir(tmp_path / "r")
    assert recover(".").directory == str(tmp_path / "r_recovered")
    assert [file.name for file in (tmp_path / "r").iterdir()] == ["a.mcap"]
    with pytest.raises(RecordingError, match="exists already"):
        recover(f"{tmp_path}/r/")


@given(st.integers(60, 10**6))
@RELAXED
def test_a_cut_file_keeps_every_whole_chunk(source, tmp_path_factory, place):
    data, written, chunks = source
    place = 60 + place % (len(data) - 60)
    file = tmp_path_factory.mktemp("x") / "a.mcap"
    file.write_bytes(data[:place])
    result = recover(file)
    assert kept(result.directory) == written[: result.messages]
    assert result.messages == sum(count for chunk, count in chunks if chunk.offset + chunk.size <= place)


def test_a_file_that_lacks_only_its_end_loses_nothing(source, tmp_path):
    data, written, _ = source
    (tmp_path / "a.mcap").write_bytes(data[:-20])
    result = recover(tmp_path / "a.mcap")
    assert not result.whole and result.lost_messages == 0
    assert kept(result.directory) == written


@pytest.mark.parametrize("place", ["packed bytes", "length", "packed length", "type", "first time"])
def test_a_damaged_chunk_in_the_middle_costs_only_itself(source, tmp_path, place):
    data, written, chunks = source
    chunk, count = chunks[len(chunks) // 2]
    packed = chunk.offset + PACKED
    at = {"packed bytes": packed + 50, "length": chunk.offset + 3, "packed length": packed - 6,
          "type": chunk.offset, "first time": chunk.offset + 9}[place]  # fmt: skip
    damaged = bytearray(data)
    damaged[at] ^= 0x30
    (tmp_path / "a.mcap").write_bytes(damaged)
    result = recover(tmp_path / "a.mcap")
    saved = set(kept(result.directory))
    lost = [m for m in written if m not in saved]
    begin = written.index(lost[0])
    assert lost == written[begin : begin + len(lost)]  # one piece
    assert len(lost) == count
    assert (result.lost_messages, result.messages) == (len(lost), len(written) - len(lost))
    assert not result.whole and len(result.dropped) >= 1 and result.lost_bytes >= chunk.size


def test_without_the_summary_a_lost_definition_is_told(source, tmp_path):
    """The first chunk defines the channels; in a cut-off file nothing else does."""
    data, written, chunks = source
    damaged = bytearray(data[: chunks[-1][0].offset])
    damaged[chunks[0][0].offset + PACKED + 100] ^= 1
    (tmp_path / "a.mcap").write_bytes(damaged)
    result = recover(tmp_path / "a.mcap")
    assert result.messages == 0 and any("whose definition is lost" in line for line in result.dropped)
    assert result.lost_messages is None
    # with the summary the rest comes back
    damaged = bytearray(data)
    damaged[chunks[0][0].offset + PACKED + 100] ^= 1
    (tmp_path / "b.mcap").write_bytes(damaged)
    result = recover(tmp_path / "b.mcap")
    assert result.messages > 0.8 * len(written) and result.lost_messages == len(written) - result.messages


@given(st.integers(0, 10**6), st.integers(1, 255), st.integers(1, 64))
@RELAXED
def test_whatever_is_recovered_was_written(source, tmp_path_factory, place, change, length):
    data, written, _ = source
    damaged = bytearray(data)
    for at in range(place % len(data), min(place % len(data) + length, len(data))):
        damaged[at] ^= change
    file = tmp_path_factory.mktemp("x") / "a.mcap"
    file.write_bytes(damaged)
    try:
        result = recover(file)
    except RecordingError as error:
        assert "\n" not in str(error)
        return
    good = set(written)
    assert all(message in good for message in kept(result.directory))


@given(st.integers(0, 10**6), st.binary(max_size=40), st.integers(0, 200))
@RELAXED
def test_bytes_that_come_in_or_get_lost_anywhere_are_one_sentence(source, tmp_path_factory, place, noise, lost):
    data, written, _ = source
    place %= len(data)
    file = tmp_path_factory.mktemp("x") / "a.mcap"
    file.write_bytes(data[:place] + noise + data[place + lost :])
    good = set(written)
    try:
        with Recording(file) as recording:
            assert all((m.topic, m.log_time, m.data) in good for m in recording.messages())
    except RecordingError as error:
        assert "\n" not in str(error)
    try:
        recovered = kept(recover(file).directory)
    except RecordingError as error:
        assert "\n" not in str(error) and place < 40  # not even the header can be read
        return
    assert all(message in good for message in recovered)


def test_nothing_is_overwritten_and_nothing_half_is_left(source, tmp_path):
    data, _, _ = source
    (tmp_path / "a.mcap").write_bytes(data[:5000])
    (tmp_path / "b").mkdir()
    with pytest.raises(RecordingError, match="not overwritten"):
        recover(tmp_path / "a.mcap", tmp_path / "b")
    (tmp_path / "noise.mcap").write_bytes(struct.pack("<100I", *range(100)))
    with pytest.raises(RecordingError, match="nothing in it can be recovered"):
        recover(tmp_path / "noise.mcap")
    with pytest.raises(RecordingError):
        recover(tmp_path / "missing.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "b", "noise.mcap"]


def test_a_whole_recording_is_left_alone(source, tmp_path, capsys):
    data, written, _ = source
    (tmp_path / "a.mcap").write_bytes(data)
    found = recover(tmp_path / "a.mcap")
    assert found.whole and found.directory == str(tmp_path) and found.messages == len(written)
    assert (found.topics, found.attachments, found.lost_messages) == (dict.fromkeys(TOPICS, 60), ["cell.yaml"], 0)
    assert main(["recover", str(tmp_path / "a.mcap")]) == 0
    assert "nothing to recover; unchanged" in capsys.readouterr().out
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


def test_a_message_with_an_impossible_publish_time_costs_only_itself(tmp_path):
    times = [(i, 2**63 if i == 3 else i) for i in range(6)]
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channel = writer.register_channel("/t", "cdr", writer.register_schema("a/msg/B", "ros2msg", b"int8 x"))
        for log_time, publish_time in times:
            writer.add_message(channel, log_time, b"\0\1\0\0\1", publish_time)
        writer.finish()
    found = recover(tmp_path / "a.mcap", tmp_path / "b")
    assert found.messages == 5 and "1 messages that have the time 9223372036854775808 ns" in found.dropped[0]
    assert [at for _, at, _ in kept(tmp_path / "b")] == [0, 1, 2, 4, 5]
