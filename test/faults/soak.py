"""A long run: many passes in one graph. Memory, threads and files must not grow."""

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from faults.trials import fault_cell
from kr270_milling.live.graph import Graph
from kr270_milling.live.ros.environment import keep_to_this_host

COLUMNS = ("process", "samples", "memory [MB]", "growth [MB]", "slope", "threads", "file handles")
SETTLED = 0.5  # share of the run after which everything has been allocated once; queues keep their longest length
MOST_GROWTH = 5.0  # [MB] from then to the end, by the fitted slope


@dataclass
class Growth:
    """One process over a run."""

    name: str
    #: pass, memory that no other process shares [MB], threads, open handles
    samples: list[tuple[int, float, int, int]] = field(default_factory=list)

    def look(self, number: int, pid: int) -> None:
        process = psutil.Process(pid)
        memory = process.memory_full_info().uss * 1e-6
        self.samples.append((number, memory, process.num_threads(), process.num_fds()))

    @property
    def _steady(self) -> np.ndarray:
        return np.array(self.samples[min(int(SETTLED * len(self.samples)), len(self.samples) - 2) :])

    @property
    def slope(self) -> float:
        """[MB] a pass, of the steady part."""
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
        return problems

    def cells(self) -> list[str]:
        """As text, in the order of COLUMNS; from the middle to the end of the run."""
        memory, threads, files = (f"{first:.4g} -> {last:.4g}" for first, last in self._steady[[0, -1], 1:].T)
        slope = f"{self.slope * 1000:+.2f} kB/pass"
        return [self.name, str(len(self.samples)), memory, f"{self.growth:+.2f}", slope, threads, files]


def run_soak(count: int, out: Path) -> list[Growth]:
    """A row for each process over some passes. The recordings are removed after each pass."""
    keep_to_this_host()
    with Graph(fault_cell(), out, composed=True) as graph:
        pids = {child.name: child.pid for child in graph.children.values()} | {"runner": os.getpid()}
        rows = {name: Growth(name) for name in pids}
        for number in range(1, count + 1):
            recording, *_ = graph.run_pass(f"pass_{number}")
            for name, pid in pids.items():
                rows[name].look(number, pid)
            for file in recording.glob("*"):
                file.unlink()
    return list(rows.values())
