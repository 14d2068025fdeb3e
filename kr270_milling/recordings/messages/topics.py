"""The table of topics. QoS, publishers, readiness, replay, viewers and the page of the nodes are derived from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from kr270_milling.base.samples import (
    ClockSample,
    CompensatorState,
    JointProgram,
    JointSample,
    PoseSample,
    StockMap,
    Text,
    TwistSample,
    WrenchSample,
)
from kr270_milling.path.trajectory import Trajectory

ROBOT, CUT, COMPENSATOR, RECORDER = "compliant_robot", "cutting_process", "trajectory_compensator", "recorder"


@dataclass(frozen=True)
class Topic:
    """A row of the table."""

    name: str  #: relative, except for /diagnostics
    type: str  #: type of the message
    record: Callable | None  #: class of the record that the message carries; None: no record
    publisher: str  #: node, or the command rsi in its recording; empty: the user, or every node
    subscribers: tuple[str, ...] = ()  #: nodes that use the message
    latched: bool = False  #: late subscribers receive the last message
    stamped: bool = False  #: the message has the time of the pass
    scene: bool = False  #: input of the scene for viewers
    note: str = ""  #: for the page of the nodes

    @property
    def key(self) -> str:
        """The name without slash."""
        return self.name.strip("/")


#: in the order of causes: of two differences at one time, a recompute names the one whose topic comes first
TOPICS = (
    Topic("target_trajectory", "trajectory_msgs/msg/MultiDOFJointTrajectory", Trajectory, "", (COMPENSATOR,),
          latched=True, scene=True, note="default: the path of the cell file"),
    Topic("robot_description", "std_msgs/msg/String", Text, ROBOT, latched=True, scene=True, note="URDF"),
    Topic("tool_pose", "geometry_msgs/msg/PoseStamped", PoseSample, ROBOT, (CUT, COMPENSATOR), stamped=True,
          scene=True, note="every exchange"),
    Topic("wrench", "geometry_msgs/msg/WrenchStamped", WrenchSample, CUT, (ROBOT, COMPENSATOR), stamped=True,
          scene=True, note="every exchange; a force sensor may publish it"),
    Topic("deflection", "geometry_msgs/msg/TwistStamped", TwistSample, ROBOT, stamped=True,
          note="a small displacement [m] and rotation [rad], not a velocity; see `publish.every`"),
    Topic("joint_states", "sensor_msgs/msg/JointState", JointSample, ROBOT, (COMPENSATOR,), stamped=True, scene=True,
          note="see `publish.every`"),
    Topic("clock", "rosgraph_msgs/msg/Clock", ClockSample, ROBOT, stamped=True,
          note="with `publish.clock`: every 10 ms of the pass"),
    Topic("workpiece", "nav_msgs/msg/OccupancyGrid", StockMap, CUT, latched=True, stamped=True,
          note="thinned; at begin and end of a pass; service `~/publish_workpiece`"),
    Topic("compensator_state", "diagnostic_msgs/msg/DiagnosticStatus", CompensatorState, COMPENSATOR, latched=True,
          note="method, passes, and the recordings that the reference follows from"),
    Topic("reference_trajectory", "trajectory_msgs/msg/MultiDOFJointTrajectory", Trajectory, COMPENSATOR,
          (ROBOT, CUT), latched=True, scene=True),
    Topic("joint_trajectory", "trajectory_msgs/msg/JointTrajectory", JointProgram, COMPENSATOR,
          note="for a real controller; on request, service `~/send_joint_trajectory`"),
    Topic("target_path", "nav_msgs/msg/Path", None, COMPENSATOR, latched=True, note="for viewers"),
    Topic("reference_path", "nav_msgs/msg/Path", None, COMPENSATOR, latched=True, note="for viewers"),
    Topic("recording", "std_msgs/msg/String", Text, RECORDER, latched=True,
          note="file that is being written; empty: none"),
    Topic("correction", "geometry_msgs/msg/TwistStamped", TwistSample, "rsi", stamped=True,
          note="in recordings of the command `rsi`: displacement and rotation that the controller adds"),
    Topic("rsi_status", "std_msgs/msg/String", Text, "rsi", note="in recordings of the command `rsi`: one sentence"),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", None, "",
          note="level, message and values of each node, five times a second"),
)  # fmt: skip


def published_by(node: str) -> tuple[Topic, ...]:
    """Return the topics that a node publishes."""
    return tuple(topic for topic in TOPICS if topic.publisher == node)


def topic_table() -> str:
    """Return the table of the page of the nodes, in Markdown."""
    rows = ["| topic (relative) | type | from → to | latched | |", "|---|---|---|---|---|"]
    for topic in TOPICS:
        publisher = topic.publisher or ("every node" if topic.name[0] == "/" else "user")
        ends = f"{publisher} → {', '.join(topic.subscribers)}" if topic.subscribers else publisher
        kind = topic.type.replace("/msg/", "/")
        rows.append(f"| `{topic.name}` | {kind} | {ends} | {'yes' if topic.latched else ''} | {topic.note} |")
    return "\n".join(rows) + "\n"
