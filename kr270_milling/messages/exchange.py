"""The messages that the nodes exchange, as bytes and as records: quick where one comes twice in every exchange.

Pose, wrench and deflection have the frame "workpiece", so that every number stands at a fixed place: a header of 28
bytes, then doubles. Messages of any other layout or type go the way of ``codec``.
"""

from __future__ import annotations

import struct

import numpy as np

from kr270_milling.base.samples import PoseSample, TwistSample, WrenchSample
from kr270_milling.base.units import SECOND
from kr270_milling.messages import codec
from kr270_milling.messages.trajectory import read_trajectory
from kr270_milling.simulation.admission import TOOL, WORKPIECE, MessageError
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["pose_from_bytes", "to_bytes", "trajectory_from_bytes", "wrench_from_bytes"]

FRAME = WORKPIECE.encode() + b"\0"
LITTLE = b"\0\1\0\0"  # CDR, little-endian
HEAD = f"<4siII{len(FRAME)}s2x"
SIX = struct.Struct(HEAD + "6d")
SEVEN = struct.Struct(HEAD + "7d")


def to_bytes(record) -> bytes:
    """The message that carries a record, serialised."""
    kind = type(record)
    if kind is PoseSample and record.frame == WORKPIECE:
        return _pack(SEVEN, record.stamp, record.position.tolist() + record.quaternion.tolist())
    if kind is WrenchSample and record.frame == WORKPIECE:
        return _pack(SIX, record.stamp, record.wrench.tolist())
    if kind is TwistSample and record.frame == WORKPIECE:
        return _pack(SIX, record.stamp, record.twist.tolist())
    return codec.to_bytes(record)


def _pack(layout: struct.Struct, stamp_ns: int, values: list[float]) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    return layout.pack(LITTLE, seconds, nanoseconds, len(FRAME), FRAME, *values)


def _unpack(layout: struct.Struct, data: bytes) -> tuple | None:
    """Stamp [ns] and doubles; None where the message has another layout."""
    if len(data) != layout.size:
        return None
    order, seconds, nanoseconds, length, frame, *values = layout.unpack(data)
    if order != LITTLE or length != len(FRAME) or frame != FRAME:
        return None
    return seconds * SECOND + nanoseconds, np.array(values)


def pose_from_bytes(data: bytes) -> PoseSample:
    """Of a geometry_msgs/PoseStamped; raises MessageError."""
    found = _unpack(SEVEN, data)
    if found is None:
        return _slow(PoseSample, data, "tool_pose")
    return PoseSample(found[0], WORKPIECE, found[1][:3], found[1][3:])


def wrench_from_bytes(data: bytes) -> WrenchSample:
    """Of a geometry_msgs/WrenchStamped; raises MessageError."""
    found = _unpack(SIX, data)
    if found is None:
        return _slow(WrenchSample, data, "wrench")
    return WrenchSample(found[0], WORKPIECE, found[1])


def _slow(kind: type, data: bytes, topic: str):
    type_name = codec.type_of(kind)
    try:
        return codec.from_bytes(type_name, data)
    except ValueError:
        raise MessageError(f"{topic}: cannot be read as {type_name.rpartition('/')[2]}") from None


def trajectory_from_bytes(data: bytes, as_sent: bool = False) -> Trajectory:
    """Of a trajectory_msgs/MultiDOFJointTrajectory of the tool; raises MessageError, TrajectoryError.

    as_sent: as its publisher had it. Its quaternions were of length 1 already, and to divide them by their length
    once more could change a last bit.
    """
    try:
        found = read_trajectory(bytes(data))
    except ValueError:
        raise MessageError("trajectory: cannot be read as MultiDOFJointTrajectory") from None
    if found.frame_id != WORKPIECE:
        raise MessageError(f"trajectory: the frame is {found.frame_id!r}, but must be {WORKPIECE}")
    if found.names != (TOOL,):
        raise MessageError(f"trajectory: must hold one transform a point, of the joint {TOOL}")
    velocity = found.velocity[:, 0, :3]
    none = np.isnan(velocity).all()
    position, quaternion = found.position[:, 0], found.quaternion[:, 0]
    run = Trajectory(found.time, position, quaternion, None if none else velocity, found.frame_id)
    if as_sent:
        object.__setattr__(run, "quaternion", np.array(quaternion))
    return run
