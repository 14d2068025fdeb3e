"""Damage outside of the chunks: told by verify, mended by recover."""

from __future__ import annotations

import json
import struct

import pytest
from mcap.writer import IndexType, Writer
from test_recording_samples import record

from kr270_milling.cli import main
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover
from kr270_milling.recordings.bag.verify import findings

NAMES = {1: "header", 7: "message index", 9: "attachment", 12: "metadata", 15: "end of data", 11: "statistics",
         8: "chunk index", 2: "footer"}  # fmt: skip


def places(data: bytes) -> dict[str, list[tuple[int, int]]]:
    """Begin and end of the content of every record of the top level, by its name."""
    found, at = {}, 8
    while at < len(data) - 8:
        kind, size = struct.unpack_from("<BQ", data, at)
        found.setdefault(NAMES.get(kind, ""), []).append((at + 9, at + 9 + size))
        at += 9 + size
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("whole") / "a"
    written = record(directory, 40, topics=["/tool_pose", "/wrench", "/robot_description"],
                     attachments={"cell.yaml": "a: 1\n" * 50}, metadata={"seed": 7}, chunk_size=2000)  # fmt: skip
    return (directory / "a.mcap").read_bytes(), written, (directory / "metadata.yaml").read_bytes()


def test_a_whole_recording_has_no_findings(whole, tmp_path, capsys):
    (tmp_path / "a.mcap").write_bytes(whole[0])
    (tmp_path / "metadata.yaml").write_bytes(whole[2])
    assert main(["info", str(tmp_path), "--verify"]) == 0
    assert "whole: every checksum and index fits" in capsys.readouterr().out
    assert main(["info", str(tmp_path), "--verify", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["damage"] == []


@pytest.mark.parametrize("name", list(NAMES.values()))
def test_a_flipped_bit_in_any_record_is_told_and_mended(whole, tmp_path, name, capsys):
    data, written, _ = whole
    for number, (begin, end) in enumerate(places(data)[name][:3]):
        for at in {begin, (begin + end) // 2, end - 1}:
            damaged = bytearray(data)
            damaged[at] ^= 4
            path = tmp_path / f"{number}_{at}.mcap"
            path.write_bytes(damaged)
            assert main(["info", str(path), "--verify"]) in (1, 2)
            printed = capsys.readouterr()
            assert "whole" not in printed.out and (printed.out + printed.err).strip()
            result = recover(path)
            assert not result.whole and result.damage
            with Recording(result.directory) as recording:
                assert findings(recording) == []
                messages = [(m.topic, m.log_time, m.data) for m in recording.messages(as_written=True)]
            lost = name == "attachment" or not result.dropped
            assert messages == written if lost else set(messages) <= set(written)


def test_a_recompute_does_not_call_a_damaged_recording_identical(tmp_path):
    import pass_recording as made

    directory = made.write(tmp_path / "r", made.one_pass())
    (file,) = directory.glob("*.mcap")
    whole = file.read_bytes()
    assert recompute(directory).verdict == "identical"
    for name in ("message index", "metadata", "end of data"):
        begin, end = places(whole)[name][0]
        damaged = bytearray(whole)
        damaged[(begin + end) // 2] ^= 4
        file.write_bytes(damaged)
        assert recompute(directory).verdict == "damaged", name


def foreign(path, index, change=lambda data: data):
    """A file without a checksum over its data."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=200, index_types=index)
        writer.start("ros2")
        channel = writer.register_channel("/t", "cdr", writer.register_schema("a/msg/B", "ros2msg", b"int8 x"))
        for step in range(50):
            writer.add_message(channel, step, b"\0\1\0\0\1", step)
        writer.finish()
    path.write_bytes(change(path.read_bytes()))
    with Recording(path) as recording:
        return findings(recording)


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE])
def test_a_file_is_whole_with_the_indexes_that_its_writer_wrote(tmp_path, index):
    assert foreign(tmp_path / "a.mcap", index) == []


def test_an_index_of_messages_that_points_elsewhere_is_told_without_any_checksum(tmp_path):
    def change(data: bytes) -> bytes:
        begin, end = places(data)["message index"][1]
        return data[: end - 8] + bytes([data[end - 8] ^ 1]) + data[end - 7 :]

    assert "an index points to other messages than its chunk holds" in foreign(tmp_path / "a.mcap", IndexType.ALL,
                                                                               change)[0]  # fmt: skip


def test_metadata_beside_the_file_that_counts_other_messages_is_told(whole, tmp_path):
    (tmp_path / "a.mcap").write_bytes(whole[0])
    for text, told in [(whole[2].replace(b"message_count: 40", b"message_count: 41"), "counts other"),
                       (whole[2][:100], "cannot be read"), (b"{", "cannot be read")]:  # fmt: skip
        (tmp_path / "metadata.yaml").write_bytes(text)
        with Recording(tmp_path) as recording:
            assert told in findings(recording)[0]


def test_a_damaged_attachment_costs_only_itself(tmp_path):
    attached = {f"{name}.yaml": f"{name}: 1\n" * 9 for name in "abc"}
    written = record(tmp_path / "r", 5, topics=["/tool_pose"], attachments=attached)
    (file,) = (tmp_path / "r").glob("*.mcap")
    damaged = bytearray(file.read_bytes())
    damaged[places(damaged)["attachment"][1][1] - 10] ^= 4
    file.write_bytes(damaged)
    found = recover(tmp_path / "r")
    assert found.attachments == ["a.yaml", "c.yaml"] and found.messages == len(written)
    assert "attachment b.yaml" in found.dropped[0]


def test_an_index_of_messages_that_belongs_to_no_chunk_is_told_without_any_checksum(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1, enable_data_crcs=False)
        writer.start()
        channel = writer.register_channel("/a", "cdr", writer.register_schema("a", "ros2msg", b""))
        writer.add_message(channel, 1, b"\0\1\0\0abcd", 1)
        writer.add_attachment(1, 1, "a.txt", "text/plain", b"a")
        writer.finish()
    end = places(path.read_bytes())["end of data"][0][0] - 9
    stray, data = struct.pack("<BQHI", 7, 6, channel, 0), path.read_bytes()
    *starts, _ = struct.unpack_from("<QQI", data, len(data) - 28)
    footer = struct.pack("<QQI", *(place + len(stray) for place in starts), 0)
    path.write_bytes(data[:end] + stray + data[end:-28] + footer + data[-8:])
    with Recording(path) as recording:
        assert any("belongs to no chunk" in sentence for sentence in findings(recording))


def test_counts_in_a_damaged_summary_do_not_tell_what_is_lost(whole, tmp_path):
    data, written, _ = whole
    begin, end = places(data)["statistics"][0]
    for bit in range(8 * (begin + 2), 8 * end, 37):
        path = tmp_path / f"{bit}.mcap"
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        found = recover(path)
        assert found.messages == len(written) and found.lost_messages == 0
