"""How fast the recorder and its writer are, beside mcap's own writer: ``python -m bench.recorder``, in ``test``."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mcap.writer import Writer

from kr270_milling.live.ros.environment import child_environment
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.definitions import definition

SMALL_RATE, SMALL_SECONDS = 20_000, 10.0  # messages a second; seconds
LARGE, LARGE_COUNT = 1_000_000, 1000  # bytes; messages
POSE, GRID = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/OccupancyGrid"


def recorded(out: Path, rate: int, count: int, size: int) -> tuple[float, float, int]:
    """Seconds to send the messages, seconds until they were written, messages that are lost."""
    node = [sys.executable, "-m", "kr270_milling.live.nodes", "recorder", "--ros-args", "-p", f"directory:={out}"]
    source = [sys.executable, str(Path(__file__).with_name("source.py")), str(rate), str(count), str(size)]
    quiet = {"env": child_environment(), "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*node, "-p", "topics:=bench"], **quiet) as recorder:
        try:
            printed = subprocess.run(source, stdout=subprocess.PIPE, text=True, timeout=120, check=True, **quiet).stdout
        finally:
            recorder.send_signal(signal.SIGINT)
    begin, seconds = map(float, printed.split())
    with Recording(out) as recording:
        written = recording.path.stat().st_mtime - begin
        return seconds, written, count - recording.topics()["/bench"].count


def plain_writer(file: Path, type_name: str, bodies: list[bytes]) -> float:
    """Seconds of mcap's writer."""
    with open(file, "wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(type_name, "ros2msg", definition(type_name).encode())
        channel = writer.register_channel("/t", "cdr", schema)
        begin = time.perf_counter()
        for i, data in enumerate(bodies):
            writer.add_message(channel, i, data, i)
        writer.finish()
    return time.perf_counter() - begin


def bag_writer(file: Path, type_name: str, bodies: list[bytes]) -> float:
    """Seconds of BagWriter."""
    with BagWriter(file) as writer:
        writer.add_topic("/t", type_name)
        begin = time.perf_counter()
        for i, data in enumerate(bodies):
            writer.write("/t", data, i)
        writer.close()
    return time.perf_counter() - begin


def header(step: int) -> bytes:
    """The begin of a message: little-endian CDR, a stamp of ``step`` half milliseconds, the frame "base_link"."""
    return struct.pack("<4BiII10s2x", 0, 1, 0, 0, step // 2000, step % 2000 * 500_000, 10, b"base_link\0")


def bench_writer(small: int = 100_000, large: int = 200) -> dict[str, float]:
    """Small messages a second and MB/s of 1 MB messages, of mcap's writer ("plain") and of BagWriter ("bag")."""
    pad, grid = struct.pack("<7d", *(0.1 * i for i in range(7))), bytes(i * 7 % 101 for i in range(1_000_000))
    poses, grids = [header(i) + pad for i in range(small)], [header(i) + grid for i in range(large)]
    rates: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as directory:
        for name, run in (("plain", plain_writer), ("bag", bag_writer)):
            rates[f"{name}_small_per_s"] = small / run(Path(directory, f"{name}_small"), POSE, poses)
            rates[f"{name}_large_mb_per_s"] = large / run(Path(directory, f"{name}_large"), GRID, grids)
    return rates


def main() -> None:
    rates, count = bench_writer(), round(SMALL_RATE * SMALL_SECONDS)
    with tempfile.TemporaryDirectory() as directory:
        seconds, _, lost = recorded(Path(directory, "small"), SMALL_RATE, count, 0)
        rates |= {"recorder_small_per_s": count / seconds, "recorder_small_lost": lost}
        _, seconds, lost = recorded(Path(directory, "large"), 0, LARGE_COUNT, LARGE)  # as fast as they are taken
        rates |= {"recorder_large_mb_per_s": (LARGE_COUNT - lost) * LARGE * 1e-6 / seconds, "recorder_large_lost": lost}
    rates["recorder_large_share_of_plain"] = rates["recorder_large_mb_per_s"] / rates["plain_large_mb_per_s"]
    for key, value in rates.items():
        print(f"{key:32} {value:.4g}")


if __name__ == "__main__":
    main()
