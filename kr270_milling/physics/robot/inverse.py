"""Closed-form inverse kinematics of an arm with a spherical wrist, all branches, and along a path; compiled.

Branch: shoulder (the wrist centre in front of axis 1 or at its back), elbow (bent down or up), wrist (sign of A5).
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.compiled import compiled, inner
from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.physics.robot.kinematics import elbow_and_reach, rows_of

#: shoulder, elbow, wrist of the 8 branches, (8, 3)
BRANCHES = np.array([(s, e, w) for s in (1, -1) for e in (1, -1) for w in (1, -1)], float)
BRANCHES.setflags(write=False)


def _wrapped(angle):
    """The angle [rad], a number or an array, within a half turn to either side."""
    two_pi = 2 * np.pi
    return angle - two_pi * np.rint(angle / two_pi)


wrapped = inner(_wrapped)


def inverse_near(arm: Arm, mount: Mount, pose: Pose, near_q) -> np.ndarray:
    """The posture [rad], (..., 6), for every pose (...), nearest to a given one, whole turns included.

    near_q of the same batch as the poses: each pose takes the branch nearest to its own near_q. One near_q, (6,),
    for a path of poses (n,): the branch nearest to it at the first pose is followed without jumps; where the
    path leads through A5 = 0, A5 changes its sign rather than A4 jumping by 180 deg. Where A5 = 0, A4 stays as it was.
    Raises ReachError, SingularityError (wrist centre on axis 1), JointLimitError; a jump to another branch is never
    the answer to a limit.
    """
    near_q = np.asarray(near_q, float)
    if near_q.ndim == 1 and pose.position.ndim == 2:  # one seed for a path
        q = _along(arm, mount, pose, near_q) if len(pose.position) else np.empty((0, 6))
    else:
        shape = np.broadcast_shapes(pose.position.shape[:-1], near_q.shape[:-1])
        q = _nearest(arm, mount, pose, np.broadcast_to(near_q, shape + (6,)))
    _check_limits(arm, q)
    return q


def inverse_along(
    arm: Arm, mount: Mount, frame: Pose, position: np.ndarray, quaternion: np.ndarray, seed: np.ndarray
) -> np.ndarray:
    """Postures [rad], (n, 6), along positions (n, 3) [m] and orientations (n, 4) in ``frame``; see ``inverse_near``."""

    def postures(part: slice, near: np.ndarray) -> np.ndarray:
        tool = Pose(position[part], rotation_from_quaternion(quaternion[part]))
        return inverse_near(arm, mount, frame @ tool, near)

    joints = np.empty((len(position), 6))
    try:
        for part in blocks(len(position)):
            joints[part] = postures(part, joints[part.start - 1] if part.start else seed)
    except (ReachError, SingularityError, JointLimitError):
        return postures(slice(None), seed)  # raises with the number of the point
    return joints


def _check_limits(arm: Arm, q: np.ndarray) -> None:
    """Raise JointLimitError for the first posture (..., 6) [rad] with a joint out of its range."""
    slack = 1e-12  # [rad], of the joint limits: rounding
    bad = np.argwhere(~((q >= arm.joint_lower - slack) & (q <= arm.joint_upper + slack)))
    if len(bad):
        *index, joint = (int(i) for i in bad[0])
        limits = float(arm.joint_lower[joint]), float(arm.joint_upper[joint])
        raise JointLimitError(joint + 1, float(q[tuple(bad[0])]), limits, tuple(index))


def branches(arm: Arm, mount: Mount, pose: Pose, near_q) -> tuple[np.ndarray, np.ndarray]:
    """All 8 branches [rad], (..., 8, 6), angles within a half turn, limits ignored, NaN where out of reach.

    Second, the distance of the wrist centre from axis 2 [m], (..., 8). near_q (..., 6) gives A4 where A5 = 0.
    """
    flange, near_q = pose @ mount.pose.inverse(), np.asarray(near_q, float)
    shape = np.broadcast_shapes(pose.position.shape[:-1], near_q.shape[:-1])
    position, rotation = rows_of(flange.position, shape, 1), rows_of(flange.rotation, shape, 2)
    q, distance = np.full((len(position), 8, 6), np.nan), np.empty((len(position), 8))
    _fill(lengths_of(arm), position, rotation, rows_of(near_q[..., 3], shape, 0), -1, q, distance)
    return q.reshape(*shape, 8, 6), distance.reshape(*shape, 8)


def lengths_of(arm: Arm) -> tuple[float, ...]:
    """d1, a1, a2, length of the forearm, d6 [m] and elbow offset [rad], for ``branches_at``."""
    return tuple(map(float, (arm.d1, arm.a1, arm.a2, arm.forearm, arm.d6, arm.elbow_offset)))


@compiled
def _fill(lengths, position, rotation, near_a4, only, q, distance):
    for k in range(len(position)):
        branches_at(lengths, position[k], rotation[k], near_a4[k], only, q[k], distance[k])


@inner
def branches_at(lengths, position, rotation, near_a4, only, q, distance):
    """Fill q (8, 6) [rad] with the branches of one flange pose, and distance (8,) [m]; see ``branches``.

    only: the row of ``BRANCHES`` that is filled, with that of the other sign of A5; -1: all.

    Wrist centre p - d6 x_6; A2 and A3 by the cosine rule in the triangle of axis 2, axis 3 and wrist centre; A4 to A6
    from R36 = Rx(-A4) Ry(A5) Rx(-A6). The other sign of A5 is the same orientation: A4 + pi, -A5, A6 + pi.
    """
    d1, a1, a2, forearm, d6, elbow_offset = lengths
    x, y = position[0] - d6 * rotation[0, 0], position[1] - d6 * rotation[1, 0]
    height, far = position[2] - d6 * rotation[2, 0] - d1, math.hypot(x, y)
    for shoulder in range(2):
        if only >= 0 and only // 4 != shoulder:
            continue
        side = 1.0 - 2.0 * shoulder
        radius = side * far - a1
        for branch in range(4 * shoulder, 4 * shoulder + 4):
            distance[branch] = math.hypot(radius, height)
        cosine = (radius**2 + height**2 - a2**2 - forearm**2) / (2 * a2 * forearm)
        if not abs(cosine) < 1.0 + 1e-12:
            continue
        q1 = wrapped(-math.atan2(side * y, side * x))
        bend = math.acos(min(1.0, max(-1.0, cosine)))
        for elbow in range(2):
            if only >= 0 and only // 2 % 2 != elbow:
                continue
            beta = -bend if elbow == 0 else bend  # angle of the forearm against the upper arm, counted upwards
            lead = math.atan2(forearm * math.sin(beta), a2 + forearm * math.cos(beta))
            q2, q3 = wrapped(lead - math.atan2(height, radius)), wrapped(elbow_offset - beta)
            s1, c1, s, c = math.sin(q1), math.cos(q1), math.sin(q2 + q3), math.cos(q2 + q3)
            x0, y0, z0 = _below_elbow(rotation[:, 0], s1, c1, s, c)
            _, y1, z1 = _below_elbow(rotation[:, 1], s1, c1, s, c)
            _, y2, z2 = _below_elbow(rotation[:, 2], s1, c1, s, c)
            q4 = near_a4
            # below this sine of A5, the pose determines only the sum of A4 and A6
            if math.hypot(y0, z0) >= 1e-12:
                q4 = math.atan2(-y0, -z0)
            s4, c4 = (
                math.sin(q4),
                math.cos(q4),
            )  # A5 and A6 from Rx(A4) R36 = Ry(A5) Rx(-A6): right for any A4 where A5 = 0
            q5 = math.atan2(-(s4 * y0 + c4 * z0), x0)
            q6 = math.atan2(c4 * y2 - s4 * z2, c4 * y1 - s4 * z1)
            row = 4 * shoulder + 2 * elbow
            # one by one: Numba compiles the sentence on shapes of a slice for seconds
            q[row, 0], q[row, 1], q[row, 2], q[row, 3], q[row, 4], q[row, 5] = q1, q2, q3, q4, q5, q6
            for j in range(3):
                q[row + 1, j] = q[row, j]
            q[row + 1, 3], q[row + 1, 4], q[row + 1, 5] = wrapped(q4 + np.pi), -q5, wrapped(q6 + np.pi)


@inner
def _below_elbow(column, s1, c1, s, c):
    """Return a column of R36 = (Rz(-A1) Ry(A2 + A3))^T R from that of R."""
    x, y, z = column[0], column[1], column[2]
    return c1 * c * x - s1 * c * y - s * z, s1 * x + c1 * y, c1 * s * x - s1 * s * y + c * z


def _reach(arm: Arm) -> tuple[float, float]:
    return abs(arm.a2 - arm.forearm), arm.a2 + arm.forearm


def _nearest(arm: Arm, mount: Mount, pose: Pose, near_q: np.ndarray) -> np.ndarray:
    """For each pose the branch with the least sum of squares of joint angles from near_q, (..., 6)."""
    every, distance = branches(arm, mount, pose, near_q)
    every = near_q[..., None, :] + _wrapped(every - near_q[..., None, :])
    away = np.sum((every - near_q[..., None, :]) ** 2, -1)
    out = np.argwhere(~np.isfinite(away).any(-1))
    if len(out):
        index = tuple(int(i) for i in out[0])
        raise ReachError(float(distance[index].min()), _reach(arm), index)
    best = np.argmin(np.where(np.isfinite(away), away, np.inf), -1)
    q = np.take_along_axis(every, best[..., None, None], -2)[..., 0, :]
    _check_shoulder(arm, mount, pose)
    return q


def _check_shoulder(arm: Arm, mount: Mount, pose: Pose) -> None:
    flange = pose @ mount.pose.inverse()
    centre = flange.position - arm.d6 * flange.rotation[..., :, 0]
    radius = np.hypot(centre[..., 0], centre[..., 1])
    bad = np.argwhere(~(radius > 1e-9))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise SingularityError("shoulder", float(radius[index]) / (arm.a2 + arm.forearm), index)


def _along(arm: Arm, mount: Mount, path: Pose, seed: np.ndarray) -> np.ndarray:
    """Postures (n, 6) along a path of poses (n,) on the branch nearest to the seed, (6,)."""
    first = _nearest(arm, mount, Pose(path.position[0], path.rotation[0]), seed)
    _check_shoulder(arm, mount, path)
    beta, radius = elbow_and_reach(arm, first)
    row = (0 if radius >= 0 else 4) + (0 if _wrapped(beta) <= 0 else 2)  # in BRANCHES, with A5 > 0
    flange = path @ mount.pose.inverse()
    batch = flange.position.shape[:1]
    position, rotation = rows_of(flange.position, batch, 1), rows_of(flange.rotation, batch, 2)
    q = np.empty((len(position), 6))
    q[0] = first
    every, away = np.full((8, 6), np.nan), np.zeros(8)
    lost, distance = _follow(lengths_of(arm), row, position, rotation, every, away, first.copy(), q)
    if lost:
        raise ReachError(distance, _reach(arm), (lost,))
    return q


@compiled
def _follow(lengths, row, position, rotation, every, distance, last, q):
    """Fill the postures (n, 6) after the first one without jumps; return the first one out of reach, 0 without, and the
    distance of its wrist centre from axis 2 [m].

    A4 stays where A5 = 0. Where the path leads through A5 = 0, A5 changes its sign. every (8, 6), distance (8,): of
    ``branches_at``; last (6,): the first posture, changed.
    """
    sign = 1.0 if q[0, 4] >= 0.0 else -1.0
    if sign < 0.0:  # the last posture is that with A5 > 0
        last[3], last[4], last[5] = last[3] + np.pi, -last[4], last[5] + np.pi
    for k in range(1, len(q)):
        every[row, 0] = np.nan
        branches_at(lengths, position[k], rotation[k], last[3], row, every, distance)
        if not np.isfinite(every[row, 0]):
            return k, distance[row]
        step = flip = 0.0
        for j in range(3, 6):
            other = every[row, j] + np.pi if j != 4 else -every[row, j]
            step, flip = step + wrapped(every[row, j] - last[j]) ** 2, flip + wrapped(other - last[j]) ** 2
        if flip < step:
            sign = -sign
        for j in range(6):
            last[j] = every[row, j]
            angle = last[j]
            if sign < 0.0 and j > 2:
                angle = -last[j] if j == 4 else last[j] + np.pi
            q[k, j] = angle - 2 * np.pi * np.rint((angle - q[k - 1, j]) / (2 * np.pi))
    return 0, 0.0
