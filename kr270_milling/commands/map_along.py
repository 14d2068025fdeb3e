"""The part of ``map`` that turns the tool about its axis along a path: ``map CELL --along PATH``."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.progress import progress

__all__ = ["run_along"]

GRID = (-180.0, 180.0, 73)  #: [deg], where --tool-turn does not say otherwise
RECORDING, TABLE, CELL = "along", "along.csv", "along.yaml"


def run_along(args) -> Answer:
    import numpy as np

    from kr270_milling.base.errors import ParameterError
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.jobs import simulate
    from kr270_milling.studies.along import Turns, constant_way, find_way, turned
    from kr270_milling.studies.placements import course_at

    if any(axis is not None for axis in (args.x, args.y, args.z, args.turn)):
        raise ParameterError("--along", args.along, "without --x, --y, --z and --turn: the workpiece stays")
    source = find_file(args.cell).resolve()
    settings = [*args.set, *([f"path.file={Path(args.along).resolve()}"] if args.along else [])]
    cell = read_cell(source, settings)
    with progress("milling") as report:
        ran = simulate(cell, progress=report).result
    chosen = np.linspace(0, len(ran.time) - 1, min(args.places, len(ran.time))).astype(int)
    step = float(ran.time[-1] - ran.time[0]) / (len(chosen) - 1)
    turns = Turns(cell, course_at(cell, ran, chosen), step, np.degrees(1e-6 * args.smooth))
    grid = np.radians(np.linspace(*(args.tool_turn or GRID)))
    way, same, own = find_way(turns, grid), constant_way(turns, grid), constant_way(turns, np.zeros(1))
    run, q = turned(cell, ran.time_ns[chosen], way)
    files = _write(Path(args.out), source, args.set, cell, run, q, way)
    speed = np.abs(np.diff(q, axis=0)) / np.diff(run.time)[:, None] / cell.arm.joint_speed_limit
    found = {
        "rows": len(chosen),
        "rows_per_s": None,
        "branch": way.branch,
        "criterion_um": 1e6 * way.value,
        "criterion_constant_um": 1e6 * same.value if same else None,
        "criterion_unturned_um": 1e6 * own.value if own else None,
        "constant_turn_deg": float(np.degrees(same.turn[0])) if same else None,
        "error_max_um": 1e6 * float(way.error.max()),
        "error_max_constant_um": 1e6 * float(same.error.max()) if same else None,
        "turn_deg": np.degrees([way.turn.min(), way.turn.max()]).tolist(),
        "joint_speed_share": speed.max(axis=0).tolist(),
        "slower": float(run.duration_ns / cell.target().duration_ns),
        "best": [{"cell": str(files[0])}],
        "files": [str(path) for path in files],
    }
    low, high = found["turn_deg"]
    shown = [f"turning the tool from {low:.4g} to {high:.4g} deg along the path: {1e6 * way.value:.2f} um"]
    for name, other in (("the best turn that stays the same", same), ("as it is", own)):
        shown.append(f"{name}: " + (f"{1e6 * other.value:.2f} um" if other else "not within the limits of the joints"))
    share = f"joints run at up to {100 * speed.max():.0f} % of their speeds"
    return Answer(found, [
        *shown,
        "(root mean square of the static error across the feed and of what turning is worth by --smooth; what corners",
        "and teeth shake is not in it: compare `simulate` of both cells)",
        f"{share}, the path takes {found['slower']:.3f} times",
        *files,
    ])  # fmt: skip


def _write(out: Path, source: Path, settings, cell, run, q, way) -> list[Path]:
    """The turned trajectory as a recording, the cell that runs it, and a table with the joint angles."""
    import numpy as np

    from kr270_milling.bag.writer import BagWriter
    from kr270_milling.base.files import staged
    from kr270_milling.messages.codec import to_bytes
    from kr270_milling.messages.trajectory import TRAJECTORY
    from kr270_milling.studies.placements import place_of, write_cell
    from kr270_milling.trajectory.trajectory_csv import write_csv

    changes = {"path": {"file": RECORDING}, "workpiece": place_of(cell.workpiece.pose),
               "posture_deg": np.degrees(q[0]).tolist()}  # fmt: skip
    note = f"The tool turns about its axis along the path, from {np.degrees(way.turn[0]):.2f} deg on"
    with staged(out) as (draft, final):
        write_cell(draft / CELL, source, settings, cell, changes, note)
        write_csv(draft / TABLE, run, q)
        with BagWriter(draft / RECORDING) as writer:
            writer.add_topic("/target_trajectory", TRAJECTORY)
            writer.write("/target_trajectory", to_bytes(run), 0)
        return [final(draft / name) for name in (CELL, TABLE, RECORDING)]
