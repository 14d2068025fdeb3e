"""Writes a list of moves as the posts of several controllers do, with the choices that they differ in."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["DIALECTS", "Move", "Style", "write"]


@dataclass(frozen=True)
class Move:
    """One block in mm: to a point, straight or about a centre in the xy plane."""

    end: tuple[float, float, float]
    feed: float = 0.0  #: [mm/min], 0: rapidly
    centre: tuple[float, float] | None = None
    clockwise: bool = False
    name: str = ""  #: of the operation that begins with it


@dataclass(frozen=True)
class Style:
    """How a post writes."""

    numbered: bool = False
    blanks: bool = True
    lower: bool = False
    modal: bool = True  #: words that change nothing are left out
    inch: bool = False
    incremental: bool = False
    centres: str = "relative"  #: or "absolute" (G90.1), "AC"
    feed: str = "minute"  #: or "turn" (G95), "inverse" (G93)
    padded: bool = False  #: G01, X1.
    head: tuple[str, ...] = ()
    tail: tuple[str, ...] = ("M30",)
    comment: str = "({})"


SPEED = 5000  #: [rpm]
DIALECTS = {
    "haas": Style(
        padded=True, head=("%", "O01000 (PART)", "G00 G17 G21 G40 G49 G80 G90", "T01 M06", "G54", "G43 H01", "M08"),
        tail=("M09", "G53 G49 Z0. M05", "M30", "%"),
    ),
    "fanuc": Style(
        numbered=True, blanks=False, padded=True, incremental=True,
        head=("%", ":1000", "G0G17G40G49G80", "G91G28Z0.", "T1M6", "G90G54G95"), feed="turn",
        tail=("G91G28Z0.", "G28X0.Y0.", "M30", "%"),
    ),
    "grbl": Style(head=("G90 G94", "G17", "G21", "G28 G91 Z0", "G90", "T1", "G54"), tail=("M5", "M2")),
    "linuxcnc": Style(
        lower=True, inch=True, centres="absolute", modal=False, comment="; {}",
        head=("g17 g20 g40 g49 g80 g90 g90.1 g64 p0.001", "t1 m6 g43 h1"), tail=("m5", "m2"),
    ),
    "inverse time": Style(feed="inverse", head=("G17 G21 G90 G93 G91.1",)),
    "sinumerik": Style(
        numbered=True, centres="AC", comment="; {}",
        head=("%_N_PART_MPF", "G17 G71 G90 G94 G40 DIAMOF", "G0 SUPA Z0 D0", 'T="MILL" D1', "M6", "G54 CYCLE832(0.01)"),
        tail=("G0 SUPA Z0", "M30"),
    ),
}  # fmt: skip


def write(moves: list[Move], style: Style) -> tuple[str, list[int]]:
    """The text, and the line of each move, from 1."""
    writer = _Writer(style)
    for line in style.head:
        writer.line(line)
    writer.line(f"S{SPEED} M3")
    lines = [writer.move(move) for move in moves]
    for line in style.tail:
        writer.line(line)
    return "\n".join(writer.lines) + "\n", lines


class _Writer:
    def __init__(self, style: Style):
        self.style = style
        self.lines: list[str] = []
        self.at: tuple | None = None
        self.code = ""
        self.feed = None
        self.relative = False

    def line(self, text: str) -> int:
        if self.style.numbered and text[:1] not in ("%", ":", ";", "("):
            text = f"N{10 * len(self.lines)} {text}"
        if not self.style.blanks and text[:1] not in ("%", "("):
            text = text.replace(" ", "")
        self.lines.append(text.lower() if self.style.lower else text)
        return len(self.lines)

    def number(self, value: float) -> str:
        text = f"{value / 25.4:.7f}" if self.style.inch else f"{value:.4f}"
        text = text.rstrip("0") if self.style.padded else text.rstrip("0").rstrip(".")
        return "0" if text in ("-0", "") else text

    def move(self, move: Move) -> int:
        if move.name:
            self.lines.append(self.style.comment.format(move.name))
        wanted = self.style.incremental and self.at is not None
        if wanted != self.relative:
            self.line("G91" if wanted else "G90")
            self.relative = wanted
        words = [*self._code(move), *self._lengths(move), *self._centre(move), *self._feed(move)]
        self.at = move.end
        return self.line(" ".join(words) or "G90")

    def _code(self, move: Move) -> list[str]:
        code = "0" if not move.feed else "1" if move.centre is None else "2" if move.clockwise else "3"
        word = f"G{'0' * self.style.padded}{code}"
        changed, self.code = word != self.code, word
        return [word] if changed or not self.style.modal else []

    def _lengths(self, move: Move) -> list[str]:
        words = []
        for k, letter in enumerate("XYZ"):
            if self.relative:
                step = round(move.end[k] - self.at[k], 4)
                if step or not self.style.modal:
                    words.append(letter + self.number(step))
            elif not self.style.modal or self.at is None or move.end[k] != self.at[k] or move.centre is not None:
                words.append(letter + self.number(move.end[k]))
        return words

    def _centre(self, move: Move) -> list[str]:
        if move.centre is None:
            return []
        if self.style.centres == "AC":
            return [f"{letter}=AC({self.number(c)})" for letter, c in zip("IJ", move.centre, strict=True)]
        origin = (0.0, 0.0) if self.style.centres == "absolute" else self.at
        return [letter + self.number(c - o) for letter, c, o in zip("IJ", move.centre, origin[:2], strict=True)]

    def _feed(self, move: Move) -> list[str]:
        if not move.feed:
            return []
        if self.style.feed == "inverse":
            return [f"F{move.feed / _length(self.at, move):.9f}"]
        value = move.feed / SPEED if self.style.feed == "turn" else move.feed / (25.4 if self.style.inch else 1.0)
        changed, self.feed = value != self.feed, value
        return [f"F{value:.9f}".rstrip("0")] if changed or not self.style.modal else []


def _length(start: tuple, move: Move) -> float:
    """[mm], of a straight move or a half circle."""
    steps = [e - s for e, s in zip(move.end, start, strict=True)]
    if move.centre is None:
        return math.hypot(*steps)
    radius = math.dist(start[:2], move.centre)
    return math.hypot(math.pi * radius, steps[2])
