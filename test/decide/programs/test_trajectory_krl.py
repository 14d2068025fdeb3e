"""Robot programs: a reader of its own parses them back; names, limits and headers are what a KR C4 takes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from krl_robot import NUMBER, Robot
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.cell.sections import Program
from kr270_milling.decide.programs.krl import Approach, Heading, Setup, trajectory_hash, write_krl
from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.timing import Timing, time_path
from kr270_milling.path.trajectory import Trajectory, TrajectoryError


def setup(*runs: Trajectory) -> Setup:
    mount = Pose.from_abc([0.0, 0.0, 0.25], np.radians([0.0, 90.0, 0.0]))
    base = Pose.from_abc([1.0, -1.6, 0.3], np.radians([30.0, 1.0, -2.0]))
    approaches = tuple(Approach(np.array([*run.position[0, :2], 0.05]), 2, 35) for run in runs)
    return Setup(mount, base, approaches, 0.05, 12.0, (0.0, 0.01, 0.1))


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


def write(directory, program: Program, original, revised, **more) -> list[Path]:
    return write_krl(
        directory, program, setup(original, revised), original, revised, Heading("1.2.3", "2025-06-01", **more)
    )


def assert_recovered(robot: Robot, run: Trajectory) -> None:
    """To 1 um and 0.001 deg at each point."""
    k = robot.numbers - 1
    assert np.abs(robot.column("XYZ") * 1e-3 - run.position[k]).max() < 1e-6
    turned = Rotation.from_euler("ZYX", robot.column("ABC"), degrees=True)
    assert np.degrees((turned.inv() * Rotation.from_quat(run.quaternion[k])).magnitude()).max() < 1e-3


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
@pytest.mark.parametrize("limit", [1400, 120])
def test_both_programs_are_parsed_back_across_all_their_modules(tmp_path, motion, limit):
    pair = swaying(500)
    files = write(tmp_path, Program(name="PART", motion=motion, line_limit=limit), *pair)
    assert sorted(files) == sorted(tmp_path.iterdir()) and (len(files) == 4) == (limit == 1400)
    robots = [Robot(tmp_path, main) for main in ("PART_ORG", "PART_CMP")]
    for robot, run in zip(robots, pair, strict=True):
        assert robot.numbers.tolist() == list(range(1, 501))
        assert_recovered(robot, run)
        if motion == "LIN":
            speed = np.linalg.norm(np.diff(run.position, axis=0), axis=1) / np.diff(run.time)
            written = [speed for _, _, speed in robot.points[1:]]
            np.testing.assert_allclose(written, speed, atol=0.5e-3 + 1e-9)  # rounded to 1 mm/s
    assert robots[0].rests == robots[1].rests


def test_a_tool_that_lies_level_is_recovered_although_its_angles_are_singular(tmp_path):
    original, _ = swaying(40)
    lean = np.concatenate([np.linspace(-1e-3, 1e-3, 39), [0.0]])
    level = Rotation.from_euler("ZYX", np.stack([np.full(40, 0.4), np.pi / 2 + lean, np.full(40, -0.7)], 1))
    run = Trajectory(original.time_ns, original.position, level.as_quat())
    write(tmp_path, Program(), run, run)
    assert_recovered(Robot(tmp_path, "MILLING_CMP"), run)


def test_speeds_are_rounded_to_a_millimetre_a_second_and_never_zero(tmp_path):
    for feed in (4 / 60, 1e-5):
        line = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 20 * feed * 0.05, feed, 0.05)
        for motion in ("LIN", "SPLINE"):
            write(tmp_path, Program(motion=motion, point_spacing=1e-9), line, line)
            text = (tmp_path / "MILLING_ORG.src").read_text()
            assert f"$VEL.CP={max(feed, 1e-3):.3f}\n" in text + "\n" and "-0.0000" not in text


def test_the_speed_of_a_spline_segment_is_that_along_its_curve(tmp_path):
    angle = np.linspace(0, np.pi, 41)
    circle = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    time_ns = np.arange(41) * 50_000_000
    tangent = 0.05 * np.pi / 2 * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    write(tmp_path, Program(), *2 * [Trajectory(time_ns, circle, [1.0, 0, 0, 0], tangent)])
    speeds = [speed for _, _, speed in Robot(tmp_path, "MILLING_ORG").points[1:]]
    np.testing.assert_allclose(speeds, 0.05 * np.pi / 2, atol=0.5e-3)  # rounded to 1 mm/s


def milled(tmp_path, text: str) -> Trajectory:
    (tmp_path / "part.nc").write_text(text)
    return time_path(read_gcode(tmp_path / "part.nc"), Timing()).trajectory


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
def test_the_robot_stops_in_the_corners_and_nowhere_else(tmp_path, motion):
    run = milled(tmp_path, "G0 X0 Y0 Z0\nG1 X20 F4000\nG1 Y20\nG1 X0.3\nX0.3 Y20.004\nM30\n")
    (tmp_path / "out").mkdir()
    write(tmp_path / "out", Program(motion=motion), run, run)
    robot = Robot(tmp_path / "out", "MILLING_ORG")
    rests = run.position[np.array(robot.rests) - 1] * 1e3
    np.testing.assert_allclose(rests[:2], [[20, 0, 0], [20, 20, 0]], atol=1e-6)
    np.testing.assert_allclose(rests[-1], [0.3, 20.004, 0], atol=1e-6)
    assert len(rests) <= 4 and np.linalg.norm(np.diff(robot.column("XYZ"), axis=0), axis=1).min() > 1e-3


def test_points_closer_than_the_spacing_are_left_out_of_both_and_their_time_is_kept(tmp_path):
    run = milled(tmp_path, "G0 X0 Y0 Z0\nG1 X20 F4000\nM30\n")
    (tmp_path / "out").mkdir()
    program = Program(motion="LIN", point_spacing=1e-3)
    write(tmp_path / "out", program, run, run.with_position(run.position + [0, 1e-4, 0], run.velocity))
    robots = [Robot(tmp_path / "out", f"MILLING_{kind}") for kind in ("ORG", "CMP")]
    assert np.linalg.norm(np.diff(robots[0].column("XYZ"), axis=0), axis=1).min() > 1 - 1e-6
    assert 2 < len(robots[0].numbers) < len(run) and robots[0].numbers.tolist() == robots[1].numbers.tolist()
    assert robots[0].time[-1] == pytest.approx(run.time[-1], rel=0.02)  # speeds are rounded to 1 mm/s


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
def test_no_module_exceeds_the_line_limit(tmp_path, motion):
    files = write(tmp_path, Program(motion=motion, line_limit=100), *swaying(1000))
    assert max(len(path.read_text().splitlines()) for path in files) <= 100


def test_more_modules_than_a_main_module_can_call_are_refused(tmp_path):
    with pytest.raises(TrajectoryError, match="raise program.line_limit"):
        write(tmp_path, Program(motion="LIN", line_limit=100), *swaying(4000))
    assert not list(tmp_path.rglob("*.src"))


def test_modules_end_at_a_stop_where_one_is_near(tmp_path):
    run = milled(tmp_path, "G0 X0 Y0 Z0\n" + "G1 X30 F4000\nX0\n" * 20 + "M30\n")
    (tmp_path / "out").mkdir()
    files = write(tmp_path / "out", Program(motion="LIN", line_limit=120), run, run)
    stops = np.flatnonzero(np.linalg.norm(run.velocity, axis=1) == 0) + 1
    assert len(files) > 8 and set(Robot(tmp_path / "out", "MILLING_ORG").rests) <= set(stops)


def test_names_are_krl_names(tmp_path):
    files = write(tmp_path, Program(name="A234567890123456", line_limit=100), *swaying(200))
    assert max(len(path.stem) for path in files) <= 24
    for name in ("", "1PART", "part", "PART-1", "A2345678901234567", "../X", "PART\n"):
        with pytest.raises(ParameterError):
            Program(name=name)


def test_the_head_tells_what_the_program_is_and_where_it_comes_from(tmp_path):
    pair = swaying(20)
    write(tmp_path, Program(), *pair, source_hash="abc")
    for kind, run, word in (("ORG", pair[0], "original"), ("CMP", pair[1], "compensated")):
        for suffix in ("src", "dat"):
            text = (tmp_path / f"MILLING_{kind}.{suffix}").read_text()
            for piece in (trajectory_hash(run), "abc", "2025-06-01", "1.2.3", word, "SIMULATION RESULT", "T1"):
                assert piece in text
        text = (tmp_path / f"MILLING_{kind}.src").read_text()
        assert "$TOOL={X 0.0000,Y 0.0000,Z 250.0000,A 0.00000,B 90.00000,C 0.00000}" in text
        assert "$BASE={X 1000.0000,Y -1600.0000,Z 300.0000,A 30.00000,B 1.00000,C -2.00000}" in text
        assert "$LOAD={M 12.000,CM {X 0.000,Y 10.000,Z 100.000," in text
        assert ",S 2,T 35," in (tmp_path / f"MILLING_{kind}.dat").read_text()


def test_the_same_input_gives_the_same_files_and_any_change_another_hash(tmp_path):
    pair = swaying(20)
    first = {path: path.read_bytes() for path in write(tmp_path, Program(), *pair)}
    assert first == {path: path.read_bytes() for path in write(tmp_path, Program(), *pair)}
    moved = pair[0].with_position(pair[0].position + [1e-12, 0, 0])
    assert trajectory_hash(moved) != trajectory_hash(pair[0])


def test_a_text_that_would_break_the_head_is_refused(tmp_path):
    for text in ("1.0\nEND", "\u00e4", "x" * 101):
        with pytest.raises(TrajectoryError):
            write(tmp_path, Program(), *swaying(20), source_hash=text)
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_when_the_directory_is_not_there_or_the_pair_does_not_fit(tmp_path):
    with pytest.raises(InputError):
        write(tmp_path / "none", Program(), *swaying(20))
    with pytest.raises(TrajectoryError):
        write(tmp_path, Program(), swaying(20)[0], swaying(21)[1])
    assert not list(tmp_path.iterdir())


# --- What a program does before and behind the path: home, safe height, spindle, coolant, tool and base ---


#: a cell's own commands, run up, home declared, tool and base of the controller's tables
OWN = Program(
    spindle_on=("$OUT[1]=TRUE",), spindle_off=("$OUT[1]=FALSE",), coolant_on=("$OUT[2]=TRUE",),
    coolant_off=("$OUT[2]=FALSE",), spindle_run_up=4.0, home_angles=np.radians([0, -90, 90, 0, 0, 0]), set_load=True,
)  # fmt: skip


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
@pytest.mark.parametrize("limit", [1400, 130])
def test_the_program_starts_and_ends_at_home_with_the_spindle_on_in_between(tmp_path, motion, limit):
    write(tmp_path, OWN.replace(motion=motion, line_limit=limit), *swaying(200))
    steps = [line for line in Robot(tmp_path, "MILLING_CMP").steps if not line.startswith((";", "&"))]
    moves = [line for line in steps if line.startswith(("PTP", "LIN", "SPL "))]
    assert moves[:3] == ["PTP XHOME", "PTP XAPPROACH", "LIN XP1"] and moves[-2:] == ["LIN XRETRACT", "PTP XHOME"]
    order = [steps.index(line) for line in ("PTP XHOME", "$OUT[1]=TRUE", "WAIT SEC 4.0", "$OUT[2]=TRUE",
                                            "PTP XAPPROACH", "LIN XP1", "LIN XRETRACT", "$OUT[1]=FALSE")]  # fmt: skip
    assert order == sorted(order) and steps.index("$OUT[2]=FALSE") > steps.index("LIN XRETRACT")
    assert "$LOAD={M 12.000" in (tmp_path / "MILLING_CMP.src").read_text()


def test_approach_and_retract_are_at_the_safe_height_above_first_and_last_point(tmp_path):
    pair = swaying(20)
    write(tmp_path, OWN, *pair)
    text = (tmp_path / "MILLING_CMP.dat").read_text()
    for name, k in (("XAPPROACH", 0), ("XRETRACT", -1)):
        place = re.search(rf"{name}={{X ({NUMBER}),Y ({NUMBER}),Z ({NUMBER})", text).groups()
        expected = [*pair[1].position[k, :2] * 1e3, 50.0]
        assert [float(v) for v in place] == pytest.approx(expected, abs=1e-4)
    assert "DECL E6AXIS XHOME={A1 0.0000,A2 -90.0000,A3 90.0000,A4 0.0000,A5 0.0000,A6 0.0000," in text


def test_tool_and_base_of_the_controllers_tables(tmp_path):
    write(tmp_path, Program(tool_number=3, base_number=12), *swaying(20))
    text = (tmp_path / "MILLING_ORG.src").read_text()
    assert "$TOOL=TOOL_DATA[3]\n" in text and "; TOOL_DATA[3] must be {X 0.0000,Y 0.0000,Z 250.0000" in text
    assert "$BASE=BASE_DATA[12]\n" in text


@pytest.mark.parametrize("wrong", [dict(spindle_on=("A\nB",)), dict(home="x"), dict(home_angles=[1.0]),
                                   dict(coolant_off=("\u00e4",))])  # fmt: skip
def test_what_no_controller_reads_is_refused(wrong):
    with pytest.raises(ParameterError):
        Program(**wrong)
