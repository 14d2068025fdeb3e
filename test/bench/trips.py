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

POSE = to_bytes(PoseSample(0, "workpiece", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
WRENCH = to_bytes(WrenchSample(0, "workpiece", np.zeros(6)))
WARM = 200  # trips before the clock runs


class Answer(Node):
    def __init__(self, context: Context):
        super().__init__("answer", context=context)
        self.publisher = self.create_publisher(*topics.WRENCH)
        self.done = False
        pose = topics.TOOL_POSE
        self.create_subscription(pose.type, pose.name, self.hear, pose.qos, raw=True)

    def hear(self, _: bytes) -> None:
        self.publisher.publish(WRENCH)


class Ask(Node):
    def __init__(self, context: Context, count: int):
        super().__init__("ask", context=context)
        self.publisher = self.create_publisher(*topics.TOOL_POSE)
        self.count, self.trips, self.begun, self.done = count, 0, 0.0, False
        wrench = topics.WRENCH
        self.heard = self.create_subscription(wrench.type, wrench.name, self.hear, wrench.qos, raw=True)

    def hear(self, _: bytes) -> None:
        self.trips += 1
        if self.trips == WARM:
            self.begun = time.perf_counter()
        if self.trips == WARM + self.count:
            print(self.count / (time.perf_counter() - self.begun), flush=True)
            self.done = True
            return
        self.publisher.publish(POSE)


def main(arguments: list[str]) -> int:
    keep_to_this_host()
    context = Context()
    rclpy.init(args=[], context=context)
    node = Answer(context) if arguments[0] == "answer" else Ask(context, int(arguments[1]))
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    if arguments[0] == "ask":
        while not (node.publisher.get_subscription_count() and node.heard.get_publisher_count()):
            executor.spin_once(timeout_sec=0.05)
        node.publisher.publish(POSE)
    while not node.done:
        executor.spin_once(timeout_sec=0.5)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
