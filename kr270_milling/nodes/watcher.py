"""Node: the listener of the live view takes messages some times a second, and knows when the graph is gone."""

from __future__ import annotations

import contextlib
import functools
import time

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from kr270_milling.base.errors import MillingError
from kr270_milling.ros import topics
from kr270_milling.ros.drain import DRAIN_PERIOD, aside, drain
from kr270_milling.ros.node import Ending
from kr270_milling.watch.feed import INPUTS, Feed
from kr270_milling.watch.server import Events

__all__ = ["Watcher"]

GONE = 2.0  #: [s] of the wall without any publisher after which the graph is closed


class Watcher(Ending, Node):
    """Publishes nothing; best effort on the topics of the loop, so that nobody waits for it. Done when the graph was
    there and is gone."""

    def __init__(self, events: Events, namespace: str, **kwargs):
        super().__init__("watch", namespace=namespace, start_parameter_services=False, enable_rosout=False, **kwargs)
        self._events = events
        self._feed = Feed()
        self._seen: float | None = None
        self._subscriptions_of = [self._listen(topics.BY_NAME[name]) for name in INPUTS]
        self.create_timer(DRAIN_PERIOD, self._drain)
        self.create_timer(0.2, self._look)

    def _listen(self, topic: topics.Topic):
        latched = topic.qos is topics.LATCHED
        qos = QoSProfile(
            depth=topic.qos.depth,
            reliability=ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        return aside(self, topic.type, topic.name, functools.partial(self._hear, topic.name.strip("/")), qos)

    def _hear(self, name: str, data: bytes) -> None:
        with contextlib.suppress(MillingError, ValueError):  # no such message: there is nothing to show
            for event in self._feed.hear(name, data):
                self._events.tell(event)

    def _drain(self) -> None:
        for _, _, hear, data in drain(self._subscriptions_of):
            hear(data)

    def _look(self) -> None:
        if any(self.count_publishers(s.topic_name) for s in self._subscriptions_of):
            self._seen = time.monotonic()
        elif self._seen is not None and time.monotonic() - self._seen > GONE and not self.done:
            self._drain()
            self._events.tell({"kind": "end"})
            self.end()
