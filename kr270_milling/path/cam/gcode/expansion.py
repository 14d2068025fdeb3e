"""A program with parameters, sub-programs, shifts or curves written out: one line for each move, in absolute mm.

Cycles along z stay cycles; comments, tools, speeds and words of M stay with their moves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from kr270_milling.base.errors import InputError
from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.reader import GcodeReader, changes_by_m6
from kr270_milling.path.cam.gcode.words import G_GROUPS, word_of
from kr270_milling.path.cam.machine import AXES, MM, NURBS
from kr270_milling.path.cam.program_builder import ProgramBuilder

#: words that stay in their line: dwell, tool length, exact stop, look-ahead
KEPT = frozenset((4, 8, 9, 43, 43.1, 49, 61, 61.1, 64))
#: groups of words that place the coordinates: they stay before the first move
PLACING = frozenset(("offset", "data", "preset"))
ENDING = frozenset((0, 1, 2, 5, 9, 30, 60))  #: M words after the move of their line
DROPPED = frozenset((17, 97, 98, 99))


TITLE = re.compile(r"\s*O\s*[0-9]+\s*", re.I)


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
        codes = {number for kind, number in words if kind == "G"}
        placing = any(G_GROUPS.get(code) in PLACING for code in codes) and not began
        if letter == "G":
            return value in KEPT or (placing and G_GROUPS.get(value) in PLACING)
        if letter == "M":
            return value not in ENDING and value not in DROPPED
        if letter in "ST":
            return 4 not in codes or letter == "T"
        if placing:
            return letter in "LPXYZR"
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

    def home(self, axes: list[str]) -> None:
        self._moves.append(" ".join(["G91 G28", *(f"{axis}0" for axis in axes)]))
        self._moves.append("G90")
        written = [*self._moves]
        super().home(axes)
        self._moves = written


class _Reader(GcodeReader):
    """Keeps the comments of the lines."""

    machine: _Expansion

    def _comments(self, code: str, comments: list[str]) -> None:
        super()._comments(code, comments)
        texts = [f"({comment.replace('(', '[').replace(')', ']')})" for comment in comments if comment]
        if texts and TITLE.fullmatch(code):
            texts[0] = f"{code.strip()} {texts[0]}"
        self.machine.lines += texts


def expanded(path, lines: list[str], feed: float = 0.0, offsets: Sequence[float] = ()) -> list[str] | None:
    """Return the lines of a program written out; None for a program of plain blocks in one place.

    Raises InputError for a program that cannot be run.
    """
    program = ProgramBuilder(path, "")
    machine = _Expansion(program, feed, changes_by_m6(lines), offsets)
    reader = _Reader(program, machine)
    reader.read(lines)
    if not (reader.computed or machine.needed):
        return None
    if program.refusals:
        raise InputError(path, "a program with words that cannot be run cannot be written out", program.line)
    return [*machine.lines, ""]


def _number(length: float) -> str:
    """[mm], with all digits that a position has."""
    return f"{round(length / MM, 7) + 0.0:.7f}".rstrip("0").rstrip(".")
