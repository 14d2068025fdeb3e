"""Cartesian stiffness of the loaded arm (11)-(17) of [Klimchik2012], in base_link axes at the tool point."""

from __future__ import annotations

import numpy as np

from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.equilibrium import Equilibrium, equilibrium
from kr270_milling.robot.kinematics import check_regular

__all__ = ["compliance", "loaded_stiffness", "rotate_matrix", "stiffness"]


def compliance(equilibrium: Equilibrium, arm: Arm) -> np.ndarray:
    """C_C = J (K_theta - H)^-1 J^T at the equilibrium, (..., 6, 6) in base axes; exists in singular postures too."""
    jacobian = equilibrium.jacobian
    springs = np.diag(arm.joint_stiffness) - equilibrium.hessian
    return jacobian @ np.linalg.solve(springs, np.swapaxes(jacobian, -1, -2))  # (17), its inverse


def stiffness(equilibrium: Equilibrium, arm: Arm) -> np.ndarray:
    """K_C at the equilibrium, (..., 6, 6) in base axes; raises SingularityError where J has no inverse."""
    check_regular(arm, equilibrium.posture)
    inverse = np.linalg.inv(equilibrium.jacobian)
    springs = np.diag(arm.joint_stiffness) - equilibrium.hessian
    return np.swapaxes(inverse, -1, -2) @ springs @ inverse  # (17) for a square J


def rotate_matrix(matrix: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """A 6x6 stiffness, compliance or mass matrix in other axes, same point.

    rotation (..., 3, 3) maps coordinates in the matrix's axes to the new axes: base to tool is ``pose.rotation.T``.
    """
    turn = np.zeros(np.broadcast_shapes(rotation.shape[:-2], matrix.shape[:-2]) + (6, 6))
    turn[..., :3, :3] = turn[..., 3:, 3:] = rotation
    return turn @ matrix @ np.swapaxes(turn, -1, -2)


def loaded_stiffness(arm: Arm, mount: Mount, q, wrench=None, gravity: bool = True) -> tuple[Equilibrium, np.ndarray]:
    """Pose, Jacobian and Hessian of the loaded postures (in the record), and K_C (17), for a whole batch."""
    solved = equilibrium(arm, mount, q, wrench, gravity)
    return solved, stiffness(solved, arm)
