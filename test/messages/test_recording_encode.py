"""The messages that are written without ROS, against the middleware's own serialiser."""

from __future__ import annotations

import numpy as np
import pass_recording as made
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from kr270_milling.messages import encode
from kr270_milling.ros import messages
from kr270_milling.trajectory.trajectory import Trajectory


def test_the_bytes_made_here_are_those_of_the_middlewares_serialiser():
    def same(message, encoded: encode.Encoded) -> bool:
        """The serialiser leaves rubbish between the fields and behind the last one."""
        kind, wire = type(message), serialize_message(message)
        whole = encode.Encoded(encoded.data, encoded.pads).same(wire[: len(encoded.data)])
        return whole and deserialize_message(encoded.data, kind) == deserialize_message(wire, kind)

    random = np.random.default_rng(7).normal(size=40)
    line = Trajectory.straight_line([0.0, 0.0, 0.1], [1.0, 0.0, 0.0], 0.01, 0.05, 0.05)
    curve = Trajectory.spline(np.arange(5) * 40_000_000, random[:15].reshape(5, 3))
    stamp, removed = 3_000_000_001, np.abs(np.sin(random[:28])).reshape(7, 4)
    cells = np.rint(100 * (1 - removed)).astype(np.int8)
    pairs = [
        (messages.pose_to_msg(stamp, random[:3], random[3:7]),
         encode.pose_bytes(stamp, "workpiece", random[:3], random[3:7])),
        (messages.wrench_to_msg(stamp, random[:6]), encode.vectors_bytes(stamp, "workpiece", random[:6])),
        (messages.twist_to_msg(stamp, random[:6]), encode.vectors_bytes(stamp, "workpiece", random[:6])),
        (messages.joint_state_to_msg(stamp, random[:6]), encode.joint_state_bytes(stamp, made.NAMES, random[:6])),
        (Clock(clock=messages.stamp_from_ns(stamp)), encode.clock_bytes(stamp)),
        (String(data="fräsen"), encode.string_bytes("fräsen")),
        (messages.joint_trajectory_to_msg(curve, random[:30].reshape(5, 6)),
         encode.joint_trajectory_bytes("base_link", made.NAMES, curve.time_ns, random[:30].reshape(5, 6))),
        (messages.workpiece_to_msg(stamp, removed, random[:3], 2e-4),
         encode.map_bytes(stamp, "workpiece", 2e-4, random[:3], cells)),
    ]  # fmt: skip
    for run in (line, curve):
        encoded = encode.trajectory_bytes(run.frame, "tool0", run.time_ns, run.position, run.quaternion, run.velocity)
        pairs.append((messages.trajectory_to_msg(run), encoded))
    assert [same(message, encoded) for message, encoded in pairs] == [True] * len(pairs)
    assert {PoseStamped, TwistStamped, OccupancyGrid} <= {type(message) for message, _ in pairs}
