"""Each word of a block is used, counted or refused; none is lost."""

from __future__ import annotations

import itertools
import random

from budget import budget

from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.reader import GcodeReader
from kr270_milling.path.cam.gcode.words import G_GROUPS, M_GROUPS
from kr270_milling.path.cam.program_builder import ProgramBuilder

STARTS = ("", "G0 X1 Y2 Z3", "G1 Z-1", "G2 X5 Y2 R9", "G91", "G20", "G18", "G93", "G90.1", "M5", "G81 X1 Z-1 R2", "G91 G81 Z-1 R1",
          "G28")  # fmt: skip


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
