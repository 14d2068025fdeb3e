"""Read a pass from its recording, as the same record that a simulation returns."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.frames import tool_axis
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, scored
from kr270_milling.cell.models import arm_model_of, cut_of, low_frequency_of, path_of
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.replay.attached import recorded_cells
from kr270_milling.exchange.replay.driven import read_passes, too_long
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult, follow, silent_periods
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.passes import EXCHANGED, PassSeries, Series

__all__ = ["RecordedFacts", "pass_from_recording", "passes_from_recording"]

NO_PASS = "poses, wrenches and deflections of at least one period"


@dataclasses.dataclass(frozen=True, eq=False)
class RecordedFacts:
    """Facts of a recording about a scored pass: cell, target, and the missing messages."""

    cell: Cell
    target: Trajectory
    messages_lost: int  #: poses, wrenches and deflections that the pass must have had and the file has not
    lost_to_end: int  #: the same, where the pass is known to have run to the end of its reference
    complete: bool  #: the pass ran to the end of its reference, no message of it is lost, and the file was closed
    program: str | None = None  #: text of the tool path file, where the recording carries it
    stamps: str = "exchange"  #: see ``PassSeries.stamps``
    unused: Mapping[str, str] = dataclasses.field(default_factory=dict)  #: pass that cannot be used: reason


def pass_from_recording(
    path, name: str | None = None, namespace: str | None = None
) -> tuple[ScoredPass, RecordedFacts]:
    """Return the only pass of a recording and its facts. Raises RecordingError for none, and for more than one."""
    passes = passes_from_recording(path, name, namespace)
    if len(passes) > 1:
        raise RecordingError(path, f"has {len(passes)} passes; this needs a recording with one pass")
    return passes[0]


def passes_from_recording(
    path,
    name: str | None = None,
    namespace: str | None = None,
    remap: Mapping[str, str] = MappingProxyType({}),
    cell_file=None,
) -> list[tuple[ScoredPass, RecordedFacts]]:
    """Return every pass of a recording and its facts, along reference and target of its time; the file is read once.

    A file that was cut off gives the part that is there. The facts name each pass that cannot be used.
    remap: see ``Recording``; cell_file: see ``recorded_cells``. Raises RecordingError where no pass can be used.
    """
    with Recording(path, remap=remap) as recording:
        cells = recorded_cells(recording, cell_file)
        read = read_passes(recording, cells[0], namespace)
        name, program = name or recording.path.stem, _program(recording, cells[0])
        names = [f"{name}_{number}" if len(read) > 1 else name for number in range(1, len(read) + 1)]
        results = [_scored(recording, cells, *pair, program) for pair in zip(read, names, strict=True)]
    passes = [result for result in results if not isinstance(result, str)]
    unused = {name: result for name, result in zip(names, results, strict=True) if isinstance(result, str)}
    if not passes:
        reason = f"holds no pass: {NO_PASS}, or a pass of a robot with another clock"
        raise RecordingError(recording.path, next(iter(unused.values()), reason))
    return [(scored_pass, dataclasses.replace(facts, unused=unused)) for scored_pass, facts in passes]


def _scored(
    recording: Recording, cells: tuple[Cell, Cell], series: PassSeries, name: str, program: str | None
) -> tuple[ScoredPass, RecordedFacts] | str:
    """Return the scored pass, or the reason why it cannot be used."""
    cell, plant = cells
    reference, target = series.reference, series.target or path_of(cell).target
    if reason := series.reason or too_long(cell, reference):
        return reason
    last = path_of(cell).clock.steps(reference.duration_ns)
    recorded = {kind: series.topic(kind).last() for kind in EXCHANGED}
    driven = series.stamps != "exchange"
    planned = reference if driven else imperfect_course(plant, reference, 0)
    if not driven:
        recorded["deflection"] = _all_deflections(plant, reference, planned, recorded)
    steps = functools.reduce(lambda a, b: np.intersect1d(a, b, True), (rows.step for rows in recorded.values()))
    if steps.size < 2:
        return f"has no {NO_PASS}"
    rows = {kind: part.values[np.searchsorted(part.step, steps)] for kind, part in recorded.items()}
    if driven:
        lost = to_end = series.driven_lost
        complete = series.driven_whole
    else:
        lost, to_end = (series.lost(end, cell.publish.steps(cell.exchange)) for end in (int(steps[-1]), last))
        complete = int(steps[-1]) == last and not lost
    result = _result(cells, target, planned, steps, rows, series.wall_s)
    scored_pass = ScoredPass(name, reference, result, scored(cell, result, low_frequency_of(plant), target))
    complete = complete and not recording.cut_off
    return scored_pass, RecordedFacts(cell, target, lost, to_end, complete, program, series.stamps)


def _all_deflections(plant: Cell, reference: Trajectory, planned: Trajectory, recorded: dict[str, Series]) -> Series:
    """Return the recorded deflections, completed by recomputed ones where both agree bit for bit.

    The deflections follow from the wrenches, which were all published.
    """
    wrench, there = recorded["wrench"], recorded["deflection"]
    if len(there.step) >= len(wrench.step):
        return there
    model = imperfect_arm(plant, reference, arm_model_of(plant, reference))
    whole = path_of(plant).clock.steps(planned.duration_ns) + 1
    pushes = model.push(planned, path_of(plant).clock.stamp(np.arange(whole)))
    computed = follow(model, pushes, wrench.values[: min(wrench.unbroken(), whole)])
    known = there.step < len(computed)
    other = (computed[there.step[known]].view(np.int64) != there.values[known].view(np.int64)).any(axis=1)
    end = int(there.step[known][np.argmax(other)]) if other.any() else len(computed)
    later = there.step >= end
    step = np.append(np.arange(end), there.step[later])
    return Series(step, path_of(plant).clock.stamp(step), np.append(computed[:end], there.values[later], axis=0))


def _program(recording: Recording, cell: Cell) -> str | None:
    """Return the text of the attached tool path file; None without such a file."""
    name = Path(cell.path.file).name
    if name not in [about.name for about in recording.attachments]:
        return None
    return recording.attachment(name).decode("utf-8", errors="replace")


def _result(
    cells: tuple[Cell, Cell], target: Trajectory, run: Trajectory, steps: np.ndarray, rows: dict, wall: float
) -> PassResult:
    """Return the result of a pass; torque, volume and heights come from the recorded tool centres.

    These cut a fresh workpiece; across a gap in the recording the tool moves straight.
    """
    cell, plant = cells
    stamps, tool = path_of(cell).clock.stamp(steps), rows["tool_pose"][:, :3]
    planned = run.sample(stamps)
    shift = planned + rows["deflection"][:, :3] - tool
    cut, counts = cut_of(plant), steps * path_of(plant).clock.micro_steps
    axes = tool_axis(rows["tool_pose"][:, 3:7]) if cut.tilts else None
    _, torque, volume = cut.along(tool, counts, predicted=True, axes=axes)
    silent = silent_periods(path_of(plant).drilling_at(stamps))
    torque[silent], volume[silent] = 0.0, 0.0
    return PassResult(
        stamps,
        target.sample(stamps),
        planned,
        tool,
        rows["deflection"],
        rows["wrench"],
        np.sqrt(np.sum(shift**2, axis=1)),
        torque,
        volume,
        int(counts[-1]),
        cut.removed_area,
        cut.removed_volume,
        wall,
        cut.map_heights()[2],
    )
