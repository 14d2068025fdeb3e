"""Mass of rigid links on joint springs, the mass that fits the stiffness model: the composite-rigid-body algorithm.

Each link is a thin tube of ``link_section_radius`` along its vector, a link without length a point; spindle and tool
are a body with the moments of inertia ``mount.inertia``. Velocities are (v, omega) of the body point that is at the
origin of base_link, in base axes.
"""

from __future__ import annotations

import numpy as np

from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.kinematics import LinkFrames, cross, forward

__all__ = ["POINT", "own_inertia", "rigid_joint_mass", "spatial_inertia"]

POINT = 1e-9  #: a link shorter than this [m] is a point mass in its end node


def own_inertia(arm: Arm, j: int) -> np.ndarray:
    """Inertia (3, 3) [kg m^2] of link j = 0..5 about its mass centre, in the axes of its frame.

    A tube of length L and radius r: m r^2 along it, m (L^2 / 12 + r^2 / 2) across it.
    """
    vector, mass, radius = arm.link_vectors[j], arm.link_mass[j], arm.link_section_radius[j]
    length = np.linalg.norm(vector)
    if length < POINT:
        return np.zeros((3, 3))
    along = np.outer(vector, vector) / length**2
    return mass * radius**2 * along + mass * (length**2 / 12 + radius**2 / 2) * (np.eye(3) - along)


def spatial_inertia(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(..., 6, 6) about the origin: [[m 1, -m c x], [m c x, I - m c x c x]] for a mass centre c (..., 3) [m].

    inertia: (..., 3, 3) about the mass centre; v . (this) . v is twice the kinetic energy.
    """
    crossing = cross(np.asarray(centre)[..., None, :], np.eye(3))  # rows c x e_k: the matrix of c x, transposed
    out = np.zeros(inertia.shape[:-2] + (6, 6))
    out[..., :3, :3] = mass * np.eye(3)
    out[..., :3, 3:] = mass * crossing
    out[..., 3:, :3] = -mass * crossing
    out[..., 3:, 3:] = inertia - mass * crossing @ crossing
    return out


def _bodies(arm: Arm, mount: Mount, frames: LinkFrames) -> list[np.ndarray]:
    """Spatial inertia (..., 6, 6) of what rides on each joint alone: its link, on joint 6 spindle and tool too."""
    found = []
    for j in range(6):
        start, turn = frames.nodes[..., j, :], frames.rotations[..., j, :, :]
        centre = start + arm.link_mass_centre[j] * (frames.nodes[..., j + 1, :] - start)
        found.append(spatial_inertia(arm.link_mass[j], centre, turn @ own_inertia(arm, j) @ np.swapaxes(turn, -1, -2)))
    turn = frames.rotations[..., 5, :, :]
    rider = turn @ np.diag(mount.inertia) @ np.swapaxes(turn, -1, -2)
    found[5] = found[5] + spatial_inertia(mount.mass, frames.mass_centre, rider)
    return found


def rigid_joint_mass(arm: Arm, mount: Mount, q) -> np.ndarray:
    """M_theta [kg m^2/rad^2], (..., 6, 6): M_ij = S_i^T I_max(i,j) S_j.

    S_j is the velocity of a body that joint j turns by 1 rad/s, I_j the inertia of all bodies that joint j moves.
    """
    frames = forward(arm, mount, q)
    screws = np.concatenate([cross(frames.nodes[..., :6, :], frames.axes), frames.axes], -1)  # S_j, (..., 6, 6)
    mass = np.zeros(screws.shape)
    composite = np.zeros(screws.shape)
    for j, body in reversed(list(enumerate(_bodies(arm, mount, frames)))):
        composite = composite + body
        carried = np.einsum("...ij,...j->...i", composite, screws[..., j, :])
        mass[..., j, : j + 1] = mass[..., : j + 1, j] = np.einsum("...ki,...i->...k", screws[..., : j + 1, :], carried)
    return mass
