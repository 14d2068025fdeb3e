"""All that the stiffness model says of one posture, as plain numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kr270_milling.config import build, read_tree
from kr270_milling.errors import ConfigError
from kr270_milling.frames import quaternion_from_rotation
from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.elastostatics import compliance, equilibrium, rotate_matrix, stiffness
from kr270_milling.robot.kinematics import jacobian, pose
from kr270_milling.robot.mass import cartesian_mass, mode_frequencies

__all__ = ["analyse", "read_arm"]


def read_arm(path: Path) -> tuple[Arm, Mount]:
    """Arm and mount of an arm or cell file; the tool point of a bare arm is its flange. Raises ConfigError."""
    tree = read_tree(path)
    if "arm" not in tree:
        raise ConfigError(path, "arm", None, "is missing; the file of an arm or a cell must have this group")
    bare = {"xyz_mm": [0.0, 0.0, 0.0], "abc_deg": [0.0, 0.0, 0.0]}
    return build(Arm, tree["arm"], path, "arm."), build(Mount, tree.get("mount", bare), path, "mount.")


def analyse(arm: Arm, mount: Mount, q: np.ndarray, wrench: np.ndarray, frame: str, gravity: bool) -> dict:
    """Pose, Jacobian, stiffness, compliance, deflection and natural frequencies at joints q (6,) [rad].

    wrench: (6,) [N, N m] at the tool point, in base or tool axes as ``frame`` says; all results in the same axes.
    The wrench is constant in the base frame while the arm deflects.
    """
    unloaded = pose(arm, mount, q)
    turn = unloaded.rotation.T if frame == "tool" else np.eye(3)  # base axes -> axes of the results
    both = np.kron(np.eye(2), turn)
    loaded = equilibrium(arm, mount, q, both.T @ wrench, gravity)
    shift = turn @ (loaded.pose.position - unloaded.position)
    turned = _rotation_vector(loaded.pose.rotation @ unloaded.rotation.T)
    soft = compliance(loaded, arm)
    masses = {model: cartesian_mass(arm, mount, q, model) for model in ("lumped", "consistent")}
    return {
        "position_m": unloaded.position,
        "quaternion_xyzw": quaternion_from_rotation(unloaded.rotation),
        "jacobian": both @ jacobian(arm, mount, q),
        "stiffness": rotate_matrix(stiffness(loaded, arm), turn),
        "compliance": rotate_matrix(soft, turn),
        "deflection": np.concatenate([shift, turn @ turned]),
        "joint_deflection_rad": loaded.theta,
        "mode_frequencies_hz": {model: mode_frequencies(soft, mass) for model, mass in masses.items()},
        "condition_number": float(np.linalg.cond(jacobian(arm, mount, q))),
    }


def _rotation_vector(rotation: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_rotvec()
