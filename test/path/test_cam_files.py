"""APT/CL files, tables of points and the table of readers: what is read, and no input that breaks a reader."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from budget import budget
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import rotation_from_abc, rotation_from_quaternion
from kr270_milling.cell import sections  # noqa: F401 (puts .mcap into the table of readers)
from kr270_milling.path.cam.arcs import ArcError, arc_points, centre_from_radius
from kr270_milling.path.cam.readers import READERS, PathReader, read_path_file, read_toolpath
from kr270_milling.path.toolpath import REACH, PathBuilder, Toolpath
from kr270_milling.path.trajectory import read_csv

VALID = {
    ".nc": b"G21 G90 (a)\nG0 X0 Y0 Z0\nG1 X1 F100\nG2 X5 Y4 I4 J0\nG3 X0 Y0 R6\nG91 G20\nG1 X-.5 F4\nM30\n",
    ".apt": b"UNITS/MM\nGOTO/0,0,0\nFEDRAT/100,MMPM\nRAPID\nGOTO/1,2,3,0,0,1\nGOTO/1,$\n5,3\n$$ a\nFINI\n",
    ".h": b"0 BEGIN PGM A MM\nTOOL DEF 1 R+2\nTOOL CALL 1 Z S9\nL X+0 Y+0 Z+5 FMAX M3\n"
    b"L X+9 RL F100 ; a\nL X+20\nRND R3\nL Y+9\nCC X+15 Y+9\nC X+10 Y+9 DR+\nCR X+0 Y+9 R+5 DR-\n"
    b"L IY-50 R0 FMAX\nEND PGM A MM\n",
    ".csv": b"x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min\n0,0,0,0,0,180,1\n1,0,1,0,0,180,60\n",
}
WORDS = [b"L X+1", b"RL", b"FMAX", b"CC IX+1", b"C X+3 DR+", b"CT X+2 Y+1", b"CHF 1", b"Q1=+2", b"CYCL CALL", b"M91",
         b"~", b"CP IPA+90 DR+",
         b"G0", b"G1", b"G2", b"G3", b"G20", b"G91", b"X1", b"Y-2", b"Z.5", b"I1", b"J-1", b"R5", b"R-1e9", b"F100",
         b"F0", b"S1", b"M3", b"M30", b"\n", b" ", b"(a)", b"(", b";", b"%", b"GOTO/", b"0,0,0", b",1", b"FEDRAT/5",
         b"RAPID", b"$", b"$$ b", b"UNITS/INCHES", b"FINI", b"SPINDL/", b"nan", b"-inf", b"1e999", b"9" * 400,
         b"x_mm,y_mm,z_mm,feed_mm_per_min", b"\xff", b"\0", "\u0663".encode(), "\u2028".encode(), b"\r"]  # fmt: skip
quick = settings(deadline=None, max_examples=budget(300), suppress_health_check=[HealthCheck.function_scoped_fixture])


def check(path: Path, data: bytes) -> None:
    """The file is refused in one sentence, or is a path that a machine could run."""
    path.write_bytes(data)
    try:
        toolpath = read_toolpath(path)
    except InputError as error:
        assert str(error).isprintable() and len(str(error)) < 2000 + len(str(path))
        assert error.line is not None and 1 <= error.line <= data.count(b"\n") + data.count(b"\r") + 1
        return
    assert isinstance(toolpath, Toolpath) and np.abs(toolpath.position).max() <= REACH
    assert toolpath.length > 0 and np.all(toolpath.rapid[1:] | (toolpath.feed[1:] > 0))
    assert np.all(np.diff(toolpath.line) >= 0)


#: statements after the start at X0 Y0 Z0 with F600 -> ends of the cutting moves [mm], or words of the refusal
CONVERSATIONAL = {
    "Q1 = +3 * (2 + 1)\nFN 4: Q2 = +Q1 DIV +3\nL X+Q1 IY-Q2": [(9, -3)],
    "Q1 = 0\nLBL 3\nFN 1: Q1 = +Q1 + +2\nL X+Q1\nFN 12: IF +Q1 LT +5 GOTO LBL 3": [2, 4, 6],
    'CALL LBL "A"\nM30\nLBL "A"\nL IX+1\nLBL 2\nL IX+1\nCALL LBL 2 REP2/2\nLBL 0': [1, 2, 3, 4],
    "CC X+0 Y+5\nC X+0 Y+10 DR+\nCT X+0 Y+20\nCR X+10 Y+20 R-5 DR+": [(0, 10), (0, 20), (10, 20)],
    "CC X+10 Y+0\nCP IPA-90 DR-\nLP PR+5 PA+0\nCP IPA+450 IZ-2 DR+": [(10, 10), (15, 0), (10, 5, -2)],
    "L X+10\nCHF 2\nL Y+10": [8, (10, 2), (10, 10)],
    "TOOL DEF 4 R+2\nTOOL CALL 4 Z\nL X+10 RL\nL X+20\nRND R6\nL Y+10\nL X+0 R0": [
        (10, 2), (14, 2), (18, 6), (18, 10), 0],
    "CYCL DEF 203 X ~\nQ200=2 ;A ~\nQ201=-3 ~\nQ206=90 Q202=9 Q203=-1\nL X+5 FMAX M99\nL X+6 FMAX\nCYCL CALL": [
        (5, 0, -4), (6, 0, -4)],
    "L X+1 M128": [1], "CYCL DEF 209 TAPPING": "CYCL DEF 200, 201, 203, 205 and 240 are read",
    "CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+5\nL X+1\nTRANS DATUM RESET\nL X+2": [6, 2],
    "CYCL DEF 7.0\nCYCL DEF 7.1 X+5\nCYCL DEF 7.0\nCYCL DEF 7.1 IX+1\nL X+1": [7],
    **dict.fromkeys(("CYCL DEF 8.0 MIRROR IMAGE\nCYCL DEF 8.1 X Y", "CYCL DEF 10.1 ROT+Q0"), "let the CAM output"),
    "CYCL DEF 8.0 MIRROR IMAGE\nCYCL DEF 8.1\nCYCL DEF 10.0 ROTATION\nCYCL DEF 10.1 ROT+0\nL X+1": [1],
    "PLANE SPATIAL SPA0 SPB10": "needs SPA, SPB, SPC", "PLANE VECTOR BX1": "let the CAM output PLANE SPATIAL",
    "L X+10,5": [10.5], "L X+1 Q": "is no word", "L X+Q9": "Q9 has no value", "L X+1 M89": "M89", "L X+1 M104": "M104",
    "L X+3\nSTOP M0\nL X+4\nSTOP M30\nL X+5": [3, 4],
    "CYCL DEF 240 CENTERING Q200=2 Q343=0 Q201=-1 Q206=60 Q203=0\nL X+5 FMAX M99": [(5, 0, -1)],
    "CYCL DEF 201 REAMING Q200=2 Q201=-1 Q206=60 Q203=+0\nL X+5 FMAX M99": [(5, 0, -1), (5, 0, 2)],
    "CYCL DEF 205 PECKING ~\nQ200=2 Q201=-5 Q206=60 Q202=3 Q203=0 Q212=0\nL X+5 FMAX M99": [(5, 0, -1), (5, 0, -4),
                                                                                   (5, 0, -5)],
    "CYCL DEF 240 CENTERING Q200=2 Q343=1 Q201=-1 Q344=-5 Q206=60 Q203=0": "Q343, Q379 and Q395 of zero",
    "CYCL DEF 200 X Q200=2 Q201=-3 Q206=90 Q202=9 Q203=0 Q395=1": "Q343, Q379 and Q395 of zero",
    "CYCL DEF 201 REAMING Q200=2 Q201=-1 Q206=60 Q203=0\nCYCL CALL POS X+5 Y+1 Z+0 FMAX": [(5, 1, -1), (5, 1, 2)],
    "CYCL DEF 201 REAMING Q200=2 Q201=-1 Q206=60 Q203=0\nCYCL CALL POS X+5 Y+1 Z+1": "shifts the hole",
    "L X+1\nM140 MB+3 F90\nL X+2": [(1, 0, 0), (1, 0, 3), (2, 0, 3)],
    "L X+5 RL": "radius of the tool",
    "L X+5\nRND R2": "RND without a next move", "C X+5 DR+": "C needs CC", "CT X+5 Y+0": "needs a move in the xy plane",
    "CALL LBL 7": "LBL 7 is not in this program", "LBL 1\nCALL LBL 1": "more than 10 labels call one another",
    "APPR LT X+5 LEN5": "lead-ins and lead-outs", "CYCL CALL": "before its CYCL DEF", "L A+5": "does not take A",
    "TOOL CALL 1 Y": "takes a tool, Z", "TOOL CALL 1 Z S9 DL-5": "DL and DR of TOOL CALL move the path",
    "L Z-2\nL M140 MB5\nL X+3\nL M140 MB 1 F90": [(0, 0, -2), (3, 0, 3), (3, 0, 4)],
    "L Z-2\nL M140 MB MAX FMAX\nL X+3 Y+0 Z-2": [(0, 0, -2), (3, 0, -2)],
    "L X+9 M140 MB5": "in a separate block", "L Z-1\nL X-500 F9 M91": "a cut to a place of the machine",
    "CC X+0 Y+5\nC X+0 Y+10 DR+ FMAX": "a rapid move on an arc",
    "X+5": "'X\\+5' is not read", "CC X+9 Y+0\nCP IPA-90 DR+": "turns against DR",
}  # fmt: skip


@pytest.mark.parametrize("statements", CONVERSATIONAL)
def test_a_conversational_program_leads_to_the_right_places_or_is_refused(tmp_path, statements):
    expected = CONVERSATIONAL[statements]
    (tmp_path / "a.h").write_text(f"BEGIN PGM A MM\nL X+0 Y+0 Z+0 R0 FMAX F600 M3\n{statements}\nEND PGM A MM\n")
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            read_toolpath(tmp_path / "a.h")
        return
    path = read_toolpath(tmp_path / "a.h")
    cutting = ~path.rapid & ((path.curvature == 0) | (path.curvature != np.roll(path.curvature, -1)))  # ends of arcs
    for end, known in zip(1e3 * path.position[cutting], expected, strict=True):
        known = (known,) if isinstance(known, (int, float)) else known
        assert end[: len(known)] == pytest.approx(known, abs=1e-6)


def test_a_program_in_inches_has_feeds_in_tenths_of_an_inch_and_states_the_blank(tmp_path):
    # F100 in inches is 10 inches a minute (TNC7 User's Manual, "Cutting data")
    blank = "BLK FORM 0.1 Z X-1 Y-1 Z-0.5\nBLK FORM 0.2 IX+2 Y+1 IZ+0.75\n"
    (tmp_path / "a.h").write_text(f"BEGIN PGM A INCH\n{blank}L X+0 Y+0 Z+0 R0 FMAX M3\nL X+1 F100\nEND PGM A INCH\n")
    path = read_toolpath(tmp_path / "a.h")
    assert path.feed[-1] * 60 == pytest.approx(0.254) and path.program.feed_units == ("tenths of an inch a minute",)
    assert np.array(path.program.stock) / 0.0254 == pytest.approx([-1, -1, -0.5, 1, 1, 0.25])


@pytest.mark.parametrize(("fields", "stock"), [
    (',"",,"BOX",112,5,-20,-80,-50,-40,50,40', [-50, -40, -20, 50, 40, 5]),
    (',"",,"BOX",64,5,-20,-80,-50,-40,50,40', []), (',"",,"CYLINDER",64,5,-20,-80,50', []),
])  # fmt: skip
def test_workpiece_of_sinumerik_states_a_box_in_absolute_coordinates(tmp_path, fields, stock):
    (tmp_path / "a.mpf").write_text(f"WORKPIECE({fields})\nG0 X0 Y0 Z0 S9 M3\nG1 X1 F600\nM30\n")
    assert 1e3 * np.array(read_toolpath(tmp_path / "a.mpf").program.stock) == pytest.approx(stock)


def test_fauto_takes_the_feed_of_the_tool_and_m5_stops_the_spindle_after_its_move(tmp_path):
    lines = ["BEGIN PGM A MM", "TOOL CALL 1 Z S9000 F300", "L X+0 Y+0 Z+0 FMAX M3", "L X+1 F900", "L X+2 FAUTO M5"]
    (tmp_path / "a.h").write_text("\n".join([*lines, "L X+3", "END PGM A MM", ""]))
    path = read_toolpath(tmp_path / "a.h")
    assert 6e4 * path.feed[1:] == pytest.approx([900, 300, 300])
    assert (path.spindle_speed[1:] > 0).tolist() == [True, True, False]


def test_the_whole_examples_are_read_under_every_name_of_their_kind(tmp_path):
    kinds = {READERS[suffix]: data for suffix, data in VALID.items()}
    kinds[READERS[".src"]] = (Path(__file__).parents[1] / "samples" / "krl" / "robodk.src").read_bytes()
    for suffix, reader in READERS.items():
        if reader.recorded:
            continue
        (tmp_path / f"part{suffix.upper()}").write_bytes(kinds[reader])
        assert len(read_toolpath(tmp_path / f"part{suffix.upper()}")) >= 2


@pytest.mark.parametrize("suffix", VALID)
@quick
@given(words=st.lists(st.sampled_from(WORDS), max_size=40))
def test_words_in_any_order_are_refused_or_read(tmp_path, suffix, words):
    check(tmp_path / f"x{suffix}", b"".join(words))


@pytest.mark.parametrize("suffix", VALID)
@quick
@given(data=st.data())
def test_a_file_with_a_spoilt_byte_or_a_missing_end_is_refused_or_read(tmp_path, suffix, data):
    whole = VALID[suffix]
    at = data.draw(st.integers(0, len(whole) - 1))
    check(tmp_path / f"x{suffix}", whole[:at] + data.draw(st.binary(max_size=2)) + whole[at + 1 :])
    check(tmp_path / f"y{suffix}", whole[:at])


@pytest.mark.parametrize("suffix", VALID)
def test_a_file_cut_off_within_a_line_is_never_taken_for_whole(tmp_path, suffix):
    whole = VALID[suffix].rstrip(b"\n")
    ending = whole.rindex(b"\n")  # the last line of G-code and APT only says that the program ends
    for at in range(1, ending if suffix != ".csv" else len(whole)):
        if whole[at - 1 : at] == b"\n":
            continue
        (tmp_path / f"x{suffix}").write_bytes(whole[:at])
        with pytest.raises(InputError):
            read_toolpath(tmp_path / f"x{suffix}")


@quick
@given(data=st.binary(max_size=200))
def test_a_trajectory_file_of_random_bytes_is_refused(tmp_path, data):
    (tmp_path / "x.csv").write_bytes(data)
    with pytest.raises(InputError):
        read_csv(tmp_path / "x.csv")


@pytest.mark.parametrize("suffix", VALID)
@pytest.mark.parametrize("line", [b"(" * 50_000, b"X1" * 25_000, b"9" * 250_000, b" " * 250_000 + b"x", b"$\n" * 9999])
def test_long_lines_take_no_time(tmp_path, suffix, line):
    began = time.process_time()
    check(tmp_path / f"x{suffix}", line + b"\n")
    assert time.process_time() - began < 5  # a reader that backtracks would take hours


def test_another_kind_of_file_a_tool_of_a_file_without_tools_and_a_recording_as_a_program_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.nc"):
        read_toolpath(tmp_path / "part.step")
    with pytest.raises(InputError, match=r"a \.csv file has no tools, so T1 cannot be chosen"):
        read_path_file(tmp_path / "points.csv", tool="T1")
    with pytest.raises(InputError, match=r"a \.mcap file has no tools"):
        read_path_file(tmp_path / "run.mcap", tool="T1")
    with pytest.raises(InputError, match="is a recording, not a program"):
        read_toolpath(tmp_path / "run.mcap")


# --- APT/CL files ---
HEAD = "PARTNO TEST PIECE\nUNITS/MM\nSPINDL/8000,RPM,CLW\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str, suffix: str = ".apt", **choice):
        (tmp_path / f"part{suffix}").write_text(text)
        return read_toolpath(tmp_path / f"part{suffix}", **choice)

    return read


def test_points_feeds_in_mm_or_inches_rapids_tool_axes_and_features_are_read(read):
    # RAPID holds for one move, and a statement may continue in the next line
    path = read(
        HEAD + "FROM/0,0,50\nFEDRAT/600,MMPM\nRAPID\nGOTO/0,0,5\nGOTO/ 0, $\n0, -1\n$$ done\nGOTO/10,0,-1\nFINI\n"
    )
    np.testing.assert_allclose(path.position * 1e3, [[0, 0, 50], [0, 0, 5], [0, 0, -1], [10, 0, -1]])
    assert path.rapid.tolist() == [True, True, False, False] and path.line.tolist() == [4, 7, 8, 11]
    np.testing.assert_allclose(path.feed[2:], 0.01)
    np.testing.assert_allclose(path.spindle_speed, 8000 * 2 * np.pi / 60)
    path = read("UNITS/INCHES\nGOTO/0,0,0\nFEDRAT/60\nGOTO/1,0,0\nFEDRAT/60,MMPM\nGOTO/2,0,0\nFINI\n")
    np.testing.assert_allclose(path.position[:, 0], [0, 0.0254, 0.0508])
    np.testing.assert_allclose(path.feed[1:], [0.0254, 0.001])
    path = read(HEAD + "FEDRAT/600\nGOTO/0,0,0,0,0,1\nGOTO/1,0,0,0.6,0,0.8\nGOTO/2,0,0,0,-0.28,0.96\nFINI\n")
    rotation = rotation_from_quaternion(path.quaternion)
    np.testing.assert_allclose(rotation[0], np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    np.testing.assert_allclose(-rotation[:, :, 2], [[0, 0, 1], [0.6, 0, 0.8], [0, -0.28, 0.96]], atol=1e-12)
    path = read("FEDRAT/600\nGOTO/0,0,0\n$$ circle\nGOTO/1,0,0\nPPRINT/diamond\nGOTO/2,0,0\n$$ two words\nFINI\n")
    assert [path.features[i] for i in path.feature] == ["", "circle", "diamond"]


def test_a_circle_turns_to_the_right_about_its_axis_but_of_nx_and_leads_through_its_points_to_its_goto(read):
    left = read(HEAD + "FEDRAT/600\nGOTO/5,0,0\nCIRCLE/0,0,0,0,0,1,5\nGOTO/0,5,0\nFINI\n")
    right = read(HEAD + "FEDRAT/600\nGOTO/5,0,0\nCIRCLE/0,0,0,0,0,-1,5\nGOTO/0,5,0\nEND\nrubbish\n")
    assert left.length == pytest.approx(0.005 * np.pi / 2) and right.length == pytest.approx(0.005 * np.pi * 3 / 2)
    assert set(left.curvature[1:]) == {200.0} and set(right.curvature[1:]) == {-200.0}
    np.testing.assert_allclose(left.position[-1] * 1e3, [0, 5, 0], atol=1e-12)
    # PTC Creo help, "CL output for circular interpolation": right-hand rule, helices, lists of points
    helix = read(
        "UNITS/INCHES\nFEDRAT / 8.0, IPM\nGOTO / 1.2, 0.0, -0.6\nCIRCLE / 1.0, 0.0, -0.6, $ $$ 1ST ORBIT\n"
        "0.0, 0.0, 1.0, 0.2\nGOTO / 1.2, 0.0, -0.5\nFINI\n"
    )
    turn = 25.4e-3 * np.hypot(0.4 * np.pi, 0.1)
    assert helix.length == pytest.approx(turn, rel=1e-5) and (helix.curvature[1:] > 0).all()
    listed = read(HEAD + "FEDRAT/600\nGOTO/5,0,0\nCIRCLE/0,0,0,0,0,1,5\nGOTO/4,3,0, $\n3,4,0, $\n0,5,0\nFINI\n")
    assert listed.length == pytest.approx(5e-3 * np.pi / 2)
    # NX writes eleven numbers and means k = 1 clockwise: a path along -x, a quarter up to +y, and on without a corner.
    # The sense is that of the documentation of NX ("assuming a clockwise direction") and of tool paths that NX wrote.
    path = read(
        "TOOL PATH/TRIM,TOOL,MILL\nFEDRAT/MMPM,600\nGOTO/8,-2,0\nGOTO/0,-2,0\n"
        "CIRCLE/0,0,0,0,0,1,2,0.06,0.5,10,0\nGOTO/-2,0,0\nGOTO/-2,6,0\nEND-OF-PATH\n"
    )
    assert path.length == pytest.approx(8e-3 + 2e-3 * np.pi / 2 + 6e-3) and path.curvature.min() == -500.0
    ends = path.tangent(np.arange(1, len(path)), path.plane_length[1:])
    starts = path.tangent(np.arange(1, len(path)), np.zeros(len(path) - 1))
    np.testing.assert_allclose(starts[1:], ends[:-1], atol=1e-9)


def test_a_feed_per_revolution_goes_with_the_spindle_and_tools_and_what_moves_nothing_are_noted(read):
    path = read("SPINDL/RPM,6000,CCLW\nGOTO/0,0,0\nFEDRAT/0.2,MMPR\nGOTO/1,0,0\nGODLTA/0,2,0\nFINI\n")
    np.testing.assert_allclose(path.feed[1:], 0.02)
    assert path.program.spindle_speeds == pytest.approx((-200 * np.pi,))
    np.testing.assert_allclose(path.position[-1] * 1e3, [1, 2, 0])
    path = read(
        "PARTNO BRACKET\nMULTAX/OFF\nMSYS/0,0,0,1,0,0,0,1,0\nLOADTL/3\nCUTTER/12,0\nCOOLNT/ON\nFEDRAT/600\nGOTO/0,0,5\n"
        "GOTO/0,0,0\nCOOLNT/OFF\nGOHOME\nRAPID\nGOTO/9,9,5\nFINI\n"
    )
    program = path.program
    assert program.title == "BRACKET" and program.tool == "T3"
    assert program.current.diameter == pytest.approx(0.012)
    assert dict(program.read_over)["COOLNT"] == 2
    np.testing.assert_allclose(path.position[2:] * 1e3, [[0, 0, 5], [9, 9, 5]])  # up first


def test_a_cutter_is_that_of_the_next_cut_before_and_after_the_change_of_the_tool(read):
    lines = "FEDRAT/600\nGOTO/0,0,0\nCUTTER/10\nLOADTL/1\nGOTO/1,0,0\nCUTTER/6,3\nTOOLNO/2\nLOADTL/2\nGOTO/2,0,0\n"
    tools = read(lines + "LOADTL/3\nCUTTER/8,1\nGOTO/3,0,0\nFINI\n", tool="T2").program.tools
    assert [(tool.diameter, tool.corner_radius) for tool in tools] == [(0.01, 0), (0.006, 0.003), (0.008, 0.001)]


def test_a_spindle_stops_at_a_change_of_the_tool_and_goes_on_in_its_sense(read):
    path = read("SPINDL/60,CCLW\nFEDRAT/600\nGOTO/0,0,0\nLOADTL/1\nGOTO/1,0,0\nSPINDL/ON\nGOTO/2,0,0\nFINI\n")
    assert path.spindle_speed[-2:] == pytest.approx([0, -2 * np.pi])


def test_a_single_length_leads_along_the_tool_axis(read):
    path = read("FEDRAT/600\nGOTO/0,0,0,0.6,0,0.8\nGODLTA/-5\nFINI\n")
    np.testing.assert_allclose(path.position[-1] * 1e3, [-3, 0, -4])


CYCLES = {  #: the statement, and in G-code the same hole at a point 1 mm high, from 20 mm
    "CYCLE/DRILL,6.0,250.0,MMPM,3.0": "G99 G81 Z-5 R4 F250",
    "CYCLE/DRILL,  6.000000,MMPM,  250.000000,RAPTO,  $\n  3.000000": "G99 G81 Z-5 R4 F250",
    "CYCLE / DRILL, DEPTH, 6, MMPM, 250, CLEAR, 3": "G99 G81 Z-5 R4 F250",
    "CYCLE / DRILL, DEPTH, 6, MMPM, 250, CLEAR, 3, RETURN, 0": "G98 G81 Z-5 R4 F250",
    "CYCLE/DRILL,RAPTO,3.0,FEDTO,-6.0,RTRCTO,AUTO,MMPM,250.0": "G98 G81 Z-5 R4 F250",
    "CYCLE/DRILL,DEEP,STEP,2,CLEAR,3,FEDTO,-6,RTRCTO,AUTO,MMPM,250": "G98 G83 Z-5 R4 Q2 F250",
    "CYCLE / DEEP, DEPTH, 6, STEP, 2, MMPM, 250, CLEAR, 3": "G99 G83 Z-5 R4 Q2 F250",
    "CYCLE/DEEP,6,250,MMPM,3,2": "G99 G83 Z-5 R4 Q2 F250",
    "CYCLE/BRKCHP,DEPTH,6,STEP,2,IPM,10,CLEAR,3": "G99 G73 Z-5 R4 Q2 F254",
    "CYCLE/REAM,DEPTH,6,MMPR,0.25,CLEAR,3": "G99 G85 Z-5 R4 F250",
    "CYCLE/FACE,DEPTH,6,CLEAR,3,DWELL,1": "G99 G82 Z-5 R4 F777",
}


@pytest.mark.parametrize("statement", CYCLES)
def test_a_cycle_makes_the_holes_of_its_g_code_and_its_feed_ends_with_it(read, statement):
    apt = f"""UNITS/MM
SPINDL/1000,RPM,CLW
FEDRAT/777,MMPM
RAPID
GOTO/0,0,20
{statement}
GOTO/10,0,1
GOTO/20,5,1
CYCLE/OFF
RAPID
GOTO/30,5,20
GOTO/30,5,3
FINI
"""
    g_code = f"""G21 G90 S1000 M3 F777
G0 X0 Y0 Z20
{CYCLES[statement]} X10 Y0
X20 Y5
G80
G0 X30 Y5 Z20
G1 Z3 F777
M30
"""
    path, expected = read(apt, ".apt"), read(g_code, ".nc")
    np.testing.assert_allclose(path.position, expected.position, atol=1e-12)
    np.testing.assert_allclose(path.feed, expected.feed, rtol=1e-12)
    assert (path.rapid == expected.rapid).all() and (path.drilling == expected.drilling).all()
    if "CLEAR, 3" in statement:  # the distance of a return counts from the point too
        path = read(apt.replace("CLEAR, 3", "CLEAR, 3, RETURN, 8").replace("8, RETURN, 0", "8"), ".apt")
        at_hole = path.position[:, 0] == 0.01
        assert path.position[at_hole, 2].tolist()[-2:] == pytest.approx([0.004, 0.009])


# --- Tool paths from CSV ---
HEADER = "x_mm,y_mm,z_mm,feed_mm_per_min\n"
TURNED = HEADER.replace("feed", "a_deg,b_deg,c_deg,feed")


def test_points_feeds_and_kuka_angles_of_a_table_are_read_in_their_units(read):
    path = read(HEADER + "0,0,0,600\n\n1,2,3,1200\n", ".csv")
    np.testing.assert_allclose(path.position, [[0, 0, 0], [0.001, 0.002, 0.003]])
    np.testing.assert_allclose(path.feed, [0.01, 0.02])
    assert path.line.tolist() == [2, 4] and path.rapid.tolist() == [True, False]
    other = read("feed_m_per_min, z_m, y_m, x_m\n0.6,0,0,0\n1.2,0.003,0.002,0.001\n", ".csv")
    np.testing.assert_allclose(other.position, path.position)
    np.testing.assert_allclose(other.feed, path.feed)
    path = read(TURNED + "0,0,0,0,0,180,60\n1,0,0,10,20,150,60\n", ".csv")
    expected = rotation_from_abc(np.radians([[0, 0, 180], [10, 20, 150]]))
    np.testing.assert_allclose(rotation_from_quaternion(path.quaternion), expected, atol=1e-14)


REFUSED = {".apt": [
    ("GOTO/0,0,0\nFEDRAT/600\nCIRCLE/0,0,5\n", 3, "CIRCLE"),
    ("GOTO/5,0,0\nFEDRAT/600\nCIRCLE/0,0,0,0,0,1,5,0.1,0.5,9,0,TIMES,2\n", 3, "several turns"),
    ("GOTO/5,0,0\nFEDRAT/600\nCIRCLE/0,0,0,1,0,1,5\nGOTO/-5,0,0\n", 3, "has the length 1.41421"),
    ("GOTO/5,0,0\nFEDRAT/600\nCIRCLE/0,0,0,0,0,1,5\nGOTO/-4,0,0\n", 4, "does not close"),
    ("GOTO/5,0,0\nFEDRAT/600\nGOTO/6,0,0\nCIRCLE/0,0,0,0,0,1,6\nFINI\n", 5, "without the GOTO"),
    *((f"GOTO/5,0,9\n{cycle}\n", 2, words) for cycle, words in (
        ("CYCLE/DRILL,5", "a height to go to"), ("CYCLE/DEEP,5,100,MMPM,2", "if DEEP or BRKCHP, STEP"),
        ("CYCLE/TAP,5,100,MMPM,2", "TAP; let the CAM output drilling as GOTO"),
        ("CYCLE/DRILL,DEPTH,5,CLEAR,2,RAPTO,1", "the second is RAPTO"),
        ("CYCLE/DRILL,5,100,2", "3 numbers and 0 units"),
        ("CYCLE/DRILL,5,100,MMPM,2,1,1", "5 numbers"), ("CYCLE/DRILL,FEDTO,-5,RAPTO,2,RTRCTO,MANUAL", "MANUAL"))),
    *((f"GOTO/0,0,9\nCYCLE/DRILL,5,100,MMPM,2\n{line}\nGOTO/1,1,0\n", 3, "before CYCLE/OFF")
      for line in ("RAPID", "FEDRAT/100,MMPM", "LOADTL/2", "GODLTA/1,1,1", "CIRCLE/0,0,0,0,0,1,5", "GOHOME")),
    ("GOTO/5,0,0\nCUTCOM/LEFT\n", 2, "CUTCOM: let the CAM output the path of the tool's centre"),
    ("GOTO/0,0,0\nFEDRAT/0.1,MMPR\nGOTO/1,0,0\n", 3, "without a feed"), ("SPINDL/800,SFM\n", 1, "SFM"),
    ("LOADTL/1\nFEDRAT/9\nGOTO/0,0,0\nGOTO/1,0,0\nLOADTL/2\nGOTO/2,0,0\n", 5, "2 tools: T1 from line 1, T2"),
    ("GOTO/0,0,0\nMSYS/0,0,0,1,0,0,0,1,0\n", 2, "MSYS"), ("GOTO/0,0,0\nFEDRAT/0\nGOTO/1,0,0\n", 3, "zero feed"),
    ("GOTO/0,0,0\nFEDRAT/-5\n", 2, "-5"), ("GOTO/0,0,0\nFEDRAT/0.1,MMPM,IPM\n", 2, "FEDRAT"),
    ("FEDRAT/9\nGOTO/0,0,0\nLOADTL/1\nCUTTER/8\nGOTO/1,0,0\nCUTTER/6\nLOADTL/1\nGOTO/2,0,0\n", 8, "second size of T1"),
    ("LOADTL/1\nCUTTER/0.5\nUNITS/INCHES\n", 3, "after lengths that are read in mm"),
    ("GOTO/0,0,nan\n", 1, "NAN"), ("GOTO/0,0\n", 1, "not 2 numbers"), ("GOTO/0,0,0,0,0,2\n", 1, "length 2"),
    ("GOTO/0,0,0,0,0,-1\n", 1, "below"), ("UNITS/FURLONGS\n", 1, "FURLONGS"),
    ("GOTO/0,0,0\nFEDRAT/600\nGOTO/1,0,0", 3, "cut off"), ("GOTO/0,0,0\nFEDRAT/600\nGOTO/1,$\n", 3, "continued"),
    ("GOTO/0,0,0\n{}\n", 2, "no APT statement"),
], ".csv": [
    ("x,y,z,feed\n0,0,0,1\n", 1, "x_mm"), ("0,0,0,600\n1,0,0,600\n", 1, "not a known column"),
    ("x_mm,y_mm,z_mm\n0,0,0\n", 1, "header must be"), ("x_mm,x_mm,y_mm,z_mm,feed_mm_per_min\n", 1, "x_mm"),
    (HEADER + "0,0,0,600\n1,0,0,60", 3, "cut off"), (HEADER, 1, "no row"),
    *((f"{HEADER}0,0,0,600\n{row}\n", 3, word) for row, word in (
        ("1,0,0", "3 values"), ("1,0,nan,600", "z_mm is not finite"), ("1,0,1_0,600", "1_0"), ("1,0,0,0", "zero feed"),
        ("1,0,0,-1", "out of range"), ("1e9,0,0,600", "wrong unit"))),
]}  # fmt: skip


@pytest.mark.parametrize("row", [(kind, *row) for kind in REFUSED for row in REFUSED[kind]])
def test_what_cannot_be_run_is_refused_with_line_and_word(read, row):
    suffix, text, line, word = row
    with pytest.raises(InputError, match=word) as caught:
        read(text, suffix)
    assert caught.value.line == line and "\n" not in str(caught.value)


# --- Arcs to chords ---
finite = st.floats(-0.2, 0.2)


@given(finite, finite, st.floats(1e-4, 0.2), st.floats(0, 6.28), st.floats(0.01, 6.27), st.booleans())
def test_chords_lie_within_the_tolerance_of_the_arc_and_end_on_it(x, y, radius, first, sweep, clockwise):
    sign = -1 if clockwise else 1
    start, end = ((x + radius * math.cos(a), y + radius * math.sin(a), 0.0) for a in (first, first + sign * sweep))
    points, curvature, around = arc_points(start, end, (x, y), clockwise, 1e-9, 2e-6)
    corners = np.vstack([start, points]) - [x, y, 0]
    middles = (corners[1:] + corners[:-1]) / 2
    assert np.abs(np.hypot(*corners[:, :2].T) - radius).max() < 1e-12
    assert (radius - np.hypot(*middles[:, :2].T)).max() <= 2e-6 + 1e-15  # of a chord the middle lies furthest inside
    half = np.hypot(*np.diff(corners[:, :2], axis=0).T) / 2
    length = np.sum(2 * radius * np.arcsin(np.minimum(half / radius, 1)))
    assert length == pytest.approx(radius * sweep, rel=1e-6, abs=1e-9) and around == pytest.approx(radius * sweep)
    assert curvature == pytest.approx(sign / radius) and tuple(points[-1]) == end


@given(finite, finite, finite, finite, st.floats(0.6, 3), st.booleans(), st.booleans())
def test_the_centre_found_from_a_radius_is_as_far_from_both_ends_and_gives_the_right_one_of_the_arcs(
    x0, y0, x1, y1, factor, clockwise, longer
):
    chord = math.hypot(x1 - x0, y1 - y0)
    if chord < 1e-3:
        return
    radius = factor * chord * (-1 if longer else 1)
    centre = centre_from_radius((x0, y0), (x1, y1), radius, clockwise, 1e-9)
    assert math.dist(centre, (x0, y0)) == pytest.approx(abs(radius)) == math.dist(centre, (x1, y1))
    points, _, _ = arc_points((x0, y0, 0.0), (x1, y1, 0.0), centre, clockwise, 1e-9, 1e-6)
    path = np.vstack([(x0, y0, 0.0), points])
    length = np.hypot(*np.diff(path[:, :2], axis=0).T).sum()
    minor = 2 * abs(radius) * math.asin(chord / 2 / abs(radius))
    assert length == pytest.approx(2 * math.pi * abs(radius) - minor if longer else minor, rel=2e-2)


def test_equal_start_and_end_mean_a_full_circle_in_either_sense_and_a_chord_beyond_the_diameter_does_not_close():
    for clockwise in (True, False):
        points, _, _ = arc_points((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0), clockwise, 1e-9, 1e-6)
        turn = np.unwrap([math.atan2(y, x) for x, y, _ in points])
        assert turn[-1] - turn[0] == pytest.approx((-1 if clockwise else 1) * 2 * math.pi * (1 - 1 / len(points)))
    with pytest.raises(ArcError, match="does not close"):
        centre_from_radius((0.0, 0.0), (0.1, 0.0), 0.0499, True, 10e-6)
    centre_from_radius((0.0, 0.0), (0.1, 0.0), 0.049995, True, 10e-6)


def test_a_reader_of_another_package_ends_in_one_sentence_with_file_and_line(tmp_path, monkeypatch):
    def read(path):
        builder, moves = PathBuilder(path), Path(path).read_text(encoding="utf-8").split()
        for number, feed in enumerate(moves, 1):
            builder.move((1e-3 * number, 0.0, 0.0), float(feed), number == 1, number)
        return builder.build()

    monkeypatch.setitem(sys.modules, "somebodys", SimpleNamespace(read=read))
    monkeypatch.setitem(READERS, ".mine", PathReader("somebodys", "read"))
    monkeypatch.setitem(READERS, ".gone", PathReader("no_such_module", "read"))
    for name, data, sentence in (
        ("a.mine", b"1 1 0", "a.mine, line 3: a cutting move needs a feed above 0"), ("b.mine", b"\xe9", "UTF-8"),
        ("c.gone", b"1 1", "c.gone: its reader no_such_module:read cannot be imported"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=sentence):
            read_path_file(tmp_path / name)
