"""The quick way of the exchange's messages against rclpy's own serialiser and against what must be refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import MultiDOFJointTrajectory

from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import CompensatorState, LearnedPass, PoseSample, TwistSample, WrenchSample
from kr270_milling.exchange.inputs import checked_pose, checked_wrench, in_workpiece_axes
from kr270_milling.path.trajectory import Trajectory, TrajectoryError
from kr270_milling.recordings.messages.codec import (
    from_bytes,
    pose_from_bytes,
    to_bytes,
    trajectory_from_bytes,
    wrench_from_bytes,
)

STAMPS = st.integers(0, 2**31 * 10**9 - 1)
NUMBERS = st.floats(-1e100, 1e100)
SIX = st.lists(NUMBERS, min_size=6, max_size=6).map(np.array)
UNIT = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)
QUATERNIONS = UNIT.map(lambda q: np.array(q) / np.linalg.norm(q))
DOWN = np.array([1.0, 0.0, 0.0, 0.0])


def written(data: bytes, kind: type) -> bytes:
    """As rclpy writes it; the two bytes of padding behind the frame hold whatever lay in memory there."""
    again = bytearray(serialize_message(deserialize_message(data, kind)))
    again[26:28] = b"\0\0"
    return bytes(again)


@settings(deadline=None)  # the type store is made at its first use
@given(STAMPS, SIX, QUATERNIONS)
def test_the_bytes_are_those_that_rclpy_writes_of_the_fields_that_it_reads(stamp, values, quaternion):
    pose = PoseSample(stamp, "workpiece", values[:3], quaternion)
    for sample, kind in (
        (pose, PoseStamped),
        (WrenchSample(stamp, "workpiece", values), WrenchStamped),
        (TwistSample(stamp, "workpiece", values), TwistStamped),
    ):
        assert to_bytes(sample) == written(to_bytes(sample), kind)
    read = deserialize_message(to_bytes(pose), PoseStamped)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == divmod(stamp, 10**9)
    assert (read.pose.position.z, read.pose.orientation.w) == (values[2], quaternion[3])


def test_sensor_wrench_in_tool_axes_is_turned_into_workpiece_axes():
    sample = wrench_from_bytes(to_bytes(WrenchSample(5, "tcp", np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))))
    head_over = np.array([1.0, 0.0, 0.0, 0.0])  # half a turn about x
    assert np.array_equal(in_workpiece_axes(sample, head_over), [1.0, -2.0, -3.0, 4.0, -5.0, -6.0])


@pytest.mark.parametrize("frame", ["base_link", "", "workpiece2", "Workpiece", "tcp"])
def test_wrong_frame_of_a_pose_is_refused(frame):
    with pytest.raises(MessageError, match="frame"):
        checked_pose(pose_from_bytes(to_bytes(PoseSample(0, frame, np.zeros(3), DOWN))))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(6))
def test_value_that_is_not_finite_is_refused(bad, place):
    values = np.ones(6)
    values[place] = bad
    with pytest.raises(MessageError, match="not finite"):
        checked_wrench(wrench_from_bytes(to_bytes(WrenchSample(0, "workpiece", values))))
    with pytest.raises(MessageError):
        checked_pose(pose_from_bytes(to_bytes(PoseSample(0, "workpiece", values[:3], np.append(values[3:], 0.0)))))


def test_quaternion_of_another_length_is_refused():
    with pytest.raises(MessageError, match="length 1"):
        checked_pose(PoseSample(0, "workpiece", np.zeros(3), np.array([0.5, 0.5, 0.5, 0.6])))


def test_large_finite_values_pass_though_their_sum_overflows():
    sample = WrenchSample(3, "workpiece", np.full(6, 1.7e308))
    assert checked_wrench(sample) is sample


@pytest.mark.parametrize("length", [0, 3, 12, 40, 75])
def test_truncated_message_is_refused_with_its_topic(length):
    data = to_bytes(WrenchSample(0, "workpiece", np.zeros(6)))[:length]
    with pytest.raises(MessageError, match="wrench"):
        wrench_from_bytes(data)


def test_trajectory_comes_back_and_one_of_something_else_is_refused():
    run = Trajectory([0, 10], [[0.0, 0, 0], [1e-3, 0, 0]], DOWN, [[0.1, 0, 0], [0.1, 0, 0]])
    again = trajectory_from_bytes(to_bytes(run))
    assert to_bytes(again) == to_bytes(run)
    data = to_bytes(run)
    old = deserialize_message(data, MultiDOFJointTrajectory)
    old.joint_names = ["tool0"]  # the tool tip before 0.3
    assert to_bytes(trajectory_from_bytes(serialize_message(old))) == data
    with pytest.raises(MessageError, match="frame"):
        trajectory_from_bytes(data.replace(b"workpiece", b"base_link"))
    with pytest.raises(MessageError, match="tcp"):
        trajectory_from_bytes(data.replace(b"tcp", b"tip"))
    with pytest.raises(MessageError, match="cannot be read"):
        trajectory_from_bytes(data[:70])
    bad = data.replace(np.float64(1e-3).tobytes(), np.float64(np.nan).tobytes())
    with pytest.raises(TrajectoryError):
        trajectory_from_bytes(bad)


def test_the_state_of_the_compensator_comes_back_and_rclpy_reads_it():
    learned = (LearnedPass("original/original.mcap", "ab" * 32, 121, 120), LearnedPass("", "cd" * 32, 3, 0))
    state = CompensatorState("/left/trajectory_compensator", "learned", 2, True, "01234567", "89abcdef", learned)
    data = to_bytes(state)
    again = from_bytes("diagnostic_msgs/msg/DiagnosticStatus", data)
    assert vars(again) == vars(state)
    read = deserialize_message(data, DiagnosticStatus)
    assert (read.level, read.name) == (DiagnosticStatus.OK, state.name)
    assert {pair.key: pair.value for pair in read.values}["learned_1.recording"] == "original/original.mcap"
    with pytest.raises(ValueError, match="state of a compensator"):
        from_bytes("diagnostic_msgs/msg/DiagnosticStatus", data.replace(b"finished", b"finishes"))
