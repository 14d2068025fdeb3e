"""One milling cell: every parameter record of one YAML file, and the models that they make."""

from __future__ import annotations

import dataclasses
import functools
import math
import pathlib
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError, MillingError, ParameterError
from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.base.record import Record, build, override, parameter, read_tree, specs
from kr270_milling.cell.limits import Limits
from kr270_milling.cell.path_checks import check_path
from kr270_milling.cell.plausibility import MOST_STEPS, check_effort, check_postures, sinking
from kr270_milling.cell.uncertainty import Uncertainty
from kr270_milling.compensation.parameters import Compensation
from kr270_milling.cutting import Cut, Cutting, Stock, Tool
from kr270_milling.messages.toolpath import find_tool_path, is_recording, read_recorded
from kr270_milling.programs.krl import Program
from kr270_milling.robot import Arm, Mount, inverse_near
from kr270_milling.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.simulation.arm_model import arm_model, modal_models
from kr270_milling.simulation.dynamics import ArmModel, Dynamics, ModalModel
from kr270_milling.simulation.exchange import Clock, Exchange
from kr270_milling.trajectory.joint_limits import limit_by_joints
from kr270_milling.trajectory.readers import read_toolpath
from kr270_milling.trajectory.timing import TimedPath, Timing, time_path
from kr270_milling.trajectory.toolpath import Toolpath
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Cell", "Path", "Workpiece", "read_cell"]


@dataclass(frozen=True, eq=False)
class Workpiece(Record):
    """YAML ``workpiece``: where the part is clamped."""

    xyz: np.ndarray = parameter(
        unit="mm", size=3, low=-1e5, high=1e5, text="origin of the workpiece frame on base_link"
    )
    abc: np.ndarray = parameter(unit="deg", size=3, low=-360.0, high=360.0, text="its orientation, KUKA A, B, C")

    @property
    def pose(self) -> Pose:
        """workpiece -> base_link."""
        return Pose.from_abc(self.xyz, self.abc)


@dataclass(frozen=True, eq=False)
class Path(Record):
    """YAML ``path``: a tool path file, or a straight cut along +x of the workpiece frame."""

    file: str = parameter(
        "", text="G-code, APT/CL, CSV of points or a recording of a path, workpiece frame; empty: a straight cut"
    )
    topic: str = parameter("", text="of a recording: where its path is, if several topics hold one")
    start: np.ndarray = parameter(
        [0.0, 0.0], unit="mm", size=2, low=-1e5, high=1e5, text="straight cut: x, y of the tool tip at the start"
    )
    depth_of_cut: float = parameter(0.0, unit="mm", low=0.0, high=100.0, text="straight cut: a_p below the stock's top")
    length: float = parameter(0.0, unit="mm", low=0.0, high=10000.0, text="straight cut: its length")
    feed_rate: float = parameter(
        0.0, unit="m_per_min", low=0.0, high=60.0,
        text="feed rate v_f of a straight cut, or of a recorded path whose poses all have one stamp",
    )  # fmt: skip

    def check(self) -> None:
        if self.topic and not is_recording(self.file):
            raise ParameterError("topic", self.topic, "empty where path.file is no recording (.mcap)")
        for spec in specs(Path):
            if not self.file and spec.kind is float and not getattr(self, spec.name) > 0.0:
                value = getattr(self, spec.name) / spec.scale
                raise ParameterError(spec.key, value, "above 0 for a straight cut (or give path.file)")


@dataclass(frozen=True, eq=False)
class Cell(Record):
    """The whole parameter file."""

    start_joints: np.ndarray = parameter(
        unit="deg", size=6, low=-720.0, high=720.0, text="posture at the start, selects the branch"
    )
    arm: Arm
    mount: Mount
    workpiece: Workpiece
    tool: Tool
    cutting: Cutting
    stock: Stock
    path: Path
    dynamics: Dynamics
    exchange: Exchange
    compensation: Compensation
    timing: Timing = dataclasses.field(default_factory=Timing)
    program: Program = dataclasses.field(default_factory=Program)
    limits: Limits = dataclasses.field(default_factory=Limits)
    uncertainty: Uncertainty = dataclasses.field(default_factory=Uncertainty)

    def check(self) -> None:
        turn = 2.0 * np.pi / self.exchange.micro_step
        if abs(turn - round(turn)) > 1e-6:
            raise ParameterError("exchange.micro_step_deg", np.degrees(self.exchange.micro_step), "a whole part of 360")
        self.exchange.clock(self.tool.spindle_speed)
        if self.path.file:
            return
        steps = self.path.length / self.path.feed_rate / min(self.exchange.period, self.timing.controller_step)
        if not steps <= MOST_STEPS:
            shown = self.path.feed_rate * 60.0
            allowed = f"faster: the pass would take {steps:.3g} steps, more than {MOST_STEPS:g}"
            raise ParameterError("path.feed_rate_m_per_min", shown, allowed)
        check_effort(self.exchange, self.tool, self.stock, self.path.length / self.path.feed_rate)

    @functools.cached_property
    def clock(self) -> Clock:
        return self.exchange.clock(self.tool.spindle_speed)

    @functools.cached_property
    def fed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` run under the limits of the controller alone; None for a straight cut.

        A recorded trajectory has its times already and keeps them.
        """
        if not self.path.file:
            return None
        found = _read_path(self.path)
        timed = found if isinstance(found, TimedPath) else time_path(found, self.timing)
        self._check_duration(timed.trajectory)
        check_path(self.path.file, timed, self.tool, self.stock)
        return timed

    @functools.cached_property
    def timed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` run under the limits of controller and joints; None for a straight cut."""
        timed = self.fed_path
        if timed is None:
            return None
        try:
            joints = self.joints(timed.trajectory)
        except (ReachError, JointLimitError, SingularityError) as error:
            raise self._unreachable(timed, error) from None
        if timed.timed_by_source:
            return timed
        slower = limit_by_joints(
            timed.trajectory, joints, self.arm.joint_speed_limit, self.arm.joint_acceleration_limit
        )
        return dataclasses.replace(timed, trajectory=slower)

    def _unreachable(self, timed: TimedPath, error: MillingError) -> InputError:
        """What the arm refuses, with point and line, and a hint where the path is far larger than the stock."""
        point = error.index[0] if error.index else 0
        line = int(timed.toolpath.line[timed.block[point] if point else 0]) or None
        reason = str(error).removesuffix(f" (pose {point})")
        extent, stock = (
            np.ptp(timed.toolpath.position[:, :2], axis=0).max(),
            (self.stock.max - self.stock.min)[:2].max(),
        )
        if extent > 5.0 * stock:
            reason += f"; the path is {extent / stock:.0f} times as wide as the stock, check the unit (G20, G21)"
        return InputError(self.path.file, f"point {point + 1} of the path: {reason}", line)

    def _check_duration(self, run: Trajectory) -> None:
        """Memory and time of a pass are in proportion to its steps; a path of days is a mistake of the feed."""
        steps = run.duration_ns * 1e-9 / self.exchange.period
        if not steps <= MOST_STEPS:
            shown = f"{run.duration_ns * 1e-9:.4g} s, {steps:.3g} exchange periods, more than {MOST_STEPS:g}"
            reason = f"would take {shown}: cut it in pieces, or raise exchange.period_ms"
            raise InputError(self.path.file, reason)
        sinks = sinking(run.time, run.position[:, 2], float(self.stock.max[2]))
        check_effort(self.exchange, self.tool, self.stock, run.duration_ns * 1e-9, sinks)

    def target(self) -> Trajectory:
        """The programmed trajectory of the tool tip in the workpiece frame, knots at the controller step."""
        if self.timed_path is not None:
            return self.timed_path.trajectory
        path, period = self.path, self.timing.controller_step
        start = [*path.start, self.stock.max[2] - path.depth_of_cut]
        return Trajectory.straight_line(start, [1.0, 0.0, 0.0], path.length, path.feed_rate, period)

    def joints(self, trajectory: Trajectory) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command the knots of a trajectory, on the branch of ``start_joints``."""
        return self.joints_at(trajectory.position, trajectory.quaternion)

    def joints_at(self, position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), for tool positions (n, 3) [m] and orientations (n, 4), workpiece frame."""
        tool = Pose(position, rotation_from_quaternion(quaternion))
        return inverse_near(self.arm, self.mount, self.workpiece.pose @ tool, self.start_joints)

    @functools.cached_property
    def modal_model(self) -> ModalModel:
        """Modes at the posture where the target trajectory starts, in workpiece axes."""
        start = self.joints(self.target())[:1]
        return modal_models(self.arm, self.mount, self.dynamics, self.workpiece.pose, start)[0]

    def arm_model(self, reference: Trajectory) -> ArmModel:
        """Eq. (1) over one exchange period, at the posture where the reference starts or along all of it."""
        period, spacing = self.exchange.period, self.dynamics.posture_spacing
        between = 1
        stamps = np.zeros(1, np.int64)
        if self.dynamics.follow_pose:
            fastest = float(np.max(reference.feed(reference.time_ns)))
            between = max(1, int(spacing / max(fastest, 1e-9) / period))
            knots = -(-self.clock.steps(reference.duration_ns) // between)
            check_postures(knots + 1, spacing)
            stamps = self.clock.stamp(np.arange(knots + 1) * between)
        joints = self.joints_at(reference.sample(stamps), reference.sample_orientation(stamps))
        models = modal_models(self.arm, self.mount, self.dynamics, self.workpiece.pose, joints)
        return arm_model(models, self.dynamics.damping_ratio, period, between)

    @property
    def low_frequency(self) -> float:
        """[Hz], the lowest mode that moves the tool perpendicular to the feed (more than along it)."""
        model = self.modal_model
        moves = model.output @ model.shape
        lateral = np.abs(moves[1]) > np.abs(moves[0])
        return float(model.frequency[lateral][0] if lateral.any() else model.frequency[0]) / (2 * np.pi)

    def thinned_steps(self, period: float = 0.01) -> int:
        """Exchange periods between two messages that come at most every ``period`` [s] of the pass."""
        return max(1, math.ceil(period / self.exchange.period - 1e-9))

    def cut(self) -> Cut:
        """Fresh workpiece."""
        return Cut(self.tool, self.cutting, self.stock, self.exchange.micro_step)

    @property
    def feed_rate(self) -> float:
        """[m/s], the highest that is programmed for cutting moves."""
        if self.timed_path is None:
            return self.path.feed_rate
        toolpath = self.timed_path.toolpath
        return float(np.max(toolpath.feed[~toolpath.rapid], initial=0.0))

    @property
    def full_engagement(self) -> float:
        """[s], when the middle of a tool that enters along x has come to the stock's border; 0 for a tool path file."""
        if self.path.file:
            return 0.0
        return max(0.0, float(self.stock.min[0] - self.path.start[0])) / self.path.feed_rate

    @property
    def scored_from_ns(self) -> int:
        """[ns], full engagement as a stamp."""
        return round(self.full_engagement * 1e9)


def _read_path(path: Path) -> Toolpath | TimedPath:
    """What ``path.file`` holds."""
    if is_recording(path.file):
        return read_recorded(path.file, path.topic, path.feed_rate)
    return read_toolpath(path.file)


def read_cell(path, assignments=()) -> Cell:
    """The cell of a parameter file, with ``key=value`` texts on top; raises ConfigError."""
    tree, lenient = override(read_tree(path), assignments)
    name = tree.get("path", {}).get("file") if isinstance(tree.get("path"), dict) else None
    if isinstance(name, str) and name:
        tree["path"]["file"] = str(find_tool_path(name, pathlib.Path(path).parent))
    return build(Cell, tree, path, lenient=lenient)
