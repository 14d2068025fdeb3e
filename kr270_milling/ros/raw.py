"""The messages of the exchange as bytes: what rclpy would write and read, in a tenth of the time.

They all have the frame "workpiece", so that every number stands at a fixed place: a header of 28 bytes, then doubles.
A message of any other layout is read by rclpy.
"""

from __future__ import annotations

import math
import struct

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.serialization import deserialize_message

from kr270_milling.ros import messages

__all__ = ["pose_from_bytes", "pose_to_bytes", "twist_to_bytes", "wrench_from_bytes", "wrench_to_bytes"]

SECOND = 1_000_000_000
FRAME = messages.WORKPIECE.encode() + b"\0"
LITTLE = b"\0\1\0\0"  # CDR, little-endian
HEAD = f"<4siII{len(FRAME)}s2x"
SIX, SEVEN = struct.Struct(HEAD + "6d"), struct.Struct(HEAD + "7d")


def _pack(layout: struct.Struct, stamp_ns: int, values) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    return layout.pack(LITTLE, seconds, nanoseconds, len(FRAME), FRAME, *values)


def pose_to_bytes(stamp_ns: int, position: np.ndarray, quaternion: np.ndarray) -> bytes:
    """As ``messages.pose_to_msg``."""
    return _pack(SEVEN, stamp_ns, position.tolist() + quaternion.tolist())


def wrench_to_bytes(stamp_ns: int, wrench: np.ndarray) -> bytes:
    """As ``messages.wrench_to_msg``."""
    return _pack(SIX, stamp_ns, wrench.tolist())


def twist_to_bytes(stamp_ns: int, deflection: np.ndarray) -> bytes:
    """As ``messages.twist_to_msg``."""
    return _pack(SIX, stamp_ns, deflection.tolist())


def _unpack(layout: struct.Struct, data: bytes) -> tuple[int, tuple] | None:
    """Stamp [ns] and the doubles; None where the message has another layout or a value that is not finite."""
    if len(data) != layout.size:
        return None
    order, seconds, nanoseconds, length, frame, *values = layout.unpack(data)
    if order[:2] != LITTLE[:2] or length != len(FRAME) or frame != FRAME or not math.isfinite(sum(values)):
        return None
    return seconds * SECOND + nanoseconds, values


def pose_from_bytes(data: bytes) -> tuple[int, np.ndarray, np.ndarray]:
    """As ``messages.pose_from_msg``. Raises MessageError."""
    found = _unpack(SEVEN, data)
    if found is None or abs(math.hypot(*found[1][3:]) - 1.0) > 1e-3:
        return messages.pose_from_msg(_slow(data, PoseStamped, "tool_pose"))
    values = np.array(found[1])
    return found[0], values[:3], values[3:]


def wrench_from_bytes(data: bytes, turn=None) -> tuple[int, np.ndarray]:
    """As ``messages.wrench_from_msg``; turn(): the rotation tool0 -> workpiece, for a wrench in tool0 axes."""
    found = _unpack(SIX, data)
    if found is not None:
        return found[0], np.array(found[1])
    msg = _slow(data, WrenchStamped, "wrench")
    in_tool = turn is not None and msg.header.frame_id == messages.TOOL
    return messages.wrench_from_msg(msg, turn() if in_tool else None)


def _slow(data: bytes, kind: type, topic: str):
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy raises its own RMWError, or others by the kind of damage
        raise messages.MessageError(f"{topic}: cannot be read as {kind.__name__}") from error
