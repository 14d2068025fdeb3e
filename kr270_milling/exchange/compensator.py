"""Protocol of the compensator: poses and wrenches of a pass in, revised trajectory out."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import CompensatorState, JointProgram, LearnedRecording, PoseSample, WrenchSample
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import compensator
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.exchange.inbox import PassInbox
from kr270_milling.exchange.inputs import Output, WrenchFrames, checked_length, checked_pose, checked_wrench
from kr270_milling.exchange.joint_program import joint_program
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator

__all__ = ["CompensatorProtocol", "end_of"]


class CompensatorProtocol:
    """tool_pose and wrench in; compensator_state and reference_trajectory out; joint_trajectory on request.

    plant: the cell that is simulated in the place of a real one, with its tracker; name: of the node; now: the
    time [ns] of its clock. The reference states the start of its pass: now, or the end of the last pass where that is
    later. announced: the pass of a robot with another clock begins with ``start``.
    ``finish`` completes a pass without its last wrench. A refused message leaves the state unchanged.
    """

    def __init__(
        self,
        cell: Cell,
        plant: Cell | None = None,
        name: str = "trajectory_compensator",
        now: Callable[[], int] = lambda: 0,
        announced: bool = False,
    ):
        self.cell = cell
        self.plant = plant
        self.name = name
        self.recording = ""  #: file that the passes are recorded to, as the recorder publishes it
        self.compensator: Compensator | None = None
        self.passes = 0  #: completed passes
        self.missing = 0  #: poses that the last completed pass lacks
        self.inbox = PassInbox(0, cell.exchange.iterations)
        self._now = now
        self._announced = announced
        self._frames = WrenchFrames(cell.mount, cell.workpiece, cell.sensor)
        self._free_ns = 0  # stamp after the end of the last pass
        self._learned: tuple[LearnedRecording, ...] = ()  # the passes that the reference follows from
        self._first: tuple[LearnedRecording, ...] = ()  # the pass along the target

    @property
    def active(self) -> Compensator:
        """The compensator; raises MessageError before there is a target."""
        if self.compensator is None:
            raise MessageError("there is no target trajectory yet")
        return self.compensator

    @property
    def under_way(self) -> bool:
        """Return whether the start of a pass was received and its end is not revised yet."""
        return self.compensator is not None and self.inbox.started

    @property
    def at_end(self) -> bool:
        """Return whether the pass lacks nothing but its last wrench."""
        return self.under_way and self.inbox.at_end

    def begin(self, target: Trajectory) -> list[Output]:
        """Continue along another target; raises MillingError where it is refused."""
        checked_length(target, path_of(self.cell).clock)
        outputs = self._continue(compensator(self.cell, target), ())
        self._first = ()
        return outputs

    def choose(self, method: str) -> list[Output]:
        """Choose another method; it starts from the pass along the target if there was one."""
        revised = copy.copy(self.active)  # a refused choice leaves the present one unchanged
        revised.choose(method)
        return self._continue(revised, self._first)

    def reset(self) -> list[Output]:
        """Return to the target itself."""
        revised = copy.copy(self.active)
        revised.reset()
        return self._continue(revised, ())

    def restart(self) -> list[Output]:
        """Begin the pass anew, with another start."""
        return self._continue(self.active, self._learned)

    def start(self, stamp_ns: int) -> None:
        """Begin the pass of a robot with another clock at the stamp of its start message."""
        if self.compensator is not None:
            self.inbox.begin(stamp_ns)

    def pose(self, sample: PoseSample) -> list[Output]:
        """Take a pose; raises MessageError, and the errors of a revision."""
        checked_pose(sample)
        if self.compensator is None:
            return []
        self.inbox.pose(sample)
        if self.inbox.started and not self.inbox.foreign:
            self._free_ns = self.inbox.start_ns + self.inbox.end_ns + round(path_of(self.cell).clock.period * 1e9)
        return self._revise() if self.inbox.complete else []

    def wrench(self, sample: WrenchSample) -> list[Output]:
        """Take a wrench; raises MessageError, and the errors of a revision."""
        checked_wrench(sample, self._frames.names)
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
        placed, settings = arm_of(self.cell), self.cell.compensation
        return joint_program(placed, settings, self.cell.joint_names, reference, joints, stamp_ns)

    def _revise(self) -> list[Output]:
        inbox, self.inbox = self.inbox, copy.copy(self.inbox)
        self.inbox.clear()  # the pass is over, also if its revision fails
        received = inbox.received()
        self.inbox.problem = inbox.problem
        number = self.passes
        self.passes += 1
        self.missing = received.missing
        revised = copy.copy(self.active)
        first = revised.reference is revised.target and not revised.errors
        tracker = None if self.plant is None else self.plant.imperfections
        revised.revise(received.record(path_of(self.cell), self.cell.imperfections, tracker, number))
        learned = received.as_learned(self.recording)
        outputs = self._continue(revised, (*self._learned, learned))
        if first:
            self._first = (learned,)
        return outputs

    def _continue(self, revised: Compensator, learned: tuple[LearnedRecording, ...]) -> list[Output]:
        """Return the outputs of a new state; an error comes before anything has changed."""
        # raises where no arm can run the reference
        commanded_joints(arm_of(self.cell), self.cell.compensation, revised.reference)
        self.compensator, self._learned = revised, learned
        start, problem = max(self._now(), self._free_ns), self.inbox.problem
        end, iterations = end_of(self.cell, revised.reference), self.cell.exchange.iterations
        self.inbox = PassInbox(
            end, iterations, start, revised.reference, path_of(self.cell).clock, self._frames, self._announced
        )
        self.inbox.problem = problem
        state = CompensatorState(
            self.name,
            revised.method,
            self.passes,
            revised.finished,
            fingerprint(revised.target),
            fingerprint(revised.reference),
            learned,
        )
        return [("compensator_state", state), ("reference_trajectory", revised.reference.starting_at(start))]


def end_of(cell: Cell, reference: Trajectory) -> int:
    """Return the stamp [ns] of the last exchange of a pass along a reference."""
    return int(path_of(cell).clock.stamp(path_of(cell).clock.steps(reference.duration_ns)))
