"""A recording recomputed: its inputs once more through the models, its outputs compared bit for bit.

No ROS graph and no clock: the messages come in the order of the file, and the same classes answer that answered in
the nodes. Several robots in their namespaces are recomputed side by side, with the cell of the recording.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling import __version__
from kr270_milling.bag.bagmeta import read_qos
from kr270_milling.bag.errors import RecordingError
from kr270_milling.bag.reader import Recording
from kr270_milling.cell.cell import Cell
from kr270_milling.messages import encode
from kr270_milling.messages.cdr import stamp_of
from kr270_milling.replay.compare import Channel, Difference
from kr270_milling.replay.compensator import CompensatorModel, Report, read_report
from kr270_milling.replay.complete import Stop, incomplete
from kr270_milling.replay.inputs import cell_of, in_file_order, sample
from kr270_milling.replay.models import CutModel, RobotModel
from kr270_milling.robot.urdf import urdf

__all__ = ["Recomputed", "Robot", "Robots", "Stop", "recompute"]

#: name -> type, in the order of causes
OUTPUTS = {
    "robot_description": "std_msgs/msg/String",
    "tool_pose": "geometry_msgs/msg/PoseStamped",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    "deflection": "geometry_msgs/msg/TwistStamped",
    "joint_states": "sensor_msgs/msg/JointState",
    "clock": "rosgraph_msgs/msg/Clock",
    "workpiece": "nav_msgs/msg/OccupancyGrid",
    "reference_trajectory": "trajectory_msgs/msg/MultiDOFJointTrajectory",
    "joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
}
TYPES = {**OUTPUTS, "target_trajectory": OUTPUTS["reference_trajectory"]}
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


@dataclass(frozen=True)
class Recomputed:
    """The verdict: "identical", "different", or "incomplete" where a model could not go on, or where not all was
    compared that should have been."""

    file: str
    cut_off: bool
    channels: dict[str, Channel]
    first: Difference | None
    stops: tuple[Stop, ...]
    version: str  #: of the package that wrote the recording

    @property
    def compared(self) -> int:
        return sum(c.compared for c in self.channels.values())

    @property
    def verdict(self) -> str:
        if self.first is not None:
            return "different"
        return "incomplete" if self.stops else "identical"

    def as_dict(self) -> dict:
        first = self.first
        return dict(
            file=self.file,
            verdict=self.verdict,
            cut_off=self.cut_off,
            compared=self.compared,
            channels={topic: c.as_dict() for topic, c in self.channels.items()},
            first_difference=first and dict(topic=first.topic, index=first.index, stamp_ns=first.stamp_ns,
                                            field=first.field, recorded=first.recorded, recomputed=first.recomputed),
            stopped=[dict(robot=s.robot or "/", stamp_ns=s.stamp_ns, reason=s.reason) for s in self.stops],
            recorded_version=self.version,
            version=__version__,
        )  # fmt: skip


class Robot:
    """Everything in one namespace."""

    def __init__(self, cell: Cell, namespace: str, channels: dict[str, Channel], first: bytes | None, opening):
        self.cell, self.namespace, self.channels = cell, namespace, channels
        self.stops: list[Stop] = []
        self.model = RobotModel(cell, channels, self._stop)
        self.cut = CutModel(cell, channels, self._stop)
        self.model.reference, self.references = first, 0
        self.compensator = None
        if first is not None:
            self.compensator = CompensatorModel(cell, channels, self._stop, opening)
            self.compensator.run(first)
        if "robot_description" in channels:
            channels["robot_description"].made(0, encode.string_bytes(urdf(cell.arm, cell.mount)))

    def _stop(self, stamp_ns: int, reason: str) -> None:
        self.stops.append(Stop(self.namespace, stamp_ns, reason))

    def hear(self, name: str, data: bytes) -> None:
        """The next message of one of the robot's topics, as an input and as an output."""
        if name in ("tool_pose", "wrench"):
            self._hear_exchange(name, data)
        elif name == "reference_trajectory":
            self.references += 1
            self.model.reference = data
            self.compensator.hear_reference(data, first=self.references == 1)
            return
        elif name == "target_trajectory":
            if self.compensator:
                self.compensator.hear_target(data)
            return
        elif name == "workpiece":
            self.cut.workpiece(stamp_of(data) or 0, data)
            return
        if name in self.channels:
            stamped = name not in ("robot_description", "joint_trajectory")
            self.channels[name].heard((stamp_of(data) or 0) if stamped else 0, data)

    def _hear_exchange(self, name: str, data: bytes) -> None:
        heard = sample(data, 7 if name == "tool_pose" else 6)
        models = (self.cut, self.compensator) if name == "tool_pose" else (self.model, self.compensator)
        for model in models:
            if model is not None:
                (model.pose if name == "tool_pose" else model.wrench)(heard)

    def finish(self) -> None:
        self.model.finish()
        self.cut.finish()
        for channel in self.channels.values():
            channel.finish()


class Robots:
    """The robots of a recording, fed with its messages."""

    def __init__(self, recording: Recording):
        self.recording, self.cell = recording, cell_of(recording)
        self._names = self._find_topics()
        namespaces = sorted({ns for ns, _ in self._names.values()})
        firsts, openings = self._first_references(), self._reports()
        self._openings = {ns: found[0] for ns, found in openings.items()}
        self.robots: dict[str, Robot] = {}
        for ns in namespaces:
            with self._usable(f"{ns}/reference_trajectory"):
                self.robots[ns] = Robot(self.cell, ns, self._channels(ns), firsts.get(ns), self._openings.get(ns))

    def _find_topics(self) -> dict[str, tuple[str, str]]:
        """Topic -> (namespace, name), of the topics that have the right name and type."""
        found = {}
        for topic, about in self.recording.topics().items():
            namespace, _, name = topic.rpartition("/")
            if TYPES.get(name) == about.type and about.encoding == "cdr" and about.count:
                found[topic] = namespace, name
        robots = {ns for ns, name in found.values() if name in ("tool_pose", "wrench", "reference_trajectory")}
        if not robots:
            raise RecordingError(self.recording.path, "holds no tool_pose, wrench or reference_trajectory to recompute")
        if len(robots) == 1 and (min(robots), "clock") not in found.values() and self._is_of_one_robot("/clock"):
            found.update({t: (min(robots), n) for t, (_, n) in found.items() if t == "/clock"})
        return {t: place for t, place in found.items() if place[0] in robots}

    def _is_of_one_robot(self, topic: str) -> bool:
        """Up to version 0.1.0 robots in namespaces shared one ``/clock``; its publishers stand in the recording."""
        about = self.recording.topics().get(topic)
        return about is not None and len(read_qos(about.metadata.get("offered_qos_profiles", ""))) < 2

    def _channels(self, namespace: str) -> dict[str, Channel]:
        ranks = list(OUTPUTS)
        return {
            name: Channel(topic, ranks.index(name), self.recording.decoder(topic))
            for topic, (ns, name) in self._names.items()
            if ns == namespace and name in OUTPUTS
        }

    def _first_references(self) -> dict[str, bytes]:
        """What was latched when the recording began; it may stand behind the first messages of the pass."""
        firsts: dict[str, bytes] = {}
        topics = {t: ns for t, (ns, name) in self._names.items() if name == "reference_trajectory"}
        for message in in_file_order(self.recording):
            if message.topic in topics:
                firsts.setdefault(topics[message.topic], message.data)
                if len(firsts) == len(topics):
                    break
        return firsts

    def _diagnostics(self) -> set[str]:
        topics = self.recording.topics().items()
        return {t for t, about in topics if t.endswith("/diagnostics") and about.type == DIAGNOSTICS}

    def _reports(self) -> dict[str, list[Report]]:
        found: dict[str, list[Report]] = {}
        for message, array in self.recording.decoded(self._diagnostics()):
            del message
            for namespace, report in _reports_in(array):
                found.setdefault(namespace, []).append(report)
        return found

    def feed(self, progress=None, hear: Callable[[Robot, str, bytes], None] = Robot.hear) -> None:
        """All messages in the order of the file; ``hear`` takes those of a robot."""
        diagnostics = {t: self.recording.decoder(t) for t in self._diagnostics()}
        for message in in_file_order(self.recording, progress):
            if message.topic in self._names:
                namespace, name = self._names[message.topic]
                with self._usable(message.topic):
                    hear(self.robots[namespace], name, message.data)
            elif message.topic in diagnostics:
                for namespace, report in _reports_in(diagnostics[message.topic](message.data)):
                    if namespace in self.robots and self.robots[namespace].compensator:
                        self.robots[namespace].compensator.report = report
        for namespace, robot in self.robots.items():
            with self._usable(f"{namespace}/wrench"):
                robot.finish()

    @contextlib.contextmanager
    def _usable(self, topic: str):
        """Bytes that are no message of their type, or one that no model can take."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # a force of 1e300 N is an input like any other
                yield
        except (ValueError, OverflowError) as error:
            what = f"a message on {topic} cannot be used: {' '.join(str(error).split())}"
            raise RecordingError(self.recording.path, what) from error


def _reports_in(array):
    for status in array.status:
        report = read_report({entry.key: entry.value for entry in status.values})
        if report is not None:
            yield status.name.rpartition("/")[0], report


def recompute(path, progress=None) -> Recomputed:
    """Recompute a recording; progress(messages done, of all). Raises RecordingError, ConfigError where that cannot
    be tried at all."""
    with Recording(path) as recording:
        robots = Robots(recording)
        robots.feed(progress)
        channels = {c.topic: c for robot in robots.robots.values() for c in robot.channels.values()}
        firsts = [c.first for c in channels.values() if c.first]
        stops = [stop for robot in robots.robots.values() for stop in robot.stops]
        for robot in robots.robots.values():
            stops += incomplete(robot, recording.cut_off)
        version = recording.metadata().get("kr270_milling", {}).get("kr270_milling_version", "")
        first = min(firsts, key=lambda d: d.order, default=None)
        return Recomputed(str(recording.path), recording.cut_off, channels, first, tuple(stops), version)
