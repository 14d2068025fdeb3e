"""Robot programs, offset tables and joint tables, read back by a reader of the tests and run on pinocchio's arm."""

import re
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from arm_oracle import pinocchio_arm
from budget import LONG
from krl_robot import NUMBER, Robot
from samples.small_part import GCODE, small_part, swayed
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from splines import spline

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.version import __version__
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.sections import Program
from kr270_milling.decide.check import check
from kr270_milling.decide.compensation import compensate
from kr270_milling.decide.programs import points
from kr270_milling.decide.programs.files import (
    offsets,
    program_bytes,
    rsi_address,
    time_law,
    write_joint_table,
    write_programs,
    write_rsi_table,
)
from kr270_milling.decide.programs.krl import Setup, trajectory_hash, write_krl
from kr270_milling.decide.programs.points import point_numbers, program_points
from kr270_milling.decide.programs.written import read_krl, softer_pass, written_pass, written_trajectory
from kr270_milling.live.rsi.telegram import Elements, read_elements
from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.cam.krl import read_krl_program
from kr270_milling.path.controller_motion import block_ends, controller_motion, places_on_program
from kr270_milling.path.timing import Timing, time_path
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, TrajectoryError
from kr270_milling.physics.robot import BARE


def setup(**more) -> Setup:
    mount = Pose.from_abc([0.0, 0.0, 0.25], np.radians([0.0, 90.0, 0.0]))
    base = Pose.from_abc([1.0, -1.6, 0.3], np.radians([30.0, 1.0, -2.0]))

    def approach(run: Trajectory, knot: int):
        return np.array([*run.position[knot, :2], 0.05]), 2, 35

    about = dict(top=0.0, load_mass=12.0, load_centre=(0.0, 0.01, 0.1), date="2025-06-01")
    return Setup(mount, base, approach, **about | more)


def swaying(count: int, seed: int = 3) -> tuple[Trajectory, Trajectory]:
    """A line of ``count`` knots with turning tool, and a correction of some 0.1 mm and 0.1 deg."""
    random = np.random.default_rng(seed)
    time_ns = np.arange(count) * 50_000_000
    position = np.stack([np.arange(count) * 1e-3, 0.01 * np.sin(np.arange(count) / 9), 0 * time_ns], axis=1)
    turn = Rotation.from_euler(
        "ZYX", np.stack([np.arange(count) / 20, 0.3 * np.sin(np.arange(count)), np.pi + 0 * time_ns], 1)
    )
    small = Rotation.from_rotvec(random.normal(0, 1e-3, (count, 3)))
    original = Trajectory(time_ns, position, turn.as_quat())
    return original, Trajectory(time_ns, position + random.normal(0, 1e-4, (count, 3)), (small * turn).as_quat())


def write(directory, program: Program, original, revised, **more) -> tuple[list[Path], np.ndarray, list]:
    if directory.parent.exists():
        directory.mkdir(exist_ok=True)
    return write_krl(directory, program, setup(**more), original, revised)


def assert_recovered(robot: Robot, run: Trajectory, k: np.ndarray) -> None:
    """To 0.1 um and 0.001 deg at each point, which is knot k; numbers of comments are those of the knots, from 1."""
    assert np.abs(robot.column("XYZ") * 1e-3 - run.position[k]).max() < 1e-7
    assert all(number == k[order] + 1 for number, order in robot.comments)
    turned = Rotation.from_euler("ZYX", robot.column("ABC"), degrees=True)
    assert np.degrees((turned.inv() * Rotation.from_quat(run.quaternion[k])).magnitude()).max() < 1e-3


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
@pytest.mark.parametrize("limit", [1400, 120])
def test_both_programs_are_parsed_back_across_all_their_modules(tmp_path, motion, limit):
    pair = swaying(500)
    files, knots, _ = write(tmp_path, Program(name="PART", motion=motion, line_limit=limit), *pair)
    assert sorted(files) == sorted(tmp_path.iterdir()) and (len(files) == 4) == (limit == 1400)
    assert max(len(path.read_text().splitlines()) for path in files) <= limit
    robots = [Robot(tmp_path, main) for main in ("PART_ORG", "PART_CMP")]
    for robot, run in zip(robots, pair, strict=True):
        assert len(robot.points) == 500 and len(robot.comments) == 9
        assert_recovered(robot, run, knots)
        if motion == "LIN":
            speed = np.linalg.norm(np.diff(run.position, axis=0), axis=1) / np.diff(run.time)
            written = [speed for _, speed in robot.points[1:]]
            np.testing.assert_allclose(written, speed, rtol=0.02)
    assert robots[0].rests == robots[1].rests


def test_a_tool_that_lies_level_is_recovered_although_its_angles_are_singular(tmp_path):
    original, _ = swaying(40)
    lean = np.concatenate([np.linspace(-1e-3, 1e-3, 39), [0.0]])
    level = Rotation.from_euler("ZYX", np.stack([np.full(40, 0.4), np.pi / 2 + lean, np.full(40, -0.7)], 1))
    run = Trajectory(original.time_ns, original.position, level.as_quat())
    _, knots, _ = write(tmp_path, Program(tolerance=0.0), run, run)
    assert_recovered(Robot(tmp_path, "MILLING_CMP"), run, knots)


@pytest.mark.parametrize("feed", [1e-5, 0.5e-3, 1.4e-3, 8.3e-3, 0.0333])  # [m/s]; 0.5 mm/s: 30 mm/min of a drill
def test_a_slow_feed_is_written_to_two_percent(tmp_path, feed):
    slow = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], feed, feed, 0.05)
    write(tmp_path, Program(tolerance=0.0), slow, slow)
    speeds = [speed for _, speed in Robot(tmp_path, "MILLING_ORG").points[1:]]
    assert speeds == pytest.approx([feed] * len(speeds), rel=0.02)


def test_speeds_are_those_along_the_curve(tmp_path):
    angle = np.linspace(0, np.pi, 41)
    circle = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    time_ns = np.arange(41) * 50_000_000
    tangent = 0.05 * np.pi / 2 * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    write(tmp_path, Program(), *2 * [Trajectory(time_ns, circle, [1.0, 0, 0, 0], tangent)])
    speeds = [speed for _, speed in Robot(tmp_path, "MILLING_ORG").points[1:]]
    np.testing.assert_allclose(speeds, 0.05 * np.pi / 2, atol=0.5e-3)


def test_the_points_of_a_turning_and_of_an_upright_tool_are_chosen_by_one_compiled_function():
    for run in (*swaying(9), Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.01, 0.05, 0.05)):
        point_numbers(Program(), run, run)
    assert len(points._apart.signatures) == 1


def milled(tmp_path, text: str) -> Trajectory:
    (tmp_path / "part.nc").write_text(text)
    return time_path(read_gcode(tmp_path / "part.nc"), Timing()).trajectory


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
def test_the_robot_stops_in_the_corners_and_nowhere_else(tmp_path, motion):
    run = milled(tmp_path, "G0 X0 Y0 Z0\nG1 X20 F4000\nG1 Y20\nG1 X0.3\nX0.3 Y20.004\nM30\n")
    _, knots, _ = write(tmp_path, Program(motion=motion), run, run)
    robot = Robot(tmp_path, "MILLING_ORG")
    rests = run.position[knots[np.array(robot.rests) - 1]] * 1e3
    np.testing.assert_allclose(rests[:2], [[20, 0, 0], [20, 20, 0]], atol=1e-6)
    np.testing.assert_allclose(rests[-1], [0.3, 20.004, 0], atol=1e-6)
    assert len(rests) <= 4 and np.linalg.norm(np.diff(robot.column("XYZ"), axis=0), axis=1).min() > 1e-3
    run = milled(tmp_path, "G0 X0 Y0 Z0\n" + "G1 X30 F4000\nX0\n" * 20 + "M30\n")
    program = Program(motion=motion, line_limit=400, tolerance=0.0)  # modules end at a stop where one is near
    files, knots, _ = write(tmp_path, program, run, run)
    stops = np.flatnonzero(np.linalg.norm(run.velocity, axis=1) == 0)
    rests = knots[np.array(Robot(tmp_path, "MILLING_ORG").rests) - 1]
    assert len(files) > 8 and set(rests) <= set(stops)


#: rows of zigzag with a retract after each
ROWS = "G21 S8000 M3\nG0 X0 Y0 Z5\n" + "".join(
    f"(row {row})\nG1 Z-1 F2000\n" + "".join(f"G1 X{x} Y{row + x % 2}\n" for x in range(60)) + "G0 Z5\nG0 X0\n"
    for row in range(12)
)  # fmt: skip


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
def test_a_program_larger_than_the_memory_has_parts_that_begin_and_end_above_the_stock(tmp_path, motion):
    run = milled(tmp_path, ROWS + "M30\n")
    program = Program(name="A234567890123456", motion=motion, memory=10e3)
    whole, knots, (one,) = write(tmp_path / "whole", program.replace(memory=4e6), run, run)
    files, same, parts = write(tmp_path / "parts", program, run, run)
    (before, stopped, _), (pose, stops, _) = (
        read_krl(tmp_path / name, f"{program.name}_CMP") for name in ("whole", "parts")
    )
    assert one == (0, len(run) - 1) and same.tolist() == knots.tolist()
    np.testing.assert_array_equal(pose.position, before.position)
    np.testing.assert_array_equal(stops, stopped)
    robot = Robot(tmp_path / "parts", f"{program.name}_CMP")
    assert_recovered(robot, run, knots)
    assert knots[np.array(robot.starts) - 1].tolist() == [first for first, _ in parts]
    assert [last for _, last in parts] == [*(first for first, _ in parts[1:]), len(run) - 1]
    assert all(run.standing[last] and run.position[last, 2] >= 0.0 for _, last in parts[:-1])
    assert robot.steps.count("PTP XAPPROACH") == robot.steps.count("LIN XRETRACT") == len(parts) > 2
    for kind in ("ORG", "CMP"):
        sizes = [sum(f.stat().st_size for f in (tmp_path / "parts" / f"P{n}").glob(f"*_{kind}*"))
                 for n in range(1, len(parts) + 1)]  # fmt: skip
        assert max(sizes) <= 10e3 and sum(sizes) > sum(f.stat().st_size for f in whole if f"_{kind}" in f.name)
    assert len({path.name for path in files}) == len(files) and max(len(path.stem) for path in files) <= 24
    with pytest.raises(TrajectoryError, match="none of them is a stop above the stock"):
        write(tmp_path, program, run, run, top=0.1)


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
def test_angles_are_written_where_the_tool_turns_and_a_point_takes_half_the_bytes(tmp_path, motion):
    """Version 0.3.0 took 109 bytes a point. The reader of foreign KRL finds the same points."""
    run = milled(tmp_path, ROWS + "M30\n")
    files, knots, _ = write(tmp_path / "krl", Program(motion=motion), run, run)
    assert sum(path.stat().st_size for path in files if "_CMP" in path.name) < 55 * len(knots)
    robot, path = (
        Robot(tmp_path / "krl", "MILLING_CMP"),
        read_krl_program(tmp_path / "krl" / "MILLING_CMP.src", "", 0.05),
    )
    places = [line for line in robot.steps if line.startswith(f"{motion[:3]} {{")]
    modules = [path for path in files if "_CMP" in path.name and f"{motion[:3]} {{" in path.read_text()]
    assert sum(",A " in line for line in places) == len(robot.comments) + len(modules)
    assert cKDTree(path.position).query(run.position[knots])[0].max() < 1e-7


def test_names_are_krl_names_and_what_no_controller_reads_is_refused(tmp_path):
    files, *_ = write(tmp_path, Program(name="A234567890123456", line_limit=100), *swaying(200))
    assert max(len(path.stem) for path in files) <= 24
    names = ("", "1PART", "part", "PART-1", "A2345678901234567", "../X", "PART\n")
    values = dict(spindle_on=("A\nB",)), dict(home="x"), dict(home_angles=[1.0]), dict(coolant_off=("\u00e4",))
    for wrong in (*({"name": name} for name in names), *values):
        with pytest.raises(ParameterError):
            Program(**wrong)


def test_the_five_lines_of_the_head_state_version_date_decision_source_and_hash(tmp_path):
    pair = swaying(20)
    write(tmp_path, Program(), *pair, source_hash="abc", method="spline", decision="caution")
    for kind, run, word in (("ORG", pair[0], "original"), ("CMP", pair[1], "compensated")):
        for suffix in ("src", "dat"):
            text = (tmp_path / f"MILLING_{kind}.{suffix}").read_text()
            for piece in (trajectory_hash(run), "abc", "2025-06-01", __version__, word, "SIMULATION RESULT", "T1"):
                assert piece in text
            lines = text.splitlines()[4:9]
            assert all(line.startswith("; ") for line in lines) and lines[-1] == "; sha256 of its source abc"
            assert "decision caution: see MANIFEST.txt" in text
    assert ",S 2,T 35," in text


def test_a_text_that_would_break_the_head_a_pair_that_does_not_fit_and_too_many_modules_are_refused(tmp_path):
    for text in ("1.0\nEND", "\u00e4", "x" * 101):
        with pytest.raises(TrajectoryError):
            write(tmp_path, Program(), *swaying(20), source_hash=text)
    with pytest.raises(TrajectoryError):
        write(tmp_path, Program(), swaying(20)[0], swaying(21)[1])
    with pytest.raises(TrajectoryError, match="raise program.line_limit"):
        write(tmp_path, Program(motion="LIN", line_limit=100), *swaying(4000))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("sign", ["\x0b", "\x0c", "\x85", "\u2028", "\u2029", "\x1c", "\x00", "\x7f", "\r", "\n", "\t"])
def test_a_name_of_an_operation_is_one_line_of_ascii(tmp_path, sign):
    run = swaying(20)[0]
    name = f"Tasche \u00dc1{sign}HALT {sign} \u2205"
    notes = np.arange(1, 21), np.array([name] * 20, object)
    write_krl(tmp_path, Program(tolerance=0.0), setup(), run, run, notes)
    text = (tmp_path / "MILLING_CMP.src").read_bytes()
    assert not set(text) - {*range(32, 127), 10, 13} and len(text.splitlines()) == text.count(b"\r\n")
    gap = b" " if sign.isspace() else b""
    assert b"; XP2 line 2 (Tasche U1" + gap + b"HALT" in text and b"; XP12 line 12\r\n" in text
    assert len(Robot(tmp_path, "MILLING_CMP").points) == 20


# --- What a program does before and behind the path: home, safe height, spindle, coolant, tool and base ---
#: a cell's own commands, run up, home declared, tool and base of the controller's tables
OWN = Program(
    spindle_on=("$OUT[1]=TRUE",), spindle_off=("$OUT[1]=FALSE",), coolant_on=("$OUT[2]=TRUE",),
    coolant_off=("$OUT[2]=FALSE",), spindle_run_up=4.0, home_angles=np.radians([0, -90, 90, 0, 0, 0]), set_load=True,
    tool_number=3, base_number=12,
)  # fmt: skip


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
@pytest.mark.parametrize("limit", [1400, 130])
def test_the_program_starts_and_ends_at_home_with_the_spindle_on_in_between(tmp_path, motion, limit):
    pair = swaying(200)
    write(tmp_path, OWN.replace(motion=motion, line_limit=limit), *pair)
    steps = [line for line in Robot(tmp_path, "MILLING_CMP").steps if not line.startswith((";", "&"))]
    moves = [line for line in steps if line.startswith(("PTP", "LIN X", "SPL "))]
    assert moves[:3] == ["PTP XHOME", "PTP XAPPROACH", "LIN XP1"] and moves[-2:] == ["LIN XRETRACT", "PTP XHOME"]
    order = [steps.index(line) for line in ("PTP XHOME", "$OUT[1]=TRUE", "WAIT SEC 4.0", "$OUT[2]=TRUE",
                                            "PTP XAPPROACH", "LIN XP1", "LIN XRETRACT", "$OUT[1]=FALSE")]  # fmt: skip
    assert order == sorted(order) and steps.index("$OUT[2]=FALSE") > steps.index("LIN XRETRACT")
    text = (tmp_path / "MILLING_CMP.src").read_text()
    assert "$LOAD={M 12.000" in text and "$BASE=BASE_DATA[12]\n" in text
    assert "$TOOL=TOOL_DATA[3]\n" in text and "; TOOL_DATA[3] must be {X 0.0000,Y 0.0000,Z 250.0000" in text
    text = (tmp_path / "MILLING_CMP.dat").read_text()
    up = -Rotation.from_quat(pair[1].quaternion[-1]).as_matrix()[:, 2]
    end = 1e3 * pair[1].position[-1]
    leaves = end + (50.0 - end[2]) / up[2] * up  # along the axis of the tool to the safe height, 50 mm
    for name, wanted in (("XAPPROACH", [*pair[1].position[0, :2] * 1e3, 50.0]), ("XRETRACT", leaves)):
        place = re.search(rf"{name}={{X ({NUMBER}),Y ({NUMBER}),Z ({NUMBER})", text).groups()
        assert [float(v) for v in place] == pytest.approx(wanted, abs=1e-4)
    assert "DECL E6AXIS XHOME={A1 0.0000,A2 -90.0000,A3 90.0000,A4 0.0000,A5 0.0000,A6 0.0000," in text


@pytest.mark.parametrize("lines", [(), ("HALT",)])
def test_the_program_halts_where_the_operator_starts_the_spindle(tmp_path, lines):
    run = swaying(20)[0]
    spindle = setup(spindle="8000 rpm, clockwise")
    write_krl(tmp_path, OWN.replace(spindle_on=lines), spindle, run, run)
    steps = Robot(tmp_path, "MILLING_CMP").steps
    halt = steps.index("HALT")
    assert "start the spindle by hand (8000 rpm, clockwise)" in steps[halt - 1] and steps.count("HALT") == 1
    assert steps.index("PTP XHOME") < halt < steps.index("PTP XAPPROACH")


# --- The programs of a cell ---
DATE = "2030-01-01T00:00:00+00:00"


def assert_flange(robot: Robot, arm, joints: np.ndarray) -> None:
    """The points bring the flange where joint positions [rad] bring that of pinocchio, to 1 um and 0.001 deg."""
    model, data, frame = pinocchio_arm(arm, BARE)
    outward = Rotation.from_euler("y", np.pi / 2).as_matrix()  # the controller's z points out of the flange
    commanded = robot.matrix("BASE") @ robot.transforms @ np.linalg.inv(robot.matrix("TOOL"))
    for q, place in zip(joints, commanded, strict=True):
        pin.framesForwardKinematics(model, data, q)
        assert np.abs(place[:3, 3] - data.oMf[frame].translation).max() < 1e-6
        turned = Rotation.from_matrix(place[:3, :3].T @ data.oMf[frame].rotation @ outward)
        assert np.degrees(turned.magnitude()) < 1e-3


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_part(tmp_path_factory.mktemp("part"), GCODE, "program.tolerance_um=0")


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
def test_programs_bring_the_flange_where_the_joint_positions_do(cell, tmp_path, motion):
    target = path_of(cell).target
    write_programs(tmp_path, cell, target, swayed(target), method="swayed", date=DATE, motions=(motion,))
    for kind, name, run in (("ORG", "original", target), ("CMP", "swayed", swayed(target))):
        read = Robot(next(tmp_path.glob(f"krl_{motion.lower()}_*")), f"MILLING_{kind}")
        file = next(tmp_path.glob(f"joints_{name}_*.csv"))
        assert file.read_text().partition("\n")[0] == "time_s," + ",".join(f"joint_{j}_deg" for j in range(1, 7))
        table = np.loadtxt(file, delimiter=",", skiprows=1)
        program = cell.krl.replace(motion=motion)
        knots = point_numbers(program, target, swayed(target))
        assert_flange(read, cell.arm, np.radians(table[knots, 1:]))
        assert np.abs(read.transforms[:, :3, 3] - run.position[knots]).max() < 1e-6
        assert table[:, 0] == pytest.approx(run.time, abs=1e-9)
        away = np.linalg.norm(np.diff(run.position[knots], axis=0), axis=1)
        least = 0.9 * cell.krl.point_spacing
        assert away.min() > least and len(knots) > 0.9 * len(run)  # nothing but close points is left out


def test_an_axis_at_zero_gets_an_approach_beside_it_and_the_load_has_the_axes_of_the_controllers_flange(tmp_path):
    """A part straight ahead: A1, A4 and A6 start at exactly 0, and rounding would decide what T says of them."""
    words = ['program.spindle_on=["$OUT[1]=TRUE"]', "stock.max_mm=[50,50,4]"]
    cell = read_cell(find_file("test_piece.yaml"), words)
    time_ns, quaternion = np.arange(3) * 12_000_000, path_of(cell).target.quaternion[0]
    line = Trajectory(time_ns, np.outer(np.arange(3), [1e-3, 0.0, 0.0]), quaternion)
    for sign in (1.0, -1.0):
        beside = line.with_position(line.position + [0.0, sign * 1e-5, 0.0])
        folder = tmp_path / f"{sign:g}"
        write_programs(folder, cell, line, beside, method="beside", date=DATE)
        for kind, run in (("ORG", line), ("CMP", beside)):
            robot = Robot(next(folder.glob("krl_spline_*")), f"MILLING_{kind}")
            above = np.array(robot.approach) / 1e3
            assert np.linalg.norm(above[:2] - run.position[0, :2]) < 0.5e-3
            assert above[2] == pytest.approx(0.054)  # 50 mm above the top of the stock
            (joints,) = arm_of(cell).joints_at(above[None], quaternion[None])
            assert np.degrees(np.abs(joints)).min() > 1e-3
            assert robot.turn == sum(1 << axis for axis in range(6) if joints[axis] < 0)
            # 130 mm out of the flange and 60 mm below it: out of the flange is the controller's z, up is its minus x
            assert any("$LOAD={M 45.000,CM {X 60.000,Y 0.000,Z 130.000" in step for step in robot.steps)
            assert "$OUT[1]=TRUE" in robot.steps


def test_sag_is_in_the_points_where_the_controller_does_not_compensate_it(cell, tmp_path):
    own = cell.replace(compensation=cell.compensation.replace(sag_compensated=False))
    line = Trajectory(np.arange(4) * 10**8, np.outer(np.arange(4), [1e-3, 0, 0]), path_of(cell).target.quaternion[0])
    write_programs(tmp_path, own, line, line, method="same", date=DATE)
    read = Robot(next(tmp_path.glob("krl_spline_*")), "MILLING_ORG")
    assert_flange(read, own.arm, commanded_joints(arm_of(own), own.compensation, line))
    lifted = (own.workpiece.pose.apply(read.transforms[:, :3, 3]) - own.workpiece.pose.apply(line.position))[:, 2]
    assert np.all(lifted > 0.1e-3)  # 700 kg of arm bend it by tenths of a millimetre


# --- RSI context, offset tables and joint tables ---
def test_the_rsi_context_leads_each_correction_to_its_axis_in_base(cell, tmp_path):
    """Object and parameter numbers of POSCORR and ETHERNET: those of two contexts of others that run on a KR C4."""
    target = path_of(cell).target
    address = rsi_address("192.168.1.10:50000")
    files, _ = write_programs(tmp_path, cell, target, target, method="same", date=DATE, rsi=address)
    src, context, _, ethernet = files["rsi_context"]
    assert read_elements(ethernet) == Elements()  # the command ``rsi`` speaks as the written context
    network = ElementTree.parse(ethernet)
    assert [network.findtext(f"CONFIG/{key}") for key in ("IP_NUMBER", "PORT")] == ["192.168.1.10", "50000"]
    channel = {one.get("INDX"): one.get("TAG") for one in network.iterfind("RECEIVE/ELEMENTS/ELEMENT")}
    objects = {one.get("ObjID"): one for one in ElementTree.parse(context).iterfind("RSIObject")}
    inputs = [(one.get("InIdx"), channel[one.get("OutIdx")]) for one in objects["POSCORR1"].iterfind("Inputs/Input")]
    assert inputs == [(str(n), f"RKorr.{axis}") for n, axis in enumerate("XYZABC", 1)]
    values = {one.get("Name"): one.attrib for one in objects["POSCORR1"].iterfind("Parameters/Parameter")}
    most = 1e3 * cell.compensation.max_correction
    assert float(values["LowerLimZ"]["ParamValue"]) == -most and float(values["UpperLimX"]["ParamValue"]) == most
    numbers = {name: int(one["ParamID"]) for name, one in values.items()}
    assert numbers == {"LowerLimX": 1, "LowerLimY": 2, "LowerLimZ": 3, "UpperLimX": 4, "UpperLimY": 5, "UpperLimZ": 6,
                       "MaxRotAngle": 7, "RefCorrSys": 1}  # fmt: skip
    assert objects["ETHERNET1"].find("Parameters/Parameter[@Name='ConfigFile']").get("ParamValue") == ethernet.name
    lines = src.read_bytes().decode("ascii").split("\r\n")
    steps = ('RSI_CREATE("MILLING.rsi",RSI_ID,TRUE)', "RSI_ON(#ABSOLUTE)", "RSI_OFF()", "RSI_DELETE(RSI_ID)")
    order = [lines.index(f"RSI_RET={step}") for step in steps]
    order.insert(2, lines.index("MILLING_ORG( )"))
    assert order == sorted(order) and lines.count("HALT") == 3


def test_each_part_of_a_program_has_its_table_and_its_program_for_rsi(tmp_path):
    rows = GCODE.replace("M5\nM30\n", "") + "G0 X-14 Y0\nG0 Z-1\nG1 X12\nY10\nG0 Z2\n" * 8 + "M5\nM30\n"
    cell = small_part(tmp_path, rows, "program.memory_mb=0.01", "program.tolerance_um=0")
    target = path_of(cell).target
    files, text = write_programs(
        tmp_path / "out", cell, target, swayed(target), method="m", date=DATE, rsi=rsi_address("192.168.1.10")
    )
    count = len(files["rsi"])
    tables = [np.genfromtxt(path, delimiter=",", names=True) for path in files["rsi"]]
    programs = [path.stem for path in files["rsi_context"] if path.suffix == ".src"]
    assert programs == [f"MILLING_RSI_P{n}" for n in range(1, count + 1)] and count > 1
    for path in files["rsi_context"][:count]:
        assert f"{path.stem.replace('RSI', 'ORG')}( )" in path.read_text().splitlines()
    assert all(table["time_s"][0] == 0.0 and abs(table["dX_mm"][-1]) < 1e-9 for table in tables)
    assert sum(table["time_s"][-1] for table in tables) >= target.time[-1]
    assert f"it has {count} parts" in text and f"{program_bytes(files['krl_spline']) / 1e6:.3g} MB" in text


@pytest.mark.parametrize("text", ["", "host", "1.2.3", "1.2.3.4:0", "1.2.3.4:x", "1.2.3.4:99999", "::1"])
def test_an_address_that_no_controller_takes_is_refused(text):
    with pytest.raises(InputError, match="--rsi"):
        rsi_address(text)


LINE = Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], 0.08, 4 / 60, 0.05)
BENT = spline(LINE.time_ns, LINE.position + np.sin(LINE.time)[:, None] * [0, 1e-4, -2e-5], ends="not-a-knot")


@pytest.mark.parametrize("tick_ms", [4, 12])
def test_the_rsi_table_has_the_difference_of_both_paths_at_every_tick_and_turns_about_the_axes_of_base(
    tmp_path, tick_ms
):
    write_rsi_table(tmp_path / "rsi.csv", LINE, BENT, tick_ms * 10**6)
    table = np.genfromtxt(tmp_path / "rsi.csv", delimiter=",", names=True)
    time = table["time_s"]
    assert len(table) == 1200 // tick_ms + 1 and time[-1] == 1.2
    np.testing.assert_allclose(table["dY_mm"], 0.1 * np.sin(time), atol=2e-6)  # spline error and the last digit
    np.testing.assert_allclose(table["dZ_mm"], -0.02 * np.sin(time), atol=2e-6)
    assert np.abs(table["dX_mm"]).max() < 1e-6 and not table["dA_deg"].any() and not table["dB_deg"].any()
    turn = Rotation.from_rotvec([1e-4, -2e-4, 3e-4])
    turned = Trajectory(LINE.time_ns, LINE.position, (turn * Rotation.from_quat(TOOL_DOWN)).as_quat())
    _, shift, abc = offsets(LINE, turned, 4_000_000)
    np.testing.assert_allclose(abc, np.tile([3e-4, -2e-4, 1e-4], (301, 1)), atol=1e-7)  # A, B, C about z, y, x
    assert not shift.any()


@pytest.mark.parametrize("lift", [0.0, 0.06], ids=["in the cut", "in the air"])
def test_the_correction_of_rsi_fades_to_zero_above_the_stock(tmp_path, lift):
    """The stock ends at z = 0, the retract at 50 mm with 50 mm/s; 0.2 s of air at the end of a path need no retract."""
    rise = np.clip(LINE.time - 0.8, 0.0, 0.1)[:, None] * [0.0, 0.0, 10 * lift] - [0.0, 0.0, 2e-3]
    low, bent = (run.with_position(run.position + rise) for run in (LINE, BENT))
    for name, air in (("plain", None), ("faded", (0.0, 0.05, 0.05))):
        write_rsi_table(tmp_path / name, low, bent, 4_000_000, air)
    plain, faded = (np.genfromtxt(tmp_path / name, delimiter=",", names=True) for name in ("plain", "faded"))
    last, z = faded[-1], faded["Z_mm"]
    assert last["dY_mm"] == last["dZ_mm"] == last["dA_deg"] == 0.0 < abs(plain["dY_mm"][-1])
    cut = np.flatnonzero(z[: len(plain)] < 0.0)
    np.testing.assert_array_equal(faded["dY_mm"][cut], plain["dY_mm"][cut])
    assert np.abs(np.diff(faded["dY_mm"])).max() < 1.2 * np.abs(plain["dY_mm"]).max() / 50  # 50 ticks of 4 ms
    assert len(faded) == (len(plain) + 260 if not lift else len(plain)) and z[-1] == (50.0 if not lift else z[-1])
    np.testing.assert_allclose(np.diff(faded["time_s"]), 0.004, atol=1e-9)


def test_other_ticks_paths_of_unlike_duration_and_joints_that_do_not_fit_the_knots_are_refused(tmp_path):
    longer = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.0901, 4 / 60, 0.05)
    assert offsets(longer, longer, 12_000_000)[0][-1] >= longer.duration_ns  # no multiple of the tick
    for arguments in ((LINE, BENT, 5_000_000), (LINE, longer, 4_000_000)):
        with pytest.raises(TrajectoryError):
            write_rsi_table(tmp_path / "rsi.csv", *arguments)
    for wrong in (np.zeros((24, 6)), np.full((25, 6), np.nan)):
        with pytest.raises(TrajectoryError):
            write_joint_table(tmp_path / "joints.csv", LINE, wrong)
    assert not list(tmp_path.iterdir())


# --- The figures of a program are those of its written points, joined as the controller joins them ---
UM = 1e-6
SMOOTH = "spline", "learned", "inverse"


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    cell = small_part(tmp_path_factory.mktemp("part"), GCODE, "dynamics.reference_inertia=true")
    return cell, simulate(cell)


@pytest.mark.parametrize(("method", "tolerance"), [*((m, 2 * UM) for m in ("linear", *SMOOTH)), ("inverse", 0.0)])
def test_the_written_program_leaves_what_the_plan_leaves(part, method, tolerance):
    """Points are written to 0.1 um; a step of the path by the tolerance makes an arm with little damping swing."""
    cell, original = part
    planned = compensated(cell, original, method)
    left = written_pass(cell.replace(krl=cell.krl.replace(tolerance=tolerance)), planned).scores.max_deviation
    assert left == pytest.approx(planned.scores.max_deviation, rel=0.02, abs=2 * tolerance + 0.12 * UM)
    if method in SMOOTH:  # the slopes of a smooth reference follow from its points
        run, target = planned.reference, path_of(cell).target
        np.testing.assert_array_equal(run.velocity, controller_motion(run, target).velocity)
        assert not run.velocity[block_ends(target)].any() and target.standing[1:-1].any()


def test_a_program_in_straight_lines_of_a_smooth_plan_is_a_finding(part):
    cell = part[0].replace(krl=part[0].krl.replace(tolerance=0.0))
    done = compensate(cell, "inverse", motions=("LIN",))
    (finding,) = [f for f in done.checked.findings if f.what == "written program"]
    assert finding.severity == "warning"
    assert finding.value == pytest.approx(1e6 * done.revised.scores.max_deviation)
    assert finding.value > 1.2 * finding.limit == pytest.approx(1.2e6 * done.planned.scores.max_deviation)
    assert not [f for f in compensate(cell, "inverse").checked.findings if f.what == "written program"]


@pytest.mark.parametrize(("motion", "law", "names"), [
    ("SPLINE", "jerk", ".*"), ("LIN", "jerk", "[^J]*"), ("SPLINE", "acceleration", "[^J]*"), ("SPLINE", "none", ""),
])  # fmt: skip
def test_the_programs_set_the_time_law_that_the_simulated_controller_has(part, tmp_path, motion, law, names):
    """The reader has the limits of ``timing`` and of the turning tool after BAS(#INITMOV,0), which resets them."""
    cell, original = part
    cell = cell.replace(krl=cell.krl.replace(time_law=law, turn_speed=np.radians(90.0)))
    files, text = write_programs(
        tmp_path, cell, path_of(cell).target, path_of(cell).target, method="m", date=DATE, motions=[motion]
    )
    timing = cell.timing
    values = {"$ACC.CP": timing.acceleration, "$JERK.CP": timing.jerk, "$VEL.ORI1": 90.0, "$VEL.ORI2": 90.0,
              "$ACC.ORI1": 200.0, "$ACC.ORI2": 200.0}  # fmt: skip
    expected = {name: values[name] for name in values if re.fullmatch(names, name)}
    folder = files[f"krl_{motion.lower()}"][0].parent
    robot = Robot(folder, "MILLING_CMP")
    assert {name: float(robot.state[name]) for name in values if name in robot.state} == pytest.approx(expected)
    assert all(f"{name}={value:.4f}" in text for name, value in expected.items())
    assert ("KSS 8.3 or later" in text) == ("$JERK.CP" in expected)
    if expected:
        assert robot.steps.index("BAS(#INITMOV,0)") < robot.steps.index(f"$ACC.CP={timing.acceleration:.4f}")


@pytest.mark.parametrize(("motion", "limit"), [("SPLINE", 1400), ("SPLINE", 120), ("LIN", 1400)])
def test_the_reader_has_the_points_and_stops_of_an_independent_reader(part, tmp_path, motion, limit):
    cell, original = part
    cell = cell.replace(krl=cell.krl.replace(line_limit=limit))
    run = compensated(cell, original, "spline").reference
    files, text = write_programs(
        tmp_path, cell, path_of(cell).target, run, method="spline", date="2030-01-01", motions=[motion]
    )
    folder = files[f"krl_{motion.lower()}"][0].parent
    main = f"{cell.krl.name}_CMP"
    (pose, stops, auxiliary), robot = read_krl(folder, main), Robot(folder, main)
    assert np.flatnonzero(auxiliary).tolist() == robot.auxiliary and bool(robot.auxiliary) == (motion == "LIN")
    assert [0, *(np.array(robot.rests) - 1)] == np.flatnonzero(stops).tolist()
    assert pose.position == pytest.approx(robot.column("XYZ") * 1e-3, abs=1e-12)
    assert (len(files[f"krl_{motion.lower()}"]) > 4) == (limit == 120)
    assert time_law(path_of(cell)) in text


def angle_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.sum(one * other, axis=1))


def from_circle(places: np.ndarray, a: np.ndarray, m: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances of places (n, 3) from the circle through three points: as far from all of them, in their plane."""
    axis = np.cross(m - a, b - a)
    centre = np.linalg.solve([m - a, b - a, axis], [(m - a) @ (m + a) / 2, (b - a) @ (b + a) / 2, axis @ a])
    above = (places - a) @ axis / np.linalg.norm(axis)
    around = np.sqrt(np.sum((places - centre) ** 2, axis=1) - above**2)
    return np.hypot(around - np.linalg.norm(a - centre), above)


@pytest.mark.parametrize("motion", ["SPLINE", "LIN"])
def test_points_are_few_and_the_path_through_them_is_the_planned_one(part, tmp_path, motion):
    """The path of the points is that of another library: from stop to stop a natural spline over the planned way."""
    cell, original = part
    program, target = cell.krl.replace(motion=motion), path_of(cell).target
    run = compensated(cell, original, "inverse").reference
    write_programs(tmp_path, cell, target, run, method="inverse", date=DATE, motions=(motion,))
    for kind, planned in (("ORG", target), ("CMP", run)):
        robot = Robot(next(tmp_path.glob("krl_*")), f"MILLING_{kind}")
        assert max(speed for _, speed in robot.points[1:]) < 1.01 * planned.feed(planned.time_ns).max()
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(planned.position, axis=0), axis=1))])
        knots, auxiliary = program_points(program, target, run)
        ends = [0, *(np.array(robot.rests) - 1)] if motion == "SPLINE" else np.flatnonzero(~auxiliary)
        for first, last in pairwise(ends):
            points, inner = slice(first, last + 1), np.arange(knots[first], knots[last] + 1)
            place = 1e-3 * robot.column("XYZ")[points]
            if auxiliary[first + 1]:
                gap = from_circle(planned.position[inner], *place)
            else:
                straight = last == first + 1
                spline = (make_interp_spline if straight else CubicSpline)(
                    way[knots[points]], place, *([1] if straight else [0, "natural"])
                )
                gap = np.linalg.norm(spline(way[inner]) - planned.position[inner], axis=1)
            assert gap.max() < program.tolerance + 0.1 * UM  # places are written to 0.1 um
    assert auxiliary.any() == (motion == "LIN")
    assert len(knots) < len(run) and len(point_numbers(program, target, target)) < 0.3 * len(target)
    apart = point_numbers(program.replace(point_spacing=1e-3, tolerance=0.0), target, run)
    for planned in (target, run):
        assert np.linalg.norm(np.diff(planned.position[apart], axis=0), axis=1).min() >= 1e-3
    coarse = np.diff(run.time_ns[point_numbers(program.replace(tolerance=1e-3), target, run)])
    assert coarse.min() >= 30_000_000 and len(coarse) < len(knots)


def test_check_counts_the_points_that_are_written_where_modules_end_in_the_cut(cell, tmp_path):
    short = cell.replace(krl=cell.krl.replace(line_limit=100, tolerance=3e-7))
    target = path_of(short).target
    run = swayed(target, 1e-3)
    write_programs(tmp_path, short, target, run, method="swayed", date=DATE, motions=("SPLINE",))
    written = Robot(next(tmp_path.glob("krl_*")), "MILLING_CMP").points
    assert len(list(tmp_path.glob("krl_*/MILLING_CMP_*.src"))) > 1
    assert check(short, run, "SPLINE").blocks.points == len(written)


def test_a_spline_keeps_its_tolerance_between_the_knots_too():
    """Knots 1.9 um beside a line in the order + + - -: the curve between two of a side is 1.9 * 5 / 4 um beside it."""
    across = np.resize([1.9e-6, 1.9e-6, -1.9e-6, -1.9e-6], 60)
    across[[0, 1, -2, -1]] = 0.0
    run = spline(np.arange(60) * 12_000_000, np.stack([1e-3 * np.arange(60), across, 0.0 * across], axis=1))
    knots = point_numbers(Program(tolerance=2e-6), run, run)
    x = np.arange(0.0, 59.1, 0.5)  # the way is that along the line
    curve = CubicSpline(knots, across[knots], bc_type="natural")(x)
    assert np.abs(run.sample((x * 12_000_000).astype(int))[:, 1] - curve).max() < 2e-6


@pytest.mark.parametrize("blend", [0.0, 1e-3, 3e-3, 1.0])
@pytest.mark.parametrize("stop", [False, True])
def test_lin_motions_are_blended_by_the_parabola_that_touches_both_lines(blend, stop):
    """A corner of 90 deg between legs of 4 and 10 mm, d at most half a leg: sqrt(y) + sqrt(10 - x) = sqrt(d)."""
    s = np.linspace(0.0, 14e-3, 1401)
    line = np.stack([np.minimum(s, 10e-3), np.maximum(s - 10e-3, 0.0), 0 * s], axis=1)
    knots = np.array([0, 1000, 1400])
    run = Trajectory(np.arange(1401) * 10**6, line, TOOL_DOWN)
    place = places_on_program(run, knots, line[knots], np.array([True, stop, True]), False, blend)
    d = 0.0 if stop else min(blend, 2e-3)
    rounded = np.abs(s - 10e-3) < d - 1e-9
    np.testing.assert_allclose(place[~rounded], line[~rounded], atol=1e-12)
    x, y, _ = place[rounded].T
    np.testing.assert_allclose(np.sqrt(y) + np.sqrt(10e-3 - x), np.sqrt(d), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(place[1000] - line[1000]), d * np.sqrt(2) / 4, atol=1e-12)


def bends(seed: int) -> tuple[Trajectory, Trajectory]:
    """Rows of arcs and lines in planes of space, one after the other with kinks, and a smooth correction."""
    random = np.random.default_rng(seed)
    place, rows = np.zeros(3), [np.zeros((1, 3))]
    for _ in range(12):
        across, along = Rotation.random(random_state=random).as_matrix()[:2]
        angle = np.linspace(0.0, random.uniform(0.1, 9.0), random.integers(3, 60))[1:, None]
        radius = random.uniform(1e-3, 50e-3)
        row = along * angle if random.random() < 0.3 else across * (1 - np.cos(angle)) + along * np.sin(angle)
        rows.append(place + radius * row)
        place = rows[-1][-1]
    path = np.concatenate(rows)
    target = Trajectory(np.arange(len(path)) * 12_000_000, path, TOOL_DOWN)
    return target, target.with_position(path + 30 * UM * np.sin(path / 7e-3 + [1.0, 2.0, 3.0]))


@pytest.mark.parametrize("seed", range(4))
def test_a_spline_that_ends_with_its_module_keeps_to_the_planned_path(tmp_path, seed):
    """A spline that continues behind the module would miss the knots before the end by up to 131 um."""
    target, run = bends(seed)
    program = Program(motion="SPLINE", tolerance=5 * UM, line_limit=110)
    _, knots, _ = write(tmp_path, program, target, run)
    robot = Robot(tmp_path, "MILLING_CMP")
    place, step = 1e-3 * robot.column("XYZ"), np.linalg.norm(np.diff(run.position, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(step))
    assert len(robot.rests) > 1 + np.count_nonzero(target.standing[1:])
    for first, last in pairwise([0, *(np.array(robot.rests) - 1)]):
        inner = np.arange(knots[first], knots[last] + 1)
        joined = CubicSpline(way[knots[first : last + 1]], place[first : last + 1], 0, "natural")
        gap = np.linalg.norm(joined(way[inner]) - run.position[inner], axis=1)
        assert gap.max() < program.tolerance + 0.1 * UM


@pytest.mark.parametrize("seed", range(20 if LONG else 6))
def test_arcs_replace_points_and_the_reader_of_foreign_krl_finds_all_knots_on_them(tmp_path, seed):
    """An arc turns by 5 to 180 deg; the reader has chords of 2 um. A tool that turns, or SPLINE, has no arcs."""
    target, run = bends(seed)
    program = Program(motion="LIN", tolerance=5 * UM)
    files, knots, _ = write(tmp_path, program, target, run)
    robot = Robot(tmp_path, "MILLING_CMP")
    assert_recovered(robot, run, knots)
    path = read_krl_program(tmp_path / "MILLING_CMP.src", "", 0.05).position
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    dense = make_interp_spline(way, path, 1)(np.arange(0.0, way[-1], 2 * UM))
    assert cKDTree(dense).query(run.position)[0].max() < program.tolerance + 2 * UM + 1 * UM  # half a step of dense
    middle = np.array(robot.auxiliary)
    a, m, b = (1e-3 * robot.column("XYZ")[middle + k] for k in (-1, 0, 1))
    turn = 2 * np.pi - 2 * angle_between(a - m, b - m)  # inscribed angle
    assert len(middle) > 2 and np.degrees(turn).min() > 5 - 0.1 and np.degrees(turn).max() < 180 + 0.1
    assert len(knots) < len(point_numbers(program, target, run))
    leaning = Trajectory(run.time_ns, run.position, Rotation.from_rotvec(np.array(run.position)).as_quat())
    for other, last in (
        (program.replace(motion="SPLINE"), run),
        (program.replace(tolerance=0.0), run),
        (program, leaning),
    ):
        assert not program_points(other, target, last)[1].any()


@pytest.mark.parametrize("kink", [0.0, 0.3, -1.2])
def test_two_arcs_are_blended_from_tangent_to_tangent_and_stay_arcs_elsewhere(kink):
    """Arcs of radius 10 and 5 mm, turned by 2 and -1 rad; the blending misses their corner by d |e_k - e_(k-1)| / 4."""
    s, d = np.linspace(0.0, 1.0, 20_001)[:, None], 1e-3
    turned = np.concatenate([2.0 * s[:-1], 2.0 + kink - s])
    step = np.diff(np.concatenate([20e-3 * s[:-1], 20e-3 + 5e-3 * s]), axis=0)
    step = step * np.hstack([np.cos(turned), np.sin(turned), 0 * turned])[:-1]
    arcs = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    run = Trajectory(np.arange(len(arcs)), arcs, TOOL_DOWN)
    knots = np.array([0, 10_000, 20_000, 29_000, 40_000])
    stops, auxiliary = np.isin(knots, [0, 40_000]), np.isin(knots, [10_000, 29_000])
    place = places_on_program(run, knots, arcs[knots], stops, False, d, auxiliary)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(step, axis=1))])
    rounded = np.abs(way - way[20_000]) < d
    np.testing.assert_allclose(place[~rounded], arcs[~rounded], atol=0.2 * UM)  # ``step`` has chords of 1 um
    miss = np.linalg.norm(place[20_000] - arcs[20_000])
    np.testing.assert_allclose(miss, d * np.sin(abs(kink) / 2) / 2, atol=0.2 * UM)
    direction = np.diff(place, axis=0)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    assert np.linalg.norm(np.diff(direction, axis=0), axis=1).max() < 3e-3


def test_a_program_of_lin_motions_is_judged_by_its_blended_path(part):
    cell, original = part
    program = cell.krl.replace(motion="LIN", tolerance=50e-6, blend_distance=2e-3)
    target = path_of(cell).target
    exact, blended = (
        written_trajectory(cell.replace(krl=program.replace(blend_distance=d)), target, "LIN") for d in (0.0, 2e-3)
    )
    knots, auxiliary = program_points(program, target, target)
    stops, blend = target.standing[knots], program.blend_distance
    expected = places_on_program(target, knots, target.position[knots], stops, False, blend, auxiliary)
    np.testing.assert_allclose(blended.sample(target.time_ns), expected, atol=1e-7)
    assert np.linalg.norm(blended.position - exact.position, axis=1).max() > 5e-6


def test_the_pass_of_a_program_with_arcs_is_that_of_arcs_and_not_of_the_chords_between_its_knots(part):
    """The arc of 8 mm of the part, whose knots are 0.8 mm apart: chords of 10 um."""
    cell, _ = part
    program, target = cell.krl.replace(motion="LIN", blend_distance=0.0), path_of(cell).target
    from_centre = np.linalg.norm(target.position[:, :2] - [20e-3, 10e-3], axis=1)
    (first, *_, last) = target.time_ns[np.abs(from_centre - 8e-3) < 1e-6].tolist()
    place = written_trajectory(cell.replace(krl=program), target, "LIN").sample(np.arange(first, last, 10**6))
    error = np.abs(np.linalg.norm(place[:, :2] - [20e-3, 10e-3], axis=1) - 8e-3).max()
    assert error < 1.25 * program.tolerance + 0.1 * UM


def test_a_straight_cut_stops_where_a_module_ends_and_has_no_second_time_law():
    cell = read_cell(find_file("paper.yaml"), ["timing.controller_step_ms=12"])
    run = controller_motion(path_of(cell).target, path_of(cell).target)
    short, long = (cell.replace(krl=cell.krl.replace(line_limit=n, tolerance=0.0)) for n in (100, 1400))
    assert not run.standing.any() and written_trajectory(short, run, "SPLINE").standing[1:-1].any()
    assert not written_trajectory(long, run, "SPLINE").standing.any()
    assert softer_pass(cell, run) is None


def test_a_controller_with_less_acceleration_reaches_the_same_points_later(part):
    cell, original = part
    run = compensated(cell, original, "inverse").reference
    same, softer = softer_pass(cell, run, 1.0), softer_pass(cell, run)
    assert same.reference.position == pytest.approx(run.position, abs=1e-12)
    np.testing.assert_allclose(same.reference.time_ns, run.time_ns, atol=1000)  # the ends of the ramps are interpolated
    assert softer.reference.duration_ns > run.duration_ns
    assert softer.scores.max_deviation > same.scores.max_deviation
