"""The compensator of a recording: each state that it published, recomputed from the passes that the state names."""

from __future__ import annotations

import bisect
import contextlib
import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from kr270_milling.base.errors import MillingError
from kr270_milling.base.samples import CompensatorState, LearnedRecording, PoseSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import compensator
from kr270_milling.exchange.compensator import end_of
from kr270_milling.exchange.inbox import ReceivedPass
from kr270_milling.exchange.replay.compare import Channel
from kr270_milling.exchange.replay.received import EarlierRecordings, NotRecorded, PassCollector
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.methods import METHODS
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.codec import from_bytes, trajectory_from_bytes
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["CompensatorFeed", "Revision"]

(STATE_TYPE,) = (topic.type for topic in TOPICS if topic.record is CompensatorState)


class Rebuilt(NamedTuple):
    """A compensator and its state, as they follow from the passes that a recorded state names."""

    compensator: Compensator
    state: CompensatorState


class Revision(NamedTuple):
    """The compensator after the last complete pass of a recording."""

    compensator: Compensator
    target: Trajectory
    published: bytes | None  #: the next reference in the recording; None: not recorded, or another method was chosen


class CompensatorFeed:
    """Collects states, references and passes; ``finish`` compares the states and references with recomputed ones.

    A state names the passes that its reference follows from. They are in this recording or in the files that the
    state names. The fingerprint decides whether it is the same pass. The node publishes a state and its reference
    together, so the first state belongs to the first reference, and so on.
    """

    def __init__(
        self, cells: tuple[Cell, Cell], channels: dict[str, Channel], place: tuple[Path, str, Mapping[str, str]],
        stop: Callable[[int | None, str], None], starts: Sequence[int] = (),
    ):  # fmt: skip
        self.cell, plant = cells
        self._plant = None if plant is self.cell else plant
        self._channels = channels
        self._stop = stop
        target = self.cell.target()
        self._targets = {fingerprint(target): target}
        self._end_ns = end_of(self.cell, target)
        self._collector = PassCollector(self.cell, self._end_ns, starts)
        self._starts = starts
        self._place = place  # of the recording: file, namespace, remap
        self._earlier: dict[int, EarlierRecordings] = {}  # by the end stamp of a pass
        self._states: list[tuple[bytes, CompensatorState]] = []
        self._references: list[bytes] = []
        self._claimed: set[int] = set()  # passes of this file that a state names
        self._records: dict[str, tuple[LearnedRecording, PassRecord]] = {}  # by the stated fingerprint
        self._made: dict[tuple, Compensator] = {}

    def target(self, target: Trajectory) -> None:
        """Take a target of the user."""
        self._targets[fingerprint(target)] = target
        self._end_ns = end_of(self.cell, target)
        self._collector.inbox.end_ns = self._end_ns

    def state(self, data: bytes) -> None:
        """Take the next state of the compensator."""
        with contextlib.suppress(ValueError):
            state = from_bytes(STATE_TYPE, data)
            if state.method in METHODS:
                self._states.append((data, state))
                return
        if "compensator_state" in self._channels:
            self._channels["compensator_state"].recorded(0, data, refused=True)

    def reference(self, data: bytes, usable: bool) -> None:
        """Take the next reference trajectory; usable: the nodes do not refuse the message."""
        if usable:
            self._references.append(data)
        else:
            self._channels["reference_trajectory"].recorded(0, data, refused=True)

    def sample(self, sample: PoseSample | WrenchSample) -> None:
        """Take the next tool_pose or wrench that was checked."""
        self._collector.sample(sample, len(self._references))

    # --- comparison ---

    def finish(self) -> None:
        """Compare what was recorded."""
        self._collector.finish()
        for index in range(max(len(self._states), len(self._references))):
            made = self._compare_state(index) if index < len(self._states) else None
            if index < len(self._references):
                self._compare_reference(index, made, self._references[index])
            elif made is not None and index < len(self._states) - 1:  # a recorder may stop after the last state
                number, stamp = self._when(index)
                self._channels["reference_trajectory"].expected(stamp, made.compensator.reference, number=number)

    def _compare_state(self, index: int) -> Rebuilt | None:
        data, state = self._states[index]
        channel = self._channels["compensator_state"]
        try:
            rebuilt = self._rebuild(state, index)
        except MillingError as error:
            self._stop(None, str(error))
            channel.take(data)
            return None
        number, stamp = self._when(index)
        channel.expected(stamp, rebuilt.state, number=number)
        channel.recorded(stamp, data, number=number)
        return rebuilt

    def _compare_reference(self, index: int, made: Rebuilt | None, data: bytes) -> None:
        channel = self._channels["reference_trajectory"]
        if made is not None:
            number, stamp = self._when(index)
            channel.expected(stamp, made.compensator.reference.starting_at(stamp_of(data) or 0), number=number)
            channel.recorded(stamp, data, number=number)
            return
        channel.take(data)
        if index > 0 and index >= len(self._states):
            self._stop(None, "a reference trajectory was published without its compensator_state")

    def _when(self, index: int) -> tuple[int, int]:
        """Return number and end stamp of the pass before a state; it sorts the first differences of the topics."""
        passes = self._states[index][1].passes - self._states[0][1].passes
        if passes <= 0:
            return 0, 0
        start = (stamp_of(self._references[index - 1]) or 0) if index <= len(self._references) else 0
        return (passes - 1 if start == 0 else 0) + bisect.bisect_right(self._starts, start), start + self._end_ns

    # --- recompute of a state ---

    def _rebuild(self, stated: CompensatorState, index: int) -> Rebuilt:
        """Return the compensator that follows from the stated passes; raises MillingError where one is missing."""
        target = self._targets.get(stated.target)
        if target is None:
            raise NotRecorded("", f"the target trajectory {stated.target} of the compensator is not in the recording")
        before = {one.fingerprint for _, state in self._states[:index] for one in state.learned}
        here = [index > 0 and one.fingerprint not in before for one in stated.learned]
        passes = [self._learned(one, index if new else None) for one, new in zip(stated.learned, here, strict=True)]
        made = self._revised(target, stated.method, [record for _, record in passes])
        state = CompensatorState(
            stated.name, made.method, stated.passes, made.finished, fingerprint(target), fingerprint(made.reference),
            tuple(one for one, _ in passes),
        )  # fmt: skip
        return Rebuilt(made, state)

    def _revised(self, target: Trajectory, method: str, records: list[PassRecord]) -> Compensator:
        key: tuple = (method, id(target))
        made = self._made.setdefault(key, compensator(self.cell, target, method))
        for record in records:
            key += (id(record),)
            if key not in self._made:
                made = copy.copy(made)
                made.revise(record)
                self._made[key] = made
            made = self._made[key]
        return made

    def _learned(self, stated: LearnedRecording, index: int | None) -> tuple[LearnedRecording, PassRecord]:
        """Return a pass as this recording or an earlier one has it.

        index: of the first state that names the pass; None where that state is not in this recording.
        """
        if stated.fingerprint not in self._records:
            received, plant, number = self._received(stated, index)
            record = received.record(self.cell, plant, number)
            self._records[stated.fingerprint] = received.as_learned(stated.recording), record
        return self._records[stated.fingerprint]

    def _received(self, stated: LearnedRecording, index: int | None) -> tuple[ReceivedPass, Cell | None, int]:
        path = self._place[0]
        if index is None and stated.recording != f"{path.parent.name}/{path.name}":
            earlier = self._earlier.setdefault(self._end_ns, EarlierRecordings(self._end_ns, *self._place))
            return earlier.find(stated)
        passes = {
            number: received.until_wrench(stated.wrenches)
            for number, received in enumerate(self._collector.passes)
            if number not in self._claimed and (index is None or self._collector.before[number] <= index)
        }
        same = (number for number, received in passes.items() if received.fingerprint == stated.fingerprint)
        number = next(same, next(iter(passes), None))
        if number is None:
            raise NotRecorded(stated.recording, "the reference trajectory follows from a pass that was not recorded")
        self._claimed.add(number)
        received = passes[number]
        there = received.pose_ns.size, received.wrench_ns.size
        if there != (stated.poses, stated.wrenches):
            reason = (
                f"the compensator received {stated.poses} poses and {stated.wrenches} wrenches of a pass, of which "
            )
            raise NotRecorded(stated.recording, reason + "the recording has {} and {}".format(*there))
        return received, self._plant, number

    # --- another revision of the last pass ---

    def revise(self, method: str | None = None) -> Revision | None:
        """Return the revision after the last complete pass; None where no pass is complete. Raises MillingError.

        method: default the recorded one. Another method starts from the reference of the pass.
        """
        self._collector.finish()
        if not self._collector.passes or not self._references:
            return None
        count = max(self._collector.before[-1], 1)  # the pass runs along the reference before this one
        state = self._states[min(count, len(self._states)) - 1][1] if self._states else None
        target = self._targets.get(state.target) if state is not None else list(self._targets.values())[-1]
        if target is None:
            raise NotRecorded("", "the target trajectory of the compensator is not in the recording")
        if state is not None and method in (None, state.method):
            made = copy.copy(self._rebuild(state, 0).compensator)
        else:
            made = compensator(self.cell, target, method)
            reference = trajectory_from_bytes(self._references[count - 1], as_sent=True)
            if fingerprint(reference) != fingerprint(target):
                if method is None and made.repeats:
                    raise NotRecorded("", f"{made.method} needs the passes before this one, and no state names them")
                made.resume(reference, state is not None and state.finished)
        made.revise(self._last_pass().record(self.cell, self._plant, len(self._collector.passes) - 1))
        same = state is None or method in (None, state.method)
        return Revision(made, target, self._references[count] if same and count < len(self._references) else None)

    def _last_pass(self) -> ReceivedPass:
        """Return the last pass, with the wrenches that the compensator received if a state names the pass."""
        last = self._collector.passes[-1]
        for one in (one for _, state in self._states for one in state.learned):
            received = last.until_wrench(one.wrenches)
            if received.fingerprint == one.fingerprint:
                return received
        return last
