"""Long runs: many passes in one graph, and a long recording. Memory, threads and files must not grow."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from faults.rows import fault_cell
from kr270_milling.live.graph.graph import Graph
from kr270_milling.live.graph.processes import RunError
from kr270_milling.live.ros.environment import child_environment
from kr270_milling.recordings.bag.reader import Recording

__all__ = ["COLUMNS", "Footprint", "Growth", "footprint", "run_soak"]

COLUMNS = ("process", "samples", "memory [MB]", "growth [MB]", "slope", "shared [MB]", "threads", "file handles")
SETTLED = 0.5  # share of the run after which everything has been allocated once; queues keep their longest length
MOST_GROWTH = 5.0  # [MB] from then to the end, by the fitted slope
TOPICS = ("tool_pose", "wrench", "deflection")  # of an exchange
RATE = 2000  # [1/s] exchanges, as with the default period in real time
LOOK = 0.5  # [s] between two looks at the recorder
PATIENCE = 120.0  # [s] for a process to start or to end, on a busy machine too


@dataclass(frozen=True)
class Footprint:
    """Of one process at one time."""

    memory_mb: float  #: resident and its own
    shared_mb: float  #: resident pages of shared memory: at most the segments of the middleware, which all nodes share
    threads: int
    files: int  #: open handles


def footprint(pid: int) -> Footprint:
    """Raises OSError where there is no such process."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    values = dict(line.split(":", 1) for line in lines if ":" in line)
    resident, shared = (float(values[key].split()[0]) / 1024 for key in ("VmRSS", "RssShmem"))
    return Footprint(resident - shared, shared, int(values["Threads"]), len(os.listdir(f"/proc/{pid}/fd")))


def slope(times, values) -> float:
    """Of the straight line with the least squares [unit of the values per unit of the times]."""
    times, values = np.asarray(times, float), np.asarray(values, float)
    around = times - times.mean()
    return float(around @ (values - values.mean()) / max(around @ around, 1e-300))


@dataclass
class Growth:
    """One process over a run; the times are numbers of passes, or seconds."""

    name: str
    unit: str
    times: list[float] = field(default_factory=list)
    samples: list[Footprint] = field(default_factory=list)
    lost: int = 0  #: messages that are not in the recording

    def look(self, at: float, pid: int) -> None:
        self.times.append(at)
        self.samples.append(footprint(pid))

    @property
    def _steady(self) -> slice:
        return slice(max(0, min(int(SETTLED * len(self.samples)), len(self.samples) - 2)), None)

    @property
    def slope(self) -> float:
        """[MB] a pass or a second, of the steady part."""
        return slope(self.times[self._steady], [s.memory_mb for s in self.samples[self._steady]])

    @property
    def growth(self) -> float:
        """[MB] in the steady part, by its slope."""
        times = self.times[self._steady]
        return self.slope * (times[-1] - times[0])

    @property
    def problems(self) -> list[str]:
        if len(self.samples) < 2:
            return ["has fewer than two samples"]
        problems, steady = [], self.samples[self._steady]
        if self.growth > MOST_GROWTH:
            problems.append(f"memory grew by {self.growth:.1f} MB, more than {MOST_GROWTH:g}")
        for what in ("threads", "files"):
            first, last = getattr(steady[0], what), getattr(steady[-1], what)
            if last > first:
                problems.append(f"{what} grew from {first} to {last}")
        return problems + ([f"{self.lost} messages are not in the recording"] if self.lost else [])

    def cells(self) -> list[str]:
        """As text, in the order of COLUMNS; from the middle to the end of the run."""
        a, b = self.samples[self._steady][0], self.samples[-1]
        return [
            self.name, str(len(self.samples)), f"{a.memory_mb:.1f} -> {b.memory_mb:.1f}", f"{self.growth:+.2f}",
            f"{self.slope * 1000:+.2f} kB/{self.unit}", f"{a.shared_mb:.1f} -> {b.shared_mb:.1f}",
            f"{a.threads} -> {b.threads}", f"{a.files} -> {b.files}",
        ]  # fmt: skip


def run_soak(passes: int, seconds: float, out: Path, progress: Callable[[int, int], None]) -> list[Growth]:
    """A row for each process. Recordings of the passes are removed after each pass."""
    share = passes * 5  # [s]
    total = int(share + seconds)
    rows = _passes(passes, out, lambda done: progress(int(done * 5), total))
    rows.append(_long_recording(seconds, out / "long", lambda done: progress(int(share + done), total)))
    return rows


def _passes(count: int, out: Path, progress: Callable[[float], None]) -> list[Growth]:
    with Graph(fault_cell(), out, composed=True) as graph:
        pids = {child.name: child.pid for child in graph.children.values()} | {"runner": os.getpid()}
        rows = {name: Growth(name, "pass") for name in pids}
        for number in range(1, count + 1):
            recording = graph.run_pass(f"pass_{number}").recording
            for name, pid in pids.items():
                rows[name].look(number, pid)
            for file in recording.glob("*"):
                file.unlink()
            progress(number)
    return list(rows.values())


def _long_recording(seconds: float, out: Path, progress: Callable[[float], None]) -> Growth:
    """The exchange's three topics at the rate of a pass in real time."""
    growth = Growth("recorder (one long recording)", "s")
    environment = child_environment()
    names = ",".join(TOPICS)
    node = [sys.executable, "-m", "kr270_milling.live.nodes", "recorder", "--ros-args", "-p", f"directory:={out}"]
    source = [sys.executable, str(Path(__file__).with_name("source.py")), str(RATE), str(seconds)]
    with (
        open(out.parent / "recorder.log", "wb") as log,
        subprocess.Popen([*node, "-p", f"topics:={names}"], env=environment, stderr=log) as recorder,
    ):
        try:
            with subprocess.Popen(source, env=environment, stdout=subprocess.PIPE, text=True) as sending:
                try:
                    _watch(sending, recorder, growth, seconds, progress)
                    sent = sending.communicate(timeout=PATIENCE)[0]
                finally:
                    sending.kill()
        finally:
            recorder.send_signal(signal.SIGINT)
            recorder.wait(PATIENCE)
    with Recording(out) as recording:
        growth.lost = int(sent) * len(TOPICS) - recording.count
    return growth


def _watch(sending, recorder, growth: Growth, seconds: float, progress: Callable[[float], None]) -> None:
    begin = time.monotonic()
    while sending.poll() is None:
        now = time.monotonic() - begin
        if recorder.poll() is not None or now > 2 * seconds + PATIENCE:
            sending.kill()
            raise RunError("recorder", "has ended" if recorder.poll() is not None else "the source does not end")
        growth.look(now, recorder.pid)
        progress(min(now, seconds))
        time.sleep(LOOK)
