"""Findings of check: faults of the path and of a correction, each at the point where it was made."""

from __future__ import annotations

import numpy as np
import pytest
from hostile import answered, ask, settings
from small_part import assignments, small_part

from kr270_milling.base.errors import InputError
from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.check import check
from kr270_milling.decide.findings import violations
from kr270_milling.decide.path_limits import arm_violations, corner_blending, correction_per_tick, correction_size
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.path.trajectory_csv import write_csv
from kr270_milling.physics.robot import pose


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_part(tmp_path_factory.mktemp("part"))


@pytest.fixture(scope="module")
def ran(cell):
    return simulate(cell)


def kinds(checked, severity: str = "stop") -> set[str]:
    return {f.what for f in checked.findings if f.severity == severity}


def with_limits(cell, **changes):
    return cell.replace(limits=cell.limits.replace(**changes))


# --- The arm along a path ---
def along_joints(cell, joints):
    """The findings of the trajectory whose inverse kinematics gives these joint positions [rad], one every 50 ms."""
    tool = cell.workpiece.pose.inverse() @ pose(cell.arm, cell.mount, joints)
    run = Trajectory(np.arange(len(joints)) * 50_000_000, tool.position, tool.quaternion)
    results, solved = arm_violations(cell, run)
    assert solved == pytest.approx(joints, abs=1e-9)
    return results


def test_out_of_reach_names_all_points_that_are(cell):
    far = Trajectory(np.arange(9) * 10**9, np.outer(np.linspace(0, 2, 9), [-1.0, 0.0, 0.0]), TOOL_DOWN)
    (finding,), joints = arm_violations(cell, far)
    tool, arm = cell.workpiece.pose.apply(far.position), cell.arm  # -x leads away from the arm and up
    centre = tool + arm.d6 * cell.workpiece.pose.rotation[:, 2]  # no tool: the flange is d6 in front of the wrist
    away = np.hypot(np.hypot(*centre[:, :2].T) - arm.a1, centre[:, 2] - arm.d1)
    lost = np.flatnonzero(away > arm.a2 + arm.forearm) + 1
    assert joints is None and 2 < len(lost) < 9 and finding.point == np.argmax(away) + 1
    assert f"at points {lost[0]} to {lost[-1]}: " in finding.sentence
    assert finding.value == pytest.approx(away.max(), abs=1e-9)


def test_a_joint_beyond_its_range_or_too_fast_or_hard_is_named_with_its_worst_point(cell):
    q = np.tile(cell.posture, (5, 1))
    q[:, 4] = np.radians([110, 120, 126, 128, 121])  # A5 has +-125 deg
    (limit,) = [f for f in along_joints(cell, q) if f.kind == "joint limit"]
    assert limit.point == 4 and limit.severity == "stop" and "axis 5" in limit.sentence
    assert "points 3 to 4" in limit.sentence
    q = np.tile(cell.posture, (6, 1))
    q[3:, 0] += np.radians(6.0)  # 120 deg/s within one step of 50 ms, where 110 are allowed
    fast, hard = (f for f in along_joints(cell, q) if f.severity == "stop")
    assert fast.kind == "joint speed" and hard.kind == "joint acceleration" and hard.point in (3, 4)
    assert fast.point == 4 and np.degrees(fast.value) == pytest.approx(120, rel=1e-6) and "axis 1" in fast.sentence
    assert np.degrees(hard.value) == pytest.approx(120 / 0.05, rel=1e-6)


def test_singularities_of_wrist_elbow_and_shoulder_and_a_flip_of_the_wrist_have_their_points(cell):
    q = np.tile(cell.posture, (9, 1))
    q[:, 4] = np.radians(np.linspace(8, -8.5, 9))
    results = along_joints(cell, q)
    assert [f.point for f in results if f.kind == "configuration flip"] == [5]
    (near,) = [f for f in results if f.kind == "singularity"]
    assert np.degrees(near.value) == pytest.approx(np.abs(np.linspace(8, -8.5, 9)).min(), abs=1e-6)
    assert near.point == 5 and "wrist" in near.sentence
    q = np.tile(cell.posture, (3, 1))
    q[:, 2] = cell.arm.elbow_offset + np.radians([8, 6, 4])  # the stretched arm at elbow_offset
    (near,) = [f for f in along_joints(cell, q) if f.kind == "singularity"]
    assert near.point == 3 and "elbow" in near.sentence and np.degrees(near.value) == pytest.approx(4, abs=1e-6)
    results = along_joints(with_limits(cell, shoulder_distance=5.0), np.tile(cell.posture, (3, 1)))
    (near,) = [f for f in results if f.kind == "singularity"]
    wrist = pose(cell.arm, cell.mount, cell.posture)  # no tool: the flange is d6 in front of the wrist centre
    centre = wrist.position - cell.arm.d6 * wrist.rotation[:, 2]
    assert near.value == pytest.approx(np.hypot(*centre[:2]), abs=1e-9) and "axis 1" in near.sentence


# --- A correction ---
LINE = Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], 0.08, 4 / 60, 0.05)


def shifted(run, lateral):
    """The trajectory with a shift along y [m]."""
    return run.with_position(run.position + np.asarray(lateral)[:, None] * [0.0, 1.0, 0.0], run.velocity)


def test_a_large_correction_and_a_step_shared_by_the_ticks_of_its_interval_are_reported_at_their_points():
    revised = shifted(LINE, 1.2e-3 * (np.arange(25) == 7))
    (finding,) = correction_size(LINE, revised, 4_000_000, 1e-3)
    assert finding.point == 8 and finding.value == pytest.approx(1.2e-3) and "1200.0 um" in finding.sentence
    assert correction_size(LINE, revised, 4_000_000, 1.3e-3) == []
    revised = shifted(LINE, np.where(np.arange(25) >= 10, 1e-4, 0.0))  # 100 um within 50 ms: 8 um in each tick of 4 ms
    (finding,) = correction_per_tick(LINE, revised, 4_000_000, 7.9e-6)
    assert finding.point == 11 and finding.value == pytest.approx(8e-6)
    assert correction_per_tick(LINE, revised, 4_000_000, 8.1e-6) == []


def corner(stop: bool) -> tuple[Trajectory, Trajectory]:
    """10 mm along x, then 10 mm along y; the corner is corrected by 50 um."""
    position = np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0]])
    velocity = np.array([[0, 0, 0], [0, 0, 0] if stop else [0.05, 0.05, 0], [0, 0, 0]])
    original = Trajectory(np.array([0, 10**8, 2 * 10**8]), position, TOOL_DOWN, velocity)
    return original, original.with_position(position + [[0, 0, 0], [5e-5, 0, 0], [0, 0, 0]])


def test_blending_rounds_a_corner_as_a_parabola_does_unless_the_tool_stops():
    (finding,) = corner_blending(*corner(stop=False), 1e-3)
    control = np.array([[-1e-3, 0], [0, 0], [0, 1e-3]])  # legs of 1 mm about a right angle
    u = np.linspace(0, 1, 2001)[:, None]
    parabola = (1 - u) ** 2 * control[0] + 2 * u * (1 - u) * control[1] + u**2 * control[2]
    missed = np.hypot(*parabola.T).min()
    assert finding.point == 2 and finding.value == pytest.approx(missed / 5e-5, rel=1e-2)
    assert finding.severity == "warning"
    assert corner_blending(*corner(stop=True), 1e-3) == corner_blending(*corner(stop=False), 0.0) == []


def test_a_large_or_hasty_correction_must_not_be_run_and_a_reference_of_another_path_is_refused(cell, ran):
    target, most = cell.target(), cell.compensation.max_correction
    checked = check(cell, shifted(target, 1.01 * most * (np.arange(len(target)) == 40)), ran=ran)
    stops = {f.what: f for f in checked.findings if f.severity == "stop"}
    assert stops["correction size"].where.point == 41 and stops["correction per tick"].where.point in (41, 42)
    calm = check(cell, shifted(target, 0.9 * most * np.sin(np.pi * np.linspace(0, 1, len(target)))), ran=ran)
    assert not kinds(calm) & {"correction size", "correction per tick"}
    with pytest.raises(InputError, match="points of this cell's path"):
        check(cell, LINE)


def test_blending_is_only_a_matter_of_lin_motions(cell, ran):
    """A correction in straight lines of a smooth path is checked as LIN motions."""
    target, strict = cell.target(), with_limits(cell, blending_share=1e-9)
    smooth = shifted(target, np.linspace(0.0, 1e-4, len(target)))
    straight = target.with_position(smooth.position)
    for revised, motion, blended in (
        (smooth, "LIN", True), (smooth, "SPLINE", False), (straight, None, True), (smooth, None, False)
    ):  # fmt: skip
        assert ("corner blending" in kinds(check(strict, revised, motion, ran), "warning")) == blended


# --- Findings ---
def test_neighbours_that_exceed_make_one_finding_named_by_the_worst():
    first, second = violations("spindle torque", np.array([0, 2, 3, 2, 0, 1.5, 1.0]), 1.0)
    assert (first.point, first.value, first.limit, first.severity) == (3, 3.0, 1.0, "stop")
    assert "points 2 to 4" in first.sentence and "3 N m at point 3" in first.sentence
    assert second.point == 6 and "(point 6)" in second.sentence
    assert violations("spindle torque", np.array([0.0, np.nan]), 1.0)[0].point == 2
    assert violations("spindle torque", np.array([1.0, 1.0]), 1.0) == []


def test_the_spindle_is_compared_with_what_the_pass_asks_for_at_a_line_of_the_program(cell, ran):
    torque, power = ran.result.torque.max(), (ran.result.torque * cell.tool.spindle_speed).max()
    enough = with_limits(cell, spindle_torque=float(1.001 * torque), spindle_power=float(1.001 * power))
    assert not kinds(check(enough, ran=ran)) and kinds(check(enough, ran=ran), "note") <= {"load reversal"}
    little = with_limits(cell, spindle_torque=float(0.999 * torque), spindle_power=float(0.999 * power))
    first, second = sorted(check(little, ran=ran).findings[:2], key=lambda f: f.what)
    assert (first.what, second.what) == ("spindle power", "spindle torque")
    assert first.value == pytest.approx(1e-3 * power) and first.unit == "kW"
    assert first.where.line in (6, 7, 9) and first.where.feature in ("leg", "arc")  # the cutting moves of the file
    assert f"(line {first.where.line})" in first.text
    place = cell.target().position[first.where.point - 1]
    assert first.where.position_mm == pytest.approx((1e3 * place).tolist())


def test_the_command_ends_with_1_when_the_path_must_not_be_run(tmp_path, cell):
    through = "G21 G90 S8000 M3\nG43 H1\nM8\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X12 F4000\nG0 X20\nG1 X26\nG0 Z5\nM8\nM30\n"
    words = ["check", "paper.yaml", *settings(*assignments(tmp_path, through))]
    code, text, _ = ask(*words)
    assert code == 1 and "goes 8 mm through material, 0.5 mm deep at point" in text
    answer = answered(*words, code=1)
    assert (answer["may_be_run"], answer["stops"]) == (False, 1)
    assert answer["removed_by_rapid_moves_mm3"] == pytest.approx(80.0, rel=0.02)
    assert answer["read_over"] == [{"word": "M8", "count": 2}, {"word": "G43 H1", "count": 1}]
    assert [move["where"]["line"] for move in answer["rapid_moves"]] == [7]
    assignments(tmp_path)
    assert answered(*words)["may_be_run"]
    write_csv(tmp_path / "revised.csv", shifted(cell.target(), np.full(len(cell.target()), 5e-3)))
    code, text, _ = ask(*words, "--reference", str(tmp_path / "revised.csv"))
    assert code == 1 and "the correction exceeds 2000.0 um" in text
