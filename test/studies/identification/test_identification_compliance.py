"""Compliances from load tests: exact without noise, honest intervals with it, and what cannot be identified."""

from __future__ import annotations

import dataclasses

import campaigns
import numpy as np
import pytest
from campaigns import ARM, MOUNT, TRUE, displacements

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.physics.robot.elastostatics import equilibrium
from kr270_milling.show.report.identification.compliance import reason, sentences
from kr270_milling.studies.identification.compliance import TooFewError, fit_compliance
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
