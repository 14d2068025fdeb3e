"""The pass of the program as written: read back from KRL and run as the controller joins its points.

The times of the points are those of the assumed time law: a program has speeds, but the controller plans its own ramps.
"""

from __future__ import annotations

import tempfile

import numpy as np

from kr270_milling.base.frames import Pose, quaternion_from_rotation
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.plant import Plant
from kr270_milling.decide.programs import krl
from kr270_milling.decide.programs.files import as_commanded, source_of, timed_by_cell
from kr270_milling.decide.programs.krl_reader import read_krl
from kr270_milling.path.controller_motion import controller_motion, places_on_program
from kr270_milling.path.trajectory import Trajectory

__all__ = ["SOFTER", "motion_of", "softer_pass", "written_pass", "written_trajectory"]

SOFTER = 0.8  #: share of the acceleration of the second time law
NOWHERE = Pose(np.zeros(3), np.eye(3))


def motion_of(cell: Cell, planned: Trajectory) -> str:
    """SPLINE or LIN: LIN for straight lines along a cell's path."""
    return "LIN" if planned.velocity is None else cell.krl.motion


def written_trajectory(cell: Cell, planned: Trajectory, motion: str) -> Trajectory:
    """Write the program of a planned reference, read its points back, and join them as the controller does."""
    commanded = planned
    if not cell.compensation.sag_compensated:
        commanded = as_commanded(cell, planned, commanded_joints(arm_of(cell), cell.compensation, planned))
    start = krl.Approach(planned.position[0], 0, 0)
    law = (cell.timing.acceleration, cell.timing.jerk) if timed_by_cell(path_of(cell)) else (0.0, 0.0)
    setup = krl.Setup(NOWHERE, NOWHERE, (start, start), 0.0, acceleration=law[0], jerk=law[1])
    program = cell.krl.replace(motion=motion, name="WRITTEN")
    path, target = path_of(cell), path_of(cell).target
    with tempfile.TemporaryDirectory() as folder:
        krl.write_krl(folder, program, setup, target, commanded, krl.Heading("", ""), source_of(path, len(planned)))
        read = read_krl(folder, "WRITTEN_CMP")
    k = read.number - 1
    position = planned.position[k] + read.pose.position - commanded.position[k]
    quaternion = planned.quaternion[k]
    if commanded is planned:
        quaternion = quaternion_from_rotation(read.pose.rotation)
    return _as_run(planned, target, k, position, quaternion, read.stops, read.spline)


def _as_run(
    planned: Trajectory,
    target: Trajectory,
    knots: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
    stops: np.ndarray,
    spline: bool,
) -> Trajectory:
    """The motion through the points of a program, with the time law of the plan."""
    place = places_on_program(planned, knots, position, stops, spline)
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
    written = written_trajectory(cell, planned.reference, motion or motion_of(cell, planned.reference))
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
    fine = np.union1d(fine, later.trajectory.time_ns)
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
