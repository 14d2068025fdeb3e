"""Read a pass from its recording, as the same record that a simulation returns."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, scored
from kr270_milling.cell.path import MOST_STEPS
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.replay.attached import attached_cell, attached_plant
from kr270_milling.exchange.replay.driven import driven_passes, driven_steps, poses_lost, rsi_pass
from kr270_milling.exchange.replay.inputs import TYPES
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.motion.milling_pass import PassResult, follow, silent_periods
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import TopicSeries, several
from kr270_milling.recordings.messages.codec import from_bytes, trajectory_from_bytes
from kr270_milling.recordings.messages.trajectory import TRAJECTORY

__all__ = ["RecordedFacts", "pass_from_recording", "passes_from_recording", "topic_of"]

DIAGNOSTICS = "/diagnostics"
STATE = "diagnostic_msgs/msg/DiagnosticStatus"
SERIES = ("tool_pose", "deflection", "wrench")


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


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    """Messages of a recording that all passes need."""

    references: dict[int, Trajectory]  #: by their starts [ns]
    targets: dict[str, Trajectory]  #: by their fingerprints, in the order of the file
    stated: dict[str, str]  #: fingerprint of a reference -> fingerprint of its target
    walls: list[float]  #: reported times of the wall clock [s], one a complete pass
    series: dict[str, TopicSeries]
    topics: dict[str, str]  #: our names -> names in the recording
    rsi: bool  #: an RSI session

    def add_reference(self, data: bytes) -> None:
        with contextlib.suppress(MillingError):  # the nodes refused it
            reference = trajectory_from_bytes(data)
            self.references.setdefault(reference.start_ns, reference)

    def add_target(self, data: bytes) -> None:
        with contextlib.suppress(MillingError):  # the compensator refused it
            target = trajectory_from_bytes(data)
            self.targets[fingerprint(target)] = target

    def add_state(self, data: bytes) -> None:
        with contextlib.suppress(ValueError):
            state = from_bytes(STATE, data)
            self.stated[state.reference] = state.target

    def add_walls(self, walls: Iterable[float]) -> None:
        self.walls.extend(wall for wall in walls if self.walls[-1:] != [wall])

    def target_of(self, reference: Trajectory, default: Trajectory) -> Trajectory:
        """Return the target that a reference follows from: as the compensator states it, else the last one recorded."""
        if (stated := self.stated.get(fingerprint(reference))) is not None:
            return self.targets.get(stated, default)
        return list(self.targets.values())[-1] if self.targets else default


class Window(NamedTuple):
    """One pass; the stamps of the series are counted from its start."""

    reference: Trajectory
    target: Trajectory
    series: dict[str, TopicSeries]


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
        ours = [topic for topic in matches if recording.topics()[topic].type == TYPES[name]]
        matches = ours or matches
    if len(matches) != 1:
        several = f"exists several times ({', '.join(matches)}): name a namespace" if matches else "is not recorded"
        several += f" in the namespace {namespace}" if namespace is not None else ""
        raise RecordingError(recording.path, f"the topic {name} {several}")
    return matches[0]


def pass_from_recording(
    path, name: str | None = None, namespace: str | None = None
) -> tuple[ScoredPass, RecordedFacts]:
    """Return the only pass of a recording and its facts. Raises RecordingError for none, and for more than one."""
    passes = passes_from_recording(path, name, namespace)
    if len(passes) > 1:
        raise RecordingError(path, f"has {len(passes)} passes; this needs a recording with one pass")
    return passes[0]


def passes_from_recording(
    path, name: str | None = None, namespace: str | None = None, remap: Mapping[str, str] = MappingProxyType({})
) -> list[tuple[ScoredPass, RecordedFacts]]:
    """Return every pass of a recording and its facts, along reference and target of its time; the file is read once.

    A file that was cut off gives the part that is there. remap: see ``Recording``. Raises RecordingError where there is
    no pass.
    """
    with Recording(path, remap=remap) as recording:
        cell = attached_cell(recording)
        cells = cell, attached_plant(recording, cell)
        content = _read(recording, namespace)
        program = _program(recording, cell)
        name = name or recording.path.stem
        passes = [] if content.rsi else list(_exchanged(recording, cells, content, name, program))
        passes = passes or list(_driven(recording, cells, content, name, program))
    if not passes:
        reason = "poses, wrenches and deflections of at least one period, or a pass of a robot with another clock"
        raise RecordingError(recording.path, f"holds no pass: {reason}")
    if len(passes) == 1:
        return passes
    return [(dataclasses.replace(ran, name=f"{name}_{n}"), recorded) for n, (ran, recorded) in enumerate(passes, 1)]


def _exchanged(
    recording: Recording, cells: tuple[Cell, Cell], content: Content, name: str, program: str | None
) -> Iterator[tuple[ScoredPass, RecordedFacts]]:
    """Yield the scored passes of the simulated robot."""
    windows = _windows(recording, cells[0], content)
    walls = content.walls if len(content.walls) == len(windows) else [float("nan")] * len(windows)
    for window, wall in zip(windows, walls, strict=True):
        one = _scored(recording, cells, window, wall, name, program)
        if one is not None:
            yield one


def _driven(
    recording: Recording, cells: tuple[Cell, Cell], content: Content, name: str, program: str | None
) -> Iterator[tuple[ScoredPass, RecordedFacts]]:
    """Yield the scored passes whose poses have the stamps of a driver. Raises RecordingError."""
    cell, plant = cells
    default = cell.target()
    if content.rsi:
        ((_, reference),) = content.references.items()
        programmed = content.target_of(reference, reference)
        driven = iter([rsi_pass(recording, cell, programmed, reference, content.series["tool_pose"].values[:, :3])])
    else:
        driven = driven_passes(recording, cell, content.topics)
    for reference, received, whole in driven:
        _check_duration(recording, cell, reference)
        target = default if content.rsi else content.target_of(reference, default)
        steps, tool, wrench = driven_steps(cell.clock, reference, received, whole)
        off = tool - reference.sample(cell.clock.stamp(steps))
        rows = {"tool_pose": tool, "deflection": np.hstack([off, np.zeros_like(off)]), "wrench": wrench}
        result = _result(cells, target, reference, steps, rows, float("nan"))
        ran = ScoredPass(name, reference, result, scored(cell, result, plant.low_frequency, target))
        lost, complete = poses_lost(received), whole and not recording.cut_off
        stamps = "place" if content.rsi else "driver's"
        yield ran, RecordedFacts(cell, target, lost, lost, complete, program, stamps)


def _check_duration(recording: Recording, cell: Cell, reference: Trajectory) -> int:
    """Return the last exchange of a pass. Raises RecordingError where the reference takes too long."""
    last = cell.clock.steps(reference.duration_ns)
    if last > MOST_STEPS:
        raise RecordingError(recording.path, f"its reference trajectory takes {reference.duration_ns * 1e-9:g} s")
    return last


def _windows(recording: Recording, cell: Cell, content: Content) -> list[Window]:
    """Return the passes in the order of their starts: references with a pose between their start and the next one."""
    windows = []
    starts = sorted(content.references)
    for start, end in zip(starts, [*starts[1:], np.iinfo(np.int64).max], strict=True):
        chosen = {kind: (one.stamp >= start) & (one.stamp < end) for kind, one in content.series.items()}
        series = {
            kind: TopicSeries(one.stamp[chosen[kind]] - start, one.values[chosen[kind]])
            for kind, one in content.series.items()
        }
        if not series["tool_pose"].stamp.size:
            continue
        passes = int(np.count_nonzero(series["deflection"].stamp == 0))  # published once an exchange
        if passes > 1:
            raise RecordingError(recording.path, f"does not separate its {passes} passes: they have one start")
        reference = content.references[start]
        windows.append(Window(reference, content.target_of(reference, cell.target()), series))
    return windows


def _scored(
    recording: Recording, cells: tuple[Cell, Cell], window: Window, wall: float, name: str, program: str | None
) -> tuple[ScoredPass, RecordedFacts] | None:  # fmt: skip
    """Return the scored pass; None where poses, wrenches and deflections of at least one period are missing."""
    cell, plant = cells
    reference, target, series = window
    last = _check_duration(recording, cell, reference)
    recorded = {kind: _by_step(cell, one, last) for kind, one in series.items()}
    course = imperfect_course(plant, reference, 0)
    whole = recorded | {"deflection": _all_deflections(plant, reference, course, recorded)}
    steps = functools.reduce(lambda a, b: np.intersect1d(a, b, True), (rows.step for rows in whole.values()))
    if steps.size < 2:
        return None
    rows = {kind: one.values[np.searchsorted(one.step, steps)] for kind, one in whole.items()}
    ended = int(steps[-1]) == last
    lost = _lost(cell, recorded, int(steps[-1]))
    result = _result(cells, target, course, steps, rows, wall)
    ran = ScoredPass(name, reference, result, scored(cell, result, plant.low_frequency, target))
    complete = ended and not lost and not recording.cut_off
    return ran, RecordedFacts(cell, target, lost, _lost(cell, recorded, last), complete, program)


def _read(recording: Recording, namespace: str | None) -> Content:
    """Return what is read for all passes."""
    names = {topic.rpartition("/")[2] for topic in recording.topics()}  # a driver publishes no deflection
    topics = {kind: topic_of(recording, kind, namespace) for kind in SERIES if kind == "tool_pose" or kind in names}
    topic = topic_of(recording, "reference_trajectory", namespace)
    if recording.topics()[topic].type != TRAJECTORY:
        raise RecordingError(recording.path, f"{topic} is no trajectory")
    space = topic.rpartition("/")[0]
    rsi = f"{space}/correction" in recording.topics()
    content = Content({}, {}, {}, [], {}, {**topics, "reference_trajectory": topic}, rsi)
    others: dict[str, Callable[[bytes], object]] = {
        topic: content.add_reference,
        f"{space}/target_trajectory": content.add_target,
        f"{space}/compensator_state": content.add_state,
    }
    if DIAGNOSTICS in recording.topics():
        with contextlib.suppress(RecordingError):  # of another kind; only the wall times are missing then
            decode = recording.decoder(DIAGNOSTICS)
            others[DIAGNOSTICS] = lambda data: content.add_walls(_wall_times(decode, data))
    others = {name: take for name, take in others.items() if name in recording.topics()}
    series = several(recording, list(topics.values()), others)
    if not content.references:
        raise RecordingError(recording.path, f"{topic} has no message that is a path of the tool")
    none = TopicSeries(np.zeros(0, np.int64), np.zeros((0, 6)))
    return dataclasses.replace(content, series=dict.fromkeys(SERIES, none) | dict(zip(topics, series, strict=True)))


def _wall_times(decode: Callable, data: bytes) -> Iterator[float]:
    """Return the wall time [s] that the robot reported."""
    with contextlib.suppress(RecordingError, AttributeError):  # a message of another publisher
        for pair in (pair for status in decode(data).status for pair in status.values if pair.key == "wall_s"):
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


def _result(
    cells: tuple[Cell, Cell], target: Trajectory, run: Trajectory, steps: np.ndarray, rows: dict, wall: float
) -> PassResult:
    """What no message carries (torque, volume, heights) from the recorded tool centres on a fresh workpiece; across a
    hole in the recording the tool goes straight."""
    cell, plant = cells
    stamps, tool = cell.clock.stamp(steps), rows["tool_pose"][:, :3]
    course = run.sample(stamps)
    shift = course + rows["deflection"][:, :3] - tool
    cut, counts = plant.cut(), steps * plant.clock.micro_steps
    _, torque, volume = cut.along(tool, counts)
    silent = silent_periods(plant.programmed.drilling_at(stamps))
    torque[silent], volume[silent] = 0.0, 0.0
    return PassResult(
        stamps, target.sample(stamps), course, tool, rows["deflection"], rows["wrench"],
        np.sqrt(np.sum(shift**2, axis=1)), torque, volume, int(counts[-1]), cut.removed_area, cut.removed_volume, wall,
        cut.map_heights()[2],
    )  # fmt: skip
