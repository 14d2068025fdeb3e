"""Blocks of G-code, already words, for the machine: what they set, move and end."""

from __future__ import annotations

import math
from typing import Any

from kr270_milling.base.text import short
from kr270_milling.path.cam.gcode.words import ADVICE, AXES5, DATUM, G_GROUPS, M_GROUPS, MODAL, OFFSETS, UNKNOWN
from kr270_milling.path.cam.machine import AXES, Machine
from kr270_milling.path.cam.program_builder import ProgramBuilder

__all__ = ["Interpreter"]

SENSE = {3: 1, 13: 1, 4: -1, 14: -1}
#: letters that only go with other words and move nothing by themselves
ARGUMENTS = ("P", "Q", "L", "E", "H", "D")
REST = frozenset("OABCUVWE")
MOVES = frozenset(("motion", "cycle"))  #: groups that set nothing else
PRINTER = "a word of 3-D printers or a number with an exponent; post for a milling machine"


class Interpreter(Machine):
    """Runs blocks of words; what cannot be run goes to the refusals, what moves nothing is counted."""

    def __init__(self, program: ProgramBuilder, feed: float, changes: bool):
        super().__init__(program, feed)
        self.silent = program.silent
        self.changes = changes  #: whether a tool comes with M6, else with its T
        self.next_tool = ""
        self.turning = 0
        self.speed = 0.0  #: [rad/s]

    def run(self, words: list[tuple[str, Any]]) -> None:
        """One block of letters and numbers, for T also a name: first what it sets, then the move, then what it ends."""
        axes: dict[str, float] = {}
        groups: dict[str, float] = {}
        for letter, value in words:
            if letter in "GM":
                self._group(letter, value, groups)
            elif letter == "T":
                self.next_tool = f"T{value:g}" if isinstance(value, float) else value
                groups["T"] = 0
            elif letter in axes:
                self.program.refuse(letter, f"the word {letter} occurs twice in its line")
            elif letter != "N":
                axes[letter] = value
        if not REST.isdisjoint(axes):
            self._rest(axes)
        if not groups.keys() <= MOVES:
            self._set(groups, axes)
        if "F" in axes:
            self.set_feed(axes.pop("F"), self.unit)
        if "S" in axes or "spindle" in groups:
            self._turn(groups, axes)
        if axes or groups:
            self.move(axes, groups.get("motion"), groups.get("cycle"))
            for letter in axes:  # those that belong to no move
                self.silent[short(letter)] += 1
        if "end" in groups:
            self.ended = True

    # --- what the words are ---

    def _group(self, letter: str, value: float, groups: dict) -> None:
        """Note a word under its modal group."""
        word, group = f"{letter}{value:g}", (G_GROUPS if letter == "G" else M_GROUPS).get(value)
        if group is not None:
            if groups.setdefault(group, value) != value and group not in ("home", "end"):
                self.program.refuse(word, f"{word} contradicts another word of its kind in the same line")
        elif letter == "M" and word not in ADVICE:
            self.silent[word] += 1
            groups["other"] = value
        else:
            moves = letter == "M" or not (41 <= value < 43 or value in (96, 22, 23))
            self.program.refuse(word, advice=ADVICE.get(word, UNKNOWN), lost=moves)
            if moves:
                groups["refused"] = value

    def _rest(self, axes: dict) -> None:
        """Program numbers, rotary and further axes."""
        for letter in sorted(REST & axes.keys()):
            value = axes.pop(letter)
            if letter == "E" and not axes.keys().isdisjoint(AXES):
                self.program.refuse(f"E{value:g}", advice=PRINTER)
            elif letter not in "OE" and value:
                self.program.refuse(f"{letter}{value:g}", advice=AXES5)
            elif letter not in "OE":
                self.silent[f"{letter}0"] += 1

    # --- what a block sets ---

    def _set(self, groups: dict, axes: dict) -> None:
        for group in MODAL.keys() & groups.keys():
            setattr(self, group, MODAL[group][groups[group]])
        if "feed" in groups:
            self.set_feed_mode(int(groups["feed"]))
        if "tool" in groups if self.changes else "T" in groups:
            self.change_tool(self.next_tool)
        if "dwell" in groups:
            self.silent["G4"] += 1
            _drop(axes, "P", "X", "U", "F", "S")
        for word in [group for group in groups if group[0] == "G"]:
            self._read_over(word, axes)
        if "offset" in groups:
            value = groups["offset"]
            self.program.offset = OFFSETS.get(value) or f"G{value:g} P{axes.pop('P', 1):g}"
        if "home" in groups:
            self._home(groups, axes)
        for group, word in (("preset", "G92"), ("shift", "G52"), ("data", "G10")):
            if group in groups:
                self._datum(word, axes)
        if "refused" in groups:
            axes.clear()
        elif not groups.keys().isdisjoint(("other", "T", "tool", "end")):
            _drop(axes, *ARGUMENTS)  # P of M62, D of a tool
        if groups.get("spindle") == 19:
            self.silent["M19"] += 1

    def _read_over(self, word: str, axes: dict) -> None:
        """A G word that changes no path, except together with certain words: G5, G74, G75."""
        if word in ("G74", "G75") or (word == "G5" and not axes.keys().isdisjoint("XYIJ")):
            self.program.refuse(word, advice=ADVICE.get(word, UNKNOWN), lost=True)
            axes.clear()
            return
        if word == "G43":
            self.program.length_offsets.add(self.program.tool)
        if word == "G43" and "H" in axes:
            word += f" H{axes['H']:g}"
        self.silent[word] += 1
        _drop(axes, *ARGUMENTS)
        if axes.keys() <= {"R"}:  # of G5.1
            axes.clear()

    def _home(self, groups: dict, axes: dict) -> None:
        """G28, G30, G53: the named axes leave the workpiece; without a name, and not for G53, all of them."""
        word, mode = f"G{groups['home']:g}", groups.pop("motion", None)
        axes_home = [axis for axis in AXES if axis in axes]
        if mode is not None and mode > 1:
            self.program.refuse(word, f"{word} occurs with an arc in one line")
        elif mode is not None:
            self.set_mode(mode)
        if not axes_home and word in ("G28", "G30"):
            axes_home = list(AXES)
        self.silent[" ".join([word, *axes_home])] += 1
        self.home(axes_home)
        _drop(axes, *axes_home, *ARGUMENTS)

    def _datum(self, word: str, axes: dict) -> None:
        """G10, G52, G92: harmless before the first move, for tool data, and as a shift by nothing."""
        lengths = {axis: axes[axis] for axis in AXES if axis in axes}
        began = len(self.program) > 0
        harmless = {
            "G92": bool(lengths) and not began,
            "G52": not any(lengths.values()),
            "G10": not began or axes.get("L") in (1, 10, 11, 12, 13),
        }
        if harmless[word]:
            self.silent[word] += 1
        else:
            self.program.refuse(word, advice=DATUM, lost=True)
        if word == "G92":
            for axis, value in lengths.items():
                self.position[AXES[axis]] = value * self.unit
        axes.clear()

    def _turn(self, groups: dict, axes: dict) -> None:
        """S counts only while the spindle turns."""
        speed = axes.pop("S", None)
        if speed is not None and not 0 <= speed <= 1e6:
            reason = f"the spindle speed S{speed:g} must lie between 0 and 1e6 rpm"
            self.program.refuse(f"S{speed:g}", reason)
        elif speed is not None:
            self.speed = speed * 2 * math.pi / 60
        if "spindle" in groups:
            self.turning = SENSE.get(groups["spindle"], 0)
        self.program.spindle_speed = self.turning * self.speed


def _drop(axes: dict, *letters: str) -> None:
    for letter in letters:
        axes.pop(letter, None)
