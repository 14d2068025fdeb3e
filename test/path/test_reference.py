"""G-code as LinuxCNC's interpreter runs it: kind of each move, end point, length of arcs with their turns, and feed."""

from __future__ import annotations

import math
import random
import re

import numpy as np
import pytest
from budget import budget
from samples.rs274 import RS274, difference, ours, random_program

from kr270_milling.base.errors import InputError
from kr270_milling.path.cam.gcode import flow
from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.reader import read_gcode

SAME_START = "G10 L2 P1 X0 Y0 Z0\nG10 L2 P2 X0 Y0 Z0\nG21 G90 G17\nF600\nG0 X0 Y0 Z5\nG1 Z0\n"
#: a program after its start -> ends of its cutting moves [mm], which rs274 2.9 gives, too
ENDS = {
    "#1=3\n#5599=1 #1=4 X#1\nX#1": [3, 4],  # an assignment counts after its line
    "X[2**3**2] Y[-2**2]\nX[7 MOD -3]\nX[ATAN[1]/[1]]": [(64, 4), 1, 45],
    "X[1 OR 0 AND 0] Y9\nX[ROUND[-2.5]]\nX[1 EQ 1.00005]": [(0, 9), -3, 1],
    "#<a b>=7\nX#<AB>\n#<_g>=8\nX#<_g>": [7, 8],
    "o1 sub\nX#1 Y#2\n#1=99\no1 endsub [#1+1]\n#1=5\no1 call [7]\nX#1\nX#<_value>": [(7, 0), 5, 100],
    "o1 repeat [3]\no2 if [#<_x> GT 4]\nX0\no2 elseif [#<_x> LT 1]\nX2\no2 else\nX9\no2 endif\no1 endrepeat": [2, 9, 0],
    "#1=0\no1 while [1]\n#1=[#1+1]\no2 if [#1 EQ 2]\no1 continue\no2 endif\no3 if [#1 GT 3]\no1 break\no3 endif\n"
    "X#1\no1 endwhile": [1, 3],
    "#1=2\no1 do\nX#1\n#1=[#1-1]\no1 while [#1 GT 0]": [2, 1],
    "#1=1\nM98 P7 L2\nM30\nO7\nX#1\n#1=[#1+1]\nM99": [1, 2],
    "G92 X10\nX0\nG92.2\nX0\nG92.3\nX0\nG92.1\nX0": [-10, 0, -10, 0],
    "G10 L2 P1 X1\nG1 X0\nG10 L2 P1 R90 X1\nX3 Y0": [1, (1, 3)],
    "G10 L2 P2 X5\nG55\nG1 X1\nG10 L20 P0 X4\nX1\nG54\nG1 X1": [6, 3, 1],
    "G52 X4\nX1\nG52 X0\nX1": [5, 1],
    "G52 X4\nX1\nG92.2\nX2\nG92.3\nX3\nG92.1\nX4": [5, 2, 7, 4],
    "G10 L2 P1 X1 Y2 Z3\nG1 X0\nG53 X5 Z4\nX2 Y0": [1, (5, 0, 4), (3, 2, 4)],
    "G81 X1 Z-2 R1\nG53 G1 X9 Z-1\nX5": [(1, 0, -2), (9, 0, -1), (5, 0, -1)],  # G1 ends the cycle
    # around an outside corner, into an inside one, onto an arc, out
    "G41.1 D4\nX10\nX20\nY-10\nX30\nG40\nX50": [(10, 2), (20, 2), (22, 0), (22, -8), (30, -8), (50, -10)],
    "G41.1 D4\nG3 X10 Y10 J10\nG1 Y20\nG40\nG1 X-9": [(8, 10), (8, 20), (-9, 20)],
    "G41.1 D-4\nX10\nG3 X15 Y5 J5\nG40\nG1 X30": [(10, -2), (17, 5), (30, 5)],
    "G41.1 D4\nX10\nG3 X15 Y5 J5\nG1 X5\nG40\nX-9": [(10, 2), (math.sqrt(5) + 10, 3), (5, 3), (-9, 5)],
    "#1=41.1\nG#1 D4\nX10\nG40\nG1 X20": [(10, 2), (20, 0)],
    "G41.1 D4\nX10\nG0 Z5\nG40\nG0 Z5\nG1 X20": [(10, 2, 0), (20, 0, 5)],  # beside the contour at its height
    # around a cusp of two arcs, and into it: the tool of radius 0.5 touches circles of 4.5 and 2.5, 3 apart
    "G41.1 D1\nX10\nG3 X15 Y5 J5\nG2 X13 Y3 I-2\nG1 X9\nG40\nX0": [
        (10, 0.5),
        (10 + 23 / 6, 5 - math.sqrt(4.5**2 - (23 / 6) ** 2)),
        (13, 2.5),
        (9, 2.5),
        (0, 3),
    ],
    "G42.1 D1\nX10\nG3 X15 Y5 J5\nG2 X13 Y3 I-2\nG1 X9\nG40\nX0": [
        (10, -0.5),
        (15.5, 5),
        (14.5, 5),
        (13, 3.5),
        (9, 3.5),
        (0, 3),
    ],
    "G18\nG41.1 D4\nZ10\nX10\nG40\nX20 Z0": [(2, 0, 8), (10, 0, 8), (20, 0, 0)],
    "X EXISTS[#9] Y EXISTS[#99999]": [(1, 0)],
    # back along the same line: around its end
    "G41.1 D4\nX20\nX0 Y0.0000001\nG40\nX-9": [(20, 2), (20, -2), (0, -2), (-9, 0)],
    "G83 X1 Z-6.5 R2 Q1.7": [(1, 0, 0.3), (1, 0, -1.4), (1, 0, -3.1), (1, 0, -4.8), (1, 0, -6.5)],
    "o1 sub\nM73\nG91 G20\nG55\nX1\no1 endsub\no1 call\nX9\nM70 G91 G20\nX1\nM72\nX1": [25.4, 9, 34.4, 1],
    "o1 sub\nM73\nG91\nM71\no1 endsub\no1 call\nX4\nX1": [4, 5],
    "o1 sub\nM73\nM70\nG91\no1 endsub\no1 call\nX4\nX1": [4, 1],
    # whether G92 or G52 shifts is a mode, by how much is not
    "o1 sub\nM73\nG52 X4\nX1\no1 endsub\no1 call\nX2\nG92.3\nX3": [5, 2, 7],
    "o1 sub\nM73\nG92 X4\no1 endsub\nG52 X0\no1 call\nX0": [-4],
    "G92 X10\nM70\nG92.2\nM72\nX0\nG92 X4\nM72\nX0": [-10, -14],
    "@10 ^90\n^0\nG91 @2 ^[180-90]": [(0, 10), (10, 0), (0, 12)],
    "G18 G98 G81 X3 Z-2 Y-4 R1": [(3, -4, -2)],
    # a cycle continues, whatever moves the coordinates
    "G10 L2 P2 X50\nG99 G81 X1 Z-2 R1\nG55\nX2\nG52 Y4 Z1\nX3\nG28 Z9\nX4 Y0": [
        (1, 0, -2),
        (52, 0, -2),
        (53, 0, -1),
        (54, 4, -1),
    ],
}
#: the same for words that LinuxCNC has not, by their definition
OTHER_ENDS = {
    "X10,R2\nY10,C3\nX20": [8, (10, 2), (10, 7), (13, 10), 20],
    "X10 RND=2\nY10 CHF=3\nX20": [8, (10, 2), (10, 10 - 1.5 * math.sqrt(2)), (10 + 1.5 * math.sqrt(2), 10), 20],
    "G16 X10 Y90\nY0\nG15\nX3": [(0, 10), (10, 0), (3, 0)],
    "G81 Z-2 R1 L0\nG70 I5 J90 L2\nX30\nG71 X0 Y0 I5 K90 L2\nG72 X0 Y1 I4 L2": [
        (0, 5),
        (0, -5),
        (30, -5),
        (5, 0),
        (0, 5),
        (0, 1),
        (4, 1),
    ],
    "G10 L12 P1 R1\nG41 D1\nX10\nX20,R4\nY10\nG40 Y30": [(10, 1), (16, 1), (19, 4), (19, 10), (20, 30)],
    "G76 X3 Y0 Z-2 R1 Q0.2 P1\nG80": [(3, 0, -2)],
    "G68 X0 Y0 R90\nX5\nG69\nX5": [(0, 5), (5, 5)],
    "M97 P5 L2\nM30\nN5 G91 X1\nM99": [1, 2],
    "G65 P9 A1.5 X4\nM30\nO9\nX#1 Y#24\nM99": [(1.5, 4)],
    "#1=1\nWHILE [#1 LE 2] DO1\nX#1\n#1=[#1+1]\nEND1\nIF [#1 EQ 3] GOTO 9\nX50\nN9 Y1": [1, 2, (2, 1)],
    "IF [2 GT 1] THEN X7\nGOTO 20\nX1\nN20 X8": [7, 8],
    "IF [2 GT 1] THEN #9=7\nX#9": [7],
    "R1=2 R2=R1*(3+1)\nX=R2 Y=SQRT(R1*8)\nL7 P2\nM30\n%_N_L7_SPF\nG91 X=R1\nM17": [(8, 4), (10, 4), (12, 4)],
}
REFUSED = {
    "o1 sub\no1 call\no1 endsub\no1 call": "more than 10 sub-programs call one another",
    "o1 while [1]\no1 endwhile": "runs more than 1000 lines",
    "o1 if [1]\nX1": "IF of 1 has no end",
    "o1 sub\no2 sub\no2 endsub\no1 endsub": "defined in another sub-program",
    "o1 break": "in no loop",
    "M72": "M72 without M70",
    "o1 sub\nM70\nM71\nM72\no1 endsub\no1 call": "M72 without M70",
    "G41.1 D4\nM70\nX9\nM72": "M72 .* while G41",
    **dict.fromkeys(("X[1/0]", "X[SQRT[-1]]", "X[0**-1]", "X[ASIN[2]]", "X[9**99]"), "no result"),
    **dict.fromkeys(("X#9", "X#<a>", "#1=#0", "X#5161"), "has no value|is no parameter"),
    **dict.fromkeys(("#5220=1", "#<_x>=1"), "belongs to the control"),
    **dict.fromkeys(("X[1", "X[", "X" + "[" * 200, "X[1+]", "#1", "X ATAN[1]", "EXISTS[1]"), "bracket|value|word"),
    **dict.fromkeys(("G92 X5\nG52 X1", "G52 X1\nG92 X5"), "controls differ"),
    "G41 D1\nX10": "radius of the tool is not known",
    "G41.1 D4\nX2": "longer than the radius of the tool",
    "G41.1 D4\nX9\nG3 X9 Y4 J2": "not larger than the radius of the tool",
    "G41.1 D4\nX9\nX8 Y1\nX0 Y0": "does not fit into the corner",
    "G41.1 D4\nX20\nX0 Y0.5": "almost half a turn",
    "G41.1 D4\nX9\nG28 Z0": "a move home while G41",
    "G41.1 D4\nX9\nG42.1 D4\nX20": "without G40",
    "G41.1 D4\nX9\nG40\nZ5": "after the compensation is along z",
    "F1E11\nX9": "between 0 and 1e.10",
    "G41.1 D4\nX9\nG5.1 X9 Y9 I2 J2": "straight moves and arcs",
    **dict.fromkeys(("@1 X2", "G18 @3 ^2", "G16 G91 X3"), "a radius and an angle"),
    "@5": "alone at the origin",
    "G81 X1 Z-2 R1 L0\nG70 I5 L3": "not all known",
    "G70 I5 L3": "circle of holes on Haas",
    "X9,R20\nY9": ",R does not fit",
    "G54\nG1 X5\nG56\nX6": "2 work offsets: G54 .* state their places with path.offsets_mm",
    "M98 P7\nO7\nX1\nM99": "runs into a sub-program",
    "M98 P7 H100\nM30\nO7\nX1\nN100 X2\nM99": "M98 with H, a sub-program from one of its lines on",
    "T1 M6\nG43 H1 X1\nG10 L10 P1 R9": "G10 changes the length of T1",
    "M21\nX5": "without shift, rotation, mirror",
    "G10 L11 P1 R-5": "G10 states the wear of a tool",
    "(abort, no part)": "stops itself",
    "IF [1 GT 0] GOTO 5\nX1\nM30\nN5 #3000=1 (no part)": "#3000 stops the program",
}


def program(tmp_path, lines: str):
    (tmp_path / "part.ngc").write_text(f"{SAME_START}{lines}\n" + ("" if "M30" in lines or "M99" in lines else "M30\n"))
    return tmp_path / "part.ngc"


@pytest.mark.parametrize("lines", [*ENDS, *OTHER_ENDS])
def test_parameters_sub_programs_loops_and_offsets_lead_to_the_right_places(tmp_path, lines):
    file = program(tmp_path, lines)
    path = read_gcode(file)
    cutting = ~path.rapid & ((path.curvature == 0) | (path.curvature != np.roll(path.curvature, -1)))  # ends of arcs
    ends = 1e3 * path.position[1:][cutting[1:]][1:]
    for end, known in zip(ends, (ENDS | OTHER_ENDS)[lines], strict=True):
        known = (known,) if isinstance(known, (int, float)) else known
        assert end[: len(known)] == pytest.approx(known, abs=1e-6)
    if RS274 and lines in ENDS and "[#<_x>" not in lines:
        assert difference(file) == ""


@pytest.mark.parametrize("lines", REFUSED)
def test_a_program_whose_way_or_value_is_not_known_is_refused_with_a_sentence(tmp_path, monkeypatch, lines):
    monkeypatch.setattr(flow, "MOST_BLOCKS", 1000)
    with pytest.raises(InputError, match=REFUSED[lines]) as caught:
        read_gcode(program(tmp_path, lines))
    assert "\n" not in str(caught.value) and caught.value.line


def test_g93_states_the_time_of_the_contour_and_not_of_the_tool_beside_it(tmp_path):
    path = read_gcode(program(tmp_path, "G41.1 D4\nG93 X10 F6\nX20 F5\nG3 X30 Y10 J10 F2\nG40 G94"))
    assert sorted(set((6e4 * path.feed[2:]).round(6))) == [round(10 * math.pi, 6), 50, 60]


def test_the_number_of_a_main_program_may_follow_its_sub_programs(tmp_path):
    (tmp_path / "part.ngc").write_text(f"o2 sub\nX9\no2 endsub\nO1 (main)\n{SAME_START}o2 call\nM30\n")
    assert 1e3 * read_gcode(tmp_path / "part.ngc").position[-1, 0] == pytest.approx(9)


def test_a_program_that_never_states_an_axis_is_refused_with_its_name(tmp_path):
    (tmp_path / "laser.nc").write_text("G21 G0 X0 Y0\nG1 X9 F100\nM30\n")
    with pytest.raises(InputError, match="never states Z"):
        read_gcode(tmp_path / "laser.nc")


def test_work_offsets_of_the_cell_place_the_moves_in_the_workpiece_frame(tmp_path):
    file = tmp_path / "part.nc"
    file.write_text("G21 G90 F600\nG0 X0 Y0 Z5\nG1 Z0\nG55\nG1 X1 Y0 Z0\nG54\nG1 X1 Y1 Z0\nM30\n")
    path = read_gcode(file, offsets=[0, 0, 0, 0, 0.02, 0.003])
    assert (1e3 * path.position[1:]).round(6).tolist() == [[0, 0, 0], [1, 20, 3], [1, 1, 0]]
    with pytest.raises(InputError, match="path.offsets_mm does not state G55"):
        read_gcode(file, offsets=[0.0] * 3)


def test_curves_are_bezier_curves_within_the_tolerance_of_arcs(tmp_path):
    """Their points at any parameter are those of the Bernstein polynomials; G5 without I, J continues smoothly."""
    path = read_gcode(program(tmp_path, "G5 I0 J30 P0 Q-30 X10 Y10\nG5 P0 Q30 X20 Y0\nG5.1 X40 Y40 I10 J0"))
    points = 1e3 * path.position[1:, :2]
    controls = [(0, 30j, 10 - 20j, 10 + 10j), (10 + 10j, 10 + 40j, 20 + 30j, 20 + 0j), (20 + 0j, 30 + 0j, 40 + 40j)]
    t = np.linspace(0, 1, 400)
    for control in controls:
        n = len(control) - 1
        binomial = (1, 3, 3, 1) if n == 3 else (1, 2, 1)
        curve = sum(b * (1 - t) ** (n - k) * t**k * p for k, (b, p) in enumerate(zip(binomial, control, strict=True)))
        start, end = points[:-1, 0] + 1j * points[:-1, 1], points[1:, 0] + 1j * points[1:, 1]
        way = curve[:, None] - start
        share = np.clip((way * np.conj(end - start)).real / np.abs(end - start) ** 2, 0, 1)
        assert np.abs(way - share * (end - start)).min(axis=1).max() < 2e-3


@pytest.mark.parametrize("curve", [
    "G5.2 P1 L3\nX10 Y10 P{w}\nX0 Y10 P1\nG5.3",
    "G6.2 P3 K0 X10 Y0 R1\nK0 X10 Y10 R{w}\nK0 X0 Y10 R1\nK1\nK1\nK1",
])  # fmt: skip
def test_a_rational_curve_with_these_weights_is_a_quarter_circle(tmp_path, curve):
    path = read_gcode(program(tmp_path, f"X10\n{curve}\n".format(w=math.sqrt(0.5)) + "G1 X-5"))
    points = 1e3 * path.position[2:-1, :2]
    np.testing.assert_allclose(np.hypot(*points.T), 10.0, atol=1e-9)
    middle = (points[1:] + points[:-1]) / 2
    assert 10 - np.hypot(*middle.T).min() < 2e-3 and points[-1] == pytest.approx((0, 10))
    with pytest.raises(InputError, match="without its end"):
        read_gcode(program(tmp_path, f"X10\n{curve.rpartition(chr(10))[0].format(w=1)}\nG1 X-5"))


def test_a_row_of_cuts_and_arcs_gives_the_path_of_its_blocks(tmp_path, monkeypatch):
    rng = random.Random(1)
    cuts = ["G1 X1 F600", "X2", "N7 Y3.5", "Z-1", "X1Y2 Z3", "G01 X.5 F600.0", "X0 F300", "G0 Z5", "(wall)", "F1",
            "G91", "G90", "X9E1", "X200000", "G81 Z-1 R1", "N5", "", "G1", "g1x5"]  # fmt: skip
    arcs = ["G2 X1 Y2 R40", "G3 X2 Z1 I1 J-2 F600", "X1", "G2 X2 R.1", "G2 I0", "G2 X8 R9E9", "I1 R1", "G2 I99999",
            "G3 K2", "I-.0005", "G2 X1 Y1 Z0 I.5 J.5 K0"]  # fmt: skip
    circles = {"G17": "G3 I5 J2", "G18": "G2 K-1 Z{} I2", "G19": "N5 G3 J2 X1 K2", "G90.1": "G2 I1 J9"}
    for trial in range(budget(400)):
        plane = rng.choice(("G17", "G18", "G19", "G90.1", "G20"))
        sound = [
            "G2 X{} Y{} Z{} R40",
            "G3 X{} Y{} Z{} R-50",
            "G02X{}Y{}Z{}R70F600",
            "G1 X{} Y{} Z{}",
            circles.get(plane, "G2 I1"),
        ]
        blocks = rng.choices(cuts, k=20) if trial % 3 == 0 else rng.choices(sound, k=30)
        blocks += rng.choices(arcs, k=trial % 2)
        blocks = [re.sub("{}", lambda _: f"{rng.uniform(-9, 9):.3f}", block) for block in blocks]
        (tmp_path / "part.nc").write_text("\n".join(["G21", plane, "G0 X0 Y0 Z0", "F600", *blocks, "M30", ""]))
        results = []
        for watched in (False, True):
            monkeypatch.setattr(Interpreter, "watched", watched)
            try:
                results.append(read_gcode(tmp_path / "part.nc"))
            except InputError as error:
                results.append(str(error))
        path, other = results
        if isinstance(path, str) or isinstance(other, str):
            assert path == other, trial
            continue
        for name in ("feed", "line", "feature"):
            assert np.array_equal(getattr(path, name), getattr(other, name)), trial
        np.testing.assert_allclose(path.position, other.position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(path.curvature, other.curvature, rtol=1e-12)
        assert path.program == other.program, trial


@pytest.mark.parametrize("seed", range(60))
def test_sub_programs_of_other_files_run_as_those_of_the_program(tmp_path, seed):
    """Also beside ``rs274``, which has no folder of sub-programs."""
    rng = random.Random(seed)
    text = random_program(random.Random(seed))
    while "endsub" not in text:
        text = random_program(rng)
    (tmp_path / "whole.nc").write_text(text)
    folder, main = rng.choice((".", "subroutines", "subs")), tmp_path / "split" / "part.ngc"
    (main.parent / folder).mkdir(parents=True)
    for sub, number in re.findall(r"(?s)(O(\d+) sub\n.*?O\2 endsub[^\n]*\n)", text):
        text = text.replace(sub, "")
        name = f"{number}.ngc" if folder == "." else rng.choice((f"{number}.NC", f"O{number}.nc", f"o00{number}"))
        (main.parent / folder / name).write_text("(a sub-program)\n" + sub + "M2\n")
    main.write_text(text)
    (moves, sentence, _), (same, other, _) = ours(tmp_path / "whole.nc"), ours(main)
    assert repr(same) == repr(moves) and re.sub(r"\A\w+(\.\w+)?, line \d+: ", "", other) == sentence
    assert not (RS274 and folder == "." and difference(main).startswith("differs"))


FANUC = "%\nO0007 (POCKET)\nG91 G1 X1 F600\nG90\nM99\n%\n"
BESIDE = "O7\nG41.1 D4\nG1 Y5 F600\nY20\nM99\n"
START = "G21 G90\nT1 M6\nG0 X0 Y0 Z0\n"


@pytest.mark.parametrize(("call", "file", "text", "end"), [
    ("M98 P7", "O0007.nc", FANUC, 1), ("M98 P7 L3", "7", FANUC, 3), ("M98 P20007", "7.ngc", FANUC, 2),
    ("G65 P7", "O7.CNC", FANUC, 1), ("L7 P2", "L007.SPF", "G91 G1 X1 F600\nG90\nM17\n", 2),
    ("L7", "L7.SPF", "%_N_L7_SPF\nPROC L7 SAVE DISPLOF\nG1 X7 F600\nRET\n", 7),
    ("o<a pocket> call [4]", "A Pocket.ngc", "o<a pocket> sub\nG1 X#1 F600\no<a pocket> endsub", 4),
    ("#1=7\nM98 P#1 L2", "7.ngc", FANUC, 2), ("#1=7\nM98 P#1", "7.ngc", BESIDE, -2),
    ("#1=7\no#1 call [4]", "7.ngc", "o7 sub\nG1 X#1 F600\no7 endsub", 4),
    ("M98 P7", "subs/O7.nc", "G1 X5 F600\nM98 P8\nM99\n", 6),
])  # fmt: skip
def test_a_call_finds_the_file_of_its_name_or_number(tmp_path, call, file, text, end):
    (tmp_path / "subs").mkdir()
    (tmp_path / "subs" / "O8.nc").write_text("G1 X6 F600\nM99\n")
    (tmp_path / "part.nc").write_text(f"{START}{call}\nM30\n")
    (tmp_path / file).write_text(text)
    path = read_gcode(tmp_path / "part.nc")
    assert 1e3 * path.position[-1, 0] == pytest.approx(end) and set(path.line[1:].tolist()) == {4 + call.count(chr(10))}
    assert path.program.files[0] == str(tmp_path / file)


@pytest.mark.parametrize(("call", "files", "sentence"), [
    ("M98 P7", {}, "part.nc, line 4: the sub-program O7 is not in this file, and no file of this name that has it"),
    ("M98 P7", {"O8.nc": FANUC}, "O7 is not in this file"),
    ("M98 P7", {"O7.nc": FANUC.replace("7", "8")}, "O7 is not in this file"),  # the file has another one
    ("o<../out> call", {"../out.ngc": "o<../out> sub\no<../out> endsub\n"}, "O<../out> is not in this file"),
    ("o<link> call", {"../link.ngc": "o<link> sub\no<link> endsub\n"}, "O<link> is not in this file"),
    ("M98 P7", {"O7.nc": FANUC, "0007.nc": FANUC}, "0007.nc and O7.nc are the same sub-program; remove one"),
    ("M98 P7", {"O7.nc": "G1 X1 F600\n"}, "line 4: O7.nc, line 3: the sub-program does not end"),
    ("M98 P7", {"O7.nc": "G84 X1 Z-1 R1 F600\nM99"}, "part.nc, line 4: O7.nc, line 1: G84; leave threads"),
    ("#1=7\no[#1] call", {"O7.nc": "o7 sub\no8 sub\no8 endsub\no7 endsub"}, "line 5: O8 is defined in another"),
    ("M98 P7", {"O7.nc": "M98 P7\nM99"}, "O7.nc, line 1: more than 10 sub-programs call one another"),
    ("o<a> call", {"a.ngc": "o<a> sub\no1 sub\no1 endsub\no<a> endsub"}, "a.ngc, line 2: O1 is defined in another"),
    ("M98 P7", {"O7.nc": "\0"}, "O7.nc, line 1: holds a zero byte"),
    ("M98 P7", {"O7.nc": "G1 X1" * 4_000_000}, "O7.nc: has more than 16000000 bytes"),
    ("M98 P1", {f"O{n}.nc": f"M98 P{n + 1}\nM99" for n in range(1, 120)}, "sub-programs of more than 100 files"),
])  # fmt: skip
def test_a_sub_program_of_a_file_is_refused_with_one_sentence_that_names_the_file(tmp_path, call, files, sentence):
    folder = tmp_path / "programs"
    folder.mkdir()
    (folder / "part.nc").write_text(f"{START}{call}\nM30\n")
    for name, text in files.items():
        (folder / name).write_text(text)
    (folder / "link.ngc").symlink_to(tmp_path / "link.ngc")
    with pytest.raises(InputError) as error:
        read_gcode(folder / "part.nc")
    assert sentence in str(error.value)


def test_a_length_of_the_tool_by_g43_1_leaves_the_height_to_the_next_z(tmp_path):
    part = tmp_path / "part.nc"
    part.write_text(f"{START}G43.1 Z-50\nG0 Z5\nG1 X9 F600\nM30\n")
    assert (1e3 * read_gcode(part).position[-1]).tolist() == pytest.approx([9, 0, 5])
    for wrong in ("G43.1 Z-50\nG1 X9 F600", "G43.1 H1\nG0 Z5\nG1 X9 F600", "G0 G43.1 Z5\nG1 X9 F600"):
        part.write_text(f"{START}{wrong}\nM30\n")
        with pytest.raises(InputError):
            read_gcode(part)


@pytest.mark.skipif(not RS274, reason="rs274 of LinuxCNC is not installed (linuxcnc-uspace); RS274 may name it")
def test_random_programs_run_as_in_linuxcnc_or_are_refused(tmp_path):
    results: dict[str, int] = {}
    for seed in range(10_000 if budget(100) == 100 else 300):
        (tmp_path / "part.ngc").write_text(random_program(random.Random(seed)))
        result = difference(tmp_path / "part.ngc")
        results[result.partition(":")[0]] = results.get(result.partition(":")[0], 0) + 1
        assert not result.startswith("differs"), (seed, result)
    assert results[""] > 0.7 * sum(results.values()), results
