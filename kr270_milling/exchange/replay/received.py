"""Passes as the compensator received them: collected from this recording, or read from the recordings it names."""

from __future__ import annotations

import bisect
import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from kr270_milling.base.errors import MillingError
from kr270_milling.base.samples import LearnedRecording, PoseSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.exchange.inbox import PassInbox, ReceivedPass
from kr270_milling.exchange.replay.attached import attached_cell, attached_plant
from kr270_milling.exchange.replay.inputs import INPUTS
from kr270_milling.recordings.bag.gaps import PassStarts
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of

__all__ = ["EarlierRecordings", "NotRecorded", "PassCollector"]

TOPICS = ("tool_pose", "wrench")


class NotRecorded(MillingError):
    """A pass that the compensator learned from and that cannot be read; recording: the file that holds it."""

    def __init__(self, recording: str, reason: str):
        self.recording = recording
        super().__init__(reason)


class PassCollector:
    """Collects the passes that take ``end_ns``, one after another; starts: of the passes [ns], ascending."""

    def __init__(self, cell: Cell, end_ns: int, starts: Sequence[int]):
        self.inbox = PassInbox(end_ns, cell.exchange.iterations)
        self.passes: list[ReceivedPass] = []
        self.before: list[int] = []  #: of each pass: references that were published before its first pose
        self._before = 0
        self._starts = starts
        self._clock = cell.clock

    def sample(self, sample: PoseSample | WrenchSample, references: int = 0) -> None:
        """Take the next pose or wrench that was checked; references: number of those that were published before."""
        passed = bisect.bisect_right(self._starts, sample.stamp)
        start = self._starts[passed - 1] if passed else 0
        time = sample.stamp - start
        if self._starts and not (0 <= time <= self.inbox.end_ns and self._clock.step(time) >= 0):
            return  # of another publisher
        if start != self.inbox.start_ns:
            self.finish()  # the last wrench of the previous pass is not in the file
            self.inbox.clear()
            self.inbox.start_ns = start
        if isinstance(sample, WrenchSample):
            self.inbox.wrench(sample)
        else:
            if sample.stamp == start and self.inbox.stamp_ns > 0:
                self.finish()
            self.inbox.pose(sample)
        if self.inbox.complete:
            self.finish()
        if isinstance(sample, PoseSample) and sample.stamp == start:
            self._before = references

    def finish(self) -> None:
        """Close a pass that lacks nothing but its last wrench."""
        if self.inbox.at_end:
            self.passes.append(self.inbox.received())
            self.before.append(self._before)
            self.inbox.clear()


class EarlierRecordings:
    """The passes in the recordings that a compensator names; a recording is read when a pass of it is needed."""

    def __init__(self, end_ns: int, path: Path, namespace: str, remap: Mapping[str, str]):
        self._remap = remap
        self._path = path
        self._namespace = namespace
        self._end_ns = end_ns
        self._read: dict[Path, tuple[Cell | None, list[ReceivedPass]]] = {}  # file -> plant, passes

    def find(self, stated: LearnedRecording) -> tuple[ReceivedPass, Cell | None, int]:
        """Return a pass, the plant that ran it and its number in its file; raises NotRecorded."""
        name = stated.recording
        file = self._file(name)
        if file is None:
            reason = f"{name} is missing" if name else "a pass was not recorded"
            raise NotRecorded(name, f"{reason}, and the reference trajectory follows from it")
        if file not in self._read:
            self._read[file] = self._passes_of(file)
        plant, passes = self._read[file]
        for number, received in enumerate(passes):
            learned = received.until_wrench(stated.wrenches)
            if learned.fingerprint == stated.fingerprint:
                return learned, plant, number
        raise NotRecorded(name, f"{file}: does not hold the pass that the reference trajectory follows from")

    def _file(self, name: str) -> Path | None:
        """Return the file in a neighbouring directory, or in the directory of this recording."""
        parts = PurePosixPath(name).parts[-2:]
        if not name or ".." in parts or not all(part.isprintable() for part in parts):
            return None
        folder = self._path.parent
        files = [folder.parent.joinpath(*parts), folder / parts[-1]]
        with contextlib.suppress(OSError):
            return next((file for file in files if file.is_file() and file != self._path), None)
        return None

    def _passes_of(self, file: Path) -> tuple[Cell | None, list[ReceivedPass]]:
        names = {f"{self._namespace}/{name}": name for name in TOPICS}
        with Recording(file, remap=self._remap) as recording:
            cell = attached_cell(recording)
            plant = attached_plant(recording, cell)
            starts = PassStarts()
            topic = f"{self._namespace}/reference_trajectory"
            for message in recording.messages({topic}):
                starts.take(topic, stamp_of(message.data))
            collector = PassCollector(cell, self._end_ns, starts.of(topic))
            for message in recording.messages(set(names)):
                with contextlib.suppress(MillingError):  # refused by the live node as well
                    collector.sample(INPUTS[names[message.topic]](message.data))
            collector.finish()
        return None if plant is cell else plant, collector.passes
