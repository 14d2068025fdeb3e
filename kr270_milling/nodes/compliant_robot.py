"""Node: a simulated compliant robot follows ``reference_trajectory`` under the ``wrench`` of the cut."""

from __future__ import annotations

import time

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from kr270_milling.cell import Cell
from kr270_milling.frames import rotation_from_quaternion
from kr270_milling.robot.urdf import urdf
from kr270_milling.ros import messages, topics
from kr270_milling.ros.node import ERROR, OK, WARN, ManagedNode, guarded
from kr270_milling.ros.parameters import declare
from kr270_milling.ros.spin import run_node
from kr270_milling.simulation.sides import RobotSide

__all__ = ["CompliantRobot", "main"]

RETRY = 0.5  # [s] of the wall without an answer until the tool pose is published again
GIVE_UP = 2.0  # [s] of the wall without an answer until the pass is given up


class CompliantRobot(ManagedNode):
    """Wrench in, tool pose and deflection out; the physics lives in ``simulation``."""

    def __init__(self, **kwargs):
        super().__init__("compliant_robot", **kwargs)
        self.cell = declare(self, Cell)
        about = ParameterDescriptor(description="seconds of the pass a second of the wall; 0: as fast as possible")
        self.pace = self.declare_parameter("pace", 0.0, about).value
        self._reference, self._side, self._given_up = None, None, False
        self._pose = self.create_publisher(*topics.TOOL_POSE)
        self._deflection = self.create_publisher(*topics.DEFLECTION)
        self._joints = self.create_publisher(*topics.JOINT_STATES)
        self._clock_publisher = self.create_publisher(*topics.CLOCK)
        self._description = self.create_publisher(*topics.ROBOT_DESCRIPTION)
        self._listen(topics.REFERENCE_TRAJECTORY, self._on_reference)
        self._wrench = self._listen(topics.WRENCH, self._on_wrench)
        self.create_timer(0.1, self._watch_answer)
        self.report(OK, "unconfigured")

    def _listen(self, topic, callback):
        return self.create_subscription(topic.type, topic.name, callback, topic.qos)

    def configure(self) -> None:
        target = self.cell.target()
        RobotSide(self.cell.arm_model(target), self.cell.clock, target).answer(0, np.zeros(6))  # compile before the pass
        self._description.publish(String(data=urdf(self.cell.arm, self.cell.mount)))
        self._side = None
        self.report(OK, "configured")

    def activate(self) -> None:
        self._side, self._given_up = None, False
        self.report(OK, "waiting for a reference trajectory and a cutting process")

    def deactivate(self) -> None:
        self._side = None
        self.report(OK, "stopped")

    @guarded
    def _on_reference(self, msg) -> None:
        self._reference = messages.trajectory_from_msg(msg)

    @guarded
    def _watch_answer(self) -> None:
        """Start the pass when everybody is there; ask again, and give up, when no answer comes."""
        if not self.active or self._given_up:
            return
        if self._side is None:
            heard = self._pose.get_subscription_count() and self._wrench.get_publisher_count()
            if heard and self._reference is not None:
                self._start()
        elif not self._side.done:
            silent = time.monotonic() - self._answered
            if silent > GIVE_UP:
                self._given_up = True
                self.report(ERROR, f"no wrench for {GIVE_UP:g} s: the cutting process is gone; the pass is given up")
            elif silent > RETRY:
                self.report(WARN, "no wrench: asking again")
                self._publish_pose()

    def _start(self) -> None:
        model = self.cell.arm_model(self._reference)
        self._side = RobotSide(model, self.cell.clock, self._reference, self.cell.exchange.iterations)
        self._thinned = self.cell.thinned_steps()
        self._joint_course = self.cell.joints_at(
            self._side.course[:: self._thinned], self._side.orientation[:: self._thinned]
        )
        self._step, self._started = 0, time.monotonic()
        self.report(OK, "pass running")
        self._ask()

    @guarded
    def _on_wrench(self, msg) -> None:
        side = self._side
        if not self.active or side is None or side.done:
            return
        turn = rotation_from_quaternion(side.orientation_now) if msg.header.frame_id == messages.TOOL else None
        stamp_ns, wrench = messages.wrench_from_msg(msg, turn)
        repeated = stamp_ns != side.awaited_ns
        deflection = side.answer(stamp_ns, wrench)
        if repeated:
            return
        if deflection is not None:
            self.stamp_ns = stamp_ns
            self._deflection.publish(messages.twist_to_msg(stamp_ns, deflection))
            if self._step % self._thinned == 0:
                joints = self._joint_course[self._step // self._thinned]
                self._joints.publish(messages.joint_state_to_msg(stamp_ns, joints))
                self._clock_publisher.publish(Clock(clock=messages.stamp_from_ns(stamp_ns)))
            self._step += 1
        if side.done:
            self._finish(side)
        else:
            self._ask()

    def _finish(self, side: RobotSide) -> None:
        wall = time.monotonic() - self._started
        feed_per_tooth = self.cell.path.feed_rate / (self.cell.tool.spindle_speed / (2 * np.pi) * self.cell.tool.teeth)
        large = side.correction > self.cell.exchange.warn_correction * feed_per_tooth
        told = {"largest_correction_um": f"{side.correction * 1e6:.6f}", "wall_s": f"{wall:.6f}"}
        if large:
            self.report(WARN, "pass complete, but the corrections are large: shorten exchange.period_ms", **told)
        else:
            self.report(OK, "pass complete", **told)

    def _ask(self) -> None:
        """Publish the predicted pose, not ahead of the wall clock where a pace is asked for."""
        self._answered = time.monotonic()
        if self.pace > 0.0:
            ahead = self._started + self._side.awaited_ns * 1e-9 / self.pace - self._answered
            if ahead > 0.01:
                self._pace_timer = self.create_timer(ahead, self._ask_late)
                self._answered += ahead
                return
        self._publish_pose()

    @guarded
    def _ask_late(self) -> None:
        self.destroy_timer(self._pace_timer)
        if self._side is not None:
            self._publish_pose()

    def _publish_pose(self) -> None:
        side = self._side
        self._pose.publish(messages.pose_to_msg(side.awaited_ns, side.tool, side.orientation_now))

    def watch(self) -> dict:
        listened = (self._pose, self._deflection, self._joints, self._clock_publisher, self._description)
        return {
            "state": self._state_machine.current_state[1],
            "listeners": " ".join(f"{p.topic_name}={p.get_subscription_count()}" for p in listened),
            "pass_time_s": f"{self.stamp_ns * 1e-9:.6f}",
        }


def main(args: list[str] | None = None) -> int:
    """Console script ``compliant_robot``."""
    return run_node(CompliantRobot, args)


if __name__ == "__main__":
    raise SystemExit(main())
