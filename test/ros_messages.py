"""Records as rclpy's message objects and back, for tests that speak to nodes."""

from __future__ import annotations

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.base.units import SECOND
from kr270_milling.live.ros.names import message_class
from kr270_milling.recordings.messages.codec import from_bytes, to_bytes, type_of

__all__ = ["from_msg", "ns_from_stamp", "pose_msg", "to_msg", "wrench_msg"]


def ns_from_stamp(stamp) -> int:
    """[ns], of a Time or a Duration."""
    return stamp.sec * SECOND + stamp.nanosec


def to_msg(record):
    """The message object that carries a record."""
    return deserialize_message(to_bytes(record), message_class(type_of(record)))


def from_msg(msg):
    """The record that a message object carries; of a MultiDOFJointTrajectory a Trajectory."""
    package = type(msg).__module__.partition(".msg")[0]
    return from_bytes(f"{package}/msg/{type(msg).__name__}", serialize_message(msg))


def pose_msg(stamp_ns: int, position, quaternion):
    return to_msg(PoseSample(int(stamp_ns), "workpiece", np.asarray(position, float), np.asarray(quaternion, float)))


def wrench_msg(stamp_ns: int, wrench):
    return to_msg(WrenchSample(int(stamp_ns), "workpiece", np.asarray(wrench, float)))
