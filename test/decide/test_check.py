"""Findings of check: no dangerous program or cell is released, no sound one is stopped, each finding has its place.

Each row of CASES has the finding of ``check``; ``judged`` has more programs. The programs about rapid moves start with
the top of the stock at z = 0; their volumes are closed forms, with the radius R of the cutter, the length l of the
rapid move and the depth d.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hostile import answered, ask, settings
from samples.cuttings import SET_ALUMINIUM
from samples.small_part import assignments, small_part

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide.check import check, end_violations
from kr270_milling.decide.check_arm import (
    arm_violations,
    corner_blending,
    correction_per_tick,
    correction_size,
)
from kr270_milling.decide.check_cut import HOLLOW, INSERT_RAMP, core_radius, engagement, path_contacts, rapid_violations
from kr270_milling.decide.findings import violations
from kr270_milling.decide.programs.written import drafted
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
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
    results, solved = arm_violations(arm_of(cell), cell.limits, run)
    assert solved == pytest.approx(joints, abs=1e-9)
    return results


def test_out_of_reach_names_all_points_that_are(cell):
    far = Trajectory(np.arange(9) * 10**9, np.outer(np.linspace(0, 2, 9), [-1.0, 0.0, 0.0]), TOOL_DOWN)
    (finding,), joints = arm_violations(arm_of(cell), cell.limits, far)
    tool, arm = cell.workpiece.pose.apply(far.position), cell.arm  # -x leads away from the arm and up
    centre = tool + arm.d6 * cell.workpiece.pose.rotation[:, 2]  # no tool: the flange is d6 in front of the wrist
    away = np.hypot(np.hypot(*centre[:, :2].T) - arm.a1, centre[:, 2] - arm.d1)
    lost = np.flatnonzero(away > arm.a2 + arm.forearm) + 1
    assert joints is None and 2 < len(lost) < 9 and finding.where.point == np.argmax(away) + 1
    assert f"at points {lost[0]} to {lost[-1]}: " in finding.sentence
    assert finding.value == pytest.approx(away.max(), abs=1e-9)


def ends_at(height: float, *more: str):
    cell = read_cell(find_file("paper.yaml"), [f"program.safe_height_mm={height}", *more])
    run = path_of(cell).target
    findings, names = end_violations(cell, run, [(0, len(run) - 1)]), {1: "approach", len(run): "retract"}
    for finding in findings:
        assert finding.sentence.startswith(f"{names[finding.where.point]} of the robot program: ")
        assert "point" not in finding.sentence
    return cell, run, {finding.what for finding in findings}


@pytest.mark.parametrize("height", [50, 800, 1500])
def test_approach_and_retract_are_judged_as_the_path_and_named_at_its_ends(height):
    cell, run, kinds = ends_at(height)
    lift, expected = np.arange(0.0, 1e-3 * height, 1e-3)[:, None] * [0.0, 0.0, 1.0], set()
    any_joints = replace(arm_of(cell), arm=cell.arm.replace(joint_lower=np.full(6, -9.0), joint_upper=np.full(6, 9.0)))
    for k in (0, -1):
        joints = any_joints.joints_at(run.position[k] + lift, run.quaternion[[k] * len(lift)])
        if (joints < cell.arm.joint_lower).any() or (joints > cell.arm.joint_upper).any():
            expected.add("joint limit")
        if np.abs(joints[:, 4]).min() < math.radians(3.0):  # A5 passes through zero
            expected |= {"singularity", "configuration flip"}
    assert kinds == expected and bool(expected) == (height > 50)


def test_an_approach_into_material_is_as_long_as_the_first_point_is_deep(tmp_path):
    cell = small_part(
        tmp_path, "G21 G90 S8000 M3\nG0 X10 Y10 Z-0.5\nG1 X20 F1000\nG0 Z5\nM30\n", "cutting.detail=engagement"
    )
    (finding,) = path_contacts(cell, path_of(cell).target)[0]
    assert finding.where.point == 1 and finding.amounts["length_mm"] == pytest.approx(0.5) == finding.value


def test_each_part_of_a_robot_program_has_an_approach_and_a_retract(tmp_path):
    rows = "G21 G90 S8000 M3\nG0 X-14 Y2 Z2\n" + "G0 Z-0.5\nG1 X26 F2000\nG0 Z2\nG0 X-14\n" * 8 + "M30\n"
    settings = "program.memory_mb=0.01", "program.tolerance_um=0", "cutting.detail=engagement"
    cell = small_part(tmp_path, rows, *settings, "program.safe_height_mm=800")
    checked = check(cell)
    parts = drafted(cell, path_of(cell).target, cell.krl.motion)[2]
    assert len(parts) > 2
    (flip,) = (finding for finding in checked.findings if finding.what == "configuration flip")
    assert flip.count == 2 * len(parts)


def test_a_retract_out_of_reach_or_into_a_fixture_is_found():
    far = "workpiece.xyz_mm=[0,-2433.2,1485.76]"
    assert ends_at(800, far)[2] == set() and ends_at(2000, far)[2] == {"reach"}
    above_the_end = "workpiece.fixtures_mm=[60,-10,{},80,10,{}]"
    for height, kinds in ((800, {"link contact"}), (300, set())):
        assert ends_at(height, far, above_the_end.format(900, 910))[2] == kinds


def test_a_joint_beyond_its_range_or_too_fast_or_hard_is_named_with_its_worst_point(cell):
    q = np.tile(arm_of(cell).posture, (5, 1))
    q[:, 4] = np.radians([110, 120, 126, 128, 121])  # A5 has +-125 deg
    (limit,) = [f for f in along_joints(cell, q) if f.what == "joint limit"]
    assert limit.where.point == 4 and limit.severity == "stop" and "axis 5" in limit.sentence
    assert "points 3 to 4" in limit.sentence
    q = np.tile(arm_of(cell).posture, (6, 1))
    q[3:, 0] += np.radians(6.0)  # 120 deg/s within one step of 50 ms, where 110 are allowed
    fast, hard = (f for f in along_joints(cell, q) if f.severity == "stop")
    assert fast.what == "joint speed" and hard.what == "joint acceleration" and hard.where.point in (3, 4)
    assert fast.where.point == 4 and fast.value == pytest.approx(120, rel=1e-6) and "axis 1" in fast.sentence
    assert hard.value == pytest.approx(120 / 0.05, rel=1e-6)


def test_singularities_of_wrist_elbow_and_shoulder_and_a_flip_of_the_wrist_have_their_points(cell):
    q = np.tile(arm_of(cell).posture, (9, 1))
    q[:, 4] = np.radians(np.linspace(8, -8.5, 9))
    results = along_joints(cell, q)
    assert [f.where.point for f in results if f.what == "configuration flip"] == [5]
    (near,) = [f for f in results if f.what == "singularity"]
    assert np.degrees(near.value) == pytest.approx(np.abs(np.linspace(8, -8.5, 9)).min(), abs=1e-6)
    assert near.where.point == 5 and "wrist" in near.sentence
    q = np.tile(arm_of(cell).posture, (3, 1))
    q[:, 2] = cell.arm.elbow_offset + np.radians([8, 6, 4])  # the stretched arm at elbow_offset
    (near,) = [f for f in along_joints(cell, q) if f.what == "singularity"]
    assert near.where.point == 3 and "elbow" in near.sentence and np.degrees(near.value) == pytest.approx(4, abs=1e-6)
    results = along_joints(with_limits(cell, shoulder_distance=5.0), np.tile(arm_of(cell).posture, (3, 1)))
    (near,) = [f for f in results if f.what == "singularity"]
    wrist = pose(cell.arm, cell.mount, arm_of(cell).posture)  # no tool: the flange is d6 in front of the wrist centre
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
    assert finding.where.point == 8 and finding.value == pytest.approx(1200.0) and "1200.0 um" in finding.sentence
    assert correction_size(LINE, revised, 4_000_000, 1.3e-3) == []
    revised = shifted(LINE, np.where(np.arange(25) >= 10, 1e-4, 0.0))  # 100 um within 50 ms: 8 um in each tick of 4 ms
    (finding,) = correction_per_tick(LINE, revised, 4_000_000, 7.9e-6)
    assert finding.where.point == 11 and finding.value == pytest.approx(8.0)
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
    assert finding.where.point == 2 and finding.value == pytest.approx(100 * missed / 5e-5, rel=1e-2)
    assert finding.severity == "warning"
    assert corner_blending(*corner(stop=True), 1e-3) == corner_blending(*corner(stop=False), 0.0) == []


def test_blending_rounds_lines_of_a_circle_and_not_its_arcs():
    """Points each 22.5 deg of a radius of 10 mm: d sin(t / 2) / 2 of a corner are twice the correction of 50 um."""
    angle = np.radians(22.5) * np.arange(9)
    position = 0.01 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    velocity = np.roll(position, 1, axis=1) * [-1, 1, 0]
    circle = Trajectory(10**8 * np.arange(9), position, TOOL_DOWN, velocity)
    revised, points = circle.with_position(position + [0, 0, 5e-5]), np.arange(9)
    assert corner_blending(circle, revised, 1e-3, points=points)
    assert not corner_blending(circle, revised, 1e-3, points=points, auxiliary=points % 2 == 1)


def test_a_large_or_hasty_correction_must_not_be_run_and_a_reference_of_another_path_is_refused(cell, ran):
    target, most = path_of(cell).target, cell.compensation.max_correction
    checked = check(cell, shifted(target, 1.01 * most * (np.arange(len(target)) == 40)), ran=ran)
    stops = {f.what: f for f in checked.findings if f.severity == "stop"}
    assert stops["correction size"].where.point == 41 and stops["correction per tick"].where.point in (41, 42)
    calm = check(cell, shifted(target, 0.9 * most * np.sin(np.pi * np.linspace(0, 1, len(target)))), ran=ran)
    assert not kinds(calm) & {"correction size", "correction per tick"}
    with pytest.raises(InputError, match="points of this cell's path"):
        check(cell, LINE)


def test_blending_is_only_a_matter_of_lin_motions(cell, ran):
    target, strict = path_of(cell).target, with_limits(cell, blending_share=1e-9)
    smooth = shifted(target, np.linspace(0.0, 1e-4, len(target)))
    straight = target.with_position(smooth.position)
    for revised, motion, blended in (
        (smooth, "LIN", True), (smooth, "SPLINE", False), (straight, None, True), (smooth, None, False)
    ):  # fmt: skip
        assert ("corner blending" in kinds(check(strict, revised, motion, ran), "warning")) == blended


@pytest.mark.parametrize(("distance", "motion", "stops"), [(0.0, "LIN", 1), (0.0, "SPLINE", 0), (1e-3, "LIN", 0)])
def test_lin_motions_without_blending_stop_at_each_point(cell, ran, distance, motion, stops):
    own = cell.replace(krl=cell.krl.replace(blend_distance=distance))
    checked = check(own, path_of(own).target, motion, ran)
    assert ("no blending" in kinds(checked, "warning")) == stops


# --- Findings ---
def test_neighbours_that_exceed_make_one_finding_named_by_the_worst():
    first, second = violations("spindle torque", np.array([0, 2, 3, 2, 0, 1.5, 1.0]), 1.0)
    assert (first.where.point, first.value, first.limit, first.severity) == (3, 3.0, 1.0, "stop")
    assert "points 2 to 4" in first.sentence and "3 N m at point 3" in first.sentence
    assert second.where.point == 6 and "(point 6)" in second.sentence
    assert violations("spindle torque", np.array([0.0, np.nan]), 1.0)[0].where.point == 2
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
    place = path_of(cell).target.position[first.where.point - 1]
    assert first.where.position_mm == pytest.approx((1e3 * place).tolist())


def test_the_command_ends_with_1_when_the_path_must_not_be_run(tmp_path):
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


# --- Dangerous and sound programs ---
START = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\n"
SLOT = START + "G0 Z-0.5\nG1 X26 F4000\nG0 Z5\nM30\n"  # the stock: x 0 to 40, y -14 to 40, z -10 to 0; cutter 20 mm
DOWN = "G21 G90 S8000 M3\nG0 X20 Y0 Z2\nG1 Z-0.5 F500\nG1 X26 F4000\nG0 Z2\nM30\n"
HOLES = "G21 G90 S8000 M3\nG0 X10 Y0 Z5\nG81 X10 Y0 Z-3 R1 F400\nX12 Y20\nG80\nG0 Z20\nM30\n"
EDGE = ("G21 G90 S8000 M3\nG0 X-14 Y-26 Z2\nG0 Z-10.5\nG0 X-11 Y-25\nG0 Z2\nG0 X-14 Y0\nG0 Z-0.5\nG1 X26 F4000\n"
        "G0 Z5\nM30\n")  # fmt: skip
APT = "UNITS/MM\nCUTTER/{}\nSPINDL/8000,RPM,CLW\nRAPID\nGOTO/-14,0,2\nRAPID\nGOTO/-14,0,-0.5\nFEDRAT/4000,MMPM\n" \
      "GOTO/26,0,-0.5\nRAPID\nGOTO/26,0,5\nFINI\n"  # fmt: skip
LEANING = ("UNITS/MM\nMULTAX/ON\nSPINDL/8000,RPM,CLW\nFEDRAT/4000,MMPM\nGOTO/-14,0,{1},0,{0}\nGOTO/26,0,{1},0,{0}\n"
           "FINI\n")  # fmt: skip
SHALLOW, DEEP = LEANING.format("0.0872,0.9962", 0.4), LEANING.format("0.342,0.9397", -7.3)  # 5 and 20 deg to y
OFF = APT.format("20,0").replace("SPINDL/8000,RPM,CLW\n", "")
COARSE = ("stock.grid_step_um=200", "timing.rapid_feed_m_per_min=6")
#: a narrow cut with a tool mode
NARROW = SLOT.replace("Y0", "Y-23.95")
MODE = ("stock.grid_step_um=20; tool.modes="
        "[{{direction: [0.0, 1.0, 0.0], frequency_hz: 980.0, damping_ratio: 0.025, mass_kg: {}}}]")  # fmt: skip
INCHES = SLOT.replace("G21", "G20")
BEYOND = SLOT.replace("X26 F4000", "X26 F4000\nG1 X400 Z1500")
FIXTURE, COMPLIANCE = "workpiece.fixtures_mm", "arm.joint_compliance_urad_per_n_m"
SHORT_FLUTES = "tool.flute_length_mm=0.4"
BACK = "{X: 140, Y: 0, Z: -300, A: 0, B: 0, C: 180}"  # the numbers of mount, typed as those of $TOOL
NO_PLUNGE, WEIGHTLESS = "tool.centre_cutting=false", "dynamics.gravity=false"


@dataclass(frozen=True)
class Case:
    """A program in a cell, and the finding about it: "refused" for an error, "" for a sound program."""

    name: str
    finding: str = ""
    settings: str = ""  #: separated by "; "
    program: str = SLOT  #: "": the paper's straight cut
    severity: str = "stop"
    suffix: str = ".nc"
    lines: tuple = (None,)  #: of the program, one of which the finding names
    value: float | None = None  #: of the finding, in its unit
    limit: float | None = None
    words: str = ""  #: in the sentence of the finding


def comment(text: str) -> str:
    """The slot with a comment on its tool, in line 2."""
    return SLOT.replace("G0 X-14", f"(T1 {text})\nT1 M6\nS8000 M3\nG0 X-14", 1)


def law(k_tc: float) -> str:
    return "; ".join([*SET_ALUMINIUM, f"cutting.linear_edge.tangential_cutting_n_per_mm2={k_tc}"])


def warning(*texts: str, **more) -> Case:
    return Case(*texts, severity="warning", **more)


CASES = (
    Case("a spindle of 300 kg", "payload", "mount.mass_kg=300"),
    warning("a spindle that points into the arm", "spindle direction", f"mount.tool_kuka={BACK}", words="into the arm"),
    warning("a tip behind the flange", "tool tip", f"mount.tool_kuka={BACK}", value=300.0),
    warning("a tip in metres", "tool tip", "mount.xyz_mm=[0.14,0,-0.3]; mount.abc_deg=[0,0,180]", value=0.331),
    warning("a spindle turned in radians", "tool tip", "mount.xyz_mm=[140,0,-300]; mount.abc_deg=[0,0,3.14159]",
            value=299.55, words="along the axis of the spindle"),  # 300 mm cos(3.14159 deg)
    warning("a clamp above approach and retract", "safe height", f"{FIXTURE}=[90,90,-9,99,99,80]", value=30.0,
            words="below the top of fixture 1"),
    warning("an approach in metres", "safe height", "program.safe_height_mm=0.05", value=0.05, limit=5.0),
    warning("a wrist that may be stretched", "loose limit", "limits.wrist_angle_deg=1", value=1, limit=3),
    warning("rapid moves that may touch", "loose limit", "limits.rapid_contact_um=300", value=300, limit=20),
    warning("slow joints", "slowed", "arm.joint_speed_limit_deg_per_s=[1,1,1,1,1,1]"),
    warning("a spindle at 15 deg", "spindle direction", "mount.abc_deg=[0, -15, 180]", words="75 deg away"),
    Case("a program for a cutter of 10 mm", "tool diameter", "", comment("D=10 flat end mill"), lines=(3,)),
    Case("a program for a cutter of 1 inch", "tool diameter", "", comment("1 inch end mill")),
    warning("a ball-end mill of APT", "stability not judged", "", APT.format("20,10"), suffix=".apt"),
    warning("a tool that leans by 5 deg", "holder unknown", "", SHALLOW, suffix=".apt", words="by 5 deg, and"),
    Case("a holder beside a clamp", "in the fixture", f"{FIXTURE}=[-9,11,-10,30,30,9.2]; tool.stick_out_mm=9",
         words="the holder enters", value=0.7),
    warning("a wall above a leaning tool", "undercut", "tool.diameter_mm=10", DEEP, suffix=".apt", limit=1.0),
    # 0.3 times the least and 3 times the largest of config/materials.csv
    Case("forces a thousand times too small", "force coefficient", law(0.6), value=0.6, limit=0.3 * 243.77),
    Case("forces ten times too large", "force coefficient", law(6004.6), value=6004.6, limit=3.0 * 1319.41),
    Case("slot in the air", "outside the stock", "", SLOT.replace("M30", "(far)\nG0 X-60 Y80\nG1 Z-1\nX60\nM30")),
    Case("a path beside the stock", "stock missed", "path.start_mm=[-1000,0]", "", value=0.0),
    Case("inches for millimetres", "below the stock", "", INCHES, lines=(3, 4), value=0.5 * 25.4 - 10),
    Case("beside the stock, below its bottom", "below the stock", "", EDGE, lines=(3, 4, 5), value=0.5, limit=0.0),
    Case("into the table", "below the stock", "workpiece.table_z_mm=-0.2", value=0.3, words="the table"),
    Case("through a fixture", "in the fixture", f"{FIXTURE}=[30,-5,-10,60,5,-0.2]", lines=(4,), value=0.3),
    Case("rapid move into a fixture", "in the fixture", f"{FIXTURE}=[-30,-5,-10,-10,5,1]", lines=(3, 4), value=1.5),
    Case("deeper than the flutes", "depth of cut", "tool.flute_length_mm=0.4", lines=(4,), value=0.5, limit=0.4),
    Case("a shank in the slot", "tool body", f"{SHORT_FLUTES}; tool.shank_diameter_mm=24", lines=(4,), value=0.1),
    Case("a holder in the slot", "tool body", "tool.stick_out_mm=0.4", lines=(4,), value=0.1),
    Case("a plunge with a cutter that cannot", "plunge", NO_PLUNGE, DOWN, lines=(3, 4), value=0.5, limit=0.0),
    Case("too much feed per tooth", "feed per tooth", "tool.max_feed_per_tooth_mm=0.1", value=4 / 8 / 4, limit=0.1),
    Case("a spindle of APT that is off", "spindle off", "", OFF, suffix=".apt"),
    Case("a feed in the wrong unit", "feed per tooth", "", SLOT.replace("F4", "F170"), value=170 / 8 / 4, limit=0.94),
    Case("too fast", "cutting speed", "tool.max_cutting_speed_m_per_min=400", value=math.pi * 0.02 * 8000, limit=400),
    Case("above the limit depth of the tool", "chatter", MODE.format(0.01), NARROW.replace("Z-0.5", "Z-8")),
    Case("beyond the linear model", "deflection", f"cutting.fractional.stiffness_n_per_m=5e10; {WEIGHTLESS}", limit=50),
    Case("out of reach", "reach", "", SLOT.replace("X26", "X26\nG1 Y2500"), lines=(5, 6)),
    Case("a joint beyond its range", "joint limit", "", BEYOND, lines=(5, 6), limit=155.0, words="axis 3"),
    Case("a wrist that is stretched", "singularity", "start_joints_deg=[90,-50,120,180,1,180]", words="wrist"),
    Case("an arm that hangs down", "joint deflection", f"{COMPLIANCE}=[900,900,900,900,900,900]", words="joint 2"),
    Case("another spindle speed than the cell's", "refused", "", SLOT.replace("S8000", "S9000")),
    Case("a wrong datum", "refused", "", SLOT.replace("Y0", "Y500")),

    warning("a reground cutter", "tool diameter", "tool.diameter_mm=19.8", comment("D=20 flat end mill")),
    warning("a path mostly beside the stock", "stock too small", "", SLOT.replace("G0 Z5", "G1 Y160\nG0 Z5"), limit=50),
    warning("a tool smaller than the grid", "tool and grid", "tool.diameter_mm=0.9", value=0.2, limit=0.0225),
    warning("a workpiece in another room", "envelope", "workpiece.xyz_mm=[0,-16331.9,485.7]", value=16.3319),
    warning("a workpiece upside down", "workpiece direction", "workpiece.abc_deg=[0,0,180]", value=180, limit=100),
    *(warning(f"{home} at cutting depth", "home sideways", "", SLOT.replace("G0 Z5", home), value=0.5, words=axes)
      for home, axes in (("G91 G28 X0 Y0", "X Y"), ("G28", "X Y Z"), ("G53 G0 X0", "X"))),
    *(Case(f"{home} above the part", "", "", SLOT.replace("G0 Z5", home))
      for home in ("G1 Z1\nG28", "G91 G28 Z0\nG28 X0 Y0", "G53 G0 Z0\nG53 X0")),
    warning("nrad for urad", "compliance", f"{COMPLIANCE}=[700,300,400,900,900,2000]", value=700, limit=100),
    warning("mrad for urad", "compliance", f"{COMPLIANCE}=[7e-4,3e-4,4e-4,3e-3,3e-3,2e-3]", value=7e-4, limit=0.01),
    warning("grams for kilograms", "mass", "arm.link_mass_kg=[336800,259.4,85.2,54.5,36.3,18.2]", value=336800),
    warning("outside the limits", "posture", "start_joints_deg=[90,-50,170,180,25,180]", value=170, limit=155),
    warning("radians", "posture", "start_joints_deg=[1.5708,-0.8727,2.0944,3.1416,0.4363,3.1416]", words="radians"),

    Case("the paper's straight cut", program=""),
    Case("beside the stock, into a plate", "", "limits.below_stock_mm=0.5", EDGE),
    Case("a spindle that the robot starts", "", 'program.spindle_on=["$OUT[1]=TRUE"]', SLOT.replace(" S8000 M3", "")),
    Case("two holes", program=HOLES),
    Case("a slot and a hole", program=SLOT.replace("G0 Z5", "G0 Z5\nG81 X20 Y25 Z-2 R1 F400\nG80")),
    Case("into a sacrificial plate", "", "stock.min_mm=[0,-14,-0.3]; limits.below_stock_mm=0.25"),
    Case("over a clamp", "", f"{FIXTURE}=[-30,-5,-30,-10,5,-0.6]"),
    Case("the payload of the arm", "", "mount.mass_kg=270"),
    Case("a published force coefficient", "", law(600.46)),
    Case("below the limit depth of the tool", "", MODE.format(3.7), NARROW),
    Case("flutes just long enough", "", "tool.flute_length_mm=0.51"),
    Case("chip and speed just within", "", "tool.max_feed_per_tooth_mm=0.126; tool.max_cutting_speed_m_per_min=503"),
)  # fmt: skip


def cell_of_case(case: Case, directory) -> Cell:
    settings = case.settings.split("; ") if case.settings else []
    if not case.program:
        return read_cell(find_file("paper.yaml"), settings)
    path = directory / f"part{case.suffix}"
    path.write_text(case.program)
    return small_part(directory, case.program, *COARSE, *settings, f"path.file={path}")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_dangerous_case_has_its_finding_and_a_sound_case_is_released(tmp_path, case):
    if case.finding == "refused":
        with pytest.raises(MillingError):
            check(cell_of_case(case, tmp_path))
        return
    checked = check(cell_of_case(case, tmp_path))
    text = "\n".join(checked.lines())
    if not case.finding:
        warnings = {f.what for f in checked.findings if f.severity == "warning"}
        assert checked.may_be_run and not warnings - {"tool and grid"}, text  # the grid of the table is coarse
        return
    assert checked.may_be_run == (not checked.count("stop"))
    named = [f for f in checked.findings if (f.what, f.severity) == (case.finding, case.severity)]
    finding = next(f for f in named if case.words in f.sentence)
    assert finding.sentence in text and finding.advice in text and finding.advice.endswith((".", ")."))
    assert case.lines == (None,) or finding.where.line in case.lines
    assert finding.where.line is None or f"(line {finding.where.line})" in finding.text
    assert case.value is None or finding.value == pytest.approx(case.value, rel=1e-3, abs=1e-9)
    assert case.limit is None or finding.limit == pytest.approx(case.limit, rel=1e-6)


#: [mm] -> [deg], largest ramping angles of MEAS cutters [Kyocera2021]
MAKERS_RAMPS = {25: 20, 28: 16, 32: 12.5, 35: 11, 40: 8.5, 50: 6}


def sunk(directory, diameter: float, *moves: str) -> float:
    """The largest depth [mm] that material loses below the core of a cutter [mm]."""
    program = "\n".join(["G21 G90 S8000 M3", *moves, "G0 Z5", "M30", ""])
    cell = small_part(
        directory, program, *COARSE, NO_PLUNGE, f"tool.diameter_mm={diameter}", "stock.min_mm=[0,-14,-30]"
    )
    return 1e3 * float(engagement(cell, 0.0).sunk.max())


@pytest.mark.parametrize(("diameter", "angle"), MAKERS_RAMPS.items())
def test_the_core_of_a_ramp_sinks_by_its_width_times_the_slope_and_the_ramps_of_a_maker_are_allowed(diameter, angle):
    core, slope = core_radius(diameter / 2e3), math.tan(math.radians(angle))
    assert core == pytest.approx(diameter / 2e3 - 8e-3)  # least bore 2 D - 16 mm: a helix of D - 8 mm less R
    assert 0.85 * HOLLOW < 2 * core * slope < 1.01 * min(HOLLOW, 2 * core * INSERT_RAMP)


def test_material_below_the_core_sinks_as_a_ramp_and_a_helix_say(tmp_path):
    core = 4.5  # [mm], of 25 mm
    ramp = sunk(tmp_path, 25, "G0 X5 Y10 Z1", "G1 Z0 F500", "X35 Z-3 F2000")
    assert ramp == pytest.approx(2 * core / 10, rel=0.03)
    wide, narrow = (
        sunk(tmp_path, 25, f"G0 X{20 + r} Y10 Z1", *(f"G3 X{20 + r} Y10 Z{z} I-{r} J0 F2000" for z in (-1, -3)))
        for r in (9, 3)
    )
    # the core is at most for this share of a turn over a place: where the circle about the place touches its border
    assert wide == pytest.approx(2 * math.asin(core / 9) / math.pi, rel=0.03)
    assert narrow == pytest.approx(3.0, abs=1e-3)  # the middle of a bore of less than 2 R + 2 core


def test_a_finding_in_a_sub_program_of_another_file_names_its_file_and_line(tmp_path):
    (tmp_path / "O7.nc").write_text("%\nO0007\nG1 X26 F4000\nM99\n")
    main = SLOT.replace("G1 X26 F4000", "M98 P7")
    case = next(case for case in CASES if case.name == "deeper than the flutes")
    checked = check(cell_of_case(replace(case, program=main), tmp_path))
    (finding,) = [f for f in checked.findings if f.what == case.finding]
    assert finding.where.called == "O7.nc, line 3" and f"(line {case.lines[0]}: O7.nc, line 3)" in finding.text


def test_drilling_is_reported_without_a_force_and_without_a_deviation(tmp_path):
    cases = {case.name: case for case in CASES}
    checked = check(cell_of_case(cases["two holes"], tmp_path))
    (finding,) = [f for f in checked.findings if f.what == "drilling"]
    assert "drilling: force not modelled (2 holes)" in finding.text and finding.where.line == 3
    assert checked.ran.result.removed_volume > 0.0
    assert np.abs(checked.ran.result.wrench).max() < 1e-9 and checked.ran.result.torque.max() < 1e-9  # rounding
    both = simulate(cell_of_case(cases["a slot and a hole"], tmp_path)).result
    force = np.abs(both.wrench).max(axis=1)
    assert force.max() > 10.0 and force[both.actual[:, 1] > 0.02].max() < 1e-9


# --- Rapid moves through material ---
DIAMETERS_MM = (2.0, 20.0, 50.0)
BELOW = ("G0 X0 Y0 Z5", "G1 Z-1 F1200")


def contacts_of(directory, diameter: float, lines) -> tuple[list, list[int]]:
    """The rapid moves through material along the programmed path, and their lines of the program.

    A stock of 8 by 6 diameters [mm] with the origin in the middle of its top; the first of ``lines`` has number 3.
    """
    x, y = 4.0 * diameter, 3.0 * diameter
    program = "\n".join(("G21 G90 G17", "S8000 M3", *lines, "G0 Z5", "M30", ""))
    stock = f"stock.min_mm=[{-x},{-y},-25]", f"stock.max_mm=[{x},{y},0]"
    cell = small_part(directory, program, *stock, f"tool.diameter_mm={diameter}", "timing.rapid_feed_m_per_min=6")
    contacts = rapid_violations(path_of(cell).target, engagement(cell, cell.limits.rapid_contact))
    return contacts, [int(path_of(cell).fed.toolpath.line[one.block]) for one in contacts]


def dangerous(d: float) -> dict[str, tuple]:
    """Name -> lines of the program, removed volume [mm3], numbers of lines that are stops, largest depth [mm].

    Of short rapid moves that follow each other, a few at the ends need not be a contact: they have no numbers.
    """
    r, pi = d / 2.0, math.pi
    turn = [2.0 * pi * k / 48 for k in range(1, 97)]
    helix = [f"G0 X{r / 2 * math.cos(a):.5f} Y{r / 2 * math.sin(a):.5f} Z{-min(a / (2.0 * pi), 1.0):.5f}" for a in turn]
    chords = [f"G0 X{x:.6f}" for x in np.linspace(0.0, r, 101)[1:]]
    return {
        "slot in short chords": ((*BELOW, *chords), d * r, (), 1.0),
        "corner": ((*BELOW, f"G0 X{3 * r}", f"G0 Y{d}"), 5.0 * d * r - r**2 + pi * r**2 / 4.0, (5, 6), 1.0),
        "diagonal": ((*BELOW, f"G0 X{d} Y{d}"), d * math.sqrt(2) * d, (5,), 1.0),
        "helix": ((f"G0 X{r / 2} Y0 Z5", "G1 Z0 F1200", *helix), pi * (1.5 * r) ** 2, (), 1.0),
        "vertical": (("G0 X0 Y0 Z5", "G0 Z-0.5", f"G1 X{r} F1200"), pi * r**2 / 2.0, (4,), 0.5),
        "start in material": (("G0 X0 Y0 Z-0.5", f"G1 X{r} F1200"), pi * r**2 / 2.0, (3,), 0.5),
        "25 um below the top": ((*BELOW, "G0 Z-0.025", f"G0 X{2 * d}"), 0.025 * d * 2.0 * d, (6,), 0.025),
        "18 um below the top, then down": (
            (*BELOW, "G0 Z-0.018", f"G0 X{2 * d}", "G0 Z-1"), 0.018 * d * 2.0 * d + 0.982 * pi * r**2, (7,), 1.0),
        "25 um into a wall": (back_along_a_wall(r, 0.025), 0.025 * 8.0 * d, (7,), 1.0),
    }  # fmt: skip


def back_along_a_wall(r: float, depth: float) -> tuple[str, ...]:
    """A slot through the stock by a cutter of radius r, and a rapid move back, into one wall by ``depth`` [mm]."""
    return f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{11 * r} F1200", f"Y{depth}", f"G0 X{-11 * r}"


def sound(d: float) -> dict[str, tuple[str, ...]]:
    """Name -> lines of a program whose rapid moves touch no material, or less of it than ``rapid_contact_um``, 20."""
    r = d / 2.0
    return {
        "along a wall": (f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{11 * r} F1200", f"G1 Y{r}", f"G1 X{-11 * r}",
                         f"G0 X{11 * r}"),
        "across a pocket": (*BELOW, f"G1 X{r}", f"G1 Y{r}", "G1 X0", "G1 Y0", f"G0 X{r} Y{r}"),
        "round an arc and back": (*BELOW, f"G2 X{2 * d} Y0 I{d} J0", f"G3 X0 Y0 I{-d} J0"),
        "up a steep ramp": (BELOW[0], "G1 Z0 F1200", f"G1 X{r} Z{-r}", f"G0 X{r / 2} Z{-r / 2}"),
        "down into a hole": (BELOW[0], "G1 Z-1 F600", "G0 Z2", "G0 Z-0.9", "G1 Z-2"),
        "15 um below the top": (*BELOW, "G0 Z-0.015", f"G0 X{2 * d}"),
        "15 um into a wall": back_along_a_wall(r, 0.015),
    }  # fmt: skip


DANGEROUS = {f"{name}, {d:g} mm": (d, *row) for d in DIAMETERS_MM for name, row in dangerous(d).items()}
SOUND = {f"{name}, {d:g} mm": (d, lines) for d in DIAMETERS_MM for name, lines in sound(d).items()}
BACK = SLOT.replace("G0 Z5", "G0 Z-0.4\nG0 X-14\nG0 Z5")
THROUGH = SLOT.replace("X26 F4000", "X12 F4000\nG0 X20\nG1 X26")
SHORT = ("timing.rapid_feed_m_per_min=4", "stock.grid_step_um=100")


@pytest.mark.parametrize("name", DANGEROUS)
def test_every_rapid_move_through_material_is_a_stop_with_its_volume(tmp_path, name):
    diameter, lines, volume, stops, depth = DANGEROUS[name]
    contacts, numbers = contacts_of(tmp_path, diameter, lines)
    assert {one.severity for one in contacts} == {"stop"} and numbers == list(stops or numbers)
    assert max(one.value for one in contacts) == pytest.approx(depth, rel=1e-6)
    assert sum(one.amounts["volume_mm3"] for one in contacts) == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("name", SOUND)
def test_a_rapid_move_in_the_air_is_no_contact(tmp_path, name):
    assert contacts_of(tmp_path, *SOUND[name]) == ([], [])


@pytest.mark.parametrize("factor", [1e-3, 10.0], ids=["rigid", "10 times softer"])
@pytest.mark.parametrize(("program", "answer"), [(THROUGH, 2.0 * 10.0 * 8.0 * 0.5), (BACK, 0.0)])
def test_the_answer_does_not_depend_on_the_stiffness_of_the_arm(tmp_path, factor, program, answer):
    compliance = 1e6 * factor * read_cell(find_file("paper.yaml")).arm.joint_compliance
    soft = (*SHORT, f"arm.joint_compliance_urad_per_n_m={compliance.tolist()}", "dynamics.gravity=false")
    cell = small_part(tmp_path, program, *soft)
    target = path_of(cell).target
    for reference in (None, target.with_position(target.position + [0.0, 5e-5, 0.0], target.velocity)):
        checked = check(cell, reference)
        assert checked.rapid_volume_mm3 == pytest.approx(answer, rel=0.02), checked.lines()
        stops = [f for f in checked.findings if f.what == "rapid in material"]
        assert [(f.severity, f.where.line) for f in stops] == [("stop", 5)] * bool(answer)


def test_a_corrected_path_that_lowers_a_rapid_move_into_the_floor_is_a_stop(tmp_path):
    cell = small_part(tmp_path, BACK, *SHORT)
    target, fed = path_of(cell).target, path_of(cell).timed
    back = fed.toolpath.line[fed.block] == 6
    lower = np.where(back, -0.6e-3, 0.0)[:, None] * [0.0, 0.0, 1.0]
    checked = check(cell, target.with_position(target.position + lower, target.velocity))
    stops = [f for f in checked.findings if f.what == "rapid in material"]
    assert stops and stops[0].where.line in (5, 6, 7) and checked.rapid_volume_mm3 > 0.0, checked.lines()
