"""Reading recordings, here and in readers by other people; verifying and recovering damaged recordings."""

import io
import struct
from typing import NamedTuple

import pytest
from budget import budget
from hostile import answered, ask
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from samples import pass_recording as made
from samples.recording_samples import (
    PERIOD,
    TOPICS,
    Whole,
    flipped,
    poses,
    raw,
    record,
    sample,
    whole_recording,
    write_mcap,
)

from kr270_milling.base.errors import RecordingError
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import findings, recover

NAMES = {1: "header", 6: "chunk", 7: "message index", 9: "attachment", 12: "metadata", 15: "end of data",
         11: "statistics", 8: "chunk index", 10: "attachment index", 13: "metadata index", 2: "footer"}  # fmt: skip


def places(data: bytes) -> dict[str, list[tuple[int, int]]]:
    """Begin and end of the content of every record of the top level, by its name."""
    actual, at = {}, 8
    while at < len(data) - 8:
        kind, size = struct.unpack_from("<BQ", data, at)
        actual.setdefault(NAMES.get(kind, ""), []).append((at + 9, at + 9 + size))
        at += 9 + size
    return actual


class Span(NamedTuple):
    """First byte of a chunk and the byte after its last one."""

    offset: int
    end: int


def order(messages) -> list:
    return sorted(messages, key=lambda m: (m[1], m[0]))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A directory with a file of many chunks, and its messages."""
    directory = tmp_path_factory.mktemp("bag") / "pass_1"
    written = record(directory, 60, attachments={"cell.yaml": "a: 1\n"}, metadata={"seed": 1}, chunk_size=20_000)
    return Whole((directory, written))


@pytest.fixture(scope="module")
def source(bag):
    """The bytes of this file, its messages, and its chunks with their numbers of messages."""
    directory, written = bag
    data = (directory / "pass_1.mcap").read_bytes()
    records = StreamReader(io.BytesIO(data), emit_chunks=True).records
    counts = [sum(isinstance(r, Message) for r in breakup_chunk(c)) for c in records if isinstance(c, Chunk)]
    spans = [Span(begin - 9, end) for begin, end in places(data)["chunk"]]
    return Whole((data, written, list(zip(spans, counts, strict=True))))


@pytest.mark.parametrize("part", ["", "pass_1.mcap"])
def test_rosbags_reads_the_same_bytes_and_decodes_them_with_the_definitions_in_the_file(bag, part):
    directory, written = bag
    with Reader(directory / part) as reader:
        actual = [(c.topic, t, bytes(d)) for c, t, d in reader.messages()]
        assert (reader.start_time, reader.end_time) == (0, 59 * PERIOD + 1)
        assert {k: (v.msgtype, v.msgcount) for k, v in reader.topics.items()} == {k: (v, 60) for k, v in TOPICS.items()}
        assert reader.ros_distro == (None if part else "jazzy")
        profiles = [connection.ext.offered_qos_profiles for connection in reader.connections]
        assert {(one.depth, one.durability.name) for (one,) in profiles} == {(1, "TRANSIENT_LOCAL")}
    assert order(actual) == order(written)
    with AnyReader([directory / part]) as reader:  # builds its types from the schemas in the file
        for connection, stamp, data in reader.messages():
            expected = sample(connection.topic, stamp // PERIOD)
            again = reader.typestore.serialize_cdr(reader.deserialize(data, connection.msgtype), connection.msgtype)
            assert bytes(again) == raw(expected)


# --- verifying and recovering ---


def test_a_whole_recording_has_no_findings(bag):
    directory, _ = bag
    assert "whole: every checksum and count fits" in ask("info", str(directory), "--verify").out
    assert answered("info", directory, "--verify")["damage"] == []


@pytest.mark.parametrize("name", list(NAMES.values()))
def test_a_flipped_bit_in_any_record_is_reported_and_recovered(tmp_path, name):
    data, written = whole_recording()
    for number, (begin, end) in enumerate(places(data)[name][:3]):
        for at in {begin, (begin + end) // 2, end - 1}:
            path = tmp_path / f"{number}_{at}.mcap"
            path.write_bytes(flipped(data, at, 4))
            answer = ask("info", str(path), "--verify")
            assert answer.code in (1, 2) and "whole" not in answer.out and (answer.out + answer.err).strip()
            assert answer.code == 2 or answer.out.endswith(f": kr270_milling recover {path}\n")
            result = recover(path)
            assert not result.whole and result.damage
            with Recording(result.directory) as recording:
                assert findings(recording) == []
                messages = [(m.topic, m.log_time, m.data) for m in recording.messages()]
            lost = name == "attachment" or not result.dropped
            assert messages == written if lost else set(messages) <= set(written)
            assert result.lost_messages in (None, len(written) - len(messages))


def test_a_recompute_does_not_call_a_damaged_recording_identical(tmp_path):
    directory = made.write(tmp_path / "r", made.one_pass())
    (file,) = directory.glob("*.mcap")
    whole = file.read_bytes()
    assert recompute(directory).verdict == "identical"
    for name in ("message index", "metadata", "end of data"):
        begin, end = places(whole)[name][0]
        file.write_bytes(flipped(whole, (begin + end) // 2, 4))
        assert recompute(directory).verdict == "damaged", name


def test_counts_that_do_not_fit_are_reported_without_any_checksum(tmp_path):
    data = whole_recording()[0]
    damaged = bytearray(flipped(data, places(data)["statistics"][0][0]))
    for checksummed in ("footer", "end of data"):
        end = places(data)[checksummed][0][1]
        damaged[end - 4 : end] = bytes(4)
    (tmp_path / "a.mcap").write_bytes(damaged)
    with Recording(tmp_path / "a.mcap") as recording:
        assert ["counts of messages" in text for text in findings(recording)] == [True]


def test_a_damaged_attachment_costs_only_itself(tmp_path):
    attached = {f"{name}.yaml": f"{name}: 1\n" * 9 for name in "abc"}
    written = record(tmp_path / "r", 5, topics=["/tool_pose"], attachments=attached)
    (file,) = (tmp_path / "r").glob("*.mcap")
    data = file.read_bytes()
    file.write_bytes(flipped(data, places(data)["attachment"][1][1] - 10, 4))
    actual = recover(tmp_path / "r")
    assert actual.attachments == ["a.yaml", "c.yaml"] and actual.messages == len(written)
    assert "attachment b.yaml" in actual.dropped[0]


PACKED = 9 + 3 * 8 + 4 + 8 + 8  # bytes of a chunk before its packed bytes: lengths, times, checksum, "zstd"


def content_of(directory) -> list:
    with Recording(directory) as recording:
        assert not recording.cut_off and not findings(recording)
        return [(m.topic, m.log_time, m.data) for m in recording.messages()]


def test_a_whole_file_is_copied_with_everything(source, tmp_path):
    data, written, _ = source
    (tmp_path / "a.mcap").write_bytes(data)
    result = recover(tmp_path / "a.mcap", tmp_path / "b")
    assert result.whole and result.lost_messages == 0 and not result.dropped
    assert content_of(tmp_path / "b") == written
    assert result.topics == dict.fromkeys(TOPICS, 60)
    with Recording(tmp_path / "a.mcap") as before, Recording(tmp_path / "b") as after:
        assert after.topics() == before.topics()
        assert after.attachment("cell.yaml") == before.attachment("cell.yaml")
        old, new = before.metadata(), after.metadata()
        assert all(new[key] == value for key, value in old.items() if key != "rosbag2")


def test_a_recordings_directory_gets_its_copy_beside_it_and_stays_as_it_was(source, tmp_path, monkeypatch):
    data, written, _ = source
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "a.mcap").write_bytes(data[:-20])
    with pytest.raises(Exception, match="magic"), Reader(tmp_path / "r" / "a.mcap"):
        pass
    monkeypatch.chdir(tmp_path / "r")
    result = recover(".")
    assert result.directory == str(tmp_path / "r_recovered") and result.lost_messages == 0
    with Reader(tmp_path / "r_recovered") as reader:
        assert {(c.topic, t, d) for c, t, d in reader.messages()} == set(written)
    assert [file.name for file in (tmp_path / "r").iterdir()] == ["a.mcap"]
    with pytest.raises(RecordingError, match="exists already"):
        recover(f"{tmp_path}/r/")


@given(st.integers(60, 10**6))
@settings(max_examples=budget(60))
def test_a_cut_file_keeps_every_whole_chunk(source, tmp_path_factory, place):
    data, written, chunks = source
    place = 60 + place % (len(data) - 60)
    file = tmp_path_factory.mktemp("x") / "a.mcap"
    file.write_bytes(data[:place])
    result = recover(file)
    assert content_of(result.directory) == written[: result.messages]
    assert result.messages == sum(count for chunk, count in chunks if chunk.end <= place)
    assert not result.whole and result.lost_messages in (None, len(written) - result.messages)


@pytest.mark.parametrize("place", ["packed bytes", "length", "longer", "packed length", "type"])
def test_a_damaged_chunk_in_the_middle_costs_only_itself(source, tmp_path, place):
    data, written, chunks = source
    chunk, count = chunks[len(chunks) // 2]
    packed = chunk.offset + PACKED
    at = {"packed bytes": packed + 50, "length": chunk.offset + 3, "longer": chunk.offset + 2,
          "packed length": packed - 6, "type": chunk.offset}[place]  # fmt: skip
    damaged = flipped(data, at, 0x30)
    if place == "longer":  # and yet within the file
        assert chunk.end < chunk.offset + struct.unpack_from("<Q", damaged, chunk.offset + 1)[0] < len(damaged) - 1000
    (tmp_path / "a.mcap").write_bytes(damaged)
    result = recover(tmp_path / "a.mcap")
    saved = set(content_of(result.directory))
    lost = [m for m in written if m not in saved]
    begin = written.index(lost[0])
    assert lost == written[begin : begin + len(lost)]  # one piece
    assert len(lost) == count
    assert (result.lost_messages, result.messages) == (len(lost), len(written) - len(lost))
    assert not result.whole and len(result.dropped) >= 1
    assert place == "type" or result.lost_bytes >= chunk.end - chunk.offset  # readers skip records of unknown types


def test_without_the_summary_a_lost_definition_is_reported(source, tmp_path):
    """The first chunk defines the channels; in a cut-off file nothing else does."""
    data, written, chunks = source
    damaged = flipped(data, chunks[0][0].offset + PACKED + 100)
    (tmp_path / "cut.mcap").write_bytes(damaged[: chunks[-1][0].offset])
    result = recover(tmp_path / "cut.mcap")
    assert result.messages == 0 and any("which is not defined" in line for line in result.dropped)
    assert result.lost_messages is None
    (tmp_path / "whole.mcap").write_bytes(damaged)  # with the summary
    result = recover(tmp_path / "whole.mcap")
    assert result.messages > 0.8 * len(written) and result.lost_messages == len(written) - result.messages
    uncounted = flipped(damaged, places(damaged)["statistics"][0][0])  # nothing states how many messages there were
    (tmp_path / "uncounted.mcap").write_bytes(uncounted)
    assert recover(tmp_path / "uncounted.mcap").lost_messages is None


def test_nothing_is_overwritten_and_nothing_half_is_left(source, tmp_path):
    data, written, _ = source
    (tmp_path / "a.mcap").write_bytes(data)
    (tmp_path / "b").mkdir()
    with pytest.raises(RecordingError, match="not overwritten"):
        recover(tmp_path / "a.mcap", tmp_path / "b")
    (tmp_path / "noise.mcap").write_bytes(struct.pack("<100I", *range(100)))
    with pytest.raises(RecordingError, match="nothing in it can be recovered"):
        recover(tmp_path / "noise.mcap")
    actual = recover(tmp_path / "a.mcap")  # whole: nothing is written
    assert actual.whole and actual.directory == str(tmp_path) and actual.messages == len(written)
    assert (actual.topics, actual.attachments, actual.lost_messages) == (dict.fromkeys(TOPICS, 60), ["cell.yaml"], 0)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "b", "noise.mcap"]


def test_a_message_with_an_impossible_publish_time_costs_only_itself(tmp_path):
    messages = [(at, data, 2**63 if at == 3 else at) for at, data in poses(range(6))]
    write_mcap(tmp_path / "a.mcap", messages)
    actual = recover(tmp_path / "a.mcap", tmp_path / "b")
    assert actual.messages == 5 and "1 messages that have the time 9223372036854775808 ns" in actual.dropped[0]
    assert [at for _, at, _ in content_of(tmp_path / "b")] == [0, 1, 2, 4, 5]
