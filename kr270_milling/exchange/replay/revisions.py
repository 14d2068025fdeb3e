"""The compensator of a recording: each state and reference that it published, from the passes that the state names."""

from __future__ import annotations

from kr270_milling.base.errors import MillingError
from kr270_milling.base.samples import CompensatorState, LearnedRecording
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import compensator
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.inbox import ReceivedPass
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.methods import methods
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.passes import GraphRecord, PassSeries

__all__ = ["NotRecorded", "Revisions"]


class NotRecorded(MillingError):
    """A state that the recording does not lead to; elsewhere: its history is in other recordings."""

    def __init__(self, reason: str, elsewhere: bool = False):
        self.elsewhere = elsewhere
        super().__init__(reason)


class Revisions:
    """The node publishes its n-th state together with its n-th reference."""

    def __init__(self, recording: Recording, cells: tuple[Cell, Cell], graph: GraphRecord):
        self.graph = graph
        self.cell, plant = cells
        self._plant = None if plant is self.cell else plant.imperfections
        self._file = f"{recording.path.parent.name}/{recording.path.name}"
        self._passes = [series for series in graph.passes if self._complete(series)]
        self._learned: dict[str, int] = {}  # stated fingerprint -> number of the pass in this file
        target = path_of(self.cell).target
        self._targets = {fingerprint(target): target, **graph.targets}

    def _complete(self, series: PassSeries) -> bool:
        pose = series.topic("tool_pose").last()
        steps = path_of(self.cell).clock.steps(series.reference.duration_ns)
        return not series.reason and pose.unbroken() > 0 and pose.step[-1] == steps

    def order(self, index: int) -> tuple[int, int]:
        """Return number and end stamp [ns] of the pass before a state, for the order of differences."""
        numbers = [k for k, series in enumerate(self.graph.passes) if series.number < index]
        if not numbers:
            return 0, 0
        reference = self.graph.passes[numbers[-1]].reference
        return numbers[-1], reference.start_ns + reference.duration_ns

    def rebuild(self, index: int) -> tuple[CompensatorState, Trajectory]:
        """Return a state and its reference as they follow from the recorded passes. Raises NotRecorded."""
        if index >= len(self.graph.states):
            raise NotRecorded("a reference trajectory was published without its compensator_state", index == 0)
        stated = self.graph.states[index]
        rebuilt = self._revised(stated, index)
        numbers = [self._number(named, index) for named in stated.learned]
        learned = tuple(
            named if number is None else self._received(number, named).as_learned(named.recording)
            for named, number in zip(stated.learned, numbers, strict=True)
        )
        reference = fingerprint(rebuilt.reference)
        state = CompensatorState(
            stated.name,
            rebuilt.method,
            stated.passes,
            rebuilt.finished,
            fingerprint(rebuilt.target),
            reference,
            learned,
        )
        return state, rebuilt.reference

    def _number(self, stated: LearnedRecording, index: int) -> int | None:
        """Return the pass in this file that a state names; None for a pass of another file. Raises NotRecorded."""
        if stated.fingerprint in self._learned:
            return self._learned[stated.fingerprint]
        same = [n for n in range(len(self._passes)) if self._received(n, stated).fingerprint == stated.fingerprint]
        before = {named.fingerprint for state in self.graph.states[:index] for named in state.learned}
        if not same and (index == 0 or stated.fingerprint in before):
            return None
        free = [n for n, series in enumerate(self._passes) if n not in self._learned.values() and series.number < index]
        if not same and not free:
            raise NotRecorded("the reference trajectory follows from a pass that was not recorded")
        number = (same or free)[0]
        self._learned[stated.fingerprint] = number
        received = self._received(number, stated)
        there = received.pose_ns.size, received.wrench_ns.size
        if there != (stated.poses, stated.wrenches):
            del self._learned[stated.fingerprint]
            reason = (
                f"the compensator received {stated.poses} poses and {stated.wrenches} wrenches of a pass, of which "
            )
            raise NotRecorded(reason + "the recording has {} and {}".format(*there))
        return number

    def _record(self, received: ReceivedPass, number: int) -> PassRecord:
        return received.record(path_of(self.cell), self.cell.imperfections, self._plant, number)

    def _received(self, number: int, stated: LearnedRecording | None = None) -> ReceivedPass:
        """Return a pass as the compensator received it, with the wrenches that a state counts."""
        series = self._passes[number]
        pose, wrench = series.topic("tool_pose").last(), series.topic("wrench").last()
        received = ReceivedPass(pose.stamp_ns, pose.values[:, :3].copy(), wrench.stamp_ns, wrench.values)
        return received if stated is None else received.until_wrench(stated.wrenches)

    def _revised(self, state: CompensatorState, index: int, place: int | None = None) -> Compensator:
        """Return the compensator after the passes that a state names. Raises NotRecorded.

        Where earlier passes are in other recordings, a method without experience continues from the reference of the
        last pass. place: of a reference that is taken as recorded instead.
        """
        target = self._targets.get(state.target)
        if target is None or state.method not in methods():
            reason = f"the target trajectory {state.target} of the compensator is not in the recording"
            raise NotRecorded(reason if target is None else f"the method {state.method} is not known")
        numbers = [self._number(named, index) for named in state.learned]
        rebuilt = compensator(self.cell, target, state.method)
        known = [number for number in numbers if number is not None]
        if len(known) < len(numbers):
            last = numbers[-1]
            # the revision of these methods follows from all passes before
            experienced = rebuilt.repeats or rebuilt.method in ("learned", "inverse", "robust")
            if experienced or (last is None and place is None):
                raise NotRecorded("the reference trajectory follows from passes in other recordings", elsewhere=True)
            known = [] if last is None else [last]
            start = place if last is None else self._passes[last].number
            rebuilt.resume(self.graph.published[start or 0], state.finished)
        for number in known:
            rebuilt.revise(self._record(self._received(number, self._state_of(number)), number))
        return rebuilt

    def _state_of(self, number: int) -> LearnedRecording | None:
        """Return the statement of a state about a pass."""
        names = [digest for digest, known in self._learned.items() if known == number]
        stated = (named for state in self.graph.states for named in state.learned if named.fingerprint in names)
        return next(stated, None)

    def revise(self, method: str | None = None) -> tuple[Compensator, Trajectory, Trajectory | None] | None:
        """Return the revision after the last complete pass, its target, and the next reference in the recording.

        None where no pass is complete. method: default the recorded one; another method starts from the reference of
        the pass. Raises MillingError.
        """
        if not self._passes:
            return None
        number = len(self._passes) - 1
        place = self._passes[number].number  # index of its reference, and of the state that was published with it
        state = self.graph.states[min(place, len(self.graph.states) - 1)] if self.graph.states else None
        target = self._targets.get(state.target) if state else list(self._targets.values())[-1]
        if target is None:
            raise NotRecorded("the target trajectory of the compensator is not in the recording")
        following = self.graph.states[place + 1] if place + 1 < len(self.graph.states) else None
        same = state is None or method in (None, state.method)
        if state is not None and same:
            rebuilt = self._revised(state, place, place)
        else:
            rebuilt = compensator(self.cell, target, method)
            reference = self.graph.published[place]
            if fingerprint(reference) != fingerprint(target):
                if method is None and rebuilt.repeats:
                    raise NotRecorded(f"{rebuilt.method} needs the passes before this one, and no state names them")
                rebuilt.resume(reference, state is not None and state.finished)
        last = self._received(number, following.learned[-1] if following and following.learned else None)
        rebuilt.revise(self._record(last, number))
        published = self.graph.published[place + 1] if same and place + 1 < len(self.graph.published) else None
        return rebuilt, target, published
