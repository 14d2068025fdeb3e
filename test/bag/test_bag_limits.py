"""What a file unfolds into is bounded: definitions, chunks, decoded messages, series."""

from __future__ import annotations

import struct
from contextlib import nullcontext

import numpy as np
import pytest
from mcap.writer import IndexType, Writer
from test_bag_unpack import BEGIN, chunk_record
from test_recording_reader import poses, write_mcap

from kr270_milling.bag.export import export
from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.series import series


def test_definitions_that_a_chunk_unfolds_are_bounded(tmp_path, monkeypatch):
    """60 MB of them in every chunk of 60 kB were all held."""
    monkeypatch.setattr("kr270_milling.bag.reader.MOST_DEFINED", 100_000)
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream, repeat_schemas=False, use_statistics=False)
        writer.start("ros2")
        for number in range(50):
            schema = writer.register_schema(f"a/msg/B{number}", "ros2msg", b"#" * 5000)
        writer.add_message(writer.register_channel("/t", "cdr", schema), 0, b"", 0)
        writer.finish()
    with pytest.raises(RecordingError, match="take more than 100000 bytes"):
        Recording(tmp_path / "a.mcap")


@pytest.mark.parametrize("kind", [3, 77])  # definitions, and records that nobody knows
def test_the_number_of_records_in_a_chunk_is_bounded(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("kr270_milling.bag.chunks.MOST", 1000)
    monkeypatch.setattr("kr270_milling.bag.chunks.MOST_DEFINITIONS", 900)
    for count, refused in ((900, False), (1001, True)):
        data = b"".join(struct.pack("<BQHIII", kind, 14, 1 + i, 0, 0, 0) for i in range(count))
        (tmp_path / "a.mcap").write_bytes(BEGIN + chunk_record(data, len(data), b""))
        with pytest.raises(RecordingError, match="more than 1000 records or 900") if refused else nullcontext():
            Recording(tmp_path / "a.mcap").close()


def test_the_number_of_chunks_is_bounded(tmp_path, monkeypatch):
    path = write_mcap(tmp_path / "a.mcap", poses(range(20)), chunk_size=100)
    monkeypatch.setattr("kr270_milling.bag.reader.MOST_CHUNKS", 10)
    with pytest.raises(RecordingError, match="more than 10 chunks"):
        Recording(path)


def test_a_message_that_unfolds_into_millions_of_objects_is_not_decoded_and_its_neighbours_are(tmp_path):
    """22 kB of file: 240 MB of empty texts."""
    count = 600_000
    data = b"\0\1\0\0" + struct.pack("<I", count) + struct.pack("<I4x", 1) * count
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for name, payload in (("/many", data), ("/few", b"\0\1\0\0" + struct.pack("<II4x", 1, 1))):
            schema = writer.register_schema("a/msg/S", "ros2msg", b"string[] data\n")
            writer.add_message(writer.register_channel(name, "cdr", schema), 0, payload, 0)
        writer.finish()
    with Recording(tmp_path / "a.mcap") as recording:
        found = export(recording, tmp_path / "csv")
    assert "more than 4194304 to be decoded" in found.refused["/many"]
    assert [file.name for file in found.files] == ["few.csv"]


def test_a_series_that_unfolds_far_beyond_the_file_is_refused(tmp_path, monkeypatch):
    path = write_mcap(tmp_path / "a.mcap", [(0, poses([0])[0][1])] * 20_000, index_types=IndexType.NONE)
    with Recording(path) as recording:
        assert recording.size < 20_000 and len(series(recording, "/tool_pose").values) == 20_000
        monkeypatch.setattr("kr270_milling.messages.series.BEARABLE", 1000)
        with pytest.raises(RecordingError, match="50 times the size of the file"):
            series(recording, "/tool_pose")
    varied = write_mcap(tmp_path / "b.mcap", poses(np.arange(20_000)))
    with Recording(varied) as recording:
        assert len(series(recording, "/tool_pose").values) == 20_000
