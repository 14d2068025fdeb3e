"""How wrong the identified arm may be where it is to mill: the test-pose criterion of [Klimchik2012b].

rho^2 = trace(A_0 cov A_0^T): the mean square of the error of the displacement that the arm is predicted to make under a
test load, A_0 its derivative by the sought factors and cov their covariance. The arm that compensates with these
compliances misses the target by rho.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from kr270_milling.base.record import read_tree
from kr270_milling.cell.cell import read_cell
from kr270_milling.identification.compliance import Fit
from kr270_milling.identification.measurements import Measurements
from kr270_milling.identification.problem import Problem
from kr270_milling.robot.arm import Mount

__all__ = ["TEST_FORCE", "at_posture", "pose_derivatives", "predicted_errors", "read_test_pose"]

TEST_FORCE = 100.0  #: [N] along each axis in turn, what milling of aluminium asks of the arm


def at_posture(mount: Mount, q) -> Measurements:
    """TEST_FORCE along x, y and z of the base at the tool point of posture q (6,) [rad], as tests without a result."""
    place, nothing = np.tile(mount.xyz, (3, 1)), np.full((3, 6), np.nan)
    wrench = np.hstack([TEST_FORCE * np.eye(3), np.zeros((3, 3))])
    return Measurements(np.tile(np.asarray(q, float), (3, 1)), wrench, place, place, nothing, np.ones((3, 6)), True)


def read_test_pose(path, mount: Mount) -> Measurements | None:
    """``at_posture`` in the middle of a cell's path; None for a file that is no cell."""
    if "workpiece" not in read_tree(path):
        return None
    cell = read_cell(path)
    run = cell.target()
    middle = len(run) // 2
    place, turn = run.position[middle : middle + 1], run.quaternion[middle : middle + 1]
    return at_posture(mount, cell.joints_at(place, turn)[0])


def pose_derivatives(problem: Problem, factors, pose: Measurements) -> np.ndarray:
    """A_0 of each force: translation of the tool by the factors, (k, 3, p) [m]."""
    seen = dataclasses.replace(pose, displacement=np.zeros_like(pose.displacement))
    at = dataclasses.replace(problem, measured=seen)
    return at.derivatives(factors).reshape(len(seen), 6, -1)[:, :3]


def predicted_errors(found: Fit, pose: Measurements) -> tuple[np.ndarray, np.ndarray]:
    """Translation of the tool under each force [m], (k, 3), and the standard deviation rho of its error [m], (k,)."""
    slopes = pose_derivatives(found.problem, found.factors, pose)
    square = np.einsum("kip,pq,kiq->k", slopes, found.covariance, slopes)
    at = dataclasses.replace(found.problem, measured=pose)
    return at.predict(found.factors)[:, :3], np.sqrt(np.maximum(square, 0.0))
