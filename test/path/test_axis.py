"""Tool paths with an axis: the orientation of an axis, tilted planes of three controls, turns in place."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.path.cam.readers import read_toolpath
from kr270_milling.path.kinematics import NO_ROTARY_AXES, Kinematics
from kr270_milling.path.timing import Timing, time_path
from kr270_milling.path.toolpath import LEVER, Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN, tool_along, turned


@pytest.fixture
def read(tmp_path):
    def read(text: str, suffix: str = ".nc") -> Toolpath:
        (tmp_path / f"a{suffix}").write_text(text)
        return read_toolpath(tmp_path / f"a{suffix}")

    return read


def axes(path: Toolpath) -> np.ndarray:
    return -rotation_from_quaternion(path.quaternion)[:, :, 2]


def cuts(path: Toolpath) -> np.ndarray:
    return 1e3 * path.position[~path.rapid]


def turn(axis: str, degrees: float) -> np.ndarray:
    """The matrix of a rotation about an axis, written out."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    if axis == "x":
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]] if axis == "y" else [[c, -s, 0], [s, c, 0], [0, 0, 1]])


# --- The turn about the axis ---


def test_the_orientation_is_a_smooth_function_of_the_axis_alone_and_leaves_no_turn_after_a_circle():
    assert tool_along((0, 0, 1)) == TOOL_DOWN
    around = np.radians(np.linspace(0, 360, 721))
    for tilt in np.radians([1e-6, 10, 45, 90, 120]):
        rows = [(math.sin(tilt) * math.cos(a), math.sin(tilt) * math.sin(a), math.cos(tilt)) for a in around]
        quaternion = np.array([tool_along(row) for row in rows])
        np.testing.assert_allclose(-rotation_from_quaternion(quaternion)[:, :, 2], rows, atol=1e-12)
        # a step of the azimuth by d turns the frame by 2 sin(tilt / 2) d (derivative of the shortest rotation)
        step = turned(quaternion[:-1], quaternion[1:])
        np.testing.assert_allclose(step, 2 * math.sin(tilt / 2) * around[1], rtol=1e-4)
        assert turned(quaternion[0], quaternion[-1]) < 1e-12


@pytest.mark.parametrize(
    ("axis", "words"), [("0,0,0", "length 0 "), ("0,0,2", "length 2 "), ("0,0,-1", "from below"), ("nan,0,1", "")]
)
def test_an_axis_that_is_none_is_refused_in_one_sentence(read, axis, words):
    for text, suffix in (
        (f"FEDRAT/600\nGOTO/0,0,0\nGOTO/1,0,0,{axis}\nFINI\n", ".apt"),
        (f"x_mm,y_mm,z_mm,i,j,k,feed_mm_per_min\n0,0,0,0,0,1,9\n1,0,0,{axis},9\n", ".csv"),
    ):
        with pytest.raises(InputError, match=rf"line 3: .*{words}"):
            read(text, suffix)


def test_a_table_with_axes_and_an_apt_file_of_the_same_points_are_the_same_path(read):
    rows = [(k, 0.5 * k, 0, *np.round([0.6 * math.sin(k / 4), 0.6 * math.cos(k / 4), 0.8], 9)) for k in range(9)]
    table = "x_mm,y_mm,z_mm,i,j,k,feed_mm_per_min\n" + "".join(f"{','.join(map(str, row))},600\n" for row in rows)
    apt = "FEDRAT/600\nMULTAX/ON\n" + "".join(f"GOTO/{','.join(map(str, row))}\n" for row in rows) + "FINI\n"
    first, second = read(table, ".csv"), read(apt, ".apt")
    np.testing.assert_array_equal(first.quaternion, second.quaternion)
    np.testing.assert_allclose(axes(first), [row[3:] for row in rows], atol=1e-8)
    stated = read("FEDRAT/600\nTLAXIS/0.6,0,0.8\nGOTO/0,0,0\nGOTO/1,0,0\nFINI\n", ".apt")
    np.testing.assert_allclose(axes(stated), [[0.6, 0, 0.8]] * 2)


def test_circles_and_holes_of_apt_lie_in_the_plane_of_their_axis(read):
    head = "FEDRAT/600\nTLAXIS/0.6,0,0.8\nGOTO/0,5,0\n"
    arc = read(head + "CIRCLE/0,0,0,0.6,0,0.8,5\nGOTO/-4,0,3\nFINI\n", ".apt")
    np.testing.assert_allclose(np.linalg.norm(cuts(arc), axis=1), 5.0, atol=1e-9)
    np.testing.assert_allclose(cuts(arc) @ [0.6, 0, 0.8], 0.0, atol=1e-9)
    assert arc.length == pytest.approx(5e-3 * math.pi / 2, rel=1e-3)  # counterclockwise about the axis, y to -x
    back = read(head + "CIRCLE/0,0,0,-0.6,0,-0.8,5\nGOTO/-4,0,3\nFINI\n", ".apt")
    assert back.length == pytest.approx(5e-3 * math.pi * 1.5, rel=1e-3)
    hole = read(head + "CYCLE/DRILL,3,100,MMPM,2\nGOTO/10,0,1\nCYCLE/OFF\nFINI\n", ".apt")
    np.testing.assert_allclose(cuts(hole), [[10 - 1.8, 0, 1 - 2.4]], atol=1e-9)
    np.testing.assert_allclose(1e3 * hole.position[-1], [10 + 1.2, 0, 1 + 1.6])
    turning = "CIRCLE/0,0,0,0.6,0,0.8,5\nGOTO/-4,0,3,0,0,1\n"
    for wrong, words in (("CIRCLE/0,0,0,0.6,0,0.9,5\n", "the length"), (turning, "axis changes")):
        with pytest.raises(InputError, match=words):
            read(head + wrong + "FINI\n", ".apt")


def test_a_tool_turns_in_place_at_the_feed_of_its_holder_and_rests_before_and_after(read):
    head = "x_mm,y_mm,z_mm,i,j,k,feed_mm_per_min\n"
    rows = ("0,0,0,0,0,1", "20,0,0,0,0,1", "20,0,0,0.6,0,0.8", "40,0,0,0.6,0,0.8")
    path, angle = read(head + "".join(f"{row},600\n" for row in rows), ".csv"), math.atan2(0.6, 0.8)
    np.testing.assert_allclose(path.block_length, [0, 0.02, LEVER * angle, 0.02])
    timed = time_path(path, Timing(controller_step=0.01))
    run = timed.trajectory
    turning = turned(run.quaternion[:-1], run.quaternion[1:]) > 1e-9
    assert np.ptp(run.position[:-1][turning], axis=0).max() < 1e-12 and not run.velocity[1:][turning].any()
    assert turning.sum() * 0.01 == pytest.approx(LEVER * angle / 0.01, rel=0.1)  # 10 mm/s, and two ramps
    assert run.standing.sum() == 4 and np.isfinite(run.velocity).all()


# --- Tilted planes ---
UPRIGHT = """G0 X0 Y0 Z5
G1 Z-1 F600
G1 X10 Y2
G3 X4 Y8 I-6 J0
G18 G2 X0 Z-1 I-2 K0
G17 G0 Z5
G81 X3 Y4 Z-3 R1 F90
G80
G0 Z9
"""
CONVERSED = """L X+0 Y+0 Z+5 FMAX M3
L Z-1 F600
L X+10 Y+2
CR X+4 Y+8 R+6 DR+
CC X+4 Y+4
C X+4 Y+0 DR-
L Z+5 FMAX
CYCL DEF 200 Q200=+1 Q201=-3 Q206=+90 Q202=+9 Q203=+0 Q204=+5
L X+3 Y+4 FMAX M99
L Z+9 FMAX
"""


def planes(seed: int):
    """Programs of a random plane, upright and tilted, with suffix, matrix and origin [mm] of the plane."""
    of = random.Random(seed)
    a, b, c = (round(of.uniform(-80, 80), 3) for _ in range(3))
    x, y, z = (round(of.uniform(-50, 50), 3) for _ in range(3))
    origin = np.array([x, y, z])
    euler = turn("z", a) @ turn("x", b) @ turn("z", c)
    spatial = turn("z", c) @ turn("y", b) @ turn("x", a)
    swivel = turn("x", a) @ turn("y", b) @ turn("z", c)
    other = turn("z", a) @ turn("y", b) @ turn("x", c)
    head = "G21 G90 S9000 M3\n"
    flat = f"{head}{UPRIGHT}M30\n"
    yield f"{head}G68.2 X{x} Y{y} Z{z} I{a} J{b} K{c}\nG53.1\n{UPRIGHT}G69\nM30\n", flat, ".nc", euler, origin
    for mode, turned_by, late in ((57, swivel, 0), (27, other, 3)):
        cycle = f'CYCLE800(0,"TC1",100,{mode},{x},{y},{z},{a},{b},{c},{late},0,0,-1,,1)\n'
        place = origin + turned_by[:, 0] * late
        yield f"{head}{cycle}{UPRIGHT}CYCLE800()\nM30\n", flat, ".mpf", turned_by, place
    shift = f"CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X{x:+}\nCYCL DEF 7.2 Y{y:+}\nCYCL DEF 7.3 Z{z:+}\n"
    statements = f"SPATIAL SPA{a:+} SPB{b:+} SPC{c:+}", f"EULER EULPR{a:+} EULNU{b:+} EULROT{c:+}"
    for plane, turned_by in zip(statements, (spatial, euler), strict=True):
        begin, end = "BEGIN PGM A MM\nTOOL CALL 1 Z S9000\n", "M30\nEND PGM A MM\n"
        tilted = f"{begin}{shift}PLANE {plane} TURN MB MAX FMAX SEQ-\n{CONVERSED}PLANE RESET STAY\n{end}"
        yield tilted, begin + CONVERSED + end, ".h", turned_by, origin


@pytest.mark.parametrize("seed", range(12))
def test_a_program_in_a_tilted_plane_is_the_upright_one_moved_by_the_matrices_of_the_manuals(read, seed):
    for tilted, upright, suffix, matrix, origin in planes(seed):
        moved, flat = read(tilted, suffix), read(upright, suffix)
        np.testing.assert_allclose(1e3 * moved.position, 1e3 * flat.position @ matrix.T + origin, atol=1e-7)
        np.testing.assert_allclose(axes(moved), np.tile(matrix[:, 2], (len(moved), 1)), atol=1e-9)
        np.testing.assert_array_equal(moved.rapid, flat.rapid)
        np.testing.assert_allclose(moved.feed, flat.feed)


def test_the_example_of_the_manual_has_the_same_plane_in_both_sequences(read):
    """TNC 620 User's Manual 10/2017: SPA+45 SPB+0 SPC+90 is C+90, then A+45 about the tilted axes."""
    plane = "PLANE SPATIAL SPA+45 SPB+0 SPC+90 STAY\nL A+Q120 B+Q121 C+Q122 FMAX\n"
    body = "L X+0 Y+0 Z+1 FMAX M3\nL Z+0 F600\nL X+1\nL Y+1\n"
    path = read(f"BEGIN PGM A MM\nTOOL CALL 1 Z S9000\n{plane}{body}END PGM A MM\n", ".h")
    half = math.sqrt(0.5)
    np.testing.assert_allclose(cuts(path)[-2:], [[0, 1, 0], [-half, 1, half]], atol=1e-12)
    np.testing.assert_allclose(axes(path)[-1], [half, 0, half], atol=1e-12)


SIDE = "G90 G21 S9000 M3\nG0 X0 Y0 Z50\nZ5\nG1 Z-1 F600\nX20\nG0 Z50\n"


def test_a_tilted_tool_leaves_along_its_axis_and_turns_at_the_top(read):
    plane = "G68.2 X60 Y0 Z-20 I90 J90 K0\nG53.1\nG0 X5 Y0\nZ10\nG1 Z-2 F600\nX8\nG53 G0 Z0\nG69\n"
    plane += "G0 A0 C0\nG0 X0 Y30\nZ5\nG1 Z-1\nX9\n"
    path = read(SIDE + "G53 G0 Z0\n" + plane + "M30\n")
    direction = np.array([1, 0, 0])  # z of the plane: Rz(90) Rx(90) z
    side = np.flatnonzero(axes(path) @ direction > 0.99)
    moves = np.diff(1e3 * path.position[side[0] - 1 : side[-1] + 1], axis=0)
    cutting = np.flatnonzero(~path.rapid[side])
    leave = moves[cutting[-1] + 1]
    assert leave @ direction > 0 and np.linalg.norm(np.cross(leave, direction)) < 1e-9  # out of the part before up
    assert path.position[side[cutting[-1] + 1], 0] >= path.position[~path.rapid, 0].max() + LEVER - 1e-9
    turning = turned(path.quaternion[:-1], path.quaternion[1:]) > 1e-9
    assert np.allclose(path.position[1:][turning, 2], path.position[:, 2].max())


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("G68.2 J30\nG1 X5", "the tool is not along z"),
        ("G68.2 J30\nG53.1\nG0 Z9\nG69\nG1 X5", "the tool is not along z"),
        ("G68.2 J30\nG53.1\nG68.2 J40", "without G69"),
        ("G68.2 P1 I30\nG53.1", "takes an origin"),
        ("G68.2 J180\nG53.1", "from below"),
        ("G53.1", "G53.1 without G68.2"),
        ("G68.2 J30\nG53.1\nG52 X5", "while a plane is tilted"),
        ('CYCLE800(0,"TC1",0,192,0,0,0,30,0,0,0,0,0,-1)', "axis by axis"),
    ],
)
def test_a_plane_that_cannot_be_run_is_refused(read, lines, words):
    with pytest.raises(InputError, match=words):
        read(f"{SIDE}{lines}\nM30\n")


# --- Rotary axes of a machine ---
TABLES = Kinematics(kinematics="table_table", axes=("C", "A"), centre=np.array([10, 20, -50]) * 1e-3)
MIXED = Kinematics(kinematics="head_table", axes=("C", "B"), centre=np.array([10, 20, -50]) * 1e-3, pivot=0.2)
HEADS = Kinematics(kinematics="head_head", axes=("C", "B"), pivot=0.2)
NUTATING = Kinematics(kinematics="head_table", axes=("C", "B"), second_direction=np.array([0, 1, 1]) / math.sqrt(2))


def about(line: np.ndarray, place: np.ndarray, degrees: float) -> np.ndarray:
    """The matrix (4, 4) of a rotation about a line through a place, by Rodrigues' formula."""
    k, t = np.array([[0, -line[2], line[1]], [line[2], 0, -line[0]], [-line[1], line[0], 0]]), math.radians(degrees)
    out = np.eye(4)
    out[:3, :3] += math.sin(t) * k + (1 - math.cos(t)) * k @ k
    out[:3, 3] = place - out[:3, :3] @ place
    return out


def machine_tip(machine: Kinematics, linear: np.ndarray, first: float, second: float) -> np.ndarray:
    """The tip on the workpiece [mm], by moving the bodies of the machine: table or head, each about its line."""
    lines = {"A": np.array([1.0, 0, 0]), "B": np.array([0, 1.0, 0]), "C": np.array([0, 0, 1.0])}
    one, two = (lines[letter] for letter in machine.axes)
    centre, pivot = 1e3 * machine.centre, linear + [0, 0, 1e3 * machine.pivot]
    tip = np.append(linear, 1.0)
    if machine.kinematics == "head_head":  # the outer axis carries the inner one
        return (about(one, pivot, first) @ about(two, pivot, second) @ tip)[:3]
    if machine.kinematics == "head_table":
        return np.linalg.solve(about(one, centre, -first), about(two, pivot, second) @ tip)[:3]
    return np.linalg.solve(about(two, centre, -second) @ about(one, centre, -first), tip)[:3]


@pytest.mark.parametrize("machine", [TABLES, MIXED, HEADS], ids=lambda machine: machine.kinematics)
def test_places_are_those_of_the_bodies_of_the_machine_or_of_the_tip_that_the_control_follows(tmp_path, machine):
    one, two = machine.axes
    of, lines = random.Random(7), {"A": "x", "B": "y", "C": "z"}
    rows = np.array([[round(of.uniform(-30, 30), 3) for _ in range(5)] for _ in range(20)])
    expected = [turn(lines[one], a) @ turn(lines[two], b)[:, 2] for *_, a, b in rows]
    blocks = [f"X{x} Y{y} Z{z} {one}{a} {two}{b}\n" for x, y, z, a, b in rows]
    for on, off in (("", ""), ("G43.4 H1", "G49"), ("TRAORI", "TRAFOOF"), ("M128", "M129")):
        text = f"G90 G21 S9000 M3 F600\n{on}\nG0 {blocks[0]}G1 {''.join(blocks[1:])}{off}\nM30\n"
        (tmp_path / "a.mpf").write_text(text)
        path = read_toolpath(tmp_path / "a.mpf", machine=machine)
        ends = np.append(np.flatnonzero(np.diff(path.line)), len(path) - 1)
        places = rows[:, :3] if on else [machine_tip(machine, row[:3], *row[3:]) for row in rows]
        np.testing.assert_allclose(1e3 * path.position[ends], places, atol=1e-9)
        np.testing.assert_allclose(axes(path)[ends], expected, atol=1e-9)
        if on:
            np.testing.assert_allclose(path.feed[1:], 0.01)
        else:  # F is that of the linear axes
            time = np.bincount(path.line, path.block_length / np.maximum(path.feed, 1e-9))[path.line[ends][1:]]
            np.testing.assert_allclose(time, np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1) / 10, rtol=1e-6)


@pytest.fixture
def read_machine(tmp_path):
    def read(text: str, machine: Kinematics = TABLES, suffix: str = ".nc") -> Toolpath:
        head = "BEGIN PGM A MM\nTOOL CALL 1 Z S9000\n" if suffix == ".h" else "G90 G21 S9000 M3\n"
        (tmp_path / f"a{suffix}").write_text(f"{head}{text}M30\n" + "END PGM A MM\n" * (suffix == ".h"))
        return read_toolpath(tmp_path / f"a{suffix}", machine=machine)

    return read


def test_an_axis_that_is_at_its_place_already_turns_nothing(read_machine):
    path = read_machine("G0 X0 Y0 Z0 A0\nG1 A0 F100\nG28 A0 C0\nX9\n")
    assert 1e3 * path.position[-1] == pytest.approx([9, 0, 0])


def test_the_axis_between_two_points_is_that_of_the_turning_axes_and_conversational_programs_agree(read_machine):
    path = read_machine("G43.4 H1\nG0 X0 Y0 Z0 C10 A20\nG1 X40 C70 A-15 F600\nG49\n")
    run = time_path(path, Timing(controller_step=0.01)).trajectory
    share = run.position[:, 0] / 0.04
    exact = np.array([turn("z", 10 + 60 * s) @ turn("x", 20 - 35 * s)[:, 2] for s in share])
    shown = -rotation_from_quaternion(run.quaternion)[:, :, 2]
    assert np.degrees(np.linalg.norm(shown - exact, axis=1)).max() < 0.01
    text = "L X+0 Y+0 Z+0 C+10 A+20 FMAX M3 M128\nL X+40 C+70 IA-35 F600\nM129\n"
    other = read_machine(text, suffix=".h")
    np.testing.assert_allclose(other.position[-30:], path.position[-30:], atol=1e-12)
    np.testing.assert_allclose(other.quaternion[-30:], path.quaternion[-30:], atol=1e-12)


def test_stated_tool_axes_need_no_machine_and_turn_the_tool_along_their_move(read_machine):
    """A3= B3= C3= under TRAORI (Siemens 840D sl, Special functions, 5-axis transformation), I J K under G43.5."""
    vectors = [(0, 0, 1), (0.3, -0.2, 2), (0.6, 0, 0.8), (0.6, 0, 0.8)]
    ends = np.array([(0, 0, 0), (10, 0, 0), (10, 5, 1), (10, 5, 1)])
    units = [np.array(v) / np.linalg.norm(v) for v in vectors]
    for on, names, off in (("TRAORI", ("A3=", "B3=", "C3="), "TRAFOOF"), ("G43.5 H1", ("I", "J", "K"), "G49")):
        words = [" ".join(f"{name}{value}" for name, value in zip(names, row, strict=True)) for row in vectors]
        blocks = [f"X{x} Y{y} Z{z} {row}" for (x, y, z), row in zip(ends, words, strict=True)]
        text = "\n".join([on, f"G0 {blocks[0]}", f"G1 F600 {blocks[1]}", *blocks[2:], off, ""])
        path = read_machine(text, NO_ROTARY_AXES, ".mpf")
        np.testing.assert_allclose(1e3 * path.position, ends[:3], atol=1e-12)
        np.testing.assert_allclose(axes(path), units[:3], atol=1e-12)
    path = read_machine("TRAORI\nG0 X0 Y0 Z0\nG1 X5 F600\nA3=1 C3=1\nX9\n", NO_ROTARY_AXES, ".mpf")
    assert len(path) == 4 and path.block_length[2] == pytest.approx(LEVER * math.radians(45))  # in place


def test_a_block_in_inverse_time_takes_its_time_and_a_turn_alone_its_degrees_a_minute(read_machine):
    def seconds(path: Toolpath, line: int) -> float:
        return float((path.block_length / np.maximum(path.feed, 1e-9))[path.line == line].sum())

    for on in ("G43.4 H1\n", "\n"):
        path = read_machine(on + "G0 X50 Y0 Z0 C0 A0\nG93\nG1 X60 C30 A10 F20\nA50 F12\nG94\n")
        assert [seconds(path, line) for line in (5, 6)] == pytest.approx([3.0, 5.0], rel=1e-3)
    path = read_machine("G0 X50 Y0 Z0 C0 A0\nG1 C30 F600\n")
    assert seconds(path, 3) == pytest.approx(3.0)
    radius = math.hypot(50 - 10, 20)  # about the centre of the table
    assert path.length == pytest.approx(1e-3 * radius * math.radians(30), rel=1e-3)


def test_a_nutating_axis_turns_by_its_direction_and_rotary_words_orient_the_tool_of_a_plane(read_machine):
    path = read_machine("G43.4 H1\nG0 X0 Y0 Z0 B180 C0\nG1 X5 F600\n", NUTATING)
    np.testing.assert_allclose(axes(path)[-1], [0, 1, 0], atol=1e-12)  # half a turn about (0, 1, 1)
    plane = "G0 X0 Y0 Z9\nG68.2 I30 J20\nG0 C30. A20.\nX5 Y0 Z2\nG1 Z-1 F600\nG0 Z5\n"
    path = read_machine(plane + "G69\nG91 G28 A0 C0\nG90 G0 X0 Y0 Z9\nG1 X1\n")
    matrix = turn("z", 30) @ turn("x", 20)
    np.testing.assert_allclose(cuts(path)[0], matrix @ [5, 0, -1], atol=1e-9)
    np.testing.assert_allclose(axes(path)[-1], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "machine", "words"),
    [
        ("G0 X0 Y0 Z0\nG1 X5 A3=1 C3=1 F9\n", NO_ROTARY_AXES, "without TRAORI"),
        ("TRAORI\nG0 X0 Y0 Z0\nG1 X5 A3=0 F9\n", NO_ROTARY_AXES, "no length"),
        ("TRAORI\nG0 X0 Y0 Z0\nG2 X5 I2.5 A3=1 C3=1 F9\n", NO_ROTARY_AXES, "an arc along which"),
        ("G43.4 H1\nG0 X0 Y0 Z0\nG1 X5 B30 F9\n", NO_ROTARY_AXES, "machine.kinematics"),
        ("G0 X0 Y0 Z0\nG1 X5 B30 F9\n", TABLES, "machine.kinematics"),
        ("G43.4 H1\nG0 X0 Y0 Z0 C350\nG1 X5 C5 F9\n", TABLES, "more than 180 deg"),
        ("G43.4 H1\nG0 X0 Y0 Z0 A170 C0\nG1 X5 A180 F9\n", TABLES, "from below"),
        ("G43.4 H1\nG0 X0 Y0 Z9 A30 C0\nG81 X5 Z-2 R1 F9\n", TABLES, "the tool is not along z"),
    ],
)
def test_rotary_words_that_cannot_be_run_are_refused(read_machine, text, machine, words):
    with pytest.raises(InputError, match=words):
        read_machine(text, machine)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"axes": ("C", "C")}, "axes"), ({"axes": ("C",)}, "axes"), ({"kinematics": "robot"}, "kinematics"),
        ({"second_direction": [0, 1, 1]}, "second_direction"), ({"centre": [0.0, 1.0]}, "centre_mm"),
    ],
)  # fmt: skip
def test_a_machine_that_is_none_is_refused_with_its_key(values, key):
    with pytest.raises(ParameterError, match=key):
        Kinematics(**({"kinematics": "head_head"} | values))
