"""Drilling cycles, retracts, planes, feeds and tools of G-code: what each does to the path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kr270_milling.path.cam.drilling import CLEARANCE, Cycle
from kr270_milling.path.cam.gcode.reader import read_gcode

START = "G0 X0 Y0 Z10\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str, **options):
        (tmp_path / "part.nc").write_text(text)
        return read_gcode(tmp_path / "part.nc", **options)

    return read


def millimetres(path) -> list[list[float]]:
    return np.round(1e3 * path.position, 6).tolist()


# --- cycles ---


def test_pecks_end_at_the_bottom_and_start_a_clearance_above_the_last_one():
    path = Cycle(83, 10e-3, 2e-3, -5e-3, 3e-3).strokes()
    depths = [z for z, rapid in path if not rapid]
    np.testing.assert_allclose(depths, [-1e-3, -4e-3, -5e-3])
    np.testing.assert_allclose([z for z, rapid in path if rapid], [
        2e-3, -1e-3 + CLEARANCE, 2e-3, -4e-3 + CLEARANCE, 2e-3])  # fmt: skip


def test_chips_are_broken_by_a_short_way_back():
    path = Cycle(73, 10e-3, 2e-3, -5e-3, 3e-3).strokes()
    np.testing.assert_allclose([z for z, rapid in path if rapid], [-1e-3 + CLEARANCE, -4e-3 + CLEARANCE, 2e-3])


def test_a_bore_is_left_at_the_feed_and_a_drill_rapidly():
    assert [rapid for _, rapid in Cycle(85, 10e-3, 2e-3, -5e-3).strokes()] == [False, False]
    assert [rapid for _, rapid in Cycle(82, 10e-3, 2e-3, -5e-3).strokes()] == [False, True]


def test_g98_returns_to_where_the_cycle_was_called_and_g99_to_r(read):
    path = read(START + "G98 G81 X5 Z-3 R2 F100\nG99 X10\nG80\nG0 Z10\n")
    assert millimetres(path) == [[0, 0, 10], [5, 0, 10], [5, 0, 2], [5, 0, -3], [5, 0, 2], [5, 0, 10], [10, 0, 10],
                                 [10, 0, 2], [10, 0, -3], [10, 0, 2], [10, 0, 10]]  # fmt: skip
    assert path.rapid.tolist() == [True, True, True, False, True, True, True, True, False, True, True]


def test_holes_in_a_row_are_repeated_by_l_with_g91(read):
    path = read(START + "G91 G99 G81 X5 Z-5 R-8 F100 L3\nG80 G90\n")
    assert [p for p in millimetres(path) if p[2] < 0] == [[5, 0, -3], [10, 0, -3], [15, 0, -3]]


def test_a_cycle_without_a_repeat_drills_nothing_until_the_next_place(read):
    path = read(START + "G81 X5 Z-3 R2 F100 L0\nX7\n")
    assert [p for p in millimetres(path) if p[2] < 0] == [[7, 0, -3]]


def test_a_motion_word_ends_a_cycle_and_g80_leaves_the_motion_before_it(read):
    path = read(START + "G81 X5 Z-3 R2 F100\nG1 X9\nG81 X5 Z-3 R2\nG80\nX1\n")
    assert millimetres(path)[-1] == [1, 0, 10] and not path.rapid[-1]


# --- retracts ---


@pytest.mark.parametrize(
    "home", ["G28 G91 Z0\nG90", "G91 G28 Z0.\nG90", "G53 G0 Z0", "G0 SUPA Z0", "G30 Z5", "G74 Z1=0"]
)
def test_a_retract_goes_to_the_highest_level_and_comes_back_from_there(read, home):
    path = read(f"G0 X0 Y0 Z20\nG0 Z1\nG1 Z-1 F100\n{home}\nG0 X9 Y9\nG0 Z1\nG1 Z-1\n")
    assert millimetres(path)[2:] == [[0, 0, -1], [0, 0, 20], [9, 9, 20], [9, 9, 1], [9, 9, -1]]


def test_a_tool_that_comes_back_from_home_travels_above(read):
    path = read("G0 X0 Y0 Z20\nG1 Z-1 F100\nG28\nG0 X9 Y9 Z1\nG1 Z-1\n")
    assert millimetres(path)[1:] == [[0, 0, -1], [0, 0, 20], [9, 9, 20], [9, 9, 1], [9, 9, -1]]


def test_a_change_of_the_tool_lifts_it_but_keeps_its_coordinates(read):
    text = "T1 M6\nG0 X0 Y0 Z20\nG0 Z1\nG1 X5 F100\nT2 M6\nG1 X7\nG0 Z20\nT1 M6\nG0 X1 Z1\nG1 X2\n"
    path = read(text, tool="T1")
    assert millimetres(path) == [[0, 0, 20], [0, 0, 1], [5, 0, 1], [5, 0, 20], [1, 0, 20], [1, 0, 1], [2, 0, 1]]
    assert read(text, tool="T2").length == pytest.approx(2e-3 + 19e-3)


def test_a_preselected_tool_is_not_yet_in_the_spindle(read):
    program = read("T1 M6\nT2\n" + START + "G1 Z-1 F100\nM30\n").program
    assert [tool.name for tool in program.tools] == ["T1"]


def test_a_posts_feed_move_from_home_is_a_positioning_move(read):
    path = read("G53 G0 Z0\nG1 X5 Y5 F5000\nG0 Z2\nG1 Z-1 F100\n")
    assert millimetres(path) == [[5, 5, 2], [5, 5, -1]]


# --- planes, feeds, offsets ---


@pytest.mark.parametrize(("plane", "end", "centre"), [(17, "X5 Y5", "I5"), (18, "Z15 X5", "K5"), (19, "Y5 Z15", "J5")])
def test_clockwise_is_seen_against_the_axis_across_the_plane(read, plane, end, centre):
    quarter = read(START + f"G{plane} G2 {end} {centre} F100\n")
    rest = read(START + f"G{plane} G3 {end} {centre} F100\n")
    assert 1e3 * quarter.length == pytest.approx(2.5 * math.pi, rel=1e-3)
    assert 1e3 * rest.length == pytest.approx(7.5 * math.pi, rel=1e-3)


def test_a_helix_of_sinumerik_turns_further_circles(read):
    path = read(START + "G3 X0 Y0 Z4 I5 J0 TURN=2 F100\n")
    assert 1e3 * path.length == pytest.approx(math.hypot(3 * 10 * math.pi, 6), rel=1e-6)


def test_two_work_offsets_are_refused_and_one_is_named(read):
    assert read("G55\n" + START + "G1 Z1 F100\n").program.work_offset == "G55"
    with pytest.raises(Exception, match=r"2 work offsets: G54 \(line 3\), G55 \(line 5\); post one program for each"):
        read(START + "G54\nG1 Z1 F100\nG55\nG1 X1\n")


def test_two_spindle_speeds_are_refused_with_their_lines(read):
    with pytest.raises(Exception, match=r"2 spindle speeds: S100 \(line 3\), S200 \(line 5\); post one program"):
        read(START + "S100 M3\nG1 Z1 F100\nS200\nG1 X1\n")


def test_a_dwell_has_no_feed_and_moves_nothing(read):
    path = read(START + "G1 Z1 F600\nG4 F5\nG4 X2\nG4 P100\nX1\n")
    assert path.feed[-1] == pytest.approx(0.01) and millimetres(path)[-1] == [1, 0, 1]
    assert {r.word: r.count for r in path.program.read_over} == {"G4": 3}


def test_a_line_with_block_skip_is_run_and_said(read):
    path = read(START + "/G1 Z1 F600\n/2 X5\n")
    assert millimetres(path)[-1] == [5, 0, 1] and path.program.summary == "read over: 2 /"
