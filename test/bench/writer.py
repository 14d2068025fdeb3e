"""How fast messages are written here, beside mcap's own writer: a yardstick for the recorder."""

from __future__ import annotations

import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from mcap.writer import Writer

from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.definitions import definition

__all__ = ["bench_writer"]

POSE, GRID = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/OccupancyGrid"


def _header(step: int) -> bytes:
    """The begin of a message: little-endian CDR, a stamp of ``step`` half milliseconds, the frame "base_link"."""
    return struct.pack("<4BiII10s2x", 0, 1, 0, 0, step // 2000, step % 2000 * 500_000, 10, b"base_link\0")


def _plain(file: Path, type_name: str, bodies: list[bytes]) -> float:
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


def _ours(file: Path, type_name: str, bodies: list[bytes]) -> float:
    with BagWriter(file) as writer:
        writer.add_topic("/t", type_name)
        begin = time.perf_counter()
        for i, data in enumerate(bodies):
            writer.write("/t", data, i)
        writer.close()
    return time.perf_counter() - begin


def bench_writer(small: int = 100_000, large: int = 200) -> dict:
    """Small messages a second and MB/s of 1 MB messages, for mcap's writer ("plain") and for BagWriter ("bag")."""
    pad = struct.pack("<7d", *(0.1 * i for i in range(7)))
    poses = [_header(i) + pad for i in range(small)]
    grid = bytes(i * 7 % 101 for i in range(1_000_000))
    grids = [_header(i) + grid for i in range(large)]
    result: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as directory:
        run: Callable
        for name, run in (("plain", _plain), ("bag", _ours)):
            result[f"{name}_small_per_s"] = small / run(Path(directory, f"{name}_small"), POSE, poses)
            result[f"{name}_large_mb_per_s"] = large / run(Path(directory, f"{name}_large"), GRID, grids)
    return result
