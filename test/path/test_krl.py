"""KRL programs as posts write them: moves, feeds, words; random programs against their own arithmetic."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import TOOL0, Pose
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cli import main
from kr270_milling.decide.inputs import input_violations
from kr270_milling.path.cam.krl import _KrlReader
from kr270_milling.path.cam.krl_values import KrlError, evaluated
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.cam.readers import read_toolpath

SAMPLES = Path(__file__).parents[1] / "samples" / "krl"
DOWN = "A 0,B 0,C 180"


def written(tmp_path, *lines: str, name: str = "part.src") -> Path:
    (tmp_path / name).write_text("\n".join(["DEF PART( )", *lines, "END", ""]))
    return tmp_path / name


def cut_rows(path) -> np.ndarray:
    return np.flatnonzero(~path.rapid[1:]) + 1


@pytest.mark.parametrize("file", sorted(SAMPLES.glob("*.src")), ids=lambda file: file.stem)
def test_a_program_in_the_style_of_a_post_has_the_moves_that_its_first_line_expects(file):
    expected = re.match(r"; \(expect: (\d+) cuts, (.*) mm, feeds (.*) mm/s, E1 (.*), (.*)\)", file.read_text())
    path = read_toolpath(file)
    cuts = cut_rows(path)
    (tool,) = path.program.tools
    assert tool.cuts == int(expected[1])
    assert 1e3 * path.block_length[cuts].sum() == pytest.approx(float(expected[2]), abs=0.006)
    feeds = sorted({f"{1e3 * feed:.4g}" for feed in path.feed[cuts]}, key=float)
    assert " ".join(feeds) == expected[3]
    assert path.program.external[0] == float(expected[4])
    assert {name for name in path.features if name and name != tool.name} == {expected[5]} - {""}
    axis = np.array([1 - 2 * (path.quaternion[:, 0] ** 2 + path.quaternion[:, 1] ** 2)])
    assert axis == pytest.approx(-1.0)  # z of tcp points down, whichever axis of $TOOL is the tool's


def moves_of(draw) -> tuple[list[str], list[tuple[float, ...]]]:
    """Lines of a program and the ends [mm] of its moves, by other arithmetic than the reader's."""
    number = st.integers(-5000, 5000).map(lambda n: n / 100)
    place, lines, ends = [0.0, 0.0, 0.0], [f"LIN {{X 0,Y 0,Z 0,{DOWN}}}"], []
    for kind in draw(st.lists(st.sampled_from(["LIN", "REL", "FRAME", "LOOP", "CIRC", "VARIABLE", "IF"]), max_size=8)):
        x, y, z = draw(number), draw(number), draw(number)
        if kind == "LIN":
            keys = draw(st.sets(st.sampled_from("XYZ"), min_size=1))
            lines.append(f"LIN {{{','.join(f'{k} {v}' for k, v in zip('XYZ', (x, y, z), strict=True) if k in keys)}}}")
            place = [v if k in keys else p for k, v, p in zip("XYZ", (x, y, z), place, strict=True)]
        elif kind == "REL":
            lines.append(f"SLIN_REL {{X {x},Z {z}}} #BASE")
            place = [place[0] + x, place[1], place[2] + z]
        elif kind == "FRAME":
            angle = draw(st.sampled_from([0, 90, 180, -90]))
            lines += [f"F={{X {x},Y {y},Z {z},A {angle},B 0,C 0}}:{{X 10,Y 5,Z 1,A {-angle},B 0,C 180}}", "LIN F C_DIS"]
            turned = complex(10, 5) * {0: 1, 90: 1j, 180: -1, -90: -1j}[angle]
            place = [x + turned.real, y + turned.imag, z + 1]
        elif kind == "LOOP":
            count = draw(st.integers(1, 4))
            lines += [f"FOR I=1 TO {count}", "LIN_REL {Y 1.5}", "ENDFOR"]
            ends += [(place[0], place[1] + 1.5 * k, place[2]) for k in range(1, count)]
            place = [place[0], place[1] + 1.5 * count, place[2]]
        elif kind == "CIRC":
            radius = abs(x) + 1
            lines.append(f"CIRC_REL {{X {radius},Y {radius}}},{{X {2 * radius}}}")
            place = [place[0] + 2 * radius, place[1], place[2]]
        elif kind == "VARIABLE":
            lines += [f"D={x}*2-({y})/4", "P.X=D", f"P.Y={y}", "LIN P"]
            lines.insert(0, f"P={{X 0,Y 0,Z {place[2]}}}") if "P={" not in "".join(lines) else lines.insert(
                -1, "P.Z=$POS_ACT.Z"
            )
            if lines[-2] != "P.Z=$POS_ACT.Z":
                lines.insert(-1, "P.Z=$POS_ACT.Z")
            place = [2 * x - y / 4, y, place[2]]
        else:
            lines += [f"IF ({x} > {y}) OR NOT ({z} < 0) THEN", "LIN_REL {Z 1}", "ELSE", "LIN_REL {Z 2}", "ENDIF"]
            place = [place[0], place[1], place[2] + (1 if x > y or not z < 0 else 2)]
        ends.append(tuple(place))
    return lines, ends


@given(st.data())
@settings(max_examples=200)
def test_the_ends_of_random_programs_are_those_of_other_arithmetic(tmp_path_factory, data):
    lines, ends = moves_of(data.draw)
    file = written(tmp_path_factory.mktemp("krl"), "$VEL.CP=0.05", *lines, "LIN {X 1,Y 2,Z 3}", "LIN {X 9,Y 9,Z 9}")
    path = read_toolpath(file)
    places = [(0.0, 0.0, 0.0), *ends, (1, 2, 3), (9, 9, 9)]
    places = [p for k, p in enumerate(places) if not k or math.dist(p, places[k - 1]) > 1e-9]
    places_mm = 1e3 * path.position
    at = -1
    for place in places:  # in this order; chords of arcs lie between them
        at = next(k for k in range(at + 1, len(places_mm)) if math.dist(places_mm[k], place) < 1e-6)
    assert at == len(places_mm) - 1


@pytest.mark.parametrize("angle", [30.0, 180.0, 360.0, 725.0, -45.0])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_an_arc_with_a_stated_angle_has_its_length_and_keeps_its_radius(tmp_path, angle, tilt):
    c, s = math.cos(tilt), math.sin(tilt)
    aux, end = (10, 10 * c, 10 * s), (0, 20 * c, 20 * s)
    point = "{{X {:.12g},Y {:.12g},Z {:.12g}}}".format
    file = written(
        tmp_path, "$VEL.CP=0.05", f"LIN {{X 0,Y 0,Z 0,{DOWN}}}", f"CIRC {point(*aux)},{point(*end)}, CA {angle}"
    )
    path = read_toolpath(file)
    centre = np.array([0, 10 * c, 10 * s])
    assert np.linalg.norm(1e3 * path.position - centre, axis=1) == pytest.approx(10.0, abs=1e-9)
    exact = 10 * math.radians(abs(angle))
    assert 1e3 * path.block_length.sum() == pytest.approx(exact, rel=1e-9 if not tilt else 1e-4)
    turn = math.radians(angle)
    last = centre + 10 * np.array([math.sin(turn), -math.cos(turn) * c, -math.cos(turn) * s])
    assert 1e3 * path.position[-1] == pytest.approx(last, abs=1e-6)


REFUSED = [
    ("LIN_REL {X 1} #TOOL", "LIN_REL in the axes of the tool"),
    ("LIN {X 3,A 0,B 90,C 0}", "along z of $TOOL in one cut and along x, which points down"),
    ("$VEL={CP 0.1,ORI1 200}\n$VEL.CP=$VEL.CP*2000", "$VEL.CP must lie between"),
    ("PTP P7", "P7 has no value"),
    ("$VEL=5", "a value of another kind"),
    ("$OV_PRO={X 1}", "a value of another kind"),
    ('LIN {X "a"}', "a value of another kind"),
    ("BAS(#VEL_CP)", "a value of another kind"),
    ("SPLINE\nSPLINE\nSPL {X 2}\nENDSPLINE\nENDSPLINE", "a SPLINE block in another one"),
    ("IF TRUE THEN\n" * 3000 + "ENDIF\n" * 3000, "too many blocks"),
    ("LIN P7", "P7 has no value"),
    ("LIN {A1 0,A2 -90}", "not to angles of the axes"),
    ("LIN {X 0,Y 0,Z 0,E1 10}", "E1 moves in a cut"),
    ("CIRC {X 5,Y 0,Z 0},{X 10,Y 0,Z 0}", "lie on a line"),
    ("$IPO_MODE=#TCP", "$IPO_MODE #TCP moves the workpiece"),
    ("SLIN {X 2} WITH $IPO_MODE=SIPO_MODE(#TCP)", "$IPO_MODE #TCP moves the workpiece"),
    ("FDAT_ACT={IPO_FRAME #TCP}\nBAS(#FRAMES)", "$IPO_MODE #TCP moves the workpiece"),
    ("TIME_BLOCK START", "is not known"),
    ("$WORLD={X 1}", "$WORLD may move"),
    ("$VEL.CP=0", "$VEL.CP must lie between"),
    ("TRIGGER WHEN DISTANCE=0 DELAY=0 DO $VEL.CP=3", "TRIGGER sets $VEL.CP within a move"),
    ("BAS(#INITMOV,0)\nLIN {X 9}", "a cutting move without a feed"),
    ("GOTO AGAIN", "GOTO is not supported"),
    ("GRIP(1)", "the routine GRIP is not in the folder"),
    ("BAS(#COLD,1)", "BAS(#COLD) is not known"),
    ("IF $IN[1] THEN", "has no END"),
    ("LINE {X 1}", "is not known"),
    ("PTP_REL {A 90}", "a relative turn"),
    ("LIN {X 1e9}", "more than"),
    ("LIN {X 1,Y}", "is no expression|a value is missing|is no value"),
    ("WHILE TRUE\nLIN_REL {X 0.001}\nENDWHILE", "statements are run"),
    ("WHILE TRUE\nENDWHILE", "statements are run"),
    ("PART( )", "more than 10 deep"),
]


@pytest.mark.parametrize("line, sentence", REFUSED, ids=[repr(line[:30]) for line, _ in REFUSED])
def test_a_statement_that_cannot_be_run_is_refused_in_a_sentence(tmp_path, monkeypatch, line, sentence):
    monkeypatch.setattr("kr270_milling.path.cam.krl.MOST_STATEMENTS", 1000)
    start = [f"PTP {{X 0,Y 0,Z 5,{DOWN},E1 0}}", "$VEL.CP=0.1", "LIN {X 0,Y 0,Z 0}", "LIN {X 1,Y 0,Z 0}"]
    with pytest.raises(InputError) as caught:
        read_toolpath(written(tmp_path, *start, line))
    assert re.search(re.escape(sentence).replace(r"\|", "|"), str(caught.value))


def test_two_bases_a_moved_external_axis_and_a_file_without_its_end_are_refused(tmp_path):
    cut = [f"LIN {{X 0,Y 0,Z 0,{DOWN}}}", "LIN {X 1}"]
    two = ["$VEL.CP=0.1", "$BASE=BASE_DATA[1]", *cut, "$BASE=BASE_DATA[2]", "LIN {X 2}"]
    away = ["$VEL.CP=0.1", "PTP {X 0,Y 0,Z 0,E1 0}", *cut, "PTP {Z 9,E1 50}", "LIN {Z 0}"]
    for lines, sentence in ((two, "2 work offsets"), (away, "E1 moves between cuts")):
        with pytest.raises(InputError, match=sentence):
            read_toolpath(written(tmp_path, *lines))
    file = written(tmp_path, "$VEL.CP=0.1", *cut)
    file.write_text(file.read_text().replace("END\n", ""))
    with pytest.raises(InputError, match="may be cut off"):
        read_toolpath(file)


FRAMES = "$TOOL={X 10,Y 20,Z 300,A 0,B 0,C 180}", "$BASE={X 1200,Y -30,Z 700,A 5,B 0,C 0}"


@pytest.mark.parametrize("turn", [0.0, 90.0], ids=["tool along z", "tool along x"])
def test_a_cell_takes_base_and_tool_of_its_program_and_check_compares_them(tmp_path, turn):
    """A tool along x of $TOOL points down with B 90; z of tcp is then that x: $TOOL turned by B 90."""
    abc = "A 0,B 90,C 0" if turn else DOWN
    file = written(tmp_path, *FRAMES, "$VEL.CP=0.05", f"LIN {{X 0,Y 0,Z 1,{abc}}}", "LIN {X 20}")
    cell = tmp_path / "cell.yaml"
    assert main(["init", "--gcode", str(file), "--out", str(cell)]) == 0
    own = read_cell(cell)
    tool = Pose.from_abc([0.01, 0.02, 0.3], np.radians([0, 0, 180])) @ Pose.from_abc(
        [0, 0, 0], np.radians([0, turn, 0])
    )
    for pose, expected in (
        (TOOL0.inverse() @ own.mount.pose, tool),
        (own.workpiece.pose, Pose.from_abc([1.2, -0.03, 0.7], np.radians([5, 0, 0]))),
    ):
        np.testing.assert_allclose(pose.position, expected.position, atol=1e-9)
        np.testing.assert_allclose(pose.rotation, expected.rotation, atol=1e-9)
    away = read_cell(cell, ["workpiece.base_kuka={X: 1200, Y: -30, Z: 701, A: 5, B: 0, C: 0}"])
    for read, names in ((own, []), (away, ["$BASE of the program is 1 mm and 0 deg away from workpiece.base_kuka"])):
        assert [f.sentence for f in input_violations(read) if f.what == "frame of the program"] == names


def test_every_statement_is_used_counted_or_refused():
    for file in SAMPLES.glob("*.src"):
        program = ProgramBuilder(file, "")
        reader = _KrlReader(program, 0.0, file)
        reader.read()
        beside = sum(count for word, count in program.silent.items() if word[:2] in ("C_", "$I", "$A"))
        assert reader.statements <= sum(program.words.values()) <= reader.statements + beside
        assert not program.words["refused"]


def test_the_override_slows_and_the_folder_has_the_routine_that_is_called(tmp_path):
    written(tmp_path, "LIN {X 5}", name="deep.src").write_text("DEF DEEP( )\nLIN {X 5}\nEND\n")
    file = written(tmp_path, "$OV_PRO=50", "$VEL.CP=0.1", f"LIN {{X 0,Y 0,Z 0,{DOWN}}}", "DEEP( )")
    path = read_toolpath(file)
    assert path.feed[-1] == pytest.approx(0.05) and path.position[-1, 0] == pytest.approx(5e-3)


def test_files_and_routines_keep_their_variables_and_parts_are_in_folders_of_their_own(tmp_path):
    """XP1 of a routine in another file, and I of a routine, are others than those of the program that calls it."""
    place = "DEFDAT {}\nDECL FRAME XP1={{X {},Y 0,Z 0}}\nDECL E6POS {}={{X 1,Y 0,Z 0}}\nENDDAT\n"
    (tmp_path / "part.dat").write_text(place.format("PART", 10, "XOWN"))
    (tmp_path / "P2").mkdir()
    (tmp_path / "P2" / "other.dat").write_text(place.format("OTHER", 30, "XOTHER"))
    (tmp_path / "P2" / "other.src").write_text("DEF OTHER( )\nLIN XP1\nROUND( )\nEND\nDEF ROUND( )\nLIN {X 31}\nEND\n")
    begin = ("DECL INT I", "$VEL.CP=0.1", f"LIN {{X 0,Y 0,Z 0,{DOWN}}}")
    file = written(tmp_path, *begin, "FOR I=1 TO 2", "LIN XP1", "OTHER( )", "ROUND( )", "ENDFOR", "LIN XP1")
    file.write_text(file.read_text() + "DEF ROUND( )\nDECL INT I\nFOR I=1 TO 3\nLIN {X 20}\nLIN {X 21}\nENDFOR\nEND\n")
    ends = 1e3 * read_toolpath(file).position[1:, 0]
    assert ends == pytest.approx([*2 * [10, 30, 31, *3 * [20, 21]], 10])
    file.write_text(file.read_text().replace("OTHER( )", "LIN XOTHER\nOTHER( )"))
    with pytest.raises(InputError, match="XOTHER"):  # of a file that was not loaded, or of another file
        read_toolpath(file)


VALUES = {"1+2*3": 7, "(1+2)*3": 9, "7/2": 3, "7/2.0": 3.5, "-3+1": -2, "NOT TRUE OR TRUE": True, "1<2 AND TRUE": None,
          "(1<2) AND (3==3)": True, "SQRT(16)+ABS(-2)": 6, "SIN(30)": 0.5, "'B101'": 5, "'H1F'": 31, "P.X-1": 4,
          "#A == #A": True, "{X 1,Y 2:3}": None, "1 2": None, "": None, "SQRT(-1)": None, "1/0": None,
          "((((": None}  # fmt: skip


@pytest.mark.parametrize("text", VALUES)
def test_expressions_have_the_values_of_krl(text):
    if VALUES[text] is None:
        with pytest.raises(KrlError):
            evaluated(text, {"P": {"X": 5}}.get)
    else:
        assert evaluated(text, {"P": {"X": 5}}.get) == pytest.approx(VALUES[text])


@given(st.text("PTLINCR{}XYZ 0123456789.,;()=$#\"'\n:+-FORED", max_size=80))
@settings(max_examples=300)
def test_no_text_ends_in_a_traceback(tmp_path_factory, text):
    file = written(
        tmp_path_factory.mktemp("any"), "$VEL.CP=0.1", f"LIN {{X 0,Y 0,Z 0,{DOWN}}}", text, "LIN {X 1,Y 0,Z 0}"
    )
    try:
        read_toolpath(file)
    except InputError as error:
        assert str(error)
