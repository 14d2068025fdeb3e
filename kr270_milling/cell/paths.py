"""The programmed path of a cell: ``StraightCut``, or ``ProgramPath`` of a file. Both answer the same questions."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.path import MOST_STEPS, UPRIGHT, check_duration, check_effort, check_path
from kr270_milling.cell.sections import PathSection
from kr270_milling.path.timing import TimedPath, Timing, limit_by_joints, time_path
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Stock, Tool
from kr270_milling.physics.motion.periods import Clock, Exchange
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError

__all__ = ["CellPath", "ProgramPath", "StraightCut"]


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


@dataclass(frozen=True, eq=False)
class StraightCut(_Programmed):
    """A cut along +x of the workpiece frame, described by the keys of ``path``."""

    #: the path is one line: its scores are those of the paper, and its feed has one direction
    straight = True
    by_teeth = True  #: each tooth is swept
    fed = None  #: the tool path under the limits of the controller alone
    timed = None  #: the tool path under the limits of controller and joints
    tilts = False  #: the axis of the tool leaves z of the workpiece while it cuts
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

    @property
    def knot_source(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """Line of the program and name of the feature of each knot; empty without a program."""
        return np.zeros(0, np.int64), ()

    def line_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Line of the program at times (n,) [ns]; 0: no program."""
        return np.zeros(time_ns.size, np.int64)

    def rapid_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Return whether the tool makes a rapid move at times (n,) [ns]."""
        return np.zeros(time_ns.size, bool)

    def drilling_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Return whether the tool is in a hole of a drilling cycle at times (n,) [ns]."""
        return np.zeros(time_ns.size, bool)


@functools.lru_cache(maxsize=4)  # simulated robots, which differ in arm, tool and stock, run the same program
def _timed_by_controller(path: PathSection, timing: Timing) -> TimedPath:
    read = path.read()
    return read if isinstance(read, TimedPath) else time_path(read, timing)


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
            joints = self.arm.joints(self.fed.trajectory)
        except (ReachError, JointLimitError, SingularityError) as error:
            raise self._unreachable(error) from None
        if self.fed.timed_by_source:
            return self.fed
        speed, acceleration = self.arm.arm.joint_speed_limit, self.arm.arm.joint_acceleration_limit
        return dataclasses.replace(
            self.fed, trajectory=limit_by_joints(self.fed.trajectory, joints, speed, acceleration)
        )

    @property
    def target(self) -> Trajectory:
        """The programmed trajectory of the tool tip, knots at the controller step."""
        return self.timed.trajectory

    @property
    def knot_source(self) -> tuple[np.ndarray, tuple[str, ...]]:
        """Line of the program and name of the feature of each knot; empty without a program."""
        toolpath, block = self.timed.toolpath, self.timed.block
        return toolpath.line[block], tuple(toolpath.features[n] for n in toolpath.feature[block].tolist())

    def line_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Line of the program at times (n,) [ns]; 0: no program."""
        return self.timed.toolpath.line[self.timed.block_at(time_ns)]

    def rapid_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Return whether the tool makes a rapid move at times (n,) [ns]."""
        return self.timed.toolpath.rapid[self.timed.block_at(time_ns)]

    @property
    def tilts(self) -> bool:
        """Return whether the axis of the tool leaves z of the workpiece by more than ``UPRIGHT`` while it cuts."""
        return self.path.tilt > UPRIGHT

    @property
    def drills(self) -> bool:
        """Return whether the program has a drilling cycle."""
        return bool(self.fed.toolpath.drilling.any())

    @property
    def mills(self) -> bool:
        """Return whether the program cuts in more than drilling cycles."""
        return bool((~self.fed.toolpath.rapid & ~self.fed.toolpath.drilling).any())

    def drilling_at(self, time_ns: np.ndarray) -> np.ndarray:
        """Return whether the tool is in a hole of a drilling cycle at times (n,) [ns]."""
        drilling = self.timed.toolpath.drilling
        return drilling[self.timed.block_at(time_ns)] if drilling.any() else np.zeros(time_ns.size, bool)

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
