"""Exchanges a second of the graph, beside bare round trips of the same minute: ``python -m bench.exchanges``.

Each round runs every composition once, in another order: bare trips; one process a node; robot and cut in one process,
compensator and recorder in another; with a recording and without. Printed: smallest, median and largest of the rounds,
and the medians over the bare rate.

A bare trip: a pose as bytes from one process (``bench.exchanges ask COUNT``), a wrench as bytes from the other one
(``bench.exchanges answer``), the executor, the topics and the profile of the graph, nothing computed.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

from kr270_milling import read_cell
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph import Graph
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.environment import child_environment, keep_to_this_host
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.topics import CUT, RECORDER

TRIPS = 4000
HERE = Path(__file__).resolve().parents[1]
POSE = topics.TOOL_POSE, to_bytes(PoseSample(0, "workpiece", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
WRENCH = topics.WRENCH, to_bytes(WrenchSample(0, "workpiece", np.zeros(6)))
WARM = 200  # trips before the clock runs


class Unrecorded(Graph):
    """A graph without a recorder."""

    def begin_recording(self, name: str) -> None: ...

    def end_recording(self) -> None:
        for transition in ("cleanup", "configure"):
            self.driver.transition(transition, CUT, deadline=60.0)


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


def trips(name: str, count: float = float("inf")) -> None:
    """``ask`` prints trips a second."""
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


def bare(*on: str) -> float:
    """Round trips a second of two processes that compute nothing; on: a command line that starts both."""
    environment = child_environment() | {"PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    command = [*on, sys.executable, "-m", "bench.exchanges"]
    with subprocess.Popen([*command, "answer"], env=environment) as other:
        try:
            return float(subprocess.check_output([*command, "ask", str(TRIPS)], env=environment, timeout=120))
        finally:
            other.kill()


def exchanges(cell, kind: type[Graph], composed: bool, passes: int = 2) -> float:
    """The best of some passes of a fresh graph; each recording must be whole and recompute to the bit."""
    rates = []
    with tempfile.TemporaryDirectory() as directory, kind(cell, Path(directory), composed=composed) as graph:
        for number in range(passes):
            recording, wall, *_ = graph.run_pass(f"pass_{number + 1}")
            rates.append(path_of(cell).clock.steps(path_of(cell).target.duration_ns) / wall)
            if kind is Graph:
                lost = pass_from_recording(recording)[1].messages_lost
                again = None if number else recompute(recording)
                if lost or (again and again.verdict != "identical"):
                    raise RuntimeError(f"{RECORDER}: {lost} messages lost; recomputed: {again}")
    return max(rates)


def bench_exchanges(rounds: int = 5) -> dict[str, list[float]]:
    """Rates of each composition, one a round [1/s]."""
    cell = read_cell("paper.yaml")
    kinds = {
        "bare round trips": bare,
        "bare, on one core": lambda: bare("taskset", "-c", "0"),  # where ``run`` keeps robot and cut
        "separate, recorded": lambda: exchanges(cell, Graph, composed=False),
        "separate, not recorded": lambda: exchanges(cell, Unrecorded, composed=False),
        "composed, recorded": lambda: exchanges(cell, Graph, composed=True),
        "composed, not recorded": lambda: exchanges(cell, Unrecorded, composed=True),
    }
    rates: dict[str, list[float]] = {name: [] for name in kinds}
    for number in range(rounds):
        for name in list(kinds) if number % 2 == 0 else reversed(kinds):
            rates[name].append(kinds[name]())
    return rates


def print_table(rates: dict[str, list[float]]) -> None:
    yardstick = statistics.median(rates["bare round trips"])
    print(f"{'a second':24} {'min':>7} {'median':>7} {'max':>7} {'over bare':>10}")
    for name, values in rates.items():
        middle = statistics.median(values)
        print(f"{name:24} {min(values):7.0f} {middle:7.0f} {max(values):7.0f} {middle / yardstick:10.2f}")


if __name__ == "__main__":
    if sys.argv[1:2] in (["ask"], ["answer"]):
        trips(*sys.argv[1:])
    else:
        print_table(bench_exchanges(*map(int, sys.argv[1:])))
