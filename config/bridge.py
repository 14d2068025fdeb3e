"""Bridge of a real cell: joint positions of a driver become ``tool_pose``, a force sensor becomes ``wrench``.

python bridge.py --ros-args --params-file CELL.yaml -r joint_states:=/DRIVER/joint_states -r force:=/SENSOR/wrench

The stamps are those of the driver and of the sensor. Joint positions do not contain the deflection of the arm: where a
tracker measures the tool, let the tracker publish ``tool_pose`` and add ``-r tool_pose:=encoder_pose`` here.
"""

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from kr270_milling.base.errors import MessageError
from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import PoseSample
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import OK, ReportingNode, guarded
from kr270_milling.live.ros.parameters import declare_cell
from kr270_milling.live.ros.spin import run_node
from kr270_milling.physics.robot import pose
from kr270_milling.recordings.messages.codec import to_bytes

SENSOR = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches every publisher


class Bridge(ReportingNode):
    """Receive ``joint_states`` and ``force``, publish ``tool_pose`` in the workpiece frame and ``wrench``."""

    def __init__(self, **kwargs):
        super().__init__("bridge", **kwargs)
        self.cell = declare_cell(self)
        self.base_in_workpiece = self.cell.workpiece.pose.inverse()
        self.tool_pose = self.create_publisher(*topics.TOOL_POSE)
        self.wrench = self.create_publisher(*topics.WRENCH)
        self.create_subscription(JointState, "joint_states", self.on_joints, SENSOR)
        self.create_subscription(WrenchStamped, "force", self.on_force, SENSOR)
        self.report(OK, "waiting for joint_states and force")

    @guarded
    def on_joints(self, msg: JointState) -> None:
        positions = dict(zip(msg.name, msg.position, strict=False))
        if missing := [name for name in self.cell.joint_names if name not in positions]:
            raise MessageError(f"joint_states: has no position of {', '.join(missing)} (key joint_names)")
        joints = [positions[name] for name in self.cell.joint_names]
        tip = self.base_in_workpiece @ pose(self.cell.arm, self.cell.mount, joints)
        stamp = msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec
        self.tool_pose.publish(to_bytes(PoseSample(stamp, WORKPIECE, tip.position, tip.quaternion)))

    @guarded
    def on_force(self, msg: WrenchStamped) -> None:
        msg.header.frame_id = self.cell.sensor.frame or msg.header.frame_id
        self.wrench.publish(msg)


if __name__ == "__main__":
    run_node(Bridge)
