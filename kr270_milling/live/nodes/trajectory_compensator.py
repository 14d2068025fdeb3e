"""Node: the compensator publishes the reference trajectory, and after each pass the revised one (Fig. 9)."""

from __future__ import annotations

import math
import time

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.qos import QoSProfile, ReliabilityPolicy

from kr270_milling.base.errors import MessageError, MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.samples import JointSample, PoseSample, Text, WrenchSample
from kr270_milling.base.units import SECOND
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.compensator import CompensatorProtocol
from kr270_milling.exchange.inbox import BREAK_NS
from kr270_milling.exchange.scene import path_bytes
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import ERROR, OK, SILENT, WARN, ReportingNode, Silence
from kr270_milling.live.ros.readiness import WAIT_FOR, Readiness
from kr270_milling.live.ros.topics import RosTopic, message_class, resolved_topic
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.methods import methods
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.topics import COMPENSATOR

METHOD = "compensation.method"
TARGET = "the target itself"
#: reliable and best-effort publishers match
SENSOR = QoSProfile(depth=topics.LOOP.depth, reliability=ReliabilityPolicy.BEST_EFFORT)


class TrajectoryCompensator(ReportingNode):
    """Receive poses and wrenches of a pass, publish the revised trajectory; ``CompensatorProtocol`` computes.

    Poses and wrenches come from the simulator, a robot cell or a recording.
    """

    def __init__(self, **kwargs):
        super().__init__("trajectory_compensator", **kwargs)
        cell = self.declared_cell()
        about = "how to compensate; a new method starts from the pass along the target"
        method = self.declared(METHOD, cell.compensation.method, about, read_only=False)
        self.cell = cell.replace(compensation=cell.compensation.replace(method=method))
        about = "parameter file of the simulated plant, whose tracker's noise is added to the poses; empty: none"
        plant = self.declared("plant", "", about)
        cuts = read_cell(find_file(plant)) if plant else None
        about = "topic of the robot whose message starts a pass, at the stamp of its header; empty: its motion"
        self._start_topic = self.declared("start_topic", "", about)
        about = "type of start_topic: a message with a header, or std_msgs/msg/Header"
        start_type = message_class(self.declared("start_type", "std_msgs/msg/Header", about))
        self.protocol = CompensatorProtocol(
            self.cell, cuts, self.get_fully_qualified_name(), self._now_ns, announced=bool(self._start_topic)
        )
        about = "the cell file's path is the target until one is published"
        own = self.declared("use_cell_path", True, about)
        self.set_values(recording="", reference="")
        self.open_outlets(COMPENSATOR)
        self.subscribe(topics.RECORDING, self._on_recording)
        self.subscribe(topics.TARGET_TRAJECTORY, self._on_target)
        self._pose = self.subscribe(topics.TOOL_POSE._replace(qos=topics.EVERY), self._on_pose)
        self._wrench = self.subscribe(topics.WRENCH._replace(qos=topics.EVERY), self._on_wrench)
        if self._start_topic:
            where = f"parameters of {self.get_fully_qualified_name()}: start_topic"
            start = resolved_topic(self, self._start_topic, where)
            self.subscribe(RosTopic(start_type, start, topics.LOOP), self._on_start, stamp_of)
        about = "nodes that a pass waits for, separated by commas; with ?: only where the node is in the graph"
        names = self.declared("wait_for", WAIT_FOR, about)
        self._readiness = Readiness(self, names, (self._pose.topic_name, self._wrench.topic_name))
        self.set_values(waiting_for=self._readiness.waiting_for)
        latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # only the last message counts
        self.subscribe(topics.JOINT_STATES._replace(qos=latest), self._on_joints)
        self.serve("~/reset", self._reset)
        self.serve("~/send_joint_trajectory", self._send_program)
        self._revision = 0
        self._joints: tuple[float, np.ndarray] | None = None  # arrival [s of the monotonic clock], positions [rad]
        self._ended: float | None = None  # arrival of the last pose [s of the monotonic clock]
        self._silence = Silence()
        self._report_time = 0.0  # time of the last report of a robot that waits [s of the monotonic clock]
        self.add_on_set_parameters_callback(self._on_parameters)
        self.create_timer(0.1, self._watch_pass)  # [s] of the wall clock
        if own:
            self._publish(self.protocol.begin(path_of(self.cell).target), TARGET)
        else:
            self.report(OK, "waiting for a target trajectory")

    @property
    def in_pass(self) -> bool:
        return self.protocol.under_way

    def _now_ns(self) -> int:
        return self.get_clock().now().nanoseconds

    def _on_target(self, target: Trajectory) -> None:
        try:
            outputs = self.protocol.begin(target)
        except MillingError as error:  # out of reach; the target before remains
            raise MessageError(f"target_trajectory: {error}") from None
        self._publish(outputs, TARGET)

    def _on_recording(self, name: Text) -> None:
        """Take the name of the file to which the next passes are recorded, DIRECTORY/NAME.mcap; empty: none."""
        self.protocol.recording = name.text
        self.set_values(recording=name.text)
        self._readiness.check()
        self.publish_report()

    def _publish(self, outputs, what: str, missing: int = 0) -> None:
        self.send(outputs)
        self._revision += 1
        state = self.protocol.active
        for name, run in (("reference_path", state.reference), ("target_path", state.target)):
            self.outlets[name].publish(path_bytes(run))
        values = {
            "revision": self._revision,  # number of the published reference
            "method": state.method,
            "repeats": state.repeats,
            "passes": len(state.errors),
            "remaining_error_um": [float(e) * 1e6 for e in state.errors],
            "finished": state.finished,
            "reference": f"{fingerprint(state.reference)} at {self.protocol.inbox.start_ns}",
        }
        but = f", shortened by up to {state.cut_off * 1e6:.1f} um to the limit" if state.cut_off > 0.0 else ""
        if missing:
            but = f", of which {missing} poses did not arrive"
        self.report(WARN if but else OK, f"reference: {what}{but}", **values)

    def _on_start(self, stamp: int | None) -> None:
        """Begin a pass at the stamp of the robot's own message."""
        if stamp is None:
            raise MessageError(f"{self._start_topic}: the message has no stamp (parameter start_type)")
        self._silence.end()
        self.protocol.start(stamp)

    def _on_wrench(self, sample: WrenchSample) -> None:
        self._revised(self.protocol.wrench(sample))

    def _on_pose(self, sample: PoseSample) -> None:
        outputs = self.protocol.pose(sample)
        inbox = self.protocol.inbox
        late = inbox.ignored == 20 and not inbox.started and inbox.distance is None
        if late and 0 < sample.stamp - inbox.start_ns < inbox.end_ns:
            self.report(
                ERROR, "the pass is under way, but this compensator did not receive its start: the pass is not used"
            )
        self._revised(outputs)
        if not self.protocol.under_way or sample.stamp - inbox.start_ns != inbox.stamp_ns:
            return
        if self._silence.end():
            self.report(OK, "the pass continues")
        self._ended = time.monotonic() if self.protocol.at_end else None

    def _revised(self, outputs) -> None:
        if outputs:
            self._publish(outputs, f"revised after pass {len(self.protocol.active.errors)}", self.protocol.missing)

    def _watch_pass(self) -> None:
        """Finish without a last wrench that does not arrive; report publishers that leave in mid-pass."""
        report_after = 0.8  # [s] of the wall clock, after which the node reports why the poses of a robot are no pass
        silent, inbox = self._silence.seconds(), self.protocol.inbox
        if inbox.problem:
            self.report(WARN, inbox.problem)
            inbox.problem = ""
        if not self.protocol.under_way:
            self._readiness.check()
            self._take_sensors()
            if inbox.distance is not None and time.monotonic() - self._report_time > report_after:
                self._report_time = time.monotonic()
                where = f"the tool is {inbox.distance * 1e3:.1f} mm from the first point of the reference"
                silent_start = f"no message on {self._start_topic}; " if self._start_topic else ""
                self.report(OK, f"waiting for the start of a pass: {silent_start}{where}")
            return
        if self.protocol.at_end:
            ended = time.monotonic() if self._ended is None else self._ended
            if time.monotonic() - ended > 0.5 or not self._wrench.get_publisher_count():  # [s]
                self.used(self._pose.topic_name, lambda: self._revised(self.protocol.finish()))
            return
        for what in (self._pose, self._wrench):
            if not what.get_publisher_count() and (what is self._pose or self.protocol.inbox.wrenches):
                self._publish(self.protocol.restart(), "restarted")
                self.report(ERROR, f"the pass broke off: {what.topic_name} has no publisher")
                return
        limit = report_after if inbox.foreign else SILENT
        if inbox.foreign and silent > BREAK_NS * 1e-9:
            inbox.break_off(f"no tool_pose for {BREAK_NS * 1e-9:g} s")
        elif self._silence.is_due(silent, limit):
            self.report(WARN, f"no tool_pose for {limit:g} s in mid-pass: waiting for it")

    def _take_sensors(self) -> None:
        """Subscribe with best effort where a tracker or a force sensor publishes so; this matches all publishers."""
        if self.incompatible(self._pose):
            self.destroy_subscription(self._pose)
            self._pose = self.subscribe(topics.TOOL_POSE._replace(qos=SENSOR), self._on_pose)
        if self.incompatible(self._wrench):
            self.destroy_subscription(self._wrench)
            self._wrench = self.subscribe(topics.WRENCH._replace(qos=SENSOR), self._on_wrench)

    def _on_parameters(self, changes) -> SetParametersResult:
        """Accept another method while the node runs; it starts from the pass along the target."""
        for change in changes:
            if change.name == METHOD and change.value not in methods():
                return SetParametersResult(successful=False, reason=f"{METHOD} must be one of {', '.join(methods())}")
            if change.name != METHOD or self.protocol.compensator is None:
                continue
            outputs = self.used(METHOD, self.protocol.choose, change.value)
            if outputs is None:
                return SetParametersResult(successful=False, reason=self.unusable[METHOD][1])
            self._publish(outputs, f"method {change.value}")
        return SetParametersResult(successful=True)

    def _reset(self) -> str:
        self._publish(self.protocol.reset(), TARGET)
        return TARGET

    def _on_joints(self, state: JointSample) -> None:
        """Take the positions by name; a gripper may publish its joints on the same topic."""
        self._joints = time.monotonic(), state.of(self.cell.joint_names)

    def _present_joints(self) -> np.ndarray:
        """Return the joint positions of the robot [rad], (6,); raises MessageError where these are unknown."""
        arrival, position = self._joints or (-math.inf, np.empty(0))
        age = time.monotonic() - arrival
        if age > 1.0:  # [s]
            _, reason, _ = self.unusable.get("joint_states", (0, "joint_states: no message was received", 0.0))
            last = f"joint_states: the last message of the robot is {age:.1f} s old" if self._joints else reason
            raise MessageError(f"{last}, so the position of the robot is not known")
        return position

    def _send_program(self) -> str:
        """Publish the reference for a joint controller; return what was published."""
        lead = 1.0  # [s] of the node's clock from the publication of a joint trajectory to its start
        if self._readiness.waiting_for:
            raise MessageError(f"the pass waits: {self._readiness.waiting_for}")
        start = self._now_ns() + int(lead * SECOND)
        program = self.protocol.program(self._present_joints(), start)
        self.send([("joint_trajectory", program)])
        return f"{len(program.time)} points, {program.time[-1] / SECOND:.3f} s, start in {lead:g} s"
