"""G-code: the subset, its modal state, and a line number for all that is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.cam.machine import CHORD
from kr270_milling.path.source_program import ProgramError

START = "G0 X0 Y0 Z0\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str, **options):
        (tmp_path / "part.nc").write_text(text, newline="")
        return read_gcode(tmp_path / "part.nc", **options)

    return read


def test_spaces_case_leading_zeros_and_signs_do_not_matter(read):
    one = read("g00x+1.50y-.5z0\n  G01 X 2. F100\nM02\n")
    two = read("G0 X1.5 Y-0.5 Z0\nG1 X2 F100\nM2\n")
    np.testing.assert_array_equal(one.position, two.position)


def test_inches_are_inches_in_coordinates_and_feeds(read):
    path = read("G20\nG0 X0 Y0 Z0\nG1 X1 F60\nG21\nX50.8\n")
    np.testing.assert_allclose(path.position[:, 0], [0, 0.0254, 0.0508])
    np.testing.assert_allclose(path.feed[1:], 0.0254)


def test_the_length_of_an_arc_is_radius_times_angle(read):
    quarter = read(START + "G3 X10 Y10 I0 J10 F100\n")
    assert quarter.length == pytest.approx(0.010 * math.pi / 2, rel=1e-9)
    three = read(START + "G2 X10 Y10 I0 J10 F100\n")
    assert three.length == pytest.approx(0.010 * 3 * math.pi / 2, rel=1e-9)
    full = read(START + "G2 I-37 F100\n")
    assert full.length == pytest.approx(0.037 * 2 * math.pi, rel=1e-9)
    helix = read(START + "G2 I-37 Z-1 F100\n")
    assert helix.length == pytest.approx(math.hypot(0.037 * 2 * math.pi, 0.001), rel=1e-9)


def test_a_radius_gives_the_same_arc_as_its_centre(read):
    np.testing.assert_allclose(
        read(START + "G3 X10 Y10 R10 F100\n").position, read(START + "G3 X10 Y10 J10 F100\n").position, atol=1e-15
    )
    np.testing.assert_allclose(
        read(START + "G2 X10 Y10 R-10 F100\n").position, read(START + "G2 X10 Y10 J10 F100\n").position, atol=1e-15
    )


def test_the_chord_tolerance_is_kept_and_asks_for_no_more_chords_than_needed(read):
    path = read(START + "G2 I-37 F100\n")
    middle = (path.position[1:] + path.position[:-1]) / 2
    sagitta = 0.037 - np.hypot(middle[:, 0] + 0.037, middle[:, 1])
    assert 0.9 * CHORD < sagitta.max() <= CHORD


def test_a_comment_of_one_word_names_the_feature_that_follows(read):
    path = read("(T1 D=20)\n" + START + "(square)\nG1 X1 F100 (not a feature)\nX2\n(circle)\nX3 ; (diamond)\n")
    assert path.features == ("", "square", "circle")
    assert [path.features[i] for i in path.feature] == ["", "square", "square", "circle"]


def test_the_spindle_speed_counts_only_while_the_spindle_turns(read):
    path = read("G0 X0 Y0 Z0 S60\nG1 X1 F100\nM3\nX2\nM5\nX3\nM13 X4\nM30\n")
    np.testing.assert_allclose(path.spindle_speed / (2 * math.pi), [0, 0, 1, 0, 1])


def test_a_counterclockwise_spindle_turns_the_other_way(read):
    path = read("G0 X0 Y0 Z0\nM4 S60\nG1 X1 F100\n")
    np.testing.assert_allclose(path.spindle_speed / (2 * math.pi), [0, -1])


def test_axes_may_be_given_one_after_the_other_before_the_first_cut(read):
    path = read("G0 Z5\nX1 Y2\nG1 Z0 F100\n")
    np.testing.assert_allclose(path.position * 1e3, [[1, 2, 5], [1, 2, 0]])


def test_what_follows_the_end_of_the_program_is_not_read(read):
    assert len(read(START + "G1 X1 F100\nM30\nrubbish")) == 2


def test_a_hundred_thousand_identical_points_are_no_path_and_are_refused(read):
    with pytest.raises(InputError, match="never moves"):
        read("G0 X1 Y1 Z1\nG1 F100\n" + "X1\n" * 100_000)


def test_repeated_points_within_a_path_are_left_out(read):
    assert len(read(START + "G1 X1 F100\n" + "X1\n" * 1000 + "X2\n")) == 3


def test_a_file_that_ends_in_m_words_is_whole_without_the_end_of_its_line(read):
    assert len(read(START + "G1 X1 F100\nN9 M9 M5")) == len(read(START + "G1 X1 F100\nM30\n"))


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        (START + "G41 D1\n", 2, "G41: let the CAM output the path of the tool's centre"),
        (START + "#1=5\n", 2, "post without macros"),
        (START + "G1 X[#1+2]\n", 2, "post without macros"),
        (START + "M98 P100\n", 2, "M98: post without macros"),
        (START + "o100 sub\n", 2, "post without macros"),
        (START + "WHILE [#1 LT 5] DO1\n", 2, "post without macros"),
        (START + "G68 R90\n", 2, "G68: let the CAM output coordinates of one work offset"),
        (START + "G52 X5\n", 2, "G52"),
        (START + "G92 X5\n", 2, "G92"),
        (START + "G10 L2 P1 X5\n", 2, "G10"),
        (START + "G84 Z-5 R1 F100\n", 2, "G84: leave threads out"),
        (START + "G38.2 Z-5 F10\n", 2, "G38.2: leave probing out"),
        (START + "G5.2 X1 Y1 P1\n", 2, "G5.2: let the CAM output lines and arcs"),
        (START + "G5 X1 Y1 I1 J1\n", 2, "G5: let the CAM output lines and arcs"),
        (START + "G12 I5 F100\n", 2, "G12: let the CAM output the cycle"),
        (START + "G96 S100\n", 2, "G96: this is a word of lathes"),
        (START + "G123\n", 2, "G123: it is not known"),
        (START + "G1 X1 A90 F100\n", 2, "A90: post a 3-axis program"),
        (START + "G43.4 H1\n", 2, "G43.4: post a 3-axis program"),
        (START + "TRAORI\n", 2, "TRAORI: post a 3-axis program"),
        (START + "CYCLE81(10,0,2,-5)\n", 2, "CYCLE81: let the CAM output the cycle"),
        (START + "G1 X10 Y0,R2 F100\n", 2, "let the CAM output lines and arcs"),
        (START + "G1 X1\n", 2, "without a feed"),
        (START + "G1 X1 F0\n", 2, "zero feed"),
        (START + "G1 X1 F-100\n", 2, "F-100"),
        (START + "G1 XNaN F100\n", 2, "XNAN"),
        (START + "G1 X F100\n", 2, "X has no number"),
        (START + "G1 X1 F100\nG1 X2 Y1", 3, "cut off"),
        (START + "G1 X1e5 F100\n", 2, "E5"),
        (START + "G1 X1 X2 F100\n", 2, "X occurs twice"),
        (START + "G0 G1 X1 F100\n", 2, "G1 contradicts"),
        (START + "G2 X10 Y0 I4 J0 F100\n", 2, "does not close"),
        ("G0 X20 Y0 Z0\nG3 X0 Y20 I0 J0 F100\n", 2, "closes with an absolute centre only; write G90.1"),
        (START + "G2 X10 Y0 R4.9 F100\n", 2, "does not close"),
        (START + "G2 X10 Y0 R1" + 160 * "0" + " F100\n", 2, "wrong unit"),
        (START + "G2 X10 Y0 R100000000000000 F100\n", 2, "wrong unit"),
        (START + "G2 X0.001 Y0 J30000000000000 F100\n", 2, "wrong unit"),
        (START + "G2 X0 Y0 J900000 F100\n", 2, "leads more than 100 m away"),
        (START + "G2 X10 Y0 F100\n", 2, "without I, J or R"),
        (START + "G18 G2 X10 Z0 F100\n", 2, "without K, I or R"),
        (START + "G2 X10 Y0 I5 K2 F100\n", 2, "K does not belong"),
        (START + "G2 X10 Y0 R6 I5 F100\n", 2, "not by both"),
        (START + "G2 R6 F100\n", 2, "elsewhere"),
        (START + "G2 X5 I0 J0 F100\n", 2, "does not close"),
        (START + "G1 X5 I1 F100\n", 2, "I belongs to"),
        (START + "(open\nG1 X1 F100\n", 2, "not closed"),
        (START + "G1 X1 F100 $\n", 2, r"\$"),
        (START + "G1 X1 F100 \u0425\u0456\n", 2, "no G-code word"),
        (START + "G1 X1000000 F100\n", 2, "wrong unit"),
        (START + "G81 Z5 R2 F100\n", 2, "does not lead from R down to Z"),
        (START + "G83 Z-99 R2 Q0.001 F100\n", 2, "wrong Q"),
        (START + "G81 Z-5 R2 F100 L5\n", 2, "5 times at one place"),
        ("G0 X0 Y0\nG81 Z-5 F100\n", 2, "not all known"),
        ("X1 Y1 Z1\n", 1, "without G0"),
        ("G1 X1 Y1 Z-1 F100\nG1 X2\nG28\nG1 Z-5 X1\n", 4, "before X, Y and Z"),
        ("G1 Z-1 F100\n", 1, "before X, Y and Z"),
        ("G91 G0 X1\n", 1, "G91"),
        ("BEGIN PGM PART MM\n", 1, "Heidenhain"),
        ("G21\n", 2, "never moves"),
    ],
)
def test_what_cannot_be_run_is_refused_with_line_and_word(read, text, line, word):
    with pytest.raises(InputError, match=word) as caught:
        read(text)
    assert caught.value.line == line and "\n" not in str(caught.value)


def test_all_that_cannot_be_run_is_listed_at_once(read):
    with pytest.raises(ProgramError) as caught:
        read(START + "G41 D1\nG1 X1 F100\nX#1\nG42\nA5\nG1 X2\n")
    assert [(r.line, r.word) for r in caught.value.program.refused] == [(2, "G41"), (4, "X#1"), (5, "G42"), (6, "A5")]
    assert "line 4: X#1: post without macros" in str(caught.value) and "(also line 5)" in str(caught.value)


def test_what_follows_from_a_refused_move_is_not_refused_once_more(read):
    with pytest.raises(ProgramError) as caught:
        read("G0 X#1 Y0\nG0 Z5\nG1 Z-1 F100\nX1\n")
    assert [r.line for r in caught.value.program.refused] == [1]


def test_a_feed_may_come_from_the_cell_where_the_program_has_none(read):
    np.testing.assert_allclose(read(START + "G1 X1\nX2\n", feed=0.02).feed[1:], 0.02)
    np.testing.assert_allclose(read(START + "G1 X1\nX2 F600\n", feed=0.02).feed[1:], [0.02, 0.01])


def test_an_arc_may_miss_closing_by_the_rounding_of_its_numbers(read):
    assert read(START + "G2 X10.001 Y0 I5 J0 F100\n").length == pytest.approx(0.005 * math.pi, rel=1e-3)
