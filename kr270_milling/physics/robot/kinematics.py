"""Place and motion of every link: forward kinematics and geometric Jacobians.

All functions take postures ``q`` [rad], (..., 6), and work on whole batches. Everything is in ``base_link`` axes.
A posture with k more numbers in front, (..., k + 6), has the turns of a compliant base (``Arm.base_axes``) before the
joints; the axes are then those of the base before the load.

Nodes: O_0 base, O_1 on axis 2, O_2 on axis 3, O_3 the foot of axis 4 (after a3), O_4 = O_5 wrist centre (link 5 has no
length), O_6 flange. Link j spans O_(j-1) to O_j and is moved by joints 1..j; the axis of joint j goes through O_(j-1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.compiled import compiled
from kr270_milling.base.frames import Pose
from kr270_milling.physics.robot.arm import AXES, Arm, Mount
from kr270_milling.physics.robot.errors import SingularityError

#: number of the coordinate axis that each joint turns about, and KUKA's sign
TURNS, SIGNS = np.argmax(np.abs(AXES), axis=1), AXES.sum(axis=1)


@dataclass(frozen=True, eq=False)
class LinkFrames:
    """Every frame of the arm in one posture or a batch of them, in base_link axes."""

    rotations: np.ndarray  #: orientation of the links 1..6, (..., 6, 3, 3); link 6 has the flange's
    nodes: np.ndarray  #: O_0..O_6 [m], (..., 7, 3); link j's frame has its origin in O_(j-1)
    axes: np.ndarray  #: unit vectors of the k axes of the base and the joint axes, with KUKA's sign, (..., k + 6, 3)
    flange: Pose
    tool: Pose
    mass_centre: np.ndarray  #: mass centre of spindle and tool [m], (..., 3)

    @property
    def origins(self) -> np.ndarray:
        """A point on each of the axes [m], (..., k + 6, 3); those of the base meet in O_0."""
        base = self.axes.shape[-2] - 6
        return self.nodes[..., [0] * base + list(range(6)), :] if base else self.nodes[..., :6, :]


@compiled
def jacobian_column(ax, ay, az, rx, ry, rz):
    """j = a x r, translations of a column of the Jacobian: joint axis a, tool point r from the axis [m/rad]."""
    return ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx


def rows_of(array: np.ndarray, batch: tuple[int, ...], ends: int) -> np.ndarray:
    """(n, ...) of an array that is broadcast to ``batch`` before its last ``ends`` axes: what compiled loops take.

    Loops and not numba's gufuncs: two processes that compile one at a time leave a cache on disk with which every later
    process ends in a segmentation fault.
    """
    shape = batch + array.shape[array.ndim - ends :]
    if array.shape != shape or not array.flags.writeable:
        array = np.array(np.broadcast_to(array, shape))
    return np.ascontiguousarray(array).reshape(-1, *shape[len(batch) :])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b over the last axis; in batches three times as fast as array operations, with the same bits."""
    batch = np.broadcast_shapes(a.shape, b.shape)[:-1]
    out = np.empty((*batch, 3))
    _cross(rows_of(a, batch, 1), rows_of(b, batch, 1), out.reshape(-1, 3))
    return out


@compiled
def _cross(a, b, out):
    for n in range(len(out)):
        out[n, 0], out[n, 1], out[n, 2] = jacobian_column(a[n, 0], a[n, 1], a[n, 2], b[n, 0], b[n, 1], b[n, 2])


def rotate_matrix(matrix: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """A stiffness, compliance or mass matrix over stacked 3-vectors, (..., 3 n, 3 n), in other axes, same point.

    rotation (..., 3, 3) maps coordinates in the matrix's axes to the new axes: base to tool is ``pose.rotation.T``.
    """
    turn = np.zeros(np.broadcast_shapes(rotation.shape[:-2], matrix.shape[:-2]) + matrix.shape[-2:])
    for k in range(0, matrix.shape[-1], 3):
        turn[..., k : k + 3, k : k + 3] = rotation
    return turn @ matrix @ np.swapaxes(turn, -1, -2)


def forward(arm: Arm, mount: Mount, q) -> LinkFrames:
    """All frames of the chain in ``arm.py`` for postures q [rad], (..., 6) or (..., k + 6)."""
    q = np.asarray(q, float)
    base = arm.base_axes[: q.shape[-1] - 6]  # none for postures of the joints alone
    batch, turns = q.shape[:-1], q.shape[-1]
    angles = q.reshape(-1, turns)
    rotations, axes, nodes = np.empty((*batch, 6, 3, 3)), np.empty((*q.shape, 3)), np.zeros((*batch, 7, 3))
    _chain(
        np.cos(angles),
        np.sin(angles),
        np.append(base, TURNS),
        np.append(np.ones(base.size), SIGNS),
        np.array(arm.link_vectors),
        np.empty((3, 3)),
        rotations.reshape(-1, 6, 3, 3),
        axes.reshape(-1, turns, 3),
        nodes.reshape(-1, 7, 3),
    )
    flange = Pose(nodes[..., 6, :], rotations[..., 5, :, :])
    return LinkFrames(rotations, nodes, axes, flange, flange @ mount.pose, flange.apply(mount.mass_centre))


@compiled
def _chain(cosines, sines, turns, signs, links, turned, rotations, axes, nodes):
    """Turn about one coordinate axis after the other: rotations and ends of the links, and the axes of the turns.

    cosines, sines (n, t): of n postures; turns, signs (t,); links (6, 3); turned (3, 3): scratch. Filled:
    rotations (n, 6, 3, 3), axes (n, t, 3), nodes (n, 7, 3), whose first stays 0.
    """
    base = len(turns) - len(links)
    for p in range(len(cosines)):
        for i in range(3):  # one by one: Numba compiles the sentence on shapes of a slice for seconds
            for j in range(3):
                turned[i, j] = 1.0 if i == j else 0.0
        for j in range(len(turns)):
            k = turns[j]
            ahead, beside = (k + 1) % 3, (k + 2) % 3
            cosine, sine = cosines[p, j], signs[j] * sines[p, j]
            for row in range(3):
                a, b = turned[row, ahead], turned[row, beside]
                turned[row, ahead], turned[row, beside] = cosine * a + sine * b, cosine * b - sine * a
                axes[p, j, row] = signs[j] * turned[row, k]
                if j >= base:
                    n = j - base
                    link = turned[row, 0] * links[n, 0] + turned[row, 1] * links[n, 1] + turned[row, 2] * links[n, 2]
                    nodes[p, n + 1, row] = nodes[p, n, row] + link
                    for column in range(3):
                        rotations[p, n, row, column] = turned[row, column]


def pose(arm: Arm, mount: Mount, q) -> Pose:
    """Pose of tcp in base_link."""
    return forward(arm, mount, q).tool


def jacobian(arm: Arm, mount: Mount, q, node: int | None = None) -> np.ndarray:
    """Geometric Jacobian (..., 6, 6) in base axes, translations [m/rad] before rotations [rad/rad].

    At the tool point, or at node O_node seen as the end of link ``node`` (later joints do not move it).
    """
    frames = forward(arm, mount, q)
    if node is None:
        return jacobian_at(frames, frames.tool.position)
    return jacobian_at(frames, frames.nodes[..., node, :], node)


def jacobian_at(frames: LinkFrames, point: np.ndarray, joints: int = 6) -> np.ndarray:
    """Geometric Jacobian of a point [m], (..., 3), that rides on link number ``joints`` (0: the base).

    (..., 6, 6), or (..., 6, k + 6) of frames with k axes of the base.
    """
    count = frames.axes.shape[-2]
    jacobian = np.zeros(frames.axes.shape[:-2] + (6, count))
    moving = count - 6 + joints
    axes = frames.axes[..., :moving, :]
    arms = point[..., None, :] - frames.origins[..., :moving, :]
    jacobian[..., :3, :moving] = np.swapaxes(cross(axes, arms), -1, -2)
    jacobian[..., 3:, :moving] = np.swapaxes(axes, -1, -2)
    return jacobian


def elbow_and_reach(arm: Arm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle of the forearm against the upper arm, counted upwards [rad], and x of the wrist centre before A1 [m]."""
    beta = arm.elbow_offset - q[..., 2]
    return beta, arm.a1 + arm.a2 * np.cos(q[..., 1]) + arm.forearm * np.cos(beta - q[..., 1])


def singularity_measures(arm: Arm, q) -> np.ndarray:
    """(..., 3): shoulder, elbow, wrist; each is 0 in its singularity and at most about 1.

    The determinant of the Jacobian is their product times lengths: the distance of the wrist centre from axis 1
    (here as a share of a2 + forearm), the sine of the angle between upper arm and forearm, the sine of A5.
    """
    q = np.asarray(q, float)
    beta, radius = elbow_and_reach(arm, q)
    shoulder = np.abs(radius) / (arm.a2 + arm.forearm)
    return np.stack([shoulder, np.abs(np.sin(beta)), np.abs(np.sin(q[..., 4]))], -1)


def check_regular(arm: Arm, q: np.ndarray) -> None:
    """Raise SingularityError for the first posture whose Jacobian has no inverse."""
    measures = singularity_measures(arm, q)
    # below this measure (see ``singularity_measures``) a Jacobian is not inverted
    bad = np.argwhere(~(measures > 1e-9))
    if len(bad):
        *index, which = (int(i) for i in bad[0])
        raise SingularityError(("shoulder", "elbow", "wrist")[which], float(measures[tuple(bad[0])]), tuple(index))


def status_turn(arm: Arm, q) -> tuple[np.ndarray, np.ndarray]:
    """KRL status S and turn T of postures q, integers (...,).

    S bit 0: the wrist centre is behind axis 1 (overhead); bit 1: A3 is at or above its value in the stretched arm,
    ``arm.elbow_offset``; bit 2: A5 is negative. T bit i-1: axis i is negative. An angle within 1e-9 rad of its border
    counts as not negative, so that rounding does not decide.
    """
    q = np.asarray(q, float)
    beta, radius = elbow_and_reach(arm, q)
    status = (radius < -1e-9) + 2 * (beta <= 1e-9) + 4 * (q[..., 4] < -1e-9)
    turn = np.sum((q < -1e-9) * (1 << np.arange(6)), -1)
    return status, turn


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
