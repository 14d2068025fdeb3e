"""The modal state of a milling machine, block after block."""

from __future__ import annotations

import math

from kr270_milling.base.text import short
from kr270_milling.trajectory.gcode.blocks import Block
from kr270_milling.trajectory.gcode.motion import Motion
from kr270_milling.trajectory.gcode.words import (
    AXES5,
    CURVES,
    DATUM,
    G_ADVICE,
    G_GROUPS,
    G_SILENT,
    M_ADVICE,
    M_GROUPS,
    OFFSETS,
    UNKNOWN,
)
from kr270_milling.trajectory.summary import Observed, Refusals
from kr270_milling.trajectory.toolpath import PathBuilder

__all__ = ["Machine"]

INCH = 0.0254
MM = 0.001
UNITS = {20: INCH, 70: INCH, 700: INCH, 21: MM, 71: MM, 710: MM}
SENSE: dict[float, int] = {3: 1, 13: 1, 4: -1, 14: -1}
#: letters that only go with other words and move nothing by themselves
ARGUMENTS = ("P", "Q", "L", "E", "H", "D")
REST = frozenset("OABCUVWE")
PRINTER = "a word of 3-D printers or a number with an exponent; post for a milling machine"


class Machine:
    """Runs blocks of words: moves go to the path, what cannot be run to the refusals, the rest is counted."""

    def __init__(self, path: PathBuilder, refusals: Refusals, motion: Motion, seen: Observed, changes: bool):
        self.path = path
        self.refusals = refusals
        self.motion = motion
        self.seen = seen
        self.silent = seen.silent
        self.changes = changes  #: whether a tool comes with M6, else with its T
        self.unit = MM
        self.tool = ""
        self.next_tool = ""
        self.turning = 0
        self.speed = 0.0  #: [rad/s]
        self.ended = False

    def run(self, words: list[tuple[str, float]], number: int, block: Block | None = None) -> None:
        """One block: first what it sets, then the move, then what it ends."""
        axes: dict[str, float] = {}
        groups: dict[str, float] = {}
        for letter, value in words:
            if letter == "G":
                self._preparatory(value, groups, number)
            elif letter == "M":
                self._auxiliary(value, groups, number)
            elif letter == "T":
                self.next_tool = f"T{value:g}"
                groups["T"] = value
            elif letter == "N":
                continue
            elif letter in axes:
                self.refusals.add(number, letter, f"the word {letter} stands twice in its line")
            else:
                axes[letter] = value
        if block is not None:
            self._names(block, groups, axes)
        if not REST.isdisjoint(axes):
            self._rest(axes, number)
        if groups:
            self._set(groups, axes, number)
        if "F" in axes or "S" in axes:
            self._speeds(axes, number)
        if "spindle" in groups:
            self.turning = SENSE.get(groups["spindle"], 0)
        if groups or "S" in axes:
            self._turn(axes)
        if axes:
            absolute = block.absolute if block is not None else {}
            self.motion.run(groups, axes, self.unit, absolute, number)
            for letter in axes:  # those that belong to no move
                self.silent[short(letter)] += 1
        elif "motion" in groups or "cycle" in groups:
            self.motion.set_mode(groups.get("motion", self.motion.mode))
        if "end" in groups:
            self.ended = True

    # --- what the words are ---

    def _preparatory(self, value: float, groups: dict, number: int) -> None:
        word, group = f"G{value:g}", G_GROUPS.get(value)
        if group is not None:
            if groups.setdefault(group, value) != value and group != "home":
                self.refusals.add(number, word, f"{word} contradicts another word of its kind in the same line")
        elif value in G_SILENT or value in (5, 74, 75):
            groups[word] = value
        else:
            moves = not 41 <= value < 43 and value not in (96, 22, 23)
            self.refusals.add(number, word, advice=G_ADVICE.get(value, UNKNOWN), lost=moves)
            groups["refused" if moves else "compensated"] = value

    def _auxiliary(self, value: float, groups: dict, number: int) -> None:
        word, group = f"M{value:g}", M_GROUPS.get(value)
        if value in M_ADVICE:
            self.refusals.add(number, word, advice=M_ADVICE[value], lost=True)
            groups["refused"] = value
        elif group is None:
            self.silent[word] += 1
            groups["other"] = value
        elif groups.setdefault(group, value) != value and group != "end":
            self.refusals.add(number, word, f"{word} contradicts another word of its kind in the same line")

    def _names(self, block: Block, groups: dict, axes: dict) -> None:
        """What Sinumerik says in names: SUPA, T="MILL 10", axes of the machine."""
        if any(name == "SUPA" for name, _ in block.names):
            groups["home"] = 53
        if block.tool:
            self.next_tool = block.tool
            groups["T"] = 0
        if block.machine:
            groups["home"] = 28
            for word in ("G74", "G75"):
                groups.pop(word, None)
            axes.update(dict.fromkeys(block.machine, 0.0))

    def _rest(self, axes: dict, number: int) -> None:
        """Program numbers, rotary and further axes."""
        for letter in REST & axes.keys():
            value = axes.pop(letter)
            if letter == "E" and not axes.keys().isdisjoint("XYZ"):
                self.refusals.add(number, f"E{value:g}", advice=PRINTER)
            elif letter not in "OE" and value:
                self.refusals.add(number, f"{letter}{value:g}", advice=AXES5)
            elif letter not in "OE":
                self.silent[f"{letter}0"] += 1

    # --- what a block sets ---

    def _set(self, groups: dict, axes: dict, number: int) -> None:
        motion = self.motion
        if "units" in groups:
            self.unit = self.seen.unit = UNITS[groups["units"]]
        if "distance" in groups:
            motion.incremental = groups["distance"] == 91
        if "centre" in groups:
            motion.absolute_centre = groups["centre"] == 90.1
        if "plane" in groups:
            motion.plane = int(groups["plane"])
        if "feed" in groups:
            motion.feed.change(int(groups["feed"]))
        if "return" in groups:
            motion.to_initial = groups["return"] == 98
        if "tool" in groups if self.changes else "T" in groups:
            self._change_tool(number)
        if "dwell" in groups:
            self.silent["G4"] += 1
            _drop(axes, "P", "X", "U", "F", "S")
        for word in [word for word in groups if word[0] == "G"]:
            self._silent(word, groups[word], axes, number)
        if "offset" in groups:
            value = groups["offset"]
            self.seen.offset = OFFSETS.get(value) or f"G{value:g} P{axes.pop('P', 1):g}"
        if "home" in groups:
            self._home(groups, axes, number)
        if not groups.keys().isdisjoint(("preset", "shift", "data")):
            self._datum(groups, axes, number)
        if "refused" in groups:
            axes.clear()
        elif not groups.keys().isdisjoint(("other", "T", "tool", "end")):
            _drop(axes, *ARGUMENTS)  # P of M62, D of a tool
        if groups.get("spindle") == 19:
            self.silent["M19"] += 1

    def _silent(self, word: str, value: float, axes: dict, number: int) -> None:
        if (value == 5 and not axes.keys().isdisjoint("XYIJ")) or value in (74, 75):
            self.refusals.add(number, word, advice=CURVES if value == 5 else G_ADVICE.get(value, UNKNOWN), lost=True)
            axes.clear()
            return
        if value == 43 and "H" in axes:
            word += f" H{axes['H']:g}"
        self.silent[word] += 1
        _drop(axes, *ARGUMENTS)
        if axes.keys() <= {"R"}:  # of G5.1
            axes.clear()

    def _home(self, groups: dict, axes: dict, number: int) -> None:
        """G28, G30, G53: the named axes leave the workpiece; without a name, and not for G53, all of them."""
        value, mode = groups["home"], groups.pop("motion", None)
        named = [axis for axis in "XYZ" if axis in axes]
        if mode is not None and mode > 1:
            self.refusals.add(number, f"G{value:g}", f"G{value:g} stands with an arc in one line")
        elif mode is not None:
            self.motion.set_mode(mode)
        if not named and value in (28, 30):
            named = ["X", "Y", "Z"]
        self.silent[" ".join([f"G{value:g}", *named])] += 1
        self.motion.home(named, number)
        _drop(axes, *named, *ARGUMENTS)

    def _datum(self, groups: dict, axes: dict, number: int) -> None:
        """G10, G52, G92: harmless before the first move, for tool data, and as a shift by nothing."""
        lengths = {axis: axes[axis] for axis in "XYZ" if axis in axes}
        began = len(self.path) > 0
        if "preset" in groups and lengths and not began:
            self.motion.preset({axis: value * self.unit for axis, value in lengths.items()})
            self.silent["G92"] += 1
        elif "shift" in groups and not any(lengths.values()):
            self.silent["G52"] += 1
        elif "data" in groups and (not began or axes.get("L") in (1, 10, 11, 12, 13)):
            self.silent["G10"] += 1
        else:
            word = "G92" if "preset" in groups else "G52" if "shift" in groups else "G10"
            self.refusals.add(number, word, advice=DATUM, lost=True)
        axes.clear()

    # --- speeds and tools ---

    def _speeds(self, axes: dict, number: int) -> None:
        feed = axes.pop("F", None)
        if feed is not None:
            reason = self.motion.feed.give(feed, self.unit)
            if reason:
                self.refusals.add(number, f"F{feed:g}", reason)
        speed = axes.get("S")
        if speed is not None and not 0 <= speed <= 1e6:
            reason = f"the spindle speed S{speed:g} must lie between 0 and 1e6 rpm"
            self.refusals.add(number, f"S{speed:g}", reason)
            del axes["S"]

    def _turn(self, axes: dict) -> None:
        if "S" in axes:
            self.speed = axes.pop("S") * 2 * math.pi / 60
        self.path.spindle_speed = self.turning * self.speed

    def _change_tool(self, number: int) -> None:
        """M6, or a T in a program without M6, puts the tool of the last T into the spindle."""
        if not self.next_tool or self.next_tool == self.tool:
            return
        self.tool = self.refusals.tool = self.next_tool
        self.seen.tools.setdefault(self.tool, number)
        self.motion.change_tool(self.tool, self.seen.selected in ("", self.tool))


def _drop(axes: dict, *letters: str) -> None:
    for letter in letters:
        axes.pop(letter, None)
