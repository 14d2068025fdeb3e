"""What the compensator's node does between in and out: poses and wrenches of a pass in, revised trajectory out."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.samples import JointProgram, PoseSample, WrenchSample
from kr270_milling.compensation.compensator import Compensator
from kr270_milling.compensation.revision import PassRecord
from kr270_milling.simulation.exchange import Clock
from kr270_milling.simulation.protocol import (
    JOINT_NAMES,
    MessageError,
    Output,
    checked_pose,
    checked_wrench,
    in_workpiece_axes,
)
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["CompensatorModels", "CompensatorProtocol"]


@dataclass(frozen=True, eq=False)
class CompensatorModels:
    """What the compensator's protocol needs of its cell."""

    clock: Clock
    iterations: int  #: exchanges a period
    compensator: Callable[[Trajectory, str | None], Compensator]  #: target, method -> one without any pass
    pass_record: Callable[[int, np.ndarray, np.ndarray, np.ndarray], PassRecord]  #: number, stamps, positions, wrenches
    joints: Callable[[Trajectory], np.ndarray]  #: [rad], (n, 6), that command the knots


class CompensatorProtocol:
    """tool_pose and wrench in; reference_trajectory and joint_trajectory out.

    A pass is complete when pose and wrench have reached the end of the reference trajectory, each as often as the
    exchange is iterated; ``finish`` completes it without the last wrench. What is refused leaves all as it was.
    """

    def __init__(self, models: CompensatorModels):
        self.models = models
        self.compensator: Compensator | None = None
        self.ran: PassRecord | None = None  #: the last complete pass
        self.ran_by: Compensator | None = None  #: the compensator before it revised after that pass
        self.passes = 0  #: that were complete
        self.missing = 0  #: poses that the last complete pass lacks
        self.missing_wrenches = 0  #: the same of its wrenches
        self._early: dict[int, WrenchSample] = {}
        self._await_pass(0)

    @property
    def begun(self) -> Compensator:
        """The compensator; raises MessageError before there is a target."""
        if self.compensator is None:
            raise MessageError("there is no target trajectory yet")
        return self.compensator

    @property
    def last_pass(self) -> tuple[Compensator, PassRecord]:
        """What revised, and what it revised from; raises MessageError before a pass is complete."""
        if self.ran_by is None or self.ran is None:
            raise MessageError("no pass is complete yet")
        return self.ran_by, self.ran

    def begin(self, target: Trajectory) -> list[Output]:
        """Go on along another target; raises MillingError where it is refused."""
        return self._go_on(self.models.compensator(target, None))

    def choose(self, method: str) -> list[Output]:
        """Another method, from the pass along the target if there was one."""
        made = copy.copy(self.begun)  # to leave this one as it is if that is refused
        made.choose(method)
        return self._go_on(made)

    def reset(self) -> list[Output]:
        """Back to the target itself."""
        made = copy.copy(self.begun)
        made.reset()
        return self._go_on(made)

    def resume(self, state: Compensator) -> None:
        """Go on with a compensator that has published its reference already."""
        clock = self.models.clock
        self.compensator = state
        self._await_pass(int(clock.stamp(clock.steps(state.reference.duration_ns))))

    def twin(self) -> CompensatorProtocol:
        """An independent one in the same state."""
        other = copy.copy(self)
        vars(other).update(
            compensator=copy.copy(self.compensator),
            _poses=dict(self._poses),
            _wrenches=dict(self._wrenches),
        )
        return other

    @property
    def under_way(self) -> bool:
        """Whether the start of a pass was heard and its end was not revised yet."""
        return self.compensator is not None and bool(self._poses)

    @property
    def at_end(self) -> bool:
        """Whether the pass lacks nothing but its last wrench."""
        return self.under_way and self._last_poses <= 0

    @property
    def stamp_ns(self) -> int:
        """Of the last pose that counts."""
        return next(reversed(self._poses), 0)

    @property
    def ignored(self) -> int:
        """Poses of a pass whose start was not heard."""
        return 0 if self._poses else self._ignored

    @property
    def has_wrench(self) -> bool:
        """Whether a wrench of the pass was heard."""
        return bool(self._wrenches)

    def pose(self, sample: PoseSample) -> list[Output]:
        """Take a pose; raises MessageError, and what a revision raises."""
        checked_pose(sample)
        if self.compensator is None:
            return []
        if sample.stamp == 0 and list(self._poses) != [0]:  # a later start begins anew
            self._await_pass(self.end_ns, self._early)
        last = next(reversed(self._poses), -1)
        if sample.stamp != last and (sample.stamp < last or last >= self.end_ns or (last < 0 < sample.stamp)):
            self._ignored += 1  # older than the last one, behind the end, or before the start
            return []
        self._poses[sample.stamp] = sample  # again where the exchange is iterated, or the robot asked again
        if sample.stamp < self.end_ns:
            return []
        self._last_poses -= 1
        return self._revise_when_complete()

    def wrench(self, sample: WrenchSample) -> list[Output]:
        """Take a wrench; raises MessageError, and what a revision raises."""
        checked_wrench(sample)
        if self.compensator is None:
            return []
        if sample.stamp == 0 and list(self._poses) != [0]:
            self._early = {0: sample}  # it may overtake the pose that it answers
            return []
        if not self._poses:
            return []
        self._wrenches[sample.stamp] = sample
        if sample.stamp < self.end_ns:
            return []
        self._last_wrenches -= 1
        return self._revise_when_complete()

    def finish(self) -> list[Output]:
        """Revise without the last wrench, which does not come, if the pass lacks nothing else."""
        return self._revise() if self.at_end else []

    def _revise_when_complete(self) -> list[Output]:
        return self._revise() if self._last_poses <= 0 and self._last_wrenches <= 0 else []

    def _await_pass(self, end_ns: int, wrenches: dict[int, WrenchSample] | None = None) -> None:
        """Nothing of a pass was heard yet; each exchange brings as many poses and wrenches as it has iterations."""
        self.end_ns = end_ns  #: stamp that ends a pass
        self._poses: dict[int, PoseSample] = {}  # by their stamps, ascending
        self._ignored = 0
        self._wrenches = dict(wrenches or {})
        self._early = {}
        self._last_poses = self.models.iterations
        self._last_wrenches = self.models.iterations

    def _revise(self) -> list[Output]:
        stamps, poses = np.array(list(self._poses)), list(self._poses.values())
        positions = np.array([pose.position for pose in poses])
        self.ran = self.models.pass_record(self.passes, stamps, positions, self._wrench_series(stamps, poses))
        self.passes += 1
        self.ran_by = self.compensator
        self.missing = _holes(stamps)
        self.missing_wrenches = _holes(np.array(sorted(self._wrenches)))
        self._await_pass(self.end_ns)  # this one is over, also if nothing can be made of it
        made = copy.copy(self.begun)
        made.revise(self.ran)
        return self._go_on(made)

    def _wrench_series(self, stamps: np.ndarray, poses: list[PoseSample]) -> np.ndarray:
        """(n, 6) at the stamps of the poses, interpolated where a sensor has others; 0 where none was heard."""
        if not self._wrenches:
            return np.zeros((stamps.size, 6))
        times = np.array(sorted(self._wrenches))
        nearest = np.maximum(np.searchsorted(stamps, times, side="right") - 1, 0).tolist()
        samples = [self._wrenches[stamp] for stamp in times.tolist()]
        values = np.array([in_workpiece_axes(s, poses[k].quaternion) for s, k in zip(samples, nearest, strict=True)])
        return np.column_stack([np.interp(stamps, times, axis) for axis in values.T])

    def _go_on(self, made: Compensator) -> list[Output]:
        """Whatever may refuse the reference comes before anything has changed."""
        program = self.joint_program(made.reference)
        self.resume(made)
        return [("reference_trajectory", made.reference), ("joint_trajectory", program)]

    def joint_program(self, reference: Trajectory) -> JointProgram:
        """What a controller of joints runs for a reference; raises MillingError where that is not possible."""
        return JointProgram("base_link", JOINT_NAMES, reference.time_ns, self.models.joints(reference))


def _holes(stamps: np.ndarray) -> int:
    """How many messages are missing in a pass, where they come at one period."""
    if stamps.size < 2:
        return 0
    steps = np.diff(stamps) / np.median(np.diff(stamps))
    return int(np.sum(np.rint(steps) - 1)) if np.max(np.abs(steps - np.rint(steps))) < 0.25 else 0
