"""Read a pass from its recording, as the same record that a simulation returns."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, scored
from kr270_milling.cell.models import arm_model_of, cut_of, low_frequency_of, path_of
from kr270_milling.cell.path import MOST_STEPS
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.replay.attached import recorded_cells
from kr270_milling.exchange.replay.driven import driven_passes, driven_steps, poses_lost, rsi_pass
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult, follow, silent_periods
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series
from kr270_milling.recordings.passes import GraphRecord, PassSeries, Series, read_graph

__all__ = ["RecordedFacts", "pass_from_recording", "passes_from_recording"]

EXCHANGED = ("tool_pose", "deflection", "wrench")


@dataclasses.dataclass(frozen=True, eq=False)
class RecordedFacts:
    """What a recording states about a scored pass: cell, target, and what is missing."""

    cell: Cell
    target: Trajectory
    messages_lost: int  #: poses, wrenches and deflections that the pass must have had and the file has not
    lost_to_end: int  #: the same, where the pass is known to have run to the end of its reference
    complete: bool  #: the pass ran to the end of its reference, no message of it is lost, and the file was closed
    program: str | None = None  #: text of the tool path file, where the recording carries it
    stamps: str = "exchange"  #: of the poses; "driver's": of another clock; "place": in an RSI session
    unused: tuple[str, ...] = ()  #: of each pass of the recording that cannot be used, the reason


def pass_from_recording(
    path, name: str | None = None, namespace: str | None = None
) -> tuple[ScoredPass, RecordedFacts]:
    """Return the only pass of a recording and its facts. Raises RecordingError for none, and for more than one."""
    passes = passes_from_recording(path, name, namespace)
    if len(passes) > 1:
        raise RecordingError(path, f"has {len(passes)} passes; this needs a recording with one pass")
    return passes[0]


def passes_from_recording(
    path, name: str | None = None, namespace: str | None = None, remap: Mapping[str, str] = MappingProxyType({}),
    cell_file=None,
) -> list[tuple[ScoredPass, RecordedFacts]]:  # fmt: skip
    """Return every pass of a recording and its facts, along reference and target of its time; the file is read once.

    A file that was cut off gives the part that is there. A pass that cannot be used is left out; the facts of the
    others name it. remap: see ``Recording``; cell_file: see ``recorded_cells``. Raises RecordingError where no pass
    can be used.
    """
    with Recording(path, remap=remap) as recording:
        cells = recorded_cells(recording, cell_file)
        cell, _ = cells
        graph = read_graph(recording, path_of(cell).clock, namespace)
        program = _program(recording, cell)
        rsi = f"{graph.namespace}/correction" in recording.topics()
        unused: list[str] = []
        name = name or recording.path.stem
        passes = [] if rsi else list(_exchanged(recording, cells, graph, name, program, unused))
        passes = passes or list(_driven(recording, cells, graph, rsi, name, program, unused))
    if not passes:
        reason = "poses, wrenches and deflections of at least one period, or a pass of a robot with another clock"
        reason = unused[0] if unused else f"holds no pass: {reason}"
        raise RecordingError(recording.path, reason)
    passes = [(ran, dataclasses.replace(facts, unused=tuple(unused))) for ran, facts in passes]
    if len(passes) == 1:
        return passes
    return [(dataclasses.replace(ran, name=f"{name}_{n}"), facts) for n, (ran, facts) in enumerate(passes, 1)]


def _exchanged(
    recording: Recording, cells: tuple[Cell, Cell], graph: GraphRecord, name: str, program: str | None,
    unused: list[str],
) -> Iterator[tuple[ScoredPass, RecordedFacts]]:  # fmt: skip
    """Yield the scored passes of the simulated robot."""
    walls = graph.walls if len(graph.walls) == len(graph.passes) else [float("nan")] * len(graph.passes)
    for one, wall in zip(graph.passes, walls, strict=True):
        if one.reason:
            unused.append(f"does not separate its passes: {one.reason}")
        elif (scored_pass := _scored(recording, cells, one, wall, name, program)) is not None:
            yield scored_pass


def _driven(
    recording: Recording, cells: tuple[Cell, Cell], graph: GraphRecord, rsi: bool, name: str, program: str | None,
    unused: list[str],
) -> Iterator[tuple[ScoredPass, RecordedFacts]]:  # fmt: skip
    """Yield the scored passes whose poses have the stamps of a driver. Raises RecordingError."""
    cell, plant = cells
    default = path_of(cell).target
    if rsi:
        (reference,) = graph.references
        programmed = graph.target_of(reference) or reference
        place = series(recording, graph.topics["tool_pose"]).values[:, :3]
        driven = iter([rsi_pass(recording, cell, programmed, reference, place)])
    else:
        driven = driven_passes(recording, cell, graph.topics, unused)
    for reference, received, whole in driven:
        _check_duration(recording, cell, reference)
        target = default if rsi else graph.target_of(reference) or default
        steps, tool, wrench = driven_steps(path_of(cell).clock, reference, received, whole)
        off = tool - reference.sample(path_of(cell).clock.stamp(steps))
        rows = {"tool_pose": tool, "deflection": np.hstack([off, np.zeros_like(off)]), "wrench": wrench}
        result = _result(cells, target, reference, steps, rows, float("nan"))
        ran = ScoredPass(name, reference, result, scored(cell, result, low_frequency_of(plant), target))
        lost, complete = poses_lost(received), whole and not recording.cut_off
        stamps = "place" if rsi else "driver's"
        yield ran, RecordedFacts(cell, target, lost, lost, complete, program, stamps)


def _check_duration(recording: Recording, cell: Cell, reference: Trajectory) -> int:
    """Return the last exchange of a pass. Raises RecordingError where the reference takes too long."""
    last = path_of(cell).clock.steps(reference.duration_ns)
    if last > MOST_STEPS:
        raise RecordingError(recording.path, f"its reference trajectory takes {reference.duration_ns * 1e-9:g} s")
    return last


def _scored(
    recording: Recording, cells: tuple[Cell, Cell], one: PassSeries, wall: float, name: str, program: str | None
) -> tuple[ScoredPass, RecordedFacts] | None:  # fmt: skip
    """Return the scored pass; None where poses, wrenches and deflections of at least one period are missing."""
    cell, plant = cells
    reference, target = one.reference, one.target or path_of(cell).target
    last = _check_duration(recording, cell, reference)
    recorded = {kind: one.topic(kind).last() for kind in EXCHANGED}
    course = imperfect_course(plant, reference, 0)
    whole = recorded | {"deflection": _all_deflections(plant, reference, course, recorded)}
    steps = functools.reduce(lambda a, b: np.intersect1d(a, b, True), (rows.step for rows in whole.values()))
    if steps.size < 2:
        return None
    rows = {kind: part.values[np.searchsorted(part.step, steps)] for kind, part in whole.items()}
    ended = int(steps[-1]) == last
    lost, thinned = one.lost(int(steps[-1]), cell.publish.steps(cell.exchange)), cell.publish.steps(cell.exchange)
    result = _result(cells, target, course, steps, rows, wall)
    ran = ScoredPass(name, reference, result, scored(cell, result, low_frequency_of(plant), target))
    complete = ended and not lost and not recording.cut_off
    return ran, RecordedFacts(cell, target, lost, one.lost(last, thinned), complete, program)


def _all_deflections(plant: Cell, reference: Trajectory, course: Trajectory, recorded: dict[str, Series]) -> Series:
    """Those that were recorded and, as far as these are the same to the bit, those between them: they follow from the
    wrenches, which were all published."""
    wrench, there = recorded["wrench"], recorded["deflection"]
    if len(there.step) >= len(wrench.step):
        return there
    model = imperfect_arm(plant, reference, arm_model_of(plant, reference))
    whole = path_of(plant).clock.steps(course.duration_ns) + 1
    pushes = model.push(course, path_of(plant).clock.stamp(np.arange(whole)))
    computed = follow(model, pushes, wrench.values[: min(wrench.unbroken(), whole)])
    known = there.step < len(computed)
    other = (computed[there.step[known]].view(np.int64) != there.values[known].view(np.int64)).any(axis=1)
    end = int(there.step[known][np.argmax(other)]) if other.any() else len(computed)
    later = there.step >= end
    step = np.append(np.arange(end), there.step[later])
    return Series(step, path_of(plant).clock.stamp(step), np.append(computed[:end], there.values[later], axis=0))


def _program(recording: Recording, cell: Cell) -> str | None:
    """The tool path file that a recording carries."""
    name = Path(cell.path.file).name
    if name not in [about.name for about in recording.attachments]:
        return None
    return recording.attachment(name).decode("utf-8", errors="replace")


def _result(
    cells: tuple[Cell, Cell], target: Trajectory, run: Trajectory, steps: np.ndarray, rows: dict, wall: float
) -> PassResult:
    """What no message carries (torque, volume, heights) from the recorded tool centres on a fresh workpiece; across a
    hole in the recording the tool goes straight."""
    cell, plant = cells
    stamps, tool = path_of(cell).clock.stamp(steps), rows["tool_pose"][:, :3]
    course = run.sample(stamps)
    shift = course + rows["deflection"][:, :3] - tool
    cut, counts = cut_of(plant), steps * path_of(plant).clock.micro_steps
    _, torque, volume = cut.along(tool, counts, predicted=True)
    silent = silent_periods(path_of(plant).drilling_at(stamps))
    torque[silent], volume[silent] = 0.0, 0.0
    return PassResult(
        stamps, target.sample(stamps), course, tool, rows["deflection"], rows["wrench"],
        np.sqrt(np.sum(shift**2, axis=1)), torque, volume, int(counts[-1]), cut.removed_area, cut.removed_volume, wall,
        cut.map_heights()[2],
    )  # fmt: skip
