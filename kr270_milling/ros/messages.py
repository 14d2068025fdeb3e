"""The only place where records meet messages. Stamps are integer nanoseconds of the pass."""

from __future__ import annotations

import math
import zlib

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped, Transform, Twist, TwistStamped, Vector3, WrenchStamped
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

from kr270_milling.base.errors import MillingError
from kr270_milling.messages.trajectory import read_trajectory
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = [
    "JOINT_NAMES", "MessageError", "duration_from_bytes", "fingerprint", "joint_state_to_msg",
    "joint_trajectory_to_msg", "ns_from_stamp", "pose_from_msg", "pose_to_msg", "stamp_from_ns", "trajectory_from_msg",
    "trajectory_to_msg", "twist_to_msg", "workpiece_to_msg", "wrench_from_msg", "wrench_to_msg",
]  # fmt: skip

JOINT_NAMES = [f"joint_a{i}" for i in range(1, 7)]
TOOL = "tool0"
WORKPIECE = "workpiece"
SECOND = 1_000_000_000


class MessageError(MillingError):
    """A message that cannot be used; it is reported and dropped."""


def stamp_from_ns(ns: int) -> Time:
    return Time(sec=ns // SECOND, nanosec=ns % SECOND)


def ns_from_stamp(stamp) -> int:
    """[ns], of a Time or a Duration."""
    return stamp.sec * SECOND + stamp.nanosec


def _expect(frame: str, allowed: tuple[str, ...], topic: str) -> None:
    if frame not in allowed:
        raise MessageError(f"{topic}: the frame is {frame!r}, but must be {' or '.join(allowed)}")


def _finite(values: np.ndarray, topic: str) -> np.ndarray:
    if not np.all(np.isfinite(values)):
        raise MessageError(f"{topic}: holds a value that is not finite")
    return values


def pose_to_msg(stamp_ns: int, position: np.ndarray, quaternion: np.ndarray) -> PoseStamped:
    """Pose of tool0 in the workpiece frame."""
    msg = PoseStamped()
    msg.header.stamp, msg.header.frame_id = stamp_from_ns(stamp_ns), WORKPIECE
    p, q = msg.pose.position, msg.pose.orientation
    p.x, p.y, p.z = map(float, position)
    q.x, q.y, q.z, q.w = map(float, quaternion)
    return msg


def pose_from_msg(msg: PoseStamped) -> tuple[int, np.ndarray, np.ndarray]:
    """Stamp [ns], position (3,) [m], quaternion (4,) x, y, z, w. Raises MessageError."""
    _expect(msg.header.frame_id, (WORKPIECE,), "tool_pose")
    p, q = msg.pose.position, msg.pose.orientation
    values = _finite(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]), "tool_pose")
    if abs(math.hypot(*values[3:]) - 1.0) > 1e-3:
        raise MessageError("tool_pose: the quaternion is not of length 1")
    return ns_from_stamp(msg.header.stamp), values[:3], values[3:]


def wrench_to_msg(stamp_ns: int, wrench: np.ndarray) -> WrenchStamped:
    """Force and moment on the tool at the tool tip, in workpiece axes."""
    msg = WrenchStamped()
    msg.header.stamp, msg.header.frame_id = stamp_from_ns(stamp_ns), WORKPIECE
    f, m = msg.wrench.force, msg.wrench.torque
    f.x, f.y, f.z, m.x, m.y, m.z = map(float, wrench)
    return msg


def wrench_from_msg(msg: WrenchStamped, rotation_tool_to_workpiece: np.ndarray | None = None) -> tuple[int, np.ndarray]:
    """Stamp [ns] and wrench (6,) in workpiece axes; a force sensor may give it in tool0 axes. Raises MessageError."""
    frames = (WORKPIECE,) if rotation_tool_to_workpiece is None else (WORKPIECE, TOOL)
    _expect(msg.header.frame_id, frames, "wrench")
    f, m = msg.wrench.force, msg.wrench.torque
    wrench = _finite(np.array([f.x, f.y, f.z, m.x, m.y, m.z]), "wrench")
    if msg.header.frame_id == TOOL:
        wrench = np.concatenate([rotation_tool_to_workpiece @ wrench[:3], rotation_tool_to_workpiece @ wrench[3:]])
    return ns_from_stamp(msg.header.stamp), wrench


def twist_to_msg(stamp_ns: int, deflection: np.ndarray) -> TwistStamped:
    """Small displacement [m] and rotation [rad] of the tool tip, in workpiece axes."""
    msg = TwistStamped()
    msg.header.stamp, msg.header.frame_id = stamp_from_ns(stamp_ns), WORKPIECE
    v, w = msg.twist.linear, msg.twist.angular
    v.x, v.y, v.z, w.x, w.y, w.z = map(float, deflection)
    return msg


def joint_state_to_msg(stamp_ns: int, joints: np.ndarray) -> JointState:
    """Commanded joint positions (6,) [rad]."""
    msg = JointState(name=JOINT_NAMES, position=[float(v) for v in joints])
    msg.header.stamp = stamp_from_ns(stamp_ns)
    return msg


def trajectory_to_msg(trajectory: Trajectory) -> MultiDOFJointTrajectory:
    """Knots of tool0 in its frame; velocities only where the trajectory has them (then it is a cubic spline)."""
    msg = MultiDOFJointTrajectory(joint_names=[TOOL])
    msg.header.frame_id = trajectory.frame
    velocity = trajectory.velocity
    for i, ns in enumerate(trajectory.time_ns.tolist()):
        transform = Transform()
        t, r = transform.translation, transform.rotation
        t.x, t.y, t.z = trajectory.position[i].tolist()
        r.x, r.y, r.z, r.w = trajectory.quaternion[i].tolist()
        point = MultiDOFJointTrajectoryPoint(transforms=[transform])
        point.time_from_start = Duration(sec=ns // SECOND, nanosec=ns % SECOND)
        if velocity is not None:
            x, y, z = velocity[i].tolist()
            point.velocities = [Twist(linear=Vector3(x=x, y=y, z=z))]
        msg.points.append(point)
    return msg


def trajectory_from_msg(msg: MultiDOFJointTrajectory) -> Trajectory:
    """Raises MessageError, TrajectoryError."""
    _expect(msg.header.frame_id, (WORKPIECE,), "trajectory")
    if list(msg.joint_names) != [TOOL] or any(len(p.transforms) != 1 for p in msg.points):
        raise MessageError(f"trajectory: must hold one transform a point, of the joint {TOOL}")
    with_velocity = {len(p.velocities) for p in msg.points}
    if with_velocity not in ({0}, {1}):
        raise MessageError("trajectory: either every point has a velocity or none")
    translations = [p.transforms[0].translation for p in msg.points]
    rotations = [p.transforms[0].rotation for p in msg.points]
    velocity = None
    if with_velocity == {1}:
        velocity = np.array([[v.linear.x, v.linear.y, v.linear.z] for v in (p.velocities[0] for p in msg.points)])
    return Trajectory(
        np.array([ns_from_stamp(p.time_from_start) for p in msg.points], np.int64),
        np.array([[t.x, t.y, t.z] for t in translations]),
        np.array([[r.x, r.y, r.z, r.w] for r in rotations]),
        velocity,
        msg.header.frame_id,
    )


def duration_from_bytes(data: bytes) -> int:
    """[ns], of a serialised MultiDOFJointTrajectory. Raises MessageError."""
    try:
        return int(read_trajectory(bytes(data)).time[-1])
    except (ValueError, IndexError):
        raise MessageError("trajectory: cannot be read, or has no points") from None


def fingerprint(trajectory: Trajectory) -> str:
    """Tells whether two nodes mean the same trajectory: of times, positions and velocities, which messages keep."""
    velocity = b"" if trajectory.velocity is None else trajectory.velocity.tobytes()
    return f"{zlib.crc32(trajectory.time_ns.tobytes() + trajectory.position.tobytes() + velocity):08x}"


def joint_trajectory_to_msg(trajectory: Trajectory, joints: np.ndarray) -> JointTrajectory:
    """For a real controller: joint positions (n, 6) [rad] at the knots."""
    msg = JointTrajectory(joint_names=JOINT_NAMES)
    msg.header.frame_id = "base_link"
    for ns, q in zip(trajectory.time_ns.tolist(), joints.tolist(), strict=True):
        point = JointTrajectoryPoint(positions=q)
        point.time_from_start = Duration(sec=ns // SECOND, nanosec=ns % SECOND)
        msg.points.append(point)
    return msg


def workpiece_to_msg(stamp_ns: int, removed: np.ndarray, corner: np.ndarray, step: float) -> OccupancyGrid:
    """Share of the stock's height removed (nx, ny), 0..1, as a map: 100 is uncut, 0 cut through; corner (3,) [m]."""
    import array

    msg = OccupancyGrid()
    msg.header.stamp, msg.header.frame_id = stamp_from_ns(stamp_ns), WORKPIECE
    msg.info.resolution, (msg.info.width, msg.info.height) = float(step), removed.shape
    p = msg.info.origin.position
    p.x, p.y, p.z = map(float, corner)
    msg.data = array.array("b", np.ascontiguousarray(np.rint(100 * (1 - removed)).T.astype(np.int8)).tobytes())
    return msg
