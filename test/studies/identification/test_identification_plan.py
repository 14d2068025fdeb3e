"""Plans of load tests: the design is what it claims, the exchange finds the best of what can be enumerated."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from campaigns import ARM, MOUNT

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.show.report.identification.plan import blind_spots, write_plan
from kr270_milling.studies.identification.plan import (
    CRITERIA,
    Bench,
    Planner,
    candidates,
    read_test_pose,
    sorted_tests,
)

BENCH = Bench(MOUNT.xyz)
POSE = read_test_pose(find_file("test_piece.yaml"), MOUNT)


@pytest.fixture(scope="module")
def choice():
    return candidates(ARM, MOUNT, BENCH, 200, 3)


@pytest.fixture(scope="module")
def planner(choice):
    return Planner(ARM, MOUNT, choice, POSE)


def test_candidates_keep_to_limits_floor_and_distance(choice):
    q = choice.tests.q
    assert np.all((q > ARM.joint_lower) & (q < ARM.joint_upper)) and np.abs(q[:, [3, 5]]).max() <= np.pi
    point = forward(ARM, MOUNT, q).tool.position
    assert point[:, 2].min() > BENCH.lowest and point[:, 2].max() < BENCH.highest
    assert np.hypot(point[:, 0], point[:, 1]).min() > BENCH.nearest
    size = np.linalg.norm(choice.tests.wrench[:, :3], axis=1)
    assert size[choice.kind == 0] == pytest.approx(980.665) and size[choice.kind > 0] == pytest.approx(800.0)
    assert not choice.tests.wrench[choice.kind > 0, 2].any()


def test_each_criterion_wins_by_its_own_measure(planner):
    designs = {name: planner.best(10, name) for name in CRITERIA}
    measures = {"test pose": lambda d: d.pose_error, "A": lambda d: np.sum(d.relative**2), "D": lambda d: d.determinant}
    for name, measure in measures.items():
        assert min(designs, key=lambda n: measure(designs[n])) == name
        assert measure(designs[name]) < 0.7 * np.median([measure(planner.random(10, rng)) for rng in rngs(30)])


def rngs(count):
    return [np.random.default_rng(seed) for seed in range(count)]


def test_the_exchange_finds_the_best_of_all_choices():
    """All 4060 choices of 3 of 30 candidates."""
    few = candidates(ARM, MOUNT, BENCH, 8, 5)
    few = few.take(np.arange(30))
    planner = Planner(ARM, MOUNT, few, POSE)
    best = min(planner.design(rows).pose_error for rows in itertools.combinations(range(30), 3))
    assert planner.best(3).pose_error <= 1.02 * best


def test_more_tests_leave_less_error(planner):
    errors = [planner.best(n).pose_error for n in (6, 12, 24)]
    assert errors[0] > 1.2 * errors[1] > 1.44 * errors[2]


def test_masses_alone_leave_the_vertical_axis_unknown(choice):
    hung = choice.take(choice.kind == 0)
    relative = Planner(ARM, MOUNT, hung, POSE).best(12).relative
    assert relative[0] > 0.9 and relative[1:].max() < 0.3


def test_the_plan_is_sorted_by_load_and_written_for_the_controller(choice, planner, tmp_path):
    plan = sorted_tests(choice.take(planner.best(10).rows))
    assert np.all(np.diff(plan.kind) >= 0)
    files = write_plan(tmp_path, plan, ["a note"])
    program = files[1].read_bytes().decode("ascii")
    assert program.startswith("&ACCESS RVP\r\n") and "VERIFY IN T1" in program and program.endswith("END\r\n")
    for q in np.degrees(plan.tests.q):
        assert f"PTP {{A1 {q[0]:.4f},A2 {q[1]:.4f}," in program


def test_a_sentence_names_the_joints_that_a_plan_cannot_identify():
    relative = np.array([0.01, 0.02, 0.02, 0.05, 0.04, 1.0])
    (sentence,) = blind_spots(relative)
    assert sentence.startswith("joint 6: these tests hardly identify") and blind_spots(relative[:5]) == []
