"""``kr270_milling bench``: how fast the sweep of the teeth and the stiffness model are, beside a yardstick each.

The yardstick is timed in the same minutes, by turns, so that the ratio says the same on a slow or a busy machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from kr270_milling.commands.console import Answer

if TYPE_CHECKING:
    import numpy as np

    from kr270_milling.cell.cell import Cell

REPEATS = 5
POSTURES = 1000
#: ratio to its yardstick up to which a model is as fast as it was when this was written, with room for the machine
USUAL = {"pass": 0.9, "postures": 3.0}


def add_arguments(parser) -> None:
    """It has no options."""


def run(args) -> Answer:
    found = {**_pass(), **_postures()}
    slow = [what for what, most in USUAL.items() if found[f"{what}_over_yardstick"] > most]
    found["verdict"] = f"slower than usual: {', '.join(slow)}" if slow else "as fast as usual"
    shown = [f"{key:36} {value if isinstance(value, str) else format(value, '.6g')}" for key, value in found.items()]
    usual = ", ".join(f"{most:g} ({what})" for what, most in USUAL.items())
    return Answer(found, [
        *shown,
        "yardsticks: a plain milling pass, compiled; numpy's SVD of as many 6 x 6 matrices. A ratio below 1 is",
        f"quicker than the yardstick; usual are ratios up to {usual}.",
    ])  # fmt: skip


def _turns(ours: Callable[[], object], yardstick: Callable[[], object]) -> tuple[float, float]:
    """Median wall times [s] of both, by turns, after one turn to warm up."""
    import statistics

    walls: tuple[list[float], list[float]] = ([], [])
    for _ in range(REPEATS + 1):
        for job, found in zip((ours, yardstick), walls, strict=True):
            start = time.perf_counter()
            job()
            found.append(time.perf_counter() - start)
    return statistics.median(walls[0][1:]), statistics.median(walls[1][1:])


def _pass() -> dict:
    """The paper's pass, 1 deg micro-steps, 10 um grid."""
    import resource
    import statistics

    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.jobs import simulate

    cell = read_cell(find_file("paper.yaml"))
    start = time.perf_counter()
    result = simulate(cell).result
    first = time.perf_counter() - start
    walls = []
    job, yardstick = _turns(
        lambda: walls.append(simulate(cell).result.wall_time), lambda: plain(cell, result.micro_steps)
    )
    wall = statistics.median(walls[1:])  # of the pass alone: the yardstick neither makes its workpiece nor scores
    return {
        "us_per_step": wall / result.micro_steps * 1e6,
        "steps": result.micro_steps,
        "pass_wall_s": wall,
        "job_wall_s": job,
        "pass_yardstick_s": yardstick,
        "pass_over_yardstick": wall / yardstick,
        "real_time_factor": float(result.time[-1]) / wall,
        "first_pass_s": first,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def plain(cell: Cell, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The same case by the plain pass: the grid that it leaves, and its deflections (steps, 2) [m]."""
    import numpy as np

    from kr270_milling.commands.plain_pass import plain_pass

    tool, spacing = cell.tool, cell.stock.grid_step
    grid = np.ones((int(cell.path.length / spacing) + 10, int(2.4 * tool.radius / spacing)), np.uint8)
    stiffness, mass = 1.0 / np.array([0.6369e-6, 0.7168e-6]), 790.4
    moved = plain_pass(
        grid, spacing, tool.radius, tool.teeth, tool.spindle_speed, cell.feed_rate, steps,
        cell.clock.period / cell.clock.micro_steps, 5e9 * cell.path.depth_of_cut, stiffness, mass,
        0.38 * np.sqrt(stiffness * mass),
    )  # fmt: skip
    return grid, moved


def _postures() -> dict:
    """Pose, Jacobian, Hessian and loaded stiffness of 1000 postures in one batch."""
    import numpy as np

    from kr270_milling.base.record import find_file
    from kr270_milling.robot import equilibrium, stiffness
    from kr270_milling.robot.analysis import read_arm

    arm, mount = read_arm(find_file("paper.yaml"))
    around = np.radians([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])
    rng = np.random.default_rng(1)
    q = around + rng.uniform(-0.2, 0.2, (POSTURES, 6))
    wrench = np.tile([100.0, 200.0, -50.0, 1.0, 2.0, 3.0], (POSTURES, 1))
    matrices = rng.uniform(-1.0, 1.0, (POSTURES, 6, 6))
    wall, yardstick = _turns(
        lambda: stiffness(equilibrium(arm, mount, q, wrench), arm), lambda: np.linalg.svd(matrices)
    )
    return {"us_per_posture": wall / POSTURES * 1e6, "postures_over_yardstick": wall / yardstick}
