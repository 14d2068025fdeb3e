"""Joint speeds and accelerations that a motion of the tool tip needs."""

from __future__ import annotations

import numpy as np

from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.kinematics import check_regular, cross, forward, jacobian_at

__all__ = ["joint_motion"]


def joint_motion(arm: Arm, mount: Mount, q, velocity, acceleration) -> tuple[np.ndarray, np.ndarray]:
    """Joint speeds [rad/s] and accelerations [rad/s^2], (n, 6) each, at postures q (n, 6) [rad].

    velocity, acceleration (n, 6): of the tool tip, translations [m/s, m/s^2] before rotations [rad/s, rad/s^2], base
    axes. With the axes a_i and the columns l_i = a_i x r_i of the Jacobian, and w_i the angular velocity of link i:

    q' = J^-1 x'    q'' = J^-1 (x'' - J' q')
    J' q' = (sum_i (2 w_i - a_i q_i') x l_i q_i', sum_i w_i x a_i q_i')    w_i = sum_(k<=i) a_k q_k'

    The last line is the derivative of the geometric Jacobian: a_i turns with w_i, r_i with the links after it.

    Raises SingularityError.
    """
    check_regular(arm, q)
    frames = forward(arm, mount, q)
    jacobian = jacobian_at(frames, frames.tool.position)
    speed = np.linalg.solve(jacobian, np.asarray(velocity, float)[..., None])[..., 0]
    moves = np.swapaxes(jacobian[..., :3, :], -1, -2) * speed[..., None]  # l_i q_i', (n, 6, 3)
    turns = frames.axes * speed[..., None]
    angular = np.cumsum(turns, axis=-2)
    change = np.concatenate([cross(2 * angular - turns, moves).sum(-2), cross(angular, turns).sum(-2)], -1)
    return speed, np.linalg.solve(jacobian, (np.asarray(acceleration, float) - change)[..., None])[..., 0]
