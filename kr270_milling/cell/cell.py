"""One milling cell: its parameter file as records, what they must agree in, and the models that they make."""

from __future__ import annotations

import contextlib
import functools
import math
import pathlib
import re
from dataclasses import dataclass, replace

import numpy as np

from kr270_milling.base.errors import ConfigError, InputError, ParameterError
from kr270_milling.base.frames import JOINT_NAMES, Pose, abc_from_rotation, rotation_from_quaternion
from kr270_milling.base.record import Record, build, derived, override, parameter, read_tree, section
from kr270_milling.cell.path import check_postures
from kr270_milling.cell.paths import ProgramPath, StraightCut
from kr270_milling.cell.sections import Limits, PathSection, Program, Tolerances, Uncertainty, Workpiece
from kr270_milling.cell.stage import Removal, Stage, cleared, removal_along
from kr270_milling.cell.tools import in_program_order, tool_trees
from kr270_milling.path.cam.readers import find_tool_path
from kr270_milling.path.timing import TimedPath, Timing
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.cutting import Cut, CutModel, Cutting, EngagementCut, Stock, Tool
from kr270_milling.physics.motion.arm_model import Dynamics, arm_model, modal_models
from kr270_milling.physics.motion.dynamics import ArmModel, ModalModel, approach, discretise
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.periods import Clock, Exchange, Publish
from kr270_milling.physics.robot import Arm, Mount, inverse_along, pose
from kr270_milling.physics.robot.sensor import ForceSensor

__all__ = ["Cell", "read_cell", "read_cells", "with_program"]

SAME_PLACE = 1e-3  #: [mm], [deg]
LONG_PASS = 500_000  #: exchange periods of a pass, some 200 bytes each: 33 min at 4 ms
MOST_LONG_POSTURES = 20_000  #: of a program that is cut by its engagement; more lie between two of them, linearly
RESOLVED_NODES = 10.0  #: that a tooth meets in a micro-step: a slot then has 97 % of its force
LONG_CUTTING = 60.0  #: [s]; programs that cut longer are not swept tooth by tooth where cutting.detail is auto


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell(Record):
    """The whole parameter file with what follows from it; lengths in metres, workpiece axes."""

    start_joints: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="where the path starts, six joints: workpiece.at_start_joints"
    )
    posture_hint: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="six joints near those of the path: they choose the branch"
    )
    joint_names: tuple[str, ...] = parameter(
        JOINT_NAMES, text="names of the six joints in joint_states, joint_trajectory and robot_description"
    )
    arm: Arm
    mount: Mount
    sensor: ForceSensor = section(ForceSensor)
    workpiece: Workpiece
    tool: Tool
    cutting: Cutting
    stock: Stock
    path: PathSection
    dynamics: Dynamics
    exchange: Exchange
    compensation: CompensationSettings
    publish: Publish = section(Publish)
    timing: Timing = section(Timing)
    krl: Program = section(Program, key="program")
    limits: Limits = section(Limits)
    uncertainty: Uncertainty = section(Uncertainty)
    tolerances: Tolerances = section(Tolerances, key="part")
    imperfections: Imperfections = section(Imperfections)
    stage: Stage | None = derived(None)  #: in a program with several tools; None: one tool, an uncut stock

    def __post_init__(self):
        super().__post_init__()
        if not self.workpiece.xyz.size or not self.workpiece.abc.size:  # at the start joints
            object.__setattr__(self, "workpiece", self.placed())

    def check(self) -> None:
        turn = 2.0 * np.pi / self.exchange.micro_step
        if abs(turn - round(turn)) > 1e-6:
            raise ParameterError("exchange.micro_step_deg", np.degrees(self.exchange.micro_step), "a whole part of 360")
        self._check_posture()
        if len(set(self.joint_names)) != 6 or len(self.joint_names) != 6 or not all(self.joint_names):
            raise ParameterError("joint_names", list(self.joint_names), "six different names")
        if self.by_engagement and not self.path.file:
            raise ParameterError("cutting.detail", "engagement", "teeth or auto for a straight cut")
        if self.tool.spindle_speed > 0.0:
            self.exchange.clock(self.tool.spindle_speed)
        elif self.programmed.spindle_speed_needed:
            raise ParameterError("tool.spindle_speed_rpm", 0.0, "above 0 where no program states it")
        self.programmed.check()

    def _check_posture(self) -> None:
        """Six joints, once: where the path starts, or near it."""
        placed = self.workpiece.at_start_joints
        for key, value in (("start_joints_deg", self.start_joints), ("posture_hint_deg", self.posture_hint)):
            if value.size not in (0, 6):
                raise ParameterError(key, np.degrees(value).tolist(), "six joint positions")
        if placed and not (self.path.length and self.path.feed_rate):
            allowed = "false without a straight cut in path; give xyz_mm and abc_deg"
            raise ParameterError("workpiece.at_start_joints", True, allowed)
        if placed and not self.start_joints.size:
            raise ParameterError("start_joints_deg", [], "six joint positions for workpiece.at_start_joints")
        if not self.posture.size:
            raise ParameterError("posture_hint_deg", None, "six joint positions (or give start_joints_deg)")

    @property
    def posture(self) -> np.ndarray:
        """Joint positions [rad], (6,), at the start of the path or near them; they choose the branch."""
        return self.start_joints if self.start_joints.size else self.posture_hint

    def __repr__(self) -> str:
        return f"<Cell {self.arm.name}: {self.programmed.name}>"

    def placed(self) -> Workpiece:
        """The workpiece where the start joints put the tool at the start of the straight cut."""
        cut = StraightCut(self.path, self.stock, self.tool, self.timing, self.exchange).target
        start = Pose(cut.position[0], rotation_from_quaternion(cut.quaternion[0]))
        placed = pose(self.arm, self.mount, self.start_joints) @ start.inverse()
        return self.workpiece.replace(xyz=placed.position, abc=abc_from_rotation(placed.rotation))

    @functools.cached_property
    def clock(self) -> Clock:
        return self.exchange.clock(self.tool.spindle_speed)

    @functools.cached_property
    def programmed(self) -> StraightCut | ProgramPath:
        """The programmed path."""
        common = self.path, self.stock, self.tool, self.timing, self.exchange
        return (
            ProgramPath(*common, self.arm, self.joints, not self.by_engagement)
            if self.path.file
            else StraightCut(*common)
        )

    @property
    def fed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` under the limits of the controller alone; None for a straight cut."""
        return self.programmed.fed

    @property
    def timed_path(self) -> TimedPath | None:
        """The tool path of ``path.file`` under the limits of controller and joints; None for a straight cut."""
        return self.programmed.timed

    def target(self) -> Trajectory:
        """The programmed trajectory of the tool tip in the workpiece frame, knots at the controller step."""
        return self.programmed.target

    def joints(self, trajectory: Trajectory) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command the knots of a trajectory, on the branch of ``posture``."""
        return self.joints_at(trajectory.position, trajectory.quaternion)

    def joints_at(self, position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), for tool positions (n, 3) [m] and orientations (n, 4), workpiece frame."""
        return inverse_along(self.arm, self.mount, self.workpiece.pose, position, quaternion, self.posture)

    def joints_along(self, reference: Trajectory, stamps: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command a trajectory at stamps (n,) [ns]."""
        return self.joints_at(reference.sample(stamps), reference.sample_orientation(stamps))

    @functools.cached_property
    def modal_model(self) -> ModalModel:
        """Modes at the posture where the target trajectory starts, in workpiece axes."""
        return self.modes_at(self.joints(self.target())[:1])[0]

    def modes_at(self, joints: np.ndarray) -> list[ModalModel]:
        """Modes at postures (n, 6) [rad], in workpiece axes."""
        soft = self.tool.lateral_compliance
        return modal_models(self.arm, self.mount, self.dynamics, self.workpiece.pose, joints, soft)

    def arm_model(self, reference: Trajectory) -> ArmModel:
        """Eq. (1) over one exchange period, at the posture where the reference starts or along all of it."""
        between, stamps = self._postures(reference)
        models = self.modes_at(self.joints_along(reference, stamps))
        dynamics, before = self.dynamics, np.zeros(6) if reference.standing[0] else approach(self.target())
        ratio, inertia = dynamics.damping_ratio, dynamics.reference_inertia
        revolution = 2.0 * math.pi / self.tool.spindle_speed
        return arm_model(models, ratio, self.exchange.period, between, inertia, before, revolution)

    def _postures(self, reference: Trajectory) -> tuple[int, np.ndarray]:
        """Exchange periods between two modelled postures, and the stamps [ns] of the postures."""
        if not self.dynamics.follow_pose:
            return 1, np.zeros(1, np.int64)
        steps, least = self.clock.steps(reference.duration_ns), 1
        if self.by_engagement:  # a rapid move has no force, and a long program does not need every posture
            fastest, least = self.feed_rate, -(-steps // MOST_LONG_POSTURES)
        else:
            fastest = float(np.max(reference.feed(reference.time_ns)))
        between = max(least, int(self.dynamics.posture_spacing / max(fastest, 1e-9) / self.exchange.period))
        knots = -(-steps // between)
        check_postures(knots + 1, self.dynamics.posture_spacing)
        return between, self.clock.stamp(np.arange(knots + 1) * between)

    @property
    def long_pass(self) -> bool:
        """Whether the series of a pass along the target fill so much memory that few of them are stored."""
        return self.clock.steps(self.target().duration_ns) > LONG_PASS

    @property
    def low_frequency(self) -> float:
        """[Hz], the lowest mode that moves the tool across the feed more than along it.

        The feed is that of a straight cut, +x of the workpiece frame; NaN for a tool path, which has no one feed.
        """
        if not self.programmed.straight:
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

    @property
    def by_engagement(self) -> bool:
        """Whether the mean force of the engagement is the model of the cut, and not the sweep of the teeth."""
        return self.cutting.detail == "engagement"

    @property
    def cut_text(self) -> str:
        """The models of cut and tool in one line."""
        tool = self.tool.compliance_text
        if not self.by_engagement:
            return f"cut: teeth, each tooth by itself{self._thin_chips}; {tool}"
        period, step = 1e3 * self.exchange.period, 1e3 * self.stock.grid_step
        return f"cut: engagement, mean force over {period:.3g} ms on a map of {step:.3g} mm (cutting.detail); {tool}"

    @property
    def _thin_chips(self) -> str:
        """A clause where the sweep of the teeth resolves the chips of a slow feed too coarsely, else empty.

        A tooth meets f R dphi / ds^2 nodes in a micro-step, f the feed per tooth. A micro-step that meets none has no
        force of the edge: with 5, 2.7, 1.4 and 0.7 nodes a slot showed 95, 88, 73 and 46 % of its force.
        """
        feed, tool = self.programmed.slow_feed, self.tool
        per_tooth = feed * 2.0 * math.pi / (tool.spindle_speed * tool.teeth) if tool.spindle_speed else math.inf
        nodes = per_tooth * float(tool.radii.max()) * self.exchange.micro_step / self.stock.grid_step**2
        if feed == 0.0 or nodes >= RESOLVED_NODES:
            return ""
        return (
            f" (at {6e4 * feed:.3g} mm/min a tooth meets {nodes:.2g} nodes of the grid a micro-step, below "
            f"{RESOLVED_NODES:g}: the force of thin chips is too low; set a finer stock.grid_step_um or a coarser "
            "exchange.micro_step_deg)"
        )

    def cut(self, rigid: bool = False) -> CutModel:
        """Fresh workpiece; of a later tool the stock that the earlier tools leave, rigid: on their programmed paths."""
        cut: CutModel
        common = self.tool, self.cutting, self.stock, self.exchange.micro_step
        cut = EngagementCut(*common, give=self._give) if self.by_engagement else Cut(*common)
        if self.stage and self.stage.earlier:
            cut.continue_from(cleared(self.stage.earlier, self.stock, not rigid))
        return cut

    @functools.cached_property
    def _give(self) -> float:
        """Displacement of the tip along z after an exchange period under a force along z, from rest [m/N]."""
        _, driven, output, feedthrough = discretise(self.modal_model, self.dynamics.damping_ratio, self.exchange.period)
        return float((output @ driven + feedthrough)[2, 2])

    @property
    def programmed_removal(self) -> Removal:
        """What the tool removes along its programmed path; raises InputError without a program."""
        fed = self.fed_path
        if fed is None:
            raise InputError("path.file", "is empty, and a straight cut is no program")
        return removal_along(self.path.tool, self.tool, fed.toolpath)

    def after(self, earlier: tuple[Removal, ...]) -> Cell:
        """The cell of a tool after the passes of the earlier tools of its program."""
        return self.replace(stage=replace(self.stage, earlier=earlier)) if self.stage else self

    @property
    def feed_rate(self) -> float:
        """[m/s], the highest programmed feed of the cutting moves."""
        return self.programmed.feed_rate

    @property
    def full_engagement(self) -> float:
        """[s], when the middle of a tool that enters along x reaches the border of the stock; 0 for a program."""
        return self.programmed.full_engagement

    @property
    def scored_from_ns(self) -> int:
        """[ns], full engagement as a stamp."""
        return round(self.full_engagement * 1e9)


def read_cell(path, assignments=()) -> Cell:
    """The cell of a parameter file, with ``key=value`` texts on top; raises ConfigError, InputError.

    What a program says and the file does not, the spindle speed, is taken from the program. A file with ``tools``
    gives the cell of ``path.tool``.
    """
    cells = read_cells(path, assignments)
    if len(cells) > 1:
        advice = f"choose one with --set path.tool={cells[0].path.tool}"
        raise ConfigError(path, "tools", None, f"has {len(cells)} tools, and one cell is wanted: {advice}")
    return cells[0]


def read_cells(path, assignments=()) -> tuple[Cell, ...]:
    """The cells of all ``tools`` of a parameter file, in the order of the program; one cell without ``tools``.

    ``path.tool`` chooses one of the tools. The earlier tools leave their programmed part until ``Cell.after`` states
    their passes. Raises ConfigError, InputError.
    """
    below = read_tree(path)
    tree, assigned = override(below, assignments)
    name = tree.get("path", {}).get("file") if isinstance(tree.get("path"), dict) else None
    if isinstance(name, str) and name:
        tree["path"]["file"] = str(find_tool_path(name, pathlib.Path(path).parent))
    if "tools" not in tree:
        return (_one_cell(tree, assigned, path),)
    chosen = tree.get("path", {}).get("tool", "") if isinstance(tree.get("path"), dict) else ""
    by_tool = {name: _cell_of_tool(name, one, assigned, path) for name, one in tool_trees(tree, path).items()}
    order = in_program_order(tuple(by_tool), next(iter(by_tool.values())).programmed.source, path)
    cells = [by_tool[name] for name in order]
    cut = [cell.programmed_removal for cell in cells]
    tips = [cell.mount.xyz.tolist() for cell in cells]
    stages = [
        Stage(order[k], k + 1, len(cells), tuple(cut[:k]), tuple(cut[k + 1 :]), tips[k] in tips[:k])
        for k in range(len(cells))
    ]
    staged = [_staged(cell, stage, path) for cell, stage in zip(cells, stages, strict=True)]
    return tuple(cell for cell in staged if chosen in ("", cell.path.tool))


def _staged(cell: Cell, stage: Stage, path) -> Cell:
    """The cell of one of several tools, with the name of the tool in that of the robot program."""
    try:
        krl = cell.krl.replace(name=cell.krl.name + stage.suffix)
    except ParameterError as error:
        raise ConfigError(path, "program.name", error.value, f"{error.allowed}, with the tool") from None
    return cell.replace(stage=stage, krl=krl)


def _cell_of_tool(name: str, tree: dict, assigned: frozenset, path) -> Cell:
    try:
        return _one_cell(tree, assigned, path)
    except ConfigError as error:
        key = re.sub(r"^tool\.", f"tools.{name}.", error.key)
        raise ConfigError(path, key, error.value, error.allowed) from None


def _one_cell(tree: dict, assigned: frozenset, path) -> Cell:
    tree = _placed_by_hand(tree, assigned, path)
    cell = build(Cell, tree, path)
    _check_place(cell, tree, path)
    return with_program(cell, path)


def with_program(cell: Cell, source="") -> Cell:
    """Return the cell with the spindle speed, where the file has none, and the cutting model that its program needs."""
    cell = _with_spindle(cell, source)
    try:
        return _with_cut_model(cell)
    except ParameterError as error:
        raise ConfigError(source, error.key, error.value, error.allowed) from None


def _with_cut_model(cell: Cell) -> Cell:
    """Return the cell with ``cutting.detail`` as teeth or engagement; engagement: with its period and its grid.

    A program that cannot be read leaves ``auto``: the error appears where the path is used.
    """
    detail = cell.cutting.detail
    if detail == "auto":
        with contextlib.suppress(InputError):
            detail = "engagement" if cell.programmed.cutting_time > LONG_CUTTING else "teeth"
    if detail != "engagement":
        return cell.replace(cutting=cell.cutting.replace(detail=detail)) if detail != cell.cutting.detail else cell
    return cell.replace(
        cutting=cell.cutting.replace(detail=detail),
        exchange=cell.exchange.for_engagement(cell.tool.spindle_speed),
        stock=cell.stock.for_engagement(float(cell.tool.radii.max())),
    )


def _with_spindle(cell: Cell, source) -> Cell:
    if cell.tool.spindle_speed > 0.0:
        return cell
    speeds = cell.programmed.source.spindle_speeds
    if not speeds:
        allowed = "above 0: the program in path.file has no spindle speed S"
        raise ConfigError(source, "tool.spindle_speed_rpm", 0.0, allowed)
    try:
        return cell.replace(tool=cell.tool.replace(spindle_speed=abs(speeds[0])))
    except ParameterError as error:
        raise ConfigError(source, error.key, error.value, error.allowed) from None


def _placed_by_hand(tree: dict, assigned: frozenset, path) -> dict:
    """A place given on the command line moves a workpiece that the file puts at the start joints."""
    displayed = "workpiece.base_kuka" in assigned
    given = {key for key in ("xyz_mm", "abc_deg") if displayed or f"workpiece.{key}" in assigned}
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
        same = np.shape(given) == (3,) and np.allclose(given, value, rtol=0.0, atol=SAME_PLACE)
        if given is not None and np.size(given) and not same:
            raise ConfigError(path, f"workpiece.{key}", given, "left out: at_start_joints places the workpiece")
