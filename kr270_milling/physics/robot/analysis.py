"""Stiffness of an arm in one posture, as the command ``stiffness`` prints it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ModelError, ParameterError
from kr270_milling.base.parameter_file import read_tree
from kr270_milling.base.record import Record, build
from kr270_milling.physics.robot.arm import BARE, Arm, Mount
from kr270_milling.physics.robot.elastostatics import compliance, equilibrium, stiffness
from kr270_milling.physics.robot.kinematics import pose, rotate_matrix
from kr270_milling.physics.robot.mass import MODELS, cartesian_mass, mode_frequencies


@dataclass(frozen=True, eq=False)
class ArmFile(Record):
    """An arm file: the arm, and what is mounted on it if anything is."""

    arm: Arm
    mount: Mount = BARE


def read_arm(path) -> tuple[Arm, Mount]:
    """Arm and mount of an arm file or a cell file; without a mount the tool point is the flange."""
    tree = read_tree(path)
    if "workpiece" in tree:  # a cell: its other sections are not read here
        tree = {key: tree[key] for key in ("arm", "mount") if key in tree}
    file = build(ArmFile, tree, path)
    return file.arm, file.mount


def analyse(arm: Arm, mount: Mount, q, wrench, frame: str = "base", gravity: bool = False) -> dict:
    """Pose of the unloaded posture q [rad], (6,), and the loaded equilibrium under a wrench, as a dict for JSON.

    frame: "base", or "tool" for the axes of the unloaded tcp; wrench, matrices and deflection are in its axes.
    """
    if frame not in ("base", "tool"):
        raise ParameterError("frame", frame, "one of base, tool")
    start = pose(arm, mount, q)
    turn = np.eye(3) if frame == "base" else start.rotation.T  # base axes to the chosen ones
    both = np.kron(np.eye(2), turn)
    loaded = equilibrium(arm, mount, q, both.T @ np.asarray(wrench, float), gravity)
    condition = float(np.linalg.cond(loaded.jacobian))
    most_condition = 1e6  # its square times the rounding of 1e-16 is what the stiffness is wrong by
    if not condition <= most_condition:
        raise ModelError(
            "the arm is too near a singular posture for a stiffness: the condition number of its Jacobian is "
            f"{condition:.3g}, but must be at most {most_condition:g}"
        )
    shift = loaded.pose.position - start.position
    tilt = Rotation.from_matrix(loaded.pose.rotation @ start.rotation.T).as_rotvec()
    soft = compliance(loaded, arm)
    modes = {m: mode_frequencies(soft, cartesian_mass(arm, mount, loaded.posture, m)) for m in MODELS}
    return {
        "position_m": start.position.tolist(),
        "quaternion_xyzw": start.quaternion.tolist(),
        "jacobian": (both @ loaded.jacobian).tolist(),
        "stiffness": rotate_matrix(stiffness(loaded, arm), turn).tolist(),
        "compliance": rotate_matrix(soft, turn).tolist(),
        "deflection": (both @ np.concatenate([shift, tilt])).tolist(),
        "joint_deflection_rad": loaded.theta.tolist(),
        "mode_frequencies_hz": {m: frequencies.tolist() for m, frequencies in modes.items()},
        "condition_number": condition,
        "warnings": _warnings(arm, np.asarray(q, float), start.position),
    }


def _warnings(arm: Arm, q: np.ndarray, tip: np.ndarray) -> list[str]:
    """Return a sentence for each joint beyond its limits, and for a tool point or wrist below the floor."""
    beyond = np.flatnonzero((q > arm.joint_upper + 1e-9) | (q < arm.joint_lower - 1e-9))
    findings = [
        f"axis {k + 1} at {np.degrees(q[k]):.4g} deg is outside its limits, {np.degrees(arm.joint_lower[k]):.4g} to "
        f"{np.degrees(arm.joint_upper[k]):.4g} deg"
        for k in beyond.tolist()
    ]
    wrist = pose(arm, BARE, q)
    heights = {"tool point": tip[2], "flange": wrist.position[2]}
    findings += [f"the {name} is {-1e3 * z:.4g} mm below the floor" for name, z in heights.items() if z < 0.0]
    return findings
