"""Eq. (1) in discrete time against closed forms, matrix exponentials, an integrator of another kind, and energy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from kr270_milling.physics.motion.arm_model import arm_model
from kr270_milling.physics.motion.dynamics import DynamicsError, advance, condense, discretise, modes

RANDOM = np.random.default_rng(5)
ZETA = 0.18
STILL = np.zeros(0)  # a reference that does not move


def spd(scale):
    """A symmetric positive definite matrix with coupling, (6, 6); scale: of its rows and columns, (6,)."""
    root = RANDOM.uniform(-1, 1, (6, 6)) + 2 * np.eye(6)
    return np.diag(scale) @ root @ root.T @ np.diag(scale)


COMPLIANCE = spd([4e-4] * 3 + [4e-4] * 3)  # about 1e-6 m/N
MASS = spd([12.0] * 3 + [5.0] * 3)
TRANSLATIONS = np.diag([790.4] * 3 + [0.0] * 3)
WRENCH = np.array([100.0, -50.0, 30.0, 4.0, -7.0, 5.0])


def one_degree(stiffness=1.4e6, mass=790.4):
    """Only y moves."""
    return modes(np.diag([1e-9, 1 / stiffness, 1e-9, 1e-9, 1e-9, 1e-9]), np.diag([0, mass, 0, 0, 0, 0.0]))


def run(model, zeta, period, steps, state, wrench):
    """States (steps + 1, 2r) and deflections (steps + 1, 6) with the wrench held; the compiled step itself."""
    arrays = arm_model([model], zeta, period).arrays
    states, deflections = np.zeros((steps + 1, state.size)), np.zeros((steps + 1, 6))
    states[0] = state
    for n in range(steps):
        advance(n, states[n], wrench, STILL, arrays, states[n + 1], deflections[n + 1])
    return states, deflections


def damping_matrix(model, zeta):
    """C of (1) for one ratio in every mode: M phi diag(2 zeta omega) phi^T M."""
    to_mass = model.mass @ model.shape
    return to_mass @ np.diag(2 * zeta * model.frequency) @ to_mass.T


def stiffness_matrix(model):
    to_mass = model.mass @ model.shape
    return to_mass @ np.diag(model.frequency**2) @ to_mass.T


# --- closed forms ---


def test_free_vibration_of_one_degree_follows_the_closed_form():
    model = one_degree()
    w = np.sqrt(1.4e6 / 790.4)
    damped = w * np.sqrt(1 - ZETA**2)
    states, deflections = run(model, ZETA, 1e-3, 500, np.array([1e-4, 2e-3]), np.zeros(6))
    t = np.arange(501) * 1e-3
    sine = (2e-3 + ZETA * w * 1e-4) / damped
    expected = np.exp(-ZETA * w * t) * (1e-4 * np.cos(damped * t) + sine * np.sin(damped * t))
    np.testing.assert_allclose(states[:, 0], expected, atol=1e-16)
    np.testing.assert_array_equal(deflections[1:, 1], states[1:, 0])


@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.18, 0.99])
def test_a_step_of_force_on_one_degree_follows_the_closed_form(zeta):
    model = one_degree()
    w = np.sqrt(1.4e6 / 790.4)
    damped = w * np.sqrt(1 - zeta**2)
    _, deflections = run(model, zeta, 5e-4, 1500, np.zeros(2), np.array([0, 81.0, 0, 0, 0, 0]))
    t = np.arange(1501) * 5e-4
    rest = np.exp(-zeta * w * t) * (np.cos(damped * t) + zeta * w / damped * np.sin(damped * t))
    np.testing.assert_allclose(deflections[:, 1], 81.0 / 1.4e6 * (1 - rest), atol=1e-16)


@pytest.mark.parametrize("mass", [MASS, TRANSLATIONS], ids=["six", "three"])
@pytest.mark.parametrize("period", [1e-5, 5e-4, 0.3])
def test_a_step_is_the_matrix_exponential_of_the_coupled_equation(mass, period):
    model = modes(COMPLIANCE, mass)
    r = model.frequency.size
    inverse = np.linalg.inv(model.mass)
    system = np.zeros((2 * r + 6, 2 * r + 6))  # the held wrench as further states
    system[:r, r : 2 * r] = np.eye(r)
    system[r : 2 * r, :r] = -inverse @ stiffness_matrix(model)
    system[r : 2 * r, r : 2 * r] = -inverse @ damping_matrix(model, ZETA)
    system[r : 2 * r, 2 * r :] = inverse @ model.force
    exact = expm(system * period)
    transition, held, _, _ = discretise(model, ZETA, period)
    scale = np.repeat([1.0, model.frequency[-1]], r)  # velocities are larger by omega
    np.testing.assert_allclose(
        transition / scale[:, None] * scale, exact[: 2 * r, : 2 * r] / scale[:, None] * scale, atol=1e-11
    )
    np.testing.assert_allclose(
        held / scale[:, None], exact[: 2 * r, 2 * r :] / scale[:, None], rtol=1e-7, atol=1e-12 * np.abs(held).max()
    )


def test_the_modes_diagonalise_mass_and_stiffness():
    model = modes(COMPLIANCE, MASS)
    np.testing.assert_allclose(model.shape.T @ MASS @ model.shape, np.eye(6), atol=1e-10)
    stiffness = np.linalg.inv(COMPLIANCE)
    np.testing.assert_allclose(
        model.shape.T @ stiffness @ model.shape, np.diag(model.frequency**2), atol=1e-9 * model.frequency[-1] ** 2
    )


@pytest.mark.parametrize("parts", [2, 7, 40])
def test_a_held_force_may_be_stepped_over_in_any_number_of_steps(parts):
    model, state = modes(COMPLIANCE, MASS), RANDOM.normal(size=12) * 1e-4
    whole, _ = run(model, ZETA, 0.02, 1, state, WRENCH)
    states, _ = run(model, ZETA, 0.02 / parts, parts, state, WRENCH)
    np.testing.assert_allclose(states[-1], whole[-1], rtol=1e-10, atol=1e-13)


def test_a_long_held_wrench_ends_in_the_static_deflection_of_all_six_components():
    for mass in (MASS, TRANSLATIONS):
        model = modes(COMPLIANCE, mass)
        _, deflections = run(model, ZETA, 0.05, 400, np.zeros(2 * model.frequency.size), WRENCH)
        np.testing.assert_allclose(deflections[-1], COMPLIANCE @ WRENCH, rtol=1e-10)


# --- condensation ---


def test_condensing_keeps_the_compliance_where_slicing_the_stiffness_would_not():
    _, stiffness, *_ = condense(COMPLIANCE, TRANSLATIONS)
    np.testing.assert_allclose(np.linalg.inv(stiffness), COMPLIANCE[:3, :3], rtol=1e-12)
    assert np.all(np.linalg.eigvalsh(np.linalg.inv(COMPLIANCE)[:3, :3] - stiffness) > 0)


def test_the_condensed_arm_is_the_limit_of_one_with_vanishing_rotary_inertia():
    """The matrix exponential of all six components; the difference falls in proportion to the inertia."""
    condensed = modes(COMPLIANCE, TRANSLATIONS)
    period, steps = 0.01, 12
    states, deflections = run(condensed, ZETA, period, steps, np.zeros(6), WRENCH)
    differences = []
    for inertia in (1e-2, 1e-3, 1e-4):
        full = modes(COMPLIANCE, TRANSLATIONS + np.diag([0.0] * 3 + [inertia] * 3))
        inverse, k, c = np.linalg.inv(full.mass), stiffness_matrix(full), damping_matrix(full, ZETA)
        system = np.block([[np.zeros((6, 6)), np.eye(6)], [-inverse @ k, -inverse @ c]])
        constant = np.concatenate([np.zeros(6), inverse @ WRENCH])
        whole = np.block([[system, constant[:, None]], [np.zeros((1, 13))]])
        found = expm(whole * period * steps)[:6, 12]
        differences.append(np.abs(found - deflections[-1]).max() / np.abs(deflections[-1]).max())
    assert differences[-1] < 1e-4
    order = np.polyfit(np.log([1e-2, 1e-3, 1e-4]), np.log(differences), 1)[0]
    assert order == pytest.approx(1.0, abs=0.15)


def test_moments_move_the_translations_through_the_coupling():
    moment = np.array([0, 0, 0, 0, 0, 10.0])
    model = modes(COMPLIANCE, TRANSLATIONS)
    _, deflections = run(model, ZETA, 0.05, 300, np.zeros(6), moment)
    assert np.abs(deflections[-1, :3]).min() > 1e-9
    np.testing.assert_allclose(deflections[-1], 10 * COMPLIANCE[:, 5], rtol=1e-9)


def test_a_moment_turns_massless_rotations_at_once():
    model = modes(COMPLIANCE, TRANSLATIONS)
    _, deflections = run(model, ZETA, 1e-9, 1, np.zeros(6), np.array([0, 0, 0, 0, 0, 10.0]))
    stuck = COMPLIANCE[3:, 3:] - COMPLIANCE[3:, :3] @ np.linalg.solve(COMPLIANCE[:3, :3], COMPLIANCE[:3, 3:])
    np.testing.assert_allclose(deflections[1, 3:], 10 * stuck[:, 2], rtol=1e-6)  # the translations still stand
    np.testing.assert_allclose(deflections[1, :3], 0.0, atol=1e-15)


# --- energy ---


def energies(model, states):
    """Kinetic and potential energy [J], (n,)."""
    r = model.frequency.size
    x, v = states[:, :r], states[:, r:]
    kinetic = 0.5 * np.einsum("ni,ij,nj->n", v, model.mass, v)
    return kinetic, 0.5 * np.einsum("ni,ij,nj->n", x, stiffness_matrix(model), x)


def test_undamped_free_vibration_keeps_its_energy_over_1e5_steps():
    model = modes(COMPLIANCE, MASS)
    states, _ = run(model, 0.0, 5e-4, 100_000, RANDOM.normal(size=12) * 1e-4, np.zeros(6))
    total = sum(energies(model, states))
    np.testing.assert_allclose(total, total[0], rtol=1e-9)
    assert energies(model, states)[0].min() < 0.9 * total[0]  # it does swing between the two kinds


@pytest.mark.parametrize("zeta", [0.01, 0.18, 0.9])
def test_damped_free_vibration_never_gains_energy(zeta):
    model = modes(COMPLIANCE, TRANSLATIONS)
    states, _ = run(model, zeta, 5e-4, 2000, RANDOM.normal(size=6) * 1e-4, np.zeros(6))
    total = sum(energies(model, states))
    assert np.all(np.diff(total) <= 1e-14 * total[0]) and total[-1] < 0.95 * total[0]


def test_the_work_of_a_held_force_is_what_is_stored_and_what_is_dissipated():
    model, zeta, fine = modes(COMPLIANCE, TRANSLATIONS), 0.1, 1e-5
    states, _ = run(model, zeta, fine, 4000, np.zeros(6), WRENCH)
    work = (states[-1, :3] - states[0, :3]) @ (model.force @ WRENCH)
    power = np.einsum("ni,ij,nj->n", states[:, 3:], damping_matrix(model, zeta), states[:, 3:])
    dissipated = fine / 3 * (power[0] + 4 * power[1:-1:2].sum() + 2 * power[2:-1:2].sum() + power[-1])  # Simpson
    stored = sum(energies(model, states))[-1]
    assert dissipated > 0.05 * work
    assert work == pytest.approx(stored + dissipated, rel=1e-8)


# --- several postures ---


def test_between_two_postures_the_matrices_are_interpolated_and_after_the_last_they_stay():
    models = [modes(COMPLIANCE * s, TRANSLATIONS) for s in (1.0, 1.3, 0.8)]
    arm = arm_model(models, ZETA, 5e-4, 4.0)
    state, out, deflection = RANDOM.normal(size=6) * 1e-4, np.zeros(6), np.zeros(6)
    for step in range(14):
        place = min(step / 4.0, 2.0)
        k = min(int(place), 1)
        mixed = [(1 - place + k) * m[k] + (place - k) * m[k + 1] for m in arm.arrays[:4]]
        advance(step, state, WRENCH, STILL, arm.arrays, out, deflection)
        np.testing.assert_allclose(out, mixed[0] @ state + mixed[1] @ WRENCH, rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(deflection, mixed[2] @ out + mixed[3] @ WRENCH, rtol=1e-12, atol=1e-18)


def test_several_equal_postures_are_one():
    model, state = modes(COMPLIANCE, MASS), RANDOM.normal(size=12) * 1e-4
    results = []
    for arm in (arm_model([model], ZETA, 5e-4), arm_model([model] * 5, ZETA, 5e-4, 3.0)):
        out, deflection = np.zeros(12), np.zeros(6)
        advance(7, state, WRENCH, STILL, arm.arrays, out, deflection)
        results.append(np.concatenate([out, deflection]))
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize(
    ("softness", "mass"),
    [
        (COMPLIANCE, np.zeros((6, 6))),
        (COMPLIANCE, np.diag([1.0, 1.0, -1.0, 0.0, 0.0, 0.0])),
        (COMPLIANCE, np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 0.0]) + np.eye(6, k=2) + np.eye(6, k=-2)),
        (-COMPLIANCE, TRANSLATIONS),
        (np.diag([1e-6, -1e-6, 1e-6, 1e-6, 1e-6, 1e-6]), MASS),
        (COMPLIANCE, np.full((6, 6), np.nan)),
        (np.zeros((6, 6)), TRANSLATIONS),
        (np.diag([1e-6, 0.0, 1e-6, 1e-6, 1e-6, 1e-6]), TRANSLATIONS),
        (np.full((6, 6), np.nan), TRANSLATIONS),
    ],
)
def test_a_mass_or_compliance_that_no_arm_has_is_refused(softness, mass):
    with pytest.raises(DynamicsError):
        modes(softness, mass)
