"""The compensator of a recording: its protocol, fed with the recorded pass, what it publishes compared."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

from kr270_milling.base.errors import MillingError
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.protocols import compensator_protocol
from kr270_milling.compensation.compensator import Compensator
from kr270_milling.compensation.methods import METHODS
from kr270_milling.compensation.protocol import CompensatorProtocol
from kr270_milling.compensation.revision import KnotsError
from kr270_milling.messages.codec import to_bytes, trajectory_from_bytes
from kr270_milling.replay.compare import Channel, difference
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["CompensatorFeed", "Report", "read_report"]


class Report(NamedTuple):
    """What the compensator told of itself in /diagnostics."""

    method: str
    finished: bool


def read_report(values: dict[str, str]) -> Report | None:
    """From the keys and values of a diagnostic status; None where it is not the compensator's."""
    method, finished = values.get("method", ""), values.get("finished")
    return Report(method, finished == "True") if method in METHODS and finished in ("True", "False") else None


class CompensatorFeed:
    """tool_pose and wrench of a pass in; the revised reference_trajectory and joint_trajectory compared.

    The first reference in the recording is what was run. Whether an earlier pass made it is told by the reports:
    the first in the file (``opening``) and the latest before the pass came to its end. The wrench that answers the
    last pose may have come before the live revision or not in time: both revisions are tried.
    """

    def __init__(self, cell: Cell, plant: Cell, channels: dict[str, Channel], stop, opening: Report | None):
        self.protocol = compensator_protocol(cell, None if plant is cell else plant)
        self.target = cell.target()
        self.report: Report | None = None
        self.on_pass: Callable[[CompensatorFeed, bytes | None], None] = lambda feed, published: None
        self.revisions: list[CompensatorProtocol] = []  #: of a complete pass, the likely one first
        self.known = False  #: whether the state is the node's, and not made up from reports
        self._channels = channels
        self._stop = stop
        self._opening = opening or Report(cell.compensation.method, False)
        self._published: list[bytes] = []  # references that were recorded and not compared yet
        self._begun = False
        self._without: CompensatorProtocol | None = None  # the protocol as if the last wrench did not come
        self._undecided = False

    @property
    def method(self) -> str:
        """The method that the node used, as it told, or that of the cell."""
        return (self.report or self._opening).method

    def _state(self, ran: Trajectory | None = None, finished: bool = False, method: str | None = None) -> Compensator:
        """A compensator before any pass, or behind unknown passes that led to the reference ``ran``."""
        state = self.protocol.models.compensator(self.target, method or self.method)
        if ran is not None and not _same(state.reference, ran):
            state.resume(ran, finished)
        return state

    def begin(self, data: bytes) -> None:
        """The reference that the first pass runs; where it stands in the file does not matter."""
        run = trajectory_from_bytes(data, as_sent=True)
        state = self._state(run)
        self.known = state.reference is not run
        self.protocol.resume(state)

    @property
    def lacks_passes(self) -> bool:
        """Whether what is run, and what follows from it, comes from passes that are not in this recording."""
        return not self.known and self.protocol.begun.repeats

    def goes_on_from(self, before: CompensatorFeed | None) -> bool:
        """Begin with the state behind an earlier recording, if it leads to what is run here, by this method."""
        if before is None or not before.known:
            return False
        state, run = before.protocol, self.protocol.begun.reference
        if not _same(state.begun.reference, run):
            state.choose(self.method)
        self.known = _same(state.begun.reference, run)
        self.protocol = state if self.known else self.protocol
        return self.known

    def reference(self, data: bytes) -> None:
        """The next recorded reference; the first is the one that is run."""
        if not self._begun:
            self._begun = True
            self._compare_with(data, _first_that_gives(data, self._unrevised()))
            return
        self._published.append(data)
        if self.revisions or not self.protocol.under_way:
            self._compare()

    def new_target(self, target: Trajectory) -> None:
        """A target of the user."""
        self.target = target
        self.known = False

    def sample(self, sample: PoseSample | WrenchSample) -> None:
        """The next tool_pose or wrench, one that can be used."""
        if isinstance(sample, PoseSample) and sample.stamp == 0 and (self.protocol.stamp_ns > 0 or self.revisions):
            self._compare()
        protocol = self.protocol
        if sample.stamp >= protocol.end_ns and protocol.under_way and self._without is None:
            if not self.known:
                self._restore()
            self._without = protocol.twin()
        if isinstance(sample, PoseSample) and self._without is not None:
            self._without.pose(sample)
        try:
            revised = protocol.pose(sample) if isinstance(sample, PoseSample) else protocol.wrench(sample)
        except MillingError as error:
            self._without = None
            self._undecided = False
            self._refused(error)
            return
        if revised:
            self._revised([protocol])

    def finish(self) -> None:
        """No more will come."""
        if self._published or self.protocol.at_end or self.revisions:
            self._compare()

    def revised_by(self, method: str) -> Compensator:
        """What another method makes of the complete pass."""
        before, ran = self.revisions[0].last_pass
        state = self._state(before.reference, before.finished, method)
        state.revise(ran)
        return state

    def _revised(self, revisions: list[CompensatorProtocol]) -> None:
        """The pass is complete: with what the live node may go on."""
        without, self._without = self._without, None
        undecided, self._undecided = self._undecided, False
        try:
            if without is not None and without.finish():
                revisions = [*revisions, without]
        except MillingError as error:
            self._refused(error)
        if not revisions:
            return
        self.revisions = [] if undecided else revisions
        if self._published:
            self._compare()

    def _refused(self, error: MillingError) -> None:
        """No revision is possible: the live node told so, and published none. But with other knots than the target's
        this is not the reference, or not the target, that the live node had."""
        if isinstance(error, KnotsError):
            self._stop(self.protocol.end_ns, str(error))

    def _restore(self) -> None:
        """The state in which the node was before this pass ended, as far as the file tells."""
        protocol, finished = self.protocol, self.report is not None and self.report.finished
        reference = protocol.begun.reference
        protocol.compensator = state = self._state(reference, finished)
        if state.reference is reference and state.repeats and not finished:
            reason = "neither this recording nor one beside it holds the passes before this one"
            self._stop(protocol.end_ns, f"{reason}, from which {self.method} goes on")
            self._undecided = True

    def _compare(self) -> None:
        """The recorded references with those that follow from the pass before, if one is complete.

        Where the recording has a hole in the pass, another reference is no difference: the live node may have had all.
        """
        published, self._published = self._published, []
        if self.protocol.at_end and not self.revisions:  # the last wrench is not in the file
            self._revised([])
        if self.revisions:
            try:
                self.on_pass(self, published[0] if published else None)
            except MillingError as error:  # another method was asked, which cannot revise this pass
                self._stop(self.protocol.end_ns, str(error))
        for data in published:
            found = _first_that_gives(data, self._candidates())
            differs = found is None and any(not r.missing + r.missing_wrenches for r in self.revisions)
            found = self.revisions[0] if differs else found
            self.known = found is not None
            self.protocol = found or self.protocol
            self._compare_with(data, found)
            if found is None or differs:  # what is run next is what was sent, whatever led to it
                sent = trajectory_from_bytes(data, as_sent=True)
                state = self.protocol.begun if self.known else self._state(sent)
                state.reference = sent
                self.protocol.resume(state)
        self.revisions = []

    def _compare_with(self, data: bytes, found: CompensatorProtocol | None) -> None:
        """A recorded reference, and the joint positions that belong to it, with those of a protocol."""
        channel = self._channels["reference_trajectory"]
        if found is None:
            channel.take(data)
        else:
            channel.expected(0, found.begun.reference)
            channel.recorded(0, data)
        self.revisions = []
        if "joint_trajectory" in self._channels:
            program = self.protocol.joint_program(trajectory_from_bytes(data, as_sent=True))
            self._channels["joint_trajectory"].expected(0, program)

    def _candidates(self) -> Iterator[CompensatorProtocol]:
        """States that the node may be in now, the likely one first."""
        yield from self.revisions
        yield from self._unrevised()
        if self.known and not self.revisions and self.protocol.begun.first is not None:
            for method in METHODS:
                other = self.protocol.twin()
                with contextlib.suppress(MillingError):
                    other.choose(method)
                    yield other

    def _unrevised(self) -> Iterator[CompensatorProtocol]:
        """After a new target or a reset."""
        fresh = self.protocol.twin()
        fresh.resume(self._state())
        yield fresh


def _first_that_gives(data: bytes, protocols: Iterator[CompensatorProtocol]) -> CompensatorProtocol | None:
    """The first protocol whose reference has the bits of a recorded one."""
    return next((one for one in protocols if difference(one.begun.reference, data) is None), None)


def _same(one: Trajectory, other: Trajectory) -> bool:
    return difference(one, to_bytes(other)) is None
