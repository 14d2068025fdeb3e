"""The N load tests that leave the smallest error at the cell's posture: optimal design by exchange.

Each test adds B = A^T A to the information M, A the derivatives of what it shows by the sought factors, in standard
deviations. Criteria, with cov = M^-1: test pose, trace(A_0 cov A_0^T) [Klimchik2012b]; A, trace(cov); D, det(cov).
All are of the form trace(W cov) but D, for which a test is worth log det(1 + A cov A^T).

rho^2 = trace(A_0 cov A_0^T), the test-pose criterion, is the mean square of the error of the displacement that the arm
is predicted to make under a test load: the arm that compensates with these compliances misses the target by rho.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.record import read_tree
from kr270_milling.cell.cell import read_cell
from kr270_milling.identification.candidates import Candidates
from kr270_milling.identification.compliance import Fit
from kr270_milling.identification.measurements import Measurements
from kr270_milling.identification.problem import Problem
from kr270_milling.robot.arm import Arm, Mount

__all__ = [
    "CRITERIA", "TEST_FORCE", "Design", "Planner", "at_posture", "pose_derivatives", "predicted_errors",
    "read_test_pose",
]  # fmt: skip

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


CRITERIA = ("test pose", "A", "D")
WEAK = 1.0  #: relative standard deviation of each number before anything is measured: regular from the first test on
SWEEPS = 20


@dataclass(frozen=True, eq=False)
class Design:
    """A choice of candidates and what it is worth."""

    rows: np.ndarray  #: (n,)
    pose_error: float  #: rho at the cell's posture [m]
    relative: np.ndarray  #: standard deviation of each factor, (p,)
    determinant: float  #: det(cov)^(1 / 2 p), a mean relative standard deviation


class Planner:
    """Chooses among candidates for one arm and one test pose."""

    def __init__(self, arm: Arm, mount: Mount, choice: Candidates, pose: Measurements, gravity: bool = True):
        tests = dataclasses.replace(choice.tests, displacement=np.zeros_like(choice.tests.displacement))
        problem = Problem(arm, mount, tests, gravity)
        columns = problem.derivatives(problem.start).reshape(len(tests), 6, -1)
        self._slopes = columns[:, :3]  # (m, 3, p): a tracker sees translations
        at_pose = pose_derivatives(problem, problem.start, pose)
        self._pose = np.einsum("kip,kiq->pq", at_pose, at_pose) / len(at_pose)

    def best(self, count: int, criterion: str = "test pose") -> Design:
        """A greedy choice, then exchanges of one test for another until none helps."""
        chosen: list[int] = []
        for _ in range(count):
            chosen.append(self._addition(chosen, criterion))
        for _ in range(SWEEPS):
            before = list(chosen)
            for i in range(count):
                others = chosen[:i] + chosen[i + 1 :]
                chosen[i] = self._addition(others, criterion)
            if chosen == before:
                break
        return self.design(chosen)

    def random(self, count: int, rng: np.random.Generator) -> Design:
        """Tests drawn blindly."""
        return self.design(rng.choice(len(self._slopes), count, replace=False))

    def design(self, rows) -> Design:
        """What a choice is worth."""
        covariance = self._covariance(rows)
        size = len(covariance)
        return Design(
            np.asarray(rows),
            float(np.sqrt(np.trace(self._pose @ covariance))),
            np.sqrt(np.diag(covariance)),
            float(np.exp(np.linalg.slogdet(covariance)[1] / (2 * size))),
        )

    def _covariance(self, rows) -> np.ndarray:
        slopes = self._slopes[list(rows)].reshape(-1, self._slopes.shape[-1])
        return np.linalg.inv(slopes.T @ slopes + np.eye(slopes.shape[1]) / WEAK**2)

    def _addition(self, others: list[int], criterion: str) -> int:
        """The candidate that helps most beside the others.

        cov' = cov - cov A^T (1 + A cov A^T)^-1 A cov [Woodbury].
        """
        covariance = self._covariance(others)
        spread = self._slopes @ covariance
        inner = np.eye(3) + spread @ np.swapaxes(self._slopes, -1, -2)
        if criterion == "D":
            gain = np.linalg.slogdet(inner)[1]
        else:
            weight = self._pose if criterion == "test pose" else np.eye(len(covariance))
            gain = np.trace(np.linalg.solve(inner, spread @ weight @ np.swapaxes(spread, -1, -2)), axis1=-2, axis2=-1)
        gain[others] = -np.inf
        return int(np.argmax(gain))
