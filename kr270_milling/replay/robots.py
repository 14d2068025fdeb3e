"""The robots of a recording, each in its namespace with its cut and its compensator, fed with its messages."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.bag.bagmeta import read_qos
from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.cell.cell import Cell
from kr270_milling.messages.cdr import stamp_of
from kr270_milling.messages.codec import pose_from_bytes, trajectory_from_bytes, wrench_from_bytes
from kr270_milling.replay.attached import CELL, cell_of, is_first_version, plant_of
from kr270_milling.replay.compare import Channel
from kr270_milling.replay.feeds import CutFeed, RobotFeed
from kr270_milling.replay.revisions import CompensatorFeed, Report, read_report
from kr270_milling.simulation.protocol import checked_pose, checked_wrench

__all__ = ["Robot", "Robots", "Stop"]

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
WITH_STAMP = ("tool_pose", "wrench", "deflection", "joint_states", "clock", "workpiece")
#: what the nodes take, and how they read it; each raises MillingError
INPUTS: dict[str, Callable] = {
    "tool_pose": lambda data: checked_pose(pose_from_bytes(data)),
    "wrench": lambda data: checked_wrench(wrench_from_bytes(data)),
    "reference_trajectory": trajectory_from_bytes,
    "target_trajectory": trajectory_from_bytes,
}


@dataclass(frozen=True)
class Stop:
    """Where a protocol could not go on."""

    robot: str  #: namespace
    stamp_ns: int
    reason: str

    def __str__(self) -> str:
        return f"{self.robot or '/'}: cannot go on at {self.stamp_ns * 1e-9:.6f} s: {self.reason}"


class Robot:
    """Everything in one namespace; cells: the one that plans, and the one that cuts."""

    def __init__(self, cells: tuple[Cell, Cell], namespace: str, channels: dict[str, Channel], first, opening):
        self.cell, plant = cells
        self.namespace = namespace
        self.channels = channels
        self.stops: list[Stop] = []
        self.foreign = False  #: recorded by another version, whose picture of the arm for viewers may be another
        self.revises = True  #: False: this version does not know how, and takes the references as they are recorded
        self.robot = RobotFeed(plant, channels, self._stop)
        self.cut = CutFeed(plant, channels, self._stop)
        self.compensator: CompensatorFeed | None = None
        if first is not None:
            self.robot.reference(trajectory_from_bytes(first))
            self.compensator = CompensatorFeed(self.cell, plant, channels, self._stop, opening)
            self.compensator.begin(first)

    def _stop(self, stamp_ns: int, reason: str) -> None:
        self.stops.append(Stop(self.namespace, stamp_ns, reason))

    def hear(self, name: str, data: bytes) -> None:
        """The next message of one of the robot's topics, as an input and as an output."""
        stamp = (stamp_of(data) or 0) if name in WITH_STAMP else 0
        refused = name in INPUTS and not self._use(name, data)
        if name == "workpiece":
            self.cut.workpiece(stamp, data)
        elif name == "robot_description" and self.foreign:
            self.channels[name].take(data)
        elif name in self.channels and (refused or name != "reference_trajectory"):  # that one the compensator compares
            if name == "robot_description":
                self.robot.description()
            self.channels[name].recorded(stamp, data, refused)

    def _use(self, name: str, data: bytes) -> bool:
        """Whether the nodes can have used it; what they refused live is refused here, and all goes on."""
        try:
            record = INPUTS[name](data)
            if name == "tool_pose":
                if self.revises:
                    self._tell_compensator(name, record, data)
                self.cut.pose(record)
        except MillingError:
            return False
        if name == "wrench":
            self.robot.wrench(record)
        elif name == "reference_trajectory":
            self.robot.reference(record)
        if name != "tool_pose" and (self.revises or name != "wrench"):
            self._tell_compensator(name, record, data)
        return True

    def _tell_compensator(self, name: str, record, data: bytes) -> None:
        feed = self.compensator
        if feed is None:
            return
        if name == "reference_trajectory":
            feed.reference(data)
        elif name == "target_trajectory":
            feed.new_target(record)
        else:
            feed.sample(record)

    def hear_compensator(self, name: str, data: bytes) -> None:
        """The same for the compensator alone."""
        with contextlib.suppress(MillingError):
            if name in INPUTS:
                self._tell_compensator(name, INPUTS[name](data), data)

    def finish(self) -> None:
        """No more will come."""
        self.robot.finish()
        self.cut.finish()
        if self.compensator is not None:
            self.compensator.finish()
        for channel in self.channels.values():
            channel.finish()


class Robots:
    """The robots of a recording; ``feed`` gives them its messages.

    later: files of passes that came behind this one; any other recording beside it may be that of an earlier pass.
    """

    def __init__(self, recording: Recording, later: frozenset[Path] = frozenset()):
        self.recording = recording
        self.cell = cell_of(recording)
        cells = self.cell, plant_of(recording, self.cell)
        self._names = self._find_topics()
        self._diagnostics = {
            topic: recording.decoder(topic)
            for topic, about in recording.topics().items()
            if topic.endswith("/diagnostics") and about.type == DIAGNOSTICS
        }
        firsts, openings = self._look_ahead()
        self.robots: dict[str, Robot] = {}
        for namespace in sorted({namespace for namespace, _ in self._names.values()}):
            with self._usable(f"{namespace}/reference_trajectory"):
                channels = {
                    name: Channel(topic, list(OUTPUTS).index(name))
                    for topic, (ns, name) in self._names.items()
                    if ns == namespace and name in OUTPUTS
                }
                first = firsts.get(namespace)
                robot = Robot(cells, namespace, channels, first, openings.get(namespace))
                feed = robot.compensator
                if first is not None and feed is not None:
                    if feed.method == "learned" and is_first_version(recording):
                        robot.revises = False  # that version fitted a spline to the deviation of the last pass
                    elif feed.lacks_passes:
                        _look_back(recording, namespace, first, feed, later)
                robot.foreign = recording.library != f"kr270_milling/{__version__}"
                self.robots[namespace] = robot

    def _find_topics(self) -> dict[str, tuple[str, str]]:
        """Topic -> (namespace, name), of the topics that have the right name and type."""
        topics, found = self.recording.topics(), {}
        for topic, about in topics.items():
            namespace, _, name = topic.rpartition("/")
            if TYPES.get(name) == about.type and about.encoding == "cdr" and about.count:
                found[topic] = namespace, name
        robots = {ns for ns, name in found.values() if name in ("tool_pose", "wrench", "reference_trajectory")}
        if not robots:
            raise RecordingError(self.recording.path, "holds no tool_pose, wrench or reference_trajectory to recompute")
        # up to version 0.1.0 robots in namespaces shared one ``/clock``; its publishers stand in the recording
        shared = "/clock" in found and len(robots) == 1 and (min(robots), "clock") not in found.values()
        if shared and len(read_qos(topics["/clock"].metadata.get("offered_qos_profiles", ""))) < 2:
            found["/clock"] = min(robots), "clock"
        return {t: place for t, place in found.items() if place[0] in robots}

    def _look_ahead(self) -> tuple[dict[str, bytes], dict[str, Report]]:
        """By namespace, the first reference that the nodes can have taken, which was latched when the recording began
        and may stand behind the first messages of the pass, and the first report of the compensator."""
        firsts: dict[str, bytes] = {}
        openings: dict[str, Report] = {}
        references = {t: ns for t, (ns, name) in self._names.items() if name == "reference_trajectory"}
        for message in self.recording.messages({*references, *self._diagnostics}, as_written=True):
            if message.topic in references:
                if references[message.topic] not in firsts and _is_usable(message.data):
                    firsts[references[message.topic]] = message.data
            else:
                for namespace, report in self._reports(message):
                    openings.setdefault(namespace, report)
        return firsts, openings

    def _reports(self, message) -> Iterator[tuple[str, Report]]:
        """Namespace of a compensator and what it told, out of a message of diagnostics."""
        for status in self._diagnostics[message.topic](message.data).status:
            report = read_report({entry.key: entry.value for entry in status.values})
            if report is not None:
                yield status.name.rpartition("/")[0], report

    def feed(self, progress=None, hear: Callable[[Robot, str, bytes], None] = Robot.hear) -> None:
        """All messages in the order of the file; ``hear`` takes those of a robot."""
        count = self.recording.count
        for done, message in enumerate(self.recording.messages(as_written=True), 1):
            if progress and (done % 1000 == 0 or done == count):
                progress(done, count)
            if message.topic in self._names:
                namespace, name = self._names[message.topic]
                with self._usable(message.topic):
                    hear(self.robots[namespace], name, message.data)
            elif message.topic in self._diagnostics:
                for namespace, report in self._reports(message):
                    feed = self.robots[namespace].compensator if namespace in self.robots else None
                    if feed is not None:
                        feed.report = report
        for namespace, robot in self.robots.items():
            with self._usable(f"{namespace}/wrench"):
                robot.finish()

    @contextlib.contextmanager
    def _usable(self, topic: str):
        """A message that no simulation of this size can take."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # a force of 1e300 N is an input like any other
                yield
        except (ValueError, OverflowError) as error:
            what = f"a message on {topic} cannot be used: {' '.join(str(error).split())}"
            raise RecordingError(self.recording.path, what) from error


def _is_usable(reference: bytes) -> bool:
    """Whether the nodes can have taken a reference trajectory."""
    with contextlib.suppress(MillingError):
        trajectory_from_bytes(reference)
        return True
    return False


def _look_back(recording: Recording, namespace: str, run: bytes, feed: CompensatorFeed, later: frozenset[Path]) -> None:
    """Let the feed of a later pass begin with what the recordings of the passes before it show, if they lie beside it.

    First those that published the reference ``run``, each with those before it; then the pass along the target, from
    which another method may have been chosen.
    """
    folder, topic, later = recording.path.parent, f"{namespace}/reference_trajectory", later | {recording.path}
    files = sorted({*folder.glob("*.mcap"), *folder.parent.glob("*/*.mcap")} - later)
    for published in (True, False):
        for file in files:
            with contextlib.suppress(MillingError), Recording(file) as before:
                references = [message.data for message in before.messages({topic}, as_written=True)]
                if (run in references[1:]) is not published or before.attachment(CELL) != recording.attachment(CELL):
                    continue
                robots = Robots(before, later if published else later.union(files))
                robots.feed(None, Robot.hear_compensator)
                if feed.goes_on_from(robots.robots[namespace].compensator):
                    return
