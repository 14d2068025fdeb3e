"""Node: the compensator publishes the reference trajectory, and after each pass the revised one (Fig. 9)."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from kr270_milling.cell import Cell
from kr270_milling.compensation.compensator import PassListener
from kr270_milling.compensation.parameters import METHODS
from kr270_milling.compensation.revision import PassRecord
from kr270_milling.frames import rotation_from_quaternion
from kr270_milling.passes import commanded_joints, compensator
from kr270_milling.recording.cdr import stamp_of
from kr270_milling.ros import messages, topics
from kr270_milling.ros.node import OK, WARN, ReportingNode, guarded
from kr270_milling.ros.parameters import declare
from kr270_milling.ros.spin import run_node

__all__ = ["TrajectoryCompensator", "main"]


METHOD = "compensation.method"


class TrajectoryCompensator(ReportingNode):
    """Poses (and wrenches) of a pass in, revised trajectory out; the method lives in ``compensation``.

    It does not know whether they come from the simulator, a cell or a recording. They are kept as bytes during the
    pass and looked at when it is complete: when the tool's stamp reaches the end of the reference trajectory.
    """

    def __init__(self, **kwargs):
        super().__init__("trajectory_compensator", **kwargs)
        self.cell = declare(self, Cell, writable=(METHOD,))
        about = ParameterDescriptor(description="the cell file's path is the target until one is published")
        own = self.declare_parameter("use_cell_path", True, about).value
        self._reference = self.create_publisher(*topics.REFERENCE_TRAJECTORY)
        self._joints = self.create_publisher(*topics.JOINT_TRAJECTORY)
        target = topics.TARGET_TRAJECTORY
        self.create_subscription(target.type, target.name, self._on_target, target.qos)
        for topic, callback in ((topics.TOOL_POSE, self._on_pose), (topics.WRENCH, self._on_wrench)):
            self.create_subscription(topic.type, topic.name, callback, topic.qos, raw=True)
        self.create_service(Trigger, "reset", self._on_reset)
        self.compensator = None
        self.add_on_set_parameters_callback(self._on_parameters)
        if own:
            self._begin(self.cell.target())
        else:
            self.report(OK, "waiting for a target trajectory")

    @guarded
    def _on_target(self, msg) -> None:
        self._begin(messages.trajectory_from_msg(msg))

    def _begin(self, target) -> None:
        self.compensator = compensator(self.cell, target)
        self._publish("the target itself")

    def _publish(self, what: str) -> None:
        reference = self.compensator.reference
        joints = commanded_joints(self.cell, reference)  # out of reach is told before anything is published
        clock = self.cell.clock
        self._heard = PassListener(int(clock.stamp(clock.steps(reference.duration_ns))))
        self._wrenches: dict[int, bytes] = {}
        self._reference.publish(messages.trajectory_to_msg(reference))
        self._joints.publish(messages.joint_trajectory_to_msg(reference, joints))
        limited = self.compensator.cut_off
        told = {
            "method": self.compensator.method,
            "passes": len(self.compensator.errors),
            "remaining_error_um": " ".join(f"{e * 1e6:.4f}" for e in self.compensator.errors),
            "finished": self.compensator.finished,
        }
        if limited > 0.0:
            self.report(WARN, f"reference: {what}, shortened by up to {limited * 1e6:.1f} um to the limit", **told)
        else:
            self.report(OK, f"reference: {what}", **told)

    @guarded
    def _on_wrench(self, data: bytes) -> None:
        if self.compensator is not None and self.compensator.method == "mirror":
            self._wrenches[stamp_of(data)] = data

    @guarded
    def _on_pose(self, data: bytes) -> None:
        if self.compensator is None:
            return
        self.stamp_ns = stamp_of(data)
        if self._heard.hear(self.stamp_ns, data):
            self._revise()

    def _revise(self) -> None:
        heard = [messages.pose_from_msg(deserialize_message(d, PoseStamped)) for d in self._heard.items]
        stamps, positions, quaternions = (np.array(column) for column in zip(*heard, strict=True))
        wrench = self._wrench_series(stamps, quaternions) if self.compensator.method == "mirror" else None
        self.compensator.revise(PassRecord(stamps, positions, self.cell.scored_from_ns, wrench))
        self._publish(f"revised after pass {len(self.compensator.errors)}")

    def _wrench_series(self, stamps: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
        """(n, 6) at the stamps of the poses; 0 where none was heard."""
        series = np.zeros((stamps.size, 6))
        for i, stamp in enumerate(stamps.tolist()):
            if stamp in self._wrenches:
                turn = rotation_from_quaternion(quaternions[i])
                msg = deserialize_message(self._wrenches[stamp], WrenchStamped)
                series[i] = messages.wrench_from_msg(msg, turn)[1]
        return series

    def _on_parameters(self, changes) -> SetParametersResult:
        """Another method may be chosen while the node runs; it starts from the pass along the target."""
        for change in changes:
            if change.name == METHOD and change.value not in METHODS:
                return SetParametersResult(successful=False, reason=f"{METHOD} must be one of {', '.join(METHODS)}")
            if change.name == METHOD and self.compensator is not None:
                self._choose(change.value)
        return SetParametersResult(successful=True)

    @guarded
    def _choose(self, method: str) -> None:
        self.compensator.choose(method)
        self._publish(f"method {method}")

    def _on_reset(self, _, response):
        response.success = self.compensator is not None
        if response.success:
            self.compensator.reset()
            self._publish("the target itself")
        else:
            response.message = "no target trajectory yet"
        return response

    def watch(self) -> dict:
        return {"listeners": f"{self._reference.topic_name}={self._reference.get_subscription_count()}"}


def main(args: list[str] | None = None) -> int:
    """Console script ``trajectory_compensator``."""
    return run_node(TrajectoryCompensator, args)


if __name__ == "__main__":
    raise SystemExit(main())
