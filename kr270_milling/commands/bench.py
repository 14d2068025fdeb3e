"""``kr270_milling bench``: how fast the sweep of the teeth and the stiffness model are, beside a yardstick each.

The yardstick is timed in the same minutes, by turns, so that the ratio says the same on a slow or a busy machine.
"""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable
from math import ceil, cos, floor, pi, sin, sqrt

import numpy as np
from numba import njit

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.commands.console import Answer
from kr270_milling.robot import equilibrium, stiffness
from kr270_milling.robot.analysis import read_arm

REPEATS = 5
POSTURES = 1000
#: ratio to its yardstick up to which a model is as fast as it was when this was written, with room for the machine
USUAL = {"pass": 0.9, "postures": 3.0}


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
    walls: tuple[list[float], list[float]] = ([], [])
    for _ in range(REPEATS + 1):
        for job, found in zip((ours, yardstick), walls, strict=True):
            start = time.perf_counter()
            job()
            found.append(time.perf_counter() - start)
    return statistics.median(walls[0][1:]), statistics.median(walls[1][1:])


def _pass() -> dict:
    """The paper's pass, 1 deg micro-steps, 10 um grid."""
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
    tool, spacing = cell.tool, cell.stock.grid_step
    grid = np.ones((int(cell.path.length / spacing) + 10, int(2.4 * tool.radius / spacing)), np.uint8)
    springs, mass = 1.0 / np.array([0.6369e-6, 0.7168e-6]), 790.4
    moved = _plain_pass(
        grid, spacing, tool.radius, tool.teeth, tool.spindle_speed, cell.feed_rate, steps,
        cell.clock.period / cell.clock.micro_steps, 5e9 * cell.path.depth_of_cut, springs, mass,
        0.38 * np.sqrt(springs * mass),
    )  # fmt: skip
    return grid, moved


def _postures() -> dict:
    """Pose, Jacobian, Hessian and loaded stiffness of 1000 postures in one batch."""
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


@njit(cache=True, error_model="numpy", fastmath=True)
def _sector(grid, spacing, tool_x, tool_y, radius, inner, angle, turn):
    """Clear the nodes that a tooth sweeps from angle - turn to angle; how many there were."""
    c1, s1, c0, s0 = cos(angle), -sin(angle), cos(angle - turn), -sin(angle - turn)
    left, right = min(c0, c1), max(c0, c1)
    below, above = min(s0, s1), max(s0, s1)
    first = max(0, int(floor((tool_x + min(left * radius, left * inner)) / spacing)) - 1)
    last = min(grid.shape[0], int(ceil((tool_x + max(right * radius, right * inner)) / spacing)) + 1)
    count = 0
    for p in range(first, last):
        dx = (p + 0.5) * spacing - tool_x
        reach = radius * radius - dx * dx
        if reach < 0.0:
            continue
        high = sqrt(reach)
        low = -high
        if c0 > 0.0:
            high = min(high, s0 * dx / c0)
        elif c0 < 0.0:
            low = max(low, s0 * dx / c0)
        if c1 > 0.0:
            low = max(low, s1 * dx / c1)
        elif c1 < 0.0:
            high = min(high, s1 * dx / c1)
        low = max(low, min(below * radius, below * inner))
        high = min(high, max(above * radius, above * inner))
        a = max(0, int(ceil((tool_y + low) / spacing - 0.5)))
        b = min(grid.shape[1] - 1, int(floor((tool_y + high) / spacing - 0.5)))
        for q in range(a, b + 1):
            count += grid[p, q]
            grid[p, q] = 0
    return count


@njit(cache=True, error_model="numpy", fastmath=True)
def _plain_pass(grid, spacing, radius, teeth, omega, feed, steps, step, slope, springs, mass, damping):
    """Steps of ``step`` [s] into a grid (nx, ny) of ones, along its middle; the deflections (steps, 2) [m].

    slope [N/m]: of the force over the chip thickness; springs (2,) [N/m], mass [kg], damping (2,) [N s/m].
    """
    turn, middle = omega * step, 0.5 * spacing * grid.shape[1]
    x, v, a, force = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    out = np.empty((steps, 2))
    for n in range(steps):
        force[:] = 0.0
        for tooth in range(teeth):
            angle = omega * step * n + 2.0 * pi * tooth / teeth
            tool_x = feed * step * n - radius + x[0]
            count = _sector(grid, spacing, tool_x, middle + x[1], radius, radius - 3e-4, angle, turn)
            if count:
                chip = count * spacing * spacing / (radius * turn * 1.8e-5)
                tangential = slope * 1.8e-5 * (chip + 0.1 * chip * chip) / (1.0 + chip)
                force[0] += -0.3 * tangential * cos(angle) + tangential * sin(angle)
                force[1] += 0.3 * tangential * sin(angle) + tangential * cos(angle)
        for d in range(2):
            drift = x[d] + step * v[d] + 0.25 * step * step * a[d]
            rest = force[d] - damping[d] * (v[d] + 0.5 * step * a[d]) - springs[d] * drift
            new = rest / (mass + 0.5 * step * damping[d] + 0.25 * step * step * springs[d])
            x[d] = drift + 0.25 * step * step * new
            v[d] += 0.5 * step * (a[d] + new)
            a[d] = new
            out[n, d] = x[d]
    return out
