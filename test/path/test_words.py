"""Each word of a block is used, counted or refused; none is lost."""

from __future__ import annotations

import itertools
import random

import pytest
from budget import budget

from kr270_milling.base.errors import InputError
from kr270_milling.base.table import read_table
from kr270_milling.path.cam.apt import _AptReader
from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.reader import GcodeReader
from kr270_milling.path.cam.gcode.words import G_GROUPS, M_GROUPS
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.cam.readers import read_toolpath

#: states of the machine, two of which precede a block
STARTS = (
    *("", "G0 X1 Y2 Z3", "G1 Z-1", "G2 X5 Y2 R9", "G91", "G20", "G18", "G93", "G90.1", "M5", "G28"),
    *("G81 X1 Z-1 R2", "G91 G81 Z-1 R1"),
)


class Ran:
    """Lines that an interpreter ran, without the end of a file."""

    def __init__(self, lines):
        self.program = ProgramBuilder("part.nc", "")
        self.machine = Interpreter(self.program, 0.0, True)
        self.reader = GcodeReader(self.program, self.machine)
        for self.program.line, line in enumerate(lines, 1):
            self.before = {**self.program.words}, self.program.silent.copy()
            self.reader.run_line(line)

    @property
    def words(self) -> dict[str, int]:
        """Words of the last line: used, counted, refused."""
        return {fate: count - self.before[0][fate] for fate, count in self.program.words.items()}

    @property
    def outcome(self) -> str:
        state = {name: value for name, value in vars(self.machine).items() if name != "program"}
        program = self.program
        path = [column.tobytes() for column in program.columns().values()]
        return repr((state, path, program.silent, program.frame, program.tool, program.spindle_speed, program.refusals))


def number(rng: random.Random) -> str:
    value = rng.choice((0, 1, 2, 5, rng.randint(-20, 20), rng.uniform(-9, 9)))
    return rng.choice((f"{value:g}", f"{value:+.3f}", f"{value:.2e}", f"{float(value)}", f"{value:.0f}."))


def a_block(rng: random.Random) -> list[list[str]]:
    """Words of one block as letters and numbers, of each letter but G and M at most one."""
    letters = rng.sample("ABCDEFHIJKLPQRSTUVWXYZ", rng.choice((0, 1, 2, 3, 5)))
    letters += rng.sample("XYZF", 2) if rng.random() < 0.5 else []
    words = [[letter, number(rng)] for letter in dict.fromkeys(letters)]
    for letter, known in (("G", [*G_GROUPS]), ("M", [*M_GROUPS])):
        for _ in range(rng.choice((0, 0, 1, 2))):
            words.append([letter, f"{rng.choice(known) if rng.random() < 0.9 else rng.randint(0, 400)}"])
    rng.shuffle(words)
    return [["N", "10"], *words] if rng.random() < 0.3 else words


def text(words, rng: random.Random) -> str:
    """Write words with blanks, comments, lower case and the sign of block skip here and there."""
    line = rng.choice((" ", "", "  ", " (S99 X1)", "\t")).join(letter + value for letter, value in words)
    if any(a[-1] in "." or b[0] == "E" for (_, a), (b, _) in itertools.pairwise(words)):
        line = " ".join(letter + value for letter, value in words)  # 1E5 is one number, 1 E5 are two words
    return rng.choice(("", "", "", "/")) + rng.choice((line, line, line.lower())) + rng.choice(("", "", " ;X5"))


def test_used_and_counted_and_refused_words_are_all_and_a_number_that_changes_nothing_is_counted():
    rng, blocks, fates = random.Random(41), budget(10_000), {"used": 0, "counted": 0, "refused": 0}
    for _ in range(blocks):
        lines = ["G21 G90 G17 T1 M6", "S8000 M3", "G0 X0 Y0 Z5", "G1 F500", *rng.sample(STARTS, 2)]
        words = a_block(rng)
        block = text(words, rng)
        ran = Ran([*lines, block])
        fates = {fate: count + ran.words[fate] for fate, count in fates.items()}
        assert sum(ran.words.values()) == len(words), (lines, block, ran.words)
        if ran.words["refused"]:
            continue
        counted = ran.program.silent - ran.before[1]
        heads = sum(count for word, count in counted.items() if word[0] in "GM/")
        idle = 0
        for k, (letter, value) in enumerate(words):
            if letter in "GMNO":
                continue
            others = (str(float(value) + step) for step in (1.0, -0.5))
            changed = ([*words[:k], [letter, other], *words[k + 1 :]] for other in others)
            same = [Ran([*lines, " ".join(map("".join, block))]).outcome for block in changed]
            idle += all(outcome == Ran([*lines, " ".join(map("".join, words))]).outcome for outcome in same)
        assert idle <= ran.words["counted"] - heads + ("/" in counted), (lines, block, ran.words, counted)
    assert min(fates.values()) > blocks / 3


def test_a_g_or_m_word_that_is_in_no_list_is_refused():
    for letter, groups in (("G", G_GROUPS), ("M", M_GROUPS)):
        for value in (n / 10 for n in range(10_000)):
            ran = Ran([f"{letter}{value:g}"])
            assert bool(ran.words["refused"]) >= (value not in groups), (letter, value)


#: a line behind the start of a program -> words of its refusal, or the counted words, the end of the next cut [mm], its
#: feed [mm/min] and its speed [rpm]
HEAD, END = "G21 G90 G17\nT1 M6\nS8000 M3\nG0 X0 Y0 Z5\nG1 Z-1 F800\n", "\nG1 X30\nG0 Z5\nM30\n"
LINES = {
    **dict.fromkeys(("M99 P100", "G98 L1", "M30 P5"), "a jump or a call"),
    **dict.fromkeys(("L100 P3", "M98 P1", "G65 P9 A1", "O<a> call"), "is not in this file"),
    **dict.fromkeys(("GOTO 10", "M97 P10"), "0 lines have the number N10"),
    **dict.fromkeys(("TRANS X10", "ROT Z30", "SCALE X2", "MIRROR X0", "G50.1 X0\nG51.1 X0", "DIAMON"), "without shift"),
    **dict.fromkeys(("G58 Z-2", "G59 X1 Y2"), "shifts the zero on Sinumerik"),
    **dict.fromkeys(("G126", "G500", "G15 H2", "G0 G59 X1", "G154 P5"), "2 work offsets: G54 "),
    **dict.fromkeys(("G70 I5 J0 L6", "G71 I5 J0 K2 L6"), "circle of holes on Haas"),
    **dict.fromkeys(("G4 X1 Y5", "G4 F2 X5", "G1 X5 G4 F2"), "may be the time of G4"),
    **dict.fromkeys(("G76 X3 Z-2 R1 I2", "G76 P1 Z-5 I-2 J1 K3 H3 L2"), "leave threads out"),
    **dict.fromkeys(("G71.1 P1 Q9", "G72.2"), "a word of lathes"),
    "G20 F10": ("", 0, 0, 10, 8000),
    "G20": ("", 0, 0, 800, 8000),
    **dict.fromkeys(("G93", "G93 F2 G1 X5"), "G93 needs F in each line"),
    **dict.fromkeys(("IF R1>5 GOTOF A", 'EXTCALL "UP"'), "post without macros"),
    **dict.fromkeys(("M91", "L X+10 Y+5 R0 FMAX"), "Heidenhain"),
    **dict.fromkeys(('X="5"', 'S1="5"'), "is not known"),
    **dict.fromkeys(("S2=100", "M2=3", "M2=5\nX1", "S1=8000\nS3=90"), "is another spindle than S1"),
    **dict.fromkeys(("S1=8000 M1=3", "S1=8000\nM1=3"), ("", 0, 0, 800, 8000)),
    "G0 X0,0 Y1,5": "decimal comma",
    "G90.1 G2 X10 I5": "needs I and J",
    "M61 Q5": "T1 .* T5",
    "OVR=50": "as F",
    "T12345601 M6\nX1\nT12345602 M6": "T12345601 .* T12345602",
    "G43 H1\nX1\nG43 H2": "2 tool lengths",
    "M442": "M442",
    "D1\nX1\nD2": "2 tool edges",
    "G83 X5 Z-9 R2 Q2 K0.5": "0.5 times",
    "G81": "without X, Y, Z or R",
    "T1 T2": "twice",
    "X1 E0.5": "3-D printers",
    "M19 S90": "M19 with S",
    "G63 Z-2": "threads",
    "G2 X9 R5 P1.5": "0.5 turns",
    "F1.5E3": ("", 0, 0, 1500, 8000),
    "F1.5e+03": ("", 0, 0, 1500, 8000),
    "S8E3": ("", 0, 0, 800, 8000),
    "G4 P0.1 G0 X25 Y10 S8000 M3": ("1 G4", 25, 10, 800, 8000),
    "G4 P1 F900": ("1 G4", 0, 0, 900, 8000),
    **dict.fromkeys(("G04 U1.5", "G04 X2", "G4 F2", "G4 S30"), ("1 G4", 0, 0, 800, 8000)),
    **{line: (f"1 {line.split()[0]}", 0, 0, 800, 8000) for line in ("G92 S9000", "G50 S9000", "M19 R90.", "G26 S3000")},
    **dict.fromkeys(("N60 /Y5", "/1 Y5", "N60/2Y5"), ("1 /", 0, 5, 800, 8000)),
    "#1=9\n#1=[2+3*2**2-9] X#1": ("", 9, 0, 800, 8000),  # the value before the assignment of the line
    **dict.fromkeys(("G1 Y=5*(3-2)", "#<a b>=5\nY#<AB>", "R1=2\nG1 Y=R1+3"), ("", 0, 5, 800, 8000)),
    "G2 Y0 I-1.28466e-07 J20.0 F9E2": ("", 0, 0, 900, 8000),
}


@pytest.mark.parametrize("line", LINES)
def test_a_line_is_refused_with_a_sentence_or_leads_to_the_right_place_at_its_feed(tmp_path, line):
    expected = LINES[line]
    (tmp_path / "part.nc").write_text(HEAD + line + END)
    if isinstance(expected, str):
        with pytest.raises(InputError, match=expected):
            read_toolpath(tmp_path / "part.nc")
        return
    path = read_toolpath(tmp_path / "part.nc")
    counted, *numbers = expected
    cut = max(k for k in range(len(path)) if not path.rapid[k])
    assert path.program.summary == (f"read over: {counted}" if counted else "")
    x, y, _ = 1e3 * path.position[cut - 1]
    speed = path.program.spindle_speeds[-1] * 9.549297
    assert [x, y, 6e4 * path.feed[cut], speed] == pytest.approx(numbers, abs=0.01)


DOUBTS = {
    "G20 F10": ("F10 in mm, the unit before G20", 6),
    "(T1 D=10 flat end mill)\nX5\nT1 M6 (6 mm flat end mill)\nS8000 M3": ("the comments on T1 state 10 and 6 mm", 2),
    "(T1 10 mm end mill)\nX5\n(6 mm deep with the end mill)\nX6\nT1 (end mill, D=10)": None,
    "(T1 end mill)\nX5\nT1 (D=10 end mill)": None,
    "G20": ("F800 in mm, the unit before G20", 6),
    "G43 H7": ("H7 is not the number of T1", 6),
    "G0 Z9\nG99 G81 X5 Z-3 R2\nG91 X3\nG80 G90\nG1 Z-1": (
        "R or Z of a cycle from before G90, G91, G20 or G21 keeps its height",
        8,
    ),
    "G0 Z9\nG91 G99 G81 X5 Z-3 R-2\nR-3 X3\nG80 G90\nG1 Z-1": (
        "R of a further hole with G91 counts from the height before the cycle",
        8,
    ),
    **dict.fromkeys(
        (
            "G0 Z2\nG99 G81 X0 Y0 Z-3 R2\nX9\nX9 R4\nX20 R6\nG80\nG1 Z-1",
            "G0 Z9\nG81 X0 Y0 Z-3 R2\nX9\nX9 R4\nX20 R16\nG80\nG1 Z-1",
        ),
        ("R is above the tool, which rises here before it moves to the hole", 10),
    ),
    "G0 Z2\nG99 G81 X0 Y0 Z-3 R2\nZ-4 R4\nX9\nX20 R3\nG80\nG1 Z-1": None,
    "G43\nX5\nG49\nG0 Z9\nG43\nG1": ("the length of T1 ends before a retract", 8),
    "G0 Z9\nG91 G99 G81 X5 Z-3 R-2\nX3\nG90 X9 Z-1 R3\nG80\nG1 Z-1": None,
    **dict.fromkeys(("G43 H1", "G43", "G49", "G43 H1\nX5\nG49 G53 Z0\nG43\nG1", "G43\nG28 Z0\nG49"), None),
}


@pytest.mark.parametrize("lines", DOUBTS)
def test_a_word_that_another_control_runs_in_another_way_is_noted_with_its_line(tmp_path, lines):
    (tmp_path / "part.nc").write_text(HEAD + lines + END)
    doubtful = read_toolpath(tmp_path / "part.nc").program.doubtful
    assert [row[1:] for row in doubtful] == [DOUBTS[lines]] * (DOUBTS[lines] is not None)


APT_HEAD = "UNITS/MM\nLOADTL/1\nSPINDL/8000,RPM,CLW\nRAPID\nGOTO/0,0,10\nFEDRAT/500,MMPM\nGOTO/0,0,-1\n"
APT_END = "\nGOTO/50,0,-1\nGOTO/50,20,-1\nRAPID\nGOTO/50,20,10\nFINI\n"
STATEMENTS = {
    **dict.fromkeys(("RETRCT", "CLEARP/XYPLAN,9\nRETRCT", "PLUNGE", "SAFETY/50", "INSERT G91", "PREFUN/70"), "as GOTO"),
    **dict.fromkeys(("ORIGIN/9,0,0", "CSYS/1,0,0", "MSYS/1,0,0", "ROTABL/90", "TRACUT/M1", "COPY/1"), "of one system"),
    **dict.fromkeys(("CUTCOM/ON,LEFT", "CUTCOM/ON", "CUTCOM/RIGHT,XYPLAN"), "tool's centre"),
    **dict.fromkeys(("INSERT M05", "INSERT/F9000", "INSERT T2", "INSERT S900 M3"), "sets or moves"),
    "SPINDL/5000,6000": "2 speeds",
    "RAPID/MODAL": "one move",
    "AUXFUN/98": "AUXFUN/98",
    "MODE/INCR": "INCR",
    "LOADTL/LENGTH,50,2": "number of the tool first",
    "CALL/M1": "without macros",
    "FOO/1": "FOO is not supported",
    **dict.fromkeys(f"{word} COST 100$" for word in ("PPRINT", "PARTNO", "REMARK", "INSERT", "TPRINT/T1", "COOLNT/ON")),
    **dict.fromkeys(
        ("CYCLE/OFF", "TLON", "CUTCOM/OFF", "CLEARP/XYPLAN,9", "UNLOAD/TOOL", "LOADTL/1,LENGTH,50\nSPINDL/ON")
    ),
    **dict.fromkeys(("SPINDL/8000,RPM,CLW,RANGE,2", "SPINDL/RPM,8000,CLW,MAXRPM,9000", "$$-> FEATNO / 1.0, $\n 0.0")),
    **dict.fromkeys(("RETRCT\nLOADTL/1\nSPINDL/ON", "FEDRAT/5.D+02,MMPM", "$$ COST 100$", "INSERT N5 M08")),
}


@pytest.mark.parametrize("statement", STATEMENTS)
def test_a_statement_is_refused_with_a_sentence_or_leaves_the_cut_as_it_is(tmp_path, statement):
    (tmp_path / "part.apt").write_text(APT_HEAD + statement + APT_END)
    if STATEMENTS[statement]:
        with pytest.raises(InputError, match=STATEMENTS[statement]):
            read_toolpath(tmp_path / "part.apt")
        return
    path = read_toolpath(tmp_path / "part.apt")
    assert [50, 0, -1] in (1e3 * path.position).round(6).tolist() and set(path.feed[~path.rapid]) == {0.5 / 60}
    assert path.program.spindle_speeds == pytest.approx((837.758,))


@pytest.mark.parametrize(("old", "new", "kinds"), [
    ("UNITS/MM\n", "", []), (",MMPM", "", []), ("UNITS/MM\n", "$$ FEDRAT/1,MMPM\n", []),
    ("UNITS/MM\nLOADTL/1\nSPINDL/8000,RPM,CLW\nRAPID\nGOTO/0,0,10\nFEDRAT/500,MMPM", "GOTO/0,0,9\nFEDRAT/5",
     ["no unit"]),
])  # fmt: skip
def test_a_program_of_apt_without_a_unit_of_lengths_or_of_the_feed_is_noted(tmp_path, old, new, kinds):
    (tmp_path / "part.apt").write_text(APT_HEAD.replace(old, new) + APT_END)
    assert [row[0] for row in read_toolpath(tmp_path / "part.apt").program.doubtful] == kinds


def test_used_and_counted_and_refused_statements_are_all():
    rng = random.Random(41)
    lines = (APT_HEAD + APT_END + "\n".join(STATEMENTS)).replace("FINI\n", "").split("\n")
    for _ in range(budget(1000)):
        chosen = [line for line in rng.choices(lines, k=9) if line.strip() and "$" not in line]
        program = ProgramBuilder("part.apt", "")
        _AptReader(program, 0.0).read([*chosen, ""])
        assert sum(program.words.values()) == len(chosen), (chosen, program.words)


def test_files_of_creo_are_read_by_their_name_with_cards_and_with_a_remark_that_continues(tmp_path):
    lines = ["$$* Pro/CLfile", "$$-> CUTTER / 12.0", "$$-> CSYS / 1.0, 0.0, 0.0, 0.0,  $", "0.0, 1.0, 0.0, 0.0"]
    lines += [line for line in (APT_HEAD + APT_END).split("\n") if line]
    for name, text in (("op010.ncl.1", lines), ("card.apt", [f"{line:72}{k:08d}" for k, line in enumerate(lines)])):
        (tmp_path / name).write_text("\n".join(text) + "\n")
        path = read_toolpath(tmp_path / name)
        assert 1e3 * path.position[-1] == pytest.approx([50, 20, 10])
    (tmp_path / "two.ncl").write_text("\n".join([*lines[:-1], "$$-> CSYS / 1.0, 0.0, 0.0, 9.0", lines[-1]]) + "\n")
    with pytest.raises(InputError, match="a second CSYS"):
        read_toolpath(tmp_path / "two.ncl")
    (tmp_path / "inch.apt").write_text("LOADTL/1\nGOTO/0,0,1\nFEDRAT/20,IPM\nGOTO/1,0,0\nFINI\n")
    with pytest.raises(InputError, match="FEDRAT/ in IPM without UNITS/"):
        read_toolpath(tmp_path / "inch.apt")


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("x;y\n1.500;0,5\n", ("1500", "0.5")),
        ("x;y\n1.234.567;2\n", ("1234567", "2")),
        ("x\ty\n1,5\t2\n", ("1.5", "2")),
        ("x;y\n1,500;2,250\n", ("1.500", "2.250")),
        ("sep=;\nx;y\n1;2,5\n", ("1", "2.5")),
        ("x;y\n0.5;1.500\n", ("0.5", "1.500")),
        ("x;y\n1.500;2\n", "three decimals or be thousands"),
        ("x\ty\n1,500\t2\n", "three decimals or be thousands"),
        ("x;y\n0.5;0,5\n", "another decimal sign"),
        ("x,y\n1,5,2,5\n", "separate the columns by ;"),
        ("x,y\n3,2\n1,2", ("3", "2")),
        ("x,y\n3,22\n1,2", "cut off"),
    ],
)
def test_a_table_has_one_decimal_sign(tmp_path, text, result):
    (tmp_path / "table.csv").write_text(text)
    if isinstance(result, str):
        with pytest.raises(InputError, match=result):
            read_table(tmp_path / "table.csv", ("x", "y"), whole=True)
    else:
        assert read_table(tmp_path / "table.csv", ("x", "y"), whole=True).rows[0] == result


def test_a_last_line_without_an_end_is_whole_where_it_cuts_nothing_or_repeats_an_earlier_one(tmp_path):
    for last, whole in (("G0 Z5", True), ("M9", True), ("N7 Y1", True), ("Y12", False), ("G1 Y1 F2", False)):
        (tmp_path / "part.nc").write_text(f"{HEAD}Y1\nY2\n{last}")
        if whole:
            assert read_toolpath(tmp_path / "part.nc").length > 0
        else:
            with pytest.raises(InputError, match="cut off"):
                read_toolpath(tmp_path / "part.nc")
