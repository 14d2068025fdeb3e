"""The memory of the commands that read recordings, as the kernel counts it: one chunk and 64 MB, not two chunks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pass_recording as made
import pytest
from mcap.writer import CompressionType, Writer

from kr270_milling.bag.reader import Recording

MB = 1024 * 1024
CHUNK = 100 * MB  # two of them, and one and 64 MB, are well apart
MOST = CHUNK + 64 * MB + 8 * MB  # 8 MB: what varies between two starts of the interpreter, and indexes of the messages
PEAK = """
import sys
from kr270_milling.cli import main
code = main(sys.argv[1:])
(line,) = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]
print("PEAK", code, line.split()[1])
"""
COMMANDS = {
    "info": ["info", "{}"],
    "verify": ["info", "--verify", "{}"],
    "recover": ["recover", "{}", "--out", "{}_recovered"],
    "export": ["export", "{}", "--csv", "{}_tables", "--topics", "/wrench"],
    "recompute": ["replay", "{}", "--recompute"],
}


def recording(path: Path, packing: CompressionType, size: int, random: bool = False) -> Path:
    """A pass, and two chunks of that size with messages of 64 kB in each."""
    with Recording(made.write(path.with_suffix(""), made.one_pass())) as small, open(path, "wb") as stream:
        writer = Writer(stream, 2 * CHUNK, packing, enable_data_crcs=True)
        writer.start("ros2", small.library)
        for about in small.attachments:
            writer.add_attachment(0, 0, about.name, about.media_type, small.attachment(about.name))
        for name, entries in small.metadata().items():
            if name != "rosbag2":
                writer.add_metadata(name, entries)
        channels = {
            name: writer.register_channel(
                name, about.encoding, writer.register_schema(about.type, about.schema_encoding, about.schema.encode())
            )
            for name, about in small.topics().items()
        }
        for message in small.messages():
            writer.add_message(channels[message.topic], message.log_time, message.data, message.publish_time)
        end = small.last_log_time + 1
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", text)
        piece = b"\0\1\0\0" + (65_529).to_bytes(4, "little") + b"a" * 65_528 + b"\0"
        for chunk in range(2):
            writer.flush()
            for k in range(size // len(piece)):
                data = piece[:8] + os.urandom(32_764).hex().encode() + b"\0" if random else piece
                writer.add_message(channel, end + chunk * 10**6 + k, data, end)
        writer.finish()
    return path


def peak(command: list[str], path: Path) -> int:
    """[bytes] of the command at most."""
    words = [sys.executable, "-c", PEAK, *(word.format(path) for word in command)]
    env = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]), OPENBLAS_NUM_THREADS="1")
    done = subprocess.run(words, env=env, capture_output=True, text=True, timeout=120)
    assert "PEAK 0 " in done.stdout, done.stdout + done.stderr
    return 1024 * int(done.stdout.split()[-1])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The same content, packed in each way; "little": without large chunks; "random": what packs badly."""
    folder = tmp_path_factory.mktemp("peak")
    made_of = {
        "little": (CompressionType.ZSTD, MB),
        "zstd": (CompressionType.ZSTD, CHUNK),
        "random": (CompressionType.ZSTD, CHUNK, True),
        "lz4": (CompressionType.LZ4, CHUNK),
        "none": (CompressionType.NONE, CHUNK),
    }
    return {name: recording(folder / f"{name}.mcap", *how) for name, how in made_of.items()}


@made.needs_messages
@pytest.mark.parametrize(("command", "packings"), [
    ("info", ["zstd"]), ("verify", ["zstd", "random", "lz4", "none"]), ("recover", ["zstd"]), ("export", ["zstd"]),
    ("recompute", ["zstd"]),
])  # fmt: skip
def test_no_command_holds_more_than_one_chunk_and_64_mb(files, command, packings):
    bare = peak(COMMANDS[command], files["little"])
    for packing in packings:
        assert peak(COMMANDS[command], files[packing]) - bare < MOST, packing
