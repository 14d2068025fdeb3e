"""Recompute a recording: the models along the recorded inputs, and every output compared bit for bit.

Robot: simulated along the recorded wrenches. Cut: along the recorded poses. Compensator: revised from the recorded
passes. There is no ROS graph and no clock. Robots in several namespaces are recomputed one after the other.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from kr270_milling.base.column import column, computed
from kr270_milling.base.errors import RecordingError
from kr270_milling.base.frames import tool_axis
from kr270_milling.base.version import __version__
from kr270_milling.cell.models import arm_of, cut_of, path_of
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.replay.recorded import Cells, recorded_cells
from kr270_milling.exchange.replay.revisions import (
    NotRecorded,
    Revisions,
    array_difference,
    costs_messages,
    record_difference,
    robots_of,
    usable,
)
from kr270_milling.physics.motion.milling_pass import CompliantArm, silent_periods
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import findings
from kr270_milling.recordings.messages.topics import TOPICS
from kr270_milling.recordings.passes import GraphRecord, PassSeries, Series, read_graph

UNDER_WAY = 10  # exchange periods at the end of a pass that broke off, in which causes or effects may be missing
AXES = {  # fields of the columns of a topic
    "tool_pose": [f"pose.position.{a}" for a in "xyz"] + [f"pose.orientation.{a}" for a in "xyzw"],
    "wrench": [f"wrench.force.{a}" for a in "xyz"] + [f"wrench.torque.{a}" for a in "xyz"],
    "deflection": [f"twist.linear.{a}" for a in "xyz"] + [f"twist.angular.{a}" for a in "xyz"],
    "joint_states": [f"position[{k}]" for k in range(6)],
}


@dataclass(frozen=True)
class Difference:
    """The first message that is not what the models give."""

    topic: str
    index: int  #: place of the message among those of its topic that belong to a pass, from 0
    stamp_ns: int
    field: str
    recorded: object
    recomputed: object

    def __str__(self) -> str:
        return (
            f"{self.topic}, message {self.index} at {self.stamp_ns * 1e-9:.6f} s: {self.field} is {self.recorded!r} "
            f"in the recording and {self.recomputed!r} recomputed"
        )


@dataclass
class TopicCount:
    """Messages of one topic."""

    compared: int = 0
    differing: int = 0
    missing: int = 0  #: recomputed, but not in the recording
    not_compared: int = 0  #: recorded, but their cause is not in the recording


@dataclass(frozen=True, eq=False)
class Recomputed:
    """The verdict of a recompute.

    "different": one message at least has other bits; "damaged": a checksum or a count of the file does not fit;
    "incomplete": a model could not continue, or messages were not compared; else "identical".
    """

    file: str = column("file")
    cut_off: bool = column("cut_off")
    channels: dict[str, TopicCount] = column("channels")  #: full name of a topic -> its counts
    first: Difference | None = column("first_difference")
    stops: tuple[dict, ...] = column("stopped")  #: robot, stamp_ns if a time belongs to the reason, reason
    version: str = column("recorded_version")  #: version of the package that wrote the recording
    damage: tuple[str, ...] = column("damage")

    @computed("compared")
    def compared(self) -> int:
        return sum(count.compared for count in self.channels.values())

    @computed("version")
    def present_version(self) -> str:
        return __version__

    @computed("verdict")
    def verdict(self) -> str:
        if self.first is not None:
            return "different"
        if self.damage:
            return "damaged"
        return "incomplete" if self.stops else "identical"

    @property
    def sentences(self) -> list[str]:
        """Return a sentence for each reason why the recompute is not complete."""
        stamps = (stop["stamp_ns"] for stop in self.stops)
        places = ("" if ns is None else f"cannot continue at {ns * 1e-9:.6f} s: " for ns in stamps)
        return [f"{stop['robot']}: {at}{stop['reason']}" for stop, at in zip(self.stops, places, strict=True)]


def recompute(path, progress=None, remap: Mapping[str, str] = MappingProxyType({}), cell_file=None) -> Recomputed:
    """Recompute a recording; progress(passes done, of all).

    remap: see ``Recording``; cell_file: see ``recorded_cells``.
    Raises RecordingError and ConfigError where a recompute is not possible, as for a recording of another version.
    """
    with Recording(path, remap=remap) as recording:
        recorded = re.match(r"kr270_milling/(\d+\.\d+)\.", recording.library)
        if recorded and recorded[1] != ".".join(__version__.split(".")[:2]):
            version = recording.library.partition("/")[2]
            raise RecordingError(recording.path, f"recorded by {version}; recompute it with that version")
        cells = recorded_cells(recording, cell_file)
        with usable(recording):
            robots = [_Robot(recording, cells, namespace, progress) for namespace in robots_of(recording)]
        channels = {topic: count for robot in robots for topic, count in robot.counts.items()}
        firsts = [robot.first for robot in robots if robot.first]
        _, first = min(firsts, key=operator.itemgetter(0), default=(None, None))
        stops = tuple(stop for robot in robots for stop in robot.stops)
        version = recording.metadata().get("kr270_milling", {}).get("kr270_milling_version", "")
        damage = () if recording.cut_off else tuple(findings(recording))
        return Recomputed(str(recording.path), recording.cut_off, channels, first, stops, version, damage)


class _Robot:
    """The nodes of one namespace: counts, the first difference, and the reasons why something was not compared."""

    def __init__(self, recording: Recording, cells: Cells, namespace: str, progress):
        self.cell, self.plant = cells
        self.counts: dict[str, TopicCount] = {}
        self.first: tuple[tuple, Difference] | None = None  # its order by pass, time and cause
        self.stops: list[dict] = []
        self._namespace, self._cut_off = namespace, recording.cut_off
        graph = read_graph(recording, path_of(self.cell).clock, namespace, self.cell.joint_names, costs_messages)
        poses = recording.topics()[graph.topics["tool_pose"]].count if "tool_pose" in graph.topics else 0
        if poses > graph.refused.get("tool_pose", 0) and not graph.passes:
            reason = "its poses have the stamps of a driver, not of an exchange, and cannot be recomputed; report "
            raise RecordingError(recording.path, reason + "scores them")
        complete = 0
        for number, series in enumerate(graph.passes):
            complete += self._compare_pass(series, number, complete)
            if progress:
                progress(number + 1, len(graph.passes))
        outside = graph.outside.get("deflection", 0)  # only the robot publishes it
        if graph.passes and outside > (UNDER_WAY if self._cut_off else 0):
            self._count("deflection").not_compared += outside
            reason = f"{outside} messages on {namespace}/deflection were not compared: no recorded input leads to them"
            self._stop(None, reason)
        for name, lost in self._lost(graph).items():
            unreadable = min(graph.refused.get(name, 0), lost)  # others are foreign messages, which do no harm
            if graph.passes and unreadable > (UNDER_WAY if self._cut_off else 0):
                self._count(name).not_compared += unreadable
                self._stop(None, f"{unreadable} messages on {namespace}/{name} could not be read")
        self._compare_revisions(Revisions(cells, graph))
        if not any(self._count(name).compared for name in ("tool_pose", "wrench")) and not self.stops:
            self._stop(None, "no pass is in the recording: no tool_pose and no wrench was compared")

    def _lost(self, graph: GraphRecord) -> dict[str, int]:
        """Return how many messages of the nodes are not among those that were read, by topic."""
        states = len(graph.states) - len(graph.published)
        known = {topic.rpartition("/")[2]: count for topic, count in self.counts.items()}
        lost = {name: known[name].missing for name in ("deflection", "joint_states") if name in known}
        maps = len(graph.passes) - (known["workpiece"].compared if "workpiece" in known else 0)
        return lost | {"workpiece": maps, "compensator_state": -states, "reference_trajectory": states}

    def _count(self, name: str) -> TopicCount:
        return self.counts.setdefault(f"{self._namespace}/{name}", TopicCount())

    def _stop(self, stamp_ns: int | None, reason: str) -> None:
        self.stops.append(dict(robot=self._namespace or "/", stamp_ns=stamp_ns, reason=reason))

    def _judge(self, name: str, order: tuple[int, int], index: int, difference: tuple | None, count: int = 1) -> None:
        """Count a compared message and its difference; keep the first difference by pass, time and cause.

        difference: field and both values, of the first of ``count`` messages that differ; None: none differs.
        """
        counted = self._count(name)
        counted.compared += 1
        if difference is None:
            return
        counted.differing += count
        key = (*order, [topic.name for topic in TOPICS].index(name))  # in the order of causes
        if self.first is None or key < self.first[0]:
            self.first = key, Difference(f"{self._namespace}/{name}", index, order[1], *difference)

    # --- robot and cut ---

    def _compare_pass(self, series: PassSeries, number: int, complete: int) -> bool:
        """Compare one pass; return whether it ran to the end of its reference. complete: passes before that did."""
        clock = path_of(self.plant).clock
        last = clock.steps(series.reference.duration_ns)
        wrench, pose = series.topic("wrench").last(), series.topic("tool_pose").last()
        inputs = {"wrench": wrench.unbroken(), "tool pose": pose.unbroken()}
        if series.reason or not inputs["tool pose"]:
            self._stop(None, series.reason or "the recording begins in the middle of a pass, whose state is not known")
            for name, part in series.series.items():
                self._count(name).not_compared += part.step.size
            return False
        outputs = self._robot(series, wrench, inputs["wrench"], last, complete)
        outputs["wrench"] = self._cut(series, number, pose, inputs["tool pose"])
        whole = inputs["wrench"] > last
        allowed = 0 if whole and not self._cut_off else UNDER_WAY
        for name, expected in outputs.items():
            self._compare(name, series, number, expected)
        for cause, effects in (("wrench", ("tool_pose", "deflection")), ("tool pose", ("wrench",))):
            beyond = max((int(series.topic(name).step[-1]) for name in effects if name in series.series), default=0)
            if beyond - inputs[cause] >= allowed and inputs[cause] <= last:
                stamp = series.reference.start_ns + int(clock.stamp(inputs[cause]))
                self._stop(stamp, f"the {cause} of this time is not in the recording")
        for name in ("deflection", "joint_states"):  # a gap in the stamps does not show the end of a series
            every, there, topic = self._every(name), series.topic(name).step, f"{self._namespace}/{name}"
            end = max(min(len(outputs[name]), last + 1) - allowed, 0)
            due = (end - 1) // every - (int(there[-1]) // every if there.size else -1)
            if due > 0 and not self._cut_off and topic in self.counts:
                reason = f"{due} messages that belong on {topic} are not in the recording, and the stamps show no gap"
                self._stop(None, reason)
        return whole

    def _every(self, name: str) -> int:
        """Return the number of steps from one message that must be there to the next."""
        return self.cell.publish.steps(self.cell.exchange) if name in ("deflection", "joint_states") else 1

    def _robot(self, series: PassSeries, wrench: Series, count: int, last: int, complete: int) -> dict[str, np.ndarray]:
        """Return poses, deflections and joint positions along the recorded wrenches, by steps."""
        plant, reference = self.plant, series.reference
        planned = imperfect_course(plant, reference, complete)
        model = imperfect_arm(plant, reference)
        stamps = path_of(plant).clock.stamp(np.arange(last + 1))
        arm = CompliantArm(model, model.push(planned, stamps))
        guesses: dict[int, np.ndarray] = {}  # the wrench from which the last pose of an iterated exchange was predicted
        if self.cell.exchange.iterations > 1:
            before = series.topic("wrench").last(1)
            guesses = dict(zip(before.step.tolist(), before.values, strict=True))
        tool, deflection = planned.sample(stamps[: count + 1]), np.zeros((count, 6))
        for step in range(1, len(tool)):
            tool[step] += arm.predict(guesses.get(step))[:3]
            if step < count:
                deflection[step] = arm.correct(wrench.values[step])
        turn = planned.sample_orientation(stamps[: len(tool)])
        every = self._every("joint_states")
        joints = arm_of(plant).joints_along(reference, stamps[:count:every]) if count else np.zeros((0, 6))
        repeated = np.repeat(joints, every, axis=0)[:count]  # only the rows at multiples of ``every`` are compared
        return {"tool_pose": np.hstack([tool, turn]), "deflection": deflection, "joint_states": repeated}

    def _cut(self, series: PassSeries, number: int, pose: Series, count: int) -> np.ndarray:
        """Return the wrenches along the recorded poses, by steps; compare the map of the part at their end."""
        plant, path = self.plant, path_of(self.plant)
        steps = np.arange(count)
        stamps = path.clock.stamp(steps)
        protocol = CutProtocol(plant)
        protocol.cut = cut_of(plant)
        axes = tool_axis(pose.values[:count, 3:7]) if protocol.cut.tilts else None
        wrench, _, _ = protocol.cut.along(pose.values[:count, :3], steps * path.clock.micro_steps, axes=axes)
        if path.drills:
            wrench[silent_periods(path.drilling_at(stamps))] = 0.0
        protocol.stamp_ns = series.reference.start_ns + int(stamps[-1])
        expected = protocol.map_of_part()
        at_end = [index for index, recorded in enumerate(series.maps) if recorded.stamp == expected.stamp]
        if series.maps:  # the others are of the part before, or within the pass
            self._count("workpiece").not_compared += len(series.maps) - bool(at_end)
        for index in at_end[-1:]:
            cells = (stock_map.cells.T.ravel() for stock_map in (series.maps[index], expected))
            self._judge("workpiece", (number, expected.stamp), index, array_difference("data", *cells))
        return wrench

    def _compare(self, name: str, series: PassSeries, number: int, expected: np.ndarray) -> None:
        """Compare one topic of a pass with what the models give, (steps, columns)."""
        there, every = series.topic(name).last(), self._every(name)
        if not there.step.size:
            return
        used = there.step < len(expected)
        if name == "joint_states":
            used &= there.step % every == 0
        steps, values = there.step[used], np.ascontiguousarray(there.values[used])
        counted, rows = self._count(name), np.flatnonzero(used)
        before = counted.compared + counted.not_compared
        counted.compared += rows.size
        counted.not_compared += used.size - rows.size
        counted.missing += np.setdiff1d(np.arange(0, len(expected), every), there.step).size
        different = expected[steps].view(np.int64) != values.view(np.int64)
        if different.any():
            row, column = np.argwhere(different)[0].tolist()
            stamp = series.reference.start_ns + int(there.stamp_ns[rows[row]])
            fields = AXES[name][column], float(values[row, column]), float(expected[steps[row], column])
            counted.compared -= 1
            index, count = before + int(rows[row]), int(np.count_nonzero(different.any(axis=1)))
            self._judge(name, (number, stamp), index, fields, count)

    # --- compensator ---

    def _compare_revisions(self, revisions: Revisions) -> None:
        """Compare each state and reference of the compensator with those that the recorded passes lead to."""
        graph = revisions.graph
        published: dict[str, list] = {"compensator_state": graph.states, "reference_trajectory": graph.published}
        for index in range(max(map(len, published.values()))):
            names = [name for name, messages in published.items() if index < len(messages)]
            try:
                rebuilt = revisions.rebuild(index)
            except NotRecorded as error:
                if not error.elsewhere:
                    self._stop(None, str(error))
                for name in names:
                    self._count(name).not_compared += 1
                continue
            for name, expected in zip(published, rebuilt, strict=True):
                if name in names:
                    difference = record_difference(published[name][index], expected)
                    self._judge(name, revisions.order(index), index, difference)
                elif index < len(graph.states) - 1:  # a recorder may stop after the last state
                    self._count(name).missing += 1
