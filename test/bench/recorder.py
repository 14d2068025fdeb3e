"""How fast the recorder and its writer are, beside mcap's own writer: ``python -m bench.recorder``, in ``test``.

``python recorder.py RATE COUNT SIZE`` publishes messages of one size. RATE 0: as fast as possible. SIZE 0: poses.
"""

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from kr270_milling.base.samples import PoseSample, StockMap
from kr270_milling.live.ros.environment import child_environment, keep_to_this_host
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.definitions import definition

SMALL_RATE, SMALL_SECONDS = 20_000, 10.0  # messages a second; seconds
LARGE, LARGE_COUNT = 1_000_000, 1000  # bytes; messages
WAIT = 20  # [s] of the publisher for the recorder
POSE, GRID = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/OccupancyGrid"


def recorded(out: Path, rate: int, count: int, size: int) -> tuple[float, float, int]:
    """Seconds to send the messages, seconds until they were written, messages that are lost."""
    node = [sys.executable, "-m", "kr270_milling.live.nodes", "recorder", "--ros-args", "-p", f"directory:={out}"]
    source = [sys.executable, __file__, str(rate), str(count), str(size)]
    quiet = {"env": child_environment(), "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*node, "-p", "topics:=bench"], **quiet) as recorder:
        try:
            printed = subprocess.run(source, stdout=subprocess.PIPE, text=True, timeout=120, check=True, **quiet).stdout
        finally:
            recorder.send_signal(signal.SIGINT)
    begin, seconds = map(float, printed.split())
    with Recording(out) as recording:
        written = recording.path.stat().st_mtime - begin
        return seconds, written, count - recording.topics()["/bench"].count


def publish(rate: int, count: int, size: int) -> None:
    """Prints when it began [s of the wall clock] and how many seconds it took; ends when the recorder has all."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import OccupancyGrid
    from rclpy.duration import Duration
    from rclpy.qos import HistoryPolicy, QoSProfile

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


def plain_writer(file: Path, type_name: str, bodies: list[bytes]) -> float:
    """Seconds of mcap's writer."""
    with open(file, "wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(type_name, "ros2msg", definition(type_name).encode())
        channel = writer.register_channel("/t", "cdr", schema)
        begin = time.perf_counter()
        for i, data in enumerate(bodies):
            writer.add_message(channel, i, data, i)
        writer.finish()
    return time.perf_counter() - begin


def bag_writer(file: Path, type_name: str, bodies: list[bytes]) -> float:
    """Seconds of BagWriter."""
    with BagWriter(file) as writer:
        writer.add_topic("/t", type_name)
        begin = time.perf_counter()
        for i, data in enumerate(bodies):
            writer.write("/t", data, i)
        writer.close()
    return time.perf_counter() - begin


def bench_writer(small: int = 100_000, large: int = 200) -> dict[str, float]:
    """Small messages a second and MB/s of 1 MB messages, of mcap's writer ("plain") and of BagWriter ("bag")."""
    poses, grids = bodies(small, 0), bodies(large, LARGE)
    rates: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as directory:
        for name, run in (("plain", plain_writer), ("bag", bag_writer)):
            rates[f"{name}_small_per_s"] = small / run(Path(directory, f"{name}_small"), POSE, poses)
            rates[f"{name}_large_mb_per_s"] = large / run(Path(directory, f"{name}_large"), GRID, grids)
    return rates


def main() -> None:
    rates, count = bench_writer(), round(SMALL_RATE * SMALL_SECONDS)
    with tempfile.TemporaryDirectory() as directory:
        seconds, _, lost = recorded(Path(directory, "small"), SMALL_RATE, count, 0)
        rates |= {"recorder_small_per_s": count / seconds, "recorder_small_lost": lost}
        _, seconds, lost = recorded(Path(directory, "large"), 0, LARGE_COUNT, LARGE)  # at full speed
        rates |= {"recorder_large_mb_per_s": (LARGE_COUNT - lost) * LARGE * 1e-6 / seconds, "recorder_large_lost": lost}
    rates["recorder_large_share_of_plain"] = rates["recorder_large_mb_per_s"] / rates["plain_large_mb_per_s"]
    for key, value in rates.items():
        print(f"{key:32} {value:.4g}")


if __name__ == "__main__":
    publish(*map(int, sys.argv[1:])) if len(sys.argv) > 1 else main()
