"""A process that publishes poses, wrenches and deflections: ``python source.py RATE SECONDS``.

It waits for a listener of each, and prints how many exchanges it has published.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy

from kr270_milling.base.samples import PoseSample, TwistSample, WrenchSample
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.environment import keep_to_this_host
from kr270_milling.recordings.messages.codec import to_bytes

__all__ = ["main"]

WAIT = 120.0  # [s] for the subscribers, on a busy machine too
LAST = 1.0  # [s] for the last messages to be taken
STEP_NS = 500_000


def main(arguments: list[str]) -> int:
    rate, seconds = int(arguments[0]), float(arguments[1])
    keep_to_this_host()
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("soak_source", context=context)
    publishers = [node.create_publisher(*t) for t in (topics.TOOL_POSE, topics.WRENCH, topics.DEFLECTION)]
    end = time.monotonic() + WAIT
    while not all(p.get_subscription_count() for p in publishers) and time.monotonic() < end:
        time.sleep(0.01)
    print(_publish(publishers, rate, seconds))
    time.sleep(LAST)
    node.destroy_node()
    context.try_shutdown()
    return 0


def _publish(publishers, rate: int, seconds: float) -> int:
    pose, wrench, deflection = publishers
    down, values = np.array([1.0, 0.0, 0.0, 0.0]), np.random.default_rng(0).normal(0.0, 50.0, (997, 6))
    begin, count = time.monotonic(), round(rate * seconds)
    for i in range(count):
        stamp, row = i * STEP_NS, values[i % 997]
        pose.publish(to_bytes(PoseSample(stamp, "workpiece", row[:3], down)))
        wrench.publish(to_bytes(WrenchSample(stamp, "workpiece", row)))
        deflection.publish(to_bytes(TwistSample(stamp, "workpiece", row)))
        if i % 10 == 9:  # some milliseconds' worth at a time
            ahead = begin + (i + 1) / rate - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
    return count


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
