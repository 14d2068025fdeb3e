"""Blocks of G-code, already words, for the machine: what they set, move and end.

Each word of a block is taken out of it by what uses it. A word that is left is in the list of what may be read over,
and counted, or it is refused with its block: used + counted + refused = all (``ProgramBuilder.words``).
"""

from __future__ import annotations

import math
from typing import Any

from kr270_milling.path.cam.gcode.words import (
    ADVICE,
    BELONGS,
    CLAIMS,
    DATUM,
    G_GROUPS,
    LEFT,
    M_GROUPS,
    MODAL,
    OFFSETS,
    SILENT_G,
    SILENT_M,
    UNKNOWN,
    UNKNOWN_M,
    word_of,
)
from kr270_milling.path.cam.machine import AXES, OF_ARCS, Machine
from kr270_milling.path.cam.program_builder import ProgramBuilder

__all__ = ["Interpreter"]

FURTHER = frozenset("ABCUVW")
MOVES = frozenset(("motion", "cycle"))  #: groups that set nothing else
TOOL_DATA = {"H": "tool lengths", "D": "tool edges"}


class Interpreter(Machine):
    """Runs blocks of words; what cannot be run goes to the refusals, what moves nothing is counted."""

    def __init__(self, program: ProgramBuilder, feed: float, changes: bool):
        super().__init__(program, feed)
        self.changes = changes  #: M6 changes the tool, else its T does
        self.next_tool = ""
        self.turning = 0
        self.speed = 0.0  #: [rad/s]
        self.preset = False  #: G92 gave the tool its place

    def run(self, words: list[tuple[str, Any]]) -> None:
        """Run a block of letters and numbers, for T also a name: first its settings, then the move, then its end."""
        program = self.program
        refusals, counted = program.refusals, program.words["counted"]
        axes: dict[str, float] = {}
        groups: dict[str, float] = {}
        for letter, value in words:
            if letter in "GM":
                self._group(letter, value, groups)
            elif letter in axes or (letter == "T" and "T" in groups):
                program.refuse(letter, f"the word {letter} occurs twice in its line")
            elif letter == "T":
                self.next_tool = word_of("T", value) if isinstance(value, float) else value
                groups["T"] = 0
            elif letter != "N" and (letter != "O" or axes or groups):
                axes[letter] = value
        if not groups.keys() <= MOVES:
            self._set(groups, axes)
        if "F" in axes:
            self.set_feed(axes.pop("F"), self.unit)
        if "S" in axes or "spindle" in groups:
            self._turn(groups, axes)
        if "unclear" in groups:
            feed, unit = word_of("F", self.feed_word or 0.0), word_of("G", groups["unit"])
            self.feed = None
            self.no_feed = (
                f"the feed {feed} comes before or with {unit}, and controls take it in either unit; write F after it"
            )
        if axes or groups:
            self.move(axes, groups.get("motion"), groups.get("cycle"))
            for letter, value in axes.items():
                self._left(letter, value)
        if "end" in groups:
            self.ended = True
        fate = "used" if program.refusals == refusals else "refused"
        program.words[fate] += len(words) - (program.words["counted"] - counted)

    # --- what the words are ---

    def _group(self, letter: str, value: float, groups: dict) -> None:
        """Note a word under its modal group."""
        group = (G_GROUPS if letter == "G" else M_GROUPS).get(value)
        if group is not None:
            if groups.setdefault(group, value) != value and group not in ("home", "end"):
                word = word_of(letter, value)
                self.program.refuse(word, f"{word} contradicts another word of its kind in the same line")
            if letter == "G" and value in CLAIMS:
                groups["claim"] = value
        else:
            word = word_of(letter, value)
            moves = letter == "M" or not (41 <= value < 43 or value in (96, 22, 23))
            advice = ADVICE.get(word, UNKNOWN if letter == "G" else UNKNOWN_M)
            self.program.refuse(word, advice=advice, lost=moves)
            if moves:
                groups["refused"] = value

    def _left(self, letter: str, value: float) -> None:
        """Count or refuse a word that no other word of its line took."""
        if letter in TOOL_DATA:
            self.program.set_frame(TOOL_DATA[letter], word_of(letter, value))
            self.program.count(letter)
        elif not value and (letter in FURTHER or letter in OF_ARCS):
            self.program.count(f"{letter}0")
        elif letter == "P" and self.cycle is not None and self.drilled:
            self.program.count("P")
        else:
            word = word_of(letter, value)
            reason = "" if letter in FURTHER else f"the word {word} belongs to no other word of its line"
            self.program.refuse(word, reason, LEFT.get(letter, BELONGS), derived=letter in OF_ARCS)

    def _read_over(self, word: str, axes: dict, letters: str) -> None:
        """Count a word together with the words that belong to it."""
        self.program.count(word, 1 + len([axes.pop(letter) for letter in letters if letter in axes]))

    # --- what a block sets ---

    def _set(self, groups: dict, axes: dict) -> None:
        unit = self.unit
        for group in MODAL.keys() & groups.keys():
            setattr(self, group, MODAL[group][groups[group]])
        if self.unit != unit and (self.feed_word is not None or "F" in axes):
            groups["unclear"] = 0
        if "feed" in groups:
            self.set_feed_mode(int(groups["feed"]))
        if "claim" in groups:
            self._claimed(groups, axes)
        if "tool" in groups if self.changes else "T" in groups or "tool" in groups:
            if groups.get("tool") == 61 and "Q" in axes:  # the number of the tool that is in the spindle
                self.next_tool = word_of("T", axes.pop("Q"))
            elif groups.get("tool") == 61:
                self.program.refuse("M61", "M61 without Q, the number of the tool")
            self.change_tool(self.next_tool)
            if groups.get("tool") == 6:  # it stops the spindle: NIST RS274/NGC 3.6.3
                self.turning, self.program.spindle_speed = 0, 0.0
        if "dwell" in groups:
            self._dwell(groups, axes)
        if "offset" in groups or "G15" in groups:
            self._offset(groups, axes)
        for word in [group for group in groups if group[0] in "GM"]:
            self._silent(word, groups[word], axes)
        if "home" in groups:
            self._home(groups, axes)
        for group, word in (("preset", "G92"), ("shift", "G52"), ("data", "G10")):
            if group in groups:
                self._datum(word, groups, axes)
        if "refused" in groups:
            axes.clear()
        if groups.get("spindle") == 19:
            if "S" in axes:
                self.program.refuse("M19", "M19 with S is a speed or an angle", "write S in the line of M3 or M4")
            self._read_over("M19", axes, SILENT_M[19])

    def _offset(self, groups: dict, axes: dict) -> None:
        """G54 to G59.3 and others; G54.1 P, G154 P, and G15 H of Okuma."""
        names = []
        if "G15" in groups and "H" in axes:
            names.append(f"G15 {word_of('H', axes.pop('H'))}")
        if "offset" in groups:
            value = groups["offset"]
            names.append(OFFSETS.get(value) or f"{word_of('G', value)} {word_of('P', axes.pop('P', 1))}")
        for name in names:
            self.program.set_frame("work offsets", name)
        if len(names) > 1:
            self.program.refuse(names[1], f"{names[1]} contradicts {names[0]} in the same line")

    def _claimed(self, groups: dict, axes: dict) -> None:
        """Refuse letters that are a move on one control and something else on another."""
        letters, meaning = CLAIMS[groups["claim"]]
        letter = next((letter for letter in letters if letter in axes), "")
        if letter and "motion" not in groups:
            word = word_of("G", groups["claim"])
            reason = f"{word} with {letter} {meaning}"
            self.program.refuse(word, reason, "write G0 to G3 or post without it", lost=True)
            groups["refused"] = groups["claim"]

    def _dwell(self, groups: dict, axes: dict) -> None:
        """G4 takes P; without P the one of X, U, F and S that is its time, in a block without a move."""
        times = [letter for letter in "XUFS" if letter in axes and not (letter == "S" and "spindle" in groups)]
        if "P" in axes or not times:
            self._read_over("G4", axes, "P")
        elif len(times) > 1 or "motion" in groups or not axes.keys().isdisjoint("YZ"):
            reason = f"{times[0]} may be the time of G4 or not"
            self.program.refuse("G4", reason, "write G4 P, or G4 in a line without other words", lost=True)
            groups["refused"] = 4
        else:
            self._read_over("G4", axes, times[0])

    def _silent(self, word: str, value: float, axes: dict) -> None:
        """A word that changes no path, except together with certain words: G5, G54.4, G74, G75, G92.1 to G92.3."""
        began = len(self.program) > 0
        letters = (SILENT_G if word[0] == "G" else SILENT_M)[value]
        if word in ("G92.1", "G92.2", "G92.3") and began and (self.preset or value == 92.3):
            self.program.refuse(word, advice=DATUM, lost=True)
        elif word in ("G74", "G75") or (word == "G5" and not axes.keys().isdisjoint("XYIJ")):
            self.program.refuse(word, advice=ADVICE.get(word, UNKNOWN), lost=True)
            axes.clear()
        elif word == "G54.4" and axes.get("P"):
            self.program.refuse(word, advice=DATUM, lost=True)
        else:
            number = f" {word_of('H', axes['H'])}" if word == "G43" and "H" in axes else ""
            if word == "G43":
                self.program.length_offsets.add(self.program.tool)
            if word in ("G43", "G49"):  # without H it is that of the tool
                length = number.strip() or f"H{self.program.tool[1:]}"
                self.program.set_frame("tool lengths", "H0" if word == "G49" else length)
            self._read_over(word + number, axes, letters)

    def _home(self, groups: dict, axes: dict) -> None:
        """G28, G30, G53: the named axes leave the workpiece; without a name, and not for G53, all of them."""
        word, mode = word_of("G", groups["home"]), groups.pop("motion", None)
        axes_home = [axis for axis in AXES if axis in axes]
        if mode is not None and mode > 1:
            self.program.refuse(word, f"{word} occurs with an arc in one line")
        elif mode is not None:
            self.set_mode(mode)
        text = " ".join([word, *(axes_home or (AXES if word in ("G28", "G30") else []))])
        self._read_over(text, axes, "XYZP" if word == "G30" else "XYZ")
        self.home(text.split()[1:])

    def _datum(self, word: str, groups: dict, axes: dict) -> None:
        """G10, G52, G92: harmless before the first move, for tool data, and as a shift by nothing; G92 S is a limit."""
        lengths = {axis: axes[axis] for axis in AXES if axis in axes}
        began = len(self.program) > 0
        limit = word == "G92" and "S" in axes and not lengths
        harmless = {
            "G92": limit or (bool(lengths) and not began),
            "G52": not any(lengths.values()),
            "G10": not began or axes.get("L") in (1, 10, 11, 12, 13),
        }
        if not harmless[word] or not groups.keys().isdisjoint(MOVES):
            self.program.refuse(word, advice=DATUM, lost=True)
            axes.clear()
        else:
            if lengths and word == "G92":
                self.preset = True
                for axis, value in lengths.items():
                    self.position[AXES[axis]] = value * self.unit
            self._read_over(word, axes, {"G92": "S" if limit else "XYZ", "G52": "XYZ", "G10": "LPQRXYZIJKHD"}[word])

    def _turn(self, groups: dict, axes: dict) -> None:
        """S counts only while the spindle turns."""
        speed = axes.pop("S", None)
        if speed is not None and not 0 <= speed <= 1e6:
            reason = f"the spindle speed S{speed:g} must lie between 0 and 1e6 rpm"
            self.program.refuse(f"S{speed:g}", reason)
        elif speed is not None:
            self.speed = speed * 2 * math.pi / 60
        if "spindle" in groups:
            self.turning = {3: 1, 13: 1, 4: -1, 14: -1}.get(groups["spindle"], 0)
        self.program.spindle_speed = self.turning * self.speed
