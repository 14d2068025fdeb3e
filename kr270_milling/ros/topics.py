"""The topics of the graph: name, message type, quality of service. Names are relative."""

from __future__ import annotations

from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

#: the loop of one exchange: lockstep, one message in flight; the publisher's history is so long that a recorder which
#: was stopped for two seconds can still request the messages that it missed
LOOP = QoSProfile(depth=20_000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
#: late subscribers receive the last message
LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class Topic(NamedTuple):
    """Unpacks into the arguments of ``create_publisher``."""

    type: type
    name: str
    qos: QoSProfile


TARGET_TRAJECTORY = Topic(MultiDOFJointTrajectory, "target_trajectory", LATCHED)
REFERENCE_TRAJECTORY = Topic(MultiDOFJointTrajectory, "reference_trajectory", LATCHED)
JOINT_TRAJECTORY = Topic(JointTrajectory, "joint_trajectory", LATCHED)
TARGET_PATH = Topic(Path, "target_path", LATCHED)
REFERENCE_PATH = Topic(Path, "reference_path", LATCHED)
TOOL_POSE = Topic(PoseStamped, "tool_pose", LOOP)
WRENCH = Topic(WrenchStamped, "wrench", LOOP)
DEFLECTION = Topic(TwistStamped, "deflection", LOOP)
JOINT_STATES = Topic(JointState, "joint_states", LOOP)
WORKPIECE = Topic(OccupancyGrid, "workpiece", LATCHED)
ROBOT_DESCRIPTION = Topic(String, "robot_description", LATCHED)
DIAGNOSTICS = Topic(DiagnosticArray, "/diagnostics", LOOP)
CLOCK = Topic(Clock, "clock", LOOP)  # of the robot's namespace: two robots have two times

#: the topics of the protocols' outputs, by the names that these have for them
BY_NAME = {
    topic.name: topic
    for topic in (
        TOOL_POSE, WRENCH, DEFLECTION, JOINT_STATES, CLOCK, WORKPIECE, ROBOT_DESCRIPTION, REFERENCE_TRAJECTORY,
        JOINT_TRAJECTORY, TARGET_PATH, REFERENCE_PATH,
    )
}  # fmt: skip
