"""Bridge without a force sensor: the torques of the joints become ``wrench``.

python torque_bridge.py --ros-args -p cell_file:=CELL.yaml -r joint_states:=/DRIVER/joint_states

A driver publishes the torque of each joint in ``effort`` [N m], positive with the position; a KUKA controller sends it
by RSI as GearTorque. The bridge subtracts the weight of the arm, then the mean of the first second, in which the tool
is in the air. The result contains the friction of the joints: do not trust a small force, or a force at the reversal
of a joint. The result also contains the inertia of the arm, which is small in slow motions.
"""

import numpy as np
from rclpy.time import Time
from sensor_msgs.msg import JointState

from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import JointSample, WrenchSample
from kr270_milling.base.units import SECOND
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import OK, ReportingNode
from kr270_milling.live.ros.spin import run_node
from kr270_milling.physics.robot.kinematics import forward, jacobian_at
from kr270_milling.physics.robot.loads import link_loads, load_torque
from kr270_milling.recordings.messages.codec import to_bytes

TARE_NS = SECOND  # [ns] of the first messages, in which no force acts on the tool


class TorqueBridge(ReportingNode):
    """Receive ``joint_states`` with efforts, publish ``wrench`` in axes of base_link at the tool tip."""

    def __init__(self, **kwargs):
        super().__init__("torque_bridge", **kwargs)
        self.cell = self.declared_cell()
        self.loads = link_loads(self.cell.arm, self.cell.mount)
        self.first_ns, self.in_air = None, []
        self.wrench = self.create_publisher(*topics.WRENCH)
        take = lambda message: self.used("joint_states", self.on_joints, message)  # noqa: E731
        self.create_subscription(JointState, "joint_states", take, 1000)
        self.report(OK, "waiting for joint_states with efforts")

    def on_joints(self, message: JointState) -> None:
        if len(message.effort) != len(message.name):
            raise MessageError("joint_states: has no effort of each joint")
        stamp, names = Time.from_msg(message.header.stamp).nanoseconds, tuple(message.name)
        q, torque = (
            JointSample(stamp, names, values).of(self.cell.joint_names) for values in (message.position, message.effort)
        )
        frames = forward(self.cell.arm, self.cell.mount, q)
        residual = torque + load_torque(frames, np.zeros(6), self.loads)  # 0 without a force at the tool
        self.first_ns = stamp if self.first_ns is None else self.first_ns
        if stamp - self.first_ns < TARE_NS:
            self.in_air.append(residual)
            return
        self.report(OK, "publishing wrench")
        transposed = jacobian_at(frames, frames.tool.position).T
        wrench = np.linalg.solve(transposed, np.mean(self.in_air, axis=0) - residual)  # J^T w + g + torque = 0
        self.wrench.publish(to_bytes(WrenchSample(stamp, "base_link", wrench)))


if __name__ == "__main__":
    run_node(TorqueBridge)
