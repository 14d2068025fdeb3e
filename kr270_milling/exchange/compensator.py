"""Protocol of the compensator: poses and wrenches of a pass in, revised trajectory out."""

from __future__ import annotations

import copy
import hashlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import CompensatorState, JointProgram, LearnedPass, PoseSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints, compensator, pass_record
from kr270_milling.exchange.inputs import Output, checked_pose, checked_wrench, in_workpiece_axes
from kr270_milling.exchange.joint_program import joint_program
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.physics.motion.exchange import Clock

__all__ = ["CompensatorProtocol", "PassInbox", "ReceivedPass", "end_of"]

START_TOLERANCE = 0.5e-3  #: [m], from the first point of the reference, in which a robot with another clock waits
SEEK_NS = 1_000_000_000  # within this time of the pass, a pose beyond the tolerance must follow
MOST_EARLY = 2000  # poses and wrenches before the start is known
LAG_ROUNDS = 3


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
        """Number of poses that are missing, where poses come at one period."""
        return _missing(self.pose_ns)

    def until_wrench(self, count: int) -> ReceivedPass:
        """Return the pass with its first ``count`` wrenches only."""
        return ReceivedPass(self.pose_ns, self.position, self.wrench_ns[:count], self.wrench[:count])

    def as_learned(self, recording: str) -> LearnedPass:
        """Return what the compensator publishes of a pass; recording: its file."""
        return LearnedPass(recording, self.fingerprint, self.pose_ns.size, self.wrench_ns.size)

    def record(self, cell: Cell, plant: Cell | None, number: int) -> PassRecord:
        """Return the record for a revision: wrenches interpolated to the stamps of the poses, 0 where none came.

        plant: the simulated plant; the noise of its tracker in pass ``number`` is added to the poses.
        """
        wrench = np.zeros((self.pose_ns.size, 6))
        if self.wrench_ns.size:
            wrench = np.column_stack([np.interp(self.pose_ns, self.wrench_ns, axis) for axis in self.wrench.T])
        tracker = None if plant is None else plant.imperfections
        return pass_record(cell, self.pose_ns, self.position, wrench, tracker, number)


class PassInbox:
    """Collects poses and wrenches of one pass that starts at the stamp ``start_ns`` and takes ``end_ns``.

    All other times are those of the pass, counted from its start. A pass is complete when pose and wrench have
    reached the end, each as often as the exchange is iterated.

    A robot with another clock starts when its tool leaves the first point of ``reference`` along the reference; then
    ``start_ns`` becomes a stamp of this clock. ``clock`` recognises the stamps of the simulated robot.
    """

    def __init__(
        self, end_ns: int, iterations: int, start_ns: int = 0, reference: Trajectory | None = None,
        clock: Clock | None = None,
    ):  # fmt: skip
        self.end_ns = end_ns
        self.start_ns = start_ns
        self._reference = reference
        self._clock = clock
        self._iterations = iterations
        self.clear()

    def clear(self, wrenches: dict[int, WrenchSample] | None = None) -> None:
        """Await the next pass; wrenches: those of this pass that came before its first pose."""
        self._poses: dict[int, PoseSample] = {}  # by their stamps, ascending
        self._wrenches: dict[int, WrenchSample] = dict(wrenches or {})
        self._early: dict[int, WrenchSample] = {}
        self._ignored = 0
        self.foreign = False  #: the pass of a robot with another clock
        self.distance = 0.0  #: [m], of the tool of such a robot from the first point of the reference
        self.gap_ns = 0  #: longest time between two poses
        self._at_start: deque[PoseSample] = deque(maxlen=MOST_EARLY)
        self._before: deque[WrenchSample] = deque(maxlen=MOST_EARLY)
        self._last_poses = self._last_wrenches = self._iterations

    @property
    def started(self) -> bool:
        """Whether a pose of the pass was received."""
        return bool(self._poses)

    @property
    def at_end(self) -> bool:
        """Whether the pass lacks nothing but its last wrench."""
        return self.started and self._last_poses <= 0

    @property
    def complete(self) -> bool:
        """Whether all messages of the pass have come."""
        return self.at_end and self._last_wrenches <= 0

    @property
    def stamp_ns(self) -> int:
        """Time of the last pose that counts."""
        return next(reversed(self._poses), 0)

    @property
    def ignored(self) -> int:
        """Number of poses of a pass whose start was not received."""
        return 0 if self._poses else self._ignored

    @property
    def has_wrench(self) -> bool:
        """Whether a wrench of the pass was received."""
        return bool(self._wrenches)

    def pose(self, sample: PoseSample) -> None:
        """Take a pose that was checked."""
        time = sample.stamp - self.start_ns
        if time == 0 and list(self._poses) != [0]:  # a later start begins another pass
            self.clear(self._early)
        last = next(reversed(self._poses), -1)
        unstarted = last < 0 and time != 0
        if unstarted and self._reference is not None and self._is_foreign(time):
            self._seek_start(self._reference, sample)
            return
        if time != last and (time < last or last >= self.end_ns or unstarted):
            self._ignored += 1  # older than the last one, after the end, or without the start
            return
        self.gap_ns = max(self.gap_ns, time - last if last >= 0 else 0)
        self._poses[time] = sample  # repeated where the exchange is iterated, or the robot asked again
        self._last_poses -= time >= self.end_ns

    def _is_foreign(self, time: int) -> bool:
        """Whether a time is none of the simulated robot."""
        if self._clock is None:
            return False
        return not 0 <= time <= self.end_ns or self._clock.step(time) < 0

    def _seek_start(self, reference: Trajectory, sample: PoseSample) -> None:
        """Begin the pass with the first pose that has left the first point along the reference."""
        self._ignored += 1
        self.distance = float(np.linalg.norm(sample.position - reference.position[0]))
        if self.distance <= START_TOLERANCE:
            self._at_start.append(sample)
            return
        waited, self._at_start = self._at_start, deque(maxlen=MOST_EARLY)
        if not waited:
            return
        times = np.arange(0, min(SEEK_NS, self.end_ns) + 1, SEEK_NS // 1000)
        off = np.linalg.norm(reference.sample(times) - sample.position, axis=1)
        nearest = int(np.argmin(off))
        if off[nearest] > START_TOLERANCE:
            return
        early = list(self._before)
        self.clear()
        self.foreign = True
        self._last_poses = self._last_wrenches = 1
        self.start_ns = sample.stamp - int(times[nearest])
        for pose in (*waited, sample):
            if pose.stamp >= self.start_ns:
                self._poses[pose.stamp - self.start_ns] = pose
        for one in early:
            self.wrench(one)

    def wrench(self, sample: WrenchSample) -> None:
        """Take a wrench that was checked."""
        if self.foreign:
            time = sample.stamp - self.start_ns
            if time >= 0 and self._last_wrenches > 0:
                self._wrenches[time] = sample
                self._last_wrenches -= time >= self.end_ns
            return
        if self._reference is not None:
            self._before.append(sample)
        time = sample.stamp - self.start_ns
        if time == 0 and list(self._poses) != [0]:
            self._early = {0: sample}  # it may overtake the pose that it answers
        elif self._poses:
            self._wrenches[time] = sample
            self._last_wrenches -= time >= self.end_ns

    def received(self) -> ReceivedPass:
        """Return what has come; the wrenches of a tool frame are turned by the pose before them."""
        stamps, poses = np.array(list(self._poses), np.int64), list(self._poses.values())
        times = np.array(sorted(self._wrenches), np.int64)
        nearest = np.maximum(np.searchsorted(stamps, times, side="right") - 1, 0).tolist()
        samples = [self._wrenches[stamp] for stamp in times.tolist()]
        turned = [in_workpiece_axes(s, poses[k].quaternion) for s, k in zip(samples, nearest, strict=True)]
        position = np.array([pose.position for pose in poses], float).reshape(-1, 3)
        if self.foreign and self._reference is not None:
            late = lag(self._reference, stamps, position)
            stamps, times = stamps - late, times - late
        return ReceivedPass(stamps, position, times, np.array(turned, float).reshape(-1, 6))


def lag(reference: Trajectory, time_ns: np.ndarray, position: np.ndarray) -> int:
    """Return the delay [ns] of poses (n, 3) [m] along a reference: least squares of v (p - r) + v^2 dt."""
    delay = 0
    for _ in range(LAG_ROUNDS):
        velocity = reference.sample_velocity(time_ns - delay)
        behind = np.sum(velocity * (position - reference.sample(time_ns - delay)))
        delay -= round(1e9 * behind / max(np.sum(velocity**2), 1e-12))
    return delay


class CompensatorProtocol:
    """tool_pose and wrench in; compensator_state and reference_trajectory out; joint_trajectory on request.

    plant: the cell that is simulated in the place of a real one, with its tracker; name: of the node; now: the
    time [ns] of its clock. The reference states the start of its pass: now, or the end of the last pass where that is
    later.
    ``finish`` completes a pass without its last wrench. A refused message leaves the state unchanged.
    """

    def __init__(
        self, cell: Cell, plant: Cell | None = None, name: str = "trajectory_compensator",
        now: Callable[[], int] = lambda: 0,
    ):  # fmt: skip
        self.cell = cell
        self.plant = plant
        self.name = name
        self.recording = ""  #: file that the passes are recorded to, as the recorder publishes it
        self.compensator: Compensator | None = None
        self.passes = 0  #: completed passes
        self.missing = 0  #: poses that the last completed pass lacks
        self.inbox = PassInbox(0, cell.exchange.iterations)
        self._now = now
        self._free_ns = 0  # stamp after the end of the last pass
        self._learned: tuple[LearnedPass, ...] = ()  # the passes that the reference follows from
        self._first: tuple[LearnedPass, ...] = ()  # the pass along the target

    @property
    def active(self) -> Compensator:
        """The compensator; raises MessageError before there is a target."""
        if self.compensator is None:
            raise MessageError("there is no target trajectory yet")
        return self.compensator

    @property
    def under_way(self) -> bool:
        """Whether the start of a pass was received and its end is not revised yet."""
        return self.compensator is not None and self.inbox.started

    @property
    def at_end(self) -> bool:
        """Whether the pass lacks nothing but its last wrench."""
        return self.under_way and self.inbox.at_end

    def begin(self, target: Trajectory) -> list[Output]:
        """Continue along another target; raises MillingError where it is refused."""
        outputs = self._continue(compensator(self.cell, target), ())
        self._first = ()
        return outputs

    def choose(self, method: str) -> list[Output]:
        """Choose another method; it starts from the pass along the target if there was one."""
        made = copy.copy(self.active)  # a refused choice leaves the present one unchanged
        made.choose(method)
        return self._continue(made, self._first)

    def reset(self) -> list[Output]:
        """Return to the target itself."""
        made = copy.copy(self.active)
        made.reset()
        return self._continue(made, ())

    def restart(self) -> list[Output]:
        """Begin the pass anew, with another start."""
        return self._continue(self.active, self._learned)

    def pose(self, sample: PoseSample) -> list[Output]:
        """Take a pose; raises MessageError, and the errors of a revision."""
        checked_pose(sample)
        if self.compensator is None:
            return []
        self.inbox.pose(sample)
        if self.inbox.started and not self.inbox.foreign:
            self._free_ns = self.inbox.start_ns + self.inbox.end_ns + round(self.cell.clock.period * 1e9)
        return self._revise() if self.inbox.complete else []

    def wrench(self, sample: WrenchSample) -> list[Output]:
        """Take a wrench; raises MessageError, and the errors of a revision."""
        checked_wrench(sample)
        if self.compensator is None:
            return []
        self.inbox.wrench(sample)
        return self._revise() if self.inbox.complete else []

    def finish(self) -> list[Output]:
        """Revise without the last wrench if the pass lacks nothing else."""
        return self._revise() if self.at_end else []

    def program(self, joints: np.ndarray, stamp_ns: int) -> JointProgram:
        """Return the reference for a joint controller, see ``joint_program``; joints (6,) [rad]: of the robot.

        Raises MessageError in mid-pass and before there is a target, and the errors of ``joint_program``.
        """
        reference = self.active.reference
        if self.under_way:
            raise MessageError("a pass is under way: the robot moves")
        return joint_program(self.cell, reference, joints, stamp_ns)

    def _revise(self) -> list[Output]:
        received = self.inbox.received()
        number = self.passes
        self.passes += 1
        self.missing = received.missing
        self.inbox.clear()  # the pass is over, also if its revision fails
        made = copy.copy(self.active)
        first = made.reference is made.target and not made.errors
        made.revise(received.record(self.cell, self.plant, number))
        learned = received.as_learned(self.recording)
        outputs = self._continue(made, (*self._learned, learned))
        if first:
            self._first = (learned,)
        return outputs

    def _continue(self, made: Compensator, learned: tuple[LearnedPass, ...]) -> list[Output]:
        """Return the outputs of a new state; an error comes before anything has changed."""
        commanded_joints(self.cell, made.reference)  # raises where no arm can run the reference
        self.compensator, self._learned = made, learned
        start = max(self._now(), self._free_ns)
        end, iterations = end_of(self.cell, made.reference), self.cell.exchange.iterations
        self.inbox = PassInbox(end, iterations, start, made.reference, self.cell.clock)
        state = CompensatorState(
            self.name, made.method, self.passes, made.finished, fingerprint(made.target), fingerprint(made.reference),
            learned,
        )  # fmt: skip
        return [("compensator_state", state), ("reference_trajectory", made.reference.starting_at(start))]


def end_of(cell: Cell, reference: Trajectory) -> int:
    """Return the stamp [ns] of the last exchange of a pass along a reference."""
    return int(cell.clock.stamp(cell.clock.steps(reference.duration_ns)))


def _missing(stamps: np.ndarray) -> int:
    """Number of messages that are missing in a pass, where they come at one period."""
    if stamps.size < 2:
        return 0
    steps = np.diff(stamps) / np.median(np.diff(stamps))
    return int(np.sum(np.rint(steps) - 1)) if np.max(np.abs(steps - np.rint(steps))) < 0.25 else 0
