"""G-code in: the path of one tool, and what the program says beside it.

Fanuc, Haas, LinuxCNC, GRBL and Sinumerik dialects: planes and helices, units, incremental moves and centres, retracts
(G28, G30, G53, SUPA), drilling cycles, feeds per minute, revolution and inverse time. Words that move nothing are
counted (``SourceProgram.read_over``); those that cannot be run are listed all at once. Without a unit word the unit is
mm. A line with the sign of block skip is run, as with the switch off.
"""

from __future__ import annotations

import re

from kr270_milling.base.text import read_lines, short, unended
from kr270_milling.trajectory.comments import operation_name
from kr270_milling.trajectory.gcode.blocks import SIMPLE, WORD, CommentError, split_comments, tokens
from kr270_milling.trajectory.gcode.machine import Machine
from kr270_milling.trajectory.gcode.motion import CHORD, Motion
from kr270_milling.trajectory.gcode.words import MACROS, NAMES_ADVICE, NAMES_SILENT, UNKNOWN
from kr270_milling.trajectory.source_program import ProgramError, SourceProgram
from kr270_milling.trajectory.summary import Observed, Refusals, source_program
from kr270_milling.trajectory.toolpath import PathBuilder, Toolpath

__all__ = ["read_gcode"]

CHANGE = re.compile(r"(?<![A-Z])M0*6(?![0-9.])", re.I)
TITLE = re.compile(r"\s*[O:]\s*[0-9]+\s*", re.I)
LABEL = re.compile(r"\s*(?:N\s*[0-9]+|[O:]\s*[0-9]+)?\s*", re.I)
LAST = re.compile(r"\s*(?:N\s*[0-9]+)?(?:\s*M\s*[0-9]{1,2})+\s*", re.I)
ROUND = ", or put a remark in brackets"
MOST_COMMENTS = 2000


def read_gcode(path, chord_tolerance: float = CHORD, tool: str = "", feed: float = 0.0) -> Toolpath:
    """Read the path of one tool; raises ProgramError with all words that cannot be run.

    chord_tolerance [m]: arcs to chords; tool: "T1", needed where the program cuts with several; feed [m/s]: for a
    program without F, 0 for none.
    """
    reader = _Reader(path, chord_tolerance, tool, feed)
    program = reader.read()
    if program.refused:
        raise ProgramError(path, program)
    return reader.path.build(reader.lines, program)


class _Reader:
    """Lines to blocks, comments to names."""

    def __init__(self, source, chord: float, tool: str, feed: float):
        self.text = read_lines(source)
        self.lines = len(self.text)
        self.path = PathBuilder(source)
        self.refusals = Refusals()
        self.seen = Observed(_tool_name(tool))
        self.motion = Motion(self.path, self.refusals, self.seen, feed, chord)
        changes = any(CHANGE.search(_code(line)) for line in self.text if "6" in line and CHANGE.search(line))
        self.machine = Machine(self.path, self.refusals, self.motion, self.seen, changes)
        self.announced = ""  #: operation that a post announced by word
        self.percent = 0

    def read(self) -> SourceProgram:
        number = 0
        for number, line in enumerate(self.text, 1):
            if SIMPLE.fullmatch(line):
                words = [(letter, float(text)) for letter, text in WORD.findall(line)]
                if words:
                    self.machine.run(words, number)
            else:
                self._line(line, number)
            if self.machine.ended or self.refusals.full:
                break
        else:
            self._check_end()
        return source_program(self.seen, self.path, self.refusals, min(number, self.lines))

    def _check_end(self) -> None:
        """A program without an end may be cut off, unless it ends in M words, which move nothing."""
        if (reason := unended(self.text)) and not LAST.fullmatch(_code(self.text[-1])):
            self.refusals.add(self.lines, "", reason)

    def _line(self, line: str, number: int) -> None:
        line = line.strip()
        if line[:1] == "%":
            self.percent += 1
            self.machine.ended = line == "%" and self.percent > 1 and len(self.path) > 1
            return
        try:
            code, comments = split_comments(line)
        except CommentError as error:
            self.refusals.add(number, "(", str(error), "close the bracket")
            return
        if code[:1] == "/":
            code = code.lstrip("/0123456789 ") if code[1:2].isdigit() else code[1:]
            self.seen.silent["/"] += 1
        if code[:1] == ":":
            code = "O" + code[1:]
        if comments:
            self._comments(code, comments)
        code = code.upper()
        if SIMPLE.fullmatch(code):
            words = [(letter, float(text)) for letter, text in WORD.findall(code)]
            if words:
                self.machine.run(words, number)
        else:
            self._pieces(code, number)

    def _pieces(self, code: str, number: int) -> None:
        """A line that is more than words of one letter."""
        block = tokens(code)
        if block.macro:
            self.refusals.add(number, short(block.macro), advice=MACROS, lost=True)
        elif block.bare:
            self.refusals.add(number, block.bare, f"the word {block.bare} has no number")
        elif block.rest:
            shown = short(block.rest)
            comma = re.match(r",[RCA][0-9.]", block.rest)
            advice = NAMES_ADVICE["RND"] if comma else "a word is a letter and a number" + ROUND
            self.refusals.add(number, shown, f"{shown!r} is no G-code word", advice, lost=bool(comma))
        elif not self._named(block.names, number):
            return
        else:
            self.machine.run(block.words, number, block)

    def _named(self, names: list, number: int) -> bool:
        """Whether the words of several letters in a line let it be run."""
        fine = True
        for name, argument in names:
            if name == "SUPA":
                continue
            advice = NAMES_ADVICE.get(name)
            reset = argument is None and name in ("TRANS", "ROT", "SCALE", "MIRROR")
            idle = name == "CYCLE800" and not re.search(r"[1-9]", (argument or "").split(",,")[-1])
            if name in NAMES_SILENT or reset or idle:
                self.seen.silent[name] += 1
            else:
                fine = False
                self.refusals.add(number, short(name), advice=advice or UNKNOWN, lost=True)
        return fine

    def _comments(self, code: str, comments: list[str]) -> None:
        if len(self.seen.comments) < MOST_COMMENTS:
            tool = self.machine.next_tool
            if match := re.search(r"T\s*0*([0-9]+)", code, re.I):
                tool = f"T{int(match.group(1))}"
            self.seen.comments += [(comment, tool) for comment in comments]
        if TITLE.fullmatch(code) and not self.seen.title:
            self.seen.title = comments[0]
        if LABEL.fullmatch(code):
            self._name(comments[0], bool(TITLE.fullmatch(code)))

    def _name(self, comment: str, title: bool) -> None:
        name, announced = operation_name(comment)
        if announced:
            self.announced = name
        elif comment.lower().startswith("finish operation"):
            self.announced = ""
            return
        if name and (announced or not self.announced):
            self.path.name_feature(name)
            self.motion.named = not title


def _code(line: str) -> str:
    try:
        return split_comments(line)[0]
    except CommentError:
        return ""


def _tool_name(text: str) -> str:
    """T1 of "1", "t1" and "T01"; the name itself of any other."""
    match = re.fullmatch(r"\s*[Tt]?0*([0-9]+)\s*", text)
    return f"T{int(match.group(1))}" if match else text.strip()
