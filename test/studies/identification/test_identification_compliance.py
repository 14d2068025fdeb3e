"""Compliances from load tests: exact without noise, honest intervals with it, and what cannot be identified."""

from __future__ import annotations

import dataclasses
import itertools

import campaigns
import numpy as np
import pytest
from campaigns import ARM, MOUNT, TRUE, displacements

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.plant import perturbed
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.physics.robot.elastostatics import equilibrium
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.show.report.identification.compliance import reason, sentences
from kr270_milling.show.report.identification.plan import blind_spots, write_plan
from kr270_milling.studies.identification.compliance import TooFewError, fit_compliance
from kr270_milling.studies.identification.plan import (
    CRITERIA,
    Bench,
    Planner,
    candidates,
    read_test_pose,
    sorted_tests,
)
from kr270_milling.studies.identification.problem import Cause, Exclusion, Problem, SoftArmError


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_displacements_are_those_of_the_loaded_equilibrium(rng):
    tests = campaigns.loads(rng)
    loaded, rest = (equilibrium(ARM, MOUNT, tests.q, w).pose.position for w in (tests.wrench, None))
    assert displacements(ARM, MOUNT, tests)[:, :3] == pytest.approx(loaded - rest, abs=1e-12)


def test_derivatives_are_those_of_differences(rng):
    problem = Problem(ARM, MOUNT, dataclasses.replace(campaigns.loads(rng), displacement=np.zeros((20, 6))))
    columns, step = problem.derivatives(np.ones(6)), 1e-4 * np.eye(6)
    for k in range(6):
        by_difference = (problem.residuals(1 + step[k]) - problem.residuals(1 - step[k])) / 2e-4
        assert columns[:, k] == pytest.approx(by_difference, abs=2e-3 * np.abs(columns[:, k]).max())


def test_without_noise_the_compliances_are_fitted_exactly(rng):
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(campaigns.loads(rng))))
    assert fitted.values == pytest.approx(TRUE.joint_compliance, rel=1e-7)
    assert fitted.free.all() and fitted.residual_rms < 1e-10


def test_gravity_matters_and_can_be_left_out(rng):
    """The derivative of the weights' torque (15) is a part of the stiffness."""
    seen = campaigns.measured(campaigns.loads(rng))
    off = fit_compliance(Problem(ARM, MOUNT, seen, gravity=False)).values
    assert 1e-4 < np.abs(off / TRUE.joint_compliance - 1).max() < 0.05


@pytest.mark.parametrize("known", [True, False])
def test_intervals_cover_the_truth(known):
    """60 campaigns x 6 joints; 400 campaigns are in the verification book. sqrt(0.95 x 0.05 / 360) = 1.1 %."""
    rng = np.random.default_rng(3)
    hits = []
    for _ in range(60):
        fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(campaigns.loads(rng), rng=rng, known=known)))
        hits.append(np.abs(fitted.values - TRUE.joint_compliance) <= fitted.half_widths)
    assert 0.91 <= np.mean(hits) <= 0.99


def test_a_joint_that_no_load_turned_is_named(rng):
    """Force and reflector at the flange's centre: axis 6 passes through it."""
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(campaigns.loads(rng, point=np.zeros(3)), rng=rng)))
    assert fitted.free.tolist() == [True] * 5 + [False]
    assert reason(fitted, 5) == "joint 6: no load turned it"
    assert fitted.values[5] == ARM.joint_compliance[5] and fitted.half_widths[5] == np.inf


def test_a_reflector_on_the_axis_differs_from_a_load_on_the_axis(rng):
    tests = dataclasses.replace(campaigns.loads(rng), reflector=np.zeros((20, 3)))
    assert fit_compliance(Problem(ARM, MOUNT, campaigns.measured(tests))).exclusions[5].cause is Cause.ON_AXIS


def test_weights_alone_do_not_turn_the_vertical_axis(rng):
    tests = campaigns.loads(rng)
    tests.wrench[:, :2] = 0.0
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(tests)))
    assert fitted.exclusions == {0: Exclusion(Cause.NO_LOAD)}


def test_published_compliances_are_identified_from_hanging_loads(rng):
    """250 to 280 kg that hang: joints 2 to 6, as the table of 2013 has them, and not joint 1, which it lacks."""
    table = [0.302, 0.406, 3.002, 3.303, 2.365]  # [Klimchik2013a], Table IV, at second hand
    arm, mount = read_arm(find_file("kr270_2_identified_2013.yaml"))
    weights = campaigns.loads(rng, 15, point=[0.0, 0.15, 0.2])
    weights.wrench[:, :3] = np.column_stack([np.zeros((15, 2)), -9.81 * rng.uniform(250.0, 280.0, 15)])
    moved = displacements(arm, mount, weights)
    moved[:, 3:] = np.nan
    fitted = fit_compliance(Problem(ARM, mount, dataclasses.replace(weights, displacement=moved)))
    assert fitted.free.tolist() == [False, *[True] * 5]
    assert 1e6 * fitted.values[1:] == pytest.approx(table, rel=1e-6)
    assert 1e6 * fitted.values[0] == pytest.approx(0.26)  # stays as Table 1 has it


def test_joints_that_move_alike_are_not_identified(rng):
    """One posture, one load: three numbers, of which axes 2, 3 and 5 make two."""
    tests = campaigns.loads(rng, 1)
    many = tests.take(np.zeros(8, int))
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(many)))
    assert fitted.free.sum() <= 3
    assert [e.cause for e in fitted.exclusions.values()].count(Cause.ALIKE) == 3


def test_a_joint_whose_effect_is_below_the_noise_keeps_the_value_of_the_file(rng):
    tests = campaigns.loads(rng)
    tests.wrench[:] *= 0.01
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(tests, rng=rng)))
    assert not fitted.free.all() and Cause.NOISE in [e.cause for e in fitted.exclusions.values()]
    assert np.all(fitted.values > 0.0)


def test_robust_fit_withstands_outliers_that_the_plain_one_does_not(rng):
    seen = campaigns.measured(campaigns.loads(rng, 30), rng=rng)
    seen.displacement[[3, 11, 20], :3] += 3e-3
    plain, robust = (fit_compliance(Problem(ARM, MOUNT, seen), robust=r) for r in (False, True))
    errors = [np.abs(f.values / TRUE.joint_compliance - 1).max() for f in (plain, robust)]
    assert errors[1] < 0.2 * errors[0]
    assert np.flatnonzero(robust.weights == 0.0).tolist() == [3, 11, 20]
    assert np.all(np.abs(robust.values - TRUE.joint_compliance) < 2 * robust.half_widths)


def test_stated_noise_that_is_too_small_widens_the_intervals(rng):
    tests = campaigns.loads(rng)
    honest = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(tests, rng=rng)))
    seen = campaigns.measured(tests, rng=rng)
    bold = fit_compliance(Problem(ARM, MOUNT, dataclasses.replace(seen, sigma=seen.sigma / 5)))
    assert bold.half_widths == pytest.approx(honest.half_widths, rel=0.4)
    assert bold.chi2_reduced > 15


def test_a_sentence_warns_of_displacements_against_the_loads(rng):
    seen = campaigns.measured(campaigns.loads(rng), rng=rng)
    right, wrong = (fit_compliance(Problem(ARM, MOUNT, dataclasses.replace(seen, displacement=s * seen.displacement)))
                    for s in (1, -1))  # fmt: skip
    assert any("look at the signs" in text for text in sentences(wrong))
    assert not any("look at the signs" in text for text in sentences(right))


def test_rotations_help_where_they_are_measured(rng):
    tests = campaigns.loads(rng)
    shifts = campaigns.measured(tests)
    both = dataclasses.replace(shifts, displacement=displacements(TRUE, MOUNT, tests))
    widths = [fit_compliance(Problem(ARM, MOUNT, m)).half_widths for m in (shifts, both)]
    assert np.all(widths[1] < widths[0])


def test_the_compensator_is_identified(rng):
    spring = GravityCompensator(stiffness=200e3, preload=20e3, base_x=-0.69, base_z=0.12, arm_length=0.4)
    tests = campaigns.loads(rng, 40)
    tests.wrench[:, 2] -= 2000.0
    true = TRUE.replace(compensator=spring)
    seen = campaigns.measured(tests, arm=true, rng=rng, sigma=1e-6)
    start = ARM.replace(compensator=spring.replace(stiffness=150e3, preload=15e3))
    fitted = fit_compliance(
        Problem(start, MOUNT, dataclasses.replace(seen, sigma=seen.sigma / 20), True, ("stiffness", "preload"))
    )
    assert np.all(np.abs(fitted.values[6:] - [200e3, 20e3]) < 2 * fitted.half_widths[6:])
    assert fitted.half_widths[6] < 50e3


def test_too_few_numbers_and_an_arm_that_falls_are_refused(rng):
    tests = campaigns.measured(campaigns.loads(rng, 2))
    with pytest.raises(TooFewError, match="6 measured numbers"):
        fit_compliance(Problem(ARM, MOUNT, tests))
    with pytest.raises(SoftArmError, match="no equilibrium under the load of row"):
        Problem(ARM, MOUNT, tests).predict(np.full(6, 1e4))


# --- Identified intervals reach the plants of the verdict ---


SPREADS = [0.01, 0.02, 0.04, 0.08, 0.16, 0.32]


def factors(*settings: str) -> np.ndarray:
    """Of the compliances and of the coefficients K_tc, K_ac, K_ae of 400 plants with a sharp tool, (400, 9)."""
    cell = read_cell(
        find_file("test_piece.yaml"),
        ["cutting.linear_edge.axial_edge_n_per_mm=-3", "uncertainty.tool_wear=0", *settings],
    )
    rng = np.random.default_rng(6)
    return np.array([known(perturbed(cell, rng)) for _ in range(400)]) / known(cell)


def known(cell) -> list[float]:
    law = cell.cutting.linear_edge
    return [*cell.arm.joint_compliance, law.tangential_cutting, law.axial_cutting, law.axial_edge]


def test_each_joint_and_each_coefficient_scatters_by_its_own_spread():
    """Log-normal of relative deviation v: ln has the deviation sqrt(ln(1 + v^2)); 400 samples know it to 3.5 %."""
    joints = f"uncertainty.joint_compliances={SPREADS}"
    for given, axial in (([0.05, 0.1, 0.1, 0.1], [0.3, 0.3]), ([0.05, 0.1, 0.1, 0.1, 0.2, 0.3], [0.2, 0.3])):
        drawn = np.log(factors(joints, f"uncertainty.force_coefficients={given}")).std(0)
        assert drawn == pytest.approx(np.sqrt(np.log1p(np.square([*SPREADS, 0.05, *axial]))), rel=0.12)


def test_without_them_the_common_spread_holds():
    spread = np.array([0.15] * 6 + [0.3] * 3)
    assert np.log(factors()).std(0) == pytest.approx(np.sqrt(np.log1p(spread**2)), rel=0.12)


def test_lists_of_another_length_are_refused():
    with pytest.raises(ParameterError, match="empty or one number"):
        factors("uncertainty.force_coefficients=[0.1]")


# --- Plans of load tests: the design is what it claims, the exchange finds the best of what can be enumerated ---


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


TILTING = TRUE.replace(base_compliance=np.array([0.08e-6, 0.08e-6, 0.0]))  # [rad/(N m)] about x, y, z of base_link


def tilting_campaign(rng, tests):
    """Tests of an arm on a base that tilts: the difference of two equilibria, by elastostatics, with noise."""
    loaded, rest = (equilibrium(TILTING, MOUNT, tests.q, w).pose.position for w in (tests.wrench, None))
    moved = np.full((len(tests), 6), np.nan)
    moved[:, :3] = loaded - rest + campaigns.SIGMA * rng.normal(size=(len(tests), 3))
    return dataclasses.replace(tests, displacement=moved)


def test_intervals_cover_the_truth_with_the_base_among_the_unknowns_and_miss_the_truth_without():
    """40 campaigns x 8 numbers: sqrt(0.95 x 0.05 / 320) = 1.2 %; 300 campaigns gave 94.5 %."""
    rng, hits, missed = np.random.default_rng(3), [], []
    true = np.append(TILTING.joint_compliance, TILTING.base_compliance[:2])
    for _ in range(40):
        seen = tilting_campaign(rng, campaigns.loads(rng))
        fitted = fit_compliance(Problem(ARM, MOUNT, seen, base=True))
        hits.append(np.abs(fitted.values - true) <= fitted.half_widths)
        missed.append(abs(fit_compliance(Problem(ARM, MOUNT, seen)).factors[1] / 0.8 - 1.0))
    assert 0.91 <= np.mean(hits) <= 0.99
    assert np.mean(missed) > 0.5


def test_a_base_that_the_loads_do_not_tilt_is_named_and_widens_the_intervals(rng):
    """One load in one posture, 20 times: no combination of numbers but three is identified."""
    tests = campaigns.loads(rng, 1).take(np.zeros(20, int))
    fitted = fit_compliance(Problem(ARM, MOUNT, tilting_campaign(rng, tests), base=True))
    assert fitted.free.sum() <= 3 and not fitted.free[6:].all()
    named = [text for text in sentences(fitted) if text.startswith("not identified: base")]
    assert len(named) >= 2 and "joint 1" in named[-1]


def test_a_known_base_of_the_arm_file_is_a_part_of_the_model(rng):
    known = ARM.replace(base_compliance=TILTING.base_compliance)
    seen = tilting_campaign(rng, campaigns.loads(rng))
    fitted = fit_compliance(Problem(known, MOUNT, seen))
    assert np.abs(fitted.values / TILTING.joint_compliance - 1.0).max() < 0.25
    assert fitted.chi2_reduced < 1.7
    problem = Problem(known, MOUNT, seen, base=True)
    columns, step = problem.derivatives(problem.start), 1e-4 * np.eye(8)
    for k in (0, 6, 7):
        by_difference = (problem.residuals(1 + step[k]) - problem.residuals(1 - step[k])) / 2e-4
        assert columns[:, k] == pytest.approx(by_difference, abs=2e-3 * np.abs(columns[:, k]).max())
