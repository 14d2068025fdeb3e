"""A process that publishes messages of one size: ``python source.py RATE COUNT SIZE``.

RATE 0: as fast as they are taken. SIZE 0: poses. Prints when it began [s of the wall clock] and how many seconds it
took; ends when the recorder has received all.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.duration import Duration
from rclpy.qos import HistoryPolicy, QoSProfile

from kr270_milling.base.samples import PoseSample, StockMap
from kr270_milling.live.ros.environment import keep_to_this_host
from kr270_milling.recordings.messages.codec import to_bytes

WAIT = 20  # [s] for the recorder


def main(rate: int, count: int, size: int) -> None:
    keep_to_this_host()
    rclpy.init(args=[])
    node = rclpy.create_node("bench_source")
    # with KEEP_ALL a publisher waits for a reader that does not keep up, in place of dropping
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL) if size else QoSProfile(depth=20_000)
    publisher = node.create_publisher(OccupancyGrid if size else PoseStamped, "bench", qos)
    end = time.monotonic() + WAIT
    while not publisher.get_subscription_count() and time.monotonic() < end:
        time.sleep(0.01)
    messages = bodies(count, size)
    begin, wall = time.monotonic(), time.time()
    for i, body in enumerate(messages):
        publisher.publish(body)
        if rate and i % 20 == 19:  # a millisecond's worth at a time
            time.sleep(max(0.0, begin + (i + 1) / rate - time.monotonic()))
    print(wall, time.monotonic() - begin)
    publisher.wait_for_all_acked(Duration(seconds=WAIT))
    rclpy.try_shutdown()


def bodies(count: int, size: int) -> list[bytes]:
    if not size:
        down = np.array([1.0, 0.0, 0.0, 0.0])
        return [to_bytes(PoseSample(i * 50_000, "workpiece", np.full(3, float(i)), down)) for i in range(count)]
    cells = np.linspace(0, 100, size).astype(np.int8).reshape(1000, -1)
    return [to_bytes(StockMap(0, "workpiece", 1e-3, np.zeros(3), cells))] * count


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
