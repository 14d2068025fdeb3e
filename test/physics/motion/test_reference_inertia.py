"""The term -M r'' of eq. (1) against transfer functions, closed forms, exact integration and energy."""

from __future__ import annotations

import numpy as np
import pytest
from book import check
from scipy import interpolate, signal
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.motion.arm_model import arm_model
from kr270_milling.physics.motion.dynamics import approach, modes, push, reference_motion
from kr270_milling.physics.motion.exchange import Clock
from kr270_milling.physics.motion.milling_pass import CompliantArm

RANDOM = np.random.default_rng(11)
ZETA, PERIOD = 0.07, 1e-3
STIFFNESS, MASS = 1.395e6, 790.4  # [N/m], [kg]: the paper's arm across the feed
OMEGA = np.sqrt(STIFFNESS / MASS)
DAMPED = OMEGA * np.sqrt(1 - ZETA**2)


def spd(scale):
    root = RANDOM.uniform(-1, 1, (6, 6)) + 2 * np.eye(6)
    return np.diag(scale) @ root @ root.T @ np.diag(scale)


SOFT, HEAVY = spd([4e-4] * 6), spd([12.0] * 3 + [5.0] * 3)
TRANSLATIONS = np.diag([790.4] * 3 + [0.0] * 3)


def one_degree():
    """Only y moves."""
    return modes(np.diag([1e-9, 1 / STIFFNESS] + [1e-9] * 4), np.diag([0, MASS, 0, 0, 0, 0.0]))


def deflections(model, reference, periods, zeta=ZETA, period=PERIOD):
    """Deflection (periods + 1, 6) and state (periods + 1, 2r) of the arm that follows a reference, without a cut."""
    stamps = Clock(period, 1).stamp(np.arange(periods + 1))
    arm = arm_model([model], zeta, period, reference_inertia=True)
    side = CompliantArm(arm, arm.push(reference, stamps))
    out, states = np.zeros((periods + 1, 6)), np.zeros((periods + 1, arm.order))
    for n in range(periods):
        out[n + 1] = side.correct(np.zeros(6))
        states[n + 1] = side.state
    return out, states


def knots(times, positions, velocity=None, quaternion=TOOL_DOWN):
    return Trajectory(np.rint(np.asarray(times) * 1e9).astype(np.int64), positions, quaternion, velocity)


def along_y(values):
    return np.outer(values, [0.0, 1.0, 0.0])


def polygon(periods=400, every=20, size=1e-4):
    """A reference of straight lines with corners in all three directions."""
    times = np.arange(0, periods + 1, every) * PERIOD
    return knots(times, RANDOM.normal(size=(times.size, 3)) * size)


# --- transfer function ---
@check(
    "M delta'' + C delta' + K delta = -M r'', straight lines with corners, zeta {zeta}",
    "scipy.signal.lsim of (C s + K) / (M s^2 + C s + K), exact for lines, relative",
    cases=("zeta", [(0.001,), (0.04,), (0.182,)]),
)  # fmt: skip
def test_moving_reference(zeta):
    reference, time = polygon(), np.arange(401) * PERIOD
    y = reference.sample(Clock(PERIOD, 1).stamp(np.arange(401)))[:, 1]
    steady = reference.sample_velocity(0)[1] * time  # the filter comes in along the first line
    filtered = signal.lti([2 * zeta * OMEGA, OMEGA**2], [1, 2 * zeta * OMEGA, OMEGA**2])
    expected = signal.lsim(filtered, y - y[0] - steady, time)[1] + y[0] + steady
    found, _ = deflections(one_degree(), reference, 400, zeta)
    return 0.0, np.abs(y + found[:, 1] - expected).max() / np.abs(y).max(), 1e-11


@pytest.mark.parametrize("mass", [HEAVY, TRANSLATIONS], ids=["six", "three"])
def test_every_mode_of_a_coupled_arm_follows_its_own_filter(mass):
    model, reference = modes(SOFT, mass), polygon()
    stamps = Clock(PERIOD, 1).stamp(np.arange(401))
    time = stamps * 1e-9
    bent = reference.sample(stamps) - reference.position[0] - time[:, None] * reference.sample_velocity(0)
    wanted = np.zeros((401, 6))
    wanted[:, :3] = bent
    modal = wanted[:, model.inertial] @ model.mass @ model.shape
    followed = np.empty_like(modal)
    for k, w in enumerate(model.frequency):
        filtered = signal.lti([2 * ZETA * w, w**2], [1, 2 * ZETA * w, w**2])
        followed[:, k] = signal.lsim(filtered, modal[:, k], time)[1]
    expected = (followed - modal) @ model.shape.T @ model.output.T
    found, _ = deflections(model, reference, 400)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


# --- closed forms ---
@check("corner of 0.4 mm/s in the reference, zeta {zeta}", "-dv / omega_d exp(-zeta omega t) sin(omega_d t), 9.5 um at "
       "6.7 Hz without damping, relative", cases=("zeta", [(0.0,), (ZETA,)]))  # fmt: skip
def test_corner(zeta):
    corner, change = 0.05, 0.4e-3
    reference = knots([0.0, corner, 0.4], along_y([0.0, 0.0, change * (0.4 - corner)]))
    found, _ = deflections(one_degree(), reference, 400, zeta)
    t, damped = np.arange(401) * PERIOD - corner, OMEGA * np.sqrt(1 - zeta**2)
    expected = np.where(t < 0, 0.0, -change / damped * np.exp(-zeta * OMEGA * t) * np.sin(damped * t))
    return 0.0, np.abs(found[:, 1] - expected).max() * OMEGA / change, 1e-11


def test_a_cubic_reference_is_integrated_exactly_for_the_coupled_arm():
    """The matrix exponential of M delta'' + C delta' + K delta = -M r'' with r'' linear in each segment."""
    model = modes(SOFT, HEAVY)
    times = np.arange(5) * 0.04
    positions, rates = RANDOM.normal(size=(5, 3)) * 1e-4, RANDOM.normal(size=(5, 3)) * 1e-3
    found, states = deflections(model, knots(times, positions, rates), 160)
    to_mass, r = model.mass @ model.shape, 6
    stiff, damping = (to_mass @ np.diag(d) @ to_mass.T for d in (model.frequency**2, 2 * ZETA * model.frequency))
    inverse = np.linalg.inv(model.mass)
    state = np.zeros(12)
    for k in range(4):
        h, move = 0.04, positions[k + 1] - positions[k]
        start = (6 * move / h - 4 * rates[k] - 2 * rates[k + 1]) / h
        change = (-6 * move / h + 2 * rates[k] + 4 * rates[k + 1]) / h - start
        system = np.zeros((14, 14))
        system[:r, r:12] = np.eye(6)
        system[r:12, :r], system[r:12, r:12] = -inverse @ stiff, -inverse @ damping
        system[r : r + 3, 12], system[r : r + 3, 13] = -start, -change / h
        system[13, 13] = 0.0
        clock = np.zeros((15, 15))  # 1 and t as further states: t' = 1
        clock[:14, :14] = system
        clock[13, 12] = 1.0
        state = (expm(clock[:14, :14] * h) @ np.concatenate([state, [1.0, 0.0]]))[:12]
        np.testing.assert_allclose(found[(k + 1) * 40], state[:6], atol=1e-9 * np.abs(found).max())
    np.testing.assert_allclose(states[-1], state, atol=1e-9 * np.abs(states).max())


def test_a_corner_within_a_period_costs_an_error_of_second_order_in_the_period():
    """Impulse and first moment of the corner are met; the second moment is wrong by less than dv H^2 / 4."""
    gaps = []
    for period in (4e-3, 2e-3, 1e-3):
        corner = 0.052 + 0.35 * period
        reference = knots([0.0, corner, 0.4], along_y([0.0, 0.0, 1e-3 * (0.4 - corner)]))
        found, _ = deflections(one_degree(), reference, round(0.4 / period), period=period)
        t = np.arange(len(found)) * period - corner
        exact = np.where(t < 0, 0.0, -1e-3 / DAMPED * np.exp(-ZETA * OMEGA * t) * np.sin(DAMPED * t))
        gaps.append(np.abs(found[:, 1] - exact)[t > period].max())
        assert gaps[-1] < 1e-3 * OMEGA * period**2 / 4
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(gaps), 1)[0] == pytest.approx(2.0, abs=0.15)


# --- energy ---
@check("energy of the undamped arm / work of its motors, r' (M z'') over straight lines", "conservation of energy")
def test_work_of_the_motors():
    """Without damping z'M z' / 2 + delta' K delta / 2 grows by the work of M z'' along r', lines between corners."""
    model, reference = modes(SOFT, HEAVY), polygon()
    _, states = deflections(model, reference, 400, zeta=0.0)
    rate = np.zeros((401, 6))
    rate[1:, :3] = reference.sample_velocity(Clock(PERIOD, 1).stamp(np.arange(401)), "left")[1:]
    rate[0] = rate[1]
    absolute = states[:, 6:] + rate  # z' before the corner, which it does not notice
    to_mass = model.mass @ model.shape
    stiff = to_mass @ np.diag(model.frequency**2) @ to_mass.T
    energy = 0.5 * np.einsum("ni,ij,nj->n", absolute, model.mass, absolute)
    energy += 0.5 * np.einsum("ni,ij,nj->n", states[:, :6], stiff, states[:, :6])
    work = np.einsum("ni,ij,nj->n", rate[1:], model.mass, np.diff(absolute, axis=0))
    np.testing.assert_allclose(np.diff(energy), work, atol=1e-9 * np.abs(work).max())
    assert np.abs(work).max() > 1e-12
    return 1.0, (energy[-1] - energy[0]) / work.sum(), 1e-9


# --- rotations, start, corners ---
def test_a_turning_reference_moves_an_arm_with_rotary_inertia_and_no_other():
    angles = np.array([0.0, 0.0, 0.02, 0.02])
    turned = Rotation.from_rotvec(np.outer(angles, [1.0, 0.0, 0.0])).as_quat()
    reference = knots([0.0, 0.05, 0.1, 0.4], np.zeros((4, 3)), quaternion=turned)
    diagonal = np.diag([MASS] * 3 + [40.0] * 3)
    model = modes(np.diag([1e-6] * 3 + [2e-6] * 3), diagonal)
    found, _ = deflections(model, reference, 100)
    w = np.sqrt(1 / (2e-6 * 40.0))
    damped, t = w * np.sqrt(1 - ZETA**2), np.arange(101) * PERIOD - 0.05
    expected = np.where(t < 0, 0.0, -0.02 / 0.05 / damped * np.exp(-ZETA * w * t) * np.sin(damped * t))
    np.testing.assert_allclose(found[:, 3], expected, atol=1e-9 * np.abs(expected).max())
    assert not deflections(modes(np.diag([1e-6] * 6), TRANSLATIONS), reference, 100)[0].any()


def test_the_motion_of_a_reference_is_its_corners_and_its_acceleration():
    reference = knots([0.0, 0.002, 0.004], along_y([0.0, 0.002, 0.0]))
    motion = reference_motion(reference, Clock(1e-3, 1).stamp(np.arange(7)))
    expected = np.zeros((6, 18))
    expected[2, 1], expected[4, 1] = -2.0, 1.0  # from 1 to -1 m/s, and to rest at the end
    np.testing.assert_allclose(motion, expected, atol=1e-10)


def test_a_correction_that_sets_out_at_once_is_a_corner_in_the_programmed_motion():
    target = knots([0.0, 0.4], np.array([[0.0, 0, 0], [0.04, 0, 0]]))
    corrected = target.with_position(target.position + along_y([0.0, 4e-4]))
    stamps = Clock(PERIOD, 1).stamp(np.arange(401))
    assert not reference_motion(corrected, stamps)[0, :6].any()
    jump = reference_motion(corrected, stamps, approach(target))[0, :6]
    np.testing.assert_allclose(jump, [0, 1e-3, 0, 0, 0, 0], atol=1e-15)


# --- one step function for everybody ---
def cell(*assignments):
    return read_cell(find_file("paper.yaml"), ("path.length_mm=14.4", *assignments))


def test_the_paper_has_eq_1_as_printed_and_every_other_cell_the_moving_reference():
    assert not cell().dynamics.reference_inertia
    assert not cell().arm_model(cell().target()).reference.size
    assert read_cell(find_file("test_piece.yaml")).dynamics.reference_inertia
    assert type(cell().dynamics)("lumped", 0.1).reference_inertia


def test_between_two_postures_the_response_goes_in_a_straight_line():
    rng = np.random.default_rng(4)
    response, motion, found = rng.normal(size=(3, 4, 18)), rng.normal(size=(11, 18)), np.empty((11, 4))
    push(motion, response, 4.0, 0, found)
    between = interpolate.make_interp_spline(np.arange(3), response, 1)(np.minimum(np.arange(11) / 4.0, 2.0))
    np.testing.assert_allclose(found, np.einsum("nij,nj->ni", between, motion), rtol=1e-12)


# --- compensated by (1) as printed, milled with the term ---
def compensated_as_printed(method):
    printed, moving = (
        read_cell(find_file("paper.yaml"), (f"dynamics.reference_inertia={on}",)) for on in ("false", "true")
    )
    return moving, compensated(printed, simulate(printed), method).reference


@check(
    "compensated by (1) as printed, milled with -M r'': {method}, largest deviation",
    "two other calculations [derived], to the digits given", "m",
    cases=("method expected", [("linear", 20e-6), ("mirror", 5.5e-6)]),
)  # fmt: skip
def test_compensation_without_the_reference(method, expected):
    moving, reference = compensated_as_printed(method)
    return expected, simulate(moving, reference).scores.max_deviation, 0.5e-6


@check(
    "compensated by (1) as printed, milled with -M r'': spline, largest deviation",
    "transfer function (2 z w s + w^2) / (s^2 + 2 z w s + w^2) of one mode, spline by scipy, lsim", "m",
)  # fmt: skip
def test_spline_without_the_reference():
    """The mode follows the correction, and answers the change of the force; both are added to the original pass.

    All links are at the tool, so one mode of 790.4 kg moves the tool across the feed.
    """
    moving, reference = compensated_as_printed("spline")
    before, after = simulate(moving), simulate(moving, reference)
    ran, time = before.result, before.result.time
    offset = (reference.position - moving.target().position)[:, 1]
    correction = interpolate.CubicSpline(reference.time, offset, bc_type=((1, 0.0), (1, 0.0)))(time)
    w, z = 2 * np.pi * moving.low_frequency, moving.dynamics.damping_ratio
    mode = [1.0, 2 * z * w, w**2]
    _, followed, _ = signal.lsim(([2 * z * w, w**2], mode), correction, time)
    change = (after.result.wrench - ran.wrench)[:, 1] / moving.arm.link_mass.sum()
    _, pushed, _ = signal.lsim(([1.0], mode), change, time)
    scored = time >= moving.full_engagement - 1e-9
    deviation = (ran.deflection[:, 1] + followed + pushed)[scored]
    return np.abs(deviation).max(), after.scores.max_deviation, 0.5e-6
