"""The tool path of a cell: read, timed under the limits of controller and joints, refused where it cannot be meant.

What a pass costs is reckoned before it starts: a wrong unit must not keep a machine busy for days.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from typing import TYPE_CHECKING

import numpy as np

from kr270_milling.bag.recorded_path import is_recording, read_recorded
from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.cell.sections import Path
from kr270_milling.cutting import Stock, Tool
from kr270_milling.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.simulation.exchange import Exchange
from kr270_milling.trajectory.readers import read_toolpath
from kr270_milling.trajectory.source_program import SourceProgram
from kr270_milling.trajectory.timing import TimedPath, limit_by_joints, time_path
from kr270_milling.trajectory.toolpath import Toolpath
from kr270_milling.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from kr270_milling.cell.cell import Cell

__all__ = ["MOST_STEPS", "check_effort", "check_postures", "fed_path", "read_program", "sinking", "straight_cut",
           "within_joint_limits"]  # fmt: skip

MOST_STEPS = 5e6  #: exchange periods or reference points of one pass; its series take some 250 bytes a step
MOST_TOOTH_STEPS = 1e10  #: micro-steps of single teeth in one pass, some 0.1 us each
MOST_VISITS = 1e13  #: nodes under the footprint, each time that it is swept as a whole, some ns each
MOST_POSTURES = 100_000  #: at which the arm's modes are computed, some ms and 3 kB each
WIDE = 5.0  #: times as wide as the stock: more than that is taken for a wrong unit
SAME_FEED = 1e-6  # [m/s]
SAME_SPEED = 0.1  # [rad/s], 1 rpm: spindle speeds that differ by less are one
UPRIGHT = np.radians(1.0)  # the cut is that of a tool along z: beyond this its floors and chips are others


def straight_cut(cell: Cell) -> Trajectory:
    """The cut along +x of the workpiece frame that ``path`` describes, knots at the controller step."""
    path = cell.path
    start = [*path.start, cell.stock.max[2] - path.depth_of_cut]
    return Trajectory.straight_line(start, [1.0, 0.0, 0.0], path.length, path.feed_rate, cell.timing.controller_step)


def fed_path(cell: Cell) -> TimedPath:
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


def within_joint_limits(cell: Cell, timed: TimedPath, joints_of) -> TimedPath:
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


def _unreachable(cell: Cell, timed: TimedPath, error: ReachError | JointLimitError | SingularityError) -> InputError:
    """The refusal of the arm with point and line, and a hint where the path is far larger than the stock."""
    point = error.index[0] if error.index else 0
    line = int(timed.toolpath.line[timed.block[point] if point else 0]) or None
    reason = str(error).removesuffix(f" (pose {point})")
    extent = np.ptp(timed.toolpath.position[:, :2], axis=0).max()
    stock = (cell.stock.max - cell.stock.min)[:2].max()
    if extent > WIDE * stock:
        reason += f"; the path is {extent / stock:.0f} times as wide as the stock, check the unit (G20, G21)"
    return InputError(cell.path.file, f"point {point + 1} of the path: {reason}", line)


def _check_duration(cell: Cell, run: Trajectory) -> None:
    """Memory and time of a pass are in proportion to its steps; a path of days is a mistake of the feed."""
    steps = run.duration_ns * 1e-9 / cell.exchange.period
    if not steps <= MOST_STEPS:
        shown = f"{run.duration_ns * 1e-9:.4g} s, {steps:.3g} exchange periods, more than {MOST_STEPS:g}"
        raise InputError(cell.path.file, f"would take {shown}: cut it in pieces, or raise exchange.period_ms")
    sinks = sinking(run.time, run.position[:, 2], float(cell.stock.max[2]))
    check_effort(cell.exchange, cell.tool, cell.stock, run.duration_ns * 1e-9, sinks)


def check_effort(exchange: Exchange, tool: Tool, stock: Stock, duration: float, sinks: tuple = (0.0, 0.0)) -> None:
    """Raise ParameterError for a pass of a duration [s] that nobody can mean; sinks: what ``sinking`` says of it."""
    turns = duration * tool.spindle_speed / (2.0 * math.pi)
    teeth = turns * 2.0 * math.pi / exchange.micro_step * tool.teeth * exchange.iterations
    if not teeth <= MOST_TOOTH_STEPS:
        shown = math.degrees(exchange.micro_step)
        allowed = f"larger: the pass would take {teeth:.3g} micro-steps of a tooth, more than {MOST_TOOTH_STEPS:g}"
        raise ParameterError("exchange.micro_step_deg", shown, allowed)
    seconds, depth = sinks
    times = min(seconds * tool.spindle_speed / (2.0 * math.pi), depth / max(stock.floor_tolerance, stock.level_step))
    nodes = math.pi * float(tool.radii.max()) ** 2 / stock.grid_step**2
    visits = nodes * times * tool.teeth * exchange.iterations
    if not visits <= MOST_VISITS:
        allowed = f"larger: the sinking tool would sweep {visits:.3g} nodes, more than {MOST_VISITS:g}"
        raise ParameterError("stock.grid_step_um", stock.grid_step * 1e6, allowed)


def sinking(time: np.ndarray, height: np.ndarray, top: float) -> tuple[float, float]:
    """How long [s] and how deep in all [m] a tool sinks below ``top``; times [s] and heights [m] of its path, (n,)."""
    down = -np.diff(np.minimum(height, top))
    return float(np.diff(time)[down > 0].sum()), float(down[down > 0].sum())


def check_postures(count: int, spacing: float) -> None:
    """Raise ParameterError for more postures along a path than anybody can mean; spacing [m]: what was asked for."""
    if count > MOST_POSTURES:
        allowed = f"larger: the arm would be modelled at {count} postures, more than {MOST_POSTURES}"
        raise ParameterError("dynamics.posture_spacing_mm", spacing * 1e3, allowed)


def check_path(file: str, timed: TimedPath, tool: Tool, stock: Stock) -> None:
    """Raise InputError, with the line where there is one, for a path that this tool cannot mean in this stock."""
    path = timed.toolpath
    if path.rapid[1:].all():
        raise InputError(file, "has no cutting move: every block is a rapid one")
    wrong = _other_spindle(path, tool) or _tilted(path) or _beside_stock(timed, tool, stock)
    if wrong:
        reason, block = wrong
        raise InputError(file, reason, int(path.line[block]) or None)


def _other_spindle(path: Toolpath, tool: Tool) -> tuple[str, int] | None:
    """A programmed spindle, where there is one, must turn as that of the model does: else why not, and the block."""
    cutting = np.flatnonzero(~path.rapid[1:]) + 1
    speed = path.spindle_speed[cutting]
    other = np.abs(np.abs(speed) - tool.spindle_speed) > SAME_SPEED
    if not speed.any():
        return None
    if other.any():
        block = cutting[np.argmax(other)]
        if path.spindle_speed[block] == 0.0:
            return "a cutting move while the spindle is off", block
        rpm = 30.0 / np.pi * np.array([abs(path.spindle_speed[block]), tool.spindle_speed])
        reason = f"the spindle speed S{rpm[0]:.6g} is not the tool.spindle_speed_rpm of the cell, {rpm[1]:.6g}"
        return reason, block
    turns = "clockwise (M3, CLW)" if speed[0] > 0 else "counterclockwise (M4, CCLW)"
    if turns.startswith(f"{tool.rotation} "):
        return None
    return f"its spindle turns {turns}, but tool.rotation of the cell is {tool.rotation}", cutting[0]


def _tilted(path: Toolpath) -> tuple[str, int] | None:
    """The cut knows one tool axis, z of the workpiece."""
    axis = rotation_from_quaternion(path.quaternion)[:, :, 2]
    tilt = np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), -axis[:, 2])
    over = ~path.rapid & (tilt > UPRIGHT)
    if not over.any():
        return None
    block = int(np.argmax(over))
    reason = (
        f"point {block + 1} of the path: the tool is tilted by {np.degrees(tilt[block]):.4g} deg, but the cut is "
        f"that of a tool along z of the workpiece (within {np.degrees(UPRIGHT):g} deg)"
    )
    return reason, block


def _beside_stock(timed: TimedPath, tool: Tool, stock: Stock) -> tuple[str, int] | None:
    """A path that leaves the stock alone must be a mistake of placement, or of the unit."""
    run = timed.trajectory
    step = tool.radius / 8 / max(float(np.max(run.feed(run.time_ns))), 1e-6)
    stamps = np.linspace(0, run.duration_ns, 2 + int(min(run.time[-1] / step, MOST_STEPS))).astype(np.int64)
    at, radius = run.sample(stamps), tool.radii.max()
    beside = np.maximum(np.maximum(stock.min - at, at - stock.max), 0.0)[:, :2]
    if np.any((np.hypot(*beside.T) < radius) & (at[:, 2] < stock.max[2])):
        return None
    way, box = _extent(at.min(axis=0), at.max(axis=0)), _extent(stock.min, stock.max)
    hint = "check the datum and the unit (G20, G21)"
    reason = f"the tool never reaches the stock: it goes through {way} mm, the stock fills {box} mm; {hint}"
    return reason, int(np.flatnonzero(~timed.toolpath.rapid[1:])[0]) + 1


def _extent(low: np.ndarray, high: np.ndarray) -> str:
    """A box [m] in words, in mm."""
    return ", ".join(f"{axis} {1e3 * a:.6g} to {1e3 * b:.6g}" for axis, a, b in zip("xyz", low, high, strict=True))


def check_feed(file: str, path: Toolpath, feed: float) -> None:
    """Raise InputError where the program has feeds of its own, not that of the cell [m/s]; 0: the cell has none."""
    other = ~path.rapid & (np.abs(path.feed - feed) > SAME_FEED)
    if feed and other.any():
        block = int(np.argmax(other))
        reason = (
            f"its feed is {6e4 * path.feed[block]:.6g} mm/min, but path.feed_rate_m_per_min of the cell says "
            f"{6e4 * feed:.6g}; leave that key out"
        )
        raise InputError(file, reason, int(path.line[block]))
