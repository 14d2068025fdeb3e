"""Slow a trajectory down where a joint would run too fast or accelerate too hard."""

from __future__ import annotations

import numpy as np

from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["limit_by_joints", "joint_rates"]

ROUNDS = 200


def joint_rates(time, joints, at_rest: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Joint speeds between the knots [rad/s], (n-1, 6), and accelerations at the knots [rad/s^2], (n, 6).

    time [s], (n,); joints [rad], (n, 6). at_rest: the motion starts and ends at rest, else with its first and last
    speed.
    """
    step = np.diff(time)[:, None]
    speed = np.diff(joints, axis=0) / step
    inner = 2 * np.diff(speed, axis=0) / (step[1:] + step[:-1])
    if at_rest:  # from rest the mean speed of the first step is half of what it gains
        first, last = 2 * speed[:1] / step[:1], -2 * speed[-1:] / step[-1:]
    else:
        first = last = np.zeros((1, speed.shape[1]))
    return speed, np.concatenate([first, inner, last])


def limit_by_joints(trajectory: Trajectory, joints, speed_limit, acceleration_limit) -> Trajectory:
    """The same knots at later times, so that no joint exceeds its speed and acceleration; time steps only grow.

    joints [rad], (n, 6), at the knots; speed_limit [rad/s] and acceleration_limit [rad/s^2], (6,). Steps are stretched
    where the limits are exceeded, round by round; what 200 rounds leave over is taken off the whole by a uniform
    stretch. Speeds and accelerations are those of ``joint_rates``.
    """
    joints = np.asarray(joints, float)
    speed_limit, acceleration_limit = np.asarray(speed_limit, float), np.asarray(acceleration_limit, float)
    if joints.shape[:1] != (len(trajectory),) or not np.isfinite(joints).all():
        raise TrajectoryError("it needs finite joint positions for each of its knots")
    if not (np.all(speed_limit > 0) and np.all(acceleration_limit > 0)):
        raise TrajectoryError("the joint limits must be above 0")
    velocity = trajectory.velocity
    at_rest = velocity is not None and not velocity[0].any() and not velocity[-1].any()
    old = np.diff(trajectory.time)
    speed, _ = joint_rates(trajectory.time, joints, at_rest)
    step = old * np.maximum(1, (np.abs(speed) / speed_limit).max(axis=1))

    def excess() -> np.ndarray:
        """By how much each knot exceeds its accelerations, (n,)."""
        time = np.concatenate([[0], np.cumsum(step)])
        return (np.abs(joint_rates(time, joints, at_rest)[1]) / acceleration_limit).max(axis=1)

    for _ in range(ROUNDS):
        over = excess()
        if over.max() <= 1:
            break
        grow = np.sqrt(np.maximum(over, 1)) * np.where(over > 1, 1 + 1e-6, 1)
        step = step * np.maximum(grow[:-1], grow[1:])
    step = step * max(1.0, np.sqrt(excess().max()) * (1 + 1e-9))
    ratio = step / old
    if not (ratio > 1).any():
        return trajectory
    step_ns = np.maximum(np.ceil(step * 1e9 - 1e-3).astype(np.int64), np.diff(trajectory.time_ns))
    time_ns = np.concatenate([[0], np.cumsum(step_ns)])
    if velocity is not None:
        at_knot = (np.concatenate([ratio[:1], ratio]) + np.concatenate([ratio, ratio[-1:]])) / 2
        velocity = velocity / at_knot[:, None]
    return Trajectory(time_ns, trajectory.position, trajectory.quaternion, velocity, trajectory.frame)
