"""APT source and CL text in: one statement after the other.

Words that move nothing are counted; those that cannot be run are listed all at once. Without UNITS/ the unit is mm.
A CIRCLE precedes the GOTO of its end. A comment, PPRINT or TOOL PATH names the feature that follows. A tool axis
i, j, k points from the tip to the spindle; the tool turns about no more than it must.
"""

from __future__ import annotations

import math
import re

from scipy.spatial.transform import Rotation

from kr270_milling.base.text import read_lines, short, unended
from kr270_milling.path.cam.apt.words import ADVICE, CENTRE, DATUM, FEEDS, LENGTHS, MILL, SILENT, SPINDLE_WORDS
from kr270_milling.path.cam.comments import kind_of, operation_name
from kr270_milling.path.cam.machine import Machine
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.source_program import ProgramTool
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN

__all__ = ["read_apt"]

WORD = re.compile(r"[A-Z][A-Z0-9 _-]*")
LARGEST_CUTTER = 0.2  #: [m]
FASTEST = 1e6  #: [rad/s]
NO_END = "a CIRCLE/ without the GOTO/ of its end"


def read_apt(path, tool: str = "", feed: float = 0.0) -> Toolpath:
    """Read an APT source or CL text file; tool: "T1" where several cut; feed [m/s]: for a program without FEDRAT/."""
    program = ProgramBuilder(path, f"T{int(tool)}" if tool.isdigit() else tool)
    reader = _AptReader(program, feed)
    reader.read(read_lines(path))
    return program.finish(reader.unit)


class StatementError(ValueError):
    """A statement with values that it cannot have."""


class _AptReader(Machine):
    """Runs statements: a move is a block of G0 after RAPID, which holds for one move, else of G1, G2 or G3."""

    def __init__(self, program: ProgramBuilder, feed: float):
        super().__init__(program, feed)
        self.absolute_centre = True
        self.speed = 0.0  #: [rad/s]
        self.rapid = False
        self.numbered = False  #: whether LOADTL names the tools
        self.circle: tuple[list[float], int] | None = None  #: its numbers and line, until the GOTO of its end
        self.system: list[str] | None = None
        self.actions = {"GOTO": self._goto, "FROM": self._from, "GODLTA": self._delta, "CIRCLE": self._circle,
                        "RAPID": self._rapid, "FEDRAT": self._feed, "FEED": self._feed, "SPINDL": self._spindle,
                        "UNITS": self._units, "FINI": self._end_program, "END": self._end_program,
                        "GOHOME": self._home, "LOADTL": self._load, "LOAD": self._load, "TOOLNO": self._load,
                        "CUTTER": self._cutter, "TLDATA": self._cutter, "CUTCOM": self._compensation,
                        "MSYS": self._system}  # fmt: skip

    @property
    def started(self) -> bool:
        """Whether the program has stated the place of the tool."""
        return not math.isnan(self.position[0])

    # --- lines to statements ---

    def read(self, lines: list[str]) -> None:
        """Up to the end of the program, or of the file."""
        statement, first, number = "", 0, 1
        for number, line in enumerate(lines if lines[-1].strip() else lines[:-1], 1):
            code, comment, note = line.partition("$$")
            code, continued, _ = code.partition("$")  # what follows the sign is a remark
            if comment and not (code.strip() or continued):
                self._name(note.strip())
            first = first if statement else number
            statement += code.strip()
            if continued:
                continue
            self.program.line = first
            if statement:
                self._statement(statement)
            statement = ""
            if self.ended or self.program.hopeless:
                break
        else:
            self.program.line = number
            if statement:
                self.program.refuse("$", "the file ends in a statement that is continued with $")
            elif reason := unended(lines):
                self.program.refuse("", reason)
        if self.circle is not None:
            self.program.refuse("CIRCLE", NO_END, line=self.circle[1])

    def _statement(self, statement: str) -> None:
        head, slash, tail = statement.partition("/")
        word = " ".join(head.split()).upper()
        first = word.split(" ")[0]
        if word in self.actions:
            self._run(word, [value.strip().upper() for value in tail.split(",")] if slash else [])
        elif first in ("PPRINT", "PARTNO"):
            self._text(first, (tail or head.strip()[6:]).strip())
        elif word == "TOOL PATH":
            self._tool_path(tail)
        elif first in SILENT:
            self.program.silent[first] += 1
        elif first in ADVICE:
            self.program.refuse(first, advice=ADVICE[first], lost=True)
        elif WORD.fullmatch(word):
            self.program.refuse(word, f"{short(word)} is not supported", MILL, lost=True)
        else:
            self.program.refuse(statement, f"{short(statement)!r} is no APT statement", lost=True)

    def _run(self, word: str, values: list[str]) -> None:
        try:
            if self.circle is not None and word in ("CIRCLE", "RAPID", "FROM", "GODLTA", "FINI"):
                raise StatementError(NO_END)
            self.actions[word](values)
        except StatementError as error:
            self.circle = None
            self.program.refuse(word, str(error))

    # --- names ---

    def _name(self, text: str) -> None:
        name, _ = operation_name(text)
        if name:
            self.program.name_feature(name)

    def _text(self, word: str, text: str) -> None:
        self.program.silent[word] += 1
        if word == "PPRINT":
            self._name(text)
            self.program.comments.append((text, self.program.tool, False))
        else:
            self.program.title = self.program.title or text

    def _tool_path(self, tail: str) -> None:
        """TOOL PATH/operation,TOOL,name of NX."""
        operation, _, rest = tail.partition(",")
        self.program.name_feature(operation.strip() or "tool path")
        name = rest.partition(",")[2].strip()
        if name and not self.numbered:
            self.change_tool(name)
            self.program.known.setdefault(name, ProgramTool(name))

    def _load(self, values: list[str]) -> None:
        """LOADTL/1, TOOLNO/1,..., LOAD/TOOL,1"""
        name = next((value for value in values if value.lstrip("+").isdigit()), "")
        if name:
            self.numbered = True
            self.change_tool(f"T{int(name)}")

    def change_tool(self, tool: str) -> None:
        self.program.named = True  # statements name the features, not the tools
        super().change_tool(tool)

    def _cutter(self, values: list[str]) -> None:
        """CUTTER/d, r, e, f, a, b, h and TLDATA/MILL, d, r, h, b, a say the diameter and the corner radius of a mill.

        a and b are the angles of the bottom and of the side. TLDATA begins with the kind: MILL, DRILL, TCUTTER.
        """
        self.program.silent["CUTTER"] += 1
        sizes = [value for value in values if not value[:1].isalpha()]
        diameter = _number(sizes[0]) * self.unit if sizes else 0.0
        if 0 < diameter <= LARGEST_CUTTER:
            mill = not values[0][:1].isalpha() or values[0].upper() == "MILL"
            radius = _number(sizes[1]) * self.unit if mill and len(sizes) > 1 else 0.0
            radius = radius if 0.0 < radius <= 0.501 * diameter else 0.0
            bottom, side = (4, 5) if values[0] == sizes[0] else (4, 3)
            if not mill:
                kind = kind_of(values[0].replace("TCUTTER", "T-slot"))
            elif len(sizes) > side and _number(sizes[side]):
                kind = "tapered mill"
            else:
                kind = "drill" if len(sizes) > bottom and _number(sizes[bottom]) else ""
            self.program.known[self.program.tool] = ProgramTool(
                self.program.tool, diameter=diameter, corner_radius=radius, kind=kind
            )

    # --- moves ---

    def _goto(self, values: list[str]) -> None:
        numbers = [_number(v) for v in values]
        points = len(numbers) > 6 or (len(numbers) == 6 and abs(math.hypot(*numbers[3:]) - 1) > 1e-3)
        if self.circle is not None and points and len(numbers) % 3 == 0:
            numbers = numbers[-3:]  # Creo lists points of the arc, the last one is its end
        if len(numbers) not in (3, 6):
            raise StatementError(f"GOTO/ needs x, y, z or x, y, z, i, j, k, not {len(numbers)} numbers")
        if len(numbers) == 6:
            self.program.quaternion = _tool_axis(numbers[3:])
        self._block(numbers[:3])

    def _block(self, end: list[float]) -> None:
        axes = dict(zip("XYZ", end, strict=True))
        mode = 0 if self.rapid or not self.started else 1
        if self.circle is not None and mode:
            (x, y, _, _, _, k, *more), _ = self.circle
            mode = 2 if (k < 0) == (len(more) == 1) else 3
            axes |= {"I": x, "J": y}
        self.rapid = False
        self.circle = None
        self.move(axes, mode)

    def _circle(self, values: list[str]) -> None:
        """k = 1 is counterclockwise, by the right-hand rule, and in NX, which adds tolerance and tool, clockwise.

        Seven numbers: PTC Creo help, "CL output for circular interpolation". Eleven: NX documentation, CLSF manager,
        names the axis "assuming a clockwise direction"; tool paths that NX wrote confirm it.
        """
        if "TIMES" in values:
            raise StatementError("CIRCLE/ of several turns; let the CAM output each turn, or GOTO moves")
        numbers = [_number(v) for v in values]
        if len(numbers) not in (7, 11):
            raise StatementError("CIRCLE/ needs x, y, z, i, j, k, r, and in NX four numbers more")
        if abs(abs(numbers[5]) - 1) > 1e-6:
            raise StatementError("CIRCLE/ about an axis that is not z; let the CAM output GOTO moves")
        if not self.started:
            raise StatementError("CIRCLE/ before a first GOTO/")
        self.circle = numbers, self.program.line

    def _from(self, values: list[str]) -> None:
        self.rapid = True
        self._goto(values)

    def _delta(self, values: list[str]) -> None:
        numbers = [_number(v) for v in values]
        numbers = [0.0, 0.0, *numbers] if len(numbers) == 1 else numbers
        if len(numbers) != 3 or not self.started:
            raise StatementError("GODLTA/ needs dx, dy, dz after a first GOTO/")
        self.incremental = True
        self._block(numbers)
        self.incremental = False

    def _home(self, values: list[str]) -> None:
        self.program.silent["GOHOME"] += 1
        if self.started:
            self.home(["Z"])

    def _rapid(self, values: list[str]) -> None:
        self.rapid = True

    def _end_program(self, values: list[str]) -> None:
        self.ended = True

    # --- settings ---

    def _feed(self, values: list[str]) -> None:
        units = [v for v in values if v in FEEDS]
        rest = [v for v in values if v not in FEEDS]
        if len(rest) != 1 or len(units) > 1:
            raise StatementError("FEDRAT/ needs one number and, if any, MMPM, IPM, MMPR or IPR")
        length, per_turn = FEEDS[units[0]] if units else (None, False)
        self.set_feed_mode(95 if per_turn else 94)
        self.set_feed(_number(rest[0]), length or self.unit)
        self.rapid = False

    def _spindle(self, values: list[str]) -> None:
        sense = 1
        for value in values:
            if value == "OFF":
                self.program.spindle_speed = 0.0
                return
            if value == "CCLW":
                sense = -1
            elif value[:1].isalpha() and value not in SPINDLE_WORDS:
                raise StatementError(f"SPINDL/{short(value)} is not supported (ON, OFF, a number, RPM, CLW, CCLW are)")
            elif value not in SPINDLE_WORDS:
                self.speed = _number(value) * 2 * math.pi / 60
                if not 0 <= self.speed <= FASTEST:
                    raise StatementError(f"the spindle speed {short(value)} is out of range")
        self.program.spindle_speed = sense * self.speed

    def _units(self, values: list[str]) -> None:
        if len(values) != 1 or values[0] not in LENGTHS:
            raise StatementError(f"UNITS/ needs MM or INCHES, not {short(','.join(values))!r}")
        self.unit = LENGTHS[values[0]]

    def _compensation(self, values: list[str]) -> None:
        if values and values[0] not in ("OFF", "ADJUST", "ON"):
            self.program.refuse("CUTCOM", advice=CENTRE)
        else:
            self.program.silent["CUTCOM"] += 1

    def _system(self, values: list[str]) -> None:
        """MSYS/: the coordinates are counted from one system of the machine, whichever it is."""
        if values != self.system and (self.system is not None or self.started):
            raise StatementError(f"a second MSYS/; {DATUM}")
        self.system = values
        self.program.silent["MSYS"] += 1


def _number(text: str) -> float:
    try:
        value = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise StatementError(f"{short(text)!r} is not a finite number")
    return value


def _tool_axis(axis: list[float]) -> tuple[float, float, float, float]:
    """Quaternion of tcp whose -z is ``axis``."""
    length = math.hypot(*axis)
    if not abs(length - 1) < 1e-3:
        raise StatementError(f"the tool axis has the length {length:g} instead of 1")
    i, j, k = (v / length for v in axis)
    if k < -0.999:
        raise StatementError("the tool comes from below; the tool must be parallel to z; post a 3-axis path")
    turn = Rotation.from_quat([-j, i, 0.0, 1 + k])  # the shortest from z to the axis
    return tuple((turn * Rotation.from_quat(TOOL_DOWN)).as_quat(canonical=True).tolist())
