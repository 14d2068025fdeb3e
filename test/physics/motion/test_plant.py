"""Imperfect plants: noise, repeatability, backlash, servo lag and the joining of points."""

import dataclasses

import numpy as np
import pytest

from kr270_milling import read_cell
from kr270_milling.base.column import as_dict
from kr270_milling.base.errors import ConfigError
from kr270_milling.cell.jobs import ScoredPass, compensated, simulate
from kr270_milling.cell.models import arm_model_of, arm_of, path_of
from kr270_milling.cell.plant import Plant, imperfect_arm, joint_gaps
from kr270_milling.decide.check_arm import backlash_statement, load_reversals
from kr270_milling.decide.compensation import compensate
from kr270_milling.decide.findings import gathered
from kr270_milling.path.controller_motion import other_motion
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.motion.backlash import Gaps, flanks, tool_jumps
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.milling_pass import CompliantArm, follow
from kr270_milling.physics.robot import jacobian, pose
from kr270_milling.physics.robot.mass import rigid_joint_mass

UM = 1e-6
SHORT = ("path.length_mm=12", "stock.grid_step_um=80", "exchange.micro_step_deg=3")


@pytest.fixture(scope="module")
def cell():
    return read_cell("paper.yaml", *SHORT)


@pytest.fixture(scope="module")
def ran(cell):
    return simulate(cell)


def test_repeatability_is_that_of_iso_9283_and_each_seed_and_number_of_a_pass_has_its_shift_and_noise():
    # ISO 9283: mean distance from the barycentre of many passes + 3 standard deviations of that distance
    shifts = np.array([Imperfections(repeatability=60 * UM).shift(n) for n in range(4000)])
    distance = np.linalg.norm(shifts - shifts.mean(axis=0), axis=1)
    assert distance.mean() + 3 * distance.std() == pytest.approx(60 * UM, rel=0.03)
    plant, zero = Imperfections(5 * UM, 60 * UM, seed=3), np.zeros((1000, 3))
    for drawn in (plant.shift, lambda number: plant.measured(zero, number)):
        assert np.array_equal(drawn(2), drawn(2)) and not np.any(drawn(2) == drawn(3))
    assert not np.any(plant.replace(seed=4).shift(2) == plant.shift(2))
    assert plant.measured(zero, 2).std() == pytest.approx(5 * UM, rel=0.05)
    assert abs(np.corrcoef(plant.measured(zero, 1)[:, 0], plant.measured(zero, 2)[:, 0])[0, 1]) < 0.15


def test_a_plant_is_its_cell_but_for_the_noise_of_its_tracker_the_place_of_its_pass_and_its_arm(cell, ran):
    plant = simulate(cell, plant=Plant(cell, cell))
    assert np.array_equal(ran.result.actual, plant.result.actual) and ran.scores == plant.scores
    assert np.array_equal(plant.record.position, plant.result.tool) and plant.record.noise == 0.0
    noisy = simulate(cell, plant=Plant(cell, cell, Imperfections(pose_noise=20 * UM)))
    assert np.array_equal(noisy.result.actual, ran.result.actual) and noisy.scores == ran.scores
    assert np.std(noisy.record.position - noisy.result.tool) == pytest.approx(20 * UM, rel=0.1)
    plant = Plant(cell, cell, Imperfections(repeatability=60 * UM))
    beside = simulate(cell, plant=plant).result
    moved, shift = beside.actual - ran.result.actual, plant.cell.imperfections.shift(0)
    assert moved == pytest.approx(np.broadcast_to(shift, moved.shape), abs=0.05 * 60 * UM)
    assert np.array_equal(beside.target, ran.result.target)
    other = cell.replace(path=cell.path.replace(length=0.03), dynamics=cell.dynamics.replace(damping_ratio=0.04))
    plant = Plant(cell, other)
    assert plant.cell.path is cell.path and plant.cell.dynamics.damping_ratio == 0.04
    assert simulate(cell, plant=plant).result.time_ns[-1] == ran.result.time_ns[-1]


# --- Backlash ---
LEVER, WIDTH, FRICTION = 1.5, 1e-4, 100.0  # [m], [rad], [N m]


def one_axis(friction: float = FRICTION) -> Gaps:
    """Joint 1 moves the tool along y at a lever; no other load than the cut, no mean over a revolution."""
    turns = np.zeros((1, 6, 6))
    turns[0, 1, 0] = LEVER
    only = np.eye(6)[0]
    return Gaps(np.zeros((1, 6)), turns, friction * only, WIDTH * only, 1.0, 1.0)


def lateral(*forces: float, periods: int = 5) -> np.ndarray:
    """Wrenches of a pass: each force [N] along y for some periods, after the row of the start."""
    wrenches = np.zeros((len(forces) * periods + 1, 6))
    wrenches[1:, 1] = np.repeat(forces, periods)
    return wrenches


def reversing(ran: ScoredPass) -> tuple[ScoredPass, int]:
    """The pass with a load across the feed that changes its sign in the middle, and the number of that sample."""
    wrench = np.zeros_like(ran.result.wrench)
    half = len(wrench) // 2
    wrench[1:half, 1], wrench[half:, 1] = 100.0, -100.0
    return dataclasses.replace(ran, result=dataclasses.replace(ran.result, wrench=wrench)), half


def test_a_load_that_reverses_beyond_the_friction_torque_moves_the_tool_by_backlash_times_lever(cell):
    plain = arm_model_of(cell, path_of(cell).target)
    wrenches = lateral(100.0, -100.0, 100.0)  # 150 N m about the axis
    still = np.zeros((0, plain.order))
    moved = follow(dataclasses.replace(plain, gaps=one_axis()), still, wrenches) - follow(plain, still, wrenches)
    expected = np.zeros((16, 6))
    expected[6:11, 1] = -WIDTH * LEVER
    assert moved == pytest.approx(expected, abs=1e-15)
    assert tool_jumps(one_axis(), wrenches) == [(6, 0, WIDTH * LEVER), (11, 0, WIDTH * LEVER)]
    assert tool_jumps(one_axis(), lateral(100.0, -66.0, 0.0, 100.0)) == []  # 99 N m against 100 N m
    assert len(tool_jumps(one_axis(), lateral(100.0, -67.0, 0.0, 66.0))) == 1
    assert len(tool_jumps(one_axis(0.0), lateral(100.0, -1.0, 0.0, 1.0))) == 2
    assert flanks(one_axis(), lateral(50.0, 100.0, -50.0))[:, 0].tolist() == [0.0] * 6 + [1.0] * 10


def test_the_load_on_a_joint_is_weight_less_inertia_of_the_path_and_single_teeth_do_not_reverse_it(cell):
    # at the turning points of a motion about axis 1 alone the inertia torque is -M_11 q1''
    joints = np.tile(cell.start_joints, (41, 1))
    swing, speed = np.radians(1.5), 2 * np.pi / 2.0  # [rad], [rad/s]
    time = np.arange(41) * 0.05
    joints[:, 0] += swing * np.cos(speed * time)
    tool = cell.workpiece.pose.inverse() @ pose(cell.arm, cell.mount, joints)
    run = Trajectory(np.arange(41) * 50_000_000, tool.position, tool.quaternion)
    gaps = joint_gaps(arm_of(cell), path_of(cell), run, cell.arm.backlash)
    inertia = rigid_joint_mass(cell.arm, cell.mount, joints[20])[0, 0]
    assert gaps.torque[20, 0] == pytest.approx(-inertia * swing * speed**2, rel=0.01)
    assert len(tool_jumps(gaps, np.zeros((path_of(cell).clock.steps(run.duration_ns) + 1, 6)))) >= 1
    # at 533 Hz the torque changes its sign, its mean over a revolution does not
    share = joint_gaps(arm_of(cell), path_of(cell), path_of(cell).target, cell.arm.backlash).share
    revolution = 2 * np.pi / cell.tool.spindle_speed
    assert share == pytest.approx(1 - np.exp(-cell.exchange.period / revolution))
    gaps = dataclasses.replace(one_axis(0.0), share=share)
    teeth = 100.0 + 300.0 * np.sin(2 * np.pi * 533.3 * cell.exchange.period * np.arange(400))
    settled = np.concatenate([np.full(100, 100.0), teeth])
    assert teeth.min() < -150.0 and tool_jumps(gaps, lateral(*settled, periods=1)) == []


def test_check_and_decision_name_the_place_and_the_jump_where_the_load_reverses(cell, ran):
    loaded, half = reversing(ran)
    (one,) = load_reversals(arm_of(cell), path_of(cell), path_of(cell).target, loaded)
    lever = np.linalg.norm(jacobian(cell.arm, cell.mount, cell.start_joints)[:3, 0])
    assert one.value == pytest.approx(1e6 * cell.arm.backlash[0] * lever, rel=0.01) and one.severity == "note"
    assert abs(path_of(cell).target.time_ns[one.where.point - 1] - ran.result.time_ns[half]) <= 60_000_000
    assert "if axis 1 has 6.2 arcsec of backlash (assumed)" in one.sentence
    stiff = cell.replace(arm=cell.arm.replace(friction_torque=np.full(6, 1e4)))
    assert load_reversals(arm_of(stiff), path_of(stiff), path_of(stiff).target, loaded) == []
    known = cell.replace(arm=cell.arm.replace(backlash=2 * cell.arm.backlash))
    (twice,) = load_reversals(arm_of(known), path_of(known), path_of(known).target, loaded)
    assert twice.value == pytest.approx(2 * one.value) and "12.4 arcsec of backlash (arm.back" in twice.sentence
    places = gathered(path_of(cell), path_of(cell).target, [one])
    assert (
        backlash_statement(cell.arm.backlash, (0.0, 2.0), places, True)
        == "backlash: in the verdict only, 0 to 12.4 arcsec"
    )
    assert "not included, up to 49.2 um" in backlash_statement(cell.arm.backlash, (0.0, 2.0), places, False)
    decision = compensate(cell, "linear").decision
    assert decision.backlash == "backlash: not included, no load reverses"
    assert decision.backlash in decision.headline and decision.backlash in decision.lines()
    assert as_dict(decision)["backlash"] == decision.backlash


def test_the_plant_moves_by_the_number_of_the_check_and_without_a_reversal_as_if_it_had_no_backlash(cell, ran):
    loaded, half = reversing(ran)
    (one,), wrench = load_reversals(arm_of(cell), path_of(cell), path_of(cell).target, loaded), loaded.result.wrench
    plant = cell.replace(imperfections=Imperfections(backlash=cell.arm.backlash))
    plain = arm_model_of(cell, path_of(cell).target)
    arm = imperfect_arm(plant, path_of(cell).target, plain)
    still = np.zeros((0, plain.order))
    moved = follow(arm, still, wrench) - follow(plain, still, wrench)
    first = int(np.argmax(moved.any(axis=1)))
    assert 1e6 * np.linalg.norm(moved[first, :3]) == pytest.approx(one.value, rel=1e-9) and half <= first < half + 30
    assert moved[first:].any(axis=1).all()
    robot = CompliantArm(arm)
    assert np.array_equal([robot.correct(w) for w in wrench[1:]], follow(arm, still, wrench)[1:])
    # the paper's straight cut loads every joint to one side
    assert load_reversals(arm_of(cell), path_of(cell), path_of(cell).target, ran) == []
    cuts = simulate(cell, plant=Plant(cell, cell, Imperfections(backlash=cell.arm.backlash)))
    assert np.array_equal(cuts.result.actual, ran.result.actual)


def test_keys_of_earlier_versions_are_refused_with_their_new_name():
    for old, new in (
        ("cutting.end_ratio", "cutting.end_share"),
        ("limits.backlash_deg", "arm.backlash_arcsec"),
        ("imperfections.backlash_deg", "imperfections.backlash_arcsec"),
        ("uncertainty.backlash_deg", "uncertainty.backlash is a multiple"),
    ):
        with pytest.raises(ConfigError, match=new):
            read_cell("paper.yaml", f"{old}=[0.01, 0.01, 0.01, 0.01, 0.01, 0.01]")


def test_the_compensator_receives_the_wrench_of_a_sensor(cell):
    """Noise while the tool cuts, its moments by a lever of 0.1 m; another one in each pass; the part is not noisy."""
    exact, noisy, none = (
        simulate(cell, plant=Plant(cell, cell, Imperfections(wrench=wrench))) for wrench in ("exact", "noisy", "none")
    )
    true = exact.record.wrench
    assert np.array_equal(true, exact.result.wrench) and none.record.wrench is None
    sensed, cuts = noisy.record.wrench, true.any(axis=1)
    assert not np.any(sensed[~cuts]) and cuts.sum() > 100
    assert (sensed - true)[cuts].std(axis=0) == pytest.approx([2.0, 2.0, 2.0, 0.2, 0.2, 0.2], rel=0.2)
    assert np.array_equal(noisy.result.actual, exact.result.actual)
    assert not np.any(Imperfections().sensed(true, 0)[cuts] == Imperfections().sensed(true, 1)[cuts])


@pytest.mark.parametrize("frequency, delay", [(10.0, 0.0), (40.0, 0.012), (0.0, 0.004)])
def test_motors_follow_a_step_of_the_correction_as_a_second_order_after_a_dead_time(frequency, delay):
    """y = 1 - exp(-z w t) (cos(w_d t) + z w / w_d sin(w_d t)), z = 0.7; the programmed path itself is not late."""
    time_ns = np.array([0, 100, 101, 1000]) * 1_000_000
    target = Trajectory(time_ns, np.outer(time_ns * 1e-9, [0.05, 0.0, 0.0]), TOOL_DOWN)
    step = np.outer([0.0, 0.0, 1.0, 1.0], [0.0, 100 * UM, 0.0])
    servo = Imperfections(servo_frequency=frequency, servo_delay=delay)
    course = servo.lagged(target.with_position(target.position + step), target)
    stamps = np.arange(0, 1000, 3) * 1_000_000
    t = np.maximum(stamps * 1e-9 - 0.1005 - delay, 0.0)
    w, z = 2 * np.pi * frequency, 0.7
    d = w * np.sqrt(1 - z * z)
    expected = 1 - np.exp(-z * w * t) * (np.cos(d * t) + z * w / d * np.sin(d * t)) if frequency else np.sign(t)
    moved = course.sample(stamps) - target.sample(stamps)
    settled = np.abs(stamps * 1e-9 - 0.1005 - delay) > 0.001
    assert moved[settled, 1] == pytest.approx(100 * UM * expected[settled], abs=0.6 * UM)
    assert np.abs(moved[:, [0, 2]]).max() < 1e-15 and servo.lagged(target, target) is target


def test_what_is_in_no_model_spoils_what_inverse_plans(cell, ran):
    """A lag of the motors, and another spline through the points than the planned one."""
    perfect = compensated(cell, ran, "inverse").scores.max_deviation
    for other in ({"servo_frequency": 10.0}, {"joining": 1.0}):
        plant = Plant(cell, cell, Imperfections(wrench="exact", **other))
        original = simulate(cell, plant=plant)
        left = compensated(cell, original, "inverse", plant=plant).scores.max_deviation
        assert 1.1 * perfect < left < original.scores.max_deviation


def test_another_controller_runs_a_parabola_exactly_and_blends_the_corners_of_straight_lines():
    """Three points give the slope of a parabola; a blend at d misses a corner by d sin(turn / 2) / 2, but at stops."""
    time_ns = np.array([0, 5, 12, 20, 33]) * 1_000_000
    way = np.array([1.0, 2.0, -1.0])
    target = Trajectory(time_ns, np.outer((time_ns * 1e-9) ** 2, way), TOOL_DOWN)
    planned = target.with_position(target.position, np.outer([0.0, 7.0, -3.0, 5.0, 66e-3], way))
    other, stamps = other_motion(planned, target, 1.0, 1e-3), np.arange(5, 33) * 1_000_000
    assert other.sample(stamps[:15]) == pytest.approx(np.outer((stamps[:15] * 1e-9) ** 2, way), abs=1e-12)
    half = other_motion(planned, target, 0.5, 1e-3)
    assert half.sample(stamps) == pytest.approx((other.sample(stamps) + planned.sample(stamps)) / 2, abs=1e-12)
    corner = np.array([[0.0, 0, 0], [4e-3, 0, 0], [4e-3, 1e-3, 0], [8e-3, 1e-3, 0], [9e-3, 1e-3, 0]])
    lines = Trajectory(time_ns, corner, TOOL_DOWN)
    for blend, distance in ((0.2e-3, 0.2e-3), (1e-3, 0.5e-3)):  # at most half of the leg of 1 mm
        missed = np.linalg.norm(other_motion(lines, lines, 1.0, blend).position - corner, axis=1)
        assert missed == pytest.approx(distance * np.sqrt(0.5) / 2 * np.array([0, 1, 1, 0, 0]), abs=1e-12)
    stops = lines.with_position(corner, np.outer([1, 1, 0, 1, 1], way))
    missed = np.linalg.norm(other_motion(lines, stops, 1.0, 1e-3).position - corner, axis=1)
    assert missed[2] == 0.0 < missed[1]
