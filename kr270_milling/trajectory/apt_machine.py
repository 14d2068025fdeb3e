"""APT statements for the mover of G-code: where the tool stands, its feed, arcs, tools and retracts are kept there."""

from __future__ import annotations

import math

from scipy.spatial.transform import Rotation

from kr270_milling.base.text import short
from kr270_milling.trajectory.gcode.motion import Motion
from kr270_milling.trajectory.source_program import ProgramTool
from kr270_milling.trajectory.summary import Observed, Refusals
from kr270_milling.trajectory.toolpath import PathBuilder
from kr270_milling.trajectory.trajectory import TOOL_DOWN

__all__ = ["ADVICE", "FEEDS", "LENGTHS", "SILENT", "Machine"]

LENGTHS = {"MM": 1e-3, "INCHES": 0.0254, "INCH": 0.0254, "IN": 0.0254, "CM": 1e-2}
#: unit of FEDRAT -> length [m] and whether it is per revolution
FEEDS = {"MMPM": (1e-3, False), "IPM": (0.0254, False), "PERMIN": (None, False), "MMPR": (1e-3, True),
         "IPR": (0.0254, True), "PERREV": (None, True)}  # fmt: skip

#: words without effect on the path
SILENT = frozenset({"REMARK", "MACHIN", "COOLNT", "DISPLY", "PAINT", "INTOL", "OUTTOL", "TOLER", "END-OF-PATH", "STOP",
                    "OPSTOP", "OPSKIP", "DELAY", "DWELL", "REWIND", "SEQNO", "AUXFUN", "PREFUN", "INSERT", "LEADER",
                    "CLEARP", "CLEARANCE", "CHECK", "SETMODE", "MODE", "CATPROCESS", "OP", "TPRINT", "CAMERA", "HEAD",
                    "ROTABL", "THICK", "ORIGIN", "LETTER", "OVPLOT", "PIVOTZ", "RETRCT",
                    "SAFETY", "SELECT", "SET", "MCHTOL", "ARCSLP", "POSTN", "PLUNGE", "BREAK"})  # fmt: skip
MACROS = "let the CAM output CL data without macros, loops and geometry statements"
CYCLES = "let the CAM output drilling as GOTO moves"
ARCS = "let the CAM output arcs as CIRCLE/ about z or as GOTO moves"
DATUM = "let the CAM output coordinates of one system"
ADVICE = {"CYCLE": CYCLES, "TLON": ARCS, "INDIRV": ARCS, "GOFWD": ARCS, "NURBS": ARCS, "ARCMOV": ARCS, "MOVARC": ARCS,
          "HELIX": ARCS, "CUTCOM": "let the CAM output the path of the tool's centre", "TRACUT": DATUM, "TRANS": DATUM,
          "COPY": DATUM, "CSYS": DATUM, "ROTATE": DATUM, "LOOPST": MACROS, "LOOPND": MACROS, "MACRO": MACROS,
          "CALL": MACROS, "IF": MACROS, "JUMPTO": MACROS, "TERMAC": MACROS, "THREAD": "leave threads out",
          "PROBE": "leave probing out", "": "post CL data of a 3-axis mill: GOTO, CIRCLE, FEDRAT, RAPID"}  # fmt: skip


LARGEST_CUTTER = 0.2  #: [m]
AXES5 = "the tool stands along z; post a 3-axis path"
SPINDLE_WORDS = ("ON", "RPM", "CLW", "LOW", "MEDIUM", "HIGH", "AUTO", "RANGE")
NO_END = "a CIRCLE/ without the GOTO/ of its end"


class StatementError(ValueError):
    """A statement with values that it cannot have."""


class Machine:
    """Runs statements that move or set something."""

    def __init__(self, path: PathBuilder, refusals: Refusals, seen: Observed, feed: float):
        self.path = path
        self.refusals = refusals
        self.seen = seen
        self.motion = Motion(path, refusals, seen, feed)
        self.motion.absolute_centre = True
        self.unit = LENGTHS["MM"]
        self.speed = 0.0
        self.rapid = False
        self.ended = False
        self.numbered = False  #: whether LOADTL names the tools
        self.circle: tuple[list[float], int] | None = None  #: its numbers and line, until the GOTO of its end
        self.system: list[str] | None = None
        self.actions = {"GOTO": self._goto, "FROM": self._from, "GODLTA": self._delta, "CIRCLE": self._circle,
                        "RAPID": self._rapid, "FEDRAT": self._feed, "FEED": self._feed, "SPINDL": self._spindle,
                        "UNITS": self._units, "FINI": self._end, "END": self._end, "GOHOME": self._home,
                        "LOADTL": self._load, "LOAD": self._load, "TOOLNO": self._load, "CUTTER": self._cutter,
                        "TLDATA": self._cutter, "MULTAX": self._axes, "CUTCOM": self._compensation,
                        "MSYS": self._system}  # fmt: skip

    @property
    def tool(self) -> str:
        """In the spindle."""
        return self.motion.tool

    @property
    def started(self) -> bool:
        """Whether the program has said where the tool stands."""
        return not math.isnan(self.motion.position[0])

    def run(self, word: str, values: list[str], number: int) -> None:
        """One statement."""
        try:
            if self.circle is not None and word in ("CIRCLE", "RAPID", "FROM", "GODLTA", "FINI"):
                raise StatementError(NO_END)
            self.actions[word](values, number)
        except StatementError as error:
            self.circle = None
            self.refusals.add(number, word, str(error))

    def finish(self) -> None:
        """At the end of the file."""
        if self.circle is not None:
            self.refusals.add(self.circle[1], "CIRCLE", NO_END)

    # --- moves ---

    def _goto(self, values: list[str], number: int) -> None:
        numbers = [_number(v) for v in values]
        points = len(numbers) > 6 or (len(numbers) == 6 and abs(math.hypot(*numbers[3:]) - 1) > 1e-3)
        if self.circle is not None and points and len(numbers) % 3 == 0:
            numbers = numbers[-3:]  # Creo lists points of the arc, the last one is its end
        if len(numbers) not in (3, 6):
            raise StatementError(f"GOTO/ needs x, y, z or x, y, z, i, j, k, not {len(numbers)} numbers")
        if len(numbers) == 6:
            self.path.quaternion = _tool_axis(numbers[3:])
        self._move(numbers[:3], number)

    def _move(self, end: list[float], number: int, absolute: bool = True) -> None:
        """A block of G-code: G0 after RAPID, which holds for one move, and to the first point, else G1, G2 or G3."""
        axes = dict(zip("XYZ", end, strict=True))
        mode, self.rapid = (0 if self.rapid or not self.started else 1), False
        if self.circle is not None and mode:
            (x, y, _, _, _, k, *more), _ = self.circle
            mode = 2 if (k < 0) == (len(more) == 1) else 3
            axes |= {"I": x, "J": y}
        self.circle = None
        self.motion.run({"motion": mode}, axes, self.unit, dict.fromkeys("XYZ", absolute), number)

    def _circle(self, values: list[str], number: int) -> None:
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
        self.circle = numbers, number

    def _from(self, values: list[str], number: int) -> None:
        self.rapid = True
        self._goto(values, number)

    def _delta(self, values: list[str], number: int) -> None:
        numbers = [_number(v) for v in values]
        numbers = [0.0, 0.0, *numbers] if len(numbers) == 1 else numbers
        if len(numbers) != 3 or not self.started:
            raise StatementError("GODLTA/ needs dx, dy, dz after a first GOTO/")
        self._move(numbers, number, absolute=False)

    def _home(self, values: list[str], number: int) -> None:
        self.seen.silent["GOHOME"] += 1
        if self.started:
            self.motion.home(["Z"], number)

    def _rapid(self, values: list[str], number: int) -> None:
        self.rapid = True

    def _end(self, values: list[str], number: int) -> None:
        self.ended = True

    # --- settings ---

    def _feed(self, values: list[str], number: int) -> None:
        units = [v for v in values if v in FEEDS]
        rest = [v for v in values if v not in FEEDS]
        if len(rest) != 1 or len(units) > 1:
            raise StatementError("FEDRAT/ needs one number and, if any, MMPM, IPM, MMPR or IPR")
        length, per_turn = FEEDS[units[0]] if units else (None, False)
        self.motion.feed.change(95 if per_turn else 94)
        wrong = self.motion.feed.give(_number(rest[0]), length or self.unit)
        if wrong:
            raise StatementError(wrong)
        self.rapid = False

    def _spindle(self, values: list[str], number: int) -> None:
        sense = 1
        for value in values:
            if value in SPINDLE_WORDS:
                continue
            if value == "OFF":
                self.path.spindle_speed = 0.0
                return
            if value == "CCLW":
                sense = -1
                continue
            if value[:1].isalpha():
                raise StatementError(f"SPINDL/{short(value)} is not supported (ON, OFF, a number, RPM, CLW, CCLW are)")
            self.speed = _number(value) * 2 * math.pi / 60
            if not 0 <= self.speed <= 1e6:
                raise StatementError(f"the spindle speed {short(value)} is out of range")
        self.path.spindle_speed = sense * self.speed

    def _units(self, values: list[str], number: int) -> None:
        if len(values) != 1 or values[0] not in LENGTHS:
            raise StatementError(f"UNITS/ needs MM or INCHES, not {short(','.join(values))!r}")
        self.unit = self.seen.unit = LENGTHS[values[0]]

    def _load(self, values: list[str], number: int) -> None:
        """LOADTL/1, TOOLNO/1,..., LOAD/TOOL,1"""
        name = next((value for value in values if value.lstrip("+").isdigit()), "")
        if name:
            self.numbered = True
            self.change_tool(f"T{int(name)}", number)

    def change_tool(self, name: str, number: int) -> None:
        """The tool of the moves that follow."""
        if name == self.tool:
            return
        self.refusals.tool = name
        self.seen.tools.setdefault(name, number)
        self.motion.named = True  # statements name the features, not the tools
        self.motion.change_tool(name, self.seen.selected in ("", name))

    def _cutter(self, values: list[str], number: int) -> None:
        """CUTTER/d, r, ... and TLDATA/MILL, d, ... say the diameter."""
        self.seen.silent["CUTTER"] += 1
        sizes = [value for value in values if not value[:1].isalpha()]
        if sizes and 0 < _number(sizes[0]) * self.unit <= LARGEST_CUTTER:
            self.seen.known[self.tool] = ProgramTool(self.tool, diameter=_number(sizes[0]) * self.unit)

    def _axes(self, values: list[str], number: int) -> None:
        """MULTAX/ON only lets axes be written; a tilted one is refused where the path is checked."""
        self.seen.silent["MULTAX"] += 1

    def _compensation(self, values: list[str], number: int) -> None:
        if values and values[0] not in ("OFF", "ADJUST", "ON"):
            self.refusals.add(number, "CUTCOM", advice="let the CAM output the path of the tool's centre")
        else:
            self.seen.silent["CUTCOM"] += 1

    def _system(self, values: list[str], number: int) -> None:
        """MSYS/: the coordinates are counted from one system of the machine, whichever it is."""
        if values != self.system and (self.system is not None or self.started):
            raise StatementError("a second MSYS/; let the CAM output coordinates of one system")
        self.system = values
        self.seen.silent["MSYS"] += 1


def _number(text: str) -> float:
    try:
        value = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise StatementError(f"{short(text)!r} is not a finite number")
    return value


def _tool_axis(axis: list[float]) -> tuple[float, float, float, float]:
    length = math.hypot(*axis)
    if not abs(length - 1) < 1e-3:
        raise StatementError(f"the tool axis has the length {length:g} instead of 1")
    i, j, k = (v / length for v in axis)
    if k < -0.999:
        raise StatementError(f"the tool comes from below; {AXES5}")
    turn = Rotation.from_quat([-j, i, 0.0, 1 + k])  # the shortest from z to the axis
    return tuple((turn * Rotation.from_quat(TOOL_DOWN)).as_quat(canonical=True).tolist())
