"""Closed-form inverse kinematics of an arm with a spherical wrist, all branches, and along a path.

Branch: shoulder (the wrist centre in front of axis 1 or behind it), elbow (bent down or up), wrist (sign of A5).
"""

from __future__ import annotations

import numpy as np

from kr270_milling.base.frames import Pose
from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.robot.kinematics import elbow_and_reach

__all__ = ["BRANCHES", "branches", "inverse_near"]

#: shoulder, elbow, wrist of the 8 branches, (8, 3)
BRANCHES = np.array([(s, e, w) for s in (1, -1) for e in (1, -1) for w in (1, -1)], float)
BRANCHES.setflags(write=False)
STRAIGHT = 1e-12  #: sine of A5 below which the pose does not tell A4 from A6
SLACK = 1e-12  #: [rad], of the joint limits: rounding
TWO_PI = 2 * np.pi


def inverse_near(arm: Arm, mount: Mount, pose: Pose, near_q) -> np.ndarray:
    """The posture [rad], (..., 6), for every pose (...), nearest to a given one, whole turns included.

    near_q of the same batch as the poses: each pose takes the branch nearest to its own near_q. One near_q, (6,),
    for a path of poses (n,): the branch nearest to it at the first pose is kept and followed without jumps; where the
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


def _check_limits(arm: Arm, q: np.ndarray) -> None:
    """Raise JointLimitError for the first posture (..., 6) [rad] with a joint out of its range."""
    bad = np.argwhere(~((q >= arm.joint_lower - SLACK) & (q <= arm.joint_upper + SLACK)))
    if len(bad):
        *index, joint = (int(i) for i in bad[0])
        limits = float(arm.joint_lower[joint]), float(arm.joint_upper[joint])
        raise JointLimitError(joint + 1, float(q[tuple(bad[0])]), limits, tuple(index))


def branches(arm: Arm, mount: Mount, pose: Pose, near_q) -> tuple[np.ndarray, np.ndarray]:
    """All 8 branches [rad], (..., 8, 6), angles within a half turn, limits ignored, NaN where out of reach.

    Second, the distance of the wrist centre from axis 2 [m], (..., 8). near_q (..., 6) gives A4 where A5 = 0.
    """
    flange = pose @ mount.pose.inverse()
    lifted = Pose(flange.position[..., None, :], flange.rotation[..., None, :, :])
    q123, distance = _arm_joints(arm, lifted, BRANCHES[:, 0], BRANCHES[:, 1])
    wrist = _wrist_joints(lifted, q123, BRANCHES[:, 2], np.asarray(near_q, float)[..., None, 3])
    q123 = np.broadcast_to(q123, wrist.shape)
    return np.concatenate([q123, wrist], -1), np.broadcast_to(distance, wrist.shape[:-1])


def _reach(arm: Arm) -> tuple[float, float]:
    return abs(arm.a2 - arm.forearm), arm.a2 + arm.forearm


def _arm_joints(arm: Arm, flange: Pose, shoulder, elbow):
    """A1, A2, A3 [rad], (..., 3), NaN out of reach, and the distance from axis 2 to the wrist centre [m]."""
    centre = flange.position - arm.d6 * flange.rotation[..., :, 0]
    a1 = -np.arctan2(shoulder * centre[..., 1], shoulder * centre[..., 0])
    radius = shoulder * np.hypot(centre[..., 0], centre[..., 1]) - arm.a1
    height = centre[..., 2] - arm.d1
    cosine = (radius**2 + height**2 - arm.a2**2 - arm.forearm**2) / (2 * arm.a2 * arm.forearm)
    cosine = np.where(np.abs(cosine) < 1 + 1e-12, np.clip(cosine, -1, 1), np.nan)
    beta = -elbow * np.arccos(cosine)  # of the forearm against the upper arm, counted upwards
    lead = np.arctan2(arm.forearm * np.sin(beta), arm.a2 + arm.forearm * np.cos(beta))
    a2 = lead - np.arctan2(height, radius)
    a1 = np.broadcast_to(a1, a2.shape)
    return _wrapped(np.stack([a1, a2, arm.elbow_offset - beta], -1)), np.hypot(radius, height)


def _wrist_joints(flange: Pose, q123: np.ndarray, wrist, near_a4) -> np.ndarray:
    """A4, A5, A6 [rad], (..., 3): R36 = Rx(-A4) Ry(A5) Rx(-A6); near_a4 stands in where A5 = 0."""
    r = np.swapaxes(_forearm_rotation(q123), -1, -2) @ flange.rotation
    sine = np.hypot(r[..., 1, 0], r[..., 2, 0])
    a4 = np.arctan2(-wrist * r[..., 1, 0], -wrist * r[..., 2, 0])
    a4 = np.where(sine < STRAIGHT, near_a4, a4)
    c, s = np.cos(a4), np.sin(a4)  # A5 and A6 from Rx(A4) R36 = Ry(A5) Rx(-A6): right for any A4 where A5 = 0
    a5 = np.arctan2(-(s * r[..., 1, 0] + c * r[..., 2, 0]), r[..., 0, 0])
    a6 = np.arctan2(c * r[..., 1, 2] - s * r[..., 2, 2], c * r[..., 1, 1] - s * r[..., 2, 1])
    return np.stack([a4, a5, a6], -1)


def _forearm_rotation(q123: np.ndarray) -> np.ndarray:
    """Rz(-A1) Ry(A2 + A3), (..., 3, 3)."""
    c1, s1 = np.cos(q123[..., 0]), np.sin(q123[..., 0])
    c, s = np.cos(q123[..., 1] + q123[..., 2]), np.sin(q123[..., 1] + q123[..., 2])
    rows = [[c1 * c, s1, c1 * s], [-s1 * c, c1, -s1 * s], [-s, np.zeros_like(c), c]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _wrapped(angle):
    """Into a half turn to either side."""
    return angle - TWO_PI * np.round(angle / TWO_PI)


def _nearest(arm: Arm, mount: Mount, pose: Pose, near_q: np.ndarray) -> np.ndarray:
    """For each pose the branch with the least sum of squares of joint angles from near_q, (..., 6)."""
    found, distance = branches(arm, mount, pose, near_q)
    found = near_q[..., None, :] + _wrapped(found - near_q[..., None, :])
    away = np.sum((found - near_q[..., None, :]) ** 2, -1)
    out = np.argwhere(~np.isfinite(away).any(-1))
    if len(out):
        index = tuple(int(i) for i in out[0])
        raise ReachError(float(distance[index].min()), _reach(arm), index)
    best = np.argmin(np.where(np.isfinite(away), away, np.inf), -1)
    q = np.take_along_axis(found, best[..., None, None], -2)[..., 0, :]
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
    shoulder, elbow = _branch_of(arm, first)
    flange = path @ mount.pose.inverse()
    q123, distance = _arm_joints(arm, flange, shoulder, elbow)
    lost = np.flatnonzero(~np.isfinite(q123).all(-1))
    if len(lost):
        raise ReachError(float(distance[lost[0]]), _reach(arm), (int(lost[0]),))
    q = np.concatenate([q123, _wrist_along(flange, q123, first)], -1)
    q[0] = first
    return np.unwrap(q, axis=0)


def _branch_of(arm: Arm, q: np.ndarray) -> tuple[float, float]:
    """Shoulder and elbow sign of a posture (6,)."""
    beta, radius = elbow_and_reach(arm, q)
    return (1.0 if radius >= 0 else -1.0), (1.0 if _wrapped(beta) <= 0 else -1.0)


def _wrist_along(flange: Pose, q123: np.ndarray, first: np.ndarray) -> np.ndarray:
    """A4, A5, A6 along a path, (n, 3), without jumps, from the first posture (6,) on."""
    wrist = _wrist_joints(flange, q123, 1.0, np.nan)
    known = np.isfinite(wrist[:, 0])
    known[0] = True
    wrist[0] = first[3:] if first[4] >= 0 else _flipped(first[3:])
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), 0))
    wrist[:, 0] = wrist[last, 0]
    straight = ~known
    if straight.any():
        fill = Pose(flange.position[straight], flange.rotation[straight])
        wrist[straight] = _wrist_joints(fill, q123[straight], 1.0, wrist[straight, 0])
    step = _wrapped(np.diff(wrist, axis=0))
    flip = _wrapped(_flipped(wrist[1:]) - wrist[:-1])
    flips = np.sum(flip**2, -1) < np.sum(step**2, -1)
    sign = (1.0 if first[4] >= 0 else -1.0) * np.cumprod(np.where(np.r_[False, flips], -1, 1))
    return np.where(sign[:, None] > 0, wrist, _flipped(wrist))


def _flipped(wrist: np.ndarray) -> np.ndarray:
    """The same orientation with the other sign of A5, (..., 3)."""
    return wrist * [1, -1, 1] + [np.pi, 0, np.pi]
