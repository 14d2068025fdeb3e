"""Checks of the arm along a trajectory: reach, joint limits, singularities, configuration, joint rates, backlash."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.cell import Cell
from kr270_milling.decision.path_limits import Violation, axis_reversals, joint_accelerations, joint_speeds
from kr270_milling.robot import inverse_near, jacobian, singularity_measures, status_turn
from kr270_milling.robot.errors import SingularityError
from kr270_milling.robot.inverse import branches
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["arm_violations", "runs"]


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


def runs(over: np.ndarray, badness: np.ndarray) -> list[tuple[int, str]]:
    """For each run of True in ``over`` (n,): the worst index, and its points in words, counted from 1."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(over, np.int8), [0]]))).reshape(-1, 2)
    found = []
    for start, stop in edges.tolist():
        worst = start + int(np.argmax(badness[start:stop]))
        found.append((worst, f"point {stop}" if stop - start == 1 else f"points {start + 1} to {stop}"))
    return found


def _reach(cell: Cell, tool: Pose) -> list[Violation]:
    angles, distance = branches(cell.arm, cell.mount, tool, cell.posture)
    lost = ~np.isfinite(angles).all(-1).any(-1)
    nearest = distance.min(-1)
    least, most = abs(cell.arm.a2 - cell.arm.forearm), cell.arm.a2 + cell.arm.forearm
    found = []
    for k, where in runs(lost, np.maximum(nearest - most, least - nearest)):
        sentence = (
            f"out of reach at {where}: the wrist centre would be {nearest[k]:.4f} m from axis 2 at point {k + 1}, but "
            f"the arm reaches from {least:.4f} to {most:.4f} m"
        )
        found.append(Violation("reach", k + 1, float(nearest[k]), most, "stop", sentence))
    return found


def _joint_limits(cell: Cell, joints: np.ndarray) -> list[Violation]:
    found = []
    for axis in range(6):
        angle, low, high = joints[:, axis], cell.arm.joint_lower[axis], cell.arm.joint_upper[axis]
        beyond = np.maximum(angle - high, low - angle)
        for k, where in runs(beyond > 1e-12, beyond):
            limit = high if angle[k] > high else low
            shown, bounds = np.degrees(angle[k]), f"{np.degrees(low):g} to {np.degrees(high):g}"
            sentence = f"axis {axis + 1} leaves its range of {bounds} deg at {where}: {shown:.3f} deg at point {k + 1}"
            found.append(
                Violation("joint limit", k + 1, float(angle[k]), float(limit), "stop", sentence, f"axis {axis + 1}")
            )
    return found


def _singularities(cell: Cell, joints: np.ndarray) -> list[Violation]:
    arm, limits = cell.arm, cell.limits
    measures = singularity_measures(arm, joints) * [arm.a2 + arm.forearm, 1.0, 1.0]
    rows = [
        ("shoulder", measures[:, 0], limits.shoulder_distance, 1e3, "mm from axis 1 to the wrist centre"),
        ("elbow", np.arcsin(np.minimum(measures[:, 1], 1.0)), limits.elbow_angle, 180 / np.pi, "deg of the stretched "
         "arm"),
        ("wrist", np.arcsin(np.minimum(measures[:, 2], 1.0)), limits.wrist_angle, 180 / np.pi, "deg of A5"),
    ]  # fmt: skip
    found = []
    for which, value, least, scale, what in rows:
        for k, where in runs(value < least, -value):
            sentence = (
                f"near the {which} singularity at {where}: {value[k] * scale:.4g} {what} at point {k + 1}, at least "
                f"{least * scale:.4g} is wanted"
            )
            found.append(Violation("singularity", k + 1, float(value[k]), least, "stop", sentence, which))
    return found


def _flips(cell: Cell, joints: np.ndarray) -> list[Violation]:
    status, _ = status_turn(cell.arm, joints)
    found = []
    for k in np.flatnonzero(np.diff(status)).tolist():
        before, after = int(status[k]), int(status[k + 1])
        sentence = f"the configuration flips between points {k + 1} and {k + 2}: status S {before} becomes {after}"
        found.append(Violation("configuration flip", k + 2, float(after), float(before), "stop", sentence))
    return found
