"""Checks of the arm along a trajectory: reach, joint limits, singularities, configuration, joint rates, backlash."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.cell import Cell
from kr270_milling.decision.path_limits import (
    Violation,
    axis_reversals,
    joint_accelerations,
    joint_speeds,
    violations,
)  # fmt: skip
from kr270_milling.robot import inverse_near, jacobian, singularity_measures, status_turn
from kr270_milling.robot.errors import SingularityError
from kr270_milling.robot.inverse import branches
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["arm_violations"]


def arm_violations(cell: Cell, run: Trajectory) -> tuple[list[Violation], np.ndarray | None]:
    """Everything found about the arm, and the joint positions [rad], (n, 6); None where a point is out of reach."""
    tool = cell.workpiece.pose @ Pose(run.position, rotation_from_quaternion(run.quaternion))
    found = _reach(cell, tool)
    if found:
        return found, None
    unlimited = cell.arm.replace(joint_lower=np.full(6, -4 * np.pi), joint_upper=np.full(6, 4 * np.pi))
    try:
        joints = inverse_near(unlimited, cell.mount, tool, cell.posture)
    except SingularityError as error:
        point = error.index[0] + 1
        return [Violation("singularity", point, error.measure, 0.0, "stop", f"point {point}: {error}")], None
    at_rest = run.velocity is not None and not run.velocity[[0, -1]].any()
    found = _joint_limits(cell, joints) + _singularities(cell, joints) + _flips(cell, joints)
    found += joint_speeds(run.time_ns, joints, cell.arm.joint_speed_limit)
    found += joint_accelerations(run.time_ns, joints, cell.arm.joint_acceleration_limit, at_rest)
    lever = np.linalg.norm(jacobian(cell.arm, cell.mount, joints)[:, :3], axis=1)  # |d position / d joint|
    return found + axis_reversals(joints, cell.limits.backlash, lever), joints


def _reach(cell: Cell, tool: Pose) -> list[Violation]:
    angles, distance = branches(cell.arm, cell.mount, tool, cell.posture)
    lost, nearest = ~np.isfinite(angles).all(-1).any(-1), distance.min(-1)
    least, most = abs(cell.arm.a2 - cell.arm.forearm), cell.arm.a2 + cell.arm.forearm

    def sentence(k: int, point: int, where: str) -> str:
        return (
            f"out of reach at {where}: the wrist centre would be {nearest[k]:.4f} m from axis 2 at point {point}, but "
            f"the arm reaches from {least:.4f} to {most:.4f} m"
        )

    return violations("reach", lost, nearest, most, sentence, worst=np.maximum(nearest - most, least - nearest))


def _leaving(leaves: str, degrees: np.ndarray) -> Callable[[int, int, str], str]:
    return lambda k, point, where: f"{leaves}{where}: {degrees[k]:.3f} deg at point {point}"


def _joint_limits(cell: Cell, joints: np.ndarray) -> list[Violation]:
    found = []
    for axis, (low, high) in enumerate(zip(cell.arm.joint_lower, cell.arm.joint_upper, strict=True)):
        angle, name = joints[:, axis], f"axis {axis + 1}"
        beyond = np.maximum(angle - high, low - angle)
        leaves = f"{name} leaves its range of {np.degrees(low):g} to {np.degrees(high):g} deg at "
        degrees = np.degrees(angle)
        found += violations(
            "joint limit", beyond > 1e-12, angle, np.where(angle > high, high, low),
            _leaving(leaves, degrees),
            worst=beyond, subject=name,
        )  # fmt: skip
    return found


def _singularities(cell: Cell, joints: np.ndarray) -> list[Violation]:
    arm, limits = cell.arm, cell.limits
    measures = singularity_measures(arm, joints) * [arm.a2 + arm.forearm, 1.0, 1.0]
    elbow, wrist = np.arcsin(np.minimum(measures[:, 1:], 1.0)).T
    rows = [
        ("shoulder", measures[:, 0], limits.shoulder_distance, 1e3, "mm from axis 1 to the wrist centre"),
        ("elbow", elbow, limits.elbow_angle, 180 / np.pi, "deg of the stretched arm"),
        ("wrist", wrist, limits.wrist_angle, 180 / np.pi, "deg of A5"),
    ]
    found = []
    for which, value, least, scale, what in rows:

        def sentence(k: int, point: int, where: str, row=(which, value, least, scale, what)) -> str:
            name, measure, wanted, factor, unit = row
            shown = f"near the {name} singularity at {where}: {measure[k] * factor:.4g} {unit} at point {point}"
            return f"{shown}, at least {wanted * factor:.4g} is wanted"

        found += violations("singularity", value < least, value, least, sentence, worst=-value, subject=which)
    return found


def _flips(cell: Cell, joints: np.ndarray) -> list[Violation]:
    status, _ = status_turn(cell.arm, joints)
    found = []
    for k in np.flatnonzero(np.diff(status)).tolist():
        before, after = int(status[k]), int(status[k + 1])
        sentence = f"the configuration flips between points {k + 1} and {k + 2}: status S {before} becomes {after}"
        found.append(Violation("configuration flip", k + 2, float(after), float(before), "stop", sentence))
    return found
