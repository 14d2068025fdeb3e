"""Compliances from load tests, plans of load tests, their tables, and the comparison of a measured pass."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from book import check
from samples import campaigns
from samples.campaigns import ARM, MOUNT, TRUE, displacements

from kr270_milling.base.errors import InputError, MillingError, ModelError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import path_of
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.physics.robot.elastostatics import equilibrium
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.show.report.identification.comparison import advice
from kr270_milling.show.report.identification.compliance import reason
from kr270_milling.studies.identification import comparison
from kr270_milling.studies.identification.comparison import ComparedSeries
from kr270_milling.studies.identification.compliance import Problem, fit_compliance, read_measurements
from kr270_milling.studies.identification.plan import Planner, candidates, read_test_pose


@pytest.fixture
def rng():
    return np.random.default_rng(7)


#: on a base that tilts about x and y of base_link [rad/(N m)]
TILTING = TRUE.replace(base_compliance=np.array([0.08e-6, 0.08e-6, 0.0]))


@pytest.mark.parametrize("arm", [ARM, TILTING], ids=["rigid base", "tilting base"])
def test_displacements_are_those_of_the_loaded_equilibrium(rng, arm):
    tests = campaigns.loads(rng)
    loaded, rest = (equilibrium(arm, MOUNT, tests.q, w).pose.position for w in (tests.wrench, None))
    assert displacements(arm, MOUNT, tests)[:, :3] == pytest.approx(loaded - rest, abs=1e-12)


def test_without_noise_the_compliances_are_fitted_exactly_unless_gravity_is_left_out(rng):
    """The derivative of the weights' torque (15) is a part of the stiffness."""
    seen = campaigns.measured(campaigns.loads(rng))
    fitted = fit_compliance(Problem(ARM, MOUNT, seen))
    assert fitted.values == pytest.approx(TRUE.joint_compliance, rel=1e-7)
    assert fitted.free.all() and fitted.residual_rms < 1e-10
    off = fit_compliance(Problem(ARM, MOUNT, seen, gravity=False)).values
    assert 1e-4 < np.abs(off / TRUE.joint_compliance - 1).max() < 0.05


CAMPAIGNS = 400


@check(
    f"95 % intervals of compliances that cover the truth, {CAMPAIGNS} campaigns",
    "0.95; 12 random load tests each, 20 um of noise; 2 % are allowed, 2 standard deviations are 0.9 % [derived]",
)
def test_coverage():
    return 0.95, campaigns.covered_compliances(11, CAMPAIGNS, 12).mean(), 0.02


@check(
    "error at the test pose, planned campaign / random postures with the same loads",
    "at most 1/2: root mean square of 60 campaigns of 12 load tests each",
    at_most=True,
)
def test_plan():
    """The error is that of the displacement predicted for 100 N along each axis, against the true arm."""
    rng, choice = np.random.default_rng(12), candidates(ARM, MOUNT, 1000, 2, MOUNT.xyz)
    planned = Planner(ARM, MOUNT, choice, POSE).best(12).rows
    kinds = [np.flatnonzero(choice.kind == kind) for kind in choice.kind[planned]]
    true = displacements(TRUE, MOUNT, POSE)[:, :3]

    def error(rows) -> float:
        seen = campaigns.measured(choice.tests.take(rows), rng=rng, sigma=choice.tests.sigma[0])
        fitted = fit_compliance(Problem(ARM, MOUNT, seen))
        return float(np.sum((displacements(fitted.problem.arm_at(fitted.factors), MOUNT, POSE)[:, :3] - true) ** 2))

    ours = np.mean([error(planned) for _ in range(60)])
    blind = np.mean([error(np.array([rng.choice(rows) for rows in kinds])) for _ in range(60)])
    return 0.5, math.sqrt(ours / blind), 0.0


def test_each_cause_of_a_joint_that_is_not_identified_is_named(rng):
    """Force and reflector at the flange's centre: axis 6 passes through it. One posture and one load: three numbers."""
    tests, along_axis_6 = campaigns.loads(rng), campaigns.loads(rng, point=np.zeros(3))
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(along_axis_6, rng=rng)))
    assert fitted.free.tolist() == [True] * 5 + [False] and reason(fitted, 5) == "joint 6: no load turned it"
    assert fitted.values[5] == ARM.joint_compliance[5] and fitted.half_widths[5] == np.inf
    on_axis = dataclasses.replace(tests, reflector=np.zeros((20, 3)))
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(on_axis)))
    assert "on its axis" in fitted.exclusions[5]
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(tests.take(np.zeros(8, int)))))
    assert fitted.free.sum() <= 3 and sum("in every test" in reason for reason in fitted.exclusions.values()) == 3
    tests.wrench[:] *= 0.01  # the effect of a joint is below the noise
    fitted = fit_compliance(Problem(ARM, MOUNT, campaigns.measured(tests, rng=rng)))
    assert not fitted.free.all() and any("below the noise" in reason for reason in fitted.exclusions.values())
    assert np.all(fitted.values > 0.0)


def test_published_compliances_are_identified_from_hanging_loads(rng):
    """250 to 280 kg that hang: joints 2 to 6, as the table of 2013 has them, and not joint 1, which it lacks."""
    table = [0.302, 0.406, 3.002, 3.303, 2.365]  # [Klimchik2013a], Table IV, at second hand
    arm, mount = read_arm(find_file("kr270_2_identified_2013.yaml"))
    weights = campaigns.loads(rng, 15, point=[0.0, 0.15, 0.2])
    weights.wrench[:, :3] = np.column_stack([np.zeros((15, 2)), -9.81 * rng.uniform(250.0, 280.0, 15)])
    moved = displacements(arm, mount, weights)
    moved[:, 3:] = np.nan
    fitted = fit_compliance(Problem(ARM, mount, dataclasses.replace(weights, displacement=moved)))
    assert fitted.free.tolist() == [False, *[True] * 5] and fitted.exclusions == {0: "no load turned it"}
    assert 1e6 * fitted.values[1:] == pytest.approx(table, rel=1e-6)
    assert 1e6 * fitted.values[0] == pytest.approx(0.26)  # stays as Table 1 has it


def test_intervals_follow_the_residuals_where_the_stated_noise_is_too_small_and_rotations_narrow_them(rng):
    tests = campaigns.loads(rng)
    honest, seen = (campaigns.measured(tests, rng=rng) for _ in range(2))
    both = dataclasses.replace(honest, displacement=displacements(TRUE, MOUNT, tests))
    bold = dataclasses.replace(seen, sigma=seen.sigma / 5)
    honest, bold, both = (fit_compliance(Problem(ARM, MOUNT, m)) for m in (honest, bold, both))
    assert bold.half_widths == pytest.approx(honest.half_widths, rel=0.4) and bold.chi2_reduced > 15
    assert np.all(both.half_widths < honest.half_widths)


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
    with pytest.raises(ModelError, match="6 measured numbers"):
        fit_compliance(Problem(ARM, MOUNT, tests))
    with pytest.raises(ModelError, match="no equilibrium under the load of row"):
        Problem(ARM, MOUNT, tests).predict(np.full(6, 1e4))


# --- Plans of load tests: the design is what it claims, the exchange finds the best of what can be enumerated ---
POSE = read_test_pose(find_file("test_piece.yaml"), MOUNT)


@pytest.fixture(scope="module")
def choice():
    return candidates(ARM, MOUNT, 200, 3, MOUNT.xyz)


@pytest.fixture(scope="module")
def planner(choice):
    return Planner(ARM, MOUNT, choice, POSE)


def test_candidates_keep_to_limits_floor_and_distance(choice):
    q = choice.tests.q
    assert np.all((q > ARM.joint_lower) & (q < ARM.joint_upper)) and np.abs(q[:, [3, 5]]).max() <= np.pi
    point = forward(ARM, MOUNT, q).tool.position
    assert point[:, 2].min() > 0.3 and point[:, 2].max() < 2.2
    assert np.hypot(point[:, 0], point[:, 1]).min() > 0.9
    size = np.linalg.norm(choice.tests.wrench[:, :3], axis=1)
    assert size[choice.kind == 0] == pytest.approx(980.665) and size[choice.kind > 0] == pytest.approx(800.0)
    assert not choice.tests.wrench[choice.kind > 0, 2].any()


def test_the_exchange_finds_the_best_of_all_choices():
    """All 4060 choices of 3 of 30 candidates."""
    few = candidates(ARM, MOUNT, 8, 5, MOUNT.xyz).take(np.arange(30))
    planner = Planner(ARM, MOUNT, few, POSE)
    best = min(planner.design(rows).pose_error for rows in itertools.combinations(range(30), 3))
    assert planner.best(3).pose_error <= 1.02 * best


def test_masses_alone_leave_the_vertical_axis_unknown(choice):
    hung = choice.take(choice.kind == 0)
    relative = Planner(ARM, MOUNT, hung, POSE).best(12).relative
    assert relative[0] > 0.9 and relative[1:].max() < 0.3


def test_tests_planned_for_a_base_that_tilts_know_the_posture_better_than_those_for_a_rigid_base(choice, planner):
    tilting = Planner(ARM, MOUNT, choice, POSE, base=True)
    rigid, planned = tilting.design(planner.best(12).rows), tilting.best(12)
    assert planned.pose_error < 0.98 * rigid.pose_error and tilting.names[6:] == ["base x", "base y"]
    assert planned.relative[6:].max() < 0.5


# --- A base that tilts ---
def test_intervals_of_an_unknown_noise_and_base_cover_the_truth_and_without_the_base_they_miss():
    """40 campaigns x 8 numbers: sqrt(0.95 x 0.05 / 320) = 1.2 %; 300 campaigns gave 94.5 %."""
    rng, hits, missed = np.random.default_rng(3), [], []
    true = np.append(TILTING.joint_compliance, TILTING.base_compliance[:2])
    for _ in range(40):
        seen = campaigns.measured(campaigns.loads(rng), TILTING, rng, known=False)
        fitted = fit_compliance(Problem(ARM, MOUNT, seen, base=True))
        hits.append(np.abs(fitted.values - true) <= fitted.half_widths)
        missed.append(abs(fit_compliance(Problem(ARM, MOUNT, seen)).factors[1] / 0.8 - 1.0))
    assert 0.91 <= np.mean(hits) <= 0.99 and np.mean(missed) > 0.5


def test_a_known_base_of_the_arm_file_is_a_part_of_the_model(rng):
    known = ARM.replace(base_compliance=TILTING.base_compliance)
    seen = campaigns.measured(campaigns.loads(rng), TILTING, rng)
    fitted = fit_compliance(Problem(known, MOUNT, seen))
    assert np.abs(fitted.values / TILTING.joint_compliance - 1.0).max() < 0.25 and fitted.chi2_reduced < 1.7
    problem = Problem(known, MOUNT, seen, base=True)
    columns, step = problem.derivatives(problem.start), 1e-4 * np.eye(8)
    for column, by in zip(columns.T, step, strict=True):
        by_difference = (problem.residuals(1 + by) - problem.residuals(1 - by)) / 2e-4
        assert column == pytest.approx(by_difference, abs=2e-3 * np.abs(column).max())


# --- Tables of load tests in and out ---
HEAD = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg"
POSTURE = "10,-80,100,20,30,40"


def read(tmp_path, columns: str, row: str, posture: str = POSTURE):
    file = tmp_path / "tests.csv"
    file.write_text(f"# a note\n{HEAD},{columns}\n{posture},{row}\n")
    return read_measurements(file, ARM, MOUNT)


def test_loads_act_and_reflectors_are_at_the_tool_point_or_at_the_stated_place(tmp_path):
    result = read(tmp_path, "fx_n,fz_n,dx_mm,dy_mm,dz_mm,sigma_um", "100,-50,0.1,0.2,-0.3,15")
    assert result.q[0] == pytest.approx(np.radians([10, -80, 100, 20, 30, 40]))
    assert result.wrench[0].tolist() == [100, 0, -50, 0, 0, 0]
    assert result.application[0] == pytest.approx(MOUNT.xyz) and result.reflector[0] == pytest.approx(MOUNT.xyz)
    assert result.displacement[0] == pytest.approx([1e-4, 2e-4, -3e-4, *[np.nan] * 3], nan_ok=True)
    assert result.sigma[0, :3] == pytest.approx(15e-6) and result.sigma_known
    columns = "mass_kg,mass_centre_x_mm,mass_centre_y_mm,mass_centre_z_mm,reflector_x_mm,dx_mm,dy_mm,dz_mm"
    result = read(tmp_path, columns, "100,50,0,-400,120,0,0,-0.5")
    assert result.wrench[0] == pytest.approx([0, 0, -980.665, 0, 0, 0])
    assert result.application[0] == pytest.approx([0.05, 0, -0.4])
    assert result.reflector[0] == pytest.approx([0.12, 0, 0])
    assert not result.sigma_known


@pytest.mark.parametrize(("columns", "row", "posture", "text"), [
    ("dx_mm,dy_mm,dz_mm", "0,0,0", POSTURE, "neither a wrench nor a mass_kg"),
    ("fx_n,mass_kg,dx_mm,dy_mm,dz_mm", "1,1,0,0,0", POSTURE, "both a wrench and a mass"),
    ("fx_n,dx_mm,dy_mm,dz_mm", "0,0,0,0", POSTURE, "the load is zero"),
    ("mass_kg,dx_mm,dy_mm,dz_mm", "-5,0,0,-1", POSTURE, "mass_kg must be above 0"),
    ("fx_n,dx_mm,dy_mm,dz_mm", "1,250,0,0", POSTURE, "moved the arm by more than"),
    ("fx_n,dx_mm,dy_mm,dz_mm", "1,,0,0", POSTURE, "has no value in the column dx_mm"),
    ("fx_n,dx_mm,dy_mm,dz_mm,sigma_um", "1,0,0,0,0", POSTURE, "standard deviation must be above 0"),
    ("fx_n,dx_mm,dy_mm,dz_mm", "1,nan,0,0", POSTURE, "is not finite"),
    ("fx_n,dx_mm,dy_mm,dz_mm", "1,0,0,0", "0,80,0,0,0,0", "joint limits"),
])  # fmt: skip
def test_unusable_rows_are_refused_with_their_line(tmp_path, columns, row, posture, text):
    with pytest.raises(InputError, match=f"line 3.*{text}"):
        read(tmp_path, columns, row, posture)


# --- Compare a measured pass with the simulated pass: lag, gains and advice, for a known plant ---
CELL = read_cell(find_file("paper.yaml"), ["path.length_mm=40.0", "stock.grid_step_um=40.0"])


@pytest.fixture(scope="module")
def model():
    return simulate(CELL).result


def as_pass(result, lag=0.0, noise=0.0) -> ComparedSeries:
    force, place = noise * np.random.default_rng(4).normal(size=(2, *result.actual.shape))
    values = (result.wrench[:, :3] + 1e6 * force, result.actual + place)
    return {name: (result.time + lag, value) for name, value in zip(("force", "pose"), values, strict=True)}


def compared(measured: ComparedSeries, model):
    feed, revolution = path_of(CELL).target.sample_velocity(model.time_ns), 2 * np.pi / CELL.tool.spindle_speed
    return comparison.compare(measured, as_pass(model), model.target, feed, revolution)


@pytest.mark.parametrize("lag", [-0.2, 0.0, 0.137])
def test_the_same_pass_agrees_whatever_its_clock(model, lag):
    channels, lags, ringing = compared(as_pass(model, lag, noise=2e-6), model)
    assert lags == pytest.approx({"force": lag, "pose": lag}, abs=6e-4)
    assert all(abs(c.line.gain - 1.0) < 0.01 + 3 * c.line.gain_sigma for c in channels)
    assert all(c.line.gain_sigma < 0.03 for c in channels)
    assert advice(channels, ringing) == ["measurement and simulation agree: nothing to identify again"]


def test_advice_separates_larger_forces_from_a_softer_arm(model):
    law = CELL.cutting.fractional
    stronger = CELL.replace(cutting=CELL.cutting.replace(fractional=law.replace(stiffness=1.2 * law.stiffness)))
    channels, _, ringing = compared(as_pass(simulate(stronger).result, 0.1, 2e-6), model)
    sentences = advice(channels, ringing)
    assert any("identify forces" in s for s in sentences) and not any("identify compliance" in s for s in sentences)
    softer = CELL.replace(arm=CELL.arm.replace(joint_compliance=1.25 * CELL.arm.joint_compliance))
    channels, _, ringing = compared(as_pass(simulate(softer).result, 0.1, 2e-6), model)
    sentences = advice(channels, ringing)
    assert any("the deviation is 1.2" in s and "identify compliance" in s for s in sentences)
    assert not any("identify forces" in s for s in sentences)
    assert any("identify damping" in s for s in sentences)  # 1 / sqrt(1.25): 11 % lower
    assert ringing["measured"][0] == pytest.approx(ringing["simulated"][0] / np.sqrt(1.25), rel=0.02)


def test_a_force_alone_or_a_place_alone_is_compared_and_another_pass_is_refused(model):
    both = as_pass(model)
    assert set(compared({"force": both["force"]}, model)[1]) == {"force"}
    assert set(compared({"pose": both["pose"]}, model)[1]) == {"pose"}
    with pytest.raises(MillingError, match="neither a force nor a place"):
        compared({}, model)
    noise = np.random.default_rng(0).normal(size=model.wrench[:, :3].shape)
    with pytest.raises(ModelError, match="does not resemble"):
        compared({"force": (model.time, noise)}, model)


def test_the_line_of_a_known_series_and_its_standard_deviation():
    rng = np.random.default_rng(1)
    x = rng.normal(size=4000)
    line = comparison.line_through(1.3 * x + 2.0 + 0.1 * rng.normal(size=4000), x, 4000)
    assert line.gain == pytest.approx(1.3, abs=4 * line.gain_sigma) and line.offset == pytest.approx(2.0, abs=0.01)
    assert line.gain_sigma == pytest.approx(0.1 / np.sqrt(4000), rel=0.1)
