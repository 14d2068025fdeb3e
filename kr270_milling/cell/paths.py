"""Programmed paths of a cell, and the checks of their tool path against exchange, tool and stock.

The cost of a pass is estimated before the pass starts: a wrong unit must not occupy a machine for days.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import tool_axis
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.sections import PathSection
from kr270_milling.path.timing import TimedPath, Timing, limit_by_joints, time_path
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Stock, Tool
from kr270_milling.physics.motion.periods import Clock, Exchange
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError

UPRIGHT = math.radians(0.01)  #: the heel of a flat end of 10 mm then rises by 1 um
BY_TEETH = math.radians(1.0)  #: the sweep is that of a tool along z: beyond this its floors and chips are others
MOST_STEPS = 1e7  #: exchange periods or reference points of one pass; its series take some 250 bytes a step
MOST_VISITS = 1e13  #: nodes under the footprint, each time that it is swept as a whole, some ns each


def check_duration(
    file: str, run: Trajectory, exchange: Exchange, tool: Tool, stock: Stock, by_teeth: bool = True
) -> None:
    """Raise InputError or ParameterError for a path of days, a mistake of the feed: cost grows with the steps."""
    steps = run.duration_ns * 1e-9 / exchange.period
    if not steps <= MOST_STEPS:
        shown = f"{run.duration_ns * 1e-9:.4g} s, {steps:.3g} exchange periods, more than {MOST_STEPS:g}"
        raise InputError(file, f"would take {shown}: cut it in pieces, or raise exchange.period_ms")
    sinks = sinking(run.time, run.position[:, 2], float(stock.max[2]))
    if by_teeth:
        check_effort(exchange, tool, stock, run.duration_ns * 1e-9, sinks)


def check_effort(exchange: Exchange, tool: Tool, stock: Stock, duration: float, sinks: tuple = (0.0, 0.0)) -> None:
    """Raise ParameterError for a pass of an implausible duration [s]; sinks: the result of ``sinking``."""
    turns = duration * tool.spindle_speed / (2.0 * math.pi)
    teeth = turns * 2.0 * math.pi / exchange.micro_step * tool.teeth * exchange.iterations
    most_tooth_steps = 1e10  # micro-steps of single teeth in one pass, some 0.1 us each
    if not teeth <= most_tooth_steps:
        shown = math.degrees(exchange.micro_step)
        allowed = f"larger: the pass would take {teeth:.3g} micro-steps of a tooth, more than {most_tooth_steps:g}"
        raise ParameterError("exchange.micro_step_deg", shown, allowed)
    seconds, depth = sinks
    times = min(seconds * tool.spindle_speed / (2.0 * math.pi), depth / max(stock.floor_tolerance, stock.level_step))
    nodes = math.pi * float(tool.radii.max()) ** 2 / stock.grid_step**2
    visits = nodes * times * tool.teeth * exchange.iterations
    if not visits <= MOST_VISITS:
        allowed = f"larger: the sinking tool would sweep {visits:.3g} nodes, more than {MOST_VISITS:g}"
        raise ParameterError("stock.grid_step_um", stock.grid_step * 1e6, allowed)


def sinking(time: np.ndarray, height: np.ndarray, top: float) -> tuple[float, float]:
    """Return how long [s] and how deep in all [m] a tool sinks below ``top``; time [s], height [m], (n,)."""
    down = -np.diff(np.minimum(height, top))
    return float(np.diff(time)[down > 0].sum()), float(down[down > 0].sum())


def check_postures(count: int, spacing: float) -> None:
    """Raise ParameterError for implausibly many postures along a path; spacing [m]: distance between two postures."""
    most_postures = 100_000  # at which the arm's modes are computed, some ms and 3 kB each
    if count > most_postures:
        allowed = f"larger: the arm would be modelled at {count} postures, more than {most_postures}"
        raise ParameterError("dynamics.posture_spacing_mm", spacing * 1e3, allowed)


def check_path(file: str, timed: TimedPath, tool: Tool, stock: Stock, by_teeth: bool = True) -> None:
    """Raise InputError, with the line where there is one, for a path that does not belong to tool and stock."""
    path = timed.toolpath
    check_moves(file, path, by_teeth)
    wrong = _other_spindle(path, tool)
    if not wrong and not path.cutting_tilt > UPRIGHT:  # the side of a leaning tool cuts beside its tip
        wrong = _beside_stock(timed, tool, stock)
    if wrong:
        reason, block = wrong
        raise InputError(file, reason, int(path.line[block]) or None)


def check_moves(file: str, path: Toolpath, by_teeth: bool = True) -> None:
    """Raise InputError for a path without a cutting move, and for a tilt that the cut does not model."""
    if path.rapid[1:].all():
        raise InputError(file, "has no cutting move: every block is a rapid one")
    tilted = _tilted(path, by_teeth)
    if tilted:
        reason, block = tilted
        raise InputError(file, reason, int(path.line[block]) or None)


def _other_spindle(path: Toolpath, tool: Tool) -> tuple[str, int] | None:
    """Return the reason and the block where the programmed spindle differs from the spindle of the cell."""
    cutting = np.flatnonzero(~path.rapid[1:]) + 1
    speed = path.spindle_speed[cutting]
    same_speed = 0.1  # [rad/s], 1 rpm: spindle speeds that differ by less are one
    other = np.abs(np.abs(speed) - tool.spindle_speed) > same_speed
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
    return (
        f"its spindle turns {turns}, but tool.rotation of the cell, the hand of the cutter, is {tool.rotation}",
        cutting[0],
    )


def _tilted(path: Toolpath, by_teeth: bool) -> tuple[str, int] | None:
    """Return the reason and the block where the tool tilts by more than the models of the cut and contacts support."""
    # assumed: beyond 75 deg the side of the tool hides most of the material from the height map
    cutting, moving = BY_TEETH if by_teeth else math.radians(75.0), math.radians(89.0)
    over = path.tilt > np.where(path.rapid, moving, cutting)
    if not over.any():
        return None
    block = int(np.argmax(over))
    model, most, advice = "the height map of cutting.detail: engagement is that", cutting, ""
    if path.rapid[block]:
        model, most = "rapid moves are compared with the height map", moving
    elif by_teeth:
        model, advice = "cutting.detail: teeth is the cut", "; cutting.detail: engagement cuts with a tilted axis"
    reason = (
        f"point {block + 1} of the path: the tool is tilted by {np.degrees(path.tilt[block]):.4g} deg, but {model} "
        f"of a tool along z of the workpiece (within {np.degrees(most):g} deg){advice}"
    )
    return reason, block


def _beside_stock(timed: TimedPath, tool: Tool, stock: Stock) -> tuple[str, int] | None:
    """Return the reason and the block of a path that misses the stock: a wrong placement, or a wrong unit."""
    run = timed.trajectory
    step = tool.radius / 8 / max(float(np.max(run.feed(run.time_ns))), 1e-6)
    count, radius = 2 + int(min(run.time[-1] / step, MOST_STEPS)), tool.radii.max()
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in blocks(count):
        at = run.sample((np.arange(part.start, part.stop) / (count - 1) * run.duration_ns).astype(np.int64))
        beside = np.maximum(np.maximum(stock.min - at, at - stock.max), 0.0)[:, :2]
        if np.any((np.hypot(*beside.T) < radius) & (at[:, 2] < stock.max[2])):
            return None
        low, high = np.minimum(low, at.min(axis=0)), np.maximum(high, at.max(axis=0))
    path_box, box = _extent(low, high), _extent(stock.min, stock.max)
    hint = "check the datum and the unit (G20, G21)"
    reason = f"the tool never reaches the stock: it goes through {path_box} mm, the stock fills {box} mm; {hint}"
    return reason, int(np.flatnonzero(~timed.toolpath.rapid[1:])[0]) + 1


def _extent(low: np.ndarray, high: np.ndarray) -> str:
    """A box [m] in words, in mm."""
    return ", ".join(f"{axis} {1e3 * a:.6g} to {1e3 * b:.6g}" for axis, a, b in zip("xyz", low, high, strict=True))


@dataclass(frozen=True, eq=False)
class _Programmed:
    path: PathSection
    stock: Stock
    tool: Tool
    timing: Timing
    exchange: Exchange

    @functools.cached_property
    def clock(self) -> Clock:
        return self.exchange.clock(self.tool.spindle_speed)

    @property
    def timed(self) -> TimedPath | None:
        """The tool path under the limits of controller and joints; None without a program."""
        return None

    def line_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Line of the program at times (n,) [ns]; 0: no program."""
        return self._of_block(time_ns, "line")

    def rapid_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Return whether the tool makes a rapid move at times (n,) [ns]."""
        return self._of_block(time_ns, "rapid").astype(bool)

    def drilling_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Return whether the tool is in a hole of a drilling cycle at times (n,) [ns]."""
        return self._of_block(time_ns, "drilling").astype(bool)

    def _of_block(self, time_ns: np.ndarray, name: str) -> np.ndarray:
        """Return an array of the tool path at the blocks of times (n,) [ns]; 0 without a program."""
        values = np.zeros(1, np.int64) if self.timed is None else getattr(self.timed.toolpath, name)
        if self.timed is None or not values.any():
            return np.zeros(time_ns.size, values.dtype)
        return values[self.timed.block_at(time_ns)]


@dataclass(frozen=True, eq=False)
class StraightCut(_Programmed):
    """A cut along +x of the workpiece frame, described by the keys of ``path``."""

    #: the path is one line: its scores are those of the paper, and its feed has one direction
    straight = True
    by_teeth = True  #: each tooth is swept
    fed = None  #: the tool path under the limits of the controller alone
    tilts = False  #: the axis of the tool leaves z of the workpiece while it cuts
    lean = 0.0  #: [rad], largest angle between the tool and z of the workpiece in any move
    upright = True  #: it is z of the workpiece along some block that cuts
    drills = False  #: the program has a drilling cycle
    mills = True  #: the program cuts in more than drilling cycles

    @property
    def description(self) -> str:
        """The cut as the object of a sentence."""
        return f"a straight cut of {self.path.length * 1e3:g} mm, {self.path.depth_of_cut * 1e3:.4g} mm deep,"

    @property
    def length(self) -> float:
        """[m]"""
        return self.path.length

    @property
    def feed_rate(self) -> float:
        """[m/s]"""
        return self.path.feed_rate

    @property
    def full_engagement(self) -> float:
        """[s], when the middle of a tool that enters along x reaches the border of the stock."""
        return max(0.0, float(self.stock.min[0] - self.path.start[0])) / self.path.feed_rate

    @functools.cached_property
    def target(self) -> Trajectory:
        """The programmed trajectory of the tool tip, knots at the controller step."""
        start = [*self.path.start, self.stock.max[2] - self.path.depth_of_cut]
        along, step = [1.0, 0.0, 0.0], self.timing.controller_step
        return Trajectory.straight_line(start, along, self.path.length, self.path.feed_rate, step)

    def check(self) -> None:
        """Raise ParameterError for a pass of implausible effort."""
        duration = self.path.length / self.path.feed_rate
        steps = duration / min(self.exchange.period, self.timing.controller_step)
        if not steps <= MOST_STEPS:
            allowed = f"faster: the pass would take {steps:.3g} steps, more than {MOST_STEPS:g}"
            raise ParameterError("path.feed_rate_m_per_min", self.path.feed_rate * 60.0, allowed)
        check_effort(self.exchange, self.tool, self.stock, duration)


@functools.lru_cache(maxsize=4)  # simulated robots, which differ in arm, tool and stock, run the same program
def _timed_by_controller(path: PathSection, timing: Timing) -> TimedPath:
    read = path.read()
    return read if isinstance(read, TimedPath) else time_path(read, timing)


@functools.lru_cache(maxsize=4)
def _timed_by_joints(fed: TimedPath, arm: PlacedArm) -> TimedPath:
    joints = arm.joints(fed.trajectory)
    if fed.timed_by_source:
        return fed
    speed, acceleration = arm.arm.joint_speed_limit, arm.arm.joint_acceleration_limit
    return dataclasses.replace(fed, trajectory=limit_by_joints(fed.trajectory, joints, speed, acceleration))


@dataclass(frozen=True, eq=False)
class ProgramPath(_Programmed):
    """The tool path of ``path.file``: G-code, APT, a CSV of points or a recording."""

    arm: PlacedArm
    by_teeth: bool = True  #: each tooth is swept

    straight = False
    full_engagement = 0.0  #: [s], the whole path is scored where it cuts

    @property
    def description(self) -> str:
        """The path as the object of a sentence."""
        seconds = self.target.duration_ns * 1e-9
        shown = f"{seconds:.3g}" if seconds < 1000 else f"{seconds:.0f}"
        return f"{self.path.name} ({self.length:.3g} m of path in {shown} s)"

    @property
    def length(self) -> float:
        """[m]"""
        return self.timed.toolpath.length

    @property
    def feed_rate(self) -> float:
        """[m/s], the highest programmed feed of the milling moves, of a program that only drills of all feed moves."""
        return self.path.feeds[0]

    @functools.cached_property
    def fed(self) -> TimedPath:
        """The tool path under the limits of the controller alone; a recorded trajectory keeps its times.

        Raises InputError where the file cannot be read, the pass would take days, or the path does not belong to tool
        and stock.
        """
        timed = _timed_by_controller(self.path, self.timing)
        check_duration(self.path.file, timed.trajectory, self.exchange, self.tool, self.stock, self.by_teeth)
        check_path(self.path.file, timed, self.tool, self.stock, self.by_teeth)
        return timed

    @functools.cached_property
    def timed(self) -> TimedPath:
        """The tool path, slower where a joint would exceed its speed or acceleration.

        Raises InputError where a point is out of reach.
        """
        try:
            timed = _timed_by_joints(self.fed, self.arm.geometry)
        except (ReachError, JointLimitError, SingularityError) as error:
            raise self._unreachable(error) from None
        if timed.trajectory is not self.fed.trajectory:
            name = f"{self.path.file}, slowed down by the limits of the joints"
            check_duration(name, timed.trajectory, self.exchange, self.tool, self.stock, self.by_teeth)
        return timed

    @property
    def target(self) -> Trajectory:
        """The programmed trajectory of the tool tip, knots at the controller step."""
        return self.timed.trajectory

    @property
    def tilts(self) -> bool:
        """Return whether the axis of the tool leaves z of the workpiece by more than ``UPRIGHT`` while it cuts."""
        return self.path.tilt > UPRIGHT

    @property
    def lean(self) -> float:
        """Return the largest angle between the tool and z of the workpiece in any move [rad], 0 up to ``UPRIGHT``."""
        lean = float(self.fed.toolpath.tilt.max())
        return lean if lean > UPRIGHT else 0.0

    @property
    def upright(self) -> bool:
        """Return whether the axis of the tool is z of the workpiece along some block that cuts."""
        path = self.fed.toolpath
        level = tool_axis(path.quaternion)[:, 2] > math.cos(UPRIGHT)
        return bool((level[1:] & level[:-1] & ~path.rapid[1:]).any())

    @property
    def drills(self) -> bool:
        """Return whether the program has a drilling cycle."""
        return bool(self.fed.toolpath.drilling.any())

    @property
    def mills(self) -> bool:
        """Return whether the program cuts in more than drilling cycles."""
        return bool((~self.fed.toolpath.rapid & ~self.fed.toolpath.drilling).any())

    def _unreachable(self, error: ReachError | JointLimitError | SingularityError) -> InputError:
        """The error of the arm with point and line, and a hint where the path is far larger than the stock."""
        point = error.index[0] if error.index else 0
        toolpath = self.fed.toolpath
        line = int(toolpath.line[self.fed.block[point] if point else 0]) or None
        reason = str(error).removesuffix(f" (pose {point})")
        extent = np.ptp(toolpath.position[:, :2], axis=0).max()
        width = (self.stock.max - self.stock.min)[:2].max()
        wide = 5.0  # ratio of the widths of path and stock above which the unit is probably wrong
        if extent > wide * width:
            reason += f"; the path is {extent / width:.0f} times as wide as the stock, check the unit (G20, G21)"
        return InputError(self.path.file, f"point {point + 1} of the path: {reason}", line)


CellPath = StraightCut | ProgramPath
