"""Many postures at once, compiled: all branches of the inverse kinematics, deflection of the tool, path measures.

Both signs of A5 are one configuration of the links with axis 5 turned round, so they deflect alike.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kr270_milling.base.frames import Pose
from kr270_milling.physics.robot.arm import Arm, Mount, moment_slope
from kr270_milling.physics.robot.inverse import branches_at, lengths_of, wrapped
from kr270_milling.physics.robot.kinematics import jacobian_column

_slope = njit(cache=True, nogil=True)(moment_slope)


def postures(arm: Arm, mount: Mount, place: Pose, force: np.ndarray, gravity: bool) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles [rad], (k, 8, 6), in the order of ``robot.inverse.BRANCHES``, and the deflection of the tool.

    place: of tcp on base_link, (k,); force: on the tool, base axes [N], (k, 3). The second is C F [m], (k, 8, 3),
    with C = J diag(c) J^T of the translations, joints and base; where gravity is on, c of joint 2 has the share of the
    gravity compensator, c_2 / (1 - c_2 dM_c/dq_2). NaN where out of reach.
    """
    flange = place @ mount.pose.inverse()
    count = len(flange.position)
    spring: tuple[float, ...] = (0.0,) * 5
    if gravity and (c := arm.compensator).present:
        spring = tuple(map(float, (c.stiffness, c.free_length, c.base_x, c.base_z, c.arm_length)))
    middle = 0.5 * float(arm.joint_lower[3] + arm.joint_upper[3])
    q, deflection = np.full((count, 8, 6), np.nan), np.full((count, 8, 3), np.nan)
    soft = np.concatenate([arm.joint_compliance, arm.base_compliance])
    _fill(lengths_of(arm), spring, middle, _dense(soft), _dense(place.position),
          _dense(flange.position), _dense(flange.rotation), _dense(force), q, deflection)  # fmt: skip
    return q, deflection


def _dense(array: np.ndarray) -> np.ndarray:
    """Return the array in a single layout, so that a single compilation serves."""
    return np.ascontiguousarray(array, float)


@njit(cache=True, nogil=True)
def _fill(lengths, spring, middle, soft, place, position, rotation, force, q, deflection):
    d1, a1, a2, _, d6, _ = lengths
    distance = np.empty(8)
    for k in range(len(position)):
        p, flange = place[k], rotation[k]
        branches_at(lengths, position[k], flange, middle, -1, q[k], distance)
        x, y, z = position[k] - d6 * flange[:, 0]
        for both in range(0, 8, 2):
            q1, q2, q3, q4 = q[k, both, :4]
            if not np.isfinite(q1):
                continue
            s1, c1, s, c = np.sin(q1), np.cos(q1), np.sin(q2 + q3), np.cos(q2 + q3)
            s4, c4 = np.sin(q4), np.cos(q4)
            c2 = soft[1]
            if spring[0] > 0.0:
                c2 /= 1.0 - c2 * _slope(spring, np.cos(q2), np.sin(q2))
            high = a2 * np.cos(q2) + a1
            gives = deflection[k, both]
            gives[:] = 0.0
            _add(gives, soft[0] + soft[8], 0.0, 0.0, -1.0, p[0], p[1], p[2], force[k])
            if soft[6] + soft[7] > 0.0:
                _add(gives, soft[6], 1.0, 0.0, 0.0, p[0], p[1], p[2], force[k])
                _add(gives, soft[7], 0.0, 1.0, 0.0, p[0], p[1], p[2], force[k])
            _add(gives, c2, s1, c1, 0.0, p[0] - a1 * c1, p[1] + a1 * s1, p[2] - d1, force[k])
            _add(gives, soft[2], s1, c1, 0.0, p[0] - high * c1, p[1] + high * s1, p[2] - d1 + a2 * np.sin(q2),
                 force[k])  # fmt: skip
            u, v, w = p[0] - x, p[1] - y, p[2] - z
            _add(gives, soft[3], -c1 * c, s1 * c, s, u, v, w, force[k])
            _add(gives, soft[4], s1 * c4 - c1 * s * s4, c1 * c4 + s1 * s * s4, -c * s4, u, v, w, force[k])
            _add(gives, soft[5], -flange[0, 0], -flange[1, 0], -flange[2, 0], u, v, w, force[k])
            deflection[k, both + 1] = gives


@njit(cache=True, nogil=True)
def _add(gives, soft, ax, ay, az, rx, ry, rz, force):
    """Add a joint with axis a, the tool at r from it: column j = a x r of the Jacobian, gives += c j (j . F)."""
    jx, jy, jz = jacobian_column(ax, ay, az, rx, ry, rz)
    turned = soft * (jx * force[0] + jy * force[1] + jz * force[2])
    gives[0] += jx * turned
    gives[1] += jy * turned
    gives[2] += jz * turned


@njit(cache=True, nogil=True)
def whole_turns(q, lower, upper):
    """Make the angles q (m, 6) run without jumps, in place, and return whether they are within the limits.

    Of the whole turns that are within them, those nearest to the middle of the range are taken.
    """
    within = True
    two_pi = 2.0 * np.pi
    for j in range(6):
        low = high = q[0, j]
        for k in range(1, len(q)):
            q[k, j] = q[k - 1, j] + wrapped(q[k, j] - q[k - 1, j])
            low, high = min(low, q[k, j]), max(high, q[k, j])
        first, last = np.ceil((lower[j] - low) / two_pi), np.floor((upper[j] - high) / two_pi)
        within &= first <= last
        central = np.round(0.5 * (lower[j] + upper[j] - low - high) / two_pi)
        shift = two_pi * max(first, min(last, central))
        for k in range(len(q)):
            q[k, j] += shift
    return within


def along_path(arm: Arm, q: np.ndarray, deflection: np.ndarray, feed: np.ndarray, size: np.ndarray, margin: float):
    """Measures of paths of m places, each (n, 8): within the limits, and (n, 8, 4): see below; q is unwrapped in place.

    q, deflection: (n, m, 8, 6) and (n, m, 8, 3) of ``postures``; feed: unit vectors (n, m, 3); size: force [N], (n, m),
    0 where nothing is cut: such a place counts for reach and limits alone. margin [rad]: distance to each limit.
    The four are the least of ``robot.singularity_measures``, the largest compliance in the direction of the force
    [m/N], the largest and the mean part of ``deflection`` across the feed [m]. NaN where a place is out of reach.
    """
    within, measures = np.zeros(q.shape[::2][:2], np.bool_), np.full((*q.shape[::2][:2], 4), np.nan)
    lengths = tuple(map(float, (arm.a1, arm.a2, arm.forearm, arm.elbow_offset)))
    lower, upper = arm.joint_lower + margin, arm.joint_upper - margin
    _reduce(lengths, lower, upper, q, _dense(deflection), _dense(feed), _dense(size), within, measures)
    return within, measures


@njit(cache=True, nogil=True)
def _reduce(lengths, lower, upper, q, deflection, feed, size, within, measures):
    a1, a2, forearm, elbow_offset = lengths
    n, m = q.shape[:2]
    for i in range(n):
        for b in range(8):
            singular, soft, largest, total, cuts, reached = np.inf, 0.0, 0.0, 0.0, 0, True
            for k in range(m):
                u, f, angles = deflection[i, k, b], feed[i, k], q[i, k, b]
                if not np.isfinite(u[0]):
                    reached = False
                    break
                if size[i, k] > 0.0:
                    length = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
                    along = u[0] * f[0] + u[1] * f[1] + u[2] * f[2]
                    across = np.sqrt(max(length**2 - along**2, 0.0))
                    largest, total, cuts = max(largest, across), total + across, cuts + 1
                    soft = max(soft, length / size[i, k])
                beta = elbow_offset - angles[2]
                shoulder = abs(a1 + a2 * np.cos(angles[1]) + forearm * np.cos(beta - angles[1])) / (a2 + forearm)
                singular = min(singular, shoulder, abs(np.sin(beta)), abs(np.sin(angles[4])))
            if reached:
                within[i, b] = whole_turns(q[i, :, b], lower, upper)
                measures[i, b] = singular, soft, largest, total / max(cuts, 1)
