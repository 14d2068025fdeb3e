"""The tool path of a cell: read, timed under the limits of controller and joints, refused where it cannot be meant."""

from __future__ import annotations

import dataclasses
import functools
import os

import numpy as np

from kr270_milling.bag.recorded_path import is_recording, read_recorded
from kr270_milling.base.errors import InputError
from kr270_milling.cell.plausibility import MOST_STEPS, check_effort, check_feed, check_path, sinking
from kr270_milling.cell.records import Parameters, Path
from kr270_milling.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.trajectory.readers import read_toolpath
from kr270_milling.trajectory.source_program import SourceProgram
from kr270_milling.trajectory.timing import TimedPath, limit_by_joints, time_path
from kr270_milling.trajectory.toolpath import Toolpath
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["fed_path", "read_program", "straight_cut", "within_joint_limits"]

WIDE = 5.0  #: times as wide as the stock: more than that is taken for a wrong unit


def straight_cut(cell: Parameters) -> Trajectory:
    """The cut along +x of the workpiece frame that ``path`` describes, knots at the controller step."""
    path = cell.path
    start = [*path.start, cell.stock.max[2] - path.depth_of_cut]
    return Trajectory.straight_line(start, [1.0, 0.0, 0.0], path.length, path.feed_rate, cell.timing.controller_step)


def fed_path(cell: Parameters) -> TimedPath:
    """The tool path of ``path.file`` run under the limits of the controller alone.

    A recorded trajectory has its times already and keeps them. Raises InputError where the file cannot be read, the
    pass would take days, or the path does not belong to tool and stock.
    """
    path = _read(cell.path)
    timed = path if isinstance(path, TimedPath) else time_path(path, cell.timing)
    _check_duration(cell, timed.trajectory)
    check_path(cell.path.file, timed, cell.tool, cell.stock)
    return timed


def read_program(path: Path) -> SourceProgram:
    """What the program of ``path.file`` says beside its moves; empty for a recording."""
    read = _read(path)
    return SourceProgram() if isinstance(read, TimedPath) else read.program


def within_joint_limits(cell: Parameters, timed: TimedPath, joints_of) -> TimedPath:
    """The same path, slower where a joint would exceed its speed or acceleration.

    joints_of(trajectory): joint positions [rad], (n, 6), at the knots. Raises InputError where a point is out of reach.
    """
    try:
        joints = joints_of(timed.trajectory)
    except (ReachError, JointLimitError, SingularityError) as error:
        raise _unreachable(cell, timed, error) from None
    if timed.timed_by_source:
        return timed
    slower = limit_by_joints(timed.trajectory, joints, cell.arm.joint_speed_limit, cell.arm.joint_acceleration_limit)
    return dataclasses.replace(timed, trajectory=slower)


def _read(path: Path) -> Toolpath | TimedPath:
    if is_recording(path.file):
        return read_recorded(path.file, path.topic, path.feed_rate)
    try:
        found = os.stat(path.file)
    except (OSError, ValueError) as error:
        raise InputError(path.file, f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    toolpath = _program(path.file, path.tool, path.feed_rate, (found.st_mtime_ns, found.st_size))
    if not path.length:  # else the feed is that of the straight cut, which the file replaces
        check_feed(path.file, toolpath, path.feed_rate)
    return toolpath


@functools.lru_cache(maxsize=1)
def _program(file: str, tool: str, feed: float, stamp: tuple) -> Toolpath:
    """The tool path of a file, read once as long as its stamp is the same."""
    return read_toolpath(file, tool, feed)


def _unreachable(
    cell: Parameters, timed: TimedPath, error: ReachError | JointLimitError | SingularityError
) -> InputError:
    """The refusal of the arm with point and line, and a hint where the path is far larger than the stock."""
    point = error.index[0] if error.index else 0
    line = int(timed.toolpath.line[timed.block[point] if point else 0]) or None
    reason = str(error).removesuffix(f" (pose {point})")
    extent = np.ptp(timed.toolpath.position[:, :2], axis=0).max()
    stock = (cell.stock.max - cell.stock.min)[:2].max()
    if extent > WIDE * stock:
        reason += f"; the path is {extent / stock:.0f} times as wide as the stock, check the unit (G20, G21)"
    return InputError(cell.path.file, f"point {point + 1} of the path: {reason}", line)


def _check_duration(cell: Parameters, run: Trajectory) -> None:
    """Memory and time of a pass are in proportion to its steps; a path of days is a mistake of the feed."""
    steps = run.duration_ns * 1e-9 / cell.exchange.period
    if not steps <= MOST_STEPS:
        shown = f"{run.duration_ns * 1e-9:.4g} s, {steps:.3g} exchange periods, more than {MOST_STEPS:g}"
        raise InputError(cell.path.file, f"would take {shown}: cut it in pieces, or raise exchange.period_ms")
    sinks = sinking(run.time, run.position[:, 2], float(cell.stock.max[2]))
    check_effort(cell.exchange, cell.tool, cell.stock, run.duration_ns * 1e-9, sinks)
