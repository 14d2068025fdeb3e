"""Time of both models of the cut and of the stiffness model, beside a yardstick each.

``python -m bench.models [--rounds N] [--json]``, in this folder's parent. Model and yardstick take turns, so the ratio
is the same on a slow or a busy machine. The yardstick of the sweep is also an independent simulator of the paper's
case.
"""

import argparse
import json
import resource
import statistics
import time
from collections.abc import Callable
from math import ceil, cos, floor, pi, sin, sqrt

import numpy as np
from numba import njit

from kr270_milling import read_cell
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_model_of, cut_of, path_of
from kr270_milling.physics.motion.milling_pass import run_pass
from kr270_milling.physics.robot import equilibrium, stiffness
from kr270_milling.physics.robot.analysis import read_arm

PASSES = {"teeth": 1, "engagement": 9}  #: of the test piece in each round; a pass of the engagement takes some 20 ms
POSTURES = 1000


def plain_pass(cell: Cell, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The paper's case: the grid after the pass, and the deflections (steps, 2) [m]."""
    tool, spacing = cell.tool, cell.stock.grid_step
    grid = np.ones((int(cell.path.length / spacing) + 10, int(2.4 * tool.radius / spacing)), np.uint8)
    springs, mass = 1.0 / np.array([0.6369e-6, 0.7168e-6]), 790.4
    moved = _plain_pass(
        grid, spacing, tool.radius, tool.teeth, tool.spindle_speed, path_of(cell).feed_rate, steps,
        path_of(cell).clock.period / path_of(cell).clock.micro_steps, 5e9 * cell.path.depth_of_cut, springs, mass,
        0.38 * np.sqrt(springs * mass),
    )  # fmt: skip
    return grid, moved


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


def timed(job: Callable[[], object]) -> float:
    """Wall time [s]."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def posture_job() -> Callable[[], object]:
    """The calculation of pose, Jacobian, Hessian and loaded stiffness of POSTURES postures in one batch."""
    arm, mount = read_arm(find_file("paper.yaml"))
    around = np.radians([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])
    q = around + np.random.default_rng(1).uniform(-0.2, 0.2, (POSTURES, 6))
    wrench = np.tile([100.0, 200.0, -50.0, 1.0, 2.0, 3.0], (POSTURES, 1))
    return lambda: stiffness(equilibrium(arm, mount, q, wrench), arm)


def bench_models(rounds: int = 5) -> dict[str, float]:
    """Times of the paper's pass and of a posture, and medians of their ratios to the yardsticks.

    The yardsticks are the plain pass, and numpy's SVD of as many 6 x 6 matrices.
    """
    cell = read_cell("paper.yaml")
    first = timed(lambda: simulate(cell))  # may compile
    result = simulate(cell).result
    steps = result.micro_steps
    postures, matrices = posture_job(), np.random.default_rng(1).uniform(-1.0, 1.0, (POSTURES, 6, 6))
    plain_pass(cell, steps), postures()  # compiled
    rows = []
    for _ in range(rounds):
        wall = simulate(cell).result.wall_time  # of the pass alone, without workpiece and scores
        plain, batch = timed(lambda: plain_pass(cell, steps)), timed(postures)
        rows.append((wall, wall / plain, batch, batch / timed(lambda: np.linalg.svd(matrices))))
    wall, pass_ratio, batch, posture_ratio = map(statistics.median, zip(*rows, strict=True))
    return {
        "us_per_step": wall / steps * 1e6,
        "steps": steps,
        "real_time_factor": float(result.time[-1]) / wall,
        "first_pass_s": first,
        "pass_over_yardstick": pass_ratio,
        "us_per_posture": batch / POSTURES * 1e6,
        "postures_over_yardstick": posture_ratio,
        **bench_test_piece(rounds),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def bench_test_piece(rounds: int) -> dict[str, float]:
    """Machining time per processor time over the shipped test piece, by both models of the cut in turns."""
    cells = [read_cell("test_piece.yaml", f"cutting.detail={detail}") for detail in PASSES]
    target = path_of(cells[0]).target
    models = [arm_model_of(cell, target) for cell in cells]
    factors = []
    for _ in range(rounds + 1):  # the first round may compile
        of_round = []
        for cell, model, passes in zip(cells, models, PASSES.values(), strict=True):
            times = []
            for _ in range(passes):
                start = time.process_time()
                run_pass(model, cut_of(cell), path_of(cell).clock, target, target, cell.exchange.iterations)
                times.append(time.process_time() - start)
            of_round.append(target.duration_ns * 1e-9 / statistics.median(times))
        factors.append(of_round)
    teeth, engagement = zip(*factors[1:], strict=True)
    ratios = [mean / swept for swept, mean in factors[1:]]
    return {
        "teeth_real_time_factor": statistics.median(teeth),
        "engagement_real_time_factor": statistics.median(engagement),
        "engagement_over_teeth": statistics.median(ratios),
        "engagement_over_teeth_min": min(ratios),
        "engagement_over_teeth_max": max(ratios),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m bench.models", description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    times = bench_models(args.rounds)
    print(json.dumps(times) if args.json else "\n".join(f"{key:28} {value:.6g}" for key, value in times.items()))
