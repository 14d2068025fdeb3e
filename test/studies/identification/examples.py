"""Make the example tables of config/: ``python test/studies/identification/examples.py``. A test compares them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from campaigns import ARM, MOUNT, displacements

from kr270_milling.base.record import find_file
from kr270_milling.show.report.identification.plan import load_text
from kr270_milling.studies.identification.measurements import write_measurements
from kr270_milling.studies.identification.plan import Bench, Planner, candidates, read_test_pose, sorted_tests

CONFIG = Path(__file__).resolve().parents[3] / "config"
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
