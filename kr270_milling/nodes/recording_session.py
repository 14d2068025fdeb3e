"""What a recorder does with one file: it subscribes to the topics, writes what comes, tells what is missing."""

from __future__ import annotations

import contextlib
import fnmatch
import functools
import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from kr270_milling.bag.writer import BagWriter, MessageRefused
from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.report.scene import INPUTS, Derived, Scene
from kr270_milling.ros.drain import DEPTH, Taken, aside, drain, in_order
from kr270_milling.ros.names import NameRefused, message_class
from kr270_milling.ros.node import ERROR, OK, SILENT, WARN, ReportingNode, Silence

__all__ = ["RecordingSession"]

DERIVED_QOS = QoSProfile(  # latched, so that a player gives them to whoever comes late
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
UNASKED = ("/rosout", "/parameter_events")  # recorded only when asked for by name


class RecordingSession:
    """One file of a node; topics: names that are recorded, with * and ?, empty for all; viewers: also write, and
    publish, what viewers need and nobody else publishes."""

    def __init__(self, node: ReportingNode, writer: BagWriter, topics: Sequence[str], viewers: bool):
        self.writer = writer
        self._node = node
        self._topics = topics
        self._viewers = viewers
        self._scenes: dict[str, Scene] = {}  # of each robot, by its namespace
        self._live: dict[str, Publisher | None] = {}  # of what follows for viewers; None where its type is missing
        # the recorder does not record its own topics: a player would repeat the name of the recording
        self._subscriptions: dict[str, Subscription | None] = {o.topic_name: None for o in node.outlets.values()}
        self._stopped = False
        self._before = -1
        self._refused = 0  # messages
        self._late: list[Taken] = []  # arrived while the readers were emptied
        self._there: set[str] = set()  # topics with a publisher
        self._gone: set[str] = set()  # topics that had one
        self._silences: dict[str, Silence] = {}  # of the nodes that report to /diagnostics
        self._quiet: set[str] = set()
        node.report(OK, f"recording to {writer.path}")

    def _is_wanted(self, topic: str) -> bool:
        return any(fnmatch.fnmatchcase(topic, t) for t in self._topics) if self._topics else topic not in UNASKED

    def look_around(self) -> None:
        """Subscribe to topics that are new, close an old chunk, tell whose publisher is gone."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._subscriptions or not self._is_wanted(topic):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, types, publishers)
        self._keep(self.writer.tick, time.monotonic())
        self._watch_publishers()
        self._watch_nodes()

    def _watch_publishers(self) -> None:
        there = {t for t, s in self._subscriptions.items() if s is not None and s.get_publisher_count()}
        gone, self._gone = self._gone, (self._gone | self._there) - there
        self._there = there
        if self._gone - gone and not self._stopped:
            self._node.report(WARN, f"nobody publishes {', '.join(sorted(self._gone))} any more")

    def _watch_nodes(self) -> None:
        """One that was killed publishes no farewell; its lease runs out much later."""
        quiet = {name for name, silence in self._silences.items() if silence.look() > SILENT}
        told, self._quiet = self._quiet, quiet
        if quiet - told and not self._stopped:
            self._node.report(WARN, f"{', '.join(sorted(quiet))} not heard of for {SILENT:g} s")
        elif told and not quiet and not self._stopped:
            self._node.report(OK, f"recording to {self.writer.path}")

    def _on_report(self, topic: str, data: bytes, published: int) -> None:
        self.writer.write(topic, data, published)
        with contextlib.suppress(rclpy_implementation.RMWError):  # no report: recorded as it came
            for status in deserialize_message(data, DiagnosticArray).status:
                if status.name != self._node.get_fully_qualified_name():
                    self._silences.setdefault(status.name, Silence()).heard()

    def _on_scene(self, topic: str, data: bytes, published: int) -> None:
        self.writer.write(topic, data, published)
        namespace, _, name = topic.rpartition("/")
        scene = self._scenes.setdefault(namespace, Scene())
        derived: list[Derived] = []
        with contextlib.suppress(MillingError, ValueError):  # recorded as it came; there is nothing to show
            derived += scene.hear(name, data)
        for found in derived:
            name = namespace + found.topic
            if name in self._live or (name not in self._subscriptions and self._is_wanted(name)):
                self.writer.add_topic(name, found.type, [DERIVED_QOS])
                self.writer.write(name, found.data, published)
                self._show(name, found.type, found.data)

    def _show(self, name: str, type_name: str, data: bytes) -> None:
        """Publish what follows for viewers of the running graph, where its message type is installed."""
        if name not in self._live:
            self._subscriptions[name] = None  # our own: written already
            self._live[name] = None
            with contextlib.suppress(ImportError, NameRefused):
                self._live[name] = self._node.create_publisher(message_class(type_name), name, DERIVED_QOS)
        publisher = self._live[name]
        if publisher is not None:
            publisher.publish(data)

    def _subscribe(self, topic: str, types: list[str], publishers) -> None:
        try:
            if len(types) != 1:
                raise RecordingError(self.writer.path, f"{topic} has several types: {', '.join(types)}")
            kind = message_class(types[0])
            self.writer.add_topic(topic, types[0], [p.qos_profile for p in publishers])
        except (ImportError, NameRefused, RecordingError) as error:
            self._subscriptions[topic] = None
            self._node.report(WARN, f"{topic} is not recorded: {error}")
            return

        write = self._on_report if kind is DiagnosticArray else self.writer.write
        if self._viewers and topic.rpartition("/")[2] in INPUTS:
            write = self._on_scene
        write = functools.partial(write, topic)
        self._subscriptions[topic] = aside(self._node, kind, topic, write, _matching(publishers))

    def drain(self) -> None:
        """Write what has arrived, in the order of arrival, so that a file that ends here lacks nothing that came before
        the rest of it. What arrives while the readers are emptied, one after another, waits for the next time."""
        clock = self._node.get_clock()
        begun = clock.now().nanoseconds
        taken, waited = drain(s for s in self._subscriptions.values() if s is not None), self._late
        ended = clock.now().nanoseconds  # what seems to arrive later still came before the clock was set back
        self._late = [item for item in taken if begun < item[0] <= ended]
        now = [item for item in taken if not begun < item[0] <= ended]
        for _, published, write, data in in_order([waited, now]):
            self._keep(write, data, published)

    def _keep(self, call, *args) -> None:
        """A refused message is counted; nothing is written after the first error of the file, which stays readable."""
        if self._stopped:
            return
        try:
            call(*args)
        except MessageRefused as refused:
            self._refused += 1
            if self._refused == 1:  # the rest is counted in the report and in the file
                self._node.report(WARN, f"a message is not recorded: {refused}")
        except RecordingError as error:
            self._stopped = True
            self._node.end(str(error))
            self._node.report(ERROR, str(error))

    def watch(self) -> dict:
        """Values for the report of the node."""
        return {
            "file": self.writer.path,
            "messages": self.writer.count,
            "latest_ns": " ".join(f"{c.topic}={c.gaps.last}" for c in self.writer.channels.values() if c.gaps.last),
            "missing": sum(entry.get("missing", 0) for entry in self.writer.report().values()),
            "refused": self._refused,
        }

    def settled(self) -> bool:
        """Nothing more came in since the last look."""
        self.drain()
        before, self._before = self._before, self.writer.count
        return before == self.writer.count and not self._late

    def close(self) -> str | None:
        """Finish the file; tells on standard error what is missing. Returns a sentence if that failed."""
        if self._stopped:
            return None
        try:
            self.writer.close()
        except RecordingError as error:
            return str(error)
        logger = self._node.get_logger()
        for topic, entry in self.writer.report().items():
            if entry.get("missing"):
                came, missing = entry["count"], entry["missing"]
                logger.warning(f"{topic}: {missing} of {came + missing} messages are missing")
            if entry.get("refused"):
                logger.warning(f"{topic}: {entry['refused']} messages were refused and are not recorded")
        logger.info(f"{self.writer.count} messages in {self.writer.path}")
        return None

    def release(self) -> None:
        """Give the topics back; the node goes on without this file."""
        for subscription in filter(None, self._subscriptions.values()):
            self._node.destroy_subscription(subscription)
        for publisher in filter(None, self._live.values()):
            self._node.destroy_publisher(publisher)


def _matching(publishers) -> QoSProfile:
    """What every publisher of a topic can serve: reliable or latched only if all of them are."""
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        depth=DEPTH,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
