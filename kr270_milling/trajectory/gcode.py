"""G-code in: G0 G1 G2 G3 (I, J or R), G17, G20/G21, G90/G91, F, S, M3/M5, M2/M30, N, comments.

Words that only state the default (G40, G49, G54, G80, G94) are read over; anything else is refused with its line.
Without G20 or G21 the unit is mm. A comment that stands alone in its line and is one word, as ``(circle)``, names the
feature of the part that follows. Arc centres I, J are counted from the start of the arc.
"""

from __future__ import annotations

import math
import re

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.trajectory.arcs import ArcError, centre_from_radius, flatten
from kr270_milling.trajectory.files import ends_in_mid_line, read_lines, short
from kr270_milling.trajectory.toolpath import REACH, PathBuilder, Toolpath

__all__ = ["read_gcode"]

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
WORD = re.compile(rf"([A-Z])[ \t]*({NUMBER})")
LINE = re.compile(rf"(?:[ \t]*[A-Z][ \t]*{NUMBER})*[ \t]*")
FEATURE = re.compile(r"[A-Za-z][\w-]{0,39}")
#: G word -> modal group; two words of one group cannot stand in one line
GROUPS = {0: "motion", 1: "motion", 2: "motion", 3: "motion", 80: "cycle", 17: "plane", 20: "units", 21: "units",
          90: "distance", 91: "distance", 40: "cutter", 49: "length", 54: "datum", 94: "feed"}  # fmt: skip
M_GROUPS = {2: "end", 30: "end", 3: "spindle", 5: "spindle"}
AXES = {"X": 0, "Y": 1, "Z": 2}
INCH, MM = 0.0254, 0.001
FLAT = 1e4  # [m] radius beyond which no arc can be meant


def read_gcode(path, chord_tolerance: float = 2e-6, closing_tolerance: float = 10e-6) -> Toolpath:
    """Read a G-code file; chord_tolerance [m]: arcs to chords; closing_tolerance [m]: centre of an arc to both ends."""
    lines = read_lines(path)
    reader = _Reader(path, chord_tolerance, closing_tolerance)
    for number, line in enumerate(lines, 1):
        reader.read(line, number)
        if reader.ended:
            break
    else:
        ends_in_mid_line(path, lines)
    return reader.path.build(len(lines))


class _Reader:
    """The modal state of a milling machine."""

    def __init__(self, source, chord_tolerance: float, closing_tolerance: float):
        self.source, self.chord, self.closing = source, chord_tolerance, closing_tolerance
        self.path = PathBuilder(source)
        self.position: list[float] = [math.nan] * 3  # [m], NaN until the file says where
        self.motion: int | None = None
        self.unit, self.incremental, self.feed, self.speed, self.turning = MM, False, None, 0.0, False
        self.ended = False

    def refuse(self, reason: str, number: int):
        raise InputError(self.source, reason, number)

    def read(self, line: str, number: int) -> None:
        if "(" in line or ";" in line or ")" in line or "%" in line:
            line = self._without_comments(line, number)
        line = line.upper()
        if not LINE.fullmatch(line):
            self._refuse_text(line, number)
        words = WORD.findall(line)
        if words:
            self._run(words, number)

    def _without_comments(self, line: str, number: int) -> str:
        if line.strip() == "%":
            return ""
        code, comments = "", []
        while line:
            before, mark, line = re.match(r"([^(;]*)([(;]?)(.*)", line, re.DOTALL).groups()
            code += before + " "
            if mark == "(":
                comment, closed, line = line.partition(")")
                if not closed:
                    self.refuse("a comment is opened with ( but not closed", number)
                comments.append(comment.strip())
            elif mark == ";":
                break
        if comments and not code.strip() and FEATURE.fullmatch(comments[0]):
            self.path.name_feature(comments[0])
        return code

    def _refuse_text(self, line: str, number: int) -> None:
        rest = line[LINE.match(line).end() :].lstrip(" \t")
        shown = short(re.split(r"[ \t]", rest)[0])
        if re.fullmatch(r"[A-Z][-+.]*", shown):
            self.refuse(f"the word {shown} has no number", number)
        self.refuse(f"{shown!r} is no G-code word (a letter and a number)", number)

    def _run(self, words: list[tuple[str, str]], number: int) -> None:
        """One block: first what it sets, then the move, then what it ends."""
        axes: dict[str, float] = {}
        groups: dict[str, int] = {}
        seen = set()
        for letter, text in words:
            value = float(text)
            if letter in "GM":
                group = (GROUPS if letter == "G" else M_GROUPS).get(value)
                if group is None:
                    self.refuse(f"{letter}{short(text)} is not supported", number)
                if group in groups:
                    self.refuse(f"{letter}{short(text)} contradicts another word of its kind in the same line", number)
                groups[group] = int(value)
                continue
            if letter in seen:
                self.refuse(f"the word {letter} stands twice", number)
            seen.add(letter)
            if letter in "XYZIJRFS":
                axes[letter] = value
            elif letter != "N":
                self.refuse(f"{letter}{short(text)} is not supported", number)
        self._set(groups, axes, number)
        if axes:
            self._move(axes, number)
        if "end" in groups:
            self.ended = True

    def _set(self, groups: dict[str, int], axes: dict[str, float], number: int) -> None:
        if "units" in groups:
            self.unit = INCH if groups["units"] == 20 else MM
        if "distance" in groups:
            self.incremental = groups["distance"] == 91
        if "motion" in groups:
            self.motion = groups["motion"]
        feed, speed = axes.pop("F", None), axes.pop("S", None)
        if feed is not None:
            if not 0 <= feed * self.unit <= 60 * REACH:
                self.refuse(f"the feed F{feed:g} must lie between 0 and {60 * REACH / self.unit:g} per minute", number)
            self.feed = feed * self.unit / 60
        if speed is not None:
            if not 0 <= speed <= 1e6:
                self.refuse(f"the spindle speed S{speed:g} must lie between 0 and 1e6 rpm", number)
            self.speed = speed * 2 * math.pi / 60
        if "spindle" in groups:
            self.turning = groups["spindle"] == 3
            if self.turning and self.speed == 0:
                self.refuse("M3 without a spindle speed S", number)
        if speed is not None or "spindle" in groups:
            self.path.spindle_speed = self.speed if self.turning else 0.0

    def _move(self, axes: dict[str, float], number: int) -> None:
        if self.motion is None:
            self.refuse(f"the word {next(iter(axes))} without G0, G1, G2 or G3", number)
        start, end = self.position, list(self.position)
        for letter, axis in AXES.items():
            if letter in axes:
                end[axis] = axes[letter] * self.unit + (start[axis] if self.incremental else 0.0)
                if math.isnan(end[axis]):
                    self.refuse("a G91 move before an absolute position is known", number)
                if not abs(end[axis]) <= REACH:
                    self.refuse(f"{letter}{axes[letter]:g} lies more than {REACH:g} m away; wrong unit?", number)
        arc = [letter for letter in "IJR" if letter in axes]
        if self.motion in (0, 1) and arc:
            self.refuse(f"the word {arc[0]} belongs to G2 or G3, not to G{self.motion}", number)
        if self.motion == 0:
            self._rapid(end, number)
        else:
            self._cut(start, end, axes, number)
        self.position = end

    def _rapid(self, end: list[float], number: int) -> None:
        if not any(map(math.isnan, end)):  # until X, Y and Z are known there is no place to start from
            self.path.move(tuple(end), 0.0, True, number)

    def _cut(self, start: list[float], end: list[float], axes: dict[str, float], number: int) -> None:
        if any(map(math.isnan, start)):
            self.refuse(f"G{self.motion} before X, Y and Z are known; start with G0 X Y Z", number)
        if not self.feed:
            self.refuse("zero feed on a cutting move" if self.feed == 0 else "a cutting move without a feed F", number)
        if self.motion == 1:
            self.path.move(tuple(end), self.feed, False, number)
            return
        clockwise = self.motion == 2
        offset = [axes.get(letter, 0.0) * self.unit for letter in "IJR"]
        far = next((letter for letter in "IJR" if not abs(axes.get(letter, 0.0)) * self.unit <= FLAT), None)
        try:
            if far:
                raise ArcError(f"{far}{axes[far]:g} is more than {FLAT / 1e3:g} km; wrong unit?")
            if "R" in axes and ("I" in axes or "J" in axes):
                raise ArcError("an arc is given by I and J or by R, not by both")
            if "R" in axes:
                centre = centre_from_radius(start, end, offset[2], clockwise, self.closing)
            elif "I" in axes or "J" in axes:
                centre = (start[0] + offset[0], start[1] + offset[1])
            else:
                raise ArcError(f"G{self.motion} without I, J or R")
            points, curvature = flatten(start, end, centre, clockwise, self.closing, self.chord)
            if not np.abs(points).max() <= REACH:
                raise ArcError(f"the arc leads more than {REACH:g} m away; wrong unit?")
        except ArcError as error:
            self.refuse(str(error), number)
        for point in points.tolist():
            self.path.move(tuple(point), self.feed, False, number, curvature)
