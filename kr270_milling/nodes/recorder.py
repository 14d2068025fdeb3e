"""Node: writes every topic of the graph to MCAP, bytes as they come."""

from __future__ import annotations

import contextlib
import fnmatch
import functools
import shlex
import sys
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from kr270_milling.bag.errors import MessageRefused, RecordingError
from kr270_milling.bag.writer import BagWriter
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.report.scene import INPUTS, Derived, Scene
from kr270_milling.ros.drain import DEPTH, DRAIN_PERIOD, Taken, aside, drain, in_order
from kr270_milling.ros.names import NameRefused, message_class, resolved_topic
from kr270_milling.ros.node import ERROR, OK, SILENT, WARN, ReportingNode, Silence
from kr270_milling.ros.spin import run_node

__all__ = ["Recorder", "main"]

LOOK_AROUND = 0.1  # [s] between two looks for new topics and two looks at the chunk's age
DERIVED_QOS = QoSProfile(  # latched, so that a player gives them to whoever comes late
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
UNASKED = ("/rosout", "/parameter_events")  # recorded only when asked for by name


class Recorder(ReportingNode):
    """Every topic (or those of the parameter ``topics``) into ``directory``/NAME.mcap; ends on a signal."""

    def __init__(self, **kwargs):
        super().__init__("recorder", **kwargs)
        self._where = "parameters of " + self.get_fully_qualified_name()
        topics = self._texts("topics", "names, relative or absolute, with * and ?; empty: every topic")
        self._topics = [
            t if "*" in t or "?" in t else resolved_topic(self, t, f"{self._where}: topics") for t in topics
        ]
        directory = self._text("directory", "the recording's directory, which must not hold one yet")
        attachments = self._texts("attach", "files to keep inside the recording")
        seed = self._text("seed", "seed of the run, kept inside the recording")
        command = self._text("command", "command line to keep inside the recording; empty: that of the node")
        about = "also write, and publish, what viewers need and nobody else publishes: /tf, /tf_static, /markers"
        described = ParameterDescriptor(description=about, read_only=True)
        self._viewers = self.declare_parameter("viewers", True, described).value
        self._scenes: dict[str, Scene] = {}  # of each robot, by its namespace
        self._live: dict[str, Publisher | None] = {}  # of what follows for viewers; None where its type is missing
        if not directory:
            raise InputError(self._where, "directory is missing")
        metadata = {"command": command or shlex.join(sys.argv), "seed": seed}
        self.writer = BagWriter(directory, attachments=self._read(attachments), metadata=metadata)
        self._subscriptions_of: dict[str, Subscription | None] = {}
        self._stopped, self._before = False, -1
        self._refused = 0  # messages
        self._late: list[Taken] = []  # arrived while the readers were emptied
        self._there: set[str] = set()  # topics with a publisher
        self._gone: set[str] = set()  # topics that had one
        self._silences: dict[str, Silence] = {}  # of the nodes that report to /diagnostics
        self._quiet: set[str] = set()
        self.create_timer(LOOK_AROUND, self._look_around)
        self.create_timer(DRAIN_PERIOD, self._drain)
        self.report(OK, f"recording to {self.writer.path}")

    def _text(self, name: str, about: str) -> str:
        described = ParameterDescriptor(description=about, read_only=True)
        return self.declare_parameter(name, "", described).value

    def _texts(self, name: str, about: str) -> list[str]:
        """A parameter that may be one text, or several as a list or separated by commas."""
        described = ParameterDescriptor(description=about, dynamic_typing=True, read_only=True)
        value = self.declare_parameter(name, "", described).value
        texts = str(value).split(",") if not isinstance(value, (list, tuple)) else map(str, value)
        return [text.strip() for text in texts if text.strip()]

    def _read(self, names: list[str]) -> dict[str, bytes]:
        try:
            return {Path(name).name: Path(name).read_bytes() for name in names}
        except OSError as error:
            raise InputError(self._where, f"attach: {error.filename} cannot be read ({error.strerror})") from None

    def _is_wanted(self, topic: str) -> bool:
        return any(fnmatch.fnmatchcase(topic, t) for t in self._topics) if self._topics else topic not in UNASKED

    def _look_around(self) -> None:
        """Subscribe to topics that are new, close an old chunk, tell whose publisher is gone."""
        for topic, types in self.get_topic_names_and_types():
            if topic in self._subscriptions_of or not self._is_wanted(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, types, publishers)
        self._keep(self.writer.tick, time.monotonic())
        self._watch_publishers()
        self._watch_nodes()

    def _watch_publishers(self) -> None:
        there = {t for t, s in self._subscriptions_of.items() if s is not None and s.get_publisher_count()}
        gone, self._gone = self._gone, (self._gone | self._there) - there
        self._there = there
        if self._gone - gone and not self._stopped:
            self.report(WARN, f"nobody publishes {', '.join(sorted(self._gone))} any more")

    def _watch_nodes(self) -> None:
        """One that was killed publishes no farewell; its lease runs out much later."""
        quiet = {name for name, silence in self._silences.items() if silence.look() > SILENT}
        told, self._quiet = self._quiet, quiet
        if quiet - told and not self._stopped:
            self.report(WARN, f"{', '.join(sorted(quiet))} not heard of for {SILENT:g} s")
        elif told and not quiet and not self._stopped:
            self.report(OK, f"recording to {self.writer.path}")

    def _on_report(self, topic: str, data: bytes, published: int) -> None:
        self.writer.write(topic, data, published)
        with contextlib.suppress(rclpy_implementation.RMWError):  # no report: recorded as it came
            for status in deserialize_message(data, DiagnosticArray).status:
                if status.name != self.get_fully_qualified_name():
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
            if name in self._live or (name not in self._subscriptions_of and self._is_wanted(name)):
                self.writer.add_topic(name, found.type, [DERIVED_QOS])
                self.writer.write(name, found.data, published)
                self._show(name, found.type, found.data)

    def _show(self, name: str, type_name: str, data: bytes) -> None:
        """Publish what follows for viewers of the running graph, where its message type is installed."""
        if name not in self._live:
            self._subscriptions_of[name] = None  # our own: written already
            self._live[name] = None
            with contextlib.suppress(ImportError, NameRefused):
                self._live[name] = self.create_publisher(message_class(type_name), name, DERIVED_QOS)
        publisher = self._live[name]
        if publisher is not None:
            publisher.publish(data)

    def _subscribe(self, topic: str, types: list[str], publishers) -> None:
        try:
            if len(types) != 1:
                raise RecordingError(self.writer.path, f"{topic} has several types: {', '.join(types)}")
            kind = message_class(types[0])
            periodic = 0 if types[0].startswith("diagnostic_msgs/") else None  # several nodes, each with its own stamps
            self.writer.add_topic(topic, types[0], [p.qos_profile for p in publishers], periodic)
        except (ImportError, NameRefused, RecordingError) as error:
            self._subscriptions_of[topic] = None
            self.report(WARN, f"{topic} is not recorded: {error}")
            return

        write = self._on_report if kind is DiagnosticArray else self.writer.write
        if self._viewers and topic.rpartition("/")[2] in INPUTS:
            write = self._on_scene
        write = functools.partial(write, topic)
        self._subscriptions_of[topic] = aside(self, kind, topic, write, _matching(publishers))

    def _drain(self) -> None:
        """Write what has arrived, in the order of arrival, so that a file that ends here lacks nothing that came before
        the rest of it. What arrives while the readers are emptied, one after another, waits for the next time."""
        begun = self.get_clock().now().nanoseconds
        taken, waited = drain(s for s in self._subscriptions_of.values() if s is not None), self._late
        self._late = [item for item in taken if item[0] > begun]
        for _, published, write, data in in_order([waited, [item for item in taken if item[0] <= begun]]):
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
                self.report(WARN, f"a message is not recorded: {refused}")
        except RecordingError as error:
            self._stopped, self.failure = True, str(error)
            self.report(ERROR, str(error))

    def watch(self) -> dict:
        return {
            "file": self.writer.path,
            "messages": self.writer.count,
            "latest_ns": " ".join(f"{c.topic}={c.gaps.last}" for c in self.writer.channels.values() if c.gaps.last),
            "missing": sum(entry.get("missing", 0) for entry in self.writer.report().values()),
            "refused": self._refused,
        }

    def settled(self) -> bool:
        """After a signal: nothing more came in since the last look."""
        self._drain()
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
        for topic, entry in self.writer.report().items():
            if entry.get("missing"):
                came, missing = entry["count"], entry["missing"]
                self.get_logger().warning(f"{topic}: {missing} of {came + missing} messages are missing")
            if entry.get("refused"):
                self.get_logger().warning(f"{topic}: {entry['refused']} messages were refused and are not recorded")
        self.get_logger().info(f"{self.writer.count} messages in {self.writer.path}")
        return None


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


def main(args: list[str] | None = None) -> int:
    """Console script ``recorder``."""
    return run_node(Recorder, args)


if __name__ == "__main__":
    raise SystemExit(main())
