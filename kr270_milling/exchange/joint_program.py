"""The reference trajectory for a joint controller: an approach from the position of the robot, the pass, a run-out.

Controllers such as the joint_trajectory_controller of ros2_controllers join points with positions only by straight
lines, points with velocities by cubic splines and points with accelerations, too, by quintic splines.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ModelError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.base.samples import JointProgram
from kr270_milling.base.units import SECOND
from kr270_milling.cell.arm import PlacedArm, commanded_joints
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.robot.arm import Arm
from kr270_milling.physics.robot.kinematics import forward, joint_motion

__all__ = ["joint_program"]

SHARE = 0.1  #: share of the speed and acceleration limits of the joints, in approach and run-out; 10 % as in T1
LEAST = 0.1  #: [s], of approach and run-out
SMOOTH = 1e-9  #: [m] by which a jump of velocity or acceleration at a knot may move the path
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
    turn, times = placed.place.rotation, reference.time_ns
    orientation = Rotation.from_quat(reference.quaternion)
    left, right = (reference.locate(times, side) for side in ("left", "right"))
    steps = np.hstack([left[2], right[2]])  # [s], (n, 2)
    rates = [(orientation[k + 1] * orientation[k].inv()).as_rotvec() / step for k, _, step in (left, right)]
    speeds = [reference.sample_velocity(times, side) for side in ("left", "right")]
    bends = [reference.sample_acceleration(times, side) for side in ("left", "right")]
    step = steps.max(axis=1)
    corner = np.linalg.norm(speeds[1] - speeds[0], axis=1) * step / 8 > SMOOTH
    kink = corner | (np.linalg.norm(bends[1] - bends[0], axis=1) * step**2 / 64 > SMOOTH)
    velocity = np.hstack([np.mean(speeds, axis=0) @ turn.T, np.mean(rates, axis=0) @ turn.T])
    change = (rates[1] - rates[0]) / steps.mean(axis=1)[:, None]
    acceleration = np.hstack([np.mean(bends, axis=0) @ turn.T, change @ turn.T])
    if not sag_compensated:
        velocity += _sag_rate(placed, reference, joints)
    speed, gain = joint_motion(placed.arm, placed.mount, joints, velocity, acceleration)
    speed[corner], gain[kink] = np.nan, np.nan
    return speed, gain


def _sag_rate(placed: PlacedArm, reference: Trajectory, joints: np.ndarray) -> np.ndarray:
    """Velocity (n, 6) that the joints command beyond the reference, against the sag; base axes."""
    tool, place = forward(placed.arm, placed.mount, joints).tool, placed.place
    turned = tool.rotation @ np.swapaxes(place.rotation @ rotation_from_quaternion(reference.quaternion), 1, 2)
    beyond = np.hstack([tool.position - place.apply(reference.position), Rotation.from_matrix(turned).as_rotvec()])
    return np.gradient(beyond, reference.time, axis=0)


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
