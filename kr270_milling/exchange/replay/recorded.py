"""Read a pass from its recording, as the same record that a simulation returns."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, scored
from kr270_milling.cell.path import MOST_STEPS
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.replay.attached import attached_cell, attached_plant
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult, follow, silent_periods
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import TopicSeries, several
from kr270_milling.recordings.messages.codec import trajectory_from_bytes
from kr270_milling.recordings.messages.trajectory import TRAJECTORY

__all__ = ["RecordedPass", "pass_from_recording", "topic_of"]

DIAGNOSTICS = "/diagnostics"
SERIES = ("tool_pose", "deflection", "wrench")


@dataclasses.dataclass(frozen=True, eq=False)
class RecordedPass:
    """A scored pass with its cell and with what is missing in the recording."""

    scored: ScoredPass
    cell: Cell
    messages_lost: int  #: poses, wrenches and deflections that the pass must have had and the file has not
    lost_to_end: int  #: the same, where the pass is known to have run to the end of its reference
    complete: bool  #: the pass ran to the end of its reference, no message of it is lost, and the file was closed
    program: str | None = None  #: text of the tool path file, where the recording carries it


class StepRows(NamedTuple):
    """A series of one pass by the steps of the exchange, ascending."""

    step: np.ndarray  #: (n,)
    values: np.ndarray  #: (n, columns)


def topic_of(recording: Recording, name: str, namespace: str | None = None) -> str:
    """The full name of one of the graph's topics in a recording; raises RecordingError where there is not just one."""
    if namespace is not None:
        matches = [f"/{namespace.strip('/')}/{name}".replace("//", "/")]
        matches = [topic for topic in matches if topic in recording.topics()]
    else:
        matches = [topic for topic in recording.topics() if topic.rpartition("/")[2] == name]
    if len(matches) != 1:
        several = f"exists several times ({', '.join(matches)}): name a namespace" if matches else "is not recorded"
        several += f" in the namespace {namespace}" if namespace is not None else ""
        raise RecordingError(recording.path, f"the topic {name} {several}")
    return matches[0]


def pass_from_recording(path, name: str | None = None, namespace: str | None = None) -> RecordedPass:
    """The pass that a recording holds; a file that was cut off gives the part that is there. It is read once."""
    with Recording(path) as recording:
        cell = attached_cell(recording)
        plant = attached_plant(recording, cell)
        reference, wall, series = _read(recording, namespace)
        program = _program(recording, cell)
    last = cell.clock.steps(reference.duration_ns)
    if last > MOST_STEPS:
        raise RecordingError(recording.path, f"its reference trajectory takes {reference.duration_ns * 1e-9:g} s")
    recorded = {kind: _by_step(cell, one, last) for kind, one in series.items()}
    course = imperfect_course(plant, reference, 0)
    whole = recorded | {"deflection": _all_deflections(plant, reference, course, recorded)}
    steps = functools.reduce(lambda a, b: np.intersect1d(a, b, True), (rows.step for rows in whole.values()))
    if steps.size < 2:
        raise RecordingError(recording.path, "holds no pass: poses, wrenches and deflections of at least one period")
    rows = {kind: one.values[np.searchsorted(one.step, steps)] for kind, one in whole.items()}
    ended = int(steps[-1]) == last
    lost = _lost(cell, recorded, int(steps[-1]))
    result = _result(cell, plant, course, steps, rows, wall)
    ran = ScoredPass(name or recording.path.stem, reference, result, scored(cell, result, plant.low_frequency))
    complete = ended and not lost and not recording.cut_off
    return RecordedPass(ran, cell, lost, _lost(cell, recorded, last), complete, program)


def _read(recording: Recording, namespace: str | None) -> tuple[Trajectory, float, dict[str, TopicSeries]]:
    """The reference that the pass ran, its time of the wall [s], and the series."""
    topics = {kind: topic_of(recording, kind, namespace) for kind in SERIES}
    topic = topic_of(recording, "reference_trajectory", namespace)
    if recording.topics()[topic].type != TRAJECTORY:
        raise RecordingError(recording.path, f"{topic} is no trajectory")
    runs: list[bytes] = []
    walls = [float("nan")]
    others: dict = {topic: lambda data: runs.append(data) if not runs else None}
    if DIAGNOSTICS in recording.topics():
        decode = recording.decoder(DIAGNOSTICS)
        others[DIAGNOSTICS] = lambda data: walls.extend(_wall_times(decode(data)))
    series = dict(zip(SERIES, several(recording, list(topics.values()), others), strict=True))
    if not runs:
        raise RecordingError(recording.path, f"{topic} has no message")
    passes = int(np.count_nonzero(series["deflection"].stamp == 0))  # published once an exchange
    if passes > 1:
        raise RecordingError(recording.path, f"holds {passes} passes; each pass needs a separate recording")
    try:
        return trajectory_from_bytes(runs[0]), walls[-1], series
    except MillingError as error:
        raise RecordingError(recording.path, f"a message on {topic} is no path of the tool: {error}") from error


def _wall_times(diagnostics) -> Iterator[float]:
    """Return the wall time [s] that the robot reported."""
    for pair in (pair for status in diagnostics.status for pair in status.values if pair.key == "wall_s"):
        with contextlib.suppress(ValueError):
            yield float(pair.value)


def _by_step(cell: Cell, series: TopicSeries, last: int) -> StepRows:
    """Of a repeated stamp the last, which is what counted when an exchange was iterated."""
    step = np.rint(series.stamp / (cell.clock.period * 1e9)).astype(np.int64)
    rows = np.flatnonzero((step >= 0) & (step <= last) & (cell.clock.stamp(step) == series.stamp))[::-1]
    steps, latest = np.unique(step[rows], return_index=True)
    return StepRows(steps, series.values[rows[latest]])


def _lost(cell: Cell, recorded: dict[str, StepRows], last: int) -> int:
    """Poses, wrenches and deflections that are missing up to a step; of the deflections those that were due."""
    thinned = cell.thinned_steps
    due = np.count_nonzero(recorded["deflection"].step % thinned == 0)
    there = {"tool_pose": len(recorded["tool_pose"].step), "wrench": len(recorded["wrench"].step)}
    return sum(max(0, last + 1 - count) for count in there.values()) + max(0, last // thinned + 1 - due)


def _all_deflections(plant: Cell, reference: Trajectory, course: Trajectory, recorded: dict[str, StepRows]) -> StepRows:
    """Those that were recorded and, as far as these are the same to the bit, those between them: they follow from the
    wrenches, which were all published."""
    wrench, there = recorded["wrench"], recorded["deflection"]
    if len(there.step) >= len(wrench.step):
        return there
    model = imperfect_arm(plant, reference, plant.arm_model(reference))
    whole = plant.clock.steps(course.duration_ns) + 1
    count = np.flatnonzero(np.append(wrench.step, -1) != np.arange(len(wrench.step) + 1))[0]  # without a hole
    pushes = model.push(course, plant.clock.stamp(np.arange(whole)))
    computed = follow(model, pushes, wrench.values[: min(count, whole)])
    known = there.step < len(computed)
    other = (computed[there.step[known]].view(np.int64) != there.values[known].view(np.int64)).any(axis=1)
    end = int(there.step[known][np.argmax(other)]) if other.any() else len(computed)
    later = there.step >= end
    return StepRows(
        np.append(np.arange(end), there.step[later]), np.append(computed[:end], there.values[later], axis=0)
    )


def _program(recording: Recording, cell: Cell) -> str | None:
    """The tool path file that a recording carries."""
    name = Path(cell.path.file).name
    if name not in [about.name for about in recording.attachments]:
        return None
    return recording.attachment(name).decode("utf-8", errors="replace")


def _result(cell: Cell, plant: Cell, run: Trajectory, steps: np.ndarray, rows: dict, wall: float) -> PassResult:
    """What no message carries (torque, volume, heights) from the recorded tool centres on a fresh workpiece; across a
    hole in the recording the tool goes straight."""
    stamps, tool = cell.clock.stamp(steps), rows["tool_pose"][:, :3]
    course = run.sample(stamps)
    shift = course + rows["deflection"][:, :3] - tool
    cut, counts = plant.cut(), steps * plant.clock.micro_steps
    _, torque, volume = cut.along(tool, counts)
    silent = silent_periods(plant.programmed.drilling_at(stamps))
    torque[silent], volume[silent] = 0.0, 0.0
    return PassResult(
        stamps, cell.target().sample(stamps), course, tool, rows["deflection"], rows["wrench"],
        np.sqrt(np.sum(shift**2, axis=1)), torque, volume, int(counts[-1]), cut.removed_area, cut.removed_volume, wall,
        cut.map_heights()[2],
    )  # fmt: skip
