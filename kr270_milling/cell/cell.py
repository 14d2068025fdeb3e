"""One milling cell: its parameter file, and the models that it makes."""

from __future__ import annotations

import functools
import math
import pathlib
from dataclasses import dataclass

import numpy as np

from kr270_milling.bag.recorded_path import find_tool_path
from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.frames import Pose, abc_from_rotation, rotation_from_quaternion
from kr270_milling.base.record import build, override, read_tree
from kr270_milling.cell.path import fed_path, read_program, straight_cut, within_joint_limits
from kr270_milling.cell.plausibility import MOST_STEPS, check_postures
from kr270_milling.cell.records import Parameters, Path, Workpiece
from kr270_milling.cutting import Cut
from kr270_milling.robot import inverse_near, pose
from kr270_milling.simulation.arm_model import arm_model, modal_models
from kr270_milling.simulation.dynamics import ArmModel, ModalModel
from kr270_milling.simulation.exchange import Clock
from kr270_milling.simulation.reference_motion import approach
from kr270_milling.trajectory.source_program import SourceProgram
from kr270_milling.trajectory.timing import TimedPath
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["MOST_STEPS", "Cell", "Path", "Workpiece", "read_cell", "with_program"]


SAME_PLACE = 1e-3  #: [mm], [deg]


@dataclass(frozen=True, eq=False)
class Cell(Parameters):
    """The records of a parameter file with what follows from them; lengths in metres, workpiece axes."""

    def __post_init__(self):
        super().__post_init__()
        if not self.workpiece.xyz.size or not self.workpiece.abc.size:  # at the start joints
            object.__setattr__(self, "workpiece", self.placed())

    def __repr__(self) -> str:
        cut = self.path.file.rpartition("/")[2] or f"straight cut of {1e3 * self.path.length:g} mm"
        return f"<Cell {self.arm.name}: {cut}>"

    def placed(self) -> Workpiece:
        """The workpiece where the start joints put the tool at the start of the straight cut."""
        cut = straight_cut(self)
        start = Pose(cut.position[0], rotation_from_quaternion(cut.quaternion[0]))
        placed = pose(self.arm, self.mount, self.start_joints) @ start.inverse()
        return self.workpiece.replace(xyz=placed.position, abc=abc_from_rotation(placed.rotation))

    @functools.cached_property
    def clock(self) -> Clock:
        return self.exchange.clock(self.tool.spindle_speed)

    @functools.cached_property
    def fed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` under the limits of the controller alone; None for a straight cut."""
        return fed_path(self) if self.path.file else None

    @functools.cached_property
    def timed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` under the limits of controller and joints; None for a straight cut."""
        return within_joint_limits(self, self.fed_path, self.joints) if self.fed_path else None

    @functools.cached_property
    def program_of_path(self) -> SourceProgram:
        """What the program in ``path.file`` says beside its moves; empty where there is none."""
        if self.tool.spindle_speed > 0.0 and self.fed_path is not None:
            return self.fed_path.toolpath.program
        return read_program(self.path) if self.path.file else SourceProgram()

    def target(self) -> Trajectory:
        """The programmed trajectory of the tool tip in the workpiece frame, knots at the controller step."""
        return self.timed_path.trajectory if self.timed_path else straight_cut(self)

    def joints(self, trajectory: Trajectory) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command the knots of a trajectory, on the branch of ``posture``."""
        return self.joints_at(trajectory.position, trajectory.quaternion)

    def joints_at(self, position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), for tool positions (n, 3) [m] and orientations (n, 4), workpiece frame."""
        tool = Pose(position, rotation_from_quaternion(quaternion))
        return inverse_near(self.arm, self.mount, self.workpiece.pose @ tool, self.posture)

    @functools.cached_property
    def modal_model(self) -> ModalModel:
        """Modes at the posture where the target trajectory starts, in workpiece axes."""
        start = self.joints(self.target())[:1]
        return modal_models(self.arm, self.mount, self.dynamics, self.workpiece.pose, start)[0]

    def arm_model(self, reference: Trajectory) -> ArmModel:
        """Eq. (1) over one exchange period, at the posture where the reference starts or along all of it."""
        between, stamps = self._postures(reference)
        joints = self.joints_at(reference.sample(stamps), reference.sample_orientation(stamps))
        models = modal_models(self.arm, self.mount, self.dynamics, self.workpiece.pose, joints)
        dynamics, period = self.dynamics, self.exchange.period
        before = approach(self.target())
        return arm_model(models, dynamics.damping_ratio, period, between, dynamics.reference_inertia, before)

    def _postures(self, reference: Trajectory) -> tuple[int, np.ndarray]:
        """Exchange periods between two modelled postures, and the stamps [ns] of the postures."""
        if not self.dynamics.follow_pose:
            return 1, np.zeros(1, np.int64)
        fastest = float(np.max(reference.feed(reference.time_ns)))
        between = max(1, int(self.dynamics.posture_spacing / max(fastest, 1e-9) / self.exchange.period))
        knots = -(-self.clock.steps(reference.duration_ns) // between)
        check_postures(knots + 1, self.dynamics.posture_spacing)
        return between, self.clock.stamp(np.arange(knots + 1) * between)

    @property
    def low_frequency(self) -> float:
        """[Hz], the lowest mode that moves the tool across the feed more than along it.

        The feed is that of a straight cut, +x of the workpiece frame; NaN for a tool path, which has no one feed.
        """
        if self.path.file:
            return math.nan
        model = self.modal_model
        moves = model.output @ model.shape
        lateral = np.abs(moves[1]) > np.abs(moves[0])
        return float(model.frequency[lateral][0] if lateral.any() else model.frequency[0]) / (2 * np.pi)

    def steps_of(self, period: float) -> int:
        """Exchange periods that make ``period`` [s] at least."""
        return max(1, math.ceil(period / self.exchange.period - 1e-9))

    @property
    def thinned_steps(self) -> int:
        """Exchange periods from one published deflection to the next: ``publish.every``, or as many as make 10 ms."""
        return self.publish.every or self.steps_of(0.01)

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


def read_cell(path, assignments=()) -> Cell:
    """The cell of a parameter file, with ``key=value`` texts on top; raises ConfigError, InputError.

    What a program says and the file does not, the spindle speed, is taken from the program.
    """
    below = read_tree(path)
    tree, assigned = override(below, assignments)
    name = tree.get("path", {}).get("file") if isinstance(tree.get("path"), dict) else None
    if isinstance(name, str) and name:
        tree["path"]["file"] = str(find_tool_path(name, pathlib.Path(path).parent))
    tree = _placed_by_hand(tree, assigned, path)
    cell = build(Cell, tree, path)
    _check_place(cell, tree, path)
    return with_program(cell, path)


def with_program(cell: Cell, source="") -> Cell:
    """The cell with the spindle speed of its program where it has none of its own."""
    if cell.tool.spindle_speed > 0.0:
        return cell
    speeds = cell.program_of_path.spindle_speeds
    if not speeds:
        allowed = "above 0: the program in path.file has no spindle speed S"
        raise ConfigError(source, "tool.spindle_speed_rpm", 0.0, allowed)
    try:
        return cell.replace(tool=cell.tool.replace(spindle_speed=abs(speeds[0])))
    except ParameterError as error:
        raise ConfigError(source, error.key, error.value, error.allowed) from None


def _placed_by_hand(tree: dict, assigned: frozenset, path) -> dict:
    """A place given on the command line moves a workpiece that the file puts at the start joints."""
    given = {key for key in ("xyz_mm", "abc_deg") if f"workpiece.{key}" in assigned}
    place = tree.get("workpiece")
    if not given or not isinstance(place, dict) or place.get("at_start_joints") is not True:
        return tree
    rest = {key: value for key, value in place.items() if key not in ("xyz_mm", "abc_deg")}
    derived = build(Cell, tree | {"workpiece": rest}, path).workpiece
    numbers = {"xyz_mm": (1e3 * derived.xyz).tolist(), "abc_deg": np.degrees(derived.abc).tolist()}
    chosen = {key: place[key] if key in given else numbers[key] for key in numbers}
    return tree | {"workpiece": rest | chosen | {"at_start_joints": False}}


def _check_place(cell: Cell, tree: dict, path) -> None:
    """Raise ConfigError where a file gives the place of a workpiece twice, and differently."""
    if not cell.workpiece.at_start_joints:
        return
    place = cell.placed()
    derived = {"xyz_mm": 1e3 * place.xyz, "abc_deg": np.degrees(place.abc)}
    for key, value in derived.items():
        given = tree["workpiece"].get(key)
        if given is not None and not np.allclose(given, value, rtol=0.0, atol=SAME_PLACE):
            raise ConfigError(path, f"workpiece.{key}", given, "left out: at_start_joints places the workpiece")
