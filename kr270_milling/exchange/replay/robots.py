"""The robots of a recording, each in its namespace with its cut and its compensator, fed with its messages."""

from __future__ import annotations

import bisect
import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell import Cell
from kr270_milling.exchange.compensator import end_of
from kr270_milling.exchange.replay.attached import attached_cell, attached_plant
from kr270_milling.exchange.replay.compare import Channel
from kr270_milling.exchange.replay.feeds import CutFeed, RobotFeed
from kr270_milling.exchange.replay.inputs import INPUTS, OUTPUTS, STAMPED, TYPES
from kr270_milling.exchange.replay.revisions import CompensatorFeed
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.bag.mcap_file import Damage
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.codec import trajectory_from_bytes

__all__ = ["Robot", "Robots", "Stop"]

EXCHANGE = ("tool_pose", "wrench", "deflection", "joint_states", "clock")  # stamped with the exchanges of a pass

NO_MESSAGE = 13  # [bytes] of the record with the checksum of the data


@dataclass(frozen=True)
class Stop:
    """A reason why a recompute is not complete."""

    robot: str  #: namespace
    stamp_ns: int | None  #: where a protocol could not continue; None: no time belongs to the reason
    reason: str

    def __str__(self) -> str:
        at = "" if self.stamp_ns is None else f"cannot continue at {self.stamp_ns * 1e-9:.6f} s: "
        return f"{self.robot or '/'}: {at}{self.reason}"


class Robot:
    """All nodes of one namespace; cells: the cell that plans, and the cell that cuts."""

    def __init__(
        self, recording: Recording, cells: tuple[Cell, Cell], namespace: str, channels: dict[str, Channel],
        ends: Mapping[int, int],
    ):  # fmt: skip
        self.cell, plant = cells
        starts = self._starts = sorted(ends)
        self._ends = ends  # start of a pass [ns] -> its last stamp
        self.namespace = namespace
        self.channels = channels
        self.stops: list[Stop] = []
        #: another version recorded it, whose picture of the arm for viewers may be another
        self.foreign = recording.library != f"kr270_milling/{__version__}"
        self.robot = RobotFeed(plant, channels, self._stop, starts)
        self.cut = CutFeed(plant, channels, self._stop, starts)
        self.compensator = CompensatorFeed(
            cells, channels, (recording.path, namespace, recording.remap), self._stop, starts
        )

    def _stop(self, stamp_ns: int | None, reason: str) -> None:
        stop = Stop(self.namespace, stamp_ns, reason)
        if stop not in self.stops:
            self.stops.append(stop)

    def feed(self, name: str, data: bytes) -> None:
        """Take the next message of a topic, as an input and as an output."""
        refused = self._is_foreign(name, data) or (name in INPUTS and not self._use(name, data))
        if name in ("reference_trajectory", "compensator_state"):
            self.feed_compensator(name, data)
            return
        stamp = (stamp_of(data) or 0) if name in STAMPED else 0
        if name == "workpiece":
            self.cut.workpiece(stamp, data)
        elif name == "robot_description" and self.foreign:
            self.channels[name].take(data)
        elif name in self.channels:
            if name == "robot_description":
                self.robot.description()
            self.channels[name].recorded(stamp, data, refused)

    def _is_foreign(self, name: str, data: bytes) -> bool:
        """Whether a message has no stamp of the exchange in any pass: no node uses it, as of another publisher."""
        if name not in EXCHANGE:
            return False
        stamp = stamp_of(data)
        passed = 0 if stamp is None else bisect.bisect_right(self._starts, stamp)
        if stamp is None or not passed:
            return stamp is None or bool(self._starts)
        start = self._starts[passed - 1]
        return stamp > self._ends[start] or self.cell.clock.step(stamp - start) < 0

    def _use(self, name: str, data: bytes) -> bool:
        """Return whether the nodes can have used a message; the recompute refuses what the live nodes refused."""
        try:
            record = INPUTS[name](data)
            if name in ("tool_pose", "wrench"):
                self.compensator.sample(record)
            if name == "tool_pose":
                self.cut.pose(record)
        except MillingError:
            return False
        if name == "wrench":
            self.robot.wrench(record)
        elif name == "reference_trajectory":
            self.reference(record)
        elif name == "target_trajectory":
            self.compensator.target(record)
        return True

    def reference(self, run: Trajectory) -> None:
        """Take the reference of the next pass of robot and cut."""
        self.robot.reference(run)
        self.cut.reference(run)

    def feed_compensator(self, name: str, data: bytes) -> None:
        """Take the next message for the compensator alone."""
        if self._is_foreign(name, data):
            return
        record = None
        with contextlib.suppress(MillingError):
            record = INPUTS[name](data) if name in INPUTS else None
        if name == "reference_trajectory":
            self.compensator.reference(data, record is not None)
        elif name == "compensator_state":
            self.compensator.state(data)
        elif name == "target_trajectory" and record is not None:
            self.compensator.target(record)
        elif record is not None:
            self.compensator.sample(record)

    def finish(self) -> None:
        """Complete the comparison after the last message."""
        self.robot.finish()
        self.cut.finish()
        self.compensator.finish()
        for channel in self.channels.values():
            channel.finish()


class Robots:
    """The robots of a recording; ``feed`` gives them its messages."""

    def __init__(self, recording: Recording):
        self.recording = recording
        self.cell = attached_cell(recording)
        cells = self.cell, attached_plant(recording, self.cell)
        self._names = self._find_topics()
        firsts, ends = self._read_references()
        self.robots: dict[str, Robot] = {}
        for namespace in sorted({namespace for namespace, _ in self._names.values()}):
            with self.usable(f"{namespace}/reference_trajectory"):
                times = ends.get(namespace, {})
                channels = {  # a map of the uncut part has the stamp 0 in every pass
                    name: Channel(topic, OUTPUTS.index(name), (0,) if name == "workpiece" else sorted(times))
                    for topic, (ns, name) in self._names.items()
                    if ns == namespace and name in OUTPUTS
                }
                robot = Robot(recording, cells, namespace, channels, times)
                if namespace in firsts:
                    robot.reference(trajectory_from_bytes(firsts[namespace]))
                self.robots[namespace] = robot

    def _find_topics(self) -> dict[str, tuple[str, str]]:
        """Return topic -> (namespace, name) of the topics that have the right name and type."""
        places = {}
        for topic, about in self.recording.topics().items():
            namespace, _, name = topic.rpartition("/")
            if TYPES.get(name) == about.type and about.encoding == "cdr" and about.count:
                places[topic] = namespace, name
        robots = {ns for ns, name in places.values() if name in ("tool_pose", "wrench", "reference_trajectory")}
        if not robots:
            raise RecordingError(self.recording.path, "holds no tool_pose, wrench or reference_trajectory to recompute")
        return {t: place for t, place in places.items() if place[0] in robots}

    def _read_references(self) -> tuple[dict[str, bytes], dict[str, dict[int, int]]]:
        """Return the first usable reference of each namespace, and the starts and ends [ns] of the passes.

        The first reference was latched when the recording began, and may be recorded after the first messages of the
        pass.
        """
        firsts: dict[str, bytes] = {}
        ends: dict[str, dict[int, int]] = {}
        references = {t: ns for t, (ns, name) in self._names.items() if name == "reference_trajectory"}
        longest = end_of(self.cell, self.cell.target())
        for message in self.recording.messages(set(references), _pass_over):
            with contextlib.suppress(MillingError):
                reference, namespace = trajectory_from_bytes(message.data), references[message.topic]
                firsts.setdefault(namespace, message.data)
                start = reference.start_ns
                ends.setdefault(namespace, {})[start] = start + max(longest, end_of(self.cell, reference))
        return firsts, ends

    def feed(self, progress=None, feed: Callable[[Robot, str, bytes], None] = Robot.feed) -> None:
        """Feed all messages in the order of the file; ``feed`` takes the messages of a robot."""
        count = self.recording.count
        for done, message in enumerate(self.recording.messages(on_damage=_pass_over), 1):
            if progress and (done % 1000 == 0 or done == count):
                progress(done, count)
            if message.topic in self._names:
                namespace, name = self._names[message.topic]
                with self.usable(message.topic):
                    feed(self.robots[namespace], name, message.data)

    def finish(self) -> None:
        """Complete the comparison after the last message."""
        for namespace, robot in self.robots.items():
            with self.usable(f"{namespace}/wrench"):
                robot.finish()

    @contextlib.contextmanager
    def usable(self, topic: str):
        """Raise RecordingError for a message whose values are too large for a simulation."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # a force of 1e300 N is a valid input
                yield
        except (ValueError, OverflowError) as error:
            reason = f"a message on {topic} cannot be used: {' '.join(str(error).split())}"
            raise RecordingError(self.recording.path, reason) from error


def _pass_over(damage: Damage, size: int) -> None:
    """Pass over a damage that costs no message; ``recompute`` reports it. Raises Damage."""
    if size > NO_MESSAGE:
        raise damage
