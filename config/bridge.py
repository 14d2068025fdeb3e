"""Bridge of a real cell: joint positions of a driver become ``tool_pose``, a force sensor becomes ``wrench``.

python bridge.py --ros-args -p cell_file:=CELL.yaml -r joint_states:=/DRIVER/joint_states -r force:=/SENSOR/wrench

The stamps are those of the driver and of the sensor. Joint positions do not contain the deflection of the arm: where a
tracker measures the tool, let the tracker publish ``tool_pose`` and add ``-r tool_pose:=encoder_pose`` here.
"""

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import JointSample, PoseSample, WrenchSample
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import OK, ReportingNode
from kr270_milling.live.ros.spin import run_node
from kr270_milling.physics.robot import pose
from kr270_milling.recordings.messages.codec import to_bytes

SENSOR = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches every publisher


class Bridge(ReportingNode):
    """Receive ``joint_states`` and ``force``, publish ``tool_pose`` in the workpiece frame and ``wrench``."""

    def __init__(self, **kwargs):
        super().__init__("bridge", **kwargs)
        self.cell = self.declared_cell()
        self.base_in_workpiece = self.cell.workpiece.pose.inverse()
        self.tool_pose = self.create_publisher(*topics.TOOL_POSE)
        self.wrench = self.create_publisher(*topics.WRENCH)
        self.subscribe(topics.RosTopic(JointState, "joint_states", SENSOR), self.on_joints)
        self.subscribe(topics.RosTopic(WrenchStamped, "force", SENSOR), self.on_force)
        self.report(OK, "waiting for joint_states and force")

    def on_joints(self, state: JointSample) -> None:
        tip = self.base_in_workpiece @ pose(self.cell.arm, self.cell.mount, state.of(self.cell.joint_names))
        self.tool_pose.publish(to_bytes(PoseSample(state.stamp, WORKPIECE, tip.position, tip.quaternion)))

    def on_force(self, sample: WrenchSample) -> None:
        self.wrench.publish(to_bytes(sample._replace(frame=self.cell.sensor.frame or sample.frame)))


if __name__ == "__main__":
    run_node(Bridge)
