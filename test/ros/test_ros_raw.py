from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message, serialize_message

from kr270_milling.ros import messages, raw

STAMPS = st.integers(0, 2**31 * 10**9 - 1)
NUMBERS = st.floats(-1e100, 1e100)
SIX = st.lists(NUMBERS, min_size=6, max_size=6).map(np.array)
UNIT = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)
QUATERNIONS = UNIT.map(lambda q: np.array(q) / np.linalg.norm(q))


def written(msg) -> bytes:
    """As rclpy writes it; the two bytes of padding behind the frame hold whatever lay in memory there."""
    data = bytearray(serialize_message(msg))
    data[26:28] = b"\0\0"
    return bytes(data)


@given(STAMPS, SIX)
def test_wrench_and_twist_have_the_bytes_that_rclpy_writes(stamp, values):
    wrench, twist = messages.wrench_to_msg(stamp, values), messages.twist_to_msg(stamp, values)
    assert raw.wrench_to_bytes(stamp, values) == written(wrench)
    assert raw.twist_to_bytes(stamp, values) == written(twist)


@given(STAMPS, SIX, QUATERNIONS)
def test_pose_has_the_bytes_that_rclpy_writes(stamp, values, quaternion):
    msg = messages.pose_to_msg(stamp, values[:3], quaternion)
    assert raw.pose_to_bytes(stamp, values[:3], quaternion) == written(msg)


@given(STAMPS, SIX, QUATERNIONS)
def test_what_is_read_from_bytes_is_what_rclpy_reads(stamp, values, quaternion):
    data = serialize_message(messages.pose_to_msg(stamp, values[:3], quaternion))
    found, expected = raw.pose_from_bytes(data), messages.pose_from_msg(deserialize_message(data, PoseStamped))
    assert found[0] == expected[0] == stamp
    assert np.array_equal(found[1], expected[1]) and np.array_equal(found[2], expected[2])
    stamp_ns, wrench = raw.wrench_from_bytes(serialize_message(messages.wrench_to_msg(stamp, values)))
    assert stamp_ns == stamp and np.array_equal(wrench, values)


def test_sensor_wrench_in_tool_axes_is_turned_into_workpiece_axes():
    msg = messages.wrench_to_msg(5, np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    msg.header.frame_id = "tool0"
    _, wrench = raw.wrench_from_bytes(serialize_message(msg), lambda: np.diag([1.0, -1.0, -1.0]))
    assert np.array_equal(wrench, [1.0, -2.0, -3.0, 4.0, -5.0, -6.0])


@pytest.mark.parametrize("frame", ["base_link", "", "workpiece2", "Workpiece", "tool0"])
def test_wrong_frame_of_a_pose_is_refused(frame):
    msg = messages.pose_to_msg(0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    msg.header.frame_id = frame
    with pytest.raises(messages.MessageError, match="frame"):
        raw.pose_from_bytes(serialize_message(msg))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(6))
def test_value_that_is_not_finite_is_refused(bad, place):
    values = np.ones(6)
    values[place] = bad
    with pytest.raises(messages.MessageError, match="not finite"):
        raw.wrench_from_bytes(raw.wrench_to_bytes(0, values))
    with pytest.raises(messages.MessageError):
        raw.pose_from_bytes(raw.pose_to_bytes(0, values[:3], np.append(values[3:], 0.0)))


def test_quaternion_of_another_length_is_refused():
    with pytest.raises(messages.MessageError, match="length 1"):
        raw.pose_from_bytes(raw.pose_to_bytes(0, np.zeros(3), np.array([0.5, 0.5, 0.5, 0.6])))


def test_large_finite_values_pass_though_their_sum_overflows():
    values = np.full(6, 1.7e308)
    assert np.array_equal(raw.wrench_from_bytes(raw.wrench_to_bytes(3, values))[1], values)


@pytest.mark.parametrize("length", [0, 3, 12, 40, 75])
def test_truncated_message_is_refused_with_its_topic(length):
    data = raw.wrench_to_bytes(0, np.zeros(6))[:length]
    with pytest.raises(messages.MessageError, match="wrench"):
        raw.wrench_from_bytes(data)
