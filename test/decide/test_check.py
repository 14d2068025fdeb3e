"""Findings of check: each fault made on purpose, at the point where it was made."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import pytest
from program_table import DIAMETERS_MM, ISSUE, Row, dangerous, random_sound, sound, with_rapid_cut
from small_part import GCODE, assignments, small_part

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cli import main
from kr270_milling.decide.check import check
from kr270_milling.decide.check_cut import engagement, rapid_violations
from kr270_milling.decide.findings import violations
from kr270_milling.decide.path_limits import (
    arm_violations,
    corner_blending,
    correction_per_tick,
    correction_size,
    joint_rate_violations,
)
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
    assert "the correction exceeds 2000.0 um" in capsys.readouterr().out


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


# --- Checks of a corrected path ---
LINE = Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], 0.08, 4 / 60, 0.05)
TICK = 4_000_000  # [ns]


def shifted(lateral) -> Trajectory:
    return LINE.with_position(LINE.position + np.asarray(lateral)[:, None] * [0.0, 1.0, 0.0])


def test_neighbours_that_exceed_make_one_finding_named_by_the_worst():
    first, second = violations("spindle torque", np.array([0, 2, 3, 2, 0, 1.5, 1.0]), 1.0)
    assert (first.point, first.value, first.limit, first.severity) == (3, 3.0, 1.0, "stop")
    assert "points 2 to 4" in first.sentence and "3 N m at point 3" in first.sentence
    assert second.point == 6 and "(point 6)" in second.sentence


def test_what_is_not_a_number_is_a_finding_and_what_equals_the_limit_is_none():
    assert violations("spindle torque", np.array([0.0, np.nan]), 1.0)[0].point == 2
    assert violations("spindle torque", np.array([1.0, 1.0]), 1.0) == []


def test_a_large_correction_is_found_at_its_point():
    lateral = np.zeros(25)
    lateral[7] = 1.2e-3
    (finding,) = correction_size(LINE, shifted(lateral), TICK, 1e-3)
    assert finding.point == 8 and finding.value == pytest.approx(1.2e-3) and "1200.0 um" in finding.sentence
    assert correction_size(LINE, shifted(lateral), TICK, 1.3e-3) == []


def test_a_step_of_the_correction_is_shared_by_the_ticks_of_its_interval():
    lateral = np.where(np.arange(25) >= 10, 1e-4, 0.0)
    revised = shifted(lateral)  # 100 um within 50 ms: 8 um in each tick of 4 ms
    (finding,) = correction_per_tick(LINE, revised, 4_000_000, 7.9e-6)
    assert finding.point == 11 and finding.value == pytest.approx(8e-6)
    assert correction_per_tick(LINE, revised, 4_000_000, 8.1e-6) == []


def corner(stop: bool) -> tuple[Trajectory, Trajectory]:
    """10 mm along x, then 10 mm along y; the corner is corrected by 50 um."""
    position = np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0]])
    velocity = np.array([[0, 0, 0], [0, 0, 0] if stop else [0.05, 0.05, 0], [0, 0, 0]])
    original = Trajectory(np.array([0, 10**8, 2 * 10**8]), position, TOOL_DOWN, velocity)
    return original, original.with_position(position + [[0, 0, 0], [5e-5, 0, 0], [0, 0, 0]])


def test_blending_rounds_a_corner_as_a_parabola_does():
    original, revised = corner(stop=False)
    (finding,) = corner_blending(original, revised, 1e-3)
    control = np.array([[-1e-3, 0], [0, 0], [0, 1e-3]])  # legs of 1 mm about a right angle
    u = np.linspace(0, 1, 2001)[:, None]
    parabola = (1 - u) ** 2 * control[0] + 2 * u * (1 - u) * control[1] + u**2 * control[2]
    missed = np.hypot(*parabola.T).min()
    assert finding.point == 2 and finding.value == pytest.approx(missed / 5e-5, rel=1e-2)
    assert finding.severity == "warning"


def test_no_blending_where_the_tool_stops_or_the_distance_is_nothing():
    assert corner_blending(*corner(stop=True), 1e-3) == []
    assert corner_blending(*corner(stop=False), 0.0) == []


def test_joint_speeds_and_accelerations_are_found_by_axis_and_point():
    time, none = np.arange(5) * 0.1, np.full(6, np.inf)
    joints = np.zeros((5, 6))
    joints[:, 2] = [0, 0, 0.2, 0.2, 0.2]  # 2 rad/s between points 2 and 3, 20 rad/s^2 at both
    (fast,) = joint_rate_violations(time, joints, np.full(6, 1.9), none)
    assert fast.point == 3 and "axis 3" in fast.sentence and fast.value == pytest.approx(2.0)
    (hard,) = joint_rate_violations(time, joints, none, np.full(6, 19.0), at_rest=False)
    assert hard.point in (2, 3) and hard.value == pytest.approx(20.0)
    assert joint_rate_violations(time, joints, np.full(6, 2.1), none) == []


# --- Cells and paths that are wrong, each with the finding that it must give, and everyday programs that may be run ---
START = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\n"
SLOT = START + "G0 Z-0.5\nG1 X26 F4000\nG0 Z5\nM30\n"  # the stock: x 0 to 40, y -14 to 40, z -10 to 0; cutter 20 mm
FIRM = "dynamics.modes=[{frequency_hz: 60, damping_ratio: 0.02, shape: [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]}]"
#: a light mode at the tooth frequency of a slow spindle, far above its limit depth
CHATTERS = (FIRM, "dynamics.reference_inertia=false", "stock.grid_step_um=20", "path.length_mm=20",
            "tool.spindle_speed_rpm=800", "path.feed_rate_m_per_min=0.4", "exchange.period_ms=0.625",
            "path.depth_of_cut_mm=9")  # fmt: skip


@dataclass(frozen=True)
class Wrong:
    """A program or settings, and the finding: line of the program, value and limit in its unit where they are known."""

    what: str
    program: str = SLOT
    settings: tuple[str, ...] = ()
    severity: str = "stop"
    lines: tuple = (None,)
    value: float | None = None
    limit: float | None = None
    words: str = ""
    moved: dict = field(default_factory=dict)  #: point -> shift [m] of a corrected trajectory


WRONG = {
    "rapid into the fixture": Wrong(
        "in the fixture", settings=("workpiece.fixtures_mm=[-30,-5,-10,-10,5,1]",), lines=(3, 4), value=1.5),
    "chatter": Wrong("chatter", "", CHATTERS, value=9.0, words="above the stability limit"),
    "vibration that grows in the pass": Wrong("growing vibration", "", CHATTERS, limit=0.02),
    "deflection beyond the linear model": Wrong(
        "deflection", settings=("cutting.fractional.stiffness_n_per_m=5e10", "dynamics.gravity=false"), limit=50.0),
    "a joint beyond its range": Wrong(
        "joint limit", SLOT.replace("X26 F4000", "X26 F4000\nG1 X400 Z1500"), lines=(5, 6), limit=155.0,
        words="axis 3"),
    "a wrist that is stretched": Wrong(
        "singularity", settings=("start_joints_deg=[90,-50,120,180,1,180]",), lines=(2, 3, 4), words="wrist"),
    "an axis that must jump": Wrong("joint speed", moved={40: [0.0, 0.4, 0.0]}, lines=(3, 4), words="axis"),
    "a correction beyond its limit": Wrong("correction size", moved={40: [0.0, 2.5e-3, 0.0]}, value=2500, limit=2000),
    "a path beside the stock": Wrong("stock missed", "", ("path.start_mm=[-1000,0]",), value=0.0),
    "a feed in the wrong unit": Wrong(
        "feed per tooth", SLOT.replace("F4000", "F170000"), (), "warning", value=170 / 8 / 4, limit=5.0),
    "a tool smaller than the grid": Wrong(
        "tool and grid", SLOT, ("tool.diameter_mm=0.9",), "warning", value=0.05, limit=0.0225),
    "a workpiece in another room": Wrong(
        "envelope", settings=("workpiece.xyz_mm=[0,-16331.9,485.7]",), severity="warning", value=16.3319),
    "compliances a thousand times too large": Wrong(
        "compliance", settings=("arm.joint_compliance_urad_per_n_m=[700,300,400,900,900,2000]",), severity="warning",
        value=700, limit=100),
    "compliances a thousand times too small": Wrong(
        "compliance", settings=("arm.joint_compliance_urad_per_n_m=[7e-4,3e-4,4e-4,3e-3,3e-3,2e-3]",),
        severity="warning", value=7e-4, limit=0.01),
    "grams for kilograms": Wrong(
        "mass", settings=("arm.link_mass_kg=[336800,259.4,85.2,54.5,36.3,18.2]",), severity="warning", value=336800),
    "a posture outside the limits": Wrong(
        "posture", settings=("start_joints_deg=[90,-50,170,180,25,180]",), severity="warning", value=170, limit=155),
    "radians for degrees": Wrong(
        "posture", settings=("start_joints_deg=[1.5708,-0.8727,2.0944,3.1416,0.4363,3.1416]",), severity="warning",
        words="radians"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_at_its_place_with_its_value(tmp_path, name):
    wrong = WRONG[name]
    paper = find_file("paper.yaml")
    cell = small_part(tmp_path, wrong.program, *wrong.settings) if wrong.program else read_cell(paper, wrong.settings)
    checked = check(cell, _moved(cell, wrong.moved))
    found = [f for f in checked.findings if (f.what, f.severity) == (wrong.what, wrong.severity)]
    found = [f for f in found if wrong.words in f.sentence]
    assert len(found) == 1, checked.lines()
    (finding,) = found
    assert finding.advice.endswith((".", ").")) and finding.count >= 1
    assert wrong.moved or finding.where.line in wrong.lines or wrong.lines == (None,)
    assert wrong.value is None or finding.value == pytest.approx(wrong.value, rel=1e-3, abs=1e-9)
    assert wrong.limit is None or finding.limit == pytest.approx(wrong.limit, rel=1e-6)
    assert checked.may_be_run == (not checked.count("stop")) and (wrong.severity == "warning" or not checked.may_be_run)
    text = "\n".join(checked.lines())
    assert finding.sentence in text and finding.advice in text and (finding.where.line is None or "(line" in text)


def _moved(cell, shifts: dict):
    """The path with some points moved."""
    if not shifts:
        return None
    target = cell.target()
    position = target.position.copy()
    for point, shift in shifts.items():
        position[point] += shift
    return target.with_position(position, target.velocity)


EDGE = ("G21 G90 S8000 M3\nG0 X-14 Y-26 Z2\nG0 Z-10.5\nG0 X-11 Y-25\nG0 Z2\nG0 X-14 Y0\nG0 Z-0.5\nG1 X26 F4000\n"
        "G0 Z5\nM30\n")  # fmt: skip


def test_a_move_below_the_bottom_of_the_stock_beside_it_may_be_run(tmp_path):
    checked = check(small_part(tmp_path, EDGE))
    assert checked.may_be_run and not checked.count("warning"), checked.lines()


# --- Rapid moves through material ---
STIFFNESS = {"rigid": 1e-3, "nominal": 1.0, "10 times softer": 10.0}  #: factor of the compliances
DANGEROUS = [row for diameter in DIAMETERS_MM for row in dangerous(diameter)]
SOUND = [row for diameter in DIAMETERS_MM for row in sound(diameter)]
BACK = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X26 F4000\nG0 Z-0.4\nG0 X-14\nG0 Z5\nM30\n"
THROUGH = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X12 F4000\nG0 X20\nG1 X26 F4000\nG0 Z5\nM30\n"
SHORT = ("timing.rapid_feed_m_per_min=4", "stock.grid_step_um=100")


def cell_of(directory, row: Row) -> Cell:
    return small_part(directory, row.program, *row.settings)


def moves(cell: Cell) -> list:
    """Along the programmed path; no pass is simulated."""
    return rapid_violations(cell.target(), engagement(cell, cell.limits.rapid_contact))


def volume(contacts: list) -> float:
    return sum(one.amounts["volume_mm3"] for one in contacts)


@pytest.mark.parametrize("row", DANGEROUS, ids=lambda row: row.name)
def test_every_rapid_move_through_material_is_a_stop_with_its_volume(tmp_path, row):
    cell = cell_of(tmp_path, row)
    contacts = moves(cell)
    lines = {int(cell.fed_path.toolpath.line[one.block]) for one in contacts}
    assert contacts and all(one.severity == "stop" for one in contacts)
    assert not row.lines or lines == set(row.lines)
    assert 1e3 * max(one.value for one in contacts) == pytest.approx(row.depth_mm, rel=1e-6)
    assert volume(contacts) == pytest.approx(row.volume_mm3, rel=0.02)


@pytest.mark.parametrize("row", SOUND, ids=lambda row: row.name)
def test_a_sound_program_removes_nothing_by_rapid_moves(tmp_path, row):
    assert not moves(cell_of(tmp_path, row))


@pytest.mark.parametrize("seed", range(100))
def test_a_random_sound_program_is_released_and_a_rapid_plunge_in_it_is_a_stop(tmp_path, seed):
    row = random_sound(seed)
    assert not moves(cell_of(tmp_path, row))
    if seed % 10 == 0:
        row = with_rapid_cut(row)
        cell = cell_of(tmp_path, row)
        contacts = moves(cell)
        assert [int(cell.fed_path.toolpath.line[one.block]) for one in contacts] == list(row.lines)
        assert volume(contacts) == pytest.approx(row.volume_mm3, rel=0.02)


@pytest.mark.parametrize(("name", "file", "program", "line"), ISSUE, ids=[row[0] for row in ISSUE])
def test_the_programs_that_version_0_2_0_released_are_stops(tmp_path, name, file, program, line):
    path = tmp_path / "part.nc"
    path.write_text(program)
    stock = ("stock.min_mm=[-25,-25,-10]", "stock.max_mm=[25,25,0]")
    cell = read_cell(find_file("test_piece.yaml"), [f"path.file={path}", *(stock if file == "pocket" else ())])
    contacts = moves(cell)
    assert line in {int(cell.fed_path.toolpath.line[one.block]) for one in contacts}
    assert all(one.severity == "stop" for one in contacts) and volume(contacts) > 100.0


def test_the_shipped_examples_have_no_rapid_moves_in_material():
    for name in ("paper.yaml", "test_piece.yaml"):
        assert not moves(read_cell(find_file(name)))


@pytest.mark.parametrize("factor", STIFFNESS.values(), ids=STIFFNESS)
def test_the_answer_does_not_depend_on_the_stiffness_of_the_arm(tmp_path, factor):
    compliance = 1e6 * factor * read_cell(find_file("paper.yaml")).arm.joint_compliance
    soft = (*SHORT, f"arm.joint_compliance_urad_per_n_m={compliance.tolist()}", "dynamics.gravity=false")
    for program, answer in ((THROUGH, 2.0 * 10.0 * 8.0 * 0.5), (BACK, 0.0)):
        cell = small_part(tmp_path, program, *soft)
        for reference in (None, corrected(cell)):
            checked = check(cell, reference)
            assert checked.rapid_volume_mm3 == pytest.approx(answer, rel=0.02), checked.lines()
            stops = [f for f in checked.findings if f.what == "rapid in material"]
            assert [(f.severity, f.where.line) for f in stops] == [("stop", 5)] * bool(answer)


def corrected(cell: Cell, shift=(0.0, 5e-5, 0.0)):
    """The path with a constant correction [m]."""
    target = cell.target()
    return target.with_position(target.position + np.asarray(shift), target.velocity)


REAL = [(method, row) for method, diameter in (("spline", 6.0), ("mirror", 20.0), ("spline", 50.0))
        for row in (*dangerous(diameter), *sound(diameter))]  # fmt: skip


@pytest.mark.parametrize(("method", "row"), REAL, ids=[f"{method}, {row.name}" for method, row in REAL])
def test_the_answer_holds_for_the_corrected_path_of_a_method(tmp_path, method, row):
    grid = f"stock.grid_step_um={20 * row.diameter_mm:g}"
    cell = small_part(tmp_path, row.program, *row.settings, grid, "exchange.micro_step_deg=4", "exchange.period_ms=2")
    revised = compensated(cell, simulate(cell), method)
    assert not np.array_equal(revised.reference.position, cell.target().position)
    assert check(cell, revised.reference, ran=revised).rapid_volume_mm3 == pytest.approx(row.volume_mm3, rel=0.02)


def test_a_corrected_path_that_lowers_a_rapid_move_into_the_floor_is_a_stop(tmp_path):
    cell = small_part(tmp_path, BACK, *SHORT)
    target, fed = cell.target(), cell.timed_path
    back = fed.toolpath.line[fed.block] == 6
    lower = np.where(back, -0.6e-3, 0.0)[:, None] * [0.0, 0.0, 1.0]
    checked = check(cell, target.with_position(target.position + lower, target.velocity))
    stops = [f for f in checked.findings if f.what == "rapid in material"]
    assert stops and stops[0].where.line in (5, 6, 7) and checked.rapid_volume_mm3 > 0.0, checked.lines()


def test_terminal_and_json_give_line_depth_length_and_volume(tmp_path, capsys):
    (tmp_path / "part.nc").write_text(THROUGH)
    small_part(tmp_path, THROUGH)
    sets = (f"path.file={tmp_path / 'part.nc'}", "stock.min_mm=[0,-14,-10]", "stock.max_mm=[40,40,0]", *SHORT)
    words = ["check", "paper.yaml", *(part for pair in sets for part in ("--set", pair))]
    assert main(words) == 1
    text = capsys.readouterr().out
    assert "goes 8 mm through material, 0.5 mm deep at point" in text and "(line 5)" in text
    assert "removed by rapid moves: 80" in text
    assert main([*words, "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    (move,) = answer["rapid_moves"]
    assert move["where"]["line"] == 5 and move["value"] == pytest.approx(0.5) and move["severity"] == "stop"
    assert move["amounts"] == pytest.approx({"length_mm": 8.0, "volume_mm3": 80.0}, rel=0.02)
    assert answer["removed_by_rapid_moves_mm3"] == pytest.approx(80.0, rel=0.02)
