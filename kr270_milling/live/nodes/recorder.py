"""Node: write every topic of the graph to MCAP, as serialised messages, and count the missing ones."""

from __future__ import annotations

import contextlib
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from kr270_milling.base.errors import InputError, MessageError, MillingError, RecordingError
from kr270_milling.base.samples import Text
from kr270_milling.exchange.scene import INPUTS, OUTPUTS, Scene
from kr270_milling.live.ros.node import ERROR, NOT_COMPLETE, OK, WARN, ManagedNode, ReportingNode
from kr270_milling.live.ros.readiness import is_recorded, joined
from kr270_milling.live.ros.topics import LATCHED, LOOP, message_class, resolved_topic
from kr270_milling.recordings.bag.writer import BagWriter, MessageRefused
from kr270_milling.recordings.messages.topics import RECORDER


class RecordingSession:
    """The open file of a recorder.

    topics: recorded names with * and ?, empty for all; viewers: also record and publish the topics for viewers that no
    other node publishes.
    """

    def __init__(self, node: ReportingNode, writer: BagWriter, topics: Sequence[str], viewers: bool):
        self.writer = writer
        self._node = node
        self._topics = topics
        self._viewers = viewers
        self._scenes: dict[str, Scene] = {}  # namespace of a robot -> its scene
        self._live: dict[str, Publisher | None] = {}  # topics for viewers; None where the type is not installed
        # the recorder does not record its own topics: a player would repeat the name of the recording
        own = [outlet.topic_name for outlet in node.outlets.values()] + [node.resolve_topic_name("~/transition_event")]
        self._subscriptions: dict[str, Subscription | None] = dict.fromkeys(own)
        self._stopped = False
        self._refused = 0  # messages
        self._published: set[str] = set()  # topics with a publisher
        self._left: set[str] = set()  # topics whose publisher has left

    def discover(self) -> None:
        """Subscribe to new topics, close an old chunk, report publishers that have left."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self._subscriptions or not is_recorded(topic, self._topics):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscriptions[topic] = self._node.used(topic, self._subscribe, topic, types, publishers)
        self._write(self.writer.tick, time.monotonic())
        published = {t for t, s in self._subscriptions.items() if s is not None and s.get_publisher_count()}
        before, self._left = self._left, (self._left | self._published) - published
        self._published = published
        if self._left - before and not self._stopped:
            self._node.report(WARN, f"no publisher any more: {', '.join(sorted(self._left))}")

    def _on_scene(self, topic: str, data: bytes, receipt: int) -> None:
        """Write a message and what viewers show of it; receipt: its time [ns]."""
        self.writer.write(topic, data, receipt)
        namespace = topic.rpartition("/")[0]
        scene = self._scenes.setdefault(namespace, Scene())
        for kind, derived in self._node.used(topic, _derived, scene, topic, data) or ():
            name = namespace + kind
            if name in self._live or (name not in self._subscriptions and is_recorded(name, self._topics)):
                self.writer.add_topic(name, OUTPUTS[kind], [LATCHED])  # late subscribers of a player receive it
                self.writer.write(name, derived, receipt)
                self._show(name, OUTPUTS[kind], derived)

    def _show(self, name: str, type_name: str, data: bytes) -> None:
        """Publish a derived message for viewers of the running graph, where its type is installed."""
        if name not in self._live:
            self._subscriptions[name] = None  # published by this node and written already
            self._live[name] = None
            with contextlib.suppress(ImportError, MillingError):
                self._live[name] = self._node.create_publisher(message_class(type_name), name, LATCHED)
        publisher = self._live[name]
        if publisher is not None:
            publisher.publish(data)

    def _subscribe(self, topic: str, types: list[str], publishers) -> Subscription | None:
        """Subscribe to a topic; return None, with a warning, where the topic cannot be recorded."""
        try:
            if len(types) != 1:
                raise RecordingError(self.writer.path, f"{topic} has several types: {', '.join(types)}")
            kind = message_class(types[0])
            self.writer.add_topic(topic, types[0], [p.qos_profile for p in publishers])
        except (ImportError, MillingError) as error:
            self._node.report(WARN, f"{topic} is not recorded: {error}")
            return None

        def take(data: bytes) -> None:
            self._take(subscription, data)

        subscription = self._node.create_subscription(kind, topic, take, _matching(publishers), raw=True)
        return subscription

    def _take(self, subscription: Subscription, data: bytes | None = None, most: int = 1000) -> None:
        """Write a message and all that wait: with a callback for each, 9,000 of 20,000 a second were written."""
        if self._stopped:  # the executor may still hold messages of a closed subscription
            return
        topic, now = subscription.topic_name, self._node.get_clock().now().nanoseconds
        follow = self._viewers and topic.rpartition("/")[2] in INPUTS
        write = self._on_scene if follow else self.writer.write
        with subscription.handle:
            for _ in range(most):  # then another topic has its turn
                if data is None:
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                    if taken is None:
                        break
                    data = taken[0]
                self._node.used(topic, self._write, write, topic, data, now)
                data = None

    def _write(self, call, *args) -> None:
        """Write, count a refused message, and stop at the first error of the file, which stays readable."""
        if self._stopped:
            return
        try:
            call(*args)
        except MessageRefused as refused:
            self._refused += 1
            if self._refused == 1:  # the report and the file count all of them
                self._node.report(WARN, f"a message is not recorded: {refused}")
        except RecordingError as error:
            self._stopped = True
            self._node.end(str(error))
            self._node.report(ERROR, str(error))

    def watch(self) -> dict:
        """Return values for the report of the node."""
        return {
            "file": str(self.writer.path),
            "messages": self.writer.count,
            "records": joined(self._topics),
            "left_out": joined(topic for topic, subscription in self._subscriptions.items() if subscription is None),
            "missing": self._missing,
            "refused": self._refused,
        }

    def close(self) -> int:
        """Write the messages that were received, unsubscribe, close the file; return how many are missing.

        Raises RecordingError.
        """
        for subscription in filter(None, self._subscriptions.values()):
            self._take(subscription, most=LOOP.depth)
            self._node.destroy_subscription(subscription)
        for publisher in filter(None, self._live.values()):
            self._node.destroy_publisher(publisher)
        failed, self._stopped = self._stopped, True
        if not failed:
            self.writer.close()
            logger = self._node.get_logger()
            for topic, entry in self.writer.report().items():
                if missing := entry.get("missing"):
                    logger.warning(f"{topic}: {missing} of {entry['count'] + missing} messages are missing")
                if entry.get("refused"):
                    logger.warning(f"{topic}: {entry['refused']} messages were refused and are not recorded")
            logger.info(f"{self.writer.count} messages in {self.writer.path}")
        return self._missing

    @property
    def _missing(self) -> int:
        return sum(entry.get("missing", 0) for entry in self.writer.report().values())


def _derived(scene: Scene, topic: str, data: bytes) -> list[tuple[str, bytes]]:
    """Return the messages for viewers that follow from a message; raises MessageError."""
    try:
        return list(scene.take(topic.rpartition("/")[2], data))
    except Exception as error:  # noqa: BLE001 - what cannot be shown is recorded still
        raise MessageError(f"{topic} cannot be shown: {error}") from None


def _matching(publishers) -> QoSProfile:
    """Return the quality of service that matches every publisher: reliable or latched only if all publishers are."""
    reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
    latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
    return QoSProfile(
        depth=LOOP.depth,  # KEEP_ALL holds 5000: of 20,000 messages a second, one run of 4 lost 18 %
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class Recorder(ManagedNode):
    """Record every topic (or those of the parameter ``topics``) to ``directory``/NAME.mcap while the node is active.

    Activation opens the file, which attaches the files of ``attach``; deactivation closes the file.
    """

    def __init__(self, **kwargs):
        super().__init__("recorder", autostart=True, **kwargs)
        self.session: RecordingSession | None = None  #: session of the open file
        patterns = self._texts("topics", "names, relative or absolute, with * and ?; empty: every topic")
        where = f"{self._where}: topics"
        self._topics = [t if "*" in t or "?" in t else resolved_topic(self, t, where) for t in patterns]
        about = "also record and publish /tf, /tf_static and /markers for viewers, where no other node publishes them"
        self._viewers = self.declared("viewers", True, about)
        about = "directory of the recording, which must not contain a recording; read when the node is activated"
        directory = self.declared("directory", "", about, read_only=False)
        self._texts("attach", "files to attach to the recording", read_only=False)
        self.declared("seed", "", "seed of the run, stored in the recording", read_only=False)
        about = "command line to store in the recording; empty: that of the node"
        self.declared("command", "", about, read_only=False)
        self.open_outlets(RECORDER)
        self._publish_name("")
        self.create_timer(0.1, lambda: self.session and self.session.discover())  # [s]
        if self.autostart and not directory:
            raise InputError(self._where, "directory is missing: -p directory:=DIR")
        self.report(OK, "not recording")
        if self.autostart:
            self._start_alone()
        if self.failure:
            raise MillingError(self.failure)

    @property
    def _where(self) -> str:
        return f"parameters of {self.get_fully_qualified_name()}"

    def _texts(self, name: str, about: str, **fields) -> list[str]:
        """Declare a parameter of one text, or of several as a list or separated by commas."""
        return _split(self.declared(name, "", about, dynamic_typing=True, **fields))

    def activate(self) -> None:
        command = self.get_parameter("command").value or shlex.join(sys.argv)
        metadata = {"command": command, "seed": self.get_parameter("seed").value}
        try:
            names = _split(self.get_parameter("attach").value)
            attachments = {Path(name).name: Path(name).read_bytes() for name in names}
        except OSError as error:
            raise InputError(self._where, f"attach: {error.filename} cannot be read ({error.strerror})") from None
        writer = BagWriter(self.get_parameter("directory").value, attachments=attachments, metadata=metadata)
        self.session = RecordingSession(self, writer, self._topics, self._viewers)
        self.session.discover()
        self._publish_name(f"{writer.path.parent.name}/{writer.path.name}")
        self.report(OK, f"recording to {writer.path}")

    def deactivate(self) -> None:
        self._publish_name("")
        session, self.session = self.session, None
        missing = 0 if session is None else session.close()
        if missing:
            self.report(WARN, f"{missing} messages of the pass were lost; {NOT_COMPLETE}")
        else:
            self.report(OK, "not recording")

    def _publish_name(self, name: str) -> None:
        self.set_values(recording=name)
        self.send([("recording", Text(name))])

    def watch(self) -> dict:
        return {} if self.session is None else self.session.watch()

    def close(self) -> str | None:
        """Close the file before the process ends; return a sentence if that failed."""
        session, self.session = self.session, None
        try:
            if session is not None:
                session.close()
        except RecordingError as error:
            return str(error)
        return None


def _split(value) -> list[str]:
    texts = value if isinstance(value, (list, tuple)) else str(value).split(",")
    return [text for text in (str(text).strip() for text in texts) if text]
