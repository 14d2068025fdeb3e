"""The cell: its models, its checks between records, the paths and the effort that it refuses."""

import pickle

import numpy as np
import pytest
from samples.small_part import GCODE, small_part
from scipy.spatial.transform import Rotation

from kr270_milling import read_cell
from kr270_milling.base.errors import ConfigError, InputError, MillingError, ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_model_of, arm_of, cut_of, low_frequency_of, path_of
from kr270_milling.cell.paths import MOST_VISITS, check_effort, check_postures, sinking
from kr270_milling.decide.programs.files import kuka_frames
from kr270_milling.physics.robot import Mount, equilibrium, pose

FILE = find_file("paper.yaml")
PAPER = read_cell(FILE)


# --- the cell ---
def test_the_target_is_the_papers_line_from_where_the_start_joints_put_the_tool_and_the_joints_command_its_knots():
    target, joints = path_of(PAPER).target, arm_of(PAPER).joints(path_of(PAPER).target)
    assert target.duration_ns == 1_200_000_000 and set(np.diff(target.time_ns)) == {50_000_000}
    np.testing.assert_allclose(target.position[-1] - target.position[0], [0.080, 0.0, 0.0], atol=1e-15)
    assert target.position[0, 2] == pytest.approx(-PAPER.path.depth_of_cut)
    np.testing.assert_allclose(target.feed(target.time_ns), 4 / 60)
    np.testing.assert_allclose(joints[0], PAPER.start_joints, atol=1e-7)
    tool = PAPER.workpiece.pose.inverse() @ pose(PAPER.arm, PAPER.mount, joints)
    np.testing.assert_allclose(tool.position, target.position, atol=1e-12)
    np.testing.assert_allclose(tool.rotation[0], np.diag([1.0, -1.0, -1.0]), atol=1e-9)  # tcp in the workpiece
    assert [PAPER.exchange.steps_of(seconds) for seconds in (0.01, 0.0101, 1e-6)] == [20, 21, 1]  # of messages


ON_DISPLAY = "{{X: {}, Y: {}, Z: {}, A: {}, B: {}, C: {}}}"


def test_the_frames_of_the_display_are_mount_and_workpiece_and_the_programs_set_the_same_frames(tmp_path):
    """$TOOL is tcp in $FLANGE, z out; R = Rz(A) Ry(B) Rx(C), here by SciPy's intrinsic ZYX."""
    known = "mount.tool_kuka={X: 300, Y: 0, Z: 140, A: 180, B: -90, C: 0}"
    shipped, cell = read_cell("test_piece.yaml"), read_cell("test_piece.yaml", known)
    np.testing.assert_array_equal(cell.mount.xyz, shipped.mount.xyz)
    np.testing.assert_array_equal(cell.mount.abc, shipped.mount.abc)
    assert kuka_frames(shipped)[0].startswith(
        "$TOOL={X 300.0000,Y 0.0000,Z 140.0000,A 180.00000,B -90.00000,C 0.00000}"
    )
    rng = np.random.default_rng(5)
    for _ in range(20):
        tool, base = (np.round([*rng.uniform(-900, 900, 3), *rng.uniform([-180, -89, -180], [180, 89, 180])], 4)
                      for _ in range(2))  # fmt: skip
        words = f"mount.tool_kuka={ON_DISPLAY}".format(*tool), f"workpiece.base_kuka={ON_DISPLAY}".format(*base)
        cell = read_cell("test_piece.yaml", *words)
        flange = Rotation.from_euler("ZYX", [0.0, 90.0, 0.0], degrees=True)  # $FLANGE in flange: z is x of flange
        turn = flange * Rotation.from_euler("ZYX", tool[3:], degrees=True)
        np.testing.assert_allclose(1e3 * cell.mount.xyz, flange.apply(tool[:3]), atol=1e-6)
        np.testing.assert_allclose(cell.mount.pose.rotation, turn.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(1e3 * cell.workpiece.xyz, base[:3], atol=1e-6)
        np.testing.assert_allclose(np.degrees(cell.workpiece.abc), base[3:], atol=1e-6)
        for line, frame in zip(kuka_frames(cell), (tool, base), strict=True):
            shown = [float(word.split()[1]) for word in line[line.index("{") + 1 : line.index("}")].split(",")]
            np.testing.assert_allclose(shown, frame, atol=2e-4)


@pytest.mark.parametrize(("group", "words"), [
    ("mount: {tool_kuka: {X: 1, Y: 2, Z: 3, A: 4, B: 5}}", r"mount\.tool_kuka.*X, Y, Z \[mm\] and A, B, C.*TOOL_DATA"),
    ("mount: {tool_kuka: [1, 2, 3, 4, 5, 6]}", r"mount\.tool_kuka.*TOOL_DATA"),
    ("mount: {tool_kuka: {X: 1, Y: 2, Z: 3, A: 4, B: 5, C: .nan}}", r"mount\.tool_kuka\.C.*-360 to 360"),
    ("mount: {tool_kuka: {X: 1, Y: 6000, Z: 3, A: 4, B: 5, C: 6}}", r"mount\.tool_kuka\.Y.*-5000 to 5000"),
    ("mount: {abc_deg: [1, 2, 3], tool_kuka: {X: 1, Y: 2, Z: 3, A: 4, B: 5, C: 6}}", r"tool_kuka.*either"),
    ("workpiece: {xyz_mm: [1, 2, 3], base_kuka: {X: 1, Y: 2, Z: 3, A: 4, B: 5, C: 6}}", r"base_kuka.*either"),
])  # fmt: skip
def test_a_frame_of_the_display_that_is_not_whole_or_given_twice_is_refused(tmp_path, group, words):
    file = tmp_path / "cell.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    includes: [test_piece.yaml]\n    {group}\n")
    with pytest.raises(ConfigError, match=words):
        read_cell(file)


def test_a_file_with_the_frame_of_the_display_replaces_the_place_of_the_file_that_it_includes(tmp_path):
    file = tmp_path / "cell.yaml"
    frame = ON_DISPLAY.format(1200, 30, 700, 10, 0, 0)
    file.write_text(
        f"/**:\n  ros__parameters:\n    includes: [test_piece.yaml]\n    workpiece: {{base_kuka: {frame}}}\n"
    )
    np.testing.assert_allclose(1e3 * read_cell(file).workpiece.xyz, [1200, 30, 700], atol=1e-9)
    moved = read_cell("paper.yaml", f"workpiece.base_kuka={frame}")  # the paper's part is at the start joints
    np.testing.assert_allclose(np.degrees(moved.workpiece.abc), [10, 0, 0], atol=1e-9)


def test_joints_that_carry_the_sag_lift_the_arm_where_the_controller_does_not():
    spindle = Mount(mass=60.0)
    sagging = PAPER.replace(compensation=PAPER.compensation.replace(sag_compensated=False), mount=spindle)
    target = path_of(PAPER).target
    joints = commanded_joints(arm_of(sagging), sagging.compensation, target)
    tool = sagging.workpiece.pose.inverse() @ equilibrium(sagging.arm, spindle, joints, gravity=True).pose
    np.testing.assert_allclose(tool.position, target.position, atol=1e-9)
    plain = PAPER.replace(mount=spindle)
    rigid = arm_of(plain)
    np.testing.assert_array_equal(commanded_joints(rigid, plain.compensation, target), rigid.joints(target))


@pytest.mark.parametrize(("assignments", "key", "text"), [
    (["exchange.micro_step_deg=7"], "exchange.micro_step_deg", "whole part of 360"),
    (["exchange.period_ms=0.3333"], "exchange.period_ms", "whole number of micro-steps"),
    (["tool.spindle_speed_rpm=8001"], "exchange.period_ms", "for example"),
    (["stock.max_mm=[1, -20, -20]"], "stock.max_mm", "above min_mm"),
    (["tool.pitch_deg=[90, 90]"], "tool.pitch_deg", "4 teeth"),
    (["path.file=nowhere.nc"], "", "no such file"),
    (["tool.spindle_speed_rpm=200000", "tool.teeth=99", "exchange.micro_step_deg=.01"], "exchange.micro_step_deg",
     "larger"),
    (["exchange.iterations=20", "tool.teeth=16", "path.feed_rate_m_per_min=0.002"], "exchange.micro_step_deg",
     "larger"),
    (["stock.min_mm=[-1e5,-1e5,-10]", "stock.max_mm=[1e5,1e5,0]"], "stock.grid_step_um", "larger"),
    (["path.feed_rate_m_per_min=1e-7"], "path.feed_rate_m_per_min", "faster"),
])  # fmt: skip
def test_a_cell_that_cannot_be_and_a_pass_of_days_are_refused_with_their_key(assignments, key, text):
    with pytest.raises(ConfigError) as caught:
        read_cell(FILE, *assignments)
    assert caught.value.key == key and text in str(caught.value) and str(caught.value).isprintable()
    assert "np.float64" not in str(caught.value)


def test_the_score_begins_when_the_middle_of_the_tool_is_at_the_border_and_a_tool_path_has_no_low_frequency(tmp_path):
    for start, diameter, seconds in ((-10, 20, 0.15), (-30, 20, 0.45), (-10, 16, 0.15), (5, 20, 0.0)):
        words = [f"path.start_mm=[{start},0]", f"tool.diameter_mm={diameter}", "stock.min_mm=[0,-20,-20]"]
        cell = read_cell(FILE, *words)
        assert path_of(cell).full_engagement == pytest.approx(seconds, abs=1e-12)
    file = tmp_path / "turned.nc"
    file.write_text("G21 G90 S8000 M3\nG0 X0 Y-15 Z5\nG1 Z-0.5 F1000\nG1 Y15 F4000\n")
    cell = read_cell("test_piece.yaml", f"path.file={file}")
    assert np.isnan(low_frequency_of(cell))


# --- where the workpiece is ---
def test_the_start_joints_place_the_workpiece_and_numbers_may_move_it_without_a_contradiction(tmp_path):
    q = "start_joints_deg=[80,-50,120,180,25,180]"
    turned = read_cell(FILE, q)
    np.testing.assert_allclose(
        np.degrees(arm_of(turned).joints(path_of(turned).target)[0]), [80, -50, 120, 180, 25, 180], atol=1e-6
    )
    moved = read_cell(FILE, "workpiece.xyz_mm=[0,-1600,500]")
    np.testing.assert_allclose(moved.workpiece.xyz, [0.0, -1.6, 0.5])
    np.testing.assert_allclose(moved.workpiece.pose.rotation, PAPER.workpiece.pose.rotation, atol=1e-12)
    placed = "at_start_joints: true"
    twice = FILE.read_text().replace(placed, f"{placed}\n      xyz_mm: [0.0, -1600.0, 500.0]")
    (tmp_path / "cell.yaml").write_text(twice)
    with pytest.raises(ConfigError, match="workpiece.xyz_mm.*at_start_joints places the workpiece"):
        read_cell(tmp_path / "cell.yaml")
    with pytest.raises(ConfigError, match="posture_hint_deg.*six joint positions"):
        read_cell("test_piece.yaml", "posture_hint_deg=[]")


# --- what the program sets ---
PROGRAM = "G21 G90\nM3 S6000\nG0 X-40 Y0 Z5\nG0 Z-1\nG1 X40 F900\nG0 Z5\nM30\n"
SILENT = ["exchange.period_ms=0.25", "tool.spindle_speed_rpm=0"]


def programmed(folder, program, *sets):
    (folder / "part.nc").write_text(program)
    return read_cell("test_piece.yaml", f"path.file={folder / 'part.nc'}", *sets)


def test_speed_and_feed_come_from_program_or_cell_and_may_not_contradict_each_other(tmp_path):
    cell = programmed(tmp_path, PROGRAM, *SILENT)
    assert cell.tool.spindle_speed == pytest.approx(200 * np.pi)
    assert cell.path.source.feeds == pytest.approx((0.015,)) and path_of(cell).feed_rate == pytest.approx(0.015)
    with pytest.raises(ConfigError, match="no spindle speed S"):
        programmed(tmp_path, PROGRAM.replace("M3 S6000", "M3"), *SILENT)
    silent = GCODE.replace(" S8000 M3", "").replace("M5\n", "")
    assert len(path_of(small_part(tmp_path, silent, "tool.rotation=counterclockwise")).target) > 10
    other = ("path.feed_rate_m_per_min=1.2", "tool.spindle_speed_rpm=6000")
    assert path_of(programmed(tmp_path, PROGRAM.replace(" F900", ""), *other)).feed_rate == pytest.approx(0.02)
    with pytest.raises(InputError, match="its feed is 900 mm/min, but path.feed_rate_m_per_min of the cell says 1200"):
        _ = path_of(programmed(tmp_path, PROGRAM, *other)).fed


def test_a_straight_cut_and_a_program_answer_the_same_questions(tmp_path):
    cell = programmed(tmp_path, PROGRAM, *SILENT)
    program, straight = path_of(cell), path_of(PAPER)
    stamps = np.linspace(0, program.target.duration_ns, 50).astype(np.int64)
    of_line = (straight.straight, PAPER.path.name, PAPER.path.files, straight.length, PAPER.path.sha256)
    assert of_line == (True, "straight cut of 80 mm", (), 0.08, "")
    of_program = (program.straight, cell.path.name, cell.path.files, len(cell.path.sha256))
    assert of_program == (False, "part.nc", (tmp_path / "part.nc",), 64) and program.length == pytest.approx(0.092)
    assert not straight.line_at(stamps).any() and not straight.rapid_at(stamps).any()
    assert set(program.line_at(stamps)) == {4, 5, 6}
    assert np.array_equal(program.rapid_at(stamps), program.line_at(stamps) != 5)


def test_equal_cells_share_their_path_and_a_cell_keeps_the_program_that_it_has_read(tmp_path):
    cell = programmed(tmp_path, PROGRAM, *SILENT)
    again = read_cell("test_piece.yaml", f"path.file={tmp_path / 'part.nc'}", *SILENT)
    copy = pickle.loads(pickle.dumps(PAPER))
    assert copy == PAPER and hash(copy) == hash(PAPER) and path_of(copy) is path_of(PAPER)
    assert cell == again and path_of(cell) is path_of(again)
    assert path_of(cell.replace(limits=cell.limits.replace(rapid_contact=0.0))) is path_of(cell)
    assert path_of(cell.replace(timing=cell.timing.replace(jerk=1.0))) is not path_of(cell)
    length = path_of(cell).length
    (tmp_path / "part.nc").write_text(PROGRAM.replace("X40", "X30"))
    assert path_of(cell.replace(stock=cell.stock.replace(grid_step=1e-4))).length == length
    (tmp_path / "part.nc").unlink()
    assert path_of(cell.replace(stock=cell.stock.replace(grid_step=2e-4))).length == length
    with pytest.raises(InputError, match="cannot be read"):
        path_of(cell.replace(path=cell.path.replace(tool="T2"))).target  # noqa: B018


# --- effort ---
HEAD = "G21 G90 S8000 M3\n"


def test_the_effort_of_a_path_file_is_reckoned_with_its_ramps_and_postures(tmp_path):
    slow = HEAD + "G0 X-14 Y0 Z2\nG0 Z-1\nG1 X28 F0.005\n"
    with pytest.raises(MillingError, match="exchange periods"):
        assert path_of(small_part(tmp_path, slow, "timing.controller_step_ms=1000.0")).target
    fine = ["exchange.micro_step_deg=0.01", "tool.teeth=50", "exchange.iterations=20", "cutting.detail=teeth"]
    with pytest.raises(ParameterError, match=r"micro_step_deg.*larger"):
        assert path_of(small_part(tmp_path, slow.replace("F0.005", "F4"), *fine)).target
    ramp = HEAD + "G0 X2 Y0 Z0\n" + "".join(f"G1 X{20 + 10 * (-1) ** k} Z{-k / 100} F100\n" for k in range(1, 60))
    assert path_of(small_part(tmp_path, ramp)).target
    with pytest.raises(ParameterError, match=r"grid_step_um.*sinking"):
        assert path_of(
            small_part(tmp_path, ramp, "tool.diameter_mm=80.0", "stock.grid_step_um=0.5", "cutting.detail=teeth")
        ).target
    slow = ["dynamics.follow_pose=true", "dynamics.posture_spacing_mm=1e-9", "path.feed_rate_m_per_min=0.05"]
    cell = read_cell(FILE, *slow)
    with pytest.raises(ParameterError, match="posture_spacing_mm"):
        arm_model_of(cell, path_of(cell).target)
    check_postures(100_000, 1e-3)


def test_what_a_footprint_swept_as_a_whole_costs():
    """By hand: each turn 4 teeth sweep pi (10 mm / 1 um)^2 nodes, so that 7958 turns, 59.7 s, are the most."""
    stock = PAPER.stock.replace(grid_step=1e-6)
    most = MOST_VISITS / (4 * np.pi * 1e8) * 60 / 8000
    assert most == pytest.approx(59.68, abs=0.01)
    deep = 1.0  # [m], far more than the tolerance of the floor thins out
    check_effort(PAPER.exchange, PAPER.tool, stock, 100.0, (0.999 * most, deep))
    with pytest.raises(ParameterError):
        check_effort(PAPER.exchange, PAPER.tool, stock, 100.0, (1.001 * most, deep))
    check_effort(PAPER.exchange, PAPER.tool, stock, 100.0, (1.001 * most, 1e-3))
    # only the way down below the top counts
    assert sinking(np.arange(6.0), np.array([5.0, 1.0, -1.0, -1.0, 2.0, -3.0]), 0.0) == (2.0, 4.0)
    assert sinking(np.arange(3.0), np.array([1.0, 2.0, 0.5]), 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("stiffness", ["1e30", "5e12"])
def test_an_arm_that_would_fly_off_gives_no_numbers(stiffness):
    short = ["path.length_mm=14", "stock.grid_step_um=50", f"cutting.fractional.stiffness_n_per_m={stiffness}"]
    with pytest.raises(MillingError, match="would push the tool"):
        simulate(read_cell(FILE, *short))


# --- Tool paths that a cell refuses because their spindle, their tool axis or their moves cannot be meant ---
def table(directory, a=0.0, b=0.0, c=180.0, detail="auto"):
    """The cell with a slot as a table; A, B, C [deg] turn tcp."""
    path = directory / "slot.csv"
    rows = "".join(f"{x},0,-0.5,{a},{b},{c},3000\n" for x in range(-14, 20, 2))
    path.write_text("x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min\n" + rows)
    return read_cell("paper.yaml", f"path.file={path}", "stock.max_mm=[40,14,0]", f"cutting.detail={detail}")


@pytest.mark.parametrize(("program", "rotation", "reason", "line"), [
    (GCODE.replace("G1 Y10\n", "M5\nG1 Y10\n"), "clockwise", "while the spindle is off", 8),
    (GCODE, "counterclockwise", "turns clockwise .* counterclockwise", None),
    ("G21 G90\nG0 X-14 Y0 Z-0.5\nG0 X20\nM30\n", "clockwise", "no cutting move", None),
])  # fmt: skip
def test_a_program_whose_spindle_or_moves_cannot_be_meant_is_refused(tmp_path, program, rotation, reason, line):
    with pytest.raises(InputError, match=reason) as caught:
        assert path_of(small_part(tmp_path, program, f"tool.rotation={rotation}")).target
    assert line is None or caught.value.line == line


def test_a_tilted_tool_is_refused_by_the_model_that_does_not_know_its_tilt_and_taken_by_the_other(tmp_path):
    for turned, tilt, detail in ((dict(c=210.0), 30, "teeth"), (dict(b=2.0), 2, "teeth"), (dict(c=0.0), 180, "auto")):
        with pytest.raises(InputError, match=f"tilted by {tilt} deg") as caught:
            assert path_of(table(tmp_path, detail=detail, **turned)).target
        assert caught.value.line in (2, 3)
    cell = table(tmp_path, c=210.0)
    assert cell.cutting.by_engagement and path_of(cell).tilts and cut_of(cell).tilts and not path_of(cell).upright
    assert np.ptp(path_of(table(tmp_path, a=30.0, c=180.9)).target.position[:, 0]) == pytest.approx(32e-3)
