"""APT/CL files."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.path.cam.apt.reader import read_apt

HEAD = "PARTNO TEST PIECE\nUNITS/MM\nSPINDL/8000,RPM,CLW\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str):
        (tmp_path / "part.apt").write_text(text)
        return read_apt(tmp_path / "part.apt")

    return read


def test_points_feeds_and_rapids_are_read(read):
    path = read(HEAD + "FROM/0,0,50\nRAPID\nGOTO/0,0,5\nFEDRAT/600,MMPM\nGOTO/ 0, 0, -1\n$$ done\nGOTO/10,0,-1\nFINI\n")
    np.testing.assert_allclose(path.position * 1e3, [[0, 0, 50], [0, 0, 5], [0, 0, -1], [10, 0, -1]])
    assert path.rapid.tolist() == [True, True, False, False] and path.line.tolist() == [4, 6, 8, 10]
    np.testing.assert_allclose(path.feed[2:], 0.01)
    np.testing.assert_allclose(path.spindle_speed, 8000 * 2 * np.pi / 60)


def test_rapid_holds_for_one_move(read):
    path = read(HEAD + "GOTO/0,0,0\nFEDRAT/600\nRAPID\nGOTO/1,0,0\nGOTO/2,0,0\nFINI\n")
    assert path.rapid.tolist() == [True, True, False]


def test_inches_are_inches(read):
    path = read("UNITS/INCHES\nGOTO/0,0,0\nFEDRAT/60\nGOTO/1,0,0\nFEDRAT/60,MMPM\nGOTO/2,0,0\nFINI\n")
    np.testing.assert_allclose(path.position[:, 0], [0, 0.0254, 0.0508])
    np.testing.assert_allclose(path.feed[1:], [0.0254, 0.001])


def test_the_tool_axis_points_from_the_tip_to_the_spindle(read):
    path = read(HEAD + "FEDRAT/600\nGOTO/0,0,0,0,0,1\nGOTO/1,0,0,0.6,0,0.8\nGOTO/2,0,0,0,-0.28,0.96\nFINI\n")
    rotation = rotation_from_quaternion(path.quaternion)
    np.testing.assert_allclose(rotation[0], np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    np.testing.assert_allclose(-rotation[:, :, 2], [[0, 0, 1], [0.6, 0, 0.8], [0, -0.28, 0.96]], atol=1e-12)


def test_a_statement_may_go_on_in_the_next_line(read):
    path = read(HEAD + "FEDRAT/600\nGOTO/0,0,0\nGOTO/1,2,$\n3\nFINI\n")
    np.testing.assert_allclose(path.position[1] * 1e3, [1, 2, 3])
    assert path.line[1] == 6


def test_one_word_comments_name_features(read):
    path = read(
        HEAD + "FEDRAT/600\nGOTO/0,0,0\n$$ circle\nGOTO/1,0,0\nPPRINT/diamond\nGOTO/2,0,0\n$$ two words\nFINI\n"
    )
    assert [path.features[i] for i in path.feature] == ["", "circle", "diamond"]


def test_a_circle_leads_to_its_goto_and_turns_to_the_right_about_its_axis(read):
    left = read(HEAD + "FEDRAT/600\nGOTO/5,0,0\nCIRCLE/0,0,0,0,0,1,5\nGOTO/0,5,0\nFINI\n")
    right = read(HEAD + "FEDRAT/600\nGOTO/5,0,0\nCIRCLE/0,0,0,0,0,-1,5\nGOTO/0,5,0\nEND\nrubbish\n")
    assert left.length == pytest.approx(0.005 * np.pi / 2) and right.length == pytest.approx(0.005 * np.pi * 3 / 2)
    assert set(left.curvature[1:]) == {200.0} and set(right.curvature[1:]) == {-200.0}
    np.testing.assert_allclose(left.position[-1] * 1e3, [0, 5, 0], atol=1e-12)


def test_the_axis_of_a_circle_of_nx_turns_the_other_way(read):
    """NX writes eleven numbers and means k = 1 clockwise: a path along -x, a quarter up to +y, and on without a corner.

    The sense is that of the documentation of NX ("assuming a clockwise direction") and of tool paths that NX wrote.
    """
    path = read(
        "TOOL PATH/TRIM,TOOL,MILL\nFEDRAT/MMPM,600\nGOTO/8,-2,0\nGOTO/0,-2,0\n"
        "CIRCLE/0,0,0,0,0,1,2,0.06,0.5,10,0\nGOTO/-2,0,0\nGOTO/-2,6,0\nEND-OF-PATH\n"
    )
    assert path.length == pytest.approx(8e-3 + 2e-3 * np.pi / 2 + 6e-3) and path.curvature.min() == -500.0
    ends = path.tangent(np.arange(1, len(path)), path.plane_length[1:])
    starts = path.tangent(np.arange(1, len(path)), np.zeros(len(path) - 1))
    np.testing.assert_allclose(starts[1:], ends[:-1], atol=1e-9)


def test_circles_of_creo_are_orbits_points_of_the_arc_and_continued_with_a_remark(read):
    """PTC Creo help, "CL output for circular interpolation": right-hand rule, helices, lists of points."""
    helix = read(
        "UNITS/INCHES\nFEDRAT / 8.0, IPM\nGOTO / 1.2, 0.0, -0.6\nCIRCLE / 1.0, 0.0, -0.6, $ $$ 1ST ORBIT\n"
        "0.0, 0.0, 1.0, 0.2\nGOTO / 1.2, 0.0, -0.5\nFINI\n"
    )
    turn = 25.4e-3 * np.hypot(0.4 * np.pi, 0.1)
    assert helix.length == pytest.approx(turn, rel=1e-5) and (helix.curvature[1:] > 0).all()
    listed = read(HEAD + "FEDRAT/600\nGOTO/5,0,0\nCIRCLE/0,0,0,0,0,1,5\nGOTO/4,3,0, $\n3,4,0, $\n0,5,0\nFINI\n")
    assert listed.length == pytest.approx(5e-3 * np.pi / 2)


def test_a_feed_per_revolution_goes_with_the_spindle_and_cclw_turns_it_the_other_way(read):
    path = read("SPINDL/RPM,6000,CCLW\nGOTO/0,0,0\nFEDRAT/0.2,MMPR\nGOTO/1,0,0\nGODLTA/0,2,0\nFINI\n")
    np.testing.assert_allclose(path.feed[1:], 0.02)
    assert path.program.spindle_speeds == pytest.approx((-200 * np.pi,))
    np.testing.assert_allclose(path.position[-1] * 1e3, [1, 2, 0])


def test_tools_and_what_moves_nothing_are_noted(read):
    path = read(
        "PARTNO BRACKET\nMULTAX/OFF\nMSYS/0,0,0,1,0,0,0,1,0\nLOADTL/3\nCUTTER/12,0\nCOOLNT/ON\nFEDRAT/600\nGOTO/0,0,5\n"
        "GOTO/0,0,0\nCOOLNT/OFF\nGOHOME\nRAPID\nGOTO/9,9,5\nFINI\n"
    )
    program = path.program
    assert program.title == "BRACKET" and program.tool == "T3"
    assert program.current.diameter == pytest.approx(0.012)
    assert {r.word: r.count for r in program.read_over}["COOLNT"] == 2
    np.testing.assert_allclose(path.position[2:] * 1e3, [[0, 0, 5], [9, 9, 5]])  # up first


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        ("GOTO/0,0,0\nFEDRAT/600\nCIRCLE/0,0,5\n", 3, "CIRCLE"),
        ("GOTO/5,0,0\nFEDRAT/600\nCIRCLE/0,0,0,0,0,1,5,0.1,0.5,9,0,TIMES,2\n", 3, "several turns"),
        ("GOTO/5,0,0\nFEDRAT/600\nCIRCLE/0,0,0,1,0,0,5\nGOTO/-5,0,0\n", 3, "not z; let the CAM output GOTO"),
        ("GOTO/5,0,0\nFEDRAT/600\nCIRCLE/0,0,0,0,0,1,5\nGOTO/-4,0,0\n", 4, "does not close"),
        ("GOTO/5,0,0\nFEDRAT/600\nGOTO/6,0,0\nCIRCLE/0,0,0,0,0,1,6\nFINI\n", 5, "without the GOTO"),
        ("GOTO/5,0,0\nCYCLE/DRILL,5\n", 2, "CYCLE: let the CAM output drilling as GOTO"),
        ("GOTO/5,0,0\nCUTCOM/LEFT\n", 2, "CUTCOM: let the CAM output the path of the tool's centre"),
        ("GOTO/0,0,0\nFEDRAT/0.1,MMPR\nGOTO/1,0,0\n", 3, "without a feed"),
        ("SPINDL/800,SFM\n", 1, "SFM"),
        ("LOADTL/1\nFEDRAT/9\nGOTO/0,0,0\nGOTO/1,0,0\nLOADTL/2\nGOTO/2,0,0\n", 5, "2 tools: T1 from line 1, T2"),
        ("GOTO/0,0,0\nMSYS/0,0,0,1,0,0,0,1,0\n", 2, "MSYS"),
        ("GOTO/0,0,0\nGOTO/1,0,0\n", 2, "without a feed"),
        ("GOTO/0,0,0\nFEDRAT/0\nGOTO/1,0,0\n", 3, "zero feed"),
        ("GOTO/0,0,0\nFEDRAT/-5\n", 2, "-5"),
        ("GOTO/0,0,0\nFEDRAT/0.1,MMPM,IPM\n", 2, "FEDRAT"),
        ("GOTO/0,0,nan\n", 1, "NAN"),
        ("GOTO/0,0,inf\n", 1, "INF"),
        ("GOTO/0,0\n", 1, "not 2 numbers"),
        ("GOTO/0,0,0,0,0,2\n", 1, "length 2"),
        ("GOTO/0,0,0,0,0,-1\n", 1, "below"),
        ("GOTO/1e9,0,0\n", 1, "wrong unit"),
        ("UNITS/FURLONGS\n", 1, "FURLONGS"),
        ("GOTO/0,0,0\nFEDRAT/600\nGOTO/1,0,0", 3, "cut off"),
        ("GOTO/0,0,0\nFEDRAT/600\nGOTO/1,$\n", 3, "continued"),
        ("GOTO/0,0,0\nFEDRAT/600\nFINI\n", 1, "never moves"),
        ("GOTO/0,0,0\n{}\n", 2, "no APT statement"),
        ("GOTO/0,0,0,0,0,1\nFEDRAT/600\nGOTO/0,0,0,0.6,0,0.8\n", 3, "turns without moving"),
    ],
)
def test_what_cannot_be_run_is_refused_with_line_and_word(read, text, line, word):
    with pytest.raises(InputError, match=word) as caught:
        read(text)
    assert caught.value.line == line and "\n" not in str(caught.value)
