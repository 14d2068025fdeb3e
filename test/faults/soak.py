"""Long runs: many passes in one graph, and a long recording. Memory, threads and files must not grow."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from faults.trials import fault_cell
from kr270_milling.base.samples import PoseSample, TwistSample, WrenchSample
from kr270_milling.live.graph.driver import Driver
from kr270_milling.live.graph.graph import Graph
from kr270_milling.live.graph.processes import Child, RunError, stop
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.environment import keep_to_this_host
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import to_bytes

COLUMNS = ("process", "samples", "memory [MB]", "growth [MB]", "slope", "threads", "file handles")
SETTLED = 0.5  # share of the run after which everything has been allocated once; queues keep their longest length
MOST_GROWTH = 5.0  # [MB] from then to the end, by the fitted slope
TOPICS = ("tool_pose", "wrench", "deflection")  # of an exchange
RATE = 2000  # [1/s] exchanges, as with the default period in real time
STEP_NS = 500_000  # default period
AT_ONCE = 1000  # exchanges between two looks at the recorder
PATIENCE, LAST = 120.0, 1.0  # [s] for the recorder to start on a busy machine, and to take the last messages


@dataclass
class Growth:
    """One process over a run."""

    name: str
    unit: str  #: of the times: "pass", or "s"
    #: time, memory that no other process shares [MB], threads, open handles
    samples: list[tuple[float, float, int, int]] = field(default_factory=list)
    lost: int = 0  #: messages that are not in the recording

    def look(self, at: float, pid: int) -> None:
        process = psutil.Process(pid)
        memory = process.memory_full_info().uss * 1e-6
        self.samples.append((at, memory, process.num_threads(), process.num_fds()))

    @property
    def _steady(self) -> np.ndarray:
        return np.array(self.samples[min(int(SETTLED * len(self.samples)), len(self.samples) - 2) :])

    @property
    def slope(self) -> float:
        """[MB] a pass or a second, of the steady part."""
        return float(np.polyfit(*self._steady[:, :2].T, 1)[0])

    @property
    def growth(self) -> float:
        """[MB] in the steady part, by its slope."""
        return self.slope * float(np.ptp(self._steady[:, 0]))

    @property
    def problems(self) -> list[str]:
        if len(self.samples) < 2:
            return ["has fewer than two samples"]
        problems, steady = [], self._steady
        if self.growth > MOST_GROWTH:
            problems.append(f"memory grew by {self.growth:.1f} MB, more than {MOST_GROWTH:g}")
        for what, (first, last) in zip(("threads", "files"), steady[[0, -1], 2:].T, strict=True):
            if last > first:
                problems.append(f"{what} grew from {first:.0f} to {last:.0f}")
        return problems + ([f"{self.lost} messages are not in the recording"] if self.lost else [])

    def cells(self) -> list[str]:
        """As text, in the order of COLUMNS; from the middle to the end of the run."""
        memory, threads, files = (f"{first:.4g} -> {last:.4g}" for first, last in self._steady[[0, -1], 1:].T)
        slope = f"{self.slope * 1000:+.2f} kB/{self.unit}"
        return [self.name, str(len(self.samples)), memory, f"{self.growth:+.2f}", slope, threads, files]


def run_soak(passes: int, seconds: float, out: Path) -> list[Growth]:
    """A row for each process. Recordings of the passes are removed after each pass."""
    keep_to_this_host()
    return [*_passes(passes, out), _long_recording(seconds, out / "long")]


def _passes(count: int, out: Path) -> list[Growth]:
    with Graph(fault_cell(), out, composed=True) as graph:
        pids = {child.name: child.pid for child in graph.children.values()} | {"runner": os.getpid()}
        rows = {name: Growth(name, "pass") for name in pids}
        for number in range(1, count + 1):
            recording = graph.run_pass(f"pass_{number}").recording
            for name, pid in pids.items():
                rows[name].look(number, pid)
            for file in recording.glob("*"):
                file.unlink()
    return list(rows.values())


def _long_recording(seconds: float, out: Path) -> Growth:
    """The exchange's three topics at the rate of a pass in real time."""
    growth, driver = Growth("recorder (one long recording)", "s"), Driver("", lambda: None)
    words = ["--ros-args", "-p", f"directory:={out}", "-p", f"topics:={','.join(TOPICS)}"]
    recorder, count = Child(("recorder",), words, out.parent), round(RATE * seconds)
    publishers = [driver.node.create_publisher(*topics.BY_NAME[name]) for name in TOPICS]
    try:
        driver.until(lambda: all(p.get_subscription_count() for p in publishers), "discovery", PATIENCE)
        begin, random, down = time.monotonic(), np.random.default_rng(0), np.array([1.0, 0.0, 0.0, 0.0])
        for i in range(count):
            row, about = random.normal(0.0, 50.0, 6), (i * STEP_NS, "workpiece")
            records = PoseSample(*about, row[:3], down), WrenchSample(*about, row), TwistSample(*about, row)
            for publisher, record in zip(publishers, records, strict=True):
                publisher.publish(to_bytes(record))
            if i % AT_ONCE == 0:
                if not recorder.alive:
                    raise RunError("recorder", recorder.why_ended())
                growth.look(time.monotonic() - begin, recorder.pid)
            if i % 10 == 9:  # some milliseconds' worth at a time
                time.sleep(max(0.0, begin + i / RATE - time.monotonic()))
        time.sleep(LAST)
    finally:
        stop([recorder])
        driver.node.destroy_node()
        driver.node.context.try_shutdown()
    with Recording(out) as recording:
        growth.lost = count * len(TOPICS) - recording.count
    return growth
