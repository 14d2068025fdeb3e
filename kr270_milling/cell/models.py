"""The models of a cell: arm, programmed path and cut; equal cells share what is expensive to make."""

from __future__ import annotations

import functools
import math
import os

import numpy as np

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.paths import CellPath, ProgramPath, StraightCut, check_postures
from kr270_milling.cell.sections import PathSection
from kr270_milling.cell.stage import Removal, cleared, removal_along
from kr270_milling.path.timing import Timing
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Cut, CutModel, EngagementCut, Stock, Tool
from kr270_milling.physics.cutting.engagement import mean_thrusts
from kr270_milling.physics.cutting.grid import RESOLVED_NODES
from kr270_milling.physics.cutting.laws import Cutting
from kr270_milling.physics.motion.arm_model import arm_model
from kr270_milling.physics.motion.dynamics import ArmFactors, ArmModel, ModalModel, approach, discretise
from kr270_milling.physics.motion.periods import Exchange

MOST_LONG_POSTURES = 20_000  #: of a program that is cut by its engagement; more lie between two of them, linearly


def arm_of(cell: Cell) -> PlacedArm:
    """Return the arm of a cell at its workpiece."""
    near = cell.start_joints if cell.start_joints.size else cell.posture_hint
    return PlacedArm(cell.arm, cell.mount, cell.workpiece, cell.dynamics, cell.tool, tuple(near.tolist()))


def path_of(cell: Cell) -> CellPath:
    """Return the programmed path of a cell; its file is read and timed when the path is first used."""
    by_teeth = not cell.cutting.by_engagement
    return _path(_finished(cell), cell.stock, cell.tool, cell.timing, cell.exchange, arm_of(cell), by_teeth)


def program_path(cell: Cell) -> Toolpath:
    """Return the tool path of the program, without finishing passes; raises InputError without one or with times."""
    content = cell.path.loaded().read() if cell.path.file else None
    if not isinstance(content, Toolpath):
        raise InputError("path.file", "must be a program without times")
    return content


def _finished(cell: Cell) -> PathSection:
    """The section ``path`` with its content, which contains the finishing passes."""
    path, passes = cell.path.loaded(), cell.compensation.finish
    if not passes or (path.file and path.content is None):
        return path
    if not isinstance(path.content, Toolpath):
        allowed = "0 for a straight cut and for a path with times, which have no program to repeat"
        raise ParameterError("compensation.finish", passes, allowed)
    return path.replace(content=_repeated(path.content, passes, float(cell.stock.max[2]) + cell.krl.safe_height))


@functools.lru_cache(maxsize=4)
def _repeated(path: Toolpath, passes: int, height: float) -> Toolpath:
    return path.repeated(passes, height)


# each core runs a simulated robot; their paths share the 60 MB of an hour, unless a joint slows the path
@functools.lru_cache(maxsize=4 + 2 * (os.cpu_count() or 1))
def _path(
    path: PathSection, stock: Stock, tool: Tool, timing: Timing, exchange: Exchange, arm: PlacedArm, by_teeth: bool
) -> CellPath:
    if path.file:
        return ProgramPath(path, stock, tool, timing, exchange, arm, by_teeth)
    return StraightCut(path, stock, tool, timing, exchange)


def cut_of(cell: Cell, rigid: bool = False) -> CutModel:
    """Fresh workpiece; of a later tool the stock that the earlier tools leave, rigid: on their programmed paths."""
    cut: CutModel
    common = cell.tool, cell.cutting, cell.stock, cell.exchange.micro_step
    if cell.cutting.by_engagement:
        path = path_of(cell)
        bounce = _bounce(arm_of(cell), path, cell.cutting)
        cut = EngagementCut(*common, give=_give(cell), tilts=path.tilts, bounce=bounce, upright=path.upright)
    else:
        cut = Cut(*common)
    if cell.earlier:
        cut.continue_from(cleared(cell.earlier, cell.stock, not rigid))
    return cut


def flat_floors(cell: Cell) -> bool:
    """Return whether the tool leaves level floors and upright walls: a flat end with an upright axis."""
    return cell.tool.has_flat_end and not path_of(cell).tilts


def _give(cell: Cell) -> float:
    """Displacement of the tip along z after an exchange period under a force along z, from rest [m/N]."""
    ratio, period = cell.dynamics.damping_ratio, cell.exchange.period
    _, driven, output, feedthrough = discretise(modal_model_of(cell), ratio, period)
    return float((output @ driven + feedthrough)[2, 2])


@functools.lru_cache(maxsize=8)  # a robot runs several programs
def _bounce(arm: PlacedArm, path: CellPath, cutting: Cutting) -> np.ndarray:
    """Mean thrust of a tip that bounces on its end edges, as a share of that of a steady tip, see ``mean_thrusts``."""
    model, tool = _start_modes(arm, path), arm.tool
    modes = (
        model.frequency,
        model.ratios(arm.dynamics.damping_ratio),
        (model.output @ model.shape)[2],
        (model.shape.T @ model.force)[:, 2],
    )
    return mean_thrusts(modes, tool, cutting, 2.0 * math.pi / (tool.spindle_speed * tool.teeth))


def modal_model_of(cell: Cell) -> ModalModel:
    """Modes at the posture where the target trajectory starts, in workpiece axes."""
    return _start_modes(arm_of(cell), path_of(cell))


@functools.lru_cache(maxsize=8)
def _start_modes(arm: PlacedArm, path: CellPath) -> ModalModel:
    return arm.modes_at(arm.joints_at(path.target.position[:1], path.target.quaternion[:1]))[0]


def arm_model_of(cell: Cell, reference: Trajectory, factors: ArmFactors | None = None) -> ArmModel:
    """Eq. (1) over one exchange period, at the posture where the reference starts or along all of it.

    factors: of an identified arm on the modes.
    """
    arm, dynamics = arm_of(cell), cell.dynamics
    between, stamps = _postures(cell, reference)
    models = arm.modes_at(arm.joints_along(reference, stamps))
    if factors is not None:
        models = [model.scaled(factors, dynamics.damping_ratio) for model in models]
    before = np.zeros(6) if reference.standing[0] else approach(path_of(cell).target)
    ratio, inertia = dynamics.damping_ratio, dynamics.reference_inertia
    revolution = 2.0 * math.pi / cell.tool.spindle_speed
    return arm_model(models, ratio, cell.exchange.period, between, inertia, before, revolution)


def _postures(cell: Cell, reference: Trajectory) -> tuple[int, np.ndarray]:
    """Exchange periods between two modelled postures, and the stamps [ns] of the postures."""
    if not cell.dynamics.follow_pose:
        return 1, np.zeros(1, np.int64)
    path, spacing = path_of(cell), cell.dynamics.posture_spacing
    steps, least = path.clock.steps(reference.duration_ns), 1
    if cell.cutting.by_engagement:  # a rapid move has no force, and a long program does not need every posture
        fastest, least = path.feed_rate, -(-steps // MOST_LONG_POSTURES)
    else:
        fastest = float(np.max(reference.feed(reference.time_ns)))
    between = max(least, int(spacing / max(fastest, 1e-9) / cell.exchange.period))
    knots = -(-steps // between)
    check_postures(knots + 1, spacing)
    return between, path.clock.stamp(np.arange(knots + 1) * between)


def low_frequency_of(cell: Cell) -> float:
    """[Hz], the lowest mode that moves the tool across the feed more than along it.

    The feed is that of a straight cut, +x of the workpiece frame; NaN for a tool path, which has no one feed.
    """
    if not path_of(cell).straight:
        return math.nan
    model = modal_model_of(cell)
    moves = model.output @ model.shape
    lateral = np.abs(moves[1]) > np.abs(moves[0])
    return float(model.frequency[lateral][0] if lateral.any() else model.frequency[0]) / (2 * np.pi)


def cut_text_of(cell: Cell) -> str:
    """The models of cut and tool in one line."""
    tool = cell.tool.compliance_text
    if not cell.cutting.by_engagement:
        return f"cut: teeth, each tooth by itself{thin_chips(cell)}; {tool}"
    period, step = 1e3 * cell.exchange.period, 1e3 * cell.stock.grid_step
    end = "" if cell.tool.has_flat_end else f" of a cutter of revolution (tool.type {cell.tool.type})"
    return f"cut: engagement{end}, mean force over {period:.3g} ms on a map of {step:.3g} mm (cutting.detail); {tool}"


def thin_chips(cell: Cell) -> str:
    """Return a clause where the sweep of the teeth resolves the chips of a slow feed too coarsely, else empty.

    A tooth meets f R dphi / ds^2 nodes in a micro-step, f the feed per tooth. A micro-step that meets none has no
    force of the edge: with 5, 2.7, 1.4 and 0.7 nodes a slot showed 95, 88, 73 and 46 % of its force.
    """
    (_, feed, _), tool = cell.path.feeds, cell.tool
    per_tooth = feed * 2.0 * math.pi / (tool.spindle_speed * tool.teeth) if tool.spindle_speed else math.inf
    nodes = per_tooth * float(tool.radii.max()) * cell.exchange.micro_step / cell.stock.grid_step**2
    if feed == 0.0 or nodes >= RESOLVED_NODES:
        return ""
    return (
        f" (at {6e4 * feed:.3g} mm/min a tooth meets {nodes:.2g} nodes of the grid a micro-step, below "
        f"{RESOLVED_NODES:g}: the force of thin chips is too low; set a finer stock.grid_step_um or a coarser "
        "exchange.micro_step_deg)"
    )


def removal_of(cell: Cell) -> Removal:
    """Return the material that the tool removes along its programmed path; raises InputError without a program."""
    fed = path_of(cell).fed
    if fed is None:
        raise InputError("path.file", "is empty, and a straight cut is no program")
    return removal_along(cell.path.tool, cell.tool, fed.toolpath)
