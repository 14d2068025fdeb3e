"""Protocol of the compensator: poses and wrenches of a pass in, revised trajectory out.

A joint controller receives the reference with an approach from the position of the robot and a run-out. Controllers
such as the joint_trajectory_controller of ros2_controllers join points with positions only by straight lines, points
with velocities by cubic splines and points with accelerations, too, by quintic splines.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import MessageError, ModelError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.base.samples import CompensatorState, JointProgram, LearnedRecording, PoseSample, WrenchSample
from kr270_milling.base.units import SECOND
from kr270_milling.cell.arm import PlacedArm, commanded_joints
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import compensator
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.exchange.inbox import PassInbox
from kr270_milling.exchange.inputs import Output, WrenchFrames, checked_length, checked_pose, checked_wrench
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, fingerprint
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.robot.arm import Arm
from kr270_milling.physics.robot.kinematics import forward, joint_motion

SHARE = 0.1  #: share of the speed and acceleration limits of the joints, in approach and run-out; 10 % as in T1
LEAST = 0.1  #: [s], of approach and run-out
#: largest speed and acceleration of 10 u^3 - 15 u^4 + 6 u^5, from rest to rest
QUINTIC_SPEED, QUINTIC_ACCELERATION = 15 / 8, 10 / math.sqrt(3)


def joint_program(
    placed: PlacedArm,
    settings: CompensationSettings,
    names: tuple[str, ...],
    reference: Trajectory,
    joints: np.ndarray,
    stamp_ns: int,
) -> JointProgram:
    """Return what a joint controller runs for a reference; from its present position, at ``stamp_ns``.

    names: of the joints; joints: positions (6,) [rad] of the robot, which is at rest. The program moves all joints in
    proportion, below a tenth of their limits, to the start; where the reference begins or ends in motion, the program
    gains the speed before the start and loses it after the end, along the tangent. Every knot carries the velocity and
    acceleration that the planned motion has there; a corner has none, and joins its neighbours by straight lines.

    Raises ModelError where a joint exceeds a limit, and the errors of ``commanded_joints``.
    """
    position = commanded_joints(placed, settings, reference)
    velocity, acceleration = _rates(placed, reference, position, settings.sag_compensated)
    gain, loss = (_run_in(placed.arm, rate) for rate in (velocity[0], velocity[-1]))
    ahead = [position[0] - 0.5 * gain * velocity[0]] if gain else []
    beyond = [position[-1] + 0.5 * loss * velocity[-1]] if loss else []
    approach = _ns(_duration(placed.arm, (*ahead, position[0])[0] - joints))
    begin = approach + _ns(gain)
    arrival = [approach] * len(ahead), [begin + reference.duration_ns + _ns(loss)] * len(beyond)
    before, after = np.zeros((1 + len(ahead), 6)), np.zeros((len(beyond), 6))  # at rest
    program = JointProgram(
        stamp_ns,
        "base_link",
        names,
        np.concatenate([[0], arrival[0], begin + reference.time_ns, arrival[1]]),
        np.concatenate([[joints, *ahead], position, np.reshape(beyond, (-1, 6))]),
        np.concatenate([before, velocity, after]),
        np.concatenate([before, acceleration, after]),
    )
    _check_limits(placed.arm, program)
    return program


def _rates(
    placed: PlacedArm, reference: Trajectory, joints: np.ndarray, sag_compensated: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Joint speeds and accelerations at the knots, (n, 6) each; NaN where the tip's motion has a jump.

    The planned orientation turns at a constant rate from knot to knot; a knot takes the mean of both rates.
    """
    smooth = 1e-9  # [m] by which a jump of velocity or acceleration at a knot may move the path
    turn, times = placed.place.rotation, reference.time_ns
    orientation = Rotation.from_quat(reference.quaternion)
    left, right = (reference.locate(times, side) for side in ("left", "right"))
    steps = np.hstack([left[2], right[2]])  # [s], (n, 2)
    rates = [(orientation[k + 1] * orientation[k].inv()).as_rotvec() / step for k, _, step in (left, right)]
    speeds = [reference.sample_velocity(times, side) for side in ("left", "right")]
    bends = [reference.sample_acceleration(times, side) for side in ("left", "right")]
    step = steps.max(axis=1)
    corner = np.linalg.norm(speeds[1] - speeds[0], axis=1) * step / 8 > smooth
    kink = corner | (np.linalg.norm(bends[1] - bends[0], axis=1) * step**2 / 64 > smooth)
    velocity = np.hstack([np.mean(speeds, axis=0) @ turn.T, np.mean(rates, axis=0) @ turn.T])
    change = (rates[1] - rates[0]) / steps.mean(axis=1)[:, None]
    acceleration = np.hstack([np.mean(bends, axis=0) @ turn.T, change @ turn.T])
    if not sag_compensated:
        # velocity that the joints command beyond the reference, against the sag
        tool, place = forward(placed.arm, placed.mount, joints).tool, placed.place
        turned = tool.rotation @ np.swapaxes(turn @ rotation_from_quaternion(reference.quaternion), 1, 2)
        beyond = [tool.position - place.apply(reference.position), Rotation.from_matrix(turned).as_rotvec()]
        velocity += np.gradient(np.hstack(beyond), reference.time, axis=0)
    speed, gain = joint_motion(placed.arm, placed.mount, joints, velocity, acceleration)
    speed[corner], gain[kink] = np.nan, np.nan
    return speed, gain


def _duration(arm: Arm, travel: np.ndarray) -> float:
    """Duration [s] of a quintic from rest to rest that travels (6,) [rad]."""
    travel = np.abs(travel)
    by_speed = QUINTIC_SPEED * np.max(travel / (SHARE * arm.joint_speed_limit))
    by_acceleration = np.sqrt(QUINTIC_ACCELERATION * np.max(travel / (SHARE * arm.joint_acceleration_limit)))
    return max(LEAST, float(by_speed), float(by_acceleration))


def _run_in(arm: Arm, velocity: np.ndarray) -> float:
    """Duration [s] in which the joints gain or lose a velocity (6,) [rad/s]; 0 at rest.

    The speed is v (3 u^2 - 2 u^3), its largest change 3/2 v in the duration.
    """
    if np.max(np.abs(velocity)) <= 1e-9:  # at rest
        return 0.0
    return max(LEAST, 1.5 * float(np.max(np.abs(velocity) / (SHARE * arm.joint_acceleration_limit))))


def _check_limits(arm: Arm, program: JointProgram) -> None:
    """Raise ModelError for the first joint whose speed or position exceeds its limit."""
    for name, first, rows, low, high, unit in (  # the robot may be beyond a limit: the first position is not checked
        ("speed", 0, program.velocity, -arm.joint_speed_limit, arm.joint_speed_limit, "deg/s"),
        ("position", 1, program.position[1:], arm.joint_lower, arm.joint_upper, "deg"),
    ):
        bad = np.argwhere((rows < low) | (rows > high))
        if len(bad):
            row, joint = bad[0].tolist()
            raise ModelError(
                f"joint_trajectory: the {name} of {program.names[joint]} would be {math.degrees(rows[row, joint]):.2f} "
                f"{unit} at point {first + row + 1}, but must be from {math.degrees(low[joint]):.2f} to "
                f"{math.degrees(high[joint]):.2f} {unit}"
            )


def _ns(seconds: float) -> int:
    return math.ceil(seconds * SECOND)


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
        self._now = now
        frames = WrenchFrames(cell.mount, cell.workpiece, cell.sensor)
        self._inbox_of = functools.partial(
            PassInbox, path_of(cell).clock, frames, announced=announced, iterations=cell.exchange.iterations
        )
        self.inbox = self._inbox_of(Trajectory(np.array([0, 1]), np.zeros((2, 3)), np.array(TOOL_DOWN)))  # no target
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
        checked_wrench(sample, self.inbox.frames.names)
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
        self.inbox = self._inbox_of(revised.reference, start)
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
