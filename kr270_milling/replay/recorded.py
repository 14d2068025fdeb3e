"""A pass out of its recording: the same record that a simulation makes, so that scores and reports are the same."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import RecordingError
from kr270_milling.cell.cell import MOST_STEPS, Cell
from kr270_milling.cell.jobs import ScoredPass, scored
from kr270_milling.cell.plant import imperfect_course
from kr270_milling.messages.codec import trajectory_from_bytes
from kr270_milling.messages.series import series
from kr270_milling.replay.attached import cell_of, plant_of
from kr270_milling.simulation.admission import MessageError
from kr270_milling.simulation.milling_pass import PassResult
from kr270_milling.simulation.sides import RobotSide
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["RecordedPass", "pass_from_recording", "references", "topic_of"]

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


def topic_of(recording: Recording, name: str, namespace: str | None = None) -> str:
    """The full name of one of the graph's topics in a recording; raises RecordingError where there is not just one."""
    if namespace is not None:
        found = [f"/{namespace.strip('/')}/{name}".replace("//", "/")]
        found = [topic for topic in found if topic in recording.topics()]
    else:
        found = [topic for topic in recording.topics() if topic.rpartition("/")[2] == name]
    if len(found) != 1:
        several = f"is there several times ({', '.join(found)}): name a namespace" if found else "is not recorded"
        several += f" in the namespace {namespace}" if namespace is not None else ""
        raise RecordingError(recording.path, f"the topic {name} {several}")
    return found[0]


def references(recording: Recording, namespace: str | None = None) -> list[Trajectory]:
    """Every reference trajectory in the order of their publication; the first is the one that the pass ran."""
    topic = topic_of(recording, "reference_trajectory", namespace)
    try:
        found = [trajectory_from_bytes(message.data) for message in recording.messages([topic], as_written=True)]
    except (MessageError, TrajectoryError) as error:
        raise RecordingError(recording.path, f"{topic}: {error}") from error
    if not found:
        raise RecordingError(recording.path, f"{topic} has no message")
    return found


def pass_from_recording(path, name: str | None = None, namespace: str | None = None) -> RecordedPass:
    """The pass that a recording holds; a file that was cut off gives the part that is there."""
    with Recording(path) as recording:
        cell, reference = cell_of(recording), references(recording, namespace)[0]
        plant = plant_of(recording, cell)
        heard = {kind: _by_stamp(recording, topic_of(recording, kind, namespace)) for kind in SERIES}
        wall = _wall_time(recording)
    last = cell.clock.steps(reference.duration_ns)
    if last > MOST_STEPS:
        raise RecordingError(recording.path, f"its reference trajectory takes {reference.duration_ns * 1e-9:g} s")
    heard = {kind: {s: v for s, v in at.items() if 0 <= cell.clock.step(s) <= last} for kind, at in heard.items()}
    lost_to_end = _lost(cell, heard, last)
    recorded = dict(heard)
    course = imperfect_course(plant, reference, 0)
    heard["deflection"] = _all_deflections(plant, reference, course, heard["wrench"], heard["deflection"])
    stamps = np.array(sorted(set.intersection(*map(set, heard.values()))), np.int64)
    if stamps.size < 2:
        raise RecordingError(recording.path, "holds no pass: poses, wrenches and deflections of at least one period")
    rows = {kind: np.array([values[stamp] for stamp in stamps.tolist()]) for kind, values in heard.items()}
    ended = int(stamps[-1]) >= int(cell.clock.stamp(last))
    end = last if ended else max(cell.clock.step(int(stamps[-1])), 0)
    lost = _lost(cell, recorded, end)
    result = _result(cell, plant, course, stamps, rows, wall)
    ran = ScoredPass(name or recording.path.stem, reference, result, scored(cell, result, plant.low_frequency))
    return RecordedPass(ran, cell, lost, lost_to_end, ended and not lost and not recording.cut_off)


def _lost(cell: Cell, recorded: dict[str, dict], last: int) -> int:
    """Poses, wrenches and deflections that are missing up to a step; of the deflections those that were due."""
    thinned = cell.thinned_steps
    due = sum(cell.clock.step(stamp) % thinned == 0 for stamp in recorded["deflection"])
    there = {"tool_pose": len(recorded["tool_pose"]), "wrench": len(recorded["wrench"])}
    return sum(max(0, last + 1 - count) for count in there.values()) + max(0, last // thinned + 1 - due)


def _all_deflections(
    plant: Cell, reference: Trajectory, course: Trajectory, wrenches: dict, recorded: dict
) -> dict[int, np.ndarray]:
    """Those that were recorded and, as far as these are the same to the bit, those between them: they follow from the
    wrenches, which were all published."""
    if len(recorded) >= len(wrenches):
        return recorded
    side = RobotSide(plant.arm_model(reference), plant.clock, course)
    found = {}
    for stamp in sorted(wrenches):
        deflection = side.answer(stamp, wrenches[stamp])
        if deflection is None or (stamp in recorded and deflection.tobytes() != recorded[stamp].tobytes()):
            break
        found[stamp] = deflection
    return {**recorded, **found}


def _by_stamp(recording: Recording, topic: str) -> dict[int, np.ndarray]:
    """Values by stamp; of a repeated stamp the last, which is what counted when an exchange was iterated."""
    found = series(recording, topic)
    once = topic.endswith("deflection")  # published once an exchange
    passes = int(np.count_nonzero(found.stamp == 0))
    if once and passes > 1:
        raise RecordingError(recording.path, f"holds {passes} passes; every pass needs a recording of its own")
    return dict(zip(found.stamp.tolist(), found.values, strict=True))


def _wall_time(recording: Recording) -> float:
    """[s], as the robot said it in /diagnostics; NaN if it did not."""
    wall = float("nan")
    if DIAGNOSTICS in recording.topics():
        for _, msg in recording.decoded([DIAGNOSTICS], as_written=True):
            for pair in (pair for status in msg.status for pair in status.values if pair.key == "wall_s"):
                with contextlib.suppress(ValueError):
                    wall = float(pair.value)
    return wall


def _result(cell: Cell, plant: Cell, run: Trajectory, stamps: np.ndarray, rows: dict, wall: float) -> PassResult:
    course, tool = run.sample(stamps), rows["tool_pose"][:, :3]
    torque, volume, steps, area, total, heights = _cut_again(plant, stamps, tool)
    shift = course + rows["deflection"][:, :3] - tool
    return PassResult(
        stamps, cell.target().sample(stamps), course, tool, rows["deflection"], rows["wrench"],
        np.sqrt(np.sum(shift**2, axis=1)), torque, volume, steps, area, total, wall,
        heights,
    )  # fmt: skip


def _cut_again(cell: Cell, stamps: np.ndarray, tool: np.ndarray) -> tuple:
    """What no message carries: torque (n + 1,), volume (n + 1,), micro-steps, area and volume in all, heights.

    From the recorded tool centres on a fresh workpiece; across a hole in the recording the tool goes straight.
    """
    cut, clock = cell.cut(), cell.clock
    steps = np.array([clock.step(stamp) for stamp in stamps.tolist()]) * clock.micro_steps
    _, torque, volume = cut.along(tool, steps)
    return torque, volume, int(steps[-1]), cut.removed_area, cut.removed_volume, cut.map_heights()[2]
