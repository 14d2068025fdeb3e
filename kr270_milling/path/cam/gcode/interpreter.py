"""Blocks of G-code, already words, for the machine: what they set, move and end.

Each word of a block is taken out of it by what uses it. A word that is left is in the list of what may be read over,
and counted, or it is refused with its block: used + counted + refused = all (``ProgramBuilder.words``).

Work offsets, G92, G52, G10 L2 and rotation are relative to the frame of the path: a place is
offset + turn (preset + pattern), as in LinuxCNC; G68 turns the pattern about a point (Fanuc).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import Pose
from kr270_milling.path.cam.gcode.words import (
    ADVICE,
    AXES5,
    CLAIMS,
    DATUM,
    G_GROUPS,
    LEFT,
    M_GROUPS,
    MACROS,
    MODAL,
    OFFSETS,
    SILENT_G,
    SILENT_M,
    UNKNOWN,
    word_of,
)
from kr270_milling.path.cam.machine import AXES, CENTRES, MM, OF_ARCS, Machine
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.toolpath import TOP
from kr270_milling.path.trajectory import TOOL_DOWN

#: work offsets with a number, as G10 L2 P and the parameters 5221 ff. count them
NAMES = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")


class Offsets:
    """Work offsets [m, rad] and shifts [m]; where none is known the frame of the path is that of the first move."""

    def __init__(self, places: Sequence[float]):
        """places: x, y, z of G54, G55 ... in the workpiece frame; without any the path starts in its own frame."""
        self.given = bool(places)
        self.systems = {name: [*places[3 * n : 3 * n + 3], 0.0] for n, name in enumerate(NAMES[: len(places) // 3])}
        self.active = NAMES[0]
        self.preset = [0.0] * 3  #: G92 or G52
        self.stored = [0.0] * 3  #: that of G92 before G92.2
        self.local = False  #: the preset is one of G52
        self.applied = False  #: G92, G52 or G92.3 holds, also with a preset of zero
        self.turn = 1 + 0j  #: G68
        self.centre = 0j
        self.base: tuple[complex, complex, float] | None = (1 + 0j, 0j, 0.0) if places else None

    def known(self, name: str) -> bool:
        """Return whether the place of a work offset is known."""
        return name in self.systems and all(map(math.isfinite, self.systems[name]))

    @property
    def affine(self) -> tuple[complex, complex, float]:
        """Factor, xy and z of the map from coordinates of the program to those of the machine."""
        x, y, z, angle = self.systems[self.active] if self.known(self.active) else (0.0,) * 4
        turn = cmath.rect(1.0, angle) if angle else 1 + 0j
        pattern = self.centre - self.turn * self.centre
        return turn * self.turn, complex(x, y) + turn * (complex(*self.preset[:2]) + pattern), z + self.preset[2]

    @property
    def shift(self) -> tuple[complex, complex, float] | None:
        """Factor, xy [m] and z [m] of the map from coordinates of the program to the path; None where they agree."""
        if self.base is None:
            return None
        (turn, xy, z), (base_turn, base_xy, base_z) = self.affine, self.base
        shift = turn / base_turn, (xy - base_xy) / base_turn, z - base_z
        return None if shift == (1, 0, 0) else shift


FURTHER = frozenset("ABCUVW")
VECTOR = ("A3", "B3", "C3")
MOVES = frozenset(("motion", "cycle"))  #: groups that set nothing else
LETTERS = {"G92": "XYZ", "G52": "XYZ", "G68": "XYR", "G10": "LPQRXYZIJKHD", "G68.2": "XYZIJKP"}
SAVED = (*MODAL, "feed_mode", "feed", "feed_word", "no_feed", "turning", "speed")  #: modes of M70


class Interpreter(Machine):
    """Runs blocks of words; what cannot be run goes to the refusals, what moves nothing is counted."""

    watched = False  #: each move of a block is to be noted
    by_planes = True

    def __init__(self, program: ProgramBuilder, feed: float, changes: bool, offsets: Sequence[float] = ()):
        """offsets: x, y, z of G54, G55 ... in the workpiece frame [m], empty where the cell states none."""
        super().__init__(program, feed)
        self.changes = changes  #: M6 changes the tool, else its T does
        self.offsets = Offsets(offsets)
        self.shift = self.offsets.shift
        self.stated = False  #: the program states its unit
        self.fixed = True  #: the places of the cell hold, whatever G10 says
        self.next_tool = ""
        self.turning = 0
        self.vectors = False  #: I, J, K of a straight move are the tool axis
        self.speed = 0.0  #: [rad/s]
        self.preset = False  #: G92 gave the tool its place
        self.calls = False  #: sub-programs can be called
        self.call: tuple[str, float, float, dict[str, float]] | None = None  #: kind, name, repeats, values
        #: of the program and of each sub-program that runs: the modes that M70 or M73 saved
        self.modes: list[dict[str, Any] | None] = [None]
        self.radii: dict[float, float] = {0.0: 0.0}  #: number D -> radius [m] that the program states
        self.edge = math.nan  #: number of the last D
        self.end_word = 0.0  #: number of the M word that ended the program

    @property
    def cuts_alone(self) -> bool:
        """Return whether a block of coordinates is a straight cut or an arc of the mode at the feed, and no more."""
        return (
            self.mode in (1, 2, 3) and self.feed_mode == 94 and not self.incremental and self.cycle is None
            and self.shift is None and not self.skew and self.program.quaternion == TOOL_DOWN
            and not self.side and not self.polar and self.contour is None
            and bool(self.feed) and not self.watched
        )  # fmt: skip

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
        if "call" in groups or "L" in axes:
            self._call(groups, axes)
        self.pattern = []
        if not self.kinematics.letters and self.tilt is None and any(axes.get(letter) == 0.0 for letter in "ABC"):
            self.program.turn(TOOL_DOWN)
        unit = self.unit
        if not groups.keys() <= MOVES:
            self._set(groups, axes)
        if "F" in axes:
            self.set_feed(axes.pop("F"), unit)  # before G20 and G21: NIST RS274/NGC 3.8
        if "S" in axes or "spindle" in groups:
            self._turn(groups, axes)
        if "unit" in groups and self.unit != unit and self.feed_word is not None:
            feed, length = word_of("F", self.feed_word), "mm" if unit == MM else "inches"
            program.doubt("feed unit", f"{feed} in {length}, the unit before {word_of('G', groups['unit'])}")
            self.feed_word *= unit / self.unit
        self._take_vector(axes, groups)
        if self.kinematics.letters:
            self.take_angles(axes, home=groups.get("home") in (28, 30))
        if axes or groups or self.pattern:
            self.move(axes, groups.get("motion"), groups.get("cycle"))
            for letter, value in axes.items():
                self._left(letter, value)
        self.end_turn()
        if "end" in groups:
            self.ended, self.end_word = True, groups["end"]
        fate = "used" if program.refusals == refusals else "refused"
        program.words[fate] += len(words) - (program.words["counted"] - counted)

    def _take_vector(self, axes: dict, groups: dict) -> None:
        """A3, B3, C3 of Sinumerik, I, J, K of a straight move under G43.5: the tool axis from tip to holder."""
        straight = groups.get("motion", self.mode) in (0, 1) and self.cycle is None and "cycle" not in groups
        letters = CENTRES if self.vectors and straight and not axes.keys().isdisjoint(CENTRES) else VECTOR
        if axes.keys().isdisjoint(letters):
            return
        axis = [axes.pop(letter, 0.0) for letter in letters]
        if not self.follows_tip:
            self.program.refuse(letters[0], "a tool axis without TRAORI or G43.5", lost=True)
        self.take_axis(letters[0], axis)

    def _call(self, groups: dict, axes: dict) -> None:
        """M98 P L, M97 P L, G65 P L with the values of its letters, L P of Sinumerik: noted for the flow."""
        word = groups.get("call")
        if word is None:
            if self.calls and not groups and axes.keys() <= {"L", "P"}:
                self.call = "L", axes.pop("L"), axes.pop("P", 1.0), {}
            return
        name = word_of("G" if word == 65 else "M", word)
        if not self.calls or "P" not in axes:
            self.program.refuse(name, "" if "P" in axes else f"{name} without P, the sub-program", MACROS, lost=True)
            axes.clear()
            return
        if word != 65 and "H" in axes and not groups.keys() & {"G43", "tip"}:  # a line of the sub-program
            reason = f"{name} with H, a sub-program from one of its lines on"
            self.program.refuse(word_of("H", axes.pop("H")), reason, MACROS, lost=True)
        number, repeats = axes.pop("P"), axes.pop("L", 1.0)
        values = {}
        if word == 65:
            values = {letter: axes.pop(letter) for letter in list(axes) if letter not in "LNOP"}
        self.call = name, number, repeats, values

    def parameter(self, key: int | str) -> float | None:
        """Return the value of a parameter that is a state of the machine, None for another parameter."""
        if isinstance(key, str):
            return self._named(key)
        if 5420 <= key <= 5422:
            value = self.position[key - 5420] / self.unit
            return value if math.isfinite(value) and not self.side and not self.beside else None
        offsets = self.offsets
        index = key - 5221
        if key != 5220 and 5211 <= key < 5421 and self.unit != MM:
            self.program.doubt("parameter unit", f"#{key} counts in inches")
        if 5211 <= key <= 5213:
            return offsets.stored[key - 5211] / self.unit
        if key == 5220 and offsets.active in NAMES:
            return NAMES.index(offsets.active) + 1.0
        if 0 <= index < 20 * len(NAMES) and index % 20 < 3 and offsets.known(NAMES[index // 20]):
            return offsets.systems[NAMES[index // 20]][index % 20] / self.unit
        return None

    def _named(self, name: str) -> float | None:
        """Return the value of a named parameter of LinuxCNC that states a mode or a place."""
        metric = self.unit == MM
        if name in ("_X", "_Y", "_Z"):
            return self.parameter(5420 + "XYZ".index(name[1]))
        modes = {
            "_METRIC": metric,
            "_IMPERIAL": not metric,
            "_ABSOLUTE": not self.incremental,
            "_INCREMENTAL": self.incremental,
            "_PLANE": {17: 170, 18: 180, 19: 190}[self.plane],
            "_RPM": self.speed * 30 / math.pi,
            "_FEED": self.feed_word or 0.0,
            "_TASK": 0.0,
            "_VALUE": 0.0,
            "_VALUE_RETURNED": 0.0,
        }
        return float(modes[name]) if name in modes else None

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
            moves = letter == "M" or value not in (96, 22, 23)
            other = UNKNOWN if letter == "G" else "it is not known; leave it out where it moves no axis"
            advice = ADVICE.get(word, other)
            self.program.refuse(word, advice=advice, lost=moves)
            if moves:
                groups["refused"] = value

    def _left(self, letter: str, value: float) -> None:
        """Count or refuse a word that no other word of its line took."""
        if letter == "H":
            self._length(value)
            self.program.count(letter)
        elif letter == "D":
            self.program.set_frame("tool edges", word_of(letter, value))
            self.program.count(letter)
            self.edge = value
            self.radius = self.radii.get(value, math.nan)
        elif not value and (letter in FURTHER or letter in OF_ARCS):
            self.program.count(f"{letter}0")
        elif letter == "P" and self.cycle is not None and self.drilled:
            self.program.count("P")
        else:
            word = word_of(letter, value)
            reason = "" if letter in FURTHER else f"the word {word} belongs to no other word of its line"
            other = "write it in the line of the word that it belongs to, or leave it out"
            self.program.refuse(word, reason, LEFT.get(letter, other), derived=letter in OF_ARCS)

    def _read_over(self, word: str, axes: dict, letters: str) -> None:
        """Count a word together with the words that belong to it."""
        self.program.count(word, 1 + len([axes.pop(letter) for letter in letters if letter in axes]))

    # --- what a block sets ---

    def _set(self, groups: dict, axes: dict) -> None:
        data = {"preset": "G92", "shift": "G52", "data": "G10", "turn": "G68", "tilt": "G68.2"}  # groups of ``_datum``
        if "modes" in groups:
            self._save(groups["modes"])
        if "I" in axes and "L" in axes:
            self.pattern = self._pattern(groups, axes)
        self.stated |= "unit" in groups
        for group in MODAL.keys() & groups.keys():
            setattr(self, group, MODAL[group][groups[group]])
        if "feed" in groups:
            self.set_feed_mode(int(groups["feed"]))
        if "claim" in groups:
            self._claimed(groups, axes)
        if "compensation" in groups:
            self._compensate(groups["compensation"], axes)
        if "tool" in groups if self.changes else "T" in groups or "tool" in groups:
            if groups.get("tool") == 61 and "Q" in axes:  # the number of the tool that is in the spindle
                self.next_tool = word_of("T", axes.pop("Q"))
            elif groups.get("tool") == 61:
                self.program.refuse("M61", "M61 without Q, the number of the tool")
            self.change_tool(self.next_tool)
            if groups.get("tool") == 6:  # it stops the spindle: NIST RS274/NGC 3.6.3
                self.turning, self.program.spindle_speed = 0, 0.0
        if "polar" in groups:
            self.polar = True
        if "holes" in groups:
            self.program.refuse("G72", "G72 without I, L and a cycle is a word of lathes; post for a mill", lost=True)
            groups["refused"] = 72
        if "dwell" in groups:
            self._dwell(groups, axes)
        if "offset" in groups or "G15" in groups:
            self._offset(groups, axes)
        for word in [group for group in groups if group[0] in "GM"]:
            self._silent(word, groups, axes)
        if "home" in groups:
            self._home(groups, axes)
        for group, word in data.items():
            if group in groups:
                self._datum(word, groups, axes)
        if "tip" in groups:
            word = word_of("M" if groups["tip"] in (128, 129) else "G", groups["tip"])
            if "H" in axes:
                self._length(axes["H"])
            self._read_over(word, axes, "H")
            self.follow_tip(groups["tip"] != 129)
            self.vectors = groups["tip"] == 43.5
        if "orient" in groups:
            self._read_over(word_of("G", groups["orient"]), axes, "P")
            if self.tilt is None:
                self.program.refuse(word_of("G", groups["orient"]), "G53.1 without G68.2", AXES5, lost=True)
            self.turn_to_plane()
        if "refused" in groups:
            axes.clear()
        if groups.get("spindle") == 19:
            if "S" in axes:
                self.program.refuse("M19", "M19 with S is a speed or an angle", "write S in the line of M3 or M4")
            self._read_over("M19", axes, SILENT_M[19])

    def _pattern(self, groups: dict, axes: dict) -> list[complex]:
        """Return the holes of G70 (circle), G71 (arc) and G72 (row) of Haas, which drill the active cycle at L places.

        I: radius or distance, J: angle of the first hole or of the row, K: angle between holes. Without I and L, or
        without a cycle, G70 and G71 are other words.
        """
        word = groups.get("unit", groups.get("holes"))
        if word not in (70, 71, 72) or not (self.cycle or "cycle" in groups) or self.plane != 17 or self.incremental:
            return []
        groups.pop("unit", groups.pop("holes", None))
        groups.pop("claim", None)
        radius, count = axes.pop("I") * self.unit, axes.pop("L")
        first, step = axes.pop("J", 0.0), axes.pop("K", 0.0) if word == 71 else 360 / max(count, 1)
        if not 1 <= count <= 1000 or count != int(count):
            self.program.refuse(word_of("G", word), f"L{count:g} holes cannot be drilled", lost=True)
            return []
        if word == 72:
            return [k * cmath.rect(radius, math.radians(first)) for k in range(int(count))]
        return [cmath.rect(radius, math.radians(first + k * step)) for k in range(int(count))]

    def _save(self, word: float) -> None:
        """M70 saves the modes, M73 also for the end of the sub-program, M71 forgets them, M72 restores them."""
        if word == 72 and self.modes[-1] is None:
            self.program.refuse("M72", "M72 without M70", MACROS, lost=True)
        elif word == 72:
            self.restore(self.modes[-1] or {})
        else:
            saved = {name: getattr(self, name) for name in SAVED}
            at_end = word == 73 or bool(self.modes[-1] and self.modes[-1]["at_end"])
            saved |= {"offset": self.offsets.active, "applied": self.offsets.applied, "at_end": at_end}
            self.modes[-1] = None if word == 71 else saved

    def restore(self, modes: dict[str, Any]) -> None:
        """Restore the modes of M70, and whether G92 or G52 shifts; the motion of G0 to G3 stays (LinuxCNC)."""
        if self.side:
            self.ends_contour("M72 or the end of a sub-program with M73")
        for name in SAVED:
            setattr(self, name, modes[name])
        self.program.spindle_speed = self.turning * self.speed
        if modes["offset"] != self.offsets.active:
            self._use_offset(modes["offset"])
        if modes["applied"] != self.offsets.applied:
            self._restore(92.3 if modes["applied"] else 92.2)

    def _compensate(self, word: float, axes: dict) -> None:
        """G40, G41 D, G42 D: the radius that G10 gives to D, else that of the tool; G41.1 D: half of D."""
        self.side = {40: 0, 41: 1, 42: -1}[int(word)]
        number = axes.pop("D", self.edge)
        if word == int(word):
            self.edge = number if self.side else self.edge
            self.radius = self.radii.get(number, math.nan)
        else:
            self.radius = number * self.unit / 2
        if self.side and axes.pop("L", 0.0):
            self.program.refuse(word_of("G", word), "L states the edge of a tool of lathes")

    def _offset(self, groups: dict, axes: dict) -> None:
        """G54 to G59.3 and others; G54.1 P, G154 P, and G15 H of Okuma."""
        names = []
        if "G15" in groups and "H" in axes:
            names.append(f"G15 {word_of('H', axes.pop('H'))}")
        if "offset" in groups:
            value = groups["offset"]
            names.append(OFFSETS.get(value) or f"{word_of('G', value)} {word_of('P', axes.pop('P', 1))}")
        for name in names:
            self._use_offset(name)
        if len(names) > 1:
            self.program.refuse(names[1], f"{names[1]} contradicts {names[0]} in the same line")

    @property
    def _began(self) -> bool:
        """Return whether the tool was at a known place: what moves the coordinates now moves them against the path."""
        return len(self.program) > 0 or self.program.cuts > 0 or not any(map(math.isnan, self.position))

    def _use_offset(self, name: str) -> None:
        """Continue in another work offset; where its place or that of the last one is not known, the path has two."""
        offsets = self.offsets
        if offsets.given and not offsets.known(name):
            self.program.refuse(name, f"path.offsets_mm does not state {name}")
        elif offsets.given or (self._began and offsets.known(name) and offsets.known(offsets.active)):
            self._change(active=name)
        else:
            offsets.active = name
            self.program.set_frame("work offsets", name)

    def _change(self, **values) -> None:
        """Change what places the coordinates; the tool stays where it is."""
        offsets = self.offsets
        if self.tilt is not None:
            if any(getattr(offsets, name) != value for name, value in values.items()):
                reason = "other coordinates while a plane is tilted"
                self.program.refuse("G68.2", reason, "end the plane before them", lost=True)
            return
        if self._began and offsets.base is None:
            offsets.base = offsets.affine
        for name, value in values.items():
            setattr(offsets, name, value)
        self.set_shift(offsets.shift)

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

    def _silent(self, word: str, groups: dict, axes: dict) -> None:
        """A word that changes no path, except together with certain words: G5, G54.4, G74, G75, G92.1 to G92.3."""
        began, value = len(self.program) > 0, groups[word]
        letters = (SILENT_G if word[0] == "G" else SILENT_M)[value]
        if word in ("G92.1", "G92.2", "G92.3") and began and self.preset:
            self.program.refuse(word, advice=DATUM, lost=True)
        elif word in ("G5", "G5.1") and not axes.keys().isdisjoint("XYIJ"):
            groups["motion"] = value
        elif word in ("G74", "G75"):
            self.program.refuse(word, advice=ADVICE.get(word, UNKNOWN), lost=True)
            axes.clear()
        elif word == "G43.1" and ("Z" not in axes or "motion" in groups or not axes.keys().isdisjoint("XYH")):
            self.program.refuse(word, "G43.1 takes Z alone, the length of the tool", AXES5, lost=True)
            axes.clear()
        elif word == "G54.4" and axes.get("P"):
            self.program.refuse(word, advice=DATUM, lost=True)
        else:
            if word in ("G92.1", "G92.2", "G92.3"):
                self._restore(value)
            elif word == "G15":
                self.polar = False
            elif word == "G64":
                self.program.rounding = max(self.program.rounding, axes.get("P", 0.0) * self.unit)
            elif word == "G69":
                self.set_tilt(None)
                self._change(turn=1 + 0j, centre=0j)
            number = f" {word_of('H', axes['H'])}" if word == "G43" and "H" in axes else ""
            if word in ("G43", "G43.1", "G49"):
                self.follow_tip(False)
                self._length(0.0 if word == "G49" else axes.get("H"), "home" in groups)
            if word == "G43.1":  # the height of the tip follows from a length that is not known
                self.position[2] = math.nan
            self._read_over(word + number, axes, letters)

    def _length(self, number: float | None, homes: bool = False) -> None:
        """G43, G43.4 and H: the length of a number, None: that of the tool, or of 0: none, which G49 ends."""
        program, tool = self.program, self.program.tool
        own = f"H{tool[1:]}"
        word = own if number is None else word_of("H", number)
        if number == 0.0:
            away = homes or program.away or self.position[2] == TOP
            if not away and program.frame["tool lengths"] not in ("", "H0"):
                program.doubt("length end", f"the length of {tool or 'the tool'} ends before a retract")
        else:
            program.length_offsets.add(tool)
            if tool[1:].isdigit() and word != own:
                program.doubt("length number", f"{word} is not the number of {tool}")
        program.set_frame("tool lengths", word)

    def _home(self, groups: dict, axes: dict) -> None:
        """G28, G30, G53: the named axes leave the workpiece; without a name, and not for G53, all of them.

        G28 and G30 lead the named axes through their stated place: NIST RS274/NGC 3.5.8.
        """
        word, mode = word_of("G", groups["home"]), groups.get("motion")
        if mode in (0, 1):
            self.set_mode(mode)  # which ends a cycle
        if word == "G53" and (self.mode if mode is None else mode) in (0, 1) and self._in_machine(axes):
            return
        axes_home = [axis for axis in AXES if axis in axes]
        feeds = word == "G53" and (self.mode if mode is None else mode) == 1
        groups.pop("motion", None)
        if mode is not None and mode > 1:
            self.program.refuse(word, f"{word} occurs with an arc in one line")
        between = {
            axis: axes[axis]
            for axis in axes_home
            if self.absolute.get(axis, not self.incremental) or (axes[axis] and abs(self.position[AXES[axis]]) < TOP)
        }
        if between and word != "G53":
            mode, self.mode = self.mode, 0
            self._move(between)
            self.mode = mode
        every = word in ("G28", "G30") and not axes_home and axes.keys().isdisjoint(FURTHER)
        text = " ".join([word, *(AXES if every else axes_home)])
        self._read_over(text, axes, "XYZP" if word == "G30" else "XYZ")
        self.home(text.split()[1:], feeds)

    def _in_machine(self, axes: dict) -> bool:
        """Make places of the machine (G53) places of the program, where G10 stated that of the work offset."""
        offsets = self.offsets
        stated = offsets.known(offsets.active) and not (offsets.given and self.fixed)
        placed = self.skew or self.incremental or self.polar or self.side or self.cycle is not None
        if not stated or placed or self.program.frame["tool lengths"] not in ("", "H0"):
            return False
        turn, xy, z = offsets.affine
        here = complex(*self.position[:2]) * turn + xy
        if not axes.keys().isdisjoint("XY"):
            x, y = axes.get("X", here.real / self.unit), axes.get("Y", here.imag / self.unit)
            place = (complex(x, y) * self.unit - xy) / turn / self.unit
            axes["X"], axes["Y"] = place.real, place.imag
        if "Z" in axes:
            axes["Z"] -= z / self.unit
        return True

    def _restore(self, value: float) -> None:
        """G92.1 and G92.2 end the shift of G92, which G92.3 restores after G92.2."""
        stored = [0.0] * 3 if value == 92.1 else self.offsets.stored
        local = self.offsets.local and value != 92.1
        preset, applied = (stored, True) if value == 92.3 else ([0.0] * 3, False)
        self._change(preset=preset, stored=stored, local=local, applied=applied)

    def _datum(self, word: str, groups: dict, axes: dict) -> None:
        """G10, G52, G68, G92: before the first move they place the frame of the path; G92 S is a limit."""
        lengths = {axis: axes[axis] for axis in AXES if axis in axes}
        if not groups.keys().isdisjoint(MOVES):
            reason = f"{word} is in the line of a move"
        elif word == "G92" and "S" in axes and not lengths:
            self._read_over(word, axes, "S")
            return
        elif word == "G10":
            reason = self._data(lengths, axes)
        else:
            makers = {"G92": self._preset, "G52": self._local, "G68": self._turned, "G68.2": self._tilted}
            reason = makers[word](lengths, axes)
        if reason:
            self.program.refuse(word, reason, DATUM, lost=True)
            axes.clear()
            return
        self._read_over(word, axes, LETTERS[word])

    def _preset(self, lengths: dict, _) -> str:
        """G92: the tool is at these coordinates."""
        if not lengths:
            return "G92 without X, Y or Z"
        if not self._began:
            self.preset = True
            for axis, value in lengths.items():
                self.position[AXES[axis]] = value * self.unit
            return ""
        if self.offsets.turn != 1 or self.offsets.local:
            return "controls differ in G92 after G52 or G68"
        preset = [*self.offsets.preset]
        for axis, value in lengths.items():
            preset[AXES[axis]] += self.position[AXES[axis]] - value * self.unit
        if not all(map(math.isfinite, preset)):
            return "G92 where the place of the tool is not known"
        self._change(preset=preset, stored=preset, applied=True)
        return ""

    def _local(self, lengths: dict, _) -> str:
        """G52: a shift of all work offsets."""
        if self.preset or (any(self.offsets.preset) and not self.offsets.local) or self.offsets.turn != 1:
            return "controls differ in G52 after G92 or G68"
        preset = [lengths[axis] * self.unit if axis in lengths else self.offsets.preset[n] for axis, n in AXES.items()]
        if not self._began and any(preset) and not self.offsets.given:
            self.offsets.base = self.offsets.affine  # a shift of the zero that the post knows
        self._change(preset=preset, stored=preset, local=any(preset), applied=True)
        return ""

    def _turned(self, lengths: dict, axes: dict) -> str:
        """G68: the coordinates turn about X, Y, without them about the place of the tool."""
        if self.plane != 17 or "Z" in lengths or "R" not in axes:
            return "G68 takes X, Y and R in G17"
        if self.incremental or self.offsets.turn != 1:
            return "controls differ in G68 with G91 and in a second G68"
        x, y = (lengths[axis] * self.unit if axis in lengths else self.position[AXES[axis]] for axis in "XY")
        if not math.isfinite(x) or not math.isfinite(y):
            return "G68 without X and Y where the place of the tool is not known"
        if not self._began and not self.offsets.given:
            self.offsets.base = self.offsets.affine
        self._change(turn=cmath.rect(1.0, math.radians(axes["R"])), centre=complex(x, y))
        return ""

    def _tilted(self, lengths: dict, axes: dict) -> str:
        """G68.2: origin X, Y, Z; I, J, K turn about z, the new x and the new z (Fanuc B-63942EN, 5.44)."""
        if axes.get("P") or "R" in axes or "Q" in axes:
            return "G68.2 takes an origin X, Y, Z and Euler angles I, J, K"
        if self.tilt is not None or self.offsets.turn != 1:
            return "G68.2 after another G68.2 or G68 without G69"
        origin = [lengths.get(axis, 0.0) * self.unit for axis in AXES]
        turn = Rotation.from_euler("ZXZ", [axes.get(letter, 0.0) for letter in "IJK"], degrees=True)
        self.set_tilt(Pose(np.array(origin), turn.as_matrix()))
        return ""

    def swivel(self, arguments: list[str]) -> str:
        """CYCLE800(FR, TC, ST, MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, DIR ...); return why it cannot be run.

        The axes of the rotations are the pairs of bits of MODE, the first in the lowest: 1 x, 2 y, 3 z; each one about
        the axes that the one before has turned. X1, Y1, Z1 are in these axes (Siemens, 840D sl Programming Manual
        Cycles, "Swivel plane"). Without arguments, or with the data record "0", the plane ends.
        """
        data = arguments[1].strip('"') if len(arguments) > 1 else ""
        try:
            values = [float(text or 0.0) for text in [*arguments[:1], *arguments[2:]] + ["0"] * 13]
        except ValueError:
            return "CYCLE800 takes numbers"
        retract, state, mode, *rest = values
        places, direction = np.array(rest[:9]).reshape(3, 3), rest[9] if len(arguments) > 13 and arguments[13] else 1.0
        order = [int(mode) >> shift & 3 for shift in (0, 2, 4)]
        if self.shift is not None and self.shift[0] != 1:
            return "CYCLE800 in coordinates that are turned"
        if not np.isfinite(values).all() or mode != int(mode):
            return "CYCLE800 takes numbers"
        if places[1].any() and (not 0 <= mode < 64 or sorted(order) != [1, 2, 3]):
            return f"CYCLE800 with MODE {mode:g}; axis by axis is read, such as 57 for X, Y, Z"
        if retract:
            self.home(["Z"])
        if data == "0" or not any(arguments):
            self.set_tilt(None)
            return ""
        turn = np.eye(3)
        if places[1].any():
            turn = Rotation.from_euler("".join("XYZ"[k - 1] for k in order), places[1], degrees=True).as_matrix()
        plane = Pose(self.unit * (places[0] + turn @ places[2]), turn)
        if state % 10 == 1 and self.tilt is not None:
            plane = self.tilt @ plane
        upright = not plane.position.any() and np.array_equal(plane.rotation, np.eye(3))
        self.set_tilt(None if upright else plane)
        if direction:
            self.turn_to_plane()
        return ""

    def _system_at(self, lengths: dict, system: list[float]) -> list[float]:
        """Return the work offset in which the tool has these coordinates; other axes keep theirs."""
        offsets = self.offsets
        turn, xy, z = offsets.affine
        place = complex(*self.position[:2]) * turn + xy
        wanted = [lengths.get(axis, self.position[n] / self.unit) * self.unit for axis, n in AXES.items()]
        origin = place - cmath.rect(1.0, system[3]) * complex(
            wanted[0] + offsets.preset[0], wanted[1] + offsets.preset[1]
        )
        height = self.position[2] + z - wanted[2] - offsets.preset[2]
        turned = [origin.real, origin.imag, height]
        if not system[3]:  # the axes do not mix
            turned = [turned[n] if axis in lengths else system[n] for axis, n in AXES.items()]
        return [*turned, system[3]]

    def _data(self, lengths: dict, axes: dict) -> str:
        """G10: the place of a work offset by L2 and, by the coordinates that the tool is to have there, L20."""
        kind, number = axes.get("L"), axes.get("P", 0.0)
        if kind in (1, 12) and "R" in axes:
            self.radii[number] = axes["R"] * self.unit
        if kind in (11, 13) and axes.get("R"):
            return "G10 states the wear of a tool, by which the path moves"
        in_use = word_of("T", number) in self.program.length_offsets
        if kind in (1, 10, 11) and self._began and in_use and not axes.keys().isdisjoint("ZR" if kind > 1 else "Z"):
            return f"G10 changes the length of {word_of('T', number)}, which is in use"
        if kind not in (2, 20):
            return "" if kind in (1, 10, 11, 12, 13) or not self._began else "G10 of this kind"
        offsets = self.offsets
        if number not in range(len(NAMES) + 1) or (not number and offsets.active not in NAMES):
            return "" if not self._began else f"G10 L{kind:g} P{number:g} names no work offset G54 to G59.3"
        name = NAMES[int(number) - 1] if number else offsets.active
        if self.incremental or (offsets.given and self.fixed):
            return "the cell states the work offsets" if offsets.given else "controls differ in G10 with G91"
        if "R" in axes and any(offsets.preset):
            return "G10 with R while G92 or G52 is active"  # LinuxCNC 2.9 gives the tool another place
        known = offsets.known(offsets.active)
        if self._began and (name == offsets.active or kind == 20) and not known:
            return f"G10 changes {name}, whose place is not known"
        system = [*offsets.systems.get(name, [math.nan] * 3 + [0.0])]
        if kind == 20 and not self._began:
            system = [math.nan] * 3 + [0.0]
        elif kind == 20:
            system = self._system_at(lengths, system)
            if offsets.turn != 1 or (system[3] and name != offsets.active):
                return "G10 L20 while the coordinates are turned"
        else:
            for axis, value in lengths.items():
                system[AXES[axis]] = value * self.unit
            system[3] = math.radians(axes["R"]) if "R" in axes else system[3]
        if self._began:
            self._change(systems=offsets.systems | {name: system})
        else:
            offsets.systems[name] = system
        return ""

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
