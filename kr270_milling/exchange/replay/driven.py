"""Readers of passes whose poses have the stamps of a driver: of a robot with another clock, or of an RSI session.

They return the ``PassSeries`` that ``read_graph`` returns of the simulated robot, with a row for each exchange. The
inbox of the compensator separates the passes of a robot. In an RSI session the place on the path decides the time,
because override and stops change the feed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import numpy as np

from kr270_milling.base.errors import MessageError, MillingError, RecordingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import path_of
from kr270_milling.cell.path import MOST_STEPS
from kr270_milling.exchange.compensator import end_of
from kr270_milling.exchange.inbox import BREAK_NS, PassInbox, ReceivedPass, interpolated
from kr270_milling.exchange.inputs import WrenchFrames, checked_pose, checked_wrench
from kr270_milling.path.progress import PathProgress
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series
from kr270_milling.recordings.messages.codec import from_bytes
from kr270_milling.recordings.passes import TYPES, GraphRecord, PassSeries, Series, read_graph

__all__ = ["read_passes", "too_long"]

LONGEST_GAP = 100_000_000  # [ns] between two poses of a complete pass
TOPICS = ("reference_trajectory", "tool_pose", "wrench")


def read_passes(recording: Recording, cell: Cell, namespace: str | None = None) -> list[PassSeries]:
    """Return every pass of one robot, also those that cannot be used. Raises RecordingError."""
    graph = read_graph(recording, path_of(cell).clock, namespace)
    if f"{graph.namespace}/correction" in recording.topics():
        return [_rsi_pass(recording, cell, graph)]
    passes = [
        part for part in graph.passes if part.reason or part.topic("deflection").step.size
    ]  # a driver publishes none
    if any(not part.reason for part in passes):
        return passes
    return [*passes, *_driven_passes(recording, cell, graph)]


def too_long(cell: Cell, reference: Trajectory) -> str:
    """Return why a pass along a reference cannot be used, if the reference takes too long."""
    longest = path_of(cell).clock.steps(reference.duration_ns) > MOST_STEPS
    return f"its reference trajectory takes {reference.duration_ns * 1e-9:g} s" if longest else ""


def _driven_passes(recording: Recording, cell: Cell, graph: GraphRecord) -> Iterator[PassSeries]:
    """Yield the passes of a robot with another clock, in the order of the file, as the compensator receives them."""
    names = {topic: name for name, topic in graph.topics.items() if name in TOPICS}
    frames = WrenchFrames(cell.mount, cell.workpiece, cell.sensor)
    check: dict[str, Callable] = {  # as the compensator checks them
        "reference_trajectory": lambda run: run,
        "tool_pose": checked_pose,
        "wrench": lambda sample: checked_wrench(sample, frames.names),
    }
    inbox, reference, number, last = PassInbox(0, 1), None, -1, b""
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
            inbox = PassInbox(end_of(cell, record), 1, record.start_ns, record, path_of(cell).clock, frames)
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
        if reason := too_long(cell, reference):
            raise MessageError(reason)
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
        driven_lost=_poses_lost(received),
        driven_whole=whole,
    )


def _poses_lost(received: ReceivedPass) -> int:
    """Return the number of poses that are missing, by the median of the times between two poses."""
    steps = np.diff(received.pose_ns)
    return int(np.sum(np.maximum(np.rint(steps / np.median(steps)) - 1, 0))) if steps.size else 0


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
