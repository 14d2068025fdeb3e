"""Passes whose poses have the stamps of a driver: of a robot with another clock, or of an RSI session.

The inbox of the compensator separates the passes of a robot. In an RSI session the place on the path decides the
time, because override and stops change the feed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.compensator import end_of
from kr270_milling.exchange.inbox import PassInbox, ReceivedPass, interpolated
from kr270_milling.exchange.inputs import WrenchFrames, checked_pose, checked_wrench
from kr270_milling.path.progress import PathProgress
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.periods import Clock
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import pose_from_bytes, trajectory_from_bytes, wrench_from_bytes

__all__ = ["driven_passes", "driven_steps", "poses_lost", "rsi_pass"]

LONGEST_GAP = 100_000_000  # [ns] between two poses of a complete pass
NEAR_END = 1e-4  # [m] from the end of the path, where an RSI session is complete
TOPICS = ("reference_trajectory", "tool_pose", "wrench")


class DrivenSteps(NamedTuple):
    """Tool centre and wrench of a driven pass in each exchange from its first pose to its last."""

    step: np.ndarray  #: number of the exchange, (k,), ascending
    tool: np.ndarray  #: [m], (k, 3)
    wrench: np.ndarray  #: [N, N m], (k, 6); 0 where none was recorded


def driven_steps(clock: Clock, reference: Trajectory, received: ReceivedPass, complete: bool) -> DrivenSteps:
    """Return the exchanges of a pass; complete: all exchanges of the reference.

    The deviation from the reference, which changes slowly, is interpolated.
    """
    steps = np.arange(clock.steps(reference.duration_ns) + 1)
    stamps = clock.stamp(steps)
    inside = complete | ((stamps >= received.pose_ns[0]) & (stamps <= received.pose_ns[-1]))
    steps, stamps = steps[inside], stamps[inside]
    off = received.position - reference.sample(received.pose_ns)
    tool = reference.sample(stamps) + interpolated(stamps, received.pose_ns, off)
    return DrivenSteps(steps, tool, interpolated(stamps, received.wrench_ns, received.wrench))


def poses_lost(received: ReceivedPass) -> int:
    """Return the number of poses that are missing, by the median of the times between two poses."""
    steps = np.diff(received.pose_ns)
    return int(np.sum(np.maximum(np.rint(steps / np.median(steps)) - 1, 0))) if steps.size else 0


def driven_passes(
    recording: Recording, cell: Cell, topics: Mapping[str, str], unused: list[str]
) -> Iterator[tuple[Trajectory, ReceivedPass, bool]]:
    """Yield reference, messages and completeness of each pass of a robot with another clock, in the order of the file.

    topics: our names -> recorded ones; unused: receives the reason for each pass whose poses do not follow its
    reference. A complete pass has no gap and runs to the end of its reference.
    """
    names = {topic: name for name, topic in topics.items() if name in TOPICS}
    frames = WrenchFrames(cell)
    read: dict[str, Callable] = {  # as the compensator reads and checks them
        "reference_trajectory": trajectory_from_bytes,
        "tool_pose": lambda data: checked_pose(pose_from_bytes(data)),
        "wrench": lambda data: checked_wrench(wrench_from_bytes(data), frames.names),
    }
    inboxes: list[tuple[PassInbox, Trajectory]] = []
    last = b""
    for message in recording.messages(set(names)):
        name = names[message.topic]
        if name == "reference_trajectory" and message.data == last:
            continue  # latched, received again
        with contextlib.suppress(MillingError):  # refused by the live node as well
            record = read[name](message.data)
            if name == "reference_trajectory":
                last = message.data
                inbox = PassInbox(end_of(cell, record), 1, record.start_ns, record, path_of(cell).clock, frames)
                inboxes.append((inbox, record))
            elif inboxes:
                inbox, _ = inboxes[-1]
                (inbox.pose if name == "tool_pose" else inbox.wrench)(record)
    for inbox, reference in inboxes:
        if not inbox.started or not inbox.foreign:
            continue
        got = _received(inbox, unused)
        if got is not None and got.pose_ns.size > 1:
            whole = inbox.at_end and int(np.diff(got.pose_ns).max()) <= LONGEST_GAP
            yield reference, got, whole


def _received(inbox: PassInbox, unused: list[str]) -> ReceivedPass | None:
    """Return the messages of a pass; None where the compensator refuses them."""
    try:
        return inbox.received()
    except MillingError as error:
        unused.append(str(error))
        return None


def rsi_pass(
    recording: Recording, cell: Cell, programmed: Trajectory, reference: Trajectory, place: np.ndarray
) -> tuple[Trajectory, ReceivedPass, bool]:
    """Return reference, poses and completeness of an RSI session along the target of the cell.

    programmed: what the robot program runs; it differs from the target by the sag of the arm, which the poses (n, 3)
    [m] therefore do not contain. reference: programmed plus correction. Raises RecordingError where the session never
    was on the path, or where its cell has another path.
    """
    target = path_of(cell).target
    if abs(programmed.duration_ns - target.duration_ns) > LONGEST_GAP:
        reason = f"its program takes {programmed.duration_ns * 1e-9:g} s, but the path of its cell"
        raise RecordingError(recording.path, f"{reason} {target.duration_ns * 1e-9:g} s")
    path = PathProgress(programmed.position)
    way = np.full(len(place), np.nan)
    for k, point in enumerate(place):
        if path.advance(point) <= path.reach:
            way[k] = path.progress
    on_path = np.flatnonzero(np.isfinite(way))
    if on_path.size < 2 or path.progress == 0.0:
        raise RecordingError(recording.path, "the robot was never on the path")
    knots = path.distance[np.cumsum(path.moved) - 1]
    time = np.interp(way[on_path], knots, programmed.time_ns).astype(np.int64)
    time, rows = np.unique(time[::-1], return_index=True)  # the last pose of a stop
    off = place[on_path[::-1][rows]] - programmed.sample(time)
    shift = reference.position - programmed.position
    along = Trajectory(programmed.time_ns, target.sample(programmed.time_ns) + shift, target.quaternion[0])
    complete = path.length - path.progress <= NEAR_END
    none = np.zeros(0, np.int64)
    return along, ReceivedPass(time, target.sample(time) + off, none, np.zeros((0, 6))), complete
