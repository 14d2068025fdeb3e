"""The compensator of a recording: each published state and reference, and the revision of the last recorded pass."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.base.samples import CompensatorState, LearnedRecording
from kr270_milling.cell.jobs import compensator
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.inbox import ReceivedPass
from kr270_milling.exchange.replay.recorded import Cells, recorded_cells
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.methods import methods
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.passes import GraphRecord, PassSeries, read_graph


def robots_of(recording: Recording) -> list[str]:
    """Return the namespaces of the robots in a recording. Raises RecordingError where there is none."""
    names = ("tool_pose", "wrench", "reference_trajectory")
    places = {t.rpartition("/")[0] for t, a in recording.topics().items() if t.rpartition("/")[2] in names and a.count}
    if not places:
        raise RecordingError(recording.path, f"holds no {', '.join(names[:2])} or {names[2]} to recompute")
    return sorted(places)


@contextlib.contextmanager
def usable(recording: Recording) -> Iterator[None]:
    """Raise RecordingError for messages whose values are too large for a simulation, or that a model refuses."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a force of 1e300 N is a valid input
            yield
    except RecordingError:
        raise
    except (MillingError, ValueError, OverflowError) as error:
        raise RecordingError(recording.path, " ".join(str(error).split())) from error


def costs_messages(reason: str, offset: int, size: int) -> bool:
    """Return whether a damage costs messages; ``findings`` reports the others."""
    return size > 13  # bytes of the record with the checksum of the data


def array_difference(field: str, recorded: np.ndarray, expected: np.ndarray) -> tuple[str, object, object] | None:
    """Return place and both values of the first item with other bits."""
    if recorded.shape != expected.shape:
        return f"shape of {field}", recorded.shape, expected.shape
    a, b = (np.ascontiguousarray(x).view(f"i{x.dtype.itemsize}") for x in (recorded, expected))
    if np.array_equal(a, b):
        return None
    place = tuple(int(k) for k in np.argwhere(a != b)[0])
    return f"{field}[{', '.join(map(str, place))}]", recorded[place].item(), expected[place].item()


def record_difference(recorded, expected) -> tuple[str, object, object] | None:
    """Return name and both values of the first field of two records that differs."""
    names = [field.name for field in dataclasses.fields(expected)]
    if isinstance(expected, Trajectory):  # fields with the bits of a message
        names = ["time_ns", "position", "quaternion", "velocity"]
    for name in names:
        a, b = getattr(recorded, name), getattr(expected, name)
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
            if field := array_difference(name, a, b):
                return field
        elif (a is None) != (b is None) or a != b:
            return name, a, b
    return None


class NotRecorded(MillingError):
    """A state that the recording does not lead to; elsewhere: its history is in other recordings."""

    def __init__(self, reason: str, elsewhere: bool = False):
        self.elsewhere = elsewhere
        super().__init__(reason)


class Revisions:
    """The n-th state and reference of the compensator, as they follow from the recorded passes.

    A pass that a state names first is the last pass before this state; passes of the first state are in other files.
    """

    def __init__(self, cells: Cells, graph: GraphRecord):
        self.graph = graph
        self.cell, plant = cells
        self._plant = None if plant is self.cell else plant.imperfections
        self._passes = [series for series in graph.passes if self._is_complete(series)]
        target = path_of(self.cell).target
        self._targets = {fingerprint(target): target, **graph.targets}
        self._numbers: dict[str, int | None] = {}  # stated fingerprint -> pass in this file; None: in another one
        for index, state in enumerate(graph.states):
            before = sum(series.number < index for series in self._passes) - 1
            for named in state.learned:
                known = before in self._numbers.values() or before < 0
                self._numbers.setdefault(named.fingerprint, (None if index == 0 else -1) if known else before)

    def _is_complete(self, series: PassSeries) -> bool:
        pose = series.topic("tool_pose").last()
        steps = path_of(self.cell).clock.steps(series.reference.duration_ns)
        return not series.reason and pose.unbroken() > 0 and pose.step[-1] == steps

    def order(self, index: int) -> tuple[int, int]:
        """Return number and end stamp [ns] of the pass before a state, for the order of differences."""
        before = [(number, series) for number, series in enumerate(self.graph.passes) if series.number < index]
        if not before:
            return 0, 0
        number, series = before[-1]
        return number, series.reference.start_ns + series.reference.duration_ns

    def rebuild(self, index: int) -> tuple[CompensatorState, Trajectory]:
        """Return a state and its reference as they follow from the recorded passes. Raises NotRecorded."""
        if index >= len(self.graph.states):
            raise NotRecorded("a reference trajectory was published without its compensator_state", index == 0)
        stated = self.graph.states[index]
        rebuilt = self._revised(stated)
        numbers = [(named, self._numbers[named.fingerprint]) for named in stated.learned]
        state = dataclasses.replace(
            stated,
            method=rebuilt.method,
            finished=rebuilt.finished,
            target=fingerprint(rebuilt.target),
            reference=fingerprint(rebuilt.reference),
            learned=tuple(
                named if number is None else self._received(number, named).as_learned(named.recording)
                for named, number in numbers
            ),
        )
        return state, rebuilt.reference

    def _record(self, number: int, stated: LearnedRecording | None) -> PassRecord:
        received = self._received(number, stated)
        return received.record(path_of(self.cell), self.cell.imperfections, self._plant, number)

    def _pass(self, number: int) -> PassSeries:
        """Return a complete pass. Raises NotRecorded."""
        if number < 0:
            raise NotRecorded("the reference trajectory follows from a pass that was not recorded")
        return self._passes[number]

    def _received(self, number: int, stated: LearnedRecording | None) -> ReceivedPass:
        """Return a pass as the compensator received it, with the wrenches that a state counts. Raises NotRecorded."""
        pose, wrench = (self._pass(number).topic(name).last() for name in ("tool_pose", "wrench"))
        end = wrench.step.size if stated is None else stated.wrenches
        received = ReceivedPass(pose.stamp_ns, pose.values[:, :3].copy(), wrench.stamp_ns[:end], wrench.values[:end])
        there = received.pose_ns.size, received.wrench_ns.size
        if stated is not None and there != (stated.poses, stated.wrenches):
            stated_counts = f"{stated.poses} poses and {stated.wrenches} wrenches"
            recorded = "the recording has {} and {}".format(*there)
            raise NotRecorded(f"the compensator received {stated_counts} of a pass, of which {recorded}")
        return received

    def _revised(self, state: CompensatorState, place: int | None = None) -> Compensator:
        """Return the compensator after the passes that a state names. Raises NotRecorded.

        Where earlier passes are in other recordings, a method without experience continues from the reference of the
        last pass. place: of a reference that is taken as recorded instead.
        """
        target = self._targets.get(state.target)
        if target is None or state.method not in methods():
            reason = f"the target trajectory {state.target} of the compensator is not in the recording"
            raise NotRecorded(reason if target is None else f"the method {state.method} is not known")
        rebuilt = compensator(self.cell, target, state.method)
        passes = [(self._numbers[named.fingerprint], named) for named in state.learned]
        known = [(number, named) for number, named in passes if number is not None]
        if len(known) < len(passes):
            last = passes[-1][0]
            # the revision of these methods follows from all passes before
            experienced = rebuilt.repeats or rebuilt.method in ("learned", "inverse", "robust")
            if experienced or (last is None and place is None):
                raise NotRecorded("the reference trajectory follows from passes in other recordings", elsewhere=True)
            known = known[-1:] if last is not None else []
            start = place if last is None else self._pass(last).number
            rebuilt.resume(self.graph.published[start or 0], state.finished)
        for number, named in known:
            rebuilt.revise(self._record(number, named))
        return rebuilt

    def revise(self, method: str | None = None) -> tuple[Compensator, Trajectory | None] | None:
        """Return the revision after the last complete pass and the next reference in the recording.

        None where no pass is complete. method: default the recorded one; another method starts from the reference of
        the pass. Raises MillingError.
        """
        if not self._passes:
            return None
        states, published = self.graph.states, self.graph.published
        number = len(self._passes) - 1
        place = self._passes[number].number  # index of its reference, and of the state that was published with it
        state = states[min(place, len(states) - 1)] if states else None
        target = self._targets.get(state.target) if state else list(self._targets.values())[-1]
        if target is None:
            raise NotRecorded("the target trajectory of the compensator is not in the recording")
        same = state is None or method in (None, state.method)
        if state is not None and same:
            rebuilt = self._revised(state, place)
        else:
            rebuilt = compensator(self.cell, target, method)
            if fingerprint(published[place]) != fingerprint(target):
                if method is None and rebuilt.repeats:
                    raise NotRecorded(f"{rebuilt.method} needs the passes before this one, and no state names them")
                rebuilt.resume(published[place], state is not None and state.finished)
        following = states[place + 1].learned[-1:] if place + 1 < len(states) else ()
        rebuilt.revise(self._record(number, *following or (None,)))
        return rebuilt, published[place + 1] if same and place + 1 < len(published) else None


def compensate_recording(path, method: str | None = None) -> list[tuple[str, Compensator, bool | None]]:
    """Return the revision after the last complete pass of each robot: namespace, compensator, and a comparison.

    The comparison: the live node published the same bits; None: not recorded, or ``method`` takes the place of the
    recorded one. Raises RecordingError where no pass is complete, or where the pass cannot be revised.
    """
    revised: list[tuple[str, Compensator, bool | None]] = []
    with Recording(path) as recording:
        cells = recorded_cells(recording)
        for namespace in robots_of(recording):
            graph = read_graph(recording, path_of(cells[0]).clock, namespace, on_damage=costs_messages)
            with usable(recording):
                revision = Revisions(cells, graph).revise(method)
            if revision is not None:
                by, published = revision
                same = None if published is None else record_difference(published, by.reference) is None
                revised.append((namespace, by, same))
        if not revised:
            raise RecordingError(recording.path, "holds no complete pass along a recorded reference trajectory")
    return revised
