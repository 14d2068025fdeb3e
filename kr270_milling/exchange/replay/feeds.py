"""Robot and cut of a recording: the nodes' protocols, fed with what was recorded, their outputs compared."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterable, Sequence

from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.path import MOST_STEPS
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.inputs import Output
from kr270_milling.exchange.replay.compare import Channel
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.bag.stamps import PassCounter

__all__ = ["CutFeed", "RobotFeed"]

MID_PASS = "the recording begins in the middle of a pass, whose state is not known"

Stop = Callable[[int, str], None]  # (stamp [ns], reason)


class InputFeed:
    """Base of robot and cut: the comparison of outputs, and the first input that is not in the recording."""

    outputs: tuple[str, ...] = ()

    def __init__(self, cell: Cell, channels: dict[str, Channel], stop: Stop, starts: Sequence[int] = ()):
        self.cell = cell
        self._channels = channels
        self._stop = stop
        self._passes = PassCounter(starts)
        self._lack: tuple[int, str] | None = None  # the stamp [ns] and the reason of a stop

    def _publish(self, outputs: Iterable[Output]) -> None:
        for name, record in outputs:
            if name in self._channels:
                stamp = getattr(record, "stamp", 0)
                self._channels[name].expected(stamp, record, self._is_due(name, stamp))

    def _is_due(self, name: str, stamp: int) -> bool:
        """Whether the live node publishes an output at this time."""
        return True

    def end_pass(self, number: int | None = None) -> None:
        """Report a missing input if recorded outputs follow from it; else the live node missed it too.

        number: of the pass that begins.
        """
        channels = [self._channels[name] for name in self.outputs if name in self._channels]
        if self._lack is not None and any(channel.waiting for channel in channels):
            self._stop(*self._lack)
            for channel in channels:
                channel.abandon(number)
        self._lack = None


class RobotFeed(InputFeed):
    """reference_trajectory and wrench in; tool_pose, deflection, joint_states and clock compared.

    Every deflection is computed, whatever ``publish.every`` says, so those that were recorded more often are compared
    too. joint_states must be those of ``publish.every``: the joint positions of a pass are made for all published
    stamps at once, and behind a whole turn of a joint their last bit depends on which stamps these are
    (``numpy.unwrap`` adds up rounded steps).
    """

    outputs = ("tool_pose", "deflection", "joint_states", "clock")

    def __init__(self, cell: Cell, channels: dict[str, Channel], stop: Stop, starts: Sequence[int] = ()):
        super().__init__(cell, channels, stop, starts)
        self.protocol = RobotProtocol(cell, deflection_every=1)
        self._begun = False
        self._same_stamp: list[WrenchSample] = []

    def reference(self, run: Trajectory) -> None:
        """Take the reference of the next pass. Raises ValueError for an implausibly long one."""
        if self.cell.clock.steps(run.duration_ns) > MOST_STEPS:
            raise ValueError(f"the reference trajectory takes {run.duration_ns * 1e-9:g} s")
        self.protocol.reference = run

    def _is_due(self, name: str, stamp: int) -> bool:
        step = self.cell.clock.step(stamp - self.protocol.start_ns)
        return name != "deflection" or step % self.cell.thinned_steps == 0

    def description(self) -> None:
        """Compare the recorded description."""
        self._publish(self.protocol.describe())

    def wrench(self, sample: WrenchSample) -> None:
        """Take the next wrench; the wrenches of one stamp are processed together."""
        if self._same_stamp and self._same_stamp[0].stamp != sample.stamp:
            self._flush()
        self._same_stamp.append(sample)
        if self.cell.exchange.iterations == 1:
            self._flush()

    def finish(self) -> None:
        """Complete the comparison after the last message."""
        self._flush()
        self.end_pass()

    def _flush(self) -> None:
        """Take the wrenches of one stamp.

        More equal wrenches than iterations show that the robot repeated its question; the file does not show when.
        """
        samples, self._same_stamp = self._same_stamp, []
        surplus = len(samples) - self.cell.exchange.iterations
        same = [one.frame == other.frame and one.wrench.tobytes() == other.wrench.tobytes()
                for one, other in zip(samples, samples[1:], strict=False)]  # fmt: skip
        same.append(False)
        for i, sample in enumerate(samples):
            asked_again = 0
            while asked_again < surplus and same[i + asked_again]:
                asked_again += 1
            surplus -= asked_again
            self._take(sample, asked_again)

    def _take(self, sample: WrenchSample, asked_again: int) -> None:
        if self._passes.begins(sample.stamp) or not self._begun:
            self._begin(sample.stamp)
        protocol = self.protocol
        if not protocol.started or protocol.done:
            return
        if sample.stamp > protocol.awaited_ns and self._lack is None:
            self._lack = protocol.awaited_ns, "the wrench of this time is not in the recording"
        elif sample.stamp == protocol.awaited_ns:
            self._lack = None
            for _ in range(asked_again):
                self._publish(protocol.repeat())
        self._publish(protocol.wrench(sample))

    def _begin(self, stamp: int) -> None:
        self.end_pass(self._passes.index)
        self._begun = True
        self.protocol.stop()
        if self.protocol.reference is None:
            self._stop(stamp, "no reference trajectory is in the recording")
        elif stamp != self.protocol.reference.start_ns:
            self._lack = stamp, MID_PASS
            self._stop(*self._lack)
        else:
            self._publish(self.protocol.start())


class CutFeed(InputFeed):
    """tool_pose in; wrench and workpiece compared."""

    outputs = ("wrench",)

    def __init__(self, cell: Cell, channels: dict[str, Channel], stop: Stop, starts: Sequence[int] = ()):
        super().__init__(cell, channels, stop, starts)
        self.protocol = CutProtocol(cell)
        ((_, self._fresh),) = self.protocol.configure()
        self._start_ns = 0
        self._maps: list[tuple[int, bytes]] = []  # whose poses have not come, by their stamps
        self._latched = False  # the last map is that of a pass before the recording

    def reference(self, run: Trajectory) -> None:
        """Take the reference of the next pass."""
        self._start_ns = run.start_ns
        self.protocol.reference(run)

    def pose(self, sample: PoseSample) -> None:
        """The next tool_pose; raises MillingError where the protocol refuses it."""
        if self._passes.begins(sample.stamp):
            self.end_pass(self._passes.index)
            self.protocol.configure()
        time = self._time(sample.stamp)
        if self._latched and time == 0:
            self._latched = False
            self._channels["workpiece"].expected(0, self._fresh)  # of this pass, which none can begin without
        next_step = self.protocol.step + 1
        if self.cell.clock.step(time) > next_step and self._lack is None:
            lost = "the tool pose of this time is not in the recording"
            self._lack = sample.stamp - time + int(self.cell.clock.stamp(next_step)), lost if next_step else MID_PASS
        self._publish(self.protocol.pose(sample))
        if self.protocol.step == next_step:
            self._lack = None
        self._compare_maps()

    def _time(self, stamp: int) -> int:
        """Return the time of the pass under way, else of the next one; its reference comes before the last map."""
        return stamp - (self.protocol.start_ns if self.protocol.step >= 0 else self._start_ns)

    def workpiece(self, stamp: int, data: bytes) -> None:
        """Compare a recorded map: the fresh part at stamp 0, else the part after the last pose that was answered.

        In the file the map may come before or after this pose: a recorder that was busy takes topic by topic. A map
        after its pose is not compared, and neither is any map where poses are missing. The first map may be latched
        from an earlier pass.
        """
        channel = self._channels["workpiece"]
        in_pass = self.protocol.step >= 0 and self.cell.clock.step(self._time(stamp)) >= 0
        if stamp == 0:
            self._latched = False
            channel.expected(0, self._fresh)
            channel.recorded(0, data)
        elif in_pass and stamp >= self.protocol.stamp_ns:
            bisect.insort(self._maps, (stamp, data))
            self._compare_maps()
        elif self.protocol.step < 0 and channel.count == 0:
            self._latched = True
            channel.take(data)
        elif self._lack is not None or in_pass:
            channel.take(data)
        else:
            channel.recorded(stamp, data)

    def _compare_maps(self) -> None:
        while self._maps and self._maps[0][0] <= self.protocol.stamp_ns:
            stamp, data = self._maps.pop(0)
            if stamp == self.protocol.stamp_ns and self._lack is None:
                self._publish(self.protocol.workpiece())
                self._channels["workpiece"].recorded(stamp, data)
            else:
                self._channels["workpiece"].take(data)

    def finish(self) -> None:
        """Complete the comparison after the last message."""
        self.end_pass()
        for _, data in self._maps:
            self._channels["workpiece"].take(data)
