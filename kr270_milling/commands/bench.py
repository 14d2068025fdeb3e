"""``kr270_milling bench``: how fast the sweep of the teeth and the stiffness model are, after warm-up."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, print_json

REPEATS = 5
POSTURES = 1000


def add_arguments(parser) -> None:
    add_common(parser)


def run(args) -> None:
    found = {**_pass(), **_postures()}
    if args.json:
        print_json(found)
        return
    for key, value in found.items():
        print(f"{key:36} {value:.6g}" if isinstance(value, (int, float)) else f"{key:36} {value}")


def _pass() -> dict:
    """The paper's pass, 1 deg micro-steps, 10 um grid: median of five after one to warm up."""
    import resource
    import statistics
    import time

    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.jobs import simulate

    cell = read_cell(find_file("paper.yaml"))
    start = time.perf_counter()
    simulate(cell)
    first = time.perf_counter() - start
    results = [simulate(cell).result for _ in range(REPEATS)]
    wall = statistics.median(r.wall_time for r in results)
    steps = results[0].micro_steps
    return {
        "us_per_step": wall / steps * 1e6,
        "steps": steps,
        "pass_wall_s": wall,
        "real_time_factor": float(results[0].time[-1]) / wall,
        "first_pass_s": first,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _postures() -> dict:
    """Pose, Jacobian, Hessian and loaded stiffness of 1000 postures in one batch: median of five."""
    import statistics
    import time

    import numpy as np

    from kr270_milling.base.record import find_file
    from kr270_milling.robot import loaded_stiffness
    from kr270_milling.robot.analysis import read_arm

    arm, mount = read_arm(find_file("paper.yaml"))
    around = np.radians([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])
    q = around + np.random.default_rng(1).uniform(-0.2, 0.2, (POSTURES, 6))
    wrench = np.tile([100.0, 200.0, -50.0, 1.0, 2.0, 3.0], (POSTURES, 1))
    walls = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        loaded_stiffness(arm, mount, q, wrench)
        walls.append(time.perf_counter() - start)
    return {"us_per_posture": statistics.median(walls[1:]) / POSTURES * 1e6}
