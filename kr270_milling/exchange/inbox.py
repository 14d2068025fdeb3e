"""Poses and wrenches of one pass, from its start to its end, as the compensator receives them.

The pass of a robot with another clock starts when its tool leaves the first point, or its own message states the start.
"""

from __future__ import annotations

import hashlib
from collections import deque
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import MessageError
from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import LearnedRecording, PoseSample, WrenchSample
from kr270_milling.cell.jobs import pass_record
from kr270_milling.cell.paths import CellPath
from kr270_milling.exchange.inputs import WrenchFrames
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.periods import Clock

PositionQuaternion = tuple[np.ndarray, np.ndarray]
FrameWrench = tuple[str, np.ndarray]
GAP_NS = 100_000_000  # longest time between two messages of a pass without a report
BREAK_NS = 2_000_000_000  #: without progress, after which a pass is over; assumed: longer than any lag of a controller
FAR = 5e-3  # [m], from the reference; far above the deflection of an arm


@dataclass(frozen=True, eq=False)
class ReceivedPass:
    """Poses and wrenches of one pass in workpiece axes; a repeated stamp keeps its last message."""

    pose_ns: np.ndarray  #: stamps [ns], (n,), ascending
    position: np.ndarray  #: tool centre [m], (n, 3)
    wrench_ns: np.ndarray  #: stamps [ns], (m,), ascending
    wrench: np.ndarray  #: [N, N m], (m, 6)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all arrays, hexadecimal."""
        arrays = (self.pose_ns, self.position, self.wrench_ns, self.wrench)
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

    @property
    def missing(self) -> int:
        """Number of poses that are missing, by the median of the times between two poses."""
        steps = np.diff(self.pose_ns)
        return int(np.sum(np.maximum(np.rint(steps / np.median(steps)) - 1, 0))) if steps.size else 0

    def as_learned(self, recording: str) -> LearnedRecording:
        """Return what the compensator publishes of a pass; recording: its file."""
        return LearnedRecording(recording, self.fingerprint, self.pose_ns.size, self.wrench_ns.size)

    def record(self, path: CellPath, assumed: Imperfections, plant: Imperfections | None, number: int) -> PassRecord:
        """Return the record for a revision: wrenches interpolated to the stamps of the poses, 0 where none came.

        assumed: imperfections of the cell; plant: those of the simulated plant; the noise of its tracker in pass
        ``number`` is added to the poses.
        """
        wrench = interpolated(self.pose_ns, self.wrench_ns, self.wrench)
        return pass_record(path, assumed, self.pose_ns, self.position, wrench, plant, number)


class PassInbox:
    """Collects poses and wrenches of one pass along a reference, which starts at the stamp ``start_ns``.

    All other times are those of the pass, counted from its start. A pass is complete when pose and wrench have
    reached the end, each as often as the exchange is iterated.

    A robot with another clock starts when its tool leaves the first point along the reference, or with ``begin`` where
    its start is ``announced``; then ``start_ns`` becomes a stamp of this clock.
    """

    def __init__(
        self,
        clock: Clock,
        frames: WrenchFrames,
        reference: Trajectory,
        start_ns: int = 0,
        announced: bool = False,
        iterations: int = 1,
    ):
        self._clock = clock  # recognises the stamps of the simulated robot
        self.end_ns = int(self._clock.stamp(self._clock.steps(reference.duration_ns)))
        self.start_ns = self._planned_ns = start_ns
        self.foreign = False  #: the pass of a robot with another clock
        self.problem = ""  #: sentence on messages that do not fit; the caller clears it
        self.frames = frames
        self._reference = reference
        self._announced = announced
        self._iterations = iterations
        self.clear()

    def clear(self) -> None:
        """Await the next pass."""
        # plain tuples: a collection of garbage visits every NamedTuple, of which a pass of minutes has a million
        self._poses: dict[int, PositionQuaternion] = {}  # by their stamps, ascending
        self.wrenches: dict[int, FrameWrench] = {}  #: of the pass, by their stamps
        self._early: list[WrenchSample] = []  # those that came before the first pose of the pass
        self.ignored = 0  #: poses of a pass whose start was not received
        self.start_ns, self.foreign = self._planned_ns if self.foreign else self.start_ns, False
        self._distance: float | None = None
        self._waiting: deque[PoseSample] = deque(maxlen=2000)  # poses of a robot with another clock before the start
        self._before: deque[WrenchSample] = deque(maxlen=2000)
        self._standing: list[WrenchSample] = []  # wrenches before the start
        self._near_ns = 0  # time of the last pose near the reference
        self._gap_ns = GAP_NS  # longest time between two messages that was reported
        self._last_poses = self._last_wrenches = self._iterations

    @property
    def distance(self) -> float | None:
        """Distance [m] of a tool that waits from the first point of the reference; None where no such tool is known."""
        return None if self.started else self._distance

    @property
    def started(self) -> bool:
        """Return whether the start of the pass was received."""
        return self.foreign or bool(self._poses)

    @property
    def at_end(self) -> bool:
        """Return whether the pass lacks nothing but its last wrench."""
        return self.started and self._last_poses <= 0

    @property
    def complete(self) -> bool:
        """Return whether all messages of the pass have come."""
        return self.at_end and self._last_wrenches <= 0

    @property
    def stamp_ns(self) -> int:
        """Time of the last pose that counts."""
        return next(reversed(self._poses), 0)

    def pose(self, sample: PoseSample) -> None:
        """Take a pose that was checked."""
        time = sample.stamp - self.start_ns
        if self.foreign:
            self._foreign_pose(time, sample)
            return
        last, early = next(reversed(self._poses), -1), []
        if self._is_foreign(time):
            self.ignored += 1
            start = self._start_of(sample) if last < 0 else None
            if start is not None:
                self.begin(start)
            return
        if time == 0 and list(self._poses) != [0]:  # a later start begins another pass
            early, last = self._early, -1
            self.clear()
        unstarted = last < 0 and time != 0
        if time != last and (time < last or last >= self.end_ns or unstarted):
            self.ignored += 1  # older than the last one, after the end, or without the start
            return
        self._check_gap("tool_pose", time, last if last >= 0 else 0)
        # repeated where the exchange is iterated, or the robot asked again
        self._poses[time] = sample.position, sample.quaternion
        self._last_poses -= time >= self.end_ns
        for wrench in early:
            self.wrench(wrench)

    def _is_foreign(self, time: int) -> bool:
        """Return whether a time cannot be a stamp of the simulated robot."""
        return self._announced or not 0 <= time <= self.end_ns or self._clock.step(time) < 0

    def _start_of(self, sample: PoseSample) -> int | None:
        """Take a pose before the start; return the stamp [ns] of the start where the tool has left the first point."""
        # [m], from the first point of the reference, in which a robot with another clock waits
        seek_ns = 1_000_000_000  # within this time of the pass, a pose beyond the tolerance must follow
        start_tolerance = 0.5e-3
        self._distance = float(np.linalg.norm(sample.position - self._reference.position[0]))
        if self._announced or self._distance <= start_tolerance:
            self._waiting.append(sample)
        elif self._waiting:
            times = np.arange(0, min(seek_ns, self._reference.duration_ns) + 1, seek_ns // 1000)
            off = np.linalg.norm(self._reference.sample(times) - sample.position, axis=1)
            nearest = int(np.argmin(off))
            if off[nearest] <= start_tolerance:
                self._waiting.append(sample)
                return sample.stamp - int(times[nearest])
            self._waiting.clear()
        return None

    def begin(self, start_ns: int) -> None:
        """Begin the pass of a robot with another clock at a stamp [ns] of this clock."""
        restarted, waiting, before = self.started, self._waiting, self._before
        self.clear()
        self.problem = "the robot began the pass again" if restarted else self.problem
        self._planned_ns = self.start_ns
        self.foreign, self.start_ns = True, start_ns
        self._last_poses = self._last_wrenches = 1
        first = waiting[0].stamp if waiting else start_ns  # the tool waits for the start from here
        self._standing = [sample for sample in before if first <= sample.stamp < start_ns]
        if self.frames.untared(self._standing):
            self.problem = "no wrench of the force sensor before the start: its offset is not subtracted"
        for pose in waiting:
            if pose.stamp >= start_ns:
                self.pose(pose)
        for wrench in before:
            self.wrench(wrench)

    def _foreign_pose(self, time: int, sample: PoseSample) -> None:
        """Take a pose of a pass of a robot with another clock."""
        last = next(reversed(self._poses), 0)
        if time < last - GAP_NS:
            what = f"{(last - time) * 1e-9:.3f} s before {'the last one' if self._poses else 'the start of the pass'}"
            self.problem = f"tool_pose: the stamp is {what}, so the pose is not used"
        if time < last or last >= self.end_ns:
            return
        if not is_far(self._reference, time, sample.position):
            self._near_ns = max(time, 0)
        if time - last > BREAK_NS:
            self.break_off(f"no tool_pose for {(time - last) * 1e-9:.1f} s", sample)
        elif time - self._near_ns > BREAK_NS:
            self.break_off("the tool does not move, is slow or has left the reference (is the override 100 %?)", sample)
        else:
            self._check_gap("tool_pose", time, last)
            self._poses[time] = sample.position, sample.quaternion
            self._last_poses -= time >= self.end_ns

    def break_off(self, reason: str, sample: PoseSample | None = None) -> None:
        """End the pass without a revision and seek the next start, which may be near this pose."""
        self.clear()
        self.problem = f"{reason}: the pass is over and is not used; the next start begins another pass"
        if sample is not None and not self._announced:
            self.pose(sample)

    def _check_gap(self, topic: str, time: int, last: int) -> None:
        """State a gap that is longer than those before."""
        if time - last > self._gap_ns:
            self._gap_ns = time - last
            self.problem = f"no {topic} for {self._gap_ns * 1e-9:.3f} s of the pass"

    def wrench(self, sample: WrenchSample) -> None:
        """Take a wrench that was checked."""
        if self.foreign:
            time = sample.stamp - self.start_ns
            if time >= 0 and self._last_wrenches > 0:
                self._check_gap("wrench", time, next(reversed(self.wrenches), time))
                self.wrenches[time] = sample.frame, sample.wrench
                self._last_wrenches -= time >= self.end_ns
            return
        self._before.append(sample)
        time = sample.stamp - self.start_ns
        if time == 0 and list(self._poses) != [0]:
            self._early = [sample]  # it may overtake the pose that it answers, and so may those after it
        elif self._poses and not self._is_foreign(time):
            self.wrenches[time] = sample.frame, sample.wrench
            self._last_wrenches -= time >= self.end_ns
        elif self._early and not self._is_foreign(time):
            self._early.append(sample)

    def received(self) -> ReceivedPass:
        """Return what has come; the wrenches of a tool frame are turned by the pose before them.

        Raises MessageError where the poses of a robot with another clock are no pass along the reference.
        """
        stamps, poses = np.array(list(self._poses), np.int64), list(self._poses.values())
        times = np.array(sorted(self.wrenches), np.int64)
        nearest = np.maximum(np.searchsorted(stamps, times, side="right") - 1, 0)
        samples = [self.wrenches[stamp] for stamp in times.tolist()]
        turned = self._at_tip(samples, [poses[k][1] for k in nearest.tolist()])
        position = np.array([place for place, _ in poses], float).reshape(-1, 3)
        if self.foreign:
            if self.wrenches:
                self._check_gap("wrench", self.end_ns, next(reversed(self.wrenches)))
            late = lag(self._reference, stamps, position)
            stamps, times = stamps - late, times - late
            check_follows(self._reference, stamps, position)
        return ReceivedPass(stamps, position, times, turned)

    def _at_tip(self, samples: list[FrameWrench], quaternions: list[np.ndarray]) -> np.ndarray:
        """Return wrenches (n, 6) at the tool tip in workpiece axes; quaternions: of tcp."""
        frames, wrench = [frame for frame, _ in samples], np.array([w for _, w in samples], float).reshape(-1, 6)
        for frame in set(frames) - {WORKPIECE}:
            rows = [row for row, name in enumerate(frames) if name == frame]
            turns = np.array([quaternions[row] for row in rows])
            offset = self.frames.offset(self._standing, next(iter(self._poses.values()))[1])
            wrench[rows] = self.frames.at_tip(frame, wrench[rows], turns, offset)
        return wrench


def interpolated(stamps: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the values (n, columns) at the stamps (n,), linear between the known ones; 0 where none is known."""
    if not known.size:
        return np.zeros((stamps.size, values.shape[1]))
    return np.column_stack([np.interp(stamps, known, column) for column in values.T])


def lag(reference: Trajectory, time_ns: np.ndarray, position: np.ndarray) -> int:
    """Return the delay [ns] of poses (n, 3) [m] along a reference: least squares of v (p - r) + v^2 dt."""
    delay = 0
    for _ in range(3):
        velocity = reference.sample_velocity(time_ns - delay)
        behind = np.sum(velocity * (position - reference.sample(time_ns - delay)))
        delay -= round(1e9 * behind / max(np.sum(velocity**2), 1e-12))
    return delay


def is_far(reference: Trajectory, time_ns: int, position: np.ndarray) -> bool:
    """Return whether a tool at a position (3,) [m] is far from the reference of the last ``BREAK_NS``.

    A robot that lags is near an earlier point; a robot that has stopped is near none when this time has passed.
    """
    if float(np.linalg.norm(position - reference.sample(min(time_ns, reference.duration_ns)))) <= FAR:
        return False
    # every 5 ms: 2 mm at 0.4 m/s
    times = np.linspace(time_ns - BREAK_NS, time_ns, 401).clip(0, reference.duration_ns).astype(np.int64)
    return float(np.linalg.norm(reference.sample(times) - position, axis=1).min()) > FAR


def check_follows(reference: Trajectory, time_ns: np.ndarray, position: np.ndarray) -> None:
    """Raise MessageError where poses (n, 3) [m] at times (n,) [ns] are no pass along the reference."""
    if time_ns.size < 10:
        raise MessageError(f"tool_pose: the pass has only {time_ns.size} poses and is not used")
    off = float(np.linalg.norm(position - reference.sample(time_ns), axis=1).max())
    if off > FAR:
        raise MessageError(
            f"tool_pose: up to {off * 1e3:.1f} mm from the reference, so the pass is not used; is the override 100 %?"
        )
