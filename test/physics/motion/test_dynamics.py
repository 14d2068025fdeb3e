"""Eq. (1) in discrete time, the modes of the arm, and measured modes."""

import itertools

import numpy as np
import pytest
from book import check
from scipy import interpolate, signal
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from kr270_milling import read_cell
from kr270_milling.base.errors import ConfigError, ModelError
from kr270_milling.cell.arm import mirrored
from kr270_milling.cell.cell_file import cell_text
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.models import arm_model_of, arm_of, modal_model_of, path_of
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.motion.arm_model import Dynamics, MeasuredModes, arm_model, measured_model, modal_models
from kr270_milling.physics.motion.dynamics import (
    advance,
    approach,
    discretise,
    modes,
    push,
    reference_motion,
)
from kr270_milling.physics.motion.milling_pass import CompliantArm, follow
from kr270_milling.physics.motion.periods import Clock
from kr270_milling.physics.robot import cartesian_mass, compliance, equilibrium, mode_frequencies, rotate_matrix

PAPER = read_cell("paper.yaml")
RANDOM = np.random.default_rng(5)
ZETA = 0.18


def spd(scale):
    """A symmetric positive definite matrix with coupling, (6, 6); scale: of its rows and columns, (6,)."""
    root = RANDOM.uniform(-1, 1, (6, 6)) + 2 * np.eye(6)
    return np.diag(scale) @ root @ root.T @ np.diag(scale)


COMPLIANCE = spd([4e-4] * 3 + [4e-4] * 3)  # about 1e-6 m/N
MASS = spd([12.0] * 3 + [5.0] * 3)
TRANSLATIONS = np.diag([790.4] * 3 + [0.0] * 3)
WRENCH = np.array([100.0, -50.0, 30.0, 4.0, -7.0, 5.0])


def system(model, zeta, more):
    """x' = A x of (1) for x, x' and some further states, whose effect on x'' is the caller's; its first two rows."""
    r, inverse, to_mass = model.frequency.size, np.linalg.inv(model.mass), model.mass @ model.shape
    matrix = np.zeros((2 * r + more, 2 * r + more))
    matrix[:r, r : 2 * r] = np.eye(r)
    for columns, values in ((slice(r), model.frequency**2), (slice(r, 2 * r), 2 * zeta * model.frequency)):
        matrix[r : 2 * r, columns] = -inverse @ to_mass @ np.diag(values) @ to_mass.T  # K and C
    return matrix


@check(
    "one period of (1), {inertia} inertias, H = {period} s, zeta {zeta}", "matrix exponential of (1) at constant "
    "wrench, relative", cases=("inertia period zeta", [
        *((name, h, 0.18) for name in ("six", "three") for h in (1e-5, 5e-4, 0.3)), ("six", 5e-4, 0.0),
        ("six", 5e-4, 0.99)]),
)  # fmt: skip
def test_exponential(inertia, period, zeta):
    model = modes(COMPLIANCE[None], {"six": MASS, "three": TRANSLATIONS}[inertia][None])[0]
    r, matrix = model.frequency.size, system(model, zeta, 6)  # the constant wrench as further states
    matrix[r : 2 * r, 2 * r :] = np.linalg.inv(model.mass) @ model.force
    exact = expm(matrix * period)
    transition, forcing, _, _ = discretise(model, zeta, period)
    scale = np.repeat([1.0, model.frequency[-1]], r)[:, None]  # velocities are larger by omega
    forced = exact[: 2 * r, 2 * r :] / scale
    np.testing.assert_allclose(forcing / scale, forced, rtol=1e-7, atol=1e-12 * np.abs(forcing).max())
    return 0.0, np.abs((transition - exact[: 2 * r, : 2 * r]) / scale * scale.T).max(), 1e-11


def test_between_two_postures_matrices_and_responses_go_in_a_straight_line_and_stay_after_the_last():
    models = modes(COMPLIANCE * np.reshape([1.0, 1.3, 0.8], (3, 1, 1)), np.array([TRANSLATIONS] * 3))
    arm = arm_model(models, ZETA, 5e-4, 4.0)
    state, out, deflection = RANDOM.normal(size=6) * 1e-4, np.zeros(6), np.zeros(6)
    for step in range(14):
        place = min(step / 4.0, 2.0)
        k = min(int(place), 1)
        mixed = [
            (1 - place + k) * m[k] + (place - k) * m[k + 1]
            for m in (arm.transition, arm.input, arm.output, arm.feedthrough)
        ]
        advance(step, state, WRENCH, np.zeros(0), arm.arrays, out, deflection)
        np.testing.assert_allclose(out, mixed[0] @ state + mixed[1] @ WRENCH, rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(deflection, mixed[2] @ out + mixed[3] @ WRENCH, rtol=1e-12, atol=1e-18)
    rng = np.random.default_rng(4)
    response, motion, obtained = rng.normal(size=(3, 4, 18)), rng.normal(size=(11, 18)), np.empty((11, 4))
    push(motion, np.ascontiguousarray(response.swapaxes(1, 2)), 4.0, 0, obtained)
    between = interpolate.make_interp_spline(np.arange(3), response, 1)(np.minimum(np.arange(11) / 4.0, 2.0))
    np.testing.assert_allclose(obtained, np.einsum("nij,nj->ni", between, motion), rtol=1e-12)


@pytest.mark.parametrize(("softness", "mass"), [
    *((COMPLIANCE, mass) for mass in (
        np.zeros((6, 6)), np.diag([1.0, 1.0, -1.0, 0.0, 0.0, 0.0]), np.full((6, 6), np.nan),
        np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 0.0]) + np.eye(6, k=2) + np.eye(6, k=-2))),
    *((softness, TRANSLATIONS) for softness in (-COMPLIANCE, np.zeros((6, 6)), np.full((6, 6), np.nan))),
])  # fmt: skip
def test_a_mass_or_compliance_that_no_arm_has_is_refused(softness, mass):
    with pytest.raises(ModelError):
        modes(softness[None], mass[None])


# --- The term -M r'' against transfer functions, closed forms, exact integration and energy ---
LIGHT, PERIOD = 0.07, 1e-3


def deflections(model, reference, periods, zeta=LIGHT, period=PERIOD):
    """Deflection (periods + 1, 6) and last state (2r,) of the arm that follows a reference, without a cut."""
    stamps = Clock(period, 1).stamp(np.arange(periods + 1))
    arm = arm_model([model], zeta, period, reference_inertia=True)
    side = CompliantArm(arm, arm.push(reference, stamps))
    return np.array([np.zeros(6), *(side.correct(np.zeros(6)) for _ in range(periods))]), side.state


def knots(times, positions, velocity=None, quaternion=TOOL_DOWN):
    return Trajectory(np.rint(np.asarray(times) * 1e9).astype(np.int64), positions, quaternion, velocity)


def along_y(values):
    return np.outer(values, [0.0, 1.0, 0.0])


@check("M delta'' + C delta' + K delta = -M r'', straight lines with corners, {inertia} inertias, zeta {zeta}",
       "scipy.signal.lsim of (2 z w s + w^2) / (s^2 + 2 z w s + w^2) in each mode, exact for lines, relative",
       cases=("inertia zeta", [("six", 0.001), ("six", 0.04), ("six", 0.182), ("three", 0.04)]))  # fmt: skip
def test_moving_reference(inertia, zeta):
    """The filter comes in along the first line, at its speed."""
    model = modes(COMPLIANCE[None], {"six": MASS, "three": TRANSLATIONS}[inertia][None])[0]
    reference = knots(0.02 * np.arange(21), RANDOM.normal(size=(21, 3)) * 1e-4)
    stamps = Clock(PERIOD, 1).stamp(np.arange(401))
    time = stamps * 1e-9
    path = np.zeros((401, 6))
    path[:, :3] = reference.sample(stamps) - reference.position[0] - time[:, None] * reference.sample_velocity(0)
    modal = path[:, model.inertial] @ model.mass @ model.shape
    filters = [signal.lti([2 * zeta * w, w**2], [1, 2 * zeta * w, w**2]) for w in model.frequency]
    followed = np.column_stack([signal.lsim(one, modal[:, k], time)[1] for k, one in enumerate(filters)])
    expected = (followed - modal) @ model.shape.T @ model.output.T
    obtained, _ = deflections(model, reference, 400, zeta)
    return 0.0, np.abs(obtained - expected).max() / np.abs(expected).max(), 1e-11


def test_a_cubic_reference_is_integrated_exactly_for_the_coupled_arm():
    """The matrix exponential of M delta'' + C delta' + K delta = -M r'' with r'' linear in each segment."""
    model = modes(COMPLIANCE[None], MASS[None])[0]
    times = np.arange(5) * 0.04
    positions, rates = RANDOM.normal(size=(5, 3)) * 1e-4, RANDOM.normal(size=(5, 3)) * 1e-3
    obtained, last = deflections(model, knots(times, positions, rates), 160)
    state = np.zeros(12)
    for k in range(4):
        h, move = 0.04, positions[k + 1] - positions[k]
        start = (6 * move / h - 4 * rates[k] - 2 * rates[k + 1]) / h
        change = (-6 * move / h + 2 * rates[k] + 4 * rates[k + 1]) / h - start
        matrix = system(model, LIGHT, 2)
        matrix[6:9, 12], matrix[6:9, 13] = -start, -change / h
        matrix[13, 12] = 1.0  # 1 and t as further states: t' = 1
        state = (expm(matrix * h) @ np.concatenate([state, [1.0, 0.0]]))[:12]
        np.testing.assert_allclose(obtained[(k + 1) * 40], state[:6], atol=1e-9 * np.abs(obtained).max())
    np.testing.assert_allclose(last, state, atol=1e-9 * np.abs(state).max())


def test_a_corner_within_a_period_costs_an_error_of_second_order_in_the_period():
    """Impulse and first moment of the corner are met; the second moment is wrong by less than dv H^2 / 4."""
    model = modes(np.diag([1e-9, 1 / 1.4e6] + [1e-9] * 4)[None], np.diag([0, 790.4, 0, 0, 0, 0.0])[None])[0]  # y alone
    w, gaps = np.sqrt(1.4e6 / 790.4), []
    damped = w * np.sqrt(1 - LIGHT**2)
    for period in (4e-3, 2e-3, 1e-3):
        corner = 0.052 + 0.35 * period
        reference = knots([0.0, corner, 0.4], along_y([0.0, 0.0, 1e-3 * (0.4 - corner)]))
        obtained, _ = deflections(model, reference, round(0.4 / period), period=period)
        t = np.arange(len(obtained)) * period - corner
        exact = np.where(t < 0, 0.0, -1e-3 / damped * np.exp(-LIGHT * w * t) * np.sin(damped * t))
        gaps.append(np.abs(obtained[:, 1] - exact)[t > period].max())
        assert gaps[-1] < 1e-3 * w * period**2 / 4
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(gaps), 1)[0] == pytest.approx(2.0, abs=0.15)


def test_a_turning_reference_moves_an_arm_with_rotary_inertia_and_no_other():
    angles = np.array([0.0, 0.0, 0.02, 0.02])
    turned = Rotation.from_rotvec(np.outer(angles, [1.0, 0.0, 0.0])).as_quat()
    reference = knots([0.0, 0.05, 0.1, 0.4], np.zeros((4, 3)), quaternion=turned)
    diagonal = np.diag([790.4] * 3 + [40.0] * 3)
    model = modes(np.diag([1e-6] * 3 + [2e-6] * 3)[None], diagonal[None])[0]
    obtained, _ = deflections(model, reference, 100)
    w = np.sqrt(1 / (2e-6 * 40.0))
    damped, t = w * np.sqrt(1 - LIGHT**2), np.arange(101) * PERIOD - 0.05
    expected = np.where(t < 0, 0.0, -0.02 / 0.05 / damped * np.exp(-LIGHT * w * t) * np.sin(damped * t))
    np.testing.assert_allclose(obtained[:, 3], expected, atol=1e-9 * np.abs(expected).max())
    assert not deflections(modes(np.diag([1e-6] * 6)[None], TRANSLATIONS[None])[0], reference, 100)[0].any()


def test_the_motion_of_a_reference_is_its_corners_its_acceleration_and_that_of_its_start_and_the_paper_has_none():
    reference = knots([0.0, 0.002, 0.004], along_y([0.0, 0.002, 0.0]))
    motion = reference_motion(reference, Clock(1e-3, 1).stamp(np.arange(7)))
    expected = np.zeros((6, 18))
    expected[2, 1], expected[4, 1] = -2.0, 1.0  # from 1 to -1 m/s, and to rest at the end
    np.testing.assert_allclose(motion, expected, atol=1e-10)
    target = knots([0.0, 0.4], np.array([[0.0, 0, 0], [0.04, 0, 0]]))
    corrected = target.with_position(target.position + along_y([0.0, 4e-4]))
    stamps = Clock(PERIOD, 1).stamp(np.arange(401))
    assert not reference_motion(corrected, stamps)[0, :6].any()
    jump = reference_motion(corrected, stamps, approach(target))[0, :6]
    np.testing.assert_allclose(jump, [0, 1e-3, 0, 0, 0, 0], atol=1e-15)
    assert not PAPER.dynamics.reference_inertia and not arm_model_of(PAPER, path_of(PAPER).target).reference.size
    assert read_cell("test_piece.yaml").dynamics.reference_inertia
    assert Dynamics("lumped", 0.1).reference_inertia


# --- Modes of the arm in workpiece axes, from its elastostatics and mass ---
def test_frequencies_and_static_limit_are_those_of_the_loaded_arm_in_workpiece_axes():
    arm, mount, joints = PAPER.arm, PAPER.mount, arm_of(PAPER).joints(path_of(PAPER).target)[:1]
    turn = np.kron(np.eye(2), PAPER.workpiece.pose.rotation)
    for mass_model, gravity in itertools.product(("lumped", "consistent"), (True, False)):
        (model,) = modal_models(arm, mount, Dynamics(mass_model, ZETA, gravity), PAPER.workpiece.pose, joints)
        soft = compliance(equilibrium(arm, mount, joints, None, gravity), arm)
        expected = mode_frequencies(soft, cartesian_mass(arm, mount, joints, mass_model))[0]
        np.testing.assert_allclose(model.frequency / (2 * np.pi), expected, rtol=1e-7)
        static = model.output @ model.shape @ np.diag(model.frequency**-2.0) @ model.shape.T @ model.force
        np.testing.assert_allclose(static + model.feedthrough, turn.T @ soft[0] @ turn, rtol=1e-8, atol=1e-14)


CUT = ("path.length_mm=24", "stock.grid_step_um=40", "stock.max_mm=[24,12,0]")


# --- Measured modes against the arm whose modes they are, closed forms, and what a file may say of them ---
GROUPS = """/**:
  ros__parameters:
    includes: ["paper.yaml"]
    path: {length_mm: 14.4}
    dynamics:
      modes:
        - {frequency_hz: 7.07, damping_ratio: 0.037, shape: [0.01, 0.05, 0.0, 0.0, 0.0, 0.02]}
        - {frequency_hz: 10.3, damping_ratio: 0.022, shape: [0.04, -0.01, 0.02, 0.0, 0.01, 0.0]}
"""


def test_the_modes_of_an_arm_in_the_place_of_the_arm_give_the_same_pass():
    cell = read_cell("paper.yaml", *CUT, "dynamics.mass_model=rigid", "dynamics.reference_inertia=true")
    target = path_of(cell).target
    bent = target.with_position(target.position + np.outer(np.arange(len(target)) % 2 * 2e-5, [1.0, 1.0, 0.5]))
    arm = modal_model_of(cell)  # whose modes an experiment without errors gives
    frequency, shapes = arm.frequency / (2 * np.pi), (arm.output @ arm.shape).T.ravel()
    measured = MeasuredModes(frequency, np.full(frequency.size, 0.182), shapes)
    same = cell.replace(dynamics=cell.dynamics.replace(modes=measured))
    exact, obtained = (simulate(c, bent).result for c in (cell, same))
    np.testing.assert_allclose(obtained.deflection, exact.deflection, atol=1e-9 * np.abs(exact.deflection).max())
    assert obtained.volume.sum() > 0.0


def test_measured_modes_ring_down_each_with_its_ratio_and_leave_the_tool_behind_a_quick_jump_where_they_move_it():
    model = measured_model(MeasuredModes(np.array([5.0, 20.0]), np.array([0.1, 0.02]), np.eye(6)[:2].ravel()))
    arm = CompliantArm(arm_model([model], 0.5, 1e-3))
    arm.state[:2] = 1e-3
    for _ in range(200):
        deflection = arm.correct(np.zeros(6))
    for k, (f, zeta) in enumerate(((5.0, 0.1), (20.0, 0.02))):
        w = 2 * np.pi * f
        damped = w * np.sqrt(1 - zeta**2)
        turned = np.cos(damped * 0.2) + zeta * w / damped * np.sin(damped * 0.2)
        assert deflection[k] == pytest.approx(1e-3 * np.exp(-zeta * w * 0.2) * turned, rel=1e-9)
    shapes = np.array([[0.05, 0.01, 0.0, 0.0, 0.05, 0.02], [-0.01, 0.04, 0.0, 0.02, 0.0, 0.0]])
    model = measured_model(MeasuredModes(np.array([7.0, 9.0]), np.array([0.03, 0.03]), shapes.ravel()))
    period = 1e-6
    jump = Trajectory(np.array([0, 1000, 100_000]), np.array([[0, 0, 0], [1e-3, 2e-3, 3e-3], [1e-3, 2e-3, 3e-3]]),
                      TOOL_DOWN)  # fmt: skip
    pushed = arm_model([model], 0.1, period, 1.0, True, np.zeros(6))
    arm = CompliantArm(pushed, pushed.push(jump, Clock(period, 1).stamp(np.arange(3))))
    arm.correct(np.zeros(6))
    tool = np.array([1e-3, 2e-3, 3e-3]) + arm.correct(np.zeros(6))[:3]
    np.testing.assert_allclose(tool, [0.0, 0.0, 3e-3], atol=2e-6)


def test_a_list_of_groups_is_read_and_handed_to_a_node_as_a_group_of_lists(tmp_path):
    (tmp_path / "cell.yaml").write_text(GROUPS)
    cell = read_cell(tmp_path / "cell.yaml")
    np.testing.assert_allclose(cell.dynamics.modes.frequency, [7.07, 10.3])
    np.testing.assert_allclose(cell.dynamics.modes.shape[6:8], [0.04, -0.01])
    (tmp_path / "node.yaml").write_text(cell_text(cell))
    again = read_cell(tmp_path / "node.yaml").dynamics.modes
    np.testing.assert_array_equal(again.shape, cell.dynamics.modes.shape)
    assert simulate(cell).result.wrench.any()


@pytest.mark.parametrize("old, new, reason", [
    ("0.0, 0.0, 0.02]", "0.0, 0.02]", "the same keys in every group"),
    ("frequency_hz: 10.3, ", "", "the same keys in every group"),
    ("frequency_hz: 10.3", "frequency_hz: 0.0", "above 0"),
    ("[0.04, -0.01, 0.02, 0.0, 0.01, 0.0]", "[0.02, 0.1, 0.0, 0.0, 0.0, 0.04]", "none is a combination"),
    ("[0.04,", "[.nan,", "finite"),
    ("dynamics:", "dynamics:\n      follow_pose: true", "one posture"),
])  # fmt: skip
def test_modes_that_cannot_be_are_refused_with_the_key(tmp_path, old, new, reason):
    assert old in GROUPS
    (tmp_path / "cell.yaml").write_text(GROUPS.replace(old, new))
    with pytest.raises(ConfigError, match=reason):
        read_cell(tmp_path / "cell.yaml")


def test_lists_that_do_not_fit_each_other_and_a_stiffness_with_a_stick_out_are_refused():
    for lists in (("[7.0]", "[0.1, 0.2]", "[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]"), ("[7.0]", "[0.1]", "[1.0, 2.0]")):
        names = ("frequency_hz", "damping_ratio", "shape")
        with pytest.raises(ConfigError, match="for 1 modes"):
            read_cell("paper.yaml", *[f"dynamics.modes.{k}={v}" for k, v in zip(names, lists, strict=True)])
    with pytest.raises(ConfigError, match=r"tool\.stiffness_n_per_um.*stick_out_mm"):
        cell(SOFT, "tool.stick_out_mm=40")


# --- A tool that bends: the closed form of a cantilever, and a spring in series with the arm ---
SOFT = "tool.stiffness_n_per_um=2"


def cell(*settings):
    return read_cell("paper.yaml", *CUT, *settings)


@pytest.mark.parametrize("settings, expected", [
    # F L^3 / (3 E I), I = pi r^4 / 4: r 10 mm, L 80 mm, 210 GPa
    (["tool.stick_out_mm=80", "tool.modulus_gpa=210", "tool.flute_section=1"],
     0.08**3 / (630e9 * np.pi * 0.01**4 / 4)),
    # of carbide, d = 10 mm, L = 40 mm, flutes as 8 mm: 64e-6 / (1.8e12 pi 8e-3^4 / 64)
    (["tool.diameter_mm=10", "tool.stick_out_mm=40"], 64e-6 / (1.8e12 * np.pi * 0.008**4 / 64)),
    # the flutes end at 30 of 50 mm; unit load method: integral of x^2 / (E I) over both parts
    (["tool.stick_out_mm=50", "tool.flute_length_mm=30", "tool.shank_diameter_mm=18"],
     (0.05**3 - 0.03**3) / (1.8e12 * np.pi * 0.018**4 / 64) + 0.03**3 / (1.8e12 * np.pi * 0.016**4 / 64)),
    ([SOFT], 0.5e-6),
    ([], 0.0),
])  # fmt: skip
def test_the_compliance_is_that_of_a_stepped_cantilever(settings, expected):
    assert cell(*settings).tool.lateral_compliance == pytest.approx(expected, rel=1e-12)


def test_the_bending_stress_is_that_of_the_worst_section_of_the_stepped_cantilever():
    """M / W of lever and diameter [mm]; the flutes of 20 mm count as 16 mm."""
    sections = {(40, 0, 0): (40, 16), (50, 30, 18): (50, 18), (50, 45, 30): (45, 16), (0, 30, 18): (0, 16)}
    for (stick_out, fluted, shank), (lever, width) in sections.items():
        keys = f"tool.stick_out_mm={stick_out}", f"tool.flute_length_mm={fluted}", f"tool.shank_diameter_mm={shank}"
        expected = 1e-3 * lever / (np.pi * (1e-3 * width) ** 3 / 32)
        assert cell(*keys).tool.bending_stress == pytest.approx(expected, rel=1e-12)


def test_a_constant_force_moves_the_tool_by_the_sum_of_both_springs_and_a_step_with_the_mean_of_a_revolution():
    # static end of the equation of motion: C_arm F + C_tool (F - (F . z) z), rotations without the tool's
    for settings in ([], ["dynamics.mass_model=rigid", "dynamics.follow_pose=true"]):
        tried = cell(SOFT, "dynamics.damping_ratio=0.5", *settings)
        model = arm_model_of(tried, path_of(tried).target)
        still, wrench = np.zeros((0, model.order)), np.tile([100.0, -80.0, 60.0, 2.0, 1.0, 3.0], (4000, 1))
        moved = follow(model, still, wrench)[-1]
        at = arm_of(tried).joints(path_of(tried).target)[-1 if settings else 0]
        soft = compliance(equilibrium(tried.arm, tried.mount, at), tried.arm)
        arm = rotate_matrix(soft, tried.workpiece.pose.rotation.T) @ wrench[0]
        assert moved == pytest.approx(arm + [50e-6, -40e-6, 0.0, 0.0, 0.0, 0.0], rel=2e-3, abs=1e-9)
    # a step of the force: 1 - exp(-t / T) of the displacement at the time t, T the revolution, whatever H is
    for period in (0.25, 0.5):
        soft, rigid = (cell(f"exchange.period_ms={period}", *more) for more in ((SOFT,), ()))
        both = [CompliantArm(arm_model_of(one, path_of(one).target)) for one in (soft, rigid)]
        steps = round(7.5 / period)  # [ms], a revolution at 8000 rpm
        for _ in range(steps):
            bent, plain = (arm.correct(np.array([0.0, 100.0, 0.0, 0.0, 0.0, 0.0])) for arm in both)
        assert (bent - plain)[1] == pytest.approx(50e-6 * (1 - np.exp(-1)), rel=1e-6)


def test_the_mirror_and_other_methods_remove_the_displacement_of_the_tool_as_well():
    # without the tool in its model ``mirror`` would leave 0.5 um/N x 81 N = 40 um
    tried = cell(SOFT)
    original = simulate(tried)
    for method in ("linear", "mirror", "inverse"):
        left = compensated(tried, original, method).scores.static_deviation
        assert abs(left) < 0.08 * original.scores.static_deviation
    wrench = np.tile([100.0, -80.0, 60.0, 0.0, 0.0, 0.0], (len(path_of(tried).target), 1))
    bent, rigid = (
        mirrored(arm_of(one), one.compensation.relaxation, path_of(one).target, wrench).position
        for one in (tried, cell())
    )
    assert bent - rigid == pytest.approx(np.tile([-50e-6, 40e-6, 0.0], (len(bent), 1)), abs=1e-7)
