"""The standard messages of the graph as bytes (CDR, version 1, little endian), as a node's publisher puts them out.

Made from numbers without any message object, so that a recording can be recomputed where no ROS is installed.
Stamps and times are whole nanoseconds; every value is in SI units.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

__all__ = [
    "Encoded", "clock_bytes", "joint_state_bytes", "joint_trajectory_bytes", "map_bytes", "pose_bytes",
    "string_bytes", "trajectory_bytes", "vectors_bytes",
]  # fmt: skip

SECOND = 1_000_000_000


class Encoded(NamedTuple):
    """One message; ``pads`` are the bytes between its fields, which a publisher leaves as its memory was."""

    data: bytes
    pads: tuple[slice, ...]

    def same(self, recorded: bytes) -> bool:
        """Whether every bit of every field is the same."""
        if recorded == self.data or len(recorded) != len(self.data):
            return recorded == self.data
        cleared = bytearray(recorded)
        for pad in self.pads:
            cleared[pad] = bytes(pad.stop - pad.start)
        return cleared == self.data


class Builder:
    """Appends fields; every number at a multiple of its size, counted from behind the first four bytes."""

    def __init__(self):
        self.data = bytearray(b"\0\1\0\0")
        self.pads: list[slice] = []

    def pack(self, code: str, *values) -> Builder:
        end = len(self.data)
        gap = -(end - 4) % struct.calcsize("<" + code[-1])
        if gap:
            self.pads.append(slice(end, end + gap))
            self.data += bytes(gap)
        self.data += struct.pack("<" + code, *values)
        return self

    def time(self, ns: int) -> Builder:
        return self.pack("i", ns // SECOND).pack("I", ns % SECOND)

    def string(self, text: str) -> Builder:
        coded = text.encode() + b"\0"
        self.pack("I", len(coded))
        self.data += coded
        return self

    def strings(self, texts) -> Builder:
        self.pack("I", len(texts))
        for text in texts:
            self.string(text)
        return self

    def header(self, stamp_ns: int, frame: str) -> Builder:
        return self.time(stamp_ns).string(frame)

    def doubles(self, values) -> Builder:
        values = np.asarray(values, float).ravel()
        return self.pack(f"{values.size}d", *values.tolist())

    def sequence(self, values) -> Builder:
        """A sequence of doubles; an empty one is only its length."""
        self.pack("I", len(values))
        return self.doubles(values) if len(values) else self

    def done(self) -> Encoded:
        return Encoded(bytes(self.data), tuple(self.pads))


def pose_bytes(stamp_ns: int, frame: str, position, quaternion) -> Encoded:
    """geometry_msgs/PoseStamped: position (3,) [m], quaternion (4,) x, y, z, w."""
    return Builder().header(stamp_ns, frame).doubles([*position, *quaternion]).done()


def vectors_bytes(stamp_ns: int, frame: str, values) -> Encoded:
    """geometry_msgs/WrenchStamped or TwistStamped: two vectors, (6,)."""
    return Builder().header(stamp_ns, frame).doubles(values).done()


def joint_state_bytes(stamp_ns: int, names, position) -> Encoded:
    """sensor_msgs/JointState with positions [rad] only."""
    message = Builder().header(stamp_ns, "").strings(names).sequence(position)
    return message.pack("I", 0).pack("I", 0).done()


def clock_bytes(stamp_ns: int) -> Encoded:
    """rosgraph_msgs/Clock."""
    return Builder().time(stamp_ns).done()


def string_bytes(text: str) -> Encoded:
    """std_msgs/String."""
    return Builder().string(text).done()


def trajectory_bytes(frame: str, name: str, time_ns, position, quaternion, velocity=None) -> Encoded:
    """trajectory_msgs/MultiDOFJointTrajectory of one body: times (n,) [ns], (n, 3), (n, 4), velocities (n, 3)."""
    message = Builder().header(0, frame).strings([name]).pack("I", len(time_ns))
    for i, ns in enumerate(np.asarray(time_ns).tolist()):
        message.pack("I", 1).doubles([*position[i], *quaternion[i]])
        if velocity is None:
            message.pack("I", 0)
        else:
            message.pack("I", 1).doubles([*velocity[i], 0.0, 0.0, 0.0])
        message.pack("I", 0).time(ns)  # no accelerations
    return message.done()


def joint_trajectory_bytes(frame: str, names, time_ns, joints) -> Encoded:
    """trajectory_msgs/JointTrajectory with positions (n, joints) [rad] only."""
    message = Builder().header(0, frame).strings(names).pack("I", len(time_ns))
    for ns, row in zip(np.asarray(time_ns).tolist(), np.asarray(joints), strict=True):
        message.sequence(row).pack("I", 0).pack("I", 0).pack("I", 0).time(ns)
    return message.done()


def map_bytes(stamp_ns: int, frame: str, resolution: float, corner, cells: np.ndarray) -> Encoded:
    """nav_msgs/OccupancyGrid: cells (width, height) int8, corner (3,) [m]; no map_load_time, not turned."""
    message = Builder().header(stamp_ns, frame).time(0).pack("f", resolution).pack("I", cells.shape[0])
    message.pack("I", cells.shape[1]).doubles([*corner, 0.0, 0.0, 0.0, 1.0]).pack("I", cells.size)
    message.data += np.ascontiguousarray(cells.T, np.int8).tobytes()
    return message.done()
