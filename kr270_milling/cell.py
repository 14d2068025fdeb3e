"""One milling cell: every parameter record of one YAML file, and the models that they make."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.compensation.parameters import Compensation
from kr270_milling.config import Record, build, override, parameter, read_tree
from kr270_milling.cutting import Cut, Cutting, Stock, Tool
from kr270_milling.errors import ParameterError
from kr270_milling.frames import Pose, rotation_from_quaternion
from kr270_milling.robot import Arm, Mount, inverse_near
from kr270_milling.simulation.arm_model import arm_model, modal_models
from kr270_milling.simulation.dynamics import ArmModel, Dynamics, ModalModel
from kr270_milling.simulation.exchange import Clock, Exchange
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Cell", "Path", "Workpiece", "read_cell"]

MOST_STEPS = 5e6  # exchange periods or reference points of one pass; its series take some 250 bytes a step


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
    """YAML ``path``: a straight cut along +x of the workpiece frame."""

    start: np.ndarray = parameter(unit="mm", size=2, low=-1e5, high=1e5, text="x, y of the tool tip at the start")
    depth_of_cut: float = parameter(unit="mm", above=0.0, high=100.0, text="a_p, below the top of the stock")
    length: float = parameter(unit="mm", above=0.0, high=10000.0, text="length of the cut")
    feed_rate: float = parameter(unit="m_per_min", above=0.0, high=60.0, text="feed rate v_f")


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

    def check(self) -> None:
        turn = 2.0 * np.pi / self.exchange.micro_step
        if abs(turn - round(turn)) > 1e-6:
            raise ParameterError("exchange.micro_step_deg", np.degrees(self.exchange.micro_step), "a whole part of 360")
        self.exchange.clock(self.tool.spindle_speed)
        steps = self.path.length / self.path.feed_rate / min(self.exchange.period, self.compensation.controller_step)
        if not steps <= MOST_STEPS:
            shown = self.path.feed_rate * 60.0
            allowed = f"faster: the pass would take {steps:.3g} steps, more than {MOST_STEPS:g}"
            raise ParameterError("path.feed_rate_m_per_min", shown, allowed)

    @functools.cached_property
    def clock(self) -> Clock:
        return self.exchange.clock(self.tool.spindle_speed)

    @functools.cached_property
    def timed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` run under the limits of controller and joints; None for a straight cut."""
        if not self.path.file:
            return None
        timed = time_path(read_toolpath(self.path.file), self.timing)
        joints = self.joints(timed.trajectory)
        slower = limit_by_joints(
            timed.trajectory, joints, self.arm.joint_speed_limit, self.arm.joint_acceleration_limit
        )
        return dataclasses.replace(timed, trajectory=slower)

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

    @functools.cached_property
    def arm_model(self) -> ArmModel:
        """Eq. (1) at the posture where the target trajectory starts, over one exchange period."""
        return arm_model([self.modal_model], self.dynamics.damping_ratio, self.exchange.period)

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
    def full_engagement(self) -> float:
        """[s], R / v_f: when the tool that enters from the border is fully engaged."""
        return 0.5 * self.tool.diameter / self.path.feed_rate

    @property
    def scored_from_ns(self) -> int:
        """[ns], full engagement as a stamp."""
        return round(self.full_engagement * 1e9)


def read_cell(path, assignments=()) -> Cell:
    """The cell of a parameter file, with ``key=value`` texts on top; raises ConfigError."""
    tree, lenient = override(read_tree(path), assignments)
    return build(Cell, tree, path, lenient=lenient)
