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

WAIT = 120.0  # [s] for the subscribers, on a busy machine too
LAST = 1.0  # [s] for the last messages to be taken
STEP_NS = 500_000

rate, seconds = int(sys.argv[1]), float(sys.argv[2])
keep_to_this_host()
rclpy.init(args=[])
node = rclpy.create_node("soak_source")
publishers = [node.create_publisher(*t) for t in (topics.TOOL_POSE, topics.WRENCH, topics.DEFLECTION)]
end = time.monotonic() + WAIT
while not all(p.get_subscription_count() for p in publishers) and time.monotonic() < end:
    time.sleep(0.01)
down, values = np.array([1.0, 0.0, 0.0, 0.0]), np.random.default_rng(0).normal(0.0, 50.0, (997, 6))
begin, count = time.monotonic(), round(rate * seconds)
for i in range(count):
    stamp, row = i * STEP_NS, values[i % 997]
    records = (
        PoseSample(stamp, "workpiece", row[:3], down),
        *(t(stamp, "workpiece", row) for t in (WrenchSample, TwistSample)),
    )
    for publisher, record in zip(publishers, records, strict=True):
        publisher.publish(to_bytes(record))
    if i % 10 == 9:  # some milliseconds' worth at a time
        time.sleep(max(0.0, begin + (i + 1) / rate - time.monotonic()))
print(count)
time.sleep(LAST)
rclpy.try_shutdown()
