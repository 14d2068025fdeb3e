"""Read a pass from its recording, as the same record that a simulation returns.

A robot with another clock, or an RSI session, stamps its poses itself; the pass then has a row for each exchange, too.
The inbox of the compensator separates the passes of a robot. In an RSI session the place on the path decides the time,
because override and stops change the feed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import yaml

from kr270_milling.base.errors import ConfigError, MessageError, MillingError, RecordingError, one_line
from kr270_milling.base.frames import tool_axis
from kr270_milling.base.parameter_file import find_file, read_yaml
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import ScoredPass, scored
from kr270_milling.cell.models import cut_of, low_frequency_of, path_of
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.inbox import BREAK_NS, PassInbox, ReceivedPass, interpolated
from kr270_milling.exchange.inputs import WrenchFrames, checked_length, checked_pose, checked_wrench
from kr270_milling.path.toolpath import PathProgress
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult, follow, silent_periods
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import from_bytes
from kr270_milling.recordings.passes import EXCHANGED, TYPES, GraphRecord, PassSeries, Series, read_graph, series

PLAIN = re.compile(rb"(?!\.\.?$)[^/\0]{1,200}")  # name of a file in one directory
CELL_FILE, PLANT_FILE = "cell.yaml", "plant.yaml"
Cells = tuple[Cell, Cell]  #: the cell that planned a pass, and the cell that cut in it


def attached_cell(recording: Recording) -> Cell:
    """Return the cell of the attached ``cell.yaml``, or of the only attached YAML file.

    Files that the cell names (includes, a tool path) are read from the attachments, else from the shipped files.
    Raises RecordingError, ConfigError.
    """
    names = _names(recording)
    parameter_files = [n for n in names if n.endswith((".yaml", ".yml")) and n != PLANT_FILE]
    if CELL_FILE not in names and len(parameter_files) != 1:
        what = f"has {', '.join(sorted(parameter_files))}" if parameter_files else "has no parameter file"
        raise RecordingError(
            recording.path, f"{what} attached, but {CELL_FILE} is needed to recompute it; give it by --cell"
        )
    if sum(a.data_size for a in recording.attachments) > 64 * 1024 * 1024:
        raise RecordingError(recording.path, "holds more attachments than a cell needs")
    return _read_attached(recording, CELL_FILE if CELL_FILE in names else parameter_files[0])


def recorded_cells(recording: Recording, file=None) -> Cells:
    """Return the cell that planned a pass and the one that cut in it, the attached ``plant.yaml`` if there is one.

    file: of the cell, for a recording without it, as of ``ros2 bag record``. Raises RecordingError, ConfigError.
    """
    cell = attached_cell(recording) if file is None else read_cell(find_file(file))
    return cell, _read_attached(recording, PLANT_FILE) if PLANT_FILE in _names(recording) else cell


def _names(recording: Recording) -> set[str]:
    """Return the names of the attachments that can be files in one directory."""
    return {about.name for about in recording.attachments if PLAIN.fullmatch(about.name.encode())}


def _read_attached(recording: Recording, main: str) -> Cell:
    with tempfile.TemporaryDirectory() as directory:
        names, file = _names(recording), Path(directory, main)
        for name in names:
            Path(directory, name).write_bytes(recording.attachment(name))
        _localise(recording, file, names, set())
        try:
            cell = read_cell(file)
            path_of(cell).timed  # noqa: B018 - reads the tool path while its file is there
        except ConfigError as error:
            where = f"{recording.path}, attached {Path(error.file).name}"
            raise ConfigError(where, error.key, error.value, error.allowed) from error
    return cell


def _localise(recording: Recording, file: Path, names: set[str], visited: set[str]) -> None:
    """Make a parameter file, and its includes, name the attached files instead of their original places.

    Raises RecordingError where a parameter file names a file that is neither attached nor shipped.
    """
    visited.add(file.name)
    try:
        tree = read_yaml(file)
        parameters = tree["/**"]["ros__parameters"]
    except (ConfigError, LookupError, TypeError):
        return  # read_cell reports the error
    includes, path = (parameters.get("includes"), parameters.get("path")) if isinstance(parameters, dict) else ([], {})
    includes, path = includes if isinstance(includes, list) else [], path if isinstance(path, dict) else {}
    named = [*includes, *filter(None, [path.get("file")])]
    far = [n for n in named if not isinstance(n, str) or not PLAIN.fullmatch(n.encode())]
    foreign = [n for n in far if not isinstance(n, str) or Path(n).name not in names]
    if foreign:
        reason = f"its {file.name} names {repr(foreign[0])[:100]}, which is not attached"
        raise RecordingError(recording.path, one_line(reason))
    if far:
        includes[:] = [Path(n).name for n in includes]
        if path.get("file"):
            path["file"] = Path(path["file"]).name
        file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    for name in includes:
        if Path(name).name in names and Path(name).name not in visited:
            _localise(recording, file.with_name(Path(name).name), names, visited)


LONGEST_GAP = 100_000_000  # [ns] between two poses of a complete pass


def _driven_passes(recording: Recording, cell: Cell, graph: GraphRecord) -> Iterator[PassSeries]:
    """Yield the passes of a robot with another clock, in the order of the file, as the compensator receives them."""
    check: dict[str, Callable] = {  # as the compensator checks them
        "reference_trajectory": lambda run: run,
        "tool_pose": checked_pose,
        "wrench": lambda sample: checked_wrench(sample, frames.names),
    }
    names = {topic: name for name, topic in graph.topics.items() if name in check}
    frames = WrenchFrames(cell.mount, cell.workpiece, cell.sensor)
    inbox_of = functools.partial(PassInbox, path_of(cell).clock, frames)
    inbox, reference, number, last = inbox_of(path_of(cell).target), None, -1, b""
    for message in recording.messages(set(names)):
        name = names[message.topic]
        if name == "reference_trajectory" and message.data == last:
            continue  # latched, received again
        try:
            record = check[name](from_bytes(TYPES[name], message.data))
        except (MillingError, ValueError):  # refused by the live node as well
            continue
        if name == "reference_trajectory":
            if reference is not None:
                yield from _received(cell, graph, number, reference, inbox)
            reference, number, last = record, number + 1, message.data
            inbox = inbox_of(record, record.start_ns)
        elif reference is not None:
            late = inbox.foreign and record.stamp - inbox.start_ns > inbox.end_ns + BREAK_NS
            if inbox.foreign and inbox.at_end and (inbox.complete or late):
                yield from _received(cell, graph, number, reference, inbox)
                inbox.clear()
            start = inbox.start_ns if inbox.foreign else None
            with contextlib.suppress(MillingError):
                (inbox.pose if name == "tool_pose" else inbox.wrench)(record)
            if start is not None and not (inbox.foreign and inbox.start_ns == start):  # broken off
                yield PassSeries(number, reference, graph.target_of(reference), {}, reason=inbox.problem)
    if reference is not None:
        yield from _received(cell, graph, number, reference, inbox)


def _received(
    cell: Cell, graph: GraphRecord, number: int, reference: Trajectory, inbox: PassInbox
) -> Iterator[PassSeries]:
    """Yield the pass in an inbox, if there is one; with the reason where the compensator refuses the pass."""
    if not inbox.foreign:
        return
    target = graph.target_of(reference)
    try:
        checked_length(reference, path_of(cell).clock)
        received = inbox.received()
    except MillingError as error:
        yield PassSeries(number, reference, target, {}, reason=str(error))
        return
    whole = inbox.at_end and int(np.diff(received.pose_ns).max()) <= LONGEST_GAP
    yield _at_exchanges(cell, number, reference, target, received, whole, "driver's")


def _at_exchanges(
    cell: Cell,
    number: int,
    reference: Trajectory,
    target: Trajectory | None,
    received: ReceivedPass,
    whole: bool,
    stamps: str,
) -> PassSeries:
    """Return a pass with a row for each exchange from its first pose to its last; whole: of all exchanges.

    The deviation from the reference, which changes slowly, is interpolated; it is the deflection.
    """
    steps = np.arange(path_of(cell).clock.steps(reference.duration_ns) + 1)
    times = path_of(cell).clock.stamp(steps)
    inside = whole | ((times >= received.pose_ns[0]) & (times <= received.pose_ns[-1]))
    steps, times = steps[inside], times[inside]
    off = interpolated(times, received.pose_ns, received.position - reference.sample(received.pose_ns))
    rows = {
        "tool_pose": np.hstack([reference.sample(times) + off, reference.sample_orientation(times)]),
        "deflection": np.hstack([off, np.zeros_like(off)]),
        "wrench": interpolated(times, received.wrench_ns, received.wrench),
    }
    return PassSeries(
        number,
        reference,
        target,
        {name: Series(steps, times, values) for name, values in rows.items()},
        stamps=stamps,
        driven_lost=received.missing,
        driven_whole=whole,
    )


def _rsi_pass(recording: Recording, cell: Cell, graph: GraphRecord) -> PassSeries:
    """Return the pass of an RSI session, along the target of the cell.

    The target in the recording is the program of the robot. It differs from the target of the cell by the sag of the
    arm, which the poses therefore do not contain. The reference in the recording is the program plus the correction.
    Raises RecordingError where the session never was on the path, or where its cell has another path.
    """
    (reference,) = graph.references
    programmed, target = graph.target_of(reference) or reference, path_of(cell).target
    place = series(recording, graph.topics["tool_pose"]).values[:, :3]
    if abs(programmed.duration_ns - target.duration_ns) > LONGEST_GAP:
        reason = f"its program takes {programmed.duration_ns * 1e-9:g} s, but the path of its cell"
        raise RecordingError(recording.path, f"{reason} {target.duration_ns * 1e-9:g} s")
    path = PathProgress(programmed.position)
    progress = np.full(len(place), np.nan)
    for k, point in enumerate(place):
        if path.advance(point) <= path.reach:
            progress[k] = path.progress
    on_path = np.flatnonzero(np.isfinite(progress))
    if on_path.size < 2 or path.progress == 0.0:
        raise RecordingError(recording.path, "the robot was never on the path")
    knots = path.distance[np.cumsum(path.moved) - 1]
    time = np.interp(progress[on_path], knots, programmed.time_ns).astype(np.int64)
    time, rows = np.unique(time[::-1], return_index=True)  # the last pose of a stop
    off = place[on_path[::-1][rows]] - programmed.sample(time)
    shift = reference.position - programmed.position
    along = Trajectory(programmed.time_ns, target.sample(programmed.time_ns) + shift, target.quaternion[0])
    received = ReceivedPass(time, target.sample(time) + off, np.zeros(0, np.int64), np.zeros((0, 6)))
    whole = path.length - path.progress <= 1e-4  # the session is complete
    return _at_exchanges(cell, 0, along, target, received, whole, "place")


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
        graph = read_graph(recording, path_of(cells[0]).clock, namespace)
        if f"{graph.namespace}/correction" in recording.topics():
            read = [_rsi_pass(recording, cells[0], graph)]
        else:  # a driver publishes no deflection
            read = [part for part in graph.passes if part.reason or part.topic("deflection").step.size]
            if all(part.reason for part in read):
                read += _driven_passes(recording, cells[0], graph)
        name, file = name or recording.path.stem, Path(cells[0].path.file).name
        attached = file in [about.name for about in recording.attachments]
        program = recording.attachment(file).decode("utf-8", errors="replace") if attached else None
        names = [f"{name}_{number}" if len(read) > 1 else name for number in range(1, len(read) + 1)]
        passes = []
        unused: dict[str, str] = {}  # pass that cannot be used: reason
        for part, part_name in zip(read, names, strict=True):
            try:
                passes.append(_scored(recording, cells, part, part_name, program, unused))
            except MessageError as error:  # noqa: PERF203 - one pass of several
                unused[part_name] = str(error)
    if not passes:
        reason = f"holds no pass: {NO_PASS}, or a pass of a robot with another clock"
        raise RecordingError(recording.path, next(iter(unused.values()), reason))
    return passes


def _scored(
    recording: Recording, cells: Cells, series: PassSeries, name: str, program: str | None, unused: Mapping[str, str]
) -> tuple[ScoredPass, RecordedFacts]:
    """Return a scored pass and its facts; raise MessageError for a pass that cannot be used."""
    cell, plant = cells
    reference, target = series.reference, series.target or path_of(cell).target
    checked_length(reference, path_of(cell).clock)
    if series.reason:
        raise MessageError(series.reason)
    last = path_of(cell).clock.steps(reference.duration_ns)
    recorded = {kind: series.topic(kind).last() for kind in EXCHANGED}
    driven = series.stamps != "exchange"
    planned = reference if driven else imperfect_course(plant, reference, 0)
    if not driven:
        recorded["deflection"] = _all_deflections(plant, reference, planned, recorded)
    steps = functools.reduce(lambda a, b: np.intersect1d(a, b, True), (rows.step for rows in recorded.values()))
    if steps.size < 2:
        raise MessageError(f"has no {NO_PASS}")
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
    return scored_pass, RecordedFacts(cell, target, lost, to_end, complete, program, series.stamps, unused)


def _all_deflections(plant: Cell, reference: Trajectory, planned: Trajectory, recorded: dict[str, Series]) -> Series:
    """Return the recorded deflections, completed by recomputed ones where both agree bit for bit.

    The deflections follow from the wrenches, which were all published.
    """
    wrench, there = recorded["wrench"], recorded["deflection"]
    if len(there.step) >= len(wrench.step):
        return there
    model = imperfect_arm(plant, reference)
    whole = path_of(plant).clock.steps(planned.duration_ns) + 1
    pushes = model.push(planned, path_of(plant).clock.stamp(np.arange(whole)))
    computed = follow(model, pushes, wrench.values[: min(wrench.unbroken(), whole)])
    known = there.step < len(computed)
    other = (computed[there.step[known]].view(np.int64) != there.values[known].view(np.int64)).any(axis=1)
    end = int(there.step[known][np.argmax(other)]) if other.any() else len(computed)
    later = there.step >= end
    step = np.append(np.arange(end), there.step[later])
    return Series(step, path_of(plant).clock.stamp(step), np.append(computed[:end], there.values[later], axis=0))


def _result(
    cells: Cells, target: Trajectory, run: Trajectory, steps: np.ndarray, rows: dict, wall: float
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
