"""Chunks and records made to do harm: the reader's memory is bounded by what is there, not by what is claimed."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from test_recording_reader import write_mcap

from kr270_milling.bag.packing import Packed
from kr270_milling.bag.reader import Recording
from kr270_milling.bag.structure import Damage
from kr270_milling.base.errors import RecordingError


def chunk_record(data: bytes, unpacked: int, packing: bytes, crc: int = 0, claimed: int | None = None) -> bytes:
    head = struct.pack("<QQQII", 0, 0, unpacked, crc, len(packing)) + packing
    body = head + struct.pack("<Q", len(data) if claimed is None else claimed) + data
    return struct.pack("<BQ", 6, len(body)) + body


BEGIN = b"\x89MCAP0\r\n" + struct.pack("<BQI4sI", 1, 12, 4, b"ros2", 0)
GREEDY = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000, 2_000_000_000))
from kr270_milling.base.errors import RecordingError
from kr270_milling.bag.reader import Recording
from kr270_milling.bag.recover import recover

def grown():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before

before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for file in sys.argv[1:]:
    try:
        with Recording(file) as recording:
            list(recording.messages())
        print("read", recording.cut_off)
    except RecordingError as error:
        print(error)
    try:
        recover(file)
    except RecordingError:
        pass
    print(grown())
"""


def greedy_files() -> dict[str, bytes]:
    empty = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)
    many = zstandard.compress(empty * 2_000_000)
    small = zstandard.compress(b"\0" * 1000)
    return {  # the most that memory grew so far is told behind each, so that the one that may take least comes first
        "bomb": chunk_record(zstandard.compress(b"\0" * 200_000_000), 1000, b"zstd"),
        "unpacked": chunk_record(small, 2**60, b"zstd"),
        "packed": chunk_record(small, 1000, b"zstd", claimed=2**61),
        "endless": chunk_record(small, 1000, b"zstd", claimed=2**64 - 1),
        "messages": chunk_record(many, 62_000_000, b"zstd"),
        "record": struct.pack("<BQ", 3, 2**62) + b"\0" * 100,
        "name": struct.pack("<BQHI", 3, 100, 1, 2**32 - 1) + b"\0" * 94,
        "attachment": struct.pack("<BQQQIIQ", 9, 2**40, 0, 0, 0, 0, 2**40) + b"\0" * 100,
        "no lz4": chunk_record(b"\x04\x22\x4d\x18" + b"\xff" * 50, 2**27, b"lz4"),
        "unknown": chunk_record(b"abc", 3, b"rar"),
    }


def test_files_that_claim_absurd_sizes_take_no_memory(tmp_path):
    files = greedy_files()
    for name, content in files.items():
        (tmp_path / f"{name}.mcap").write_bytes(BEGIN + content)
    env = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]), OPENBLAS_NUM_THREADS="1")
    command = [sys.executable, "-c", GREEDY, *(str(tmp_path / f"{name}.mcap") for name in files)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    for name, told, kilobytes in zip(files, lines[::2], lines[1::2], strict=True):
        assert "Error" not in told and name in told or told == "read True", told
        assert int(kilobytes) < (100_000 if name == "bomb" else 600_000), name


def test_a_long_file_is_read_in_little_memory(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", ((i, os.urandom(100_000)) for i in range(1500)))  # 150 MB
    code = """
import resource, sys
from kr270_milling.bag.reader import Recording
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with Recording(sys.argv[1]) as recording:
    assert sum(1 for _ in recording.messages()) == 1500
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    env = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]))
    output = subprocess.run([sys.executable, "-c", code, path], env=env, capture_output=True, text=True, check=True)
    assert int(output.stdout) < 120_000  # [kB]; the cache of 64 MB and what zstandard needs


def zstd_stream(data: bytes) -> bytes:
    """A frame that does not say how many bytes it holds."""
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    return packer.compress(data) + packer.flush()


@pytest.mark.parametrize(("packing", "pack"), [
    ("zstd", zstandard.compress), ("zstd", zstd_stream), ("zstd", lambda data: zstandard.compress(data, 19)),
    ("lz4", lz4.frame.compress), ("lz4", lambda data: lz4.frame.compress(data, block_linked=False, store_size=False)),
    ("lz4", lambda data: lz4.frame.compress(data, content_checksum=True, block_size=lz4.frame.BLOCKSIZE_MAX4MB)),
    ("", bytes),
])  # fmt: skip
def test_every_packing_gives_its_bytes_back_and_one_that_was_cut_off_does_not(tmp_path, packing, pack):
    for data in (b"a", b"a" * 5_000_000, os.urandom(5_000_000), os.urandom(100_000) * 30):
        whole = pack(data)
        for packed in (whole, whole[: len(whole) // 2]):
            path = tmp_path / "a.mcap"
            path.write_bytes(chunk_record(packed, len(data), packing.encode()))
            with open(path, "rb") as stream:
                found = Packed.of(stream, 0, path.stat().st_size)
                try:
                    unpacked = found.unpack(stream, 0)
                except Damage:
                    unpacked = None
            assert (unpacked == data) == (packed == whole)


def test_a_message_of_an_undefined_channel_is_an_error(tmp_path):
    body = struct.pack("<BQHIQQ", 5, 22, 9, 0, 0, 0)
    (tmp_path / "a.mcap").write_bytes(BEGIN + chunk_record(body, len(body), b"", zlib.crc32(body)))
    with Recording(tmp_path / "a.mcap") as recording, pytest.raises(RecordingError, match="channel 9"):
        list(recording.messages())
