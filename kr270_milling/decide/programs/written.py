"""The pass of the program as written: read back from KRL and run as the controller joins its points.

The times of the points are those of the assumed time law: a program has speeds, but the controller plans its own ramps.
"""

from __future__ import annotations

import functools
import re
import tempfile
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.frames import Pose, quaternion_from_rotation
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.plant import Plant
from kr270_milling.cell.sections import Program
from kr270_milling.decide.programs import krl
from kr270_milling.decide.programs.files import as_commanded, knot_feeds, notes_of, timed_by_cell
from kr270_milling.decide.programs.points import dense_times
from kr270_milling.path.controller_motion import controller_motion, places_on_program
from kr270_milling.path.trajectory import Trajectory

SOFTER = 0.8  #: share of the acceleration of the second time law
MOTION = re.compile(r"(SPL|LIN|CIRC)(?: \{(X [^}]*)\},| )\{(X [^}]*)\}( C_DIS)?(?: WITH .*)?")
START = re.compile(r"DECL FRAME XP\d+=\{(.*)\}")


def drafted(cell: Cell, planned: Trajectory, motion: str) -> tuple[dict[str, list[str]], tuple, list, Trajectory]:
    """Return lines, layout and parts of the program of a planned reference, see ``program_files``; what it commands.

    The frames are those of the workpiece, so that the program has the points of the reference.
    """
    nowhere, path = Pose(np.zeros(3), np.eye(3)), path_of(cell)
    target, commanded = path.target, planned
    if not cell.compensation.sag_compensated:
        target, commanded = (
            as_commanded(cell, run, commanded_joints(arm_of(cell), cell.compensation, run)) for run in (target, planned)
        )
    start = planned.position[0], 0, 0  # of the approach, which is not simulated
    law = (cell.timing.acceleration, cell.timing.jerk) if timed_by_cell(path) else (0.0, 0.0)
    setup = krl.Setup(nowhere, nowhere, lambda *_: start, float(cell.stock.max[2]), acceleration=law[0], jerk=law[1])
    program, count = cell.krl.replace(motion=motion, name="WRITTEN"), len(planned)
    notes, feeds = notes_of(path, count), knot_feeds(path, count)
    return *krl.program_files(program, setup, target, commanded, notes, feeds), commanded


@functools.lru_cache(maxsize=1)  # the pass of the program and the simulated robots run the same
def written_trajectory(cell: Cell, planned: Trajectory, motion: str) -> Trajectory:
    """Draft the program of a planned reference, read its points back, and join them as the controller does."""
    files, (k, _, _), _, commanded = drafted(cell, planned, motion)
    with tempfile.TemporaryDirectory() as folder:
        write_files({Path(folder, name): (line + "\n" for line in lines) for name, lines in files.items()})
        pose, stops, auxiliary = read_krl(folder, "WRITTEN_CMP")
    position = planned.position[k] + pose.position - commanded.position[k]
    quaternion = planned.quaternion[k]
    if commanded is planned:
        quaternion = quaternion_from_rotation(pose.rotation)
    program = cell.krl.replace(motion=motion)
    return _as_run(planned, path_of(cell).target, k, position, quaternion, stops, auxiliary, program)


def _as_run(
    planned: Trajectory,
    target: Trajectory,
    knots: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
    stops: np.ndarray,
    auxiliary: np.ndarray,
    program: Program,
) -> Trajectory:
    """The motion through the points of a program, with the time law of the plan."""
    spline = program.motion == "SPLINE"
    if auxiliary.any():  # a chord from knot to knot is not the arc
        times = dense_times(target, program.tolerance)
        knots = np.searchsorted(times, planned.time_ns[knots])
        planned = Trajectory(times, planned.sample(times), planned.sample_orientation(times), None, planned.frame)
    place = places_on_program(planned, knots, position, stops, spline, program.blend_distance, auxiliary)
    turned = Trajectory(planned.time_ns[knots], position, quaternion).sample_orientation(planned.time_ns)
    run = Trajectory(planned.time_ns, place, turned, None, planned.frame)
    if not spline:
        return run
    ends = np.zeros(len(run), bool)
    ends[knots[stops]] = ends[[0, -1]] = True
    return controller_motion(run, target, ends)


def written_pass(
    cell: Cell, planned: ScoredPass, motion: str | None = None, plant: Plant | None = None, progress=None
) -> ScoredPass:
    """The pass of the written program of a planned pass; ``reference`` stays that of the plan, knot by knot."""
    motion = motion or ("LIN" if planned.reference.velocity is None else cell.krl.motion)
    written = written_trajectory(cell, planned.reference, motion)
    ran = simulate(cell, written, planned.name, progress, plant)
    return ScoredPass(planned.name, planned.reference, ran.result, ran.scores, ran.record)


def softer_pass(cell: Cell, reference: Trajectory, share: float = SOFTER, progress=None) -> ScoredPass | None:
    """The pass of the same points with ``share`` times the acceleration; None where the cell has no time law.

    The jerk is ``share`` squared times the jerk, so that every ramp has ``share`` times its acceleration. Each point is
    reached where the other time law is at the same distance along the path.
    """
    timed = path_of(cell).timed
    if timed is None or timed.timed_by_source or len(timed.distance) != len(reference):
        return None
    timing = cell.timing
    lower = timing.replace(acceleration=share * timing.acceleration, jerk=share**2 * timing.jerk)
    other = cell.replace(timing=lower)
    later = path_of(other).timed
    if later is None:
        return None
    fine = np.linspace(0, later.trajectory.duration_ns, 20 * len(later.trajectory)).astype(np.int64)
    fine = np.sort(np.append(fine, later.trajectory.time_ns), kind="stable")  # ``union1d`` takes 6 s of an hour
    distance = np.maximum.accumulate(later.distance_at(fine))
    time_ns = np.rint(np.interp(timed.distance, distance, fine)).astype(np.int64)
    time_ns[[0, -1]] = 0, later.trajectory.duration_ns
    keep = np.concatenate([[True], np.diff(time_ns) > 0])
    points = Trajectory(time_ns[keep], reference.position[keep], reference.quaternion[keep], None, reference.frame)
    if reference.velocity is not None:
        stops = path_of(cell).target.standing[keep]
        stops[[0, -1]] = True
        points = controller_motion(points, path_of(other).target, stops)
    most_rows = 2**19  # rows of the series of that pass; only its scores are used
    return simulate(other, points, f"{share:g} times the acceleration", progress, most_rows=most_rows)


def read_krl(directory, main: str) -> tuple[Pose, np.ndarray, np.ndarray]:
    """Read the modules ``main``.src and .dat, and those that it calls, in the order of the motion.

    Returns the poses of the points in $BASE, (p,), where the robot stops, (p,), and which points are auxiliary ones of
    arcs, (p,); the first point is the end of the approach. Raises InputError for mixed motions.
    """
    rows: list[list[float]] = []
    stops: list[bool] = []
    auxiliary: list[bool] = []
    kinds: set[bool] = set()

    def add(text: str, stop: bool, middle: bool = False) -> None:
        row = [float(item[2:]) for item in text.split(",")]  # X, Y, Z [mm] and, where they are stated, A, B, C [deg]
        rows.append(row + rows[-1][len(row) :] if rows else row)
        stops.append(stop)
        auxiliary.append(middle)

    def run(module: str) -> None:
        path = next(Path(directory).rglob(f"{module}.src"), Path(directory, f"{module}.src"))
        data = path.with_suffix(".dat")
        start = START.search(data.read_text(encoding="ascii")) if data.is_file() else None
        if start and not rows:
            add(start[1], True)
        for line in path.read_text(encoding="ascii").splitlines():
            if match := re.fullmatch(r"([A-Z]\w*)\( \)", line):
                run(match[1])
            elif line == "ENDSPLINE":
                stops[-1] = True
            elif match := MOTION.fullmatch(line):
                kinds.add(match[1] == "SPL")
                if match[2]:
                    add(match[2], False, True)
                add(match[3], match[1] != "SPL" and not match[4])

    run(main)
    if len(kinds) != 1:
        raise InputError(main, "the path must have SPL motions or LIN and CIRC motions, at least one and not both")
    places = np.array(rows)
    return Pose.from_abc(places[:, :3] * 1e-3, np.radians(places[:, 3:])), np.array(stops), np.array(auxiliary)
