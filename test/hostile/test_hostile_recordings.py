"""Damaged and crafted recordings against the reader: errors, memory, messages."""

import os
import random
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from budget import budget
from mcap.writer import Writer
from samples.recording_samples import whole_recording, write_mcap

from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.export import export
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import findings, recover

MB = 1024 * 1024
BEGIN = b"\x89MCAP0\r\n" + struct.pack("<BQI4sI", 1, 12, 4, b"ros2", 0)
READ_ALL = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000, 2_000_000_000))
from kr270_milling.base.errors import RecordingError
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover
from kr270_milling.recordings.bag.recover import findings


def peak():  # [kB]; ru_maxrss would begin with the peak of the process that started this one
    return int(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])

before = peak()
for file in sys.argv[1:]:
    try:
        with Recording(file) as recording:
            print("read", sum(1 for _ in recording.messages()), findings(recording))
        recover(file)
    except RecordingError as error:
        print(error)
print(peak() - before, peak())
"""


def chunk_record(data: bytes, unpacked: int, compression: bytes, crc: int = 0, claimed: int | None = None) -> bytes:
    head = struct.pack("<QQQII", 0, 0, unpacked, crc, len(compression)) + compression
    body = head + struct.pack("<Q", len(data) if claimed is None else claimed) + data
    return struct.pack("<BQ", 6, len(body)) + body


def growth(*files) -> tuple[list[str], int, int]:
    """Lines of a process that reads, verifies and recovers these files; growth and peak of its memory [bytes]."""
    env = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]), OPENBLAS_NUM_THREADS="1")
    command = [sys.executable, "-c", READ_ALL, *map(str, files)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    *lines, memory = done.stdout.splitlines()
    grown, peak = (1024 * int(word) for word in memory.split())
    return lines, grown, peak


def damaged(data: bytes, kind: int, rng: random.Random) -> bytes:
    """Flipped bits, a truncation, a changed length of a record, or bytes that were replaced."""
    result, at = bytearray(data), rng.randrange(len(data))
    if kind == 0:
        for place in [at, *(rng.randrange(len(data)) for _ in range(rng.randrange(4)))]:
            result[place] ^= 1 << rng.randrange(8)
    elif kind == 1:
        return data[:at]
    elif kind == 2:
        begins = [8]
        while begins[-1] < len(data) - 8:
            begins.append(begins[-1] + 9 + struct.unpack_from("<Q", data, begins[-1] + 1)[0])
        begin = rng.choice(begins[:-1])
        result[begin + 1 : begin + 9] = struct.pack("<Q", rng.choice([0, 1, rng.randrange(5000), 2**40, 2**63]))
    else:
        result[at : at + rng.randrange(50)] = rng.randbytes(rng.randrange(1, 60))
    return bytes(result)


@pytest.mark.parametrize("seed", [*range(budget(400)), 248, 278])  # the last: a damaged summary, a length of 0
def test_a_damaged_file_gives_written_messages_or_one_sentence(tmp_path, seed):
    data, written = whole_recording()
    path, good = tmp_path / "a.mcap", set(written)
    path.write_bytes(damaged(data, seed % 4, random.Random(seed)))
    try:
        with Recording(path) as recording:
            assert findings(recording) or path.read_bytes() == data
            info(recording)
            export(recording, tmp_path / "csv")
            assert {(m.topic, m.log_time, m.data) for m in recording.messages()} <= good
    except RecordingError as error:
        assert "\n" not in str(error)
    try:
        directory = recover(path, tmp_path / "saved").directory
    except RecordingError as error:
        assert "nothing in it can be recovered" in str(error)
        return
    with Recording(directory) as recording:
        assert {(m.topic, m.log_time, m.data) for m in recording.messages()} <= good and not findings(recording)


@pytest.mark.parametrize("tail", [bytes(100), b"\xff" * 100, BEGIN])
def test_bytes_behind_the_end_of_a_file_change_no_message(tmp_path, tail):
    data, written = whole_recording()
    path = tmp_path / "a.mcap"
    path.write_bytes(data + tail)
    with Recording(path) as recording:
        assert findings(recording)
        assert [(m.topic, m.log_time, m.data) for m in recording.messages()] == written


def test_files_that_claim_absurd_sizes_take_no_memory(tmp_path):
    small = zstandard.compress(b"\0" * 1000)
    files = {
        "bomb": chunk_record(zstandard.compress(b"\0" * 200_000_000), 1000, b"zstd"),
        "large": chunk_record(zstandard.compress(b"\0" * 300_000_000), 300_000_000, b"zstd"),
        "unpacked": chunk_record(small, 2**60, b"zstd"),
        "packed": chunk_record(small, 1000, b"zstd", claimed=2**61),
        "endless": chunk_record(small, 1000, b"zstd", claimed=2**64 - 1),
        "record": struct.pack("<BQ", 3, 2**62) + b"\0" * 100,
        "name": struct.pack("<BQHI", 3, 100, 1, 2**32 - 1) + b"\0" * 94,
        "short": struct.pack("<BQHIII", 3, 24, 1, 0, 0, 100) + b"\0" * 10,
        "attachment": struct.pack("<BQQQIIQ", 9, 140, 0, 0, 0, 0, 2**40) + b"\0" * 108,
        "lz4 bomb": chunk_record(lz4.frame.compress(b"\0" * 200_000_000, store_size=False), 1000, b"lz4"),
        "no lz4": chunk_record(b"\x04\x22\x4d\x18" + b"\xff" * 50, 2**27, b"lz4"),
        "unknown": chunk_record(b"abc", 3, b"rar"),
    }
    for name, content in files.items():
        (tmp_path / f"{name}.mcap").write_bytes(BEGIN + content)
    lines, grown, _ = growth(*(tmp_path / f"{name}.mcap" for name in files))
    for name, line in zip(files, lines, strict=True):
        assert "cut off" in line if name == "record" else f"{name}.mcap" in line, line
    assert grown < 100 * MB


def test_two_chunks_of_200_mb_are_read_verified_and_recovered_within_500_mb(tmp_path):
    data = os.urandom(1_000_000)  # cannot be compressed
    path = write_mcap(tmp_path / "a.mcap", ((i, data[i:]) for i in range(420)), chunk_size=200 * MB)
    lines, _, peak = growth(path)
    assert lines == ["read 420 []"] and peak < 500 * MB


def test_every_compression_gives_its_bytes_back_and_a_truncated_chunk_is_refused(tmp_path):
    stream = zstandard.ZstdCompressor().compressobj()  # a frame without its size
    message = struct.pack("<BQHIQQ", 5, 22 + 300_000, 1, 0, 0, 0) + os.urandom(100_000) * 3
    channel = struct.pack("<BQHHI1sII", 4, 17, 1, 0, 1, b"t", 0, 0)
    data = channel + message
    for compression, packed in [
        (b"zstd", zstandard.compress(data)), (b"zstd", stream.compress(data) + stream.flush()),
        (b"lz4", lz4.frame.compress(data)), (b"lz4", lz4.frame.compress(data, store_size=False)), (b"", data),
    ]:  # fmt: skip
        path = tmp_path / "a.mcap"
        path.write_bytes(BEGIN + chunk_record(packed, len(data), compression, zlib.crc32(data)))
        with Recording(path) as recording:
            assert [m.data for m in recording.messages()] == [message[31:]]
        path.write_bytes(BEGIN + chunk_record(packed[: len(packed) // 2], len(data), compression, zlib.crc32(data)))
        with pytest.raises(RecordingError, match="unpack|checksum"):
            Recording(path)
        path.write_bytes(BEGIN + chunk_record(packed, len(data), compression, zlib.crc32(data), len(packed) - 1))
        with pytest.raises(RecordingError, match="unpack|checksum"):
            Recording(path)
        path.write_bytes(BEGIN + chunk_record(packed, len(data) + 1, compression))  # without a checksum
        with pytest.raises(RecordingError, match="announces"):
            Recording(path)


@pytest.mark.parametrize(("body", "sentence"), [
    (struct.pack("<BQHIQQ", 5, 22, 9, 0, 0, 0), "channel 9, which is not defined"),
    (struct.pack("<BQHII", 5, 10, 1, 0, 0) + struct.pack("<BQ", 0x90, 20) + bytes(20), "has an impossible length"),
    (struct.pack("<BQ", 0x90, 21) + bytes(20), "has an impossible length"),
    (struct.pack("<BQ", 0x90, 20) + bytes(24), "cannot be parsed"),
    (struct.pack("<BQHIQQ", 5, 22, 9, 0, 2**63, 0), "after the year 2262"),
    (struct.pack("<BQHHI1sII", 4, 17, 1, 0, 1, b"\xff", 0, 0), "cannot be parsed"),  # the topic is not UTF-8
])  # fmt: skip
def test_a_chunk_with_records_that_cannot_be_is_an_error_with_its_offset(tmp_path, body, sentence):
    (tmp_path / "a.mcap").write_bytes(BEGIN + chunk_record(body, len(body), b"", zlib.crc32(body)))
    with pytest.raises(RecordingError, match=sentence) as error, Recording(tmp_path / "a.mcap") as recording:
        list(recording.messages())
    assert error.value.offset == len(BEGIN) and recover(tmp_path / "a.mcap").messages == 0


def test_a_message_that_unfolds_into_millions_of_objects_is_not_exported_and_other_topics_are(tmp_path):
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
        files, refused = export(recording, tmp_path / "csv")
    assert "more than 4194304 to be decoded" in refused["/many"]
    assert [file.name for file in files] == ["few.csv"]
