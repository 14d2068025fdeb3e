"""A process that publishes messages of one size: ``python source.py RATE COUNT SIZE``.

RATE 0: as fast as they are taken. SIZE 0: poses. Prints how many were sent, in how many seconds, and after how many
the recorder had written them (by its diagnostics, which come five times a second).
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile

from kr270_milling.base.samples import PoseSample, StockMap
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.environment import keep_to_this_host
from kr270_milling.recordings.messages.codec import to_bytes

__all__ = ["main"]

WAIT = 20.0  # [s] for the recorder
PATIENCE = 2.0  # [s] without another message written


def main(arguments: list[str]) -> int:
    rate, count, size = map(int, arguments)
    keep_to_this_host()
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("bench_source", context=context)
    # with KEEP_ALL a publisher waits for a reader that does not keep up, in place of dropping
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL) if size else QoSProfile(depth=20_000)
    publisher = node.create_publisher(OccupancyGrid if size else PoseStamped, "bench", qos)
    end = time.monotonic() + WAIT
    while not publisher.get_subscription_count() and time.monotonic() < end:
        time.sleep(0.01)
    bodies = _bodies(count, size)
    begin = time.monotonic()
    seconds = _publish(publisher, rate, bodies)
    print(count, seconds, _written(node, count) - begin)
    node.destroy_node()
    context.try_shutdown()
    return 0


def _written(node, count: int) -> float:
    """When the recorder had written so many messages, or the last of those that it got [s of the monotonic clock]."""
    heard = [(time.monotonic(), 0)]

    def hear(msg) -> None:
        for status in msg.status:
            written = {pair.key: pair.value for pair in status.values}.get("messages")
            if written is not None and int(written) > heard[-1][1]:
                heard.append((time.monotonic(), int(written)))

    topic = topics.DIAGNOSTICS
    node.create_subscription(topic.type, topic.name, hear, topic.qos)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    while heard[-1][1] < count and time.monotonic() - heard[-1][0] < PATIENCE:
        executor.spin_once(timeout_sec=0.01)
    executor.shutdown()
    return heard[-1][0]


def _bodies(count: int, size: int) -> list[bytes]:
    if not size:
        down = np.array([1.0, 0.0, 0.0, 0.0])
        return [to_bytes(PoseSample(i * 50_000, "workpiece", np.full(3, float(i)), down)) for i in range(count)]
    cells = np.linspace(0, 100, size).astype(np.int8).reshape(1000, -1)
    return [to_bytes(StockMap(0, "workpiece", 1e-3, np.zeros(3), cells))] * count


def _publish(publisher, rate: int, bodies: list[bytes]) -> float:
    begin = time.monotonic()
    for i, body in enumerate(bodies):
        publisher.publish(body)
        if rate and i % 20 == 19:  # a millisecond's worth at a time
            ahead = begin + (i + 1) / rate - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
    return time.monotonic() - begin


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
