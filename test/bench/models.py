"""Sweep and stiffness model beside a yardstick each: ``python -m bench.models [ROUNDS]``, in this folder's parent.

Model and yardstick take turns, so the ratio is the same on a slow or a busy machine.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from bench.plain_pass import plain_pass
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.show.commands.bench import POSTURES, posture_job

__all__ = ["bench_models"]


def timed(job: Callable[[], object]) -> float:
    """Wall time [s]."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def bench_models(rounds: int = 5) -> dict[str, float]:
    """Medians of the ratios to the yardsticks: the plain pass, and numpy's SVD of as many 6 x 6 matrices."""
    cell = read_cell(find_file("paper.yaml"))
    steps = simulate(cell).result.micro_steps
    postures, matrices = posture_job(), np.random.default_rng(1).uniform(-1.0, 1.0, (POSTURES, 6, 6))
    plain_pass(cell, steps), postures()  # compiled
    ratios: dict[str, list[float]] = {"pass_over_yardstick": [], "postures_over_yardstick": []}
    for _ in range(rounds):
        wall = simulate(cell).result.wall_time  # of the pass alone, without workpiece and scores
        ratios["pass_over_yardstick"].append(wall / timed(lambda: plain_pass(cell, steps)))
        ratios["postures_over_yardstick"].append(timed(postures) / timed(lambda: np.linalg.svd(matrices)))
    return {key: statistics.median(values) for key, values in ratios.items()}


if __name__ == "__main__":
    for key, value in bench_models(int(sys.argv[1]) if len(sys.argv) > 1 else 5).items():
        print(f"{key:28} {value:.3f}")
