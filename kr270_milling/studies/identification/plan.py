"""The N load tests that leave the smallest error at the cell's posture: candidates, optimal design, files to do it.

Each test adds B = A^T A to the information M, A the derivatives of what it shows by the sought factors, in standard
deviations. Criteria, with cov = M^-1: test pose, trace(A_0 cov A_0^T) [Klimchik2012b]; A, trace(cov); D, det(cov).
All are of the form trace(W cov) but D, for which a test is worth log det(1 + A cov A^T).

rho^2 = trace(A_0 cov A_0^T), the test-pose criterion, is the mean square of the error of the displacement that the arm
is predicted to make under a test load: the arm that compensates with these compliances misses the target by rho.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.base.parameter_file import read_tree
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.kinematics import forward, singularity_measures
from kr270_milling.physics.robot.loads import GRAVITY
from kr270_milling.studies.identification.compliance import Measurements, Problem, unmeasured

MARGIN = np.radians(5.0)  #: distance to every joint limit
CRITERIA = ("test pose", "A", "D")


@dataclass(frozen=True, eq=False)
class Candidates:
    """m possible load tests, not measured yet."""

    tests: Measurements
    kind: np.ndarray  #: 0: mass, 1 to 3: pull outward, sideways, between both; (m,)

    def take(self, rows) -> Candidates:
        return Candidates(self.tests.take(rows), self.kind[rows])


def candidates(
    arm: Arm,
    mount: Mount,
    postures: int,
    seed: int,
    point: np.ndarray,
    mass: float = 100.0,
    pull: float = 800.0,
    sigma: float = 20e-6,
) -> Candidates:
    """Every load in up to ``postures`` postures spread evenly over the free space (Sobol').

    point: of the flange [m], (3,), where the loads act and the reflector is; mass [kg] hung there; pull [N] of a
    horizontal rope with a load cell, as no mass turns the vertical axis; sigma [m] of each measured coordinate.
    """
    q = _postures(arm, mount, point, postures, seed)
    kinds = np.flatnonzero([mass > 0.0, *[pull > 0.0] * 3])
    if not kinds.size:
        raise ParameterError("mass_kg and pull_n", [mass, pull], "above 0, one of them at least")
    outward = np.stack([np.cos(q[:, 0]), -np.sin(q[:, 0]), np.zeros(len(q))], -1)  # from axis 1
    sideways = np.stack([np.sin(q[:, 0]), np.cos(q[:, 0]), np.zeros(len(q))], -1)
    hang = np.tile([0.0, 0.0, -GRAVITY * mass], (len(q), 1))
    pulls = [pull * outward, pull * sideways, pull * (outward + sideways) / np.sqrt(2.0)]
    force = np.stack([hang, *pulls], 1)[:, kinds].reshape(-1, 3)
    tests = unmeasured(np.repeat(q, len(kinds), axis=0), force, point, sigma)
    return Candidates(tests, np.tile(kinds, len(q)))


def _postures(arm: Arm, mount: Mount, point_on_flange: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(k, 6) [rad], k up to ``count``."""
    low, high = arm.joint_lower + MARGIN, arm.joint_upper - MARGIN
    most_turn = np.radians(180.0)  # turn of axes 4 and 6, for the cables
    low[[3, 5]], high[[3, 5]] = np.maximum(low[[3, 5]], -most_turn), np.minimum(high[[3, 5]], most_turn)
    drawn = qmc.Sobol(6, seed=seed).random_base2(int(np.ceil(np.log2(16 * count))))
    q = low + (high - low) * drawn
    frames = forward(arm, mount, q)
    point = frames.flange.apply(point_on_flange)
    lowest = np.minimum(point[:, 2], frames.nodes[:, 2:, 2].min(1))
    above_base = 0.3  # [m], of tool and wrist
    within_reach = 2.2  # [m], of the tool, where a mass can still be hung
    from_axis = 0.9  # [m] from axis 1
    fits = (lowest > above_base) & (point[:, 2] < within_reach)
    fits &= np.hypot(point[:, 0], point[:, 1]) > from_axis
    fits &= np.hypot(*np.moveaxis(frames.nodes[:, 4, :2], -1, 0)) > from_axis
    least_measure = 0.1  # distance to the singularities of elbow and wrist: assumed
    fits &= (singularity_measures(arm, q)[:, 1:] > least_measure).all(1)
    if not fits.any():
        raise MillingError("no posture of this arm keeps its tool above the floor and away from its base")
    return q[fits][:count]


def at_posture(mount: Mount, q) -> Measurements:
    """Tests without a result: 100 N along x, y and z of the base at the tool point of posture q (6,) [rad]."""
    test_force = 100.0  # [N] along each axis in turn, what milling of aluminium asks of the arm
    return unmeasured(np.tile(np.asarray(q, float), (3, 1)), test_force * np.eye(3), mount.xyz, 1.0)


def read_test_pose(path, mount: Mount) -> Measurements | None:
    """``at_posture`` in the middle of a cell's path; None for a file that is no cell."""
    if "workpiece" not in read_tree(path):
        return None
    cell = read_cell(path)
    run = path_of(cell).target
    middle = len(run) // 2
    place, turn = run.position[middle : middle + 1], run.quaternion[middle : middle + 1]
    return at_posture(mount, arm_of(cell).joints_at(place, turn)[0])


@dataclass(frozen=True, eq=False)
class Design:
    """A choice of candidates and its expected precision."""

    rows: np.ndarray  #: (n,)
    pose_error: float  #: rho at the cell's posture [m]
    relative: np.ndarray  #: standard deviation of each factor, (p,)
    determinant: float  #: det(cov)^(1 / 2 p), a mean relative standard deviation


class Planner:
    """Choose among candidates for one arm and one test pose; base: whether the base is among the unknowns."""

    def __init__(
        self, arm: Arm, mount: Mount, choice: Candidates, pose: Measurements, gravity: bool = True, base: bool = False
    ):
        problem = Problem(arm, mount, choice.tests, gravity, base=base)
        self.names = problem.names  #: values of the sought numbers, (p,)
        self._slopes = problem.slopes(problem.start, choice.tests)  # (m, 3, p): a tracker sees translations
        at_pose = problem.slopes(problem.start, pose)
        self._pose = np.einsum("kip,kiq->pq", at_pose, at_pose) / len(at_pose)

    def best(self, count: int, criterion: str = "test pose") -> Design:
        """A greedy choice, then exchanges of one test for another until none helps."""
        chosen: list[int] = []
        for _ in range(count):
            chosen.append(self._addition(chosen, criterion))
        sweeps = 20
        for _ in range(sweeps):
            before = list(chosen)
            for i in range(count):
                chosen[i] = self._addition(chosen[:i] + chosen[i + 1 :], criterion)
            if chosen == before:
                break
        return self.design(chosen)

    def random(self, count: int, rng: np.random.Generator) -> Design:
        """Tests drawn blindly."""
        return self.design(rng.choice(len(self._slopes), count, replace=False))

    def design(self, rows) -> Design:
        """Return a choice with its expected precision."""
        covariance = self._covariance(rows)
        return Design(
            np.asarray(rows),
            float(np.sqrt(np.trace(self._pose @ covariance))),
            np.sqrt(np.diag(covariance)),
            float(np.exp(np.linalg.slogdet(covariance)[1] / (2 * len(covariance)))),
        )

    def _covariance(self, rows) -> np.ndarray:
        slopes = self._slopes[list(rows)].reshape(-1, self._slopes.shape[-1])
        # relative standard deviation of each number before anything is measured: regular from the first test on
        weak = 1.0
        return np.linalg.inv(slopes.T @ slopes + np.eye(slopes.shape[1]) / weak**2)

    def _addition(self, others: list[int], criterion: str) -> int:
        """Return the candidate that improves the criterion most.

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


def sorted_tests(plan: Candidates) -> Candidates:
    """Return the tests sorted by load, then by nearest posture: few changes of the load, short motions."""
    order: list[int] = []
    for kind in np.unique(plan.kind):
        left = np.flatnonzero(plan.kind == kind).tolist()
        here = plan.tests.q[order[-1]] if order else plan.tests.q[left].mean(0)
        while left:
            nearest = min(left, key=lambda row: float(np.abs(plan.tests.q[row] - here).max()))
            left.remove(nearest)
            order.append(nearest)
            here = plan.tests.q[nearest]
    return plan.take(np.array(order))
