"""Node: a simulated compliant robot follows ``reference_trajectory`` under the ``wrench`` of the cut."""

from __future__ import annotations

import time

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.robot.urdf import urdf
from kr270_milling.ros import messages, raw, topics
from kr270_milling.ros.node import ERROR, LOST, OK, WARN, ManagedNode, guarded
from kr270_milling.ros.parameters import declare_cell
from kr270_milling.ros.spin import run_node
from kr270_milling.simulation.sides import RobotSide

__all__ = ["CompliantRobot", "main"]

RETRY = 0.5  # [s] of the wall without an answer until the tool pose is published again
LOOK = 0.1  # [s] of the wall between two looks whether answers come
SETTLE = 0.5  # [s] of the wall without another listener before a pass starts: a recorder has to find the topics first


class CompliantRobot(ManagedNode):
    """Wrench in, tool pose and deflection out; the physics lives in ``simulation``."""

    def __init__(self, **kwargs):
        super().__init__("compliant_robot", **kwargs)
        self.cell = declare_cell(self)
        about = "seconds of the pass in a second of the wall; 0: as fast as possible"
        limits = [FloatingPointRange(from_value=0.0, to_value=1e6)]
        described = ParameterDescriptor(description=about, floating_point_range=limits, read_only=True)
        self.pace = self.declare_parameter("pace", 0.0, described).value
        self._reference = self._side = self._pace_timer = None
        self._given_up, self._asked, self._stale = False, 0, 0
        self._listeners, self._changed = (), time.monotonic()
        self._answered = self._looked = time.monotonic()
        self._pose = self.create_publisher(*topics.TOOL_POSE)
        self._deflection = self.create_publisher(*topics.DEFLECTION)
        self._joints = self.create_publisher(*topics.JOINT_STATES)
        self._clock_publisher = self.create_publisher(*topics.CLOCK)
        self._description = self.create_publisher(*topics.ROBOT_DESCRIPTION)
        reference, wrench = topics.REFERENCE_TRAJECTORY, topics.WRENCH
        self.create_subscription(reference.type, reference.name, self._on_reference, reference.qos)
        self._wrench = self.create_subscription(wrench.type, wrench.name, self._on_wrench, wrench.qos, raw=True)
        self.create_timer(LOOK, self._watch_answer)
        self.report(OK, "unconfigured")

    def configure(self) -> None:
        target = self.cell.target()
        side = RobotSide(self.cell.arm_model(target), self.cell.clock, target)
        side.answer(0, np.zeros(6))  # compile before the pass
        self._description.publish(String(data=urdf(self.cell.arm, self.cell.mount)))
        self._side = None
        self.report(OK, "configured")

    def activate(self) -> None:
        self._side = None
        self.report(OK, "waiting for a reference trajectory and a cutting process")

    def deactivate(self) -> None:
        self._side = None
        self.report(OK, "stopped")

    @guarded
    def _on_reference(self, msg) -> None:
        self._reference = messages.trajectory_from_msg(msg)
        self.tell(reference=messages.fingerprint(self._reference))

    @guarded
    def _watch_answer(self) -> None:
        """Start the pass when everybody is there; ask again, and give up, when no answer comes."""
        side, settled = self._side, self._is_settled()
        held_up, self._looked = time.monotonic() - self._looked, time.monotonic()
        if held_up > RETRY:
            self._answered = max(self._answered, self._looked)  # it was us who did not listen
        if not self.active or (side is not None and (side.done or self._given_up)):
            return
        cut = self._pose.get_subscription_count() and self._wrench.get_publisher_count()
        if side is None:
            if cut and settled and self._reference is not None:
                self._start()
            return
        silent = time.monotonic() - self._answered
        if not cut and not side.awaited_ns:
            self.activate()  # it went before the pass began
        elif side.awaited_ns and (not cut or silent > LOST):
            what = "no wrench: nobody publishes it any more" if not cut else f"no wrench for {LOST:g} s"
            self._given_up = True
            self.report(ERROR, f"{what}; the cutting process is gone and the pass is given up")
        elif silent > RETRY:
            self.report(
                WARN,
                "no wrench from the cutting process: asking again"
                if side.awaited_ns
                else "the cutting process is not active yet",
            )
            self._publish_pose()

    def _is_settled(self) -> bool:
        """Nobody has come or gone for a while."""
        listeners = tuple(p.get_subscription_count() for p in (self._pose, self._deflection, self._joints))
        if listeners != self._listeners:
            self._listeners, self._changed = listeners, time.monotonic()
        return time.monotonic() - self._changed >= SETTLE

    def _start(self) -> None:
        cell, reference = self.cell, self._reference
        self._side = side = RobotSide(cell.arm_model(reference), cell.clock, reference, cell.exchange.iterations)
        self._thinned = cell.thinned_steps()
        self._joint_course = cell.joints_at(side.course[:: self._thinned], side.orientation[:: self._thinned])
        self._step, self._given_up, self._asked, self._stale = 0, False, 0, 0
        self._started = time.monotonic()
        self.report(OK, "pass running")
        self._ask()

    @guarded
    def _on_wrench(self, data: bytes) -> None:
        side = self._side
        if not self.active or side is None or side.done or self._given_up:
            return
        stamp_ns, wrench = raw.wrench_from_bytes(data, lambda: rotation_from_quaternion(side.orientation_now))
        if stamp_ns != side.awaited_ns:
            return
        if self._stale:  # the second answer to a question that was asked twice
            self._stale -= 1
            return
        self._asked, self._stale = 0, self._asked - 1
        deflection = side.answer(stamp_ns, wrench)
        if stamp_ns == 0:
            self._started = time.monotonic()  # the cutting process may have come late
            self.report(OK, "pass running")
        if side.awaited_ns != stamp_ns:
            self._stale = 0
        if not side.done:
            self._ask()  # first, so that the cut works while the rest is published
        if deflection is not None:
            self._publish_state(stamp_ns, deflection)
        if side.done:
            self._finish(side)

    def _publish_state(self, stamp_ns: int, deflection: np.ndarray) -> None:
        self.stamp_ns = stamp_ns
        self._deflection.publish(raw.twist_to_bytes(stamp_ns, deflection))
        if self._step % self._thinned == 0:
            joints = self._joint_course[self._step // self._thinned]
            self._joints.publish(messages.joint_state_to_msg(stamp_ns, joints))
            self._clock_publisher.publish(Clock(clock=messages.stamp_from_ns(stamp_ns)))
        self._step += 1

    def _finish(self, side: RobotSide) -> None:
        wall = time.monotonic() - self._started
        feed = float(np.max(self._reference.feed(self._reference.time_ns)))
        feed_per_tooth = feed / (self.cell.tool.spindle_speed / (2 * np.pi) * self.cell.tool.teeth)
        large = side.correction > self.cell.exchange.warn_correction * feed_per_tooth
        told = {"largest_correction_um": f"{side.correction * 1e6:.6f}", "wall_s": repr(wall)}
        if large:
            self.report(WARN, "pass complete, but the corrections are large: shorten exchange.period_ms", **told)
        else:
            self.report(OK, "pass complete", **told)

    def _ask(self) -> None:
        """Publish the predicted pose, not ahead of the wall clock where a pace is asked for."""
        self._answered = time.monotonic()
        if self.pace > 0.0:
            ahead = self._started + self._side.awaited_ns * 1e-9 / self.pace - self._answered
            if ahead > 0.005:
                self._answered += ahead
                self._pace_timer = self.create_timer(ahead, self._ask_late)
                return
        self._publish_pose()

    @guarded
    def _ask_late(self) -> None:
        self.destroy_timer(self._pace_timer)
        if self._side is not None and not self._side.done:
            self._publish_pose()

    def _publish_pose(self) -> None:
        side = self._side
        self._asked += 1
        self._pose.publish(raw.pose_to_bytes(side.awaited_ns, side.tool, side.orientation_now))

    def watch(self) -> dict:
        return {"state": self._state_machine.current_state[1], "pass_time_s": f"{self.stamp_ns * 1e-9:.6f}"}


def main(args: list[str] | None = None) -> int:
    """Console script ``compliant_robot``."""
    return run_node(CompliantRobot, args)


if __name__ == "__main__":
    raise SystemExit(main())
