"""Bare round trips: ``python -m bench.trips answer``, and in another process ``python -m bench.trips ask COUNT``.

A pose as bytes from one process, a wrench as bytes from the other, EventsExecutor, the topics and the profile of the
graph, nothing computed: what the middleware and rclpy take of an exchange. ``ask`` prints trips a second.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.environment import keep_to_this_host
from kr270_milling.recordings.messages.codec import to_bytes

POSE = topics.TOOL_POSE, to_bytes(PoseSample(0, "workpiece", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
WRENCH = topics.WRENCH, to_bytes(WrenchSample(0, "workpiece", np.zeros(6)))
WARM = 200  # trips before the clock runs


class Partner(Node):
    """Answers each message; ends after ``count`` messages."""

    def __init__(self, name: str, context: Context, sends, receives, count: float):
        super().__init__(name, context=context)
        (sent, self.data), (received, _) = sends, receives
        self.publisher = self.create_publisher(*sent)
        self.source = self.create_subscription(received.type, received.name, self.answer, received.qos, raw=True)
        self.count, self.trips, self.times = count, 0, []

    def answer(self, _: bytes) -> None:
        self.trips += 1
        if self.trips in (WARM, WARM + self.count):
            self.times.append(time.perf_counter())
        self.publisher.publish(self.data)


def main(name: str, count: float = float("inf")) -> None:
    keep_to_this_host()
    context = Context()
    rclpy.init(args=[], context=context)
    ends = (WRENCH, POSE) if name == "answer" else (POSE, WRENCH)
    node, executor = Partner(name, context, *ends, float(count)), EventsExecutor(context=context)
    executor.add_node(node)
    while not (node.publisher.get_subscription_count() and node.source.get_publisher_count()):
        executor.spin_once(timeout_sec=0.05)
    if name == "ask":
        node.publisher.publish(node.data)
    while len(node.times) < 2:
        executor.spin_once(timeout_sec=0.5)
    begin, end = node.times
    print(node.count / (end - begin), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
