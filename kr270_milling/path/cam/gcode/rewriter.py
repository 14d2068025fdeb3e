"""G-code out: the lines of a program with other end points of its moves, and everything else unchanged.

The interpreter of the reader runs each line, so that the kind of its move is known. A line with a feed move (G1, G2,
G3) becomes G1 blocks; its N number, its other words and its comments stay.

A program with parameters, sub-programs, shifts or curves is first written out: one line for each move, in absolute mm.
Cycles along z stay cycles; comments, tools, speeds and words of M stay with their moves.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import read_lines
from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.reader import COMMENT, PIECE, SKIP, GcodeReader, changes_by_m6, gcode_path
from kr270_milling.path.cam.gcode.words import G_GROUPS, word_of
from kr270_milling.path.cam.machine import AXES, MM, NURBS
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.toolpath import Toolpath

#: groups of words that place the coordinates: they stay before the first move
PLACING = frozenset(("offset", "data", "preset"))
ENDING = frozenset((0, 1, 2, 5, 9, 30, 60))  #: M words after the move of their line
DROPPED = frozenset((17, 70, 71, 72, 73, 97, 98, 99))


class _Expansion(Interpreter):
    """Writes each block as its settings and its moves."""

    watched = True

    def __init__(self, *args: Any):
        super().__init__(*args)
        self.lines: list[str] = ["G21 G90 G17 G94 G40 G80"]
        self.needed = False  #: another program than the source
        self._moves: list[str] = []
        self._fed = 0.0

    def run(self, words: list[tuple[str, Any]]) -> None:
        began, self._moves = self._began, []
        super().run(words)
        head = [self._word(*word) for word in words if self._stays(*word, words, began)]
        ending = [word_of(*word) for word in words if word[0] == "M" and word[1] in ENDING]
        self.lines += [" ".join(head)] * bool(head) + self._moves + [" ".join(ending)] * bool(ending)
        self.needed = (
            self.needed
            or self.shift is not None
            or self.contour is not None
            or self.polar
            or bool(self.pattern)
            or self.mode in (5, 5.1, *NURBS)
            or bool(self.cycle and self.plane != 17)
        )

    def _stays(self, letter: str, value: Any, words: list, began: bool) -> bool:
        # words that stay in their line: dwell, tool length, exact stop, look-ahead
        unchanged = frozenset((4, 8, 9, 43, 43.1, 49, 61, 61.1, 64))
        codes = {number for kind, number in words if kind == "G"}
        placing = any(G_GROUPS.get(code) in PLACING for code in codes) and not began
        if letter == "G":
            return value in unchanged or (placing and G_GROUPS.get(value) in PLACING)
        if letter == "M":
            return value not in ENDING and value not in DROPPED
        if letter in "ST":
            return 4 not in codes or letter == "T"
        if placing:  # the axes of a line with G54 are those of a move
            stated = {G_GROUPS.get(code) for code in codes} & (PLACING - {"offset"})
            return letter in ("LPXYZR" if stated else "P")
        return (
            (letter == "H" and 43 in codes)
            or (letter == "Z" and 43.1 in codes)
            or (letter == "P" and not codes.isdisjoint((4, 64)))
        )

    def _word(self, letter: str, value: Any) -> str:
        if not isinstance(value, float):
            return f'{letter}="{value}"'
        return f"{letter}{_number(value * self.unit)}" if letter in AXES else word_of(letter, value)

    def _place(self, point) -> str:
        ends = zip(AXES, self.on_path(point), strict=True)
        return " ".join(f"{axis}{_number(value)}" for axis, value in ends if math.isfinite(value))

    def go(self, end) -> None:
        super().go(end)
        if place := self._place(end):
            self._moves.append(f"G0 {place}")

    def _feed_to(self, start, ends, length: float, curvature: float = 0.0) -> None:
        feed = 6e4 * (self._feed_rate(length) or 0.0)
        self._moves += [f"G1 {self._place(end)} F{feed:.6g}" for end in ends]
        super()._feed_to(start, ends, length, curvature)

    def _hole(self, place, cycle, across: int) -> bool:
        count = len(self._moves) + 3  # with the moves up to the height R
        drilled = super()._hole(place, cycle, across)
        if across == 2:
            peck = f" Q{_number(cycle.peck)}" if cycle.kind in (73, 83) else ""
            xy = self._place((*place[:2], math.nan))
            _, _, height = self.on_path((0.0, 0.0, cycle.bottom))
            _, _, level = self.on_path((0.0, 0.0, cycle.retract))
            feed = f" F{6e4 * (self._feed_rate(cycle.retract - cycle.bottom) or 0.0):.6g}"
            hole = f"G99 G{cycle.kind} {xy} Z{_number(height)} R{_number(level)}{peck}{feed}"
            self._moves = [*self._moves[:count], hole, "G80", f"G0 {self._place(self.position)}"]
        return drilled

    def restore(self, modes: dict[str, Any]) -> None:
        super().restore(modes)
        turning = {1: "M3", -1: "M4", 0: "M5"}[self.turning]
        self.lines.append(f"{word_of('S', round(self.speed * 30 / math.pi, 6))} {turning}")

    def home(self, axes: list[str], feeds: bool = False) -> None:
        self._moves.append(" ".join(["G91 G28", *(f"{axis}0" for axis in axes)]))
        self._moves.append("G90")
        written = [*self._moves]
        super().home(axes, feeds)
        self._moves = written


class _Reader(GcodeReader):
    """Keeps the comments of the lines after the start sign and the name of the program."""

    machine: _Expansion
    named = 0  #: lines of start sign and name

    def _comments(self, code: str, comments: list[str]) -> None:
        super()._comments(code, comments)
        if self.program.line <= self.named:
            return
        texts = [f"({comment.replace('(', '[').replace(')', ']')})" for comment in comments if comment]
        if texts and re.fullmatch(r"\s*O\s*[0-9]+\s*", code, re.I):
            texts[0] = f"{code.strip()} {texts[0]}"
        self.machine.lines += texts


def expanded(path, lines: list[str], feed: float = 0.0) -> list[str] | None:
    """Return the lines of a program written out; None for a program of plain blocks in one place.

    Raises InputError for a program that cannot be run.
    """
    program = ProgramBuilder(path, "")
    machine = _Expansion(program, feed, changes_by_m6(lines), ())
    reader = _Reader(program, machine)
    # start sign, name of the program with its comment, blank lines: controls want these first
    name = re.compile(r"\s*(?:%.*|[O:]\s*[0-9]+\s*(?:\([^)]*\)\s*)?)?", re.I)
    named = list(itertools.takewhile(name.fullmatch, lines))
    reader.named = len(named)
    reader.read(lines)
    if not (reader.computed or machine.needed):
        return None
    if program.refusals:
        raise InputError(path, "a program with words that cannot be run cannot be written out", program.line)
    ends = ["%"] * any("%" in line for line in named)
    return [*filter(str.strip, named), *machine.lines, *ends, ""]


def _number(length: float) -> str:
    """[mm], with all digits that a position has."""
    return f"{round(length / MM, 7) + 0.0:.7f}".rstrip("0").rstrip(".")


ABSOLUTE = "is incremental, and a corrected program needs absolute coordinates; post the program with G90"
PLACES = {"feed": frozenset("XYZIJKR") | {"CR", "TURN"}, "rapid": frozenset("XYZ")}


@dataclass(frozen=True)
class SourceMove:
    """The move of one line."""

    kind: str  #: "feed", "rapid" or "cycle"
    unit: float  #: [m], of its coordinates
    arc: bool  #: G2 or G3


class _Watch(Interpreter):
    """Notes the move of a line; refuses a move of a corrected tool that the corrected program would change."""

    watched = True
    tools: Collection[str] = ()
    top = -math.inf  #: [m], of the stock
    move_of_line: SourceMove | None = None

    def __init__(self, program: ProgramBuilder, feed: float, changes: bool):
        super().__init__(program, feed, changes)
        self._corrected: frozenset[str] = frozenset()  #: axes that a corrected feed move placed

    def _note(self, kind: str, axes: Collection[str]) -> None:
        if self.program.run in self.tools:
            self.move_of_line = SourceMove(kind, self.unit, self.mode in (2, 3))
            self._corrected = frozenset("XYZ") if kind == "feed" else self._corrected.difference(axes)

    def _refuse(self, reason: str) -> None:
        if self.program.run in self.tools:
            raise InputError(self.program.source, reason, self.program.line)

    def _relative(self, axes: Collection[str]) -> str:
        """The axes of a block that it moves by a length, not to a place."""
        return "".join(axis for axis in "XYZ" if axis in axes and not self.absolute.get(axis, not self.incremental))

    def _move(self, axes: dict) -> None:
        relative = self._relative(axes)
        self._note("rapid", axes)
        super()._move(axes)
        if relative and self.move_of_line and self.move_of_line.kind == "rapid":
            self._refuse(f"the rapid move along {relative[0]} {ABSOLUTE}")

    def _in_machine(self, axes: dict) -> bool:
        """Keep the line of a G53."""
        return False

    def home(self, axes: list[str], feeds: bool = False) -> None:
        """Refuse to leave sideways at cutting depth: the model retracts first, but a machine moves these axes."""
        depth = self.top - self.position[2]
        # 1 um: rounding of a height
        if not {"X", "Y"}.isdisjoint(axes) and depth > 1e-6 and not self.program.away:
            where = f"{1e3 * depth:.4g} mm below the top of the stock"
            self._refuse(f"the move home of {' '.join(axes)} leaves sideways {where}; retract along Z alone first")
        super().home(axes, feeds)

    def _feed_to(self, start, ends: list, length: float, curvature: float = 0.0) -> None:
        if self.incremental:
            self._refuse(f"the move {ABSOLUTE}")
        if self.feed_mode == 93:
            self._refuse(
                "a feed in inverse time (G93) holds for the whole block; post the program with feeds per minute (G94)"
            )
        self._note("feed", ())
        super()._feed_to(start, ends, length, curvature)

    def _drill(self, kind: float | None, axes: dict) -> None:
        if self._relative(axes):
            self._refuse(f"the drilling cycle {ABSOLUTE}")
        if "Z" in self._corrected or not self._corrected <= axes.keys():
            self._refuse(
                "the drilling cycle begins at the end of a feed move; write a rapid move to X, Y and Z before it"
            )
        super()._drill(kind, axes)
        self._note("cycle", "XYZ")


@dataclass(frozen=True)
class GcodeSource:
    """The lines of a program, and the moves that the corrected tools make in them."""

    lines: tuple[str, ...]
    moves: dict[int, SourceMove]  #: line number, from 1 -> blocks
    written_out: bool = False  #: the lines are not those of the file, which has parameters, sub-programs or shifts

    def repeated(self, times: int, start: np.ndarray, height: float) -> tuple[GcodeSource, int]:
        """Return the lines with all moves ``times`` times more, and the number of lines from one to the next.

        start (3,), height [m]: place to which the tool returns, and height of the rapid moves to it.
        """
        first, last = min(self.moves), max(self.moves)
        unit = self.moves[last].unit
        x, y, z = _words(start, unit).split()
        up = _words(np.array([0.0, 0.0, height]), unit).split()[2]
        between = [f"G90 G0 {up}", f"G0 {x} {y}", f"G0 {z}"]
        body = [*between, *self.lines[first - 1 : last]]
        lines = (*self.lines[:last], *body * times, *self.lines[last:])
        moves = {n + k * len(body): move for k in range(times + 1) for n, move in self.moves.items()}
        return dataclasses.replace(self, lines=lines, moves=moves), len(body)

    def rewritten(self, ends: dict[int, np.ndarray], feeds: dict[int, np.ndarray] | None = None) -> list[str]:
        """Return the lines with other end points; ends: line -> points (k, 3) [m], feeds: line -> feeds (k,) [m/s].

        A feed move without points has no length: its line keeps its other words. A rapid move or cycle without points
        is not changed.
        """
        lines: list[str] = []
        for number, line in enumerate(self.lines, 1):
            move, points = self.moves.get(number), ends.get(number, np.zeros((0, 3)))
            if move is None or not (move.kind == "feed" or len(points)):
                lines.append(line)
            else:
                rates = feeds.get(number) if feeds and move.kind == "feed" else None
                lines += _rewritten(line, move, [_words(point, move.unit) for point in points], rates)
        return lines

    def lines_of(self, path: Toolpath, file, feed: float) -> np.ndarray:
        """Return the line of each block of a path of the file, in these lines."""
        if not self.written_out:
            return path.line
        read = gcode_path(file, list(self.lines), path.program.tool, feed)
        # [m], of a position and its number with seven decimals of a mm
        if len(read) != len(path) or np.abs(read.position - path.position).max() > 1e-9:
            raise InputError(file, "cannot be written out without parameters and sub-programs")
        return read.line

    @property
    def comment(self) -> str:
        """Return the form of a comment of this program, with {} for its text."""
        return "; {}" if any(line.lstrip().startswith(";") for line in self.lines[:200]) else "({})"

    @property
    def head(self) -> int:
        """Return the number of lines before the first block: the start sign, the name of the program, blank lines."""
        named = (
            k
            for k, line in enumerate(self.lines)
            if line.strip() and line.lstrip()[0] not in "%O:o" and not line.startswith(";$PATH")
        )
        return next(named, 0)


def read_source(path, tools: Collection[str], top: float = -math.inf, feed: float = 0.0) -> GcodeSource:
    """Read a program whose lines are to be rewritten for some of its tools, ``""`` for a program without tools.

    A program with parameters, sub-programs or shifts is written out first. top [m]: of the stock; feed [m/s]: for a
    program without F. Raises InputError for incremental moves, feeds in inverse time, and moves home sideways below
    the top of these tools.
    """
    lines = read_lines(path)
    written_out = expanded(path, lines, feed)
    lines = written_out or lines
    program = ProgramBuilder(path, "")
    machine = _Watch(program, 0.0, changes_by_m6(lines))
    machine.tools, machine.top = tools, top
    reader = GcodeReader(program, machine)
    moves: dict[int, SourceMove] = {}
    for program.line, line in enumerate(lines, 1):
        machine.move_of_line = None
        reader.run_line(line)
        if machine.move_of_line:
            moves[program.line] = machine.move_of_line
        if machine.ended:
            break
    return GcodeSource(tuple(lines), moves, written_out is not None)


def _words(point: np.ndarray, unit: float) -> str:
    """X, Y and Z to 0.1 um, or to 1e-5 inch."""
    digits = 4 if unit == MM else 5
    return " ".join(
        f"{axis}{round(value, digits) + 0.0:.{digits}f}" for axis, value in zip("XYZ", point / unit, strict=True)
    )


def _rewritten(line: str, move: SourceMove, places: list[str], rates: np.ndarray | None = None) -> list[str]:
    """Return a line as the blocks that lead to ``places``; rates (k,) [m/s]: feeds in place of that of the line."""
    code = line.lstrip()
    skip = ""
    if mark := SKIP.match(code):
        number = mark[1] or ""
        skip, code = mark[0][len(number) :].lstrip(), number + " " + code[mark.end() :]
    words, ending, comments, place = _sorted_words(code, move)
    feed = move.kind == "feed"
    blocks = [f"G1 {position}" if feed else position for position in places]
    if rates is not None:
        words = [word for word in words if not word.upper().startswith("F")]
        digits = 1 if move.unit == MM else 3
        texts = [f" F{60.0 * rate / move.unit:.{digits}f}" for rate in rates.tolist()]
        before = [""] + texts[:-1]
        blocks = [block + text * (text != last) for block, text, last in zip(blocks, texts, before, strict=True)]
    words.insert(place, blocks[0] if blocks else "G1")
    rows = [words, *([block] for block in blocks[1:])]
    rows[-1] = rows[-1] + ending
    rows[0] = rows[0] + comments
    return [skip + " ".join(row) for row in rows if row]


def _sorted_words(code: str, move: SourceMove) -> tuple[list[str], list[str], list[str], int]:
    """The words of a line without those of its move: of its first block, of its last block, comments; where the move
    was."""
    # words that end a block: they stay on the last of its new blocks
    last_of_block = {("G", 9.0), *(("M", float(code)) for code in (0, 1, 2, 5, 9, 17, 30, 47, 60, 99))}
    words: list[str] = []
    ending: list[str] = []
    comments: list[str] = []
    place = None
    start = 0
    marks = [match for match in COMMENT.finditer(code) if not (match["call"] or match["open"])]
    for span in [*(match.span() for match in marks), (len(code), len(code))]:
        for match in PIECE.finditer(code[start : span[0]].upper()):
            text = match.group()
            if match.lastgroup == "blank":
                continue
            if _of_move(match, move):
                place = len(words) if place is None else place
            elif match.lastgroup == "word" and (text[0], float(text[1:])) in last_of_block:
                ending.append(text)
            else:
                words.append(code[start:][slice(*match.span())])
        comments += [code[slice(*span)]] if span[1] > span[0] else []
        start = span[1]
    return words, ending, comments, len(words) if place is None else place


def _of_move(match, move: SourceMove) -> bool:
    text = match.group()
    if match.lastgroup == "assigned":
        return text.partition("=")[0].strip() in PLACES[move.kind]
    if match.lastgroup != "word":
        return False
    motion = move.kind == "feed" and text[0] == "G" and float(text[1:]) in (0, 1, 2, 3)
    return motion or text[0] in PLACES[move.kind] or (text[0] == "P" and move.arc)
