"""Heidenhain conversational programs in: straight moves, circles, corners, drilling cycles, labels and Q parameters.

One statement is one block of the machine. Words that move nothing are counted; those that cannot be run are listed all
at once. Sources: Heidenhain, TNC 320 and iTNC 530 user's manuals for conversational programming.
"""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.files import read_lines, short
from kr270_milling.base.frames import Pose
from kr270_milling.path.cam.comments import operation_name
from kr270_milling.path.cam.gcode import flow
from kr270_milling.path.cam.gcode.expressions import NUMBER, ExpressionError, Scanner, Variables
from kr270_milling.path.cam.gcode.words import SILENT_M, word_of
from kr270_milling.path.cam.machine import INCH, MM, Machine
from kr270_milling.path.cam.program_builder import Cycle, ProgramBuilder
from kr270_milling.path.kinematics import NO_ROTARY_AXES, Kinematics
from kr270_milling.path.source_program import ProgramTool
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN

#: words of a block; a sign alone is the direction of a circle
WORD = re.compile(
    r"(FMAX|FAUTO|R0(?![0-9.])|RL|RR|DR|DL|IPA|IPR|PA|PR|MB|LA|I?[XYZABC]|[RFMST]) ?"
    rf"([-+]?(?:{NUMBER.pattern}|Q[0-9]+|MAX)|[-+])?"
)
LABEL = re.compile(r"(CALL )?LBL ?([0-9]+|\".*?\")(?: ?REP ?([0-9]+)(?:/[0-9]+)?)?")
SILENT = re.compile(
    r"BLK FORM|TOOL DEF|STOP\Z|FUNCTION RESET (?!TCPM)|CYCL DEF (?:247|32\.|9\.)|FN ?(?:14|16|38):|M ?0*[01]\Z"
)
BLANK = re.compile(r"BLK FORM 0\.([12])(?: Z(?= ))? ([^Z].*)")  #: a corner of a box
#: turns, mirrors, scales that change nothing with zeros alone
RESETS = re.compile(r"CYCL DEF (?:8|10|11|19)\.[0-9]+")
CHANGING = re.compile(r"[1-9Q]|^ ?[XYZ](?![A-Z])")  #: a value, or an axis that is mirrored
SHIFT = re.compile(r"(?:CYCL DEF 7\.[0-9]+|TRANS DATUM)(?: DATUM SHIFT| AXIS| RESET)?")
HOLES = re.compile(r"CYCL DEF (200|201|203|205|240) ")
COMMA = re.compile(r"(?<=[0-9]),(?=[0-9])(?=[^\"]*(?:\"[^\"]*\"[^\"]*)*\Z)")  #: of a number, not of a name
#: PLANE -> its angles and the axes of the rotations: of the fixed axes in small letters
PLANES = {"SPATIAL": (("SPA", "SPB", "SPC"), "xyz"), "EULER": (("EULPR", "EULNU", "EULROT"), "ZXZ")}
ADVICE = {
    **dict.fromkeys(("APPR", "DEP"), "let the CAM output lead-ins and lead-outs as L and C"),
    **dict.fromkeys(("CALL PGM", "SEL"), "post one program without calls of other files"),
    "CYCL DEF": "CYCL DEF 200, 201, 203, 205 and 240 are read; let the CAM output other cycles as moves",
    "PLANE": "let the CAM output PLANE SPATIAL or PLANE EULER",
    "TCH PROBE": "leave probing out of this program",
}
SPINDLE = {3: 1, 13: 1, 4: -1, 14: -1, 5: 0}
#: M words that move nothing: those of G-code but for cycles, datums, feeds on arcs and rotary axes; another tool in its
#: place, rotary axes on the short way, errors of tools, look-ahead, ends of such modes
M_WORDS = {*SILENT_M} - {89, 104, 109, 110, 114, 116} | {6, 101, 102, 107, 108, 120, 126, 127, 129, 137, 141, 145, 149}


def read_heidenhain(path, tool: str = "", feed: float = 0.0, machine: Kinematics = NO_ROTARY_AXES) -> Toolpath:
    """Read a conversational program; options as of ``read_gcode``."""
    program = ProgramBuilder(path, f"T{int(tool)}" if tool.isdigit() else tool)
    reader = _Conversational(program, feed)
    reader.kinematics = machine
    reader.run_lines(read_lines(path))
    return program.finish(reader.unit)


class _Refused(ValueError):
    """A statement that cannot be run."""


class _Conversational(Machine):
    """Runs statements: L, C, CR, CT, LP and CP are blocks of G0 to G3."""

    by_planes = True

    def __init__(self, program: ProgramBuilder, feed: float):
        super().__init__(program, feed)
        self.absolute_centre = True
        self.called_feed = self.feed  #: of TOOL CALL, which FAUTO takes [m/s]
        self.speed = 0.0  #: [rad/s]
        self.turning = 0
        self.datum = [0.0] * 3  #: shift of the datum [m]
        self.low = [math.nan] * 3  #: lower corner of the blank [m]
        self.pole: complex | None = None  #: CC [m]
        self.heading: complex | None = None  #: direction of the last move in the xy plane
        self.arc_centre: complex | None = None  #: [m], of the block; None: given by its radius
        self.hole: tuple[Cycle, float] | None = None  #: of CYCL DEF, with its feed
        self.variables = Variables(lambda key: None)
        self.labels: dict[str, int] = {}
        self.calls: list[int] = []  #: indices of the statements after the calls that run
        self.counters: dict[int, int] = {}  #: call with REP -> times that are left
        self.moving: dict[str, Callable] = {
            "L": self._straight, "LP": self._straight, "C": self._round, "CP": self._round, "CR": self._round,
            "CT": self._tangent,
        }  # fmt: skip

    # --- lines to statements ---

    def run_lines(self, lines: list[str]) -> None:
        """Run a program up to its end; one that looks ahead runs twice."""
        if self.contour is None and re.search(r"\bR[LR]\b|\bRND\b|\bCHF\b", "\n".join(lines), re.I):
            self.look_ahead(lambda machine: machine.run_lines(lines))
            self.program.beside.clear()  # RL and RR always count from the radius of the tool
        statements = _statements(lines)
        for index, (_, text, _) in enumerate(statements):
            if (match := LABEL.fullmatch(text)) and not match[1] and match[2] != "0":
                self.labels.setdefault(match[2], index)
        program, index, executed = self.program, 0, 0
        while index < len(statements) and not self.ended and not program.hopeless:
            program.line, text, comment = statements[index]
            executed += 1
            refusals, counted, index = program.refusals, program.words["counted"], index + 1
            try:
                if executed > flow.MOST_BLOCKS:
                    self.ended = True
                    raise _Refused(f"the program runs more than {flow.MOST_BLOCKS} statements; does a jump end?")
                index = self._statement(text, comment, index)
            except (_Refused, ExpressionError) as fault:
                program.refuse(short(text), str(fault).replace("#", "Q"), lost=True)
            if text and program.words["counted"] == counted:
                program.words["used" if program.refusals == refusals else "refused"] += 1
        if not self.ended:
            program.line = len(lines)
            program.refuse("", "the program has no END PGM, M2 or M30; the file may be cut off")

    def _statement(self, text: str, comment: str, index: int) -> int:
        """Run a statement and return the index of the next one."""
        word = text.partition(" ")[0]
        if comment:
            self._comment(comment, text)
        if not text:
            return index
        if match := re.fullmatch(r"BEGIN PGM (.*?) ?(MM|INCH)", text):
            self.unit = INCH if match[2] == "INCH" else MM
            self.program.title = self.program.title or match[1]
        elif text.startswith("END PGM"):
            self.ended = True
        elif match := LABEL.fullmatch(text):
            return self._label(match, index)
        elif match := re.fullmatch(r"FN ?(?:9|10|11|12): ?IF (.*?) ?(EQU|NE|GT|LT) (.*?) ?GOTO LBL ?(.*)", text):
            left, right = self._value(match[1]), self._value(match[3])
            holds = {"EQU": left == right, "NE": left != right, "GT": left > right, "LT": left < right}[match[2]]
            return self._place_of(match[4]) if holds else index
        elif match := re.fullmatch(r"(?:FN ?[0-5]: ?)?Q([0-9]+) ?= ?(.*)", text):
            self.variables.set(int(match[1]), self._value(match[2]))
        elif word in self.moving:
            self._block(word, text[len(word) :])
        elif text.startswith("TOOL CALL"):
            self._tool(text[9:])
        elif word == "CC":
            self._centre_word(text[2:])
        elif word in ("RND", "CHF"):
            self._corner(word, text[3:])
        elif match := HOLES.match(text):
            self._define(match[1], text)
        elif text.startswith("CYCL CALL"):
            self._call_cycle(text[9:])
        elif match := re.match(r"FUNCTION (RESET )?TCPM\b(?!.*AXIS SPAT)", text):
            self.program.count("FUNCTION TCPM")
            self.follow_tip(match[1] is None)
        elif SHIFT.match(text):
            self._shift(text)
        elif word == "PLANE" and text.split()[1:2] and text.split()[1] in {*PLANES, "RESET"}:
            self._plane(text)
        elif SILENT.match(text) or (RESETS.match(text) and not CHANGING.search(RESETS.sub("", text, count=1))):
            self._note(text)
        elif text.startswith(("M", "STOP M")):
            self._block("L", " " + text.removeprefix("STOP "))
        else:
            known = next((name for name in ADVICE if text.startswith(name)), "")
            reason = "" if known else f"{short(text)!r} is not read"
            self.program.refuse(
                short(text), reason, ADVICE.get(known, "let the CAM output L, C, CR, CT, LP and CP"), lost=True
            )
        return index

    def _shift(self, text: str) -> None:
        """A shift of the datum: of the axes that it names, from the datum of the workpiece; without any to zero."""
        words, functions = self._words(SHIFT.sub("", text))
        if words.keys() - {"X", "Y", "Z", "IX", "IY", "IZ"} or functions or self.tilt is not None:
            raise _Refused("a shift of the datum takes X, Y and Z, before PLANE")
        place = [*self.datum] if words else [0.0] * 3
        for k, axis in enumerate("XYZ"):
            if axis in words:
                place[k] = words[axis] * self.unit
            place[k] += words.get(f"I{axis}", 0.0) * self.unit
        if not text.startswith("CYCL DEF 7.0"):  # the head of the cycle
            self.datum = place
            self.set_shift((1 + 0j, complex(*place[:2]), place[2]) if any(place) else None)

    def _plane(self, text: str) -> None:
        """PLANE SPATIAL turns about the fixed x, y, z, PLANE EULER about z, the new x and the new z; RESET ends both.

        The axes turn with MOVE and TURN; with STAY in a block that names A, B or C. (Heidenhain, TNC 620 User's Manual
        Conversational Programming, 10/2017, "Tilting the working plane")
        """
        kind = text.split()[1]
        names, axes = PLANES.get(kind, ((), ""))
        angles = {name: self._value(value) for name, value in re.findall(r"(SP[ABC]|EUL[A-Z]+) ?([-+]?[0-9.Q]+)", text)}
        if angles.keys() != set(names):
            raise _Refused(f"PLANE {kind} needs {', '.join(names)}")
        if self.shift is not None and self.shift[0] != 1:
            raise _Refused("PLANE in coordinates that are turned")
        plane = None
        if any(angles.values()):
            turn = Rotation.from_euler(axes, [angles[name] for name in names], degrees=True)
            plane = Pose(np.zeros(3), turn.as_matrix())
        self.set_tilt(plane)
        self.pole = self.heading = None
        for number in (120, 121, 122):  # the angles of the machine's axes, which name the plane and no number here
            self.variables.set(number, 0.0)
        if re.search(r" (?:MOVE|TURN)\b", text):
            self.turn_to_plane()

    def _note(self, text: str) -> None:
        """A statement that moves nothing; TOOL DEF states the radius of its tool, BLK FORM the blank."""
        if match := BLANK.match(text):
            self._blank(match[1] == "2", self._words(match[2])[0])
            return
        match = re.match(r"TOOL DEF ?([0-9]+|\".*\").*? R ?([-+]?[0-9.]+)", text)
        if match and 0 < float(match[2]) * self.unit <= 0.1:
            name = _tool_name(match[1])
            self.program.known[name] = ProgramTool(name, diameter=2 * float(match[2]) * self.unit)
        self.program.count(" ".join(text.split()[:2]))

    def _blank(self, upper: bool, words: dict[str, float]) -> None:
        """A corner of the blank; IX, IY, IZ of the upper one count from the lower one."""
        corner = [words.get(axis, math.nan) * self.unit for axis in "XYZ"]
        if not upper:
            self.low = corner
            return
        for k, axis in enumerate("XYZ"):
            if f"I{axis}" in words:
                corner[k] = self.low[k] + words[f"I{axis}"] * self.unit
        self.program.state_stock([*self.low, *corner])

    def _comment(self, comment: str, text: str) -> None:
        if len(self.program.comments) < 2000:
            match = re.match(r"TOOL CALL ?([0-9]+|\".*?\")", text)
            tool = _tool_name(match[1]) if match else self.program.tool
            self.program.comments.append((comment, tool, match is not None))
        name, announced = operation_name(comment)
        if not text and name and (announced or not self.program.inside_operation):
            self.program.name_operation(name, title=False)

    # --- values ---

    def _value(self, text: str) -> float:
        code = re.sub(r"Q(?=[0-9])", "#", text.replace("DIV", "/").replace("^", "**")).replace(" ", "")
        scanner = Scanner(code, self.variables)
        value = scanner.expression()
        if not scanner.ended:
            raise _Refused(f"{short(code[scanner.place :])!r} follows a value")
        return value

    def _words(self, text: str) -> tuple[dict[str, float], list[float]]:
        """Return the words of a block, and its M words."""
        words: dict[str, float] = {}
        functions: list[float] = []
        place, text = 0, text.strip().replace("F MAX", "FMAX").replace("F AUTO", "FAUTO")
        while place < len(text):
            match = WORD.match(text, place)
            if match is None:
                raise _Refused(f"{short(text[place:])!r} is no word")
            name, value = match.groups()
            place = match.end() + (text[match.end() : match.end() + 1] == " ")
            if value is None and name not in ("FMAX", "FAUTO", "R0", "RL", "RR"):
                raise _Refused(f"{name} has no value")
            if value in ("+", "-"):
                number = 1.0 if value == "+" else -1.0
            else:
                number = math.inf if value == "MAX" else self._value(value) if value else 0.0
            if name == "M":
                functions.append(number)
            elif name in words:
                raise _Refused(f"{name} occurs twice in its statement")
            else:
                words[name] = number
        return words, functions

    # --- moves ---

    def _block(self, kind: str, text: str) -> None:
        words, functions = self._words(text)
        for word, side in (("R0", 0), ("RL", 1), ("RR", -1)):
            if word in words:
                words.pop(word)
                self.side, self.radius = side, math.nan
        rapid = words.pop("FMAX", None) is not None
        if words.pop("FAUTO", None) is not None:
            self.feed = self.called_feed
        if "F" in words:
            self._feed(words.pop("F"))
        for number in functions:
            if number in (3, 4, 13, 14):
                self._turn(SPINDLE[int(number)])
        if other := [number for number in functions if number not in {*M_WORDS, *SPINDLE, 2, 30, 91, 92, 99, 128, 140}]:
            self.program.refuse(word_of("M", other[0]), advice="leave it out where it moves no axis", lost=True)
            return
        if 128 in functions or 129 in functions:
            self.follow_tip(128 in functions)
        if not self.kinematics.letters and words.keys() & {"A", "B", "C"}:
            computed = re.search(r"[ABC] ?\+?Q12[012]", text)
            self.program.turn(self.along_plane if computed else TOOL_DOWN)
        elif self.kinematics.letters and re.search(r"[ABC] ?\+?Q12[012]", text):
            self.turn_to_plane()
            words = {name: value for name, value in words.items() if name not in "ABC"}
        if 140 in functions:  # back along the tool axis, by MB or as far as it goes
            back = words.pop("MB", math.inf)
            if math.isinf(back):
                self.home(["Z"])
            elif words or self.program.quaternion != self.along_plane:
                raise _Refused("M140 MB in a separate block, with the tool along z")
            else:
                words["IZ"], rapid = back, not re.search(r"F ?[-+0-9Q.]", text)
        if "LA" in words and 120 in functions:
            words.pop("LA")
        for number in functions:
            if number in M_WORDS:
                self.program.silent[word_of("M", number)] += 1
        if 91 in functions or 92 in functions:
            self.home([axis for axis in "XYZ" if words.pop(axis, None) is not None], not rapid)
            self._swing(words, rapid)
        elif words.keys() <= {"A", "B", "C", "IA", "IB", "IC"}:
            self._swing(words, rapid)
        else:
            self._go(kind, words, rapid)
        for axis in "ABC":
            if words.get(axis, 1.0) == 0.0:
                words.pop(axis)
        if words:
            raise _Refused(f"{kind} does not take {next(iter(words))}")
        if 99 in functions:
            self._drill_here()
        if 5 in functions:  # at the end of its block
            self._turn(0)
        if 2 in functions or 30 in functions:
            self.ended = True

    def _turn(self, turning: int) -> None:
        self.turning = turning
        self.program.spindle_speed = turning * self.speed

    def _swing(self, words: dict[str, float], rapid: bool) -> None:
        """A block of rotary axes alone."""
        self.set_mode(0 if rapid else 1)
        self._take(words)
        self.end_turn()
        self.absolute = {}

    def _take(self, words: dict[str, float]) -> None:
        """Take the words of the rotary axes, absolute or not."""
        self.absolute |= {axis: f"I{axis}" not in words for axis in "ABC"}
        angles = {
            axis: words.pop(name) for axis in self.kinematics.letters for name in (axis, f"I{axis}") if name in words
        }
        self.take_angles(angles)

    def _go(self, kind: str, words: dict[str, float], rapid: bool) -> None:
        start = complex(*self.position[:2])
        axes: dict[str, float] = {}
        self.absolute = {"I": True, "J": True}
        for axis in "XYZ":
            for name in (f"I{axis}", axis):
                if name in words:
                    axes[axis] = words.pop(name)
                    self.absolute[axis] = name == axis
        if kind in ("LP", "CP"):
            self._polar_end(words, axes, start)
        self._take(words)
        mode = self.moving[kind](kind, words, axes, start)
        if rapid and mode != 1:
            raise _Refused(f"{kind} with FMAX is a rapid move on an arc")
        self.heading = None if mode in (2, 3) else self.heading
        self.move(axes, 0 if rapid and mode == 1 else mode)
        self.absolute = {}
        self.end_turn()
        self._turn_heading(mode, start)

    def _turn_heading(self, mode: int, start: complex) -> None:
        """Note the direction of the tool at the end of a move."""
        way = complex(*self.position[:2]) - start
        if mode == 1 and abs(way) > 0:
            self.heading = way / abs(way)
        elif mode in (2, 3) and self.arc_centre is not None:
            out = complex(*self.position[:2]) - self.arc_centre
            self.heading = (1j if mode == 3 else -1j) * out / abs(out) if abs(out) > 0 else None

    def _straight(self, kind: str, words: dict, axes: dict, start: complex) -> int:
        return 1

    def _polar_end(self, words: dict, axes: dict, start: complex) -> None:
        """PR and PA about the pole CC; IPA turns on from the place of the tool."""
        if self.pole is None or not cmath.isfinite(start):
            raise _Refused("a move about a pole needs CC and a known place")
        radius, angle = cmath.polar(start - self.pole)
        if "PR" in words:
            radius = words.pop("PR") * self.unit
        if "IPR" in words:
            radius += words.pop("IPR") * self.unit
        if "PA" in words:
            angle = math.radians(words.pop("PA"))
        if "IPA" in words:
            turn = words.pop("IPA")
            angle += math.radians(turn)
            sense = words.get("DR", 0.0)
            if sense and (turn * sense < 0 or not turn):
                raise _Refused("IPA turns against DR")
            if sense and abs(turn) > 360:
                axes["TURN"] = math.ceil(abs(turn) / 360 - 1e-9) - 1.0
        end = (self.pole + cmath.rect(radius, angle)) / self.unit
        axes["X"], axes["Y"] = end.real, end.imag
        self.absolute |= {"X": True, "Y": True}

    def _round(self, kind: str, words: dict, axes: dict, start: complex) -> int:
        """C and CP about the pole, CR by a radius, which is negative for the longer arc; DR+ turns to the left."""
        sense = words.pop("DR", 0.0)
        if sense not in (1.0, -1.0):
            raise _Refused(f"{kind} needs DR+ or DR-")
        self.arc_centre = None
        if kind == "CR":
            if "R" not in words:
                raise _Refused("CR needs R")
            axes["R"] = words.pop("R")
        else:
            if self.pole is None:
                raise _Refused(f"{kind} needs CC before it")
            axes["I"], axes["J"] = self.pole.real / self.unit, self.pole.imag / self.unit
            self.arc_centre = self.pole
        return 3 if sense > 0 else 2

    def _tangent(self, kind: str, words: dict, axes: dict, start: complex) -> int:
        """CT continues in the direction of the move before it."""
        end = self._end({axis: axes[axis] for axis in "XY" if axis in axes})[:2]
        way = complex(*end) - start
        if self.heading is None or not abs(way) > 0:
            raise _Refused("CT needs a move in the xy plane before it and another end")
        across = (way / self.heading).imag  # the centre is beside the start, at the distance way^2 / (2 across)
        if abs(across) < 1e-9 * abs(way):
            raise _Refused("CT continues straight on; write L")
        self.arc_centre = start + 1j * self.heading * abs(way) ** 2 / (2 * across)
        axes["I"], axes["J"] = self.arc_centre.real / self.unit, self.arc_centre.imag / self.unit
        return 3 if across > 0 else 2

    def _centre_word(self, text: str) -> None:
        """CC X Y, CC IX IY from the place of the tool, CC alone: the place of the tool."""
        words, _ = self._words(text)
        values = [*self.position[:2]]
        for k, axis in enumerate("XY"):
            if axis in words:
                values[k] = words[axis] * self.unit
            elif f"I{axis}" in words:
                values[k] += words[f"I{axis}"] * self.unit
            elif words and self.pole is not None:
                values[k] = (self.pole.real, self.pole.imag)[k]
        if words.keys() - {"X", "Y", "IX", "IY"} or not all(map(math.isfinite, values)):
            raise _Refused("CC takes X and Y")
        self.pole = complex(*values)

    def _corner(self, word: str, text: str) -> None:
        """RND R5 and CHF 5 change the corner after the move before; CHF states the length along each side."""
        size = text.strip().removeprefix("R")
        if " " in size.strip():
            raise _Refused(f"{word} with further words")
        if isinstance(self.contour, list) and self.contour and self.contour[-1] is not None:
            value = self._value(size) * self.unit
            self.contour[-1] = self.contour[-1]._replace(corner=("RND" if word == "RND" else "CHR", value))

    # --- tools and cycles ---

    def _feed(self, value: float) -> None:
        """F: mm a minute or, in a program in inches, tenths of an inch (TNC7 User's Manual, "Cutting data")."""
        self.set_feed(value, self.unit if self.unit == MM else 0.1 * INCH)

    def _tool(self, text: str) -> None:
        match = re.match(r" ?([0-9]+|\".*?\")?(.*)", text)
        name, rest = match.groups() if match else (None, text)
        axis = re.match(r" ?([XYZ])(?![-+0-9])", rest)
        words, functions = self._words(rest[axis.end() :] if axis else rest)
        if functions or words.keys() - {"S", "F", "DL", "DR"} or (axis and axis[1] != "Z"):
            raise _Refused("TOOL CALL takes a tool, Z, S and F")
        if words.get("DL") or words.get("DR"):
            raise _Refused("DL and DR of TOOL CALL move the path; let the CAM output the allowance")
        if name:
            self.change_tool(_tool_name(name))
            self.program.length_offsets.add(self.program.tool)
            self.turning, self.called_feed = 0, None
        if "S" in words:
            self.speed = words["S"] * 2 * math.pi / 60
        if "F" in words:
            self._feed(words["F"])
            self.called_feed = self.feed
        self._turn(self.turning)

    def _define(self, number: str, text: str) -> None:
        """CYCL DEF 200, 203 and 205 drill, 201 reams, 240 centres.

        Q203: surface, Q200: level R above it, Q201: depth, Q204: level after the hole.
        """
        values = {key: self._value(value) for key, value in re.findall(r"Q([0-9]+) ?= ?([-+]?[0-9.Q]+)", text)}
        for key in values.keys() & {"200", "201", "202", "203", "204", "206"}:
            self.variables.set(int(key), values[key])
        needed = ["200", "201", "203", "206"] + ["202"] * (number not in ("201", "240"))
        if not values.keys() >= set(needed):
            raise _Refused(f"CYCL DEF {number} needs Q{', Q'.join(needed)}")
        surface, depth = values["203"] * self.unit, values["201"] * self.unit
        peck = values["202"] * self.unit if "202" in needed else -depth
        if depth >= 0 or values["200"] < 0 or peck <= 0 or any(values.get(key) for key in ("212", "343", "379", "395")):
            raise _Refused(
                "CYCL DEF needs a negative Q201, Q200 and Q202 above zero, and Q212, Q343, Q379 and Q395 of zero"
            )
        level = surface + values["200"] * self.unit
        kind = 81 if peck >= -depth else 73 if values.get("213") or values.get("257") else 83
        kind = 85 if number == "201" else kind
        back = surface + max(values["200"], values.get("204", 0.0)) * self.unit
        self.hole = Cycle(kind, back, level, surface + depth, peck), values["206"]

    def _call_cycle(self, text: str) -> None:
        if text.startswith(" PAT"):
            raise _Refused("CYCL CALL PAT takes its points from another file")
        words, functions = self._words(text.removeprefix(" POS"))
        if {"X", "Y"} <= words.keys() and text.startswith(" POS") and not words.pop("Z", 0.0):
            if self.hole and not self.position[2] >= self.hole[0].initial:
                self.move({"Z": self.hole[0].initial / self.unit}, 0)
            self.move({"X": words.pop("X"), "Y": words.pop("Y")}, 0)
            words.pop("FMAX", None)
        if words or any(number not in M_WORDS and number not in SPINDLE for number in functions):
            raise _Refused("CYCL CALL takes nothing, or POS with X, Y and Z of zero, which shifts the hole")
        self._drill_here()

    def _drill_here(self) -> None:
        if self.hole is None:
            raise _Refused("a call of a cycle before its CYCL DEF")
        self.ends_contour("a drilling cycle")
        cycle, rate = self.hole
        feed = self.feed
        self._feed(rate)
        self._hole(tuple(self.position), cycle, 2)
        self.feed = feed

    # --- labels ---

    def _label(self, match: re.Match, index: int) -> int:
        call, name, repeats = match.groups()
        if not call:
            return self.calls.pop() if name == "0" and self.calls else index
        if repeats is not None:
            left = self.counters.pop(index, int(repeats))
            if not left:
                return index
            self.counters[index] = left - 1
            return self._place_of(name)
        if len(self.calls) >= flow.DEEPEST:
            raise _Refused(f"more than {flow.DEEPEST} labels call one another")
        place = self._place_of(name)
        self.calls.append(index)
        return place

    def _place_of(self, name: str) -> int:
        if name not in self.labels:
            self.ended = True
            raise _Refused(f"LBL {name} is not in this program")
        return self.labels[name] + 1


def _statements(lines: list[str]) -> list[tuple[int, str, str]]:
    """Return line, text in upper case without number and comment, and comment of each statement."""
    out: list[tuple[int, str, str]] = []
    open_statement = False
    for number, line in enumerate(lines, 1):
        text = line.strip()
        continued = text.endswith("~")
        code, _, comment = text.rstrip("~").partition(";")
        code = code.strip() if open_statement else re.sub(r"^[0-9]+(?=\s|\Z)\s*", "", code.strip())
        if code.startswith("*"):  # an item of the structure
            code, comment = "", code.lstrip("* -")
        code = COMMA.sub(".", " ".join(code.upper().split()))
        if open_statement:
            first, before, remark = out[-1]
            out[-1] = first, f"{before} {code}".strip(), remark
        elif code or comment or continued:
            out.append((number, code, comment.strip()))
        open_statement = continued
    return out


def _tool_name(text: str) -> str:
    return f"T{int(text)}" if text.isdigit() else text.strip('"')
