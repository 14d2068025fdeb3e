"""Load tests of a known arm; ``python test/campaigns.py`` makes config/load_tests.csv, which a test compares."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.show.report.identification.plan import load_text
from kr270_milling.studies.identification.measurements import Measurements, write_measurements
from kr270_milling.studies.identification.plan import Bench, Planner, candidates, read_test_pose, sorted_tests
from kr270_milling.studies.identification.problem import Problem

ARM, MOUNT = read_arm(find_file("test_piece.yaml"))
#: an arm that differs from its file by 10 to 30 %
TRUE = ARM.replace(joint_compliance=ARM.joint_compliance * [1.2, 0.8, 1.1, 0.9, 1.3, 0.85])
SIGMA = 20e-6  #: [m] of a laser tracker


def displacements(arm, mount, tests: Measurements, gravity: bool = True) -> np.ndarray:
    """What an arm would show in these load tests [m, rad], (n, 6)."""
    return Problem(arm, mount, tests, gravity).predict(np.ones(6))


def loads(rng, n: int = 20, point=None) -> Measurements:
    """Random postures, pulls of about 500 N in random directions at the tool point; nothing is measured yet."""
    q = ARM.joint_lower + (ARM.joint_upper - ARM.joint_lower) * rng.uniform(0.2, 0.8, (n, 6))
    q[:, 1] = np.radians(rng.uniform(-120.0, -40.0, n))
    wrench = np.hstack([500.0 * rng.normal(size=(n, 3)), np.zeros((n, 3))])
    place = np.tile(MOUNT.xyz if point is None else point, (n, 1))
    return Measurements(q, wrench, place, place, np.full((n, 6), np.nan), np.full((n, 6), SIGMA), True)


def measured(tests: Measurements, arm=TRUE, rng=None, sigma: float = SIGMA, known: bool = True) -> Measurements:
    """Translations that ``arm`` shows in these tests, with noise if a generator is given."""
    moved = displacements(arm, MOUNT, tests)
    if rng is not None:
        moved = moved + sigma * rng.normal(size=moved.shape)
    moved[:, 3:] = np.nan
    scale = tests.sigma if known else np.ones_like(tests.sigma)
    return dataclasses.replace(tests, displacement=moved, sigma=scale, sigma_known=known)


CONFIG = Path(__file__).resolve().parents[1] / "config"
#: of the arm that the example is measured on, as factors on Table 1 of [Klimchik2014]
FACTORS = np.array([1.18, 0.92, 1.10, 0.85, 1.12, 1.25])
NOTES = [
    "EXAMPLE, NOT MEASURED: 18 load tests planned for config/test_piece.yaml by `identify compliance --plan 18`,",
    "displacements by the model of an arm whose compliances are 1.18, 0.92, 1.10, 0.85, 1.12, 1.25 times those of",
    "Table 1 (Klimchik et al. 2014), with normal noise of 20 um on each coordinate. No raw data of a KR 270 were found",
    "in public; replace this table by your own.",
]


def load_tests(path) -> None:
    """The table of load tests."""
    pose = read_test_pose(find_file("test_piece.yaml"), MOUNT)
    choice = candidates(ARM, MOUNT, Bench(MOUNT.xyz), 500, 1)
    plan = sorted_tests(choice.take(Planner(ARM, MOUNT, choice, pose).best(18).rows))
    true = ARM.replace(joint_compliance=ARM.joint_compliance * FACTORS)
    moved = displacements(true, MOUNT, plan.tests)
    moved[:, :3] += 20e-6 * np.random.default_rng(270).normal(size=(len(moved), 3))
    moved[:, 3:] = np.nan
    remarks = [load_text(plan, row) for row in range(len(moved))]
    write_measurements(path, dataclasses.replace(plan.tests, displacement=moved), NOTES, remarks)


if __name__ == "__main__":
    load_tests(CONFIG / "load_tests.csv")
