"""The compensator of a recording: each state that it published, recomputed from the passes that the state names."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from kr270_milling.base.errors import MillingError
from kr270_milling.base.samples import CompensatorState, LearnedPass, PoseSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import compensator
from kr270_milling.exchange.compensator import ReceivedPass, end_of, joint_program
from kr270_milling.exchange.replay.compare import Channel
from kr270_milling.exchange.replay.received import EarlierRecordings, MissingPass, PassCollector
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.methods import METHODS
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.recordings.messages.codec import from_bytes, trajectory_from_bytes
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["CompensatorFeed", "LastPass"]

(STATE_TYPE,) = (topic.type for topic in TOPICS if topic.record is CompensatorState)


class StateMessage(NamedTuple):
    data: bytes
    state: CompensatorState | None  # None: the message cannot be read


class ReferenceMessage(NamedTuple):
    data: bytes
    fingerprint: str | None  # None: the nodes refuse the message


class Rebuilt(NamedTuple):
    compensator: Compensator
    state: CompensatorState


class LastPass(NamedTuple):
    """The last complete pass of a recording."""

    received: ReceivedPass
    number: int  #: in the file
    state: CompensatorState | None  #: of the compensator when the pass began
    reference: Trajectory  #: along which the pass ran
    published: bytes | None  #: the next reference trajectory


class CompensatorFeed:
    """Collects states, references and passes; ``finish`` compares the states and references with recomputed ones.

    A state names the passes that its reference follows from. They are in this recording or in the files that the
    state names. The fingerprint decides whether it is the same pass.
    """

    def __init__(
        self, cells: tuple[Cell, Cell], channels: dict[str, Channel], place: tuple[Path, str],
        stop: Callable[[int | None, str], None],
    ):  # fmt: skip
        self.cell, plant = cells
        self._plant = None if plant is self.cell else plant
        self._channels = channels
        self._stop = stop
        target = self.cell.target()
        self._targets = {fingerprint(target): target}
        self._end_ns = end_of(self.cell, target)
        self._collector = PassCollector(self.cell, self._end_ns)
        self._place = place  # of the recording: file, namespace
        self._earlier: dict[int, EarlierRecordings] = {}  # by the end stamp of a pass
        self._states: list[StateMessage] = []
        self._references: list[ReferenceMessage] = []
        self._starts: list[tuple[int, int]] = []  # of each pass: states and references that came before it
        self._start = (0, 0)
        self._claimed: set[int] = set()  # passes of this file that a state names
        self._records: dict[str, tuple[LearnedPass, PassRecord]] = {}  # by the stated fingerprint
        self._made: dict[tuple, Compensator] = {}

    def target(self, target: Trajectory) -> None:
        """Take a target of the user."""
        self._targets[fingerprint(target)] = target
        self._end_ns = end_of(self.cell, target)
        self._collector.inbox.end_ns = self._end_ns

    def state(self, data: bytes) -> None:
        """Take the next state of the compensator."""
        try:
            state = from_bytes(STATE_TYPE, data)
        except ValueError:
            state = None
        self._states.append(StateMessage(data, state if state is not None and state.method in METHODS else None))

    def reference(self, data: bytes, run: Trajectory | None) -> None:
        """Take the next reference trajectory; run: None where the nodes refuse the message."""
        self._references.append(ReferenceMessage(data, None if run is None else fingerprint(run)))

    def sample(self, sample: PoseSample | WrenchSample) -> None:
        """Take the next tool_pose or wrench that was checked."""
        passes = len(self._collector.passes)
        self._collector.sample(sample)
        if len(self._collector.passes) > passes:
            self._starts.append(self._start)
        if isinstance(sample, PoseSample) and sample.stamp == 0:
            self._start = len(self._states), len(self._usable())

    def _usable(self) -> list[ReferenceMessage]:
        return [reference for reference in self._references if reference.fingerprint is not None]

    # --- comparison ---

    def finish(self) -> None:
        """Compare what was recorded."""
        self._close()
        rebuilt = [self._compare_state(index) for index in range(len(self._states))]
        self._compare_references(rebuilt)

    def _close(self) -> None:
        passes = len(self._collector.passes)
        self._collector.finish()
        if len(self._collector.passes) > passes:
            self._starts.append(self._start)

    def _compare_state(self, index: int) -> Rebuilt | None:
        data, state = self._states[index]
        channel = self._channels["compensator_state"]
        if state is None:
            channel.recorded(0, data, refused=True)
            return None
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

    def _when(self, index: int) -> tuple[int, int]:
        """Return number and end stamp of the pass before a state; it sorts the first differences of the topics."""
        first, state = self._states[0].state, self._states[index].state
        if index == 0 or first is None or state is None or state.passes <= first.passes:
            return 0, 0
        return state.passes - first.passes - 1, self._end_ns

    def _compare_references(self, rebuilt: list[Rebuilt | None]) -> None:
        """Compare each reference with that of its state, and each joint trajectory with its reference."""
        channel, joints = self._channels["reference_trajectory"], self._channels.get("joint_trajectory")
        pairs = self._pairs()
        for number, (data, known) in enumerate(self._references):
            if known is None:
                channel.recorded(0, data, refused=True)
                continue
            index = pairs.get(number)
            made = None if index is None else rebuilt[index]
            if index is not None and made is not None:
                when, stamp = self._when(index)
                channel.expected(stamp, made.compensator.reference, number=when)
                channel.recorded(stamp, data, number=when)
            else:
                channel.take(data)
                if index is None and number > 0:
                    self._stop(None, "a reference trajectory was published without its compensator_state")
            if joints is not None:
                joints.expected(0, joint_program(self.cell, trajectory_from_bytes(data, as_sent=True)))
        for index, made in enumerate(rebuilt[:-1]):  # a recorder may stop between the last state and its reference
            if made is not None and index not in pairs.values():
                when, stamp = self._when(index)
                channel.expected(stamp, made.compensator.reference, number=when)

    def _pairs(self) -> dict[int, int]:
        """Return the state of each reference: by the fingerprint in the state, else in their order."""
        left = [index for index, message in enumerate(self._states) if message.state is not None]
        pairs = {}
        for number, reference in enumerate(self._references):
            for index in left:
                stated = self._states[index].state
                if stated is not None and reference.fingerprint == stated.reference:
                    pairs[number] = index
                    left.remove(index)
                    break
        others = [n for n, r in enumerate(self._references) if r.fingerprint is not None and n not in pairs]
        return pairs | dict(zip(others, left, strict=False))

    # --- recompute of a state ---

    def _rebuild(self, stated: CompensatorState, index: int) -> Rebuilt:
        """Return the compensator that follows from the stated passes; raises MillingError where one is missing."""
        target = self._targets.get(stated.target)
        if target is None:
            raise MissingPass("", f"the target trajectory {stated.target} of the compensator is not in the recording")
        before = {one.fingerprint for _, state in self._states[:index] if state for one in state.learned}
        here = [index > 0 and one.fingerprint not in before for one in stated.learned]
        passes = [self._learned(one, new) for one, new in zip(stated.learned, here, strict=True)]
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

    def _learned(self, stated: LearnedPass, new: bool) -> tuple[LearnedPass, PassRecord]:
        """Return a pass as this recording or an earlier one has it; new: no state before this one names the pass."""
        if stated.fingerprint not in self._records:
            received, plant, number = self._received(stated, new)
            record = received.record(self.cell, plant, number)
            self._records[stated.fingerprint] = received.as_learned(stated.recording), record
        return self._records[stated.fingerprint]

    def _received(self, stated: LearnedPass, new: bool) -> tuple[ReceivedPass, Cell | None, int]:
        path, _ = self._place
        if not new and stated.recording != f"{path.parent.name}/{path.name}":
            earlier = self._earlier.setdefault(self._end_ns, EarlierRecordings(*self._place, self._end_ns))
            return earlier.find(stated)
        passes = {
            number: received.until_wrench(stated.wrenches)
            for number, received in enumerate(self._collector.passes)
            if number not in self._claimed
        }
        same = (number for number, received in passes.items() if received.fingerprint == stated.fingerprint)
        number = next(same, next(iter(passes), None))
        if number is None:
            raise MissingPass(stated.recording, "the reference trajectory follows from a pass that was not recorded")
        self._claimed.add(number)
        received = passes[number]
        there = received.pose_ns.size, received.wrench_ns.size
        if there != (stated.poses, stated.wrenches):
            reason = (
                f"the compensator received {stated.poses} poses and {stated.wrenches} wrenches of a pass, of which "
            )
            raise MissingPass(stated.recording, reason + "the recording has {} and {}".format(*there))
        return received, self._plant, number

    # --- the last pass, for another revision ---

    def last_pass(self) -> LastPass | None:
        """Return the last complete pass; None where the recording has none."""
        self._close()
        usable = self._usable()
        if not self._collector.passes or not usable:
            return None
        number = len(self._collector.passes) - 1
        received, (states, references) = self._collector.passes[number], self._starts[number]
        for _, state in self._states:
            for one in () if state is None else state.learned:
                known = received.until_wrench(one.wrenches)
                received = known if known.fingerprint == one.fingerprint else received
        in_force = self._states[max(states, 1) - 1].state if self._states else None
        ran, *later = usable[max(references, 1) - 1 :]
        reference = trajectory_from_bytes(ran.data, as_sent=True)
        return LastPass(received, number, in_force, reference, later[0].data if later else None)

    def revise(self, last: LastPass, method: str | None = None) -> tuple[Compensator, Trajectory]:
        """Return the compensator after the last pass, and its target. Raises MillingError.

        method: default the recorded one. Another method starts from the reference of the pass.
        """
        state = last.state
        target = self._targets.get(state.target) if state is not None else list(self._targets.values())[-1]
        if target is None:
            raise MissingPass("", "the target trajectory of the compensator is not in the recording")
        if state is not None and method in (None, state.method):
            made = copy.copy(self._rebuild(state, 0).compensator)
        else:
            made = compensator(self.cell, target, method)
            if fingerprint(last.reference) != fingerprint(target):
                if method is None and made.repeats:
                    raise MissingPass("", f"{made.method} needs the passes before this one, and no state names them")
                made.resume(last.reference, state is not None and state.finished)
        made.revise(last.received.record(self.cell, self._plant, last.number))
        return made, target
