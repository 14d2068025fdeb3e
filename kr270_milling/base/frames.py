"""Poses and angles, [REP103] and KUKA conventions.

``transform_a_to_b`` maps coordinates given in frame a to coordinates in frame b. KUKA writes orientations as
A, B, C: intrinsic rotations about Z, then Y', then X''.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

TOOL, WORKPIECE = "tcp", "workpiece"  #: frames of the messages; z of tcp is along the spindle, away from the flange
#: the tool tip of recordings before 0.3; since then ``tool0`` is the flange with z out of it, as in ROS-Industrial
OLD_TOOL = "tool0"
JOINT_NAMES = tuple(f"joint_{i}" for i in range(1, 7))  #: as in the drivers of KUKA robots for ROS 2


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose or a stack of poses: coordinates in the moving frame map to ``rotation @ p + position``."""

    position: np.ndarray  #: [m], (..., 3)
    rotation: np.ndarray  #: (..., 3, 3)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.apply(other.position), self.rotation @ other.rotation)

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Map points (..., 3) [m] from the moving frame to the fixed one."""
        return np.einsum("...ij,...j->...i", self.rotation, points) + self.position

    def inverse(self) -> Pose:
        transposed = np.swapaxes(self.rotation, -1, -2)
        return Pose(-np.einsum("...ij,...j->...i", transposed, self.position), transposed)

    @property
    def quaternion(self) -> np.ndarray:
        """Return the quaternion (..., 4) in the order x, y, z, w with w >= 0."""
        return quaternion_from_rotation(self.rotation)

    @classmethod
    def from_abc(cls, position, abc) -> Pose:
        """Build a pose from a position [m], (3,), and KUKA angles A, B, C [rad], (3,)."""
        return cls(np.asarray(position, float), rotation_from_abc(abc))


def rotation_from_abc(abc) -> np.ndarray:
    """Return the rotation matrix (..., 3, 3) of KUKA angles A, B, C [rad], (..., 3)."""
    a, b, c = np.moveaxis(np.asarray(abc, float), -1, 0)
    (ca, cb, cc), (sa, sb, sc) = np.cos((a, b, c)), np.sin((a, b, c))
    rows = [
        [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
        [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
        [-sb, cb * sc, cb * cc],
    ]
    return np.stack([np.stack(np.broadcast_arrays(*row), -1) for row in rows], -2)


def abc_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Return KUKA angles A, B, C [rad], (..., 3); at B = +-90 deg only A - C or A + C is defined, and C is 0."""
    r = np.asarray(rotation, float)
    cosine_b = np.hypot(r[..., 0, 0], r[..., 1, 0])
    regular = cosine_b > 1e-9
    a = np.where(regular, np.arctan2(r[..., 1, 0], r[..., 0, 0]), np.arctan2(-r[..., 0, 1], r[..., 1, 1]))
    b = np.arctan2(-r[..., 2, 0], cosine_b)
    c = np.where(regular, np.arctan2(r[..., 2, 1], r[..., 2, 2]), 0.0)
    return np.stack([a, b, c], -1)


def rotation_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (..., 3, 3) of quaternions x, y, z, w, (..., 4), of any length above 0."""
    q = np.asarray(quaternion, float)
    return Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(q.shape[:-1] + (3, 3))


def tool_axis(quaternion: np.ndarray) -> np.ndarray:
    """Return unit vectors from the tool tip to the holder, (..., 3), of orientations of tcp x, y, z, w, (..., 4)."""
    return -rotation_from_quaternion(quaternion)[..., 2]


def lifted(position: np.ndarray, axis: np.ndarray, height: float) -> np.ndarray:
    """Return the place of a tool that goes up along its axis to a height [m], (3,); one above the height stays."""
    return position + axis * (max(height - position[2], 0.0) / axis[2])


def quaternion_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Return quaternions x, y, z, w with w >= 0, (..., 4), of rotation matrices (..., 3, 3)."""
    r = np.asarray(rotation, float)
    return Rotation.from_matrix(r.reshape(-1, 3, 3)).as_quat(canonical=True).reshape(r.shape[:-2] + (4,))


#: ``tool0`` in ``flange``: its z axis points out of the flange, as x of ``flange`` does; KUKA's $FLANGE
#: [kuka_experimental: "the $FLANGE coordinate system of the KRC"]
TOOL0 = Pose.from_abc(np.zeros(3), [0.0, np.pi / 2, 0.0])
