"""Node: the compensator publishes the reference trajectory, and after each pass the revised one (Fig. 9)."""

from __future__ import annotations

import copy
import time

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from std_srvs.srv import Trigger

from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.cell.jobs import commanded_joints, compensator, pass_record
from kr270_milling.compensation.compensator import Compensator, PassListener
from kr270_milling.compensation.parameters import METHODS
from kr270_milling.ros import messages, raw, topics
from kr270_milling.ros.drain import DRAIN_PERIOD, aside, drain
from kr270_milling.ros.node import ERROR, OK, SILENT, WARN, ReportingNode, Silence, guarded
from kr270_milling.ros.parameters import declare_cell
from kr270_milling.ros.spin import run_node

__all__ = ["TrajectoryCompensator", "main"]

METHOD = "compensation.method"
LOOK = 0.1  # [s] of the wall between two looks whether the publishers are there
UNHEARD = 20  # poses of a pass without its start after which this is told
LAST_WRENCH = 0.5  # [s] of the wall after the last pose that its wrench is waited for


class TrajectoryCompensator(ReportingNode):
    """Poses and wrenches of a pass in, revised trajectory out; the method lives in ``compensation``.

    It does not know whether they come from the simulator, a cell or a recording. They are kept as bytes during the
    pass and looked at when it is complete: when pose and wrench reach the end of the reference trajectory.
    """

    def __init__(self, **kwargs):
        super().__init__("trajectory_compensator", **kwargs)
        self.cell = declare_cell(self, writable=(METHOD,))
        about = "the cell file's path is the target until one is published"
        described = ParameterDescriptor(description=about, read_only=True)
        own = self.declare_parameter("use_cell_path", True, described).value
        self._reference = self.create_publisher(*topics.REFERENCE_TRAJECTORY)
        self._joints = self.create_publisher(*topics.JOINT_TRAJECTORY)
        target, pose, wrench = topics.TARGET_TRAJECTORY, topics.TOOL_POSE, topics.WRENCH
        self.create_subscription(target.type, target.name, self._on_target, target.qos)
        self._pose = aside(self, pose.type, pose.name, self._on_pose, pose.qos)
        self._wrench = aside(self, wrench.type, wrench.name, self._on_wrench, wrench.qos)
        self.create_service(Trigger, "reset", self._on_reset)
        self.compensator, self._revision = None, 0
        self._await_pass(0)
        self._silence, self._waiting = Silence(), False
        self.add_on_set_parameters_callback(self._on_parameters)
        self.create_timer(LOOK, self._watch_pass)
        self.create_timer(DRAIN_PERIOD, self._drain)
        if own:
            self._begin(self.cell.target())
        else:
            self.report(OK, "waiting for a target trajectory")

    @guarded
    def _on_target(self, msg) -> None:
        self._begin(messages.trajectory_from_msg(msg))

    def _begin(self, target) -> None:
        self._publish(compensator(self.cell, target), "the target itself")

    def _publish(self, made: Compensator, what: str, missing: int = 0) -> None:
        """Go on with ``made`` and its reference; whatever may refuse it comes before anything has changed."""
        reference, clock = made.reference, self.cell.clock
        joints = messages.joint_trajectory_to_msg(reference, commanded_joints(self.cell, reference))
        poses = messages.trajectory_to_msg(reference)
        end_ns = int(clock.stamp(clock.steps(reference.duration_ns)))
        self.compensator = made
        self._await_pass(end_ns)
        self._reference.publish(poses)
        self._joints.publish(joints)
        self._tell(what, missing)

    def _tell(self, what: str, missing: int) -> None:
        limited = self.compensator.cut_off
        self._revision += 1
        told = {
            "revision": self._revision,  # tells every published reference from the one before
            "method": self.compensator.method,
            "passes": len(self.compensator.errors),
            "remaining_error_um": " ".join(repr(float(e) * 1e6) for e in self.compensator.errors),
            "finished": self.compensator.finished,
            "reference": messages.fingerprint(self.compensator.reference),
        }
        if missing:
            self.report(WARN, f"reference: {what}, of which {missing} poses were not heard", **told)
        elif limited > 0.0:
            self.report(WARN, f"reference: {what}, shortened by up to {limited * 1e6:.1f} um to the limit", **told)
        else:
            self.report(OK, f"reference: {what}", **told)

    def _await_pass(self, end_ns: int) -> None:
        self._heard = PassListener(end_ns)
        self._start_over()

    def _start_over(self) -> None:
        """Nothing of this pass was heard yet; each exchange brings as many poses and wrenches as it has iterations."""
        self._wrenches: dict[int, np.ndarray] = {}  # stamp -> on the tool, workpiece axes
        self._last_poses = self._last_wrenches = self.cell.exchange.iterations
        self._ended = None  # when the last pose came [s of the wall]

    @guarded
    def _drain(self) -> None:
        for _, _, callback, data in drain((self._pose, self._wrench)):
            callback(data)

    @guarded
    def _on_wrench(self, data: bytes) -> None:
        if self.compensator is None or not self._heard.stamps:
            return
        stamp, wrench = raw.wrench_from_bytes(data, lambda: rotation_from_quaternion(self._heard.items[-1][1]))
        self._wrenches[stamp] = wrench
        if stamp >= self._heard.end_ns:
            self._last_wrenches -= 1
            self._revise_when_complete()

    @guarded
    def _on_pose(self, data: bytes) -> None:
        if self.compensator is None:
            return
        stamp, position, quaternion = raw.pose_from_bytes(data)
        heard = self._heard
        if stamp == 0 and heard.stamps != [0]:
            self._start_over()
        if heard.stamps and stamp == heard.stamps[-1]:
            heard.items[-1] = position, quaternion  # the exchange is iterated
        else:
            heard.hear(stamp, (position, quaternion))
        if not heard.stamps and 0 < stamp < heard.end_ns and heard.ignored == UNHEARD:
            self.report(ERROR, "the pass is under way, but this compensator has not heard its start: it is not used")
        if not heard.stamps or stamp != heard.stamps[-1]:
            return  # older than the last one, or the start was not heard
        self.stamp_ns = stamp
        self._silence.heard()
        if self._waiting:
            self._waiting = False
            self.report(OK, "the pass goes on")
        if stamp >= heard.end_ns:
            self._last_poses -= 1
            self._ended = time.monotonic()
            self._revise_when_complete()

    def _revise_when_complete(self, without_wrench: bool = False) -> None:
        complete = self._last_poses <= 0 and (without_wrench or self._last_wrenches <= 0)
        if complete:
            self._revise()

    @guarded
    def _watch_pass(self) -> None:
        """Go on without a last wrench that does not come; tell when the publishers vanish in mid-pass."""
        silent = self._silence.look()
        if self.compensator is None or not self._heard.stamps:
            return
        if self._ended is not None:
            if time.monotonic() - self._ended > LAST_WRENCH or not self._wrench.get_publisher_count():
                self._revise_when_complete(without_wrench=True)
            return
        for what in (self._pose, self._wrench):
            if not what.get_publisher_count() and (what is self._pose or self._wrenches):
                self.report(ERROR, f"the pass broke off: nobody publishes {what.topic_name} any more")
                return
        if silent > SILENT and not self._waiting:
            self._waiting = True
            self.report(WARN, f"no tool_pose for {SILENT:g} s in mid-pass: waiting for it")

    def _revise(self) -> None:
        stamps = np.array(self._heard.stamps)
        positions = np.array([position for position, _ in self._heard.items])
        ran = pass_record(self.cell, stamps, positions, self._wrench_series(stamps))
        self._await_pass(self._heard.end_ns)  # this one is over, also if nothing can be made of it
        made = _twin(self.compensator)
        made.revise(ran)
        self._publish(made, f"revised after pass {len(made.errors)}", _holes(stamps))

    def _wrench_series(self, stamps: np.ndarray) -> np.ndarray:
        """(n, 6) at the stamps of the poses, interpolated where a sensor has others; 0 where none was heard."""
        if not self._wrenches:
            return np.zeros((stamps.size, 6))
        times = np.array(sorted(self._wrenches))
        values = np.array([self._wrenches[stamp] for stamp in times.tolist()])
        return np.column_stack([np.interp(stamps, times, axis) for axis in values.T])

    def _on_parameters(self, changes) -> SetParametersResult:
        """Another method may be chosen while the node runs; it starts from the pass along the target."""
        for change in changes:
            if change.name == METHOD and change.value not in METHODS:
                return SetParametersResult(successful=False, reason=f"{METHOD} must be one of {', '.join(METHODS)}")
            if change.name == METHOD and self.compensator is not None and not self._change("choose", change.value):
                return SetParametersResult(successful=False, reason=self._message)
        return SetParametersResult(successful=True)

    @guarded
    def _change(self, how: str, *arguments: str) -> bool:
        """``choose`` another method or ``reset``; None where that is refused, which then is the node's message."""
        made = _twin(self.compensator)
        getattr(made, how)(*arguments)
        self._publish(made, f"method {made.method}" if how == "choose" else "the target itself")
        return True

    def _on_reset(self, _, response):
        if self.compensator is None:
            response.success, response.message = False, "no target trajectory yet"
            return response
        response.success = bool(self._change("reset"))
        response.message = "" if response.success else self._message
        return response


def _twin(made: Compensator) -> Compensator:
    """One to try something with, and to leave this as it is if that is refused."""
    twin = copy.copy(made)
    twin.errors = list(made.errors)
    return twin


def _holes(stamps: np.ndarray) -> int:
    """How many poses are missing in a pass, where they come at one period."""
    steps = np.diff(stamps) / np.median(np.diff(stamps))
    return int(np.sum(np.rint(steps) - 1)) if np.max(np.abs(steps - np.rint(steps))) < 0.25 else 0


def main(args: list[str] | None = None) -> int:
    """Console script ``trajectory_compensator``."""
    return run_node(TrajectoryCompensator, args, drained=True)


if __name__ == "__main__":
    raise SystemExit(main())
