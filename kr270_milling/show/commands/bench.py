"""``kr270_milling bench``: the time of both models of the cut and of the stiffness model on this machine."""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable

from kr270_milling.base.parameter_file import find_file
from kr270_milling.show.commands.command import command
from kr270_milling.show.commands.console import Answer

__all__ = ["COMMANDS", "posture_job", "run_bench"]

REPEATS = 5
ROUNDS = 3
DETAILS = {"teeth": 1, "engagement": 9}  #: passes of each round
POSTURES = 1000
COMMANDS = {"bench": command("bench.run_bench", "bench")}


def run_bench(args) -> Answer:
    times = {**_pass(), **_details(), **_postures()}
    return Answer(times, [f"{key:27} {value:.6g}" for key, value in times.items()])


def _pass() -> dict:
    """The paper's pass, 1 deg micro-steps, 10 um grid; the first pass may compile."""
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.jobs import simulate

    cell = read_cell(find_file("paper.yaml"))
    start = time.perf_counter()
    result = simulate(cell).result
    first = time.perf_counter() - start
    wall = statistics.median(simulate(cell).result.wall_time for _ in range(REPEATS))
    return {
        "us_per_step": wall / result.micro_steps * 1e6,
        "steps": result.micro_steps,
        "pass_wall_s": wall,
        "real_time_factor": float(result.time[-1]) / wall,
        "first_pass_s": first,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _details() -> dict:
    """Machining time per processor time of a pass over the shipped test piece, by both models of the cut in turns.

    A pass of the mean-force model takes some 20 ms, so the median of several counts.
    """
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.physics.motion.milling_pass import run_pass

    cells = [read_cell(find_file("test_piece.yaml"), [f"cutting.detail={detail}"]) for detail in DETAILS]
    target = cells[0].target()
    models = [cell.arm_model(target) for cell in cells]
    rounds = []
    for _ in range(ROUNDS + 1):  # the first one may compile
        seconds = []
        for cell, model, passes in zip(cells, models, DETAILS.values(), strict=True):
            times = []
            for _ in range(passes):
                start = time.process_time()
                run_pass(model, cell.cut(), cell.clock, target, target, cell.exchange.iterations)
                times.append(time.process_time() - start)
            seconds.append(statistics.median(times))
        rounds.append(seconds)
    machining = target.duration_ns * 1e-9
    teeth, engagement = (statistics.median(machining / one for one in each) for each in zip(*rounds[1:], strict=True))
    ratios = sorted(swept / mean for swept, mean in rounds[1:])
    return {
        "teeth_real_time_factor": teeth,
        "engagement_real_time_factor": engagement,
        "engagement_over_teeth": statistics.median(ratios),
        "engagement_over_teeth_min": ratios[0],
        "engagement_over_teeth_max": ratios[-1],
    }


def posture_job() -> Callable[[], object]:
    """The calculation of pose, Jacobian, Hessian and loaded stiffness of POSTURES postures in one batch."""
    import numpy as np

    from kr270_milling.physics.robot import equilibrium, stiffness
    from kr270_milling.physics.robot.analysis import read_arm

    arm, mount = read_arm(find_file("paper.yaml"))
    around = np.radians([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])
    q = around + np.random.default_rng(1).uniform(-0.2, 0.2, (POSTURES, 6))
    wrench = np.tile([100.0, 200.0, -50.0, 1.0, 2.0, 3.0], (POSTURES, 1))
    return lambda: stiffness(equilibrium(arm, mount, q, wrench), arm)


def _postures() -> dict:
    job = posture_job()
    job()
    walls = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        job()
        walls.append(time.perf_counter() - start)
    return {"us_per_posture": statistics.median(walls) / POSTURES * 1e6}
