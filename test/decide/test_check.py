"""What ``check`` finds: each fault made on purpose, at the point where it was made."""

from __future__ import annotations

import json

import numpy as np
import pytest
from small_part import GCODE, assignments, small_part

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cli import main
from kr270_milling.decide.check import check
from kr270_milling.decide.path_limits import arm_violations
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


def along_joints(cell, joints) -> Trajectory:
    """The trajectory whose inverse kinematics gives these joint positions [rad], (n, 6), one every 50 ms."""
    tool = cell.workpiece.pose.inverse() @ pose(cell.arm, cell.mount, joints)
    return Trajectory(np.arange(len(joints)) * 50_000_000, tool.position, tool.quaternion)


def test_a_sound_path_may_be_run_and_is_simulated(cell):
    checked = check(cell)
    assert checked.may_be_run and checked.points == len(cell.target()) and checked.ran.result.removed_volume > 0
    assert checked.as_dict()["may_be_run"] and kinds(checked, "note") <= {"load reversal"}


def test_the_papers_own_case_may_be_run():
    assert check(read_cell(find_file("paper.yaml"))).may_be_run


def test_every_finding_has_the_line_of_its_point(cell, ran):
    checked = check(with_limits(cell, spindle_torque=1e-3), ran=ran)
    first = checked.findings[0]
    assert first.what == "spindle torque" and first.where.line in (6, 7, 9)  # the cutting moves of the file
    assert f"(line {first.where.line})" in first.text and first.where.feature in ("leg", "arc")
    place = cell.target().position[first.where.point - 1]
    assert first.where.position_mm == pytest.approx((1e3 * place).tolist())


def test_out_of_reach_names_all_points_that_are(cell):
    far = Trajectory(np.arange(9) * 10**9, np.outer(np.linspace(0, 2, 9), [-1.0, 0.0, 0.0]), TOOL_DOWN)
    found, joints = arm_violations(cell, far)
    tool, arm = cell.workpiece.pose.apply(far.position), cell.arm  # -x leads away from the arm and up
    centre = tool + arm.d6 * cell.workpiece.pose.rotation[:, 2]  # no tool: the flange is d6 in front of the wrist
    away = np.hypot(np.hypot(*centre[:, :2].T) - arm.a1, centre[:, 2] - arm.d1)
    lost = np.flatnonzero(away > arm.a2 + arm.forearm) + 1
    assert joints is None and 2 < len(lost) < 9 and found[0].point == np.argmax(away) + 1
    assert f"at points {lost[0]} to {lost[-1]}: " in found[0].sentence
    assert found[0].value == pytest.approx(away.max(), abs=1e-9) and len(found) == 1


def test_a_joint_beyond_its_range_is_named_with_its_worst_point(cell):
    q = np.tile(cell.posture, (5, 1))
    q[:, 4] = np.radians([110, 120, 126, 128, 121])  # A5 has +-125 deg
    found, joints = arm_violations(cell, along_joints(cell, q))
    (limit,) = [f for f in found if f.kind == "joint limit"]
    assert limit.point == 4 and limit.severity == "stop" and "axis 5" in limit.sentence
    assert "points 3 to 4" in limit.sentence and joints == pytest.approx(q, abs=1e-9)


def test_a_pass_through_a5_zero_is_a_singularity_and_a_flip(cell):
    q = np.tile(cell.posture, (9, 1))
    q[:, 4] = np.radians(np.linspace(8, -8.5, 9))
    found, _ = arm_violations(cell, along_joints(cell, q))
    assert [f.point for f in found if f.kind == "configuration flip"] == [5]
    (near,) = [f for f in found if f.kind == "singularity"]
    assert np.degrees(near.value) == pytest.approx(np.abs(np.linspace(8, -8.5, 9)).min(), abs=1e-6)
    assert near.point == 5 and "wrist" in near.sentence


def test_elbow_and_shoulder_are_watched_too(cell):
    q = np.tile(cell.posture, (3, 1))
    q[:, 2] = cell.arm.elbow_offset + np.radians([8, 6, 4])  # the stretched arm at elbow_offset
    (near,) = [f for f in arm_violations(cell, along_joints(cell, q))[0] if f.kind == "singularity"]
    assert near.point == 3 and "elbow" in near.sentence and np.degrees(near.value) == pytest.approx(4, abs=1e-6)
    strict = with_limits(cell, shoulder_distance=5.0)
    found = arm_violations(strict, along_joints(cell, np.tile(cell.posture, (3, 1))))[0]
    (near,) = [f for f in found if f.kind == "singularity"]
    wrist = pose(cell.arm, cell.mount, cell.posture)  # no tool: the flange is d6 in front of the wrist centre
    centre = wrist.position - cell.arm.d6 * wrist.rotation[:, 2]
    assert near.value == pytest.approx(np.hypot(*centre[:2]), abs=1e-9) and "axis 1" in near.sentence


def test_a_fast_joint_and_a_hard_one_are_found_at_their_points(cell):
    q = np.tile(cell.posture, (6, 1))
    q[3:, 0] += np.radians(6.0)  # 120 deg/s within one step of 50 ms, where 110 are allowed
    found, _ = arm_violations(cell, along_joints(cell, q))
    (fast,) = [f for f in found if f.kind == "joint speed"]
    assert fast.point == 4 and np.degrees(fast.value) == pytest.approx(120, rel=1e-6) and "axis 1" in fast.sentence
    assert {f.kind for f in found if f.severity == "stop"} == {"joint speed", "joint acceleration"}


def test_a_large_or_hasty_correction_must_not_be_run(cell, ran):
    target, how = cell.target(), cell.compensation
    shift = np.zeros((len(target), 3))
    shift[40, 1] = 1.01 * how.max_correction
    checked = check(cell, target.with_position(target.position + shift, target.velocity), ran=ran)
    found = {f.what: f for f in checked.findings if f.severity == "stop"}
    assert found["correction size"].where.point == 41 and found["correction per tick"].where.point in (41, 42)
    smooth = 0.9 * how.max_correction * np.sin(np.pi * np.linspace(0, 1, len(target)))[:, None] * [0, 1, 0]
    calm = check(cell, target.with_position(target.position + smooth, target.velocity), ran=ran)
    assert not kinds(calm) & {"correction size", "correction per tick"}


def test_blending_is_only_a_matter_of_lin_motions(cell, ran):
    target = cell.target()
    zigzag = 2e-5 * np.where(np.arange(len(target)) % 2, 1.0, -1.0)[:, None] * [0, 1, 0]
    revised = target.with_position(target.position + zigzag, target.velocity)
    assert "corner blending" in kinds(check(cell, revised, "LIN", ran), "warning")
    assert "corner blending" not in kinds(check(cell, revised, "SPLINE", ran), "warning")


def test_the_spindle_is_compared_with_what_the_pass_asks_for(cell, ran):
    torque, power = ran.result.torque.max(), (ran.result.torque * cell.tool.spindle_speed).max()
    enough = with_limits(cell, spindle_torque=float(1.001 * torque), spindle_power=float(1.001 * power))
    assert not kinds(check(enough, ran=ran))
    little = with_limits(cell, spindle_torque=float(0.999 * torque), spindle_power=float(0.999 * power))
    found = [f for f in check(little, ran=ran).findings if f.severity == "stop"]
    assert {f.what for f in found} == {"spindle torque", "spindle power"}
    assert [f.value for f in found if f.what == "spindle power"] == pytest.approx([1e-3 * power])  # [kW]


def test_a_reference_of_another_path_is_refused(cell):
    other = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.01, 0.05, 0.05)
    with pytest.raises(InputError, match="points of this cell's path"):
        check(cell, other)


def command(directory, *words: str, gcode: str = GCODE, sets=()) -> list[str]:
    pairs = assignments(directory, gcode, *sets)
    return ["check", "paper.yaml", *words, *(part for pair in pairs for part in ("--set", pair))]


def test_the_command_ends_with_1_when_the_path_must_not_be_run(tmp_path, capsys):
    assert main(command(tmp_path)) == 0
    assert "may be run, after a test in T1" in capsys.readouterr().out
    assert main(command(tmp_path, "--json", sets=["limits.spindle_torque_n_m=0.001"])) == 1
    found = json.loads(capsys.readouterr().out)
    assert not found["may_be_run"] and found["stops"] == sum(f["severity"] == "stop" for f in found["findings"])
    stop = found["findings"][0]
    assert stop["what"] == "spindle torque" and stop["where"]["line"] in (6, 7, 9) and stop["limit"] == 1e-3
    assert stop["unit"] == "N m" and stop["advice"] and stop["count"] >= 1


def test_words_that_move_no_tool_are_summed_up(tmp_path, capsys):
    program = GCODE.replace("(entry)", "G43 H1\nM8\n(entry)").replace("M5\n", "M9\nM8\nM5\n")
    assert main(command(tmp_path, "--json", gcode=program)) == 0
    words = {row["word"]: row["count"] for row in json.loads(capsys.readouterr().out)["read_over"]}
    assert words["M8"] == 2 and words["G43 H1"] == 1
    assert main(command(tmp_path, gcode=program)) == 0
    assert "read over: " in capsys.readouterr().out


def test_points_out_of_reach_are_findings_of_check(tmp_path, capsys):
    far = "G21 S8000 M3\nG0 X-14 Y0 Z-0.5\nG1 X12 F4000\nG1 Y2500\nM30\n"
    assert main(command(tmp_path, "--json", gcode=far)) == 1
    found = json.loads(capsys.readouterr().out)["findings"]
    assert {f["what"] for f in found} == {"reach", "stock too small"} and found[0]["where"]["line"] == 4


def test_the_command_checks_a_corrected_trajectory(tmp_path, capsys, cell):
    target = cell.target()
    revised = target.with_position(target.position + [0.0, 5e-3, 0.0], target.velocity)
    write_csv(tmp_path / "revised.csv", revised)
    assert main(command(tmp_path, "--reference", str(tmp_path / "revised.csv"))) == 1
    assert "the correction exceeds 2 mm" in capsys.readouterr().out


def test_a_correction_in_straight_lines_is_checked_as_lin_motions(cell, ran):
    target = cell.target()
    shift = np.linspace(0.0, 1e-4, len(target))[:, None] * [0.0, 1.0, 0.0]
    straight, smooth = (
        target.with_position(target.position + shift),
        target.with_position(target.position + shift, target.velocity),
    )
    strict = with_limits(cell, blending_share=1e-9)
    assert "corner blending" in kinds(check(strict, straight, ran=ran), "warning")
    assert "corner blending" not in kinds(check(strict, smooth, ran=ran), "warning")


def test_many_findings_of_one_kind_are_gathered_under_the_worst(tmp_path, capsys):
    zigzag = "".join(f"G1 Y{y}\nG1 X{x}\n" for x, y in zip(range(12, 24), [1, -1] * 6, strict=True))
    assert main(command(tmp_path, gcode=GCODE.replace("G1 Y10\n", zigzag + "G1 X12 Y10\n"))) == 0
    lines = capsys.readouterr().out.splitlines()
    reverses = [line for line in lines if "reverses" in line]
    assert len(reverses) <= 6 and any("more of the kind" in line for line in reverses)  # one line an axis at most
