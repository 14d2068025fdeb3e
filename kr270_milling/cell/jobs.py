"""The jobs around one pass of a cell: simulate it, score it, compensate it. No ROS."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import as_dict
from kr270_milling.base.errors import MillingError
from kr270_milling.base.frames import tool_axis
from kr270_milling.cell.arm import commanded_joints, mirrored
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_model_of, arm_of, cut_of, low_frequency_of, modal_model_of, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.plant import DIVERGED, Plant, coarser, cores, perturbed
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.learning import LONG, CellModels, Learner
from kr270_milling.physics.compensation.method import Method
from kr270_milling.physics.compensation.methods import method_of
from kr270_milling.physics.compensation.response import ArmResponse, Lag
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.physics.cutting import CutModel
from kr270_milling.physics.motion.dynamics import ArmFactors
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.milling_pass import PassResult, run_pass
from kr270_milling.physics.motion.scores import Scores, score

FEW_PERIODS = 500_000  #: exchange periods of a pass that is not long, some 200 bytes each: 33 min at 4 ms
PLANNED = 16  #: simulated robots for which ``robust`` plans in a long program, half of those in others


@dataclass(frozen=True, eq=False)
class ScoredPass:
    """A pass of a report or a table."""

    name: str
    reference: Trajectory
    result: PassResult
    scores: Scores
    record: PassRecord | None = None  #: report of a tracker on the pass; None: the pass itself

    def row(self) -> dict:
        """The keys that every command prints."""
        return {"name": self.name, **as_dict(self.scores)}


def simulate(
    cell: Cell,
    reference: Trajectory | None = None,
    name: str = "original",
    progress=None,
    plant: Plant | None = None,
    most_rows: float = math.inf,
    quick: bool = False,
) -> ScoredPass:
    """Run a pass on a fresh workpiece along ``reference`` (default: the target itself); plant: what runs it instead.

    most_rows: of the result, see ``PassResult.every``; quick: see ``run_pass``.
    """
    target = path_of(cell).target
    reference = target if reference is None else reference
    if plant is not None:
        result, number = plant.run(reference, progress), plant.passes - 1
        series = result.time_ns, _measured(cell, result), result.wrench
        record = pass_record(path_of(cell), cell.imperfections, *series, plant.cell.imperfections, number)
        return ScoredPass(name, reference, result, scored(cell, result, low_frequency_of(plant.cell)), record)
    cut = cut_of(cell)
    result = run_pass(
        arm_model_of(cell, reference),
        cut,
        path_of(cell).clock,
        target,
        reference,
        cell.exchange.iterations,
        progress,
        path_of(cell).drilling_at,
        most_rows,
        quick,
    )
    if not path_of(cell).straight:  # its sweep takes long, so the assessment of the part uses this workpiece
        result = dataclasses.replace(result, heights=cut.map_heights()[2])
    return ScoredPass(name, reference, result, scored(cell, result))


def scored(
    cell: Cell, result: PassResult, low_frequency: float | None = None, target: Trajectory | None = None
) -> Scores:
    """Return the scores against a target (default: the path of the cell).

    low_frequency [Hz]: of the arm of the pass, where that is another arm.
    """
    feed = (target or path_of(cell).target).sample_velocity(result.time_ns)
    lowest = low_frequency_of(cell) if low_frequency is None else low_frequency
    return score(
        result.time,
        result.actual,
        result.target,
        feed,
        path_of(cell).full_engagement,
        lowest,
        result.deflection[:, 1],
        straight=path_of(cell).straight,
    )


def record_of(cell: Cell, run: ScoredPass | PassResult) -> PassRecord:
    """Return the record for the compensator: stamps and tool centres, as a node receives them on ``tool_pose``."""
    if isinstance(run, ScoredPass) and run.record is not None:
        return run.record
    result = run.result if isinstance(run, ScoredPass) else run
    return pass_record(path_of(cell), cell.imperfections, result.time_ns, _measured(cell, result), result.wrench)


def _measured(cell: Cell, result: PassResult) -> np.ndarray:
    """Tool centres (n, 3) [m]: as ``tool_pose`` predicts them; as corrected where the mean force is exchanged.

    At an entry the prediction over 4 ms is off by some um, which a method must not learn.
    """
    return result.actual if cell.cutting.by_engagement else result.tool


def pass_record(
    path: CellPath,
    assumed: Imperfections,
    time_ns: np.ndarray,
    tool: np.ndarray,
    wrench: np.ndarray,
    tracker: Imperfections | None = None,
    number: int = 0,
) -> PassRecord:
    """Tool centres (n, 3) [m] and wrenches (n, 6) [N, N m] at stamps (n,) [ns], received, recorded or simulated.

    assumed: imperfections of the cell, which state the noise of the positions; tracker: those of a simulated tracker
    and force sensor, whose noise is added to the true tool centres and wrenches of the pass ``number``.
    """
    revolution = 2e9 * np.pi / path.tool.spindle_speed
    noise = (tracker or assumed).pose_noise
    sensed = wrench if tracker is None else tracker.sensed(wrench, number)
    tool = tool if tracker is None else tracker.measured(tool, number)
    return PassRecord(time_ns, tool, round(path.full_engagement * 1e9), sensed, revolution, noise)


def compensator(cell: Cell, target: Trajectory, method: str | Method | None = None) -> Compensator:
    """The compensator of a cell, on line and off line."""
    return Compensator(cell.compensation, target, method, models_of(cell))


def models_of(cell: Cell) -> CellModels:
    """The models of arm and cut for a compensation method."""
    return CellModels(
        mirror=functools.partial(mirrored, arm_of(cell), cell.compensation.relaxation),
        arm=lambda target: arm_response(cell, target),
        predict=lambda reference, factors: predicted(cell, reference, factors),
        cut=lambda path: cut_along(cell, path),
        robots=lambda target, reference: robot_passes(cell, target, reference),
    )


def robot_passes(cell: Cell, target: Trajectory, reference: Trajectory) -> list[tuple[ArmResponse, PassRecord]]:
    """The model first, then robots drawn from ``cell.uncertainty``: response and true pass along a reference.

    Repeatability shifts each pass by chance, so it is left out. A robot that is unstable is left out, too. The robots
    differ by deviations that the mean force shows as well as the teeth: a plan along a program leaves the robots of a
    verdict as much error with either model, and the mean force takes a tenth of the time. With twice the robots a
    program of some minutes leaves less.
    """
    planning_seed = 1_000_000  # seed of these robots: the seeds of a verdict are smaller
    mean_force = cell if cell.cutting.by_engagement or not cell.path.file else cell.by_mean_force()
    model, rng = coarser(mean_force), np.random.default_rng(planning_seed)
    count = PLANNED if target.duration_ns >= LONG else 2 * PLANNED
    drawn = [model.replace(imperfections=Imperfections()), *(perturbed(model, rng) for _ in range(count))]

    def run(robot: Cell) -> tuple[ArmResponse, PassRecord] | None:
        try:
            result = Plant(model, robot, robot.imperfections.replace(repeatability=0.0)).run(reference)
        except MillingError:
            return None
        if np.abs(result.actual - result.reference).max() >= DIVERGED:
            return None
        return robot_response(robot, target), PassRecord(result.time_ns, result.actual)

    with ThreadPoolExecutor(at_once(path_of(model))) as pool:
        return [result for result in pool.map(run, drawn) if result is not None]


def robot_response(robot: Cell, target: Trajectory) -> ArmResponse:
    """``arm_response`` of a simulated robot, with the lag and the dead time of its motors."""
    assumed = robot.imperfections
    lag = Lag.of(2.0 * np.pi * assumed.servo_frequency, assumed.servo_damping, assumed.servo_delay)
    return dataclasses.replace(arm_response(robot, target), lag=lag)


def arm_response(cell: Cell, target: Trajectory) -> ArmResponse:
    """The modes of the arm on each segment of the target, at one posture or along the path, as the pass has them."""
    models, posture = [modal_model_of(cell)], np.zeros(len(target) - 1, int)  # posture: number of a segment's model
    if cell.dynamics.follow_pose:
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(target.position, axis=0), axis=1))])
        place = np.rint(0.5 * (length[1:] + length[:-1]) / cell.dynamics.posture_spacing).astype(int)
        _, first, posture = np.unique(place, return_index=True, return_inverse=True)
        middle = (target.time_ns[1:] + target.time_ns[:-1])[first] // 2
        models = arm_of(cell).modes_at(arm_of(cell).joints_along(target, middle))
    return ArmResponse(
        frequency=np.stack([model.frequency for model in models]),
        damping=np.stack([model.ratios(cell.dynamics.damping_ratio) for model in models]),
        inward=np.stack([(model.shape.T @ model.mass @ model.reference)[:, :3] for model in models]),
        outward=np.stack([(model.output @ model.shape)[:3] for model in models]),
        push=np.stack([model.shape.T @ model.force for model in models]),
        tool=np.stack([model.tool for model in models if model.tool is not None])
        if cell.tool.lateral_compliance
        else None,
        # the displacement stays from one posture to the next: u_after = Phi_after^T M_after Phi_before u_before
        carry=np.stack(
            [
                after.shape.T @ after.mass @ before.shape
                for before, after in zip(models, [*models[1:], models[-1]], strict=True)
            ]
        ),
        moves=cell.dynamics.reference_inertia,
        posture=posture,
    )


def expected_deviations(cell: Cell, references: Sequence[Trajectory]) -> list[float]:
    """Largest deviation across the feed [m] along each reference, by the linear response of the arm to it and to the
    wrench of the cut on the target: no pass is run, and the cut does not answer the motion of the tool."""
    settings = cell.compensation
    models = dataclasses.replace(models_of(cell), arm=lambda target: robot_response(cell, target))
    learner = Learner.of_model(path_of(cell).target, models, settings.criterion, settings.smooth).expect()
    return learner.predicted(*references)


def cut_along(cell: Cell, path: Trajectory, cut: CutModel | None = None) -> PassRecord:
    """The cut alone, by a tool that runs on ``path``; cut: its workpiece, None: a fresh one."""
    steps = np.arange(path_of(cell).clock.steps(path.duration_ns) + 1)
    stamps = path_of(cell).clock.stamp(steps)
    tool = path.sample(stamps)
    cut = cut or cut_of(cell)
    axes = tool_axis(path.sample_orientation(stamps)) if cut.tilts else None
    wrench, _, _ = cut.along(tool, steps * path_of(cell).clock.micro_steps, axes=axes)
    wrench = np.where(path_of(cell).drilling_at(stamps)[:, None], 0.0, wrench)
    return pass_record(path_of(cell), cell.imperfections, stamps, tool, wrench)


def predicted(cell: Cell, reference: Trajectory, factors: ArmFactors | None = None) -> PassRecord:
    """The pass that the model predicts along ``reference``; factors: of an identified arm on the modelled arm."""
    path, driven = path_of(cell), reference
    target = path.target
    if factors is not None and factors.gain != 1.0:
        velocity = reference.velocity
        if velocity is not None and target.velocity is not None:
            velocity = target.velocity + factors.gain * (velocity - target.velocity)
        driven = target.with_position(target.position + factors.gain * (reference.position - target.position), velocity)
    arm, iterations = arm_model_of(cell, reference, factors), cell.exchange.iterations
    result = run_pass(arm, cut_of(cell), path.clock, target, driven, iterations, silent=path.drilling_at)
    return record_of(cell, result)


def joint_ranges(cell: Cell, reference: Trajectory) -> dict[str, np.ndarray]:
    """The joint positions [deg], (6,), that a reference commands: at its start and end, the least and the largest."""
    joints = np.degrees(commanded_joints(arm_of(cell), cell.compensation, reference))
    return {"start": joints[0], "end": joints[-1], "min": joints.min(axis=0), "max": joints.max(axis=0)}


def long_pass(path: CellPath) -> bool:
    """Return whether the series of a pass along a path fill so much memory that few of them are stored."""
    return path.clock.steps(path.target.duration_ns) > FEW_PERIODS


def at_once(path: CellPath) -> int:
    """Return how many simulated robots run at the same time: one for each core, with 1 GB of series in all.

    A robot needs 0.5 GB an hour at 4 ms.
    """
    return max(1, min(cores(), 4 * FEW_PERIODS // path.clock.steps(path.target.duration_ns)))


def compensated(
    cell: Cell,
    original: ScoredPass,
    method: str | Method,
    progress=None,
    by: Compensator | None = None,
    plant: Plant | None = None,
) -> ScoredPass:
    """The pass along the trajectory that ``method`` makes from the original pass; without series where it is long.

    by: a compensator to do it with; plant: what runs the passes, the original one included.
    """
    passes: dict[int, ScoredPass] = {}
    by = by or compensator(cell, path_of(cell).target, method)
    large = plant is None and long_pass(path_of(cell))
    name = method_of(method).name
    record = record_of(cell, original)

    def run(reference: Trajectory) -> PassRecord:
        nonlocal record
        for key in passes.keys() - {id(by.best)}:
            del passes[key]
        scored_pass = simulate(cell, reference, name, progress, plant)
        # the series fill 200 MB an hour
        passes[id(reference)] = dataclasses.replace(scored_pass, result=None) if large else scored_pass  # type: ignore[arg-type]
        record = record_of(cell, scored_pass)
        return record

    if large:
        # the pass that the model predicts is the pass that it has run; in an hour a further revision changes the
        # reference by 0.03 um in the root mean square, and its largest error by chance
        by.models, by.enough = dataclasses.replace(by.models, predict=lambda *_: record), 0.1
    reference = by.improve(record, run)
    if reference is original.reference:
        return dataclasses.replace(original, name=name)
    return passes.get(id(reference)) or simulate(cell, reference, name, progress, plant)


def mean_force(result: PassResult) -> np.ndarray:
    """[N], (3,), over the last quarter of the pass."""
    return result.wrench[-max(1, len(result.wrench) // 4) :, :3].mean(axis=0)
