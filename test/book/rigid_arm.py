"""The arm as rigid bodies in pinocchio: the oracle of the composite-rigid-body algorithm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

__all__ = ["rigid_arm"]


def tube(mass, vector, radius):
    """Inertia of a thin tube about its middle, by pinocchio's rotation and the textbook's principal moments."""
    length = np.linalg.norm(vector)
    across = mass * (radius**2 / 2 + length**2 / 12)
    turn = Rotation.align_vectors([vector / length], [[1.0, 0, 0]])[0].as_matrix()
    return turn @ np.diag([mass * radius**2, across, across]) @ turn.T


def rigid_arm(arm, mount):
    """The arm in pinocchio: each link's frame at O_(j-1), KUKA's axes, after the axes of a base that tilts."""
    model, parent = pin.Model(), 0
    for k in arm.base_axes.tolist():
        hinge = pin.JointModelRevoluteUnaligned(np.eye(3)[k])
        parent = model.addJoint(parent, hinge, pin.SE3.Identity(), f"base_{k}")
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    for j, axis in enumerate(axes):
        offset = np.zeros(3) if j == 0 else arm.link_vectors[j - 1]
        joint = pin.JointModelRevoluteUnaligned(np.array(axis, float))
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), offset), f"joint_{j + 1}")
        vector, mass = arm.link_vectors[j], arm.link_mass[j]
        own = tube(mass, vector, arm.link_section_radius[j]) if vector.any() else np.zeros((3, 3))
        model.appendBodyToJoint(parent, pin.Inertia(mass, arm.link_mass_centre[j] * vector, own), pin.SE3.Identity())
    rider = pin.Inertia(mount.mass, arm.link_vectors[5] + mount.mass_centre, np.diag(mount.inertia))
    model.appendBodyToJoint(parent, rider, pin.SE3.Identity())
    return model
