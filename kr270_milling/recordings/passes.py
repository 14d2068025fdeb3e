"""Passes of a recording: the messages along each reference, selected by stamps and never by log time."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import CompensatorState, JointSample, StockMap
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.recordings.bag.mcap_file import OnDamage
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import FIXED, layout_of, unpack_alike
from kr270_milling.recordings.messages.codec import from_bytes, trajectory_from_bytes, type_of
from kr270_milling.recordings.messages.topics import TOPICS


class TopicSeries(NamedTuple):
    """A topic of one of the FIXED types; the arrays are read-only."""

    stamp: np.ndarray  #: [ns], (n,) int64
    values: np.ndarray  #: SI units, (n, 7) position and quaternion x y z w, or (n, 6) translations before rotations
    unreadable: int = 0  #: messages that are not of its type, or not in the frame that is asked for


def series(recording: Recording, topic: str) -> TopicSeries:
    """Read a PoseStamped, WrenchStamped or TwistStamped topic as arrays. Raises RecordingError."""
    return several(recording, [topic])[0]


def several(
    recording: Recording,
    topics: Sequence[str],
    others: Mapping[str, Callable[[bytes], object]] = MappingProxyType({}),
    frame: str | None = None,
    on_damage: OnDamage | None = None,
) -> list[TopicSeries]:
    """Read topics of the FIXED types as arrays in one pass through the file.

    others: topic -> a function that receives each message of a further topic. A message that is not of the type of its
    topic, or not in ``frame`` if it is given, is left out. on_damage: see ``Recording.messages``. Raises RecordingError
    where no message of a topic can be read.
    """
    batches = {topic: _Batch(recording, topic, frame) for topic in topics}
    receivers = {**{topic: batch.add for topic, batch in batches.items()}, **others}
    known = recording.topics()
    fits = {n: recording.schema_of(c).name == known[c.topic].type for n, c in recording.channels.items()}
    for message in recording.messages(set(receivers), on_damage):
        if fits[message.channel]:
            receivers[message.topic](message.data)
        elif message.topic in batches:
            batches[message.topic].unreadable += 1
    return [batches[topic].series() for topic in topics]


class _Batch:
    """Collects a topic and unpacks consecutive messages of one layout together."""

    def __init__(self, recording: Recording, topic: str, frame: str | None = None):
        about = recording.topics().get(topic)
        if about is None:
            raise RecordingError(recording.path, f"has no topic {topic}")
        if about.encoding != "cdr" or about.type not in FIXED:
            reason = f"{topic} is {about.type or 'of no type'}, which is no series of numbers"
            raise RecordingError(recording.path, reason)
        self._path, self._topic, self._type, self._frame = recording.path, topic, about.type, frame
        self._width = len(FIXED[about.type])
        self._layout: tuple = ()
        self._refused: ValueError | None = None
        self.unreadable = 0
        self._waiting: list[bytes] = []
        self._stamps, self._values = [np.empty(0, np.int64)], [np.empty((0, self._width))]

    def add(self, data: bytes) -> None:
        if (layout := layout_of(data)) != self._layout or len(self._waiting) * len(data) > 1024 * 1024:  # a MB
            self._unpack()
            self._layout = layout
        self._waiting.append(data)

    def _unpack(self) -> None:
        if not self._waiting:
            return
        messages, self._waiting = self._waiting, []
        try:
            frame, stamps, values = unpack_alike(messages, self._width)
        except ValueError as error:  # of another publisher
            self._refused = error
            self.unreadable += len(messages)
            return
        if self._frame not in (None, frame):
            self.unreadable += len(messages)
            return
        self._stamps.append(stamps)
        self._values.append(values)

    def series(self) -> TopicSeries:
        self._unpack()
        if self._refused and len(self._stamps) == 1:
            reason = f"a message on {self._topic} is not a {self._type}: {self._refused}"
            raise RecordingError(self._path, reason) from self._refused
        columns = np.concatenate(self._stamps), np.concatenate(self._values)
        for column in columns:
            column.setflags(write=False)
        return TopicSeries(*columns, self.unreadable)


EXCHANGED = ("tool_pose", "wrench", "deflection")
TYPES = {topic.name: topic.type for topic in TOPICS}


class Series(NamedTuple):
    """A topic of a pass, in the order of the file; a stamp comes several times where the exchange is iterated."""

    step: np.ndarray  #: exchange, (n,) int64, not descending
    stamp_ns: np.ndarray  #: from the start of the pass, (n,) int64
    values: np.ndarray  #: (n, columns)

    def last(self, before: int = 0) -> Series:
        """Return the last row of each step; before: the row so many rows earlier, of the steps that have it."""
        end = np.searchsorted(self.step, np.unique(self.step), side="right") - 1
        rows = end - before
        rows = rows[(rows >= 0) & (self.step[rows] == self.step[end])]
        return Series(*(column[rows] for column in self))

    def unbroken(self) -> int:
        """Return the number of steps from 0 on without a gap, in a series with one row for each step."""
        return int(np.argmax(np.append(self.step, -1) != np.arange(self.step.size + 1)))


@dataclasses.dataclass(frozen=True, eq=False)
class PassSeries:
    """A pass along a reference, of the simulated robot, of a robot with another clock or of an RSI session."""

    number: int  #: place of the reference in the recording, from 0
    reference: Trajectory
    target: Trajectory | None  #: as the compensator states it; None: that of the cell
    series: dict[str, Series]  #: topic -> its rows
    maps: tuple[StockMap, ...] = ()  #: maps of the workpiece
    reason: str = ""  #: why the pass cannot be used; empty: it can
    wall_s: float = float("nan")  #: wall time that the robot reported [s]
    stamps: str = "exchange"  #: origin of the stamps; "driver's": another clock; "place": an RSI session
    driven_lost: int = 0  #: poses that are missing where a driver stamps them
    driven_whole: bool = False  #: a driven pass has no gap and runs to the end of its reference

    def topic(self, name: str) -> Series:
        return self.series.get(name, Series(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6))))

    def lost(self, last: int, thinned: int) -> int:
        """Return how many poses, wrenches and deflections are missing up to a step; thinned: steps to a deflection."""
        there = [self.topic(name).last().step for name in EXCHANGED]
        due = np.count_nonzero(there[2] % thinned == 0)
        count = sum(max(0, last + 1 - np.count_nonzero(step <= last)) for step in there[:2])
        return int(count + max(0, last // thinned + 1 - due))


@dataclasses.dataclass(eq=False)
class GraphRecord:
    """Messages of the nodes of one robot."""

    namespace: str
    topics: dict[str, str] = dataclasses.field(default_factory=dict)  #: our names -> names in the recording
    references: list[Trajectory] = dataclasses.field(default_factory=list)  #: in the order of the file
    published: list[Trajectory] = dataclasses.field(default_factory=list)  #: the same, with the bits of the messages
    targets: dict[str, Trajectory] = dataclasses.field(default_factory=dict)  #: fingerprint -> target, in this order
    states: list[CompensatorState] = dataclasses.field(default_factory=list)  #: states in the order of the file
    refused: dict[str, int] = dataclasses.field(default_factory=dict)  #: messages that cannot be read
    outside: dict[str, int] = dataclasses.field(default_factory=dict)  #: messages of no exchange of a pass
    passes: list[PassSeries] = dataclasses.field(default_factory=list)  #: passes of the simulated robot by their starts

    def target_of(self, reference: Trajectory) -> Trajectory | None:
        """Return the target of a reference: as a state says, else the last target; None: the target of the cell."""
        digest = fingerprint(reference)
        stated = [state.target for state in self.states if state.reference == digest]
        if stated:
            return self.targets.get(stated[-1])
        return list(self.targets.values())[-1] if self.targets else None


def topic_of(recording: Recording, name: str, namespace: str | None = None) -> str:
    """Return the full name of a topic of the graph in a recording; raise RecordingError unless it is unique."""
    if namespace is not None:
        matches = [f"/{namespace.strip('/')}/{name}".replace("//", "/")]
        matches = [topic for topic in matches if topic in recording.topics()]
    else:
        matches = own_topics(recording, name)
        ours = [topic for topic in matches if recording.topics()[topic].type == TYPES[name]]
        matches = ours or matches
    if len(matches) != 1:
        several = f"exists several times ({', '.join(matches)}): name a namespace" if matches else "is not recorded"
        several += f" in the namespace {namespace}" if namespace is not None else ""
        raise RecordingError(recording.path, f"the topic {name} {several}")
    return matches[0]


def own_topics(recording: Recording, name: str) -> list[str]:
    """Return the topics that end with a name: those in the namespace of a reference trajectory, or all if none is.

    Without a reference trajectory the namespace is empty.
    """
    spaces = [topic.rpartition("/")[0] for topic in recording.topics() if topic.endswith("/reference_trajectory")]
    matches = [topic for topic in recording.topics() if topic.endswith(f"/{name}")]
    return [topic for topic in matches if topic.removesuffix(f"/{name}") in (spaces or [""])] or matches


def read_graph(
    recording: Recording,
    clock,
    namespace: str | None = None,
    joint_names: Sequence[str] = (),
    on_damage: Callable | None = None,
) -> GraphRecord:
    """Read the nodes' topics of one robot once, and cut the series into the passes along its references.

    clock: the steps of the exchange (``physics.motion.periods.Clock``). joint_names: of the robot, to read its joint
    states and the maps of the part. on_damage: see ``Recording.messages``. Raises RecordingError where poses or
    references are not recorded.
    """
    names = {topic.rpartition("/")[2] for topic in recording.topics()}  # a driver publishes no deflection
    topics = {kind: topic_of(recording, kind, namespace) for kind in EXCHANGED if kind == "tool_pose" or kind in names}
    reference = topic_of(recording, "reference_trajectory", namespace)
    if recording.topics()[reference].type != type_of(Trajectory):
        raise RecordingError(recording.path, f"{reference} is no trajectory")
    space = reference.rpartition("/")[0]
    graph = GraphRecord(space, {**topics, "reference_trajectory": reference})
    joints: list[JointSample] = []
    maps: list[StockMap] = []
    walls: list[float] = []  # wall times of complete passes [s]

    def add_reference(data: bytes) -> Trajectory:
        reference = trajectory_from_bytes(data)
        graph.published.append(trajectory_from_bytes(data, as_sent=True))
        return reference

    def add_target(target: Trajectory) -> None:
        graph.targets[fingerprint(target)] = target

    take: dict[str, Callable] = {
        "target_trajectory": add_target,
        "compensator_state": graph.states.append,
        **({"joint_states": joints.append, "workpiece": maps.append} if joint_names else {}),
    }
    others = {f"{space}/{name}": _reader(graph, name, receive) for name, receive in take.items()}
    others[reference] = _reader(graph, "reference_trajectory", graph.references.append, add_reference)
    if "/diagnostics" in recording.topics():
        with contextlib.suppress(RecordingError):  # of another kind; only the wall times are missing then
            decode = recording.decoder("/diagnostics")
            others["/diagnostics"] = lambda data: walls.extend(_wall_times(decode, data, walls))
    others = {name: take for name, take in others.items() if name in recording.topics()}
    series = several(recording, list(topics.values()), others, WORKPIECE, on_damage)
    if not graph.references:
        raise RecordingError(recording.path, f"{reference} has no message that is a path of the tool")
    recorded = dict(zip(topics, series, strict=True))
    graph.refused.update({kind: rows.unreadable for kind, rows in recorded.items()})
    own = [
        state for state in joints if set(joint_names) <= set(state.names) and len(state.names) == len(state.position)
    ]
    unreadable = len(joints) - sum(bool(np.isfinite(state.position).all()) for state in own)
    graph.refused["joint_states"] = graph.refused.get("joint_states", 0) + unreadable
    if own:  # by name: a gripper may publish on the same topic
        table = np.array([[state.position[state.names.index(name)] for name in joint_names] for state in own])
        recorded["joint_states"] = TopicSeries(np.array([state.stamp for state in own], np.int64), table)
    graph.passes = _passes(graph, clock, recorded, maps, walls)
    for name, topic in recorded.items():
        graph.outside[name] = topic.stamp.size - sum(part.topic(name).step.size for part in graph.passes)
    return graph


def _reader(graph: GraphRecord, name: str, take: Callable, read: Callable | None = None) -> Callable[[bytes], None]:
    """Return the receiver of a topic's messages; a message that the nodes refuse is counted."""

    def receive(data: bytes) -> None:
        try:
            record = read(data) if read else from_bytes(TYPES[name], data)
        except (MillingError, ValueError):
            graph.refused[name] = graph.refused.get(name, 0) + 1
        else:
            take(record)

    return receive


def _wall_times(decode: Callable, data: bytes, known: list[float]) -> list[float]:
    """Return the wall time [s] that the robot reported, if it is a new one."""
    with contextlib.suppress(RecordingError, AttributeError, ValueError):  # a message of another publisher
        walls = [float(pair.value) for status in decode(data).status for pair in status.values if pair.key == "wall_s"]
        return [wall for k, wall in enumerate(walls) if wall not in (*known[-1:], *walls[:k])]
    return []


def _passes(
    graph: GraphRecord,
    clock,
    recorded: dict[str, TopicSeries],
    maps: list[StockMap],
    walls: list[float],
) -> list[PassSeries]:
    """Return the passes: references with a pose of the exchange between their start and the next one."""
    # the later of two references with the same start replaced the other before the pass
    starts = {reference.start_ns: (number, reference) for number, reference in enumerate(graph.references)}
    ordered = sorted(starts)
    passes: list[PassSeries] = []
    for start, end in zip(ordered, [*ordered[1:], np.iinfo(np.int64).max], strict=True):
        number, reference = starts[start]
        last = clock.steps(reference.duration_ns)
        cut = {name: _cut(clock, topic, name, start, end, last) for name, topic in recorded.items()}
        series = {name: part for name, part in cut.items() if part.step.size}
        if "tool_pose" not in series:
            continue
        published = recorded.get("deflection")  # once an exchange
        starting = 0 if published is None else int(np.count_nonzero(published.stamp == start))
        reason = f"does not separate its passes: {starting} passes have one start" if starting > 1 else ""
        inside = tuple(stock_map for stock_map in maps if start <= stock_map.stamp < end)
        passes.append(PassSeries(number, reference, graph.target_of(reference), series, inside, reason))
    if len(walls) == len(passes):
        return [dataclasses.replace(part, wall_s=wall) for part, wall in zip(passes, walls, strict=True)]
    return passes


def _cut(clock, topic: TopicSeries, name: str, start: int, end: int, last: int) -> Series:
    """Return the rows of a topic that the nodes use in one pass."""
    here = (topic.stamp >= start) & (topic.stamp < end)
    stamp, values = topic.stamp[here] - start, topic.values[here]
    step = np.rint(stamp / (clock.period * 1e9)).astype(np.int64)
    used = (step <= last) & (clock.stamp(step) == stamp) & np.isfinite(values).all(axis=1)
    if name == "tool_pose":
        with np.errstate(over="ignore", invalid="ignore"):
            used &= np.abs(np.linalg.norm(values[:, 3:], axis=1) - 1.0) <= 1e-3  # as the nodes allow it
    used[used] = np.maximum.accumulate(step[used]) == step[used]  # an older one comes from another publisher
    return Series(step[used], stamp[used], values[used])
