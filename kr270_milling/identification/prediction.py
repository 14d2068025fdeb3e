"""How wrong the identified arm may be where it is to mill: the test-pose criterion of [Klimchik2012b].

rho^2 = trace(A_0 cov A_0^T): the mean square of the error of the displacement that the arm is predicted to make under a
test load, A_0 its derivative by the sought factors and cov their covariance. The arm that compensates with these
compliances misses the target by rho.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.record import read_tree
from kr270_milling.cell.cell import read_cell
from kr270_milling.identification.compliance import Fit
from kr270_milling.identification.measurements import Measurements
from kr270_milling.identification.problem import Problem
from kr270_milling.robot.arm import Mount

__all__ = ["TEST_FORCE", "TestPose", "pose_derivatives", "predicted_errors", "read_test_pose", "test_pose"]

TEST_FORCE = 100.0  #: [N] along each axis in turn, what milling of aluminium asks of the arm


@dataclass(frozen=True, eq=False)
class TestPose:
    """A posture and the forces on the tool there, as load tests of which nothing is measured."""

    __test__ = False  # not one of pytest

    loads: Measurements

    @property
    def q(self) -> np.ndarray:
        """Joint angles [rad], (6,)."""
        return self.loads.q[0]


def test_pose(mount: Mount, q, forces=None) -> TestPose:
    """Forces (k, 3) [N], base axes, default TEST_FORCE along x, y and z, at the tool point of posture q (6,) [rad]."""
    forces = TEST_FORCE * np.eye(3) if forces is None else np.asarray(forces, float)
    n = len(forces)
    place = np.tile(mount.xyz, (n, 1))
    nothing = np.full((n, 6), np.nan)
    postures = np.tile(np.asarray(q, float), (n, 1))
    wrench = np.hstack([forces, 0 * forces])
    return TestPose(Measurements(postures, wrench, place, place, nothing, np.ones((n, 6)), True))


test_pose.__test__ = False  # type: ignore[attr-defined]


def read_test_pose(path, mount: Mount) -> TestPose | None:
    """The posture in the middle of a cell's path; None for a file that is no cell."""
    if "workpiece" not in read_tree(path):
        return None
    cell = read_cell(path)
    run = cell.target()
    middle = len(run) // 2
    place, turn = run.position[middle : middle + 1], run.quaternion[middle : middle + 1]
    return test_pose(mount, cell.joints_at(place, turn)[0])


def pose_derivatives(problem: Problem, factors, pose: TestPose) -> np.ndarray:
    """A_0 of each force: translation of the tool by the factors, (k, 3, p) [m]."""
    seen = dataclasses.replace(pose.loads, displacement=np.zeros_like(pose.loads.displacement))
    at = dataclasses.replace(problem, measured=seen)
    return at.derivatives(factors).reshape(len(seen), 6, -1)[:, :3]


def predicted_errors(found: Fit, pose: TestPose) -> tuple[np.ndarray, np.ndarray]:
    """Translation of the tool under each force [m], (k, 3), and the standard deviation rho of its error [m], (k,)."""
    slopes = pose_derivatives(found.problem, found.factors, pose)
    square = np.einsum("kip,pq,kiq->k", slopes, found.covariance, slopes)
    at = dataclasses.replace(found.problem, measured=pose.loads)
    moved = at.model(found.factors).predict(found.values[:6])[:, :3]
    return moved, np.sqrt(np.maximum(square, 0.0))
