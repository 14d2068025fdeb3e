"""Node: receive the messages of the live view, and end when the graph has ended."""

from __future__ import annotations

import contextlib
import functools
import time

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from kr270_milling.base.errors import MillingError
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import Ending
from kr270_milling.live.ros.polling import POLL_PERIOD, poll, polled_subscription
from kr270_milling.live.watch.feed import INPUTS, LiveEvents
from kr270_milling.live.watch.server import Events

__all__ = ["Watcher"]

GONE = 2.0  #: [s] of the wall clock without any publisher, after which the graph has ended


class Watcher(Ending, Node):
    """Subscribe with best effort to the topics of the loop, so that no publisher waits for this node; publish nothing.

    The node is done when the graph was present and has ended.
    """

    def __init__(self, events: Events, namespace: str, **kwargs):
        super().__init__("watch", namespace=namespace, start_parameter_services=False, enable_rosout=False, **kwargs)
        self._events = events
        self._feed = LiveEvents()
        self._present: float | None = None
        self._subscriptions_of = [self._subscribe(topics.BY_NAME[name]) for name in INPUTS]
        self.create_timer(POLL_PERIOD, self._poll)
        self.create_timer(0.2, self._check_graph)

    def _subscribe(self, topic: topics.RosTopic):
        latched = topic.qos is topics.LATCHED
        qos = QoSProfile(
            depth=topic.qos.depth,
            reliability=ReliabilityPolicy.RELIABLE if latched else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        return polled_subscription(
            self, topic.type, topic.name, functools.partial(self._on_message, topic.name.strip("/")), qos
        )

    def _on_message(self, name: str, data: bytes) -> None:
        with contextlib.suppress(MillingError, ValueError):  # not a message of this type
            for event in self._feed.events(name, data):
                self._events.add(event)

    def _poll(self) -> None:
        for message in poll(self._subscriptions_of):
            message.callback(message.data)

    def _check_graph(self) -> None:
        if any(self.count_publishers(s.topic_name) for s in self._subscriptions_of):
            self._present = time.monotonic()
        elif self._present is not None and time.monotonic() - self._present > GONE and not self.done:
            self._poll()
            self._events.add({"kind": "end"})
            self.end()
