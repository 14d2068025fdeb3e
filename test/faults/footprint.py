"""What a process holds: memory, threads, open files; and how these develop."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["Footprint", "footprint", "slope"]


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
