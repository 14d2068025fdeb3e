"""APT source and CL text in: one statement after the other.

Words that move nothing are counted; those that cannot be run are listed all at once. Without UNITS/ the unit is mm.
A CIRCLE precedes the GOTO of its end. A comment, PPRINT or TOOL PATH names the feature that follows. A tool axis
i, j, k points from the tip to the spindle (``tool_along``). Circles and holes may be in any plane.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from kr270_milling.base.files import read_lines, short, unended
from kr270_milling.base.frames import Pose, rotation_from_quaternion, tool_axis
from kr270_milling.path.cam.comments import kind_of, operation_name
from kr270_milling.path.cam.gcode.words import SILENT_M
from kr270_milling.path.cam.machine import INCH, MM, Machine
from kr270_milling.path.cam.program_builder import Cycle, ProgramBuilder
from kr270_milling.path.source_program import ProgramTool
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN, tool_along

LENGTHS = {"MM": MM, "INCHES": INCH, "INCH": INCH, "IN": INCH, "CM": 1e-2}
#: unit of FEDRAT -> length [m], None: that of UNITS, and whether it is per revolution
FEEDS = {"MMPM": (MM, False), "IPM": (INCH, False), "PERMIN": (None, False), "MMPR": (MM, True), "IPR": (INCH, True),
         "PERREV": (None, True)}  # fmt: skip
#: kind of CYCLE/ -> the cycle of G-code that makes the same hole
CYCLES = {"DRILL": 81, "FACE": 82, "DEEP": 83, "BRKCHP": 73, "REAM": 85}
#: words without effect on the path, whatever their values
SILENT = frozenset({
    "REMARK", "MACHIN", "COOLNT", "DISPLY", "PAINT", "INTOL", "OUTTOL", "TOLER", "END-OF-PATH", "STOP", "OPSTOP",
    "OPSKIP", "DELAY", "DWELL", "REWIND", "SEQNO", "LEADER", "CLEARP", "CLEARANCE", "CHECK", "SETMODE", "MODE",
    "CATPROCESS", "OP", "TPRINT", "CAMERA", "HEAD", "THICK", "LETTER", "OVPLOT", "PIVOTZ", "SELECT", "SET", "MULTAX",
    "MCHTOL", "ARCSLP", "BREAK", "UNLOAD", "TLON",
})  # fmt: skip
TEXTS = ("PARTNO", "PPRINT", "REMARK", "INSERT", "LETTER")  #: their values are text, in which $ is a character
TEXT = re.compile(rf"\s*(?:{'|'.join(TEXTS)})\b", re.I)
MILL = "post CL data of a 3-axis mill: GOTO, CIRCLE, FEDRAT, RAPID"
DATUM = "let the CAM output coordinates of one system"
MOVES = "let the CAM output this move as GOTO"
MACROS = "let the CAM output CL data without macros, loops and geometry statements"
ADVICE = {
    "CYCLE": "let the CAM output drilling as GOTO moves", "THREAD": "leave threads out", "PROBE": "leave probing out",
    **dict.fromkeys(("TLLFT", "TLRGT", "INDIRV", "GOFWD", "NURBS", "ARCMOV", "MOVARC", "HELIX"),
                    "let the CAM output arcs as CIRCLE/ about z or as GOTO moves"),
    **dict.fromkeys(("TRACUT", "TRANS", "COPY", "ROTATE", "ROTABL", "ROTHED", "PATTERN"), DATUM),
    **dict.fromkeys(("PLUNGE", "SAFETY", "POSTN"), MOVES),
    **dict.fromkeys(("LOOPST", "LOOPND", "MACRO", "CALL", "IF", "JUMPTO", "TERMAC"), MACROS),
}  # fmt: skip


NO_END = "a CIRCLE/ without the GOTO/ of its end"


def read_apt(path, tool: str = "", feed: float = 0.0) -> Toolpath:
    """Read an APT source or CL text file; tool: "T1" where several cut; feed [m/s]: for a program without FEDRAT/."""
    program = ProgramBuilder(path, f"T{int(tool)}" if tool.isdigit() else tool)
    reader = _AptReader(program, feed)
    reader.read(read_lines(path))
    if not (reader.units_given or reader.metric):
        program.doubtful.append(("no unit", "the program states no unit (UNITS/ or MMPM): its lengths count in mm", 0))
    return program.finish(reader.unit)


class StatementError(ValueError):
    """A statement with values that it cannot have."""


class _AptReader(Machine):
    """Runs statements: a move is a block of G0 after RAPID, which holds for one move, else of G1, G2 or G3."""

    def __init__(self, program: ProgramBuilder, feed: float):
        super().__init__(program, feed)
        self.absolute_centre = True
        self.speed = 0.0  #: [rad/s]
        self.cutter: ProgramTool | None = None  #: of the next cut: CUTTER/ is before LOADTL/ (CATIA) or after
        self.rapid = False
        self.numbered = False  #: True if LOADTL names the tools
        self.circle: tuple[list[float], int] | None = None  #: its numbers and line, until the GOTO of its end
        self.systems: dict[str, list] = {}  #: word -> its values
        self.units_given = False
        self.metric = False  #: a feed in MMPM or MMPR
        self.announced = False  #: a comment announced an operation by word
        self.holes: dict[str, float] = {}  #: depth, clear, step and back of the active CYCLE/ [m]
        self.feed_beside: tuple = ()  #: mode and feed of the moves that are no holes
        self.retracted = 0  #: line of a RETRCT/ that the tool has not come back from
        self.actions: dict[str, Callable[[list[str]], None]]
        self.actions = {"GOTO": self._goto, "FROM": self._from, "GODLTA": self._delta, "CIRCLE": self._circle,
                        "TLAXIS": self._axis,
                        "RAPID": self._rapid, "FEDRAT": self._feed, "FEED": self._feed, "SPINDL": self._spindle,
                        "UNITS": self._units, "FINI": self._end_program, "END": self._end_program,
                        "GOHOME": self._home, "LOADTL": self._load, "LOAD": self._load, "TOOLNO": self._load,
                        "CUTTER": self._cutter, "TLDATA": self._cutter, "CUTCOM": self._compensation,
                        "RETRCT": self._retract, "CYCLE": self._cycle,
                        "AUXFUN": self._auxiliary, "PREFUN": self._preparatory,
                        "MSYS": functools.partial(self._system, "MSYS"),
                        "CSYS": functools.partial(self._system, "CSYS"),
                        "ORIGIN": functools.partial(self._system, "ORIGIN")}  # fmt: skip

    @property
    def started(self) -> bool:
        """Return whether the program has stated the place of the tool."""
        return not math.isnan(self.position[0])

    # --- lines to statements ---

    def read(self, lines: list[str]) -> None:
        """Up to the end of the program, or of the file."""
        statement, remark, first, number, cuts = "", "", 0, 1, 0
        for number, line in enumerate(_without_numbers(lines if lines[-1].strip() else lines[:-1]), 1):
            # numbers that continue a remark of Creo
            if remark and re.fullmatch(r"[-+0-9.,EeDd \t]*\$?\s*", line):
                remark, line = remark.rstrip("$ \t") + line.strip(), ""
            if remark and not remark.endswith("$"):
                self._remark(remark)
                remark = ""
            if statement and self._begins(statement) in SILENT and self._begins(line):
                self._counted(statement)  # the sign in it is text: it would swallow a statement in silence
                statement = ""
            if not statement and TEXT.match(line):
                code, comment, note, continued = line, "", "", ""
            else:
                code, comment, note = line.partition("$$")
                code, continued, _ = code.partition("$")  # a remark follows the sign
            first = first if statement else number
            self.program.line = first
            if comment and not (code.strip() or continued):
                if note.startswith("->"):
                    remark = note.strip()
                self._name(note.strip())
            statement += code.strip()
            if continued:
                continue
            cuts, self.program.moved = self.program.cuts, False
            if statement:
                self._counted(statement)
            statement = ""
            if self.ended or self.program.hopeless:
                break
        else:
            self.program.line = number
            retract = self.program.moved and self.program.cuts == cuts > 0
            if statement:
                self.program.refuse("$", "the file ends in a statement that is continued with $")
            elif (reason := unended(lines)) and not (retract or lines[-1].partition("/")[0].strip().upper() in SILENT):
                self.program.refuse("", reason)
        if remark:
            self._remark(remark)
        if self.circle is not None:
            self.program.refuse("CIRCLE", NO_END, line=self.circle[1])

    def _begins(self, line: str) -> str:
        """Return the known word that a line begins with, "" for none."""
        match = re.match(r"\s*([A-Z][A-Z-]*)\s*(?:[/$]|\Z)", line, re.I)
        word = match[1].upper() if match else ""
        return word if word in self.actions or word in SILENT or word in ADVICE or word in TEXTS else ""

    def _counted(self, statement: str) -> None:
        """Run a statement and note that it was used, counted or refused."""
        words, refusals, counted = self.program.words, self.program.refusals, self.program.words["counted"]
        self._statement(statement)
        if words["counted"] == counted:
            words["used" if self.program.refusals == refusals else "refused"] += 1

    def _statement(self, statement: str) -> None:
        head, slash, tail = statement.partition("/")
        word = " ".join(head.split()).upper()
        first = word.split(" ")[0]
        values = [value.strip().upper() for value in tail.split(",")] if tail.strip() else []
        if word in self.actions:
            self._run(word, values)
        elif first in TEXTS:
            self._text(first, (tail or head.strip()[6:]).strip(), statement.strip()[6:])
        elif word == "TOOL PATH":
            self._tool_path(tail)
        elif first in ("MODE", "SET", "SETMODE") and "INCR" in values:
            self.program.refuse(first, f"{first}/INCR makes coordinates lengths", MOVES, lost=True)
        elif first in SILENT or (first in ADVICE and values in (["OFF"], ["NOMORE"])):
            self.program.count(first)
        elif first in ADVICE:
            self.program.refuse(first, advice=ADVICE[first], lost=True)
        elif re.fullmatch(r"[A-Z][A-Z0-9 _-]*", word):
            self.program.refuse(word, f"{short(word)} is not supported", MILL, lost=True)
        else:
            self.program.refuse(statement, f"{short(statement)!r} is no APT statement", lost=True)

    def _run(self, word: str, values: list[str]) -> None:
        try:
            if self.circle is not None and word in ("CIRCLE", "RAPID", "FROM", "GODLTA", "FINI"):
                raise StatementError(NO_END)
            if self.holes and word not in ("GOTO", "CYCLE", "SPINDL", "FINI", "END"):
                raise StatementError(f"{word} before CYCLE/OFF")
            self.actions[word](values)
        except StatementError as error:
            self.circle = None
            self.program.refuse(word, str(error))

    # --- names ---

    def _name(self, text: str) -> None:
        name, announced = operation_name(text)
        self.announced = self.announced or announced
        if name and (announced or not self.announced):
            self.program.name_feature(name)

    def _text(self, word: str, text: str, block: str) -> None:
        # a block of an INSERT that sets or moves
        words = re.findall(r"(?<![A-Z])([A-Z])\s*([-+]?\.?[0-9]+)", block, re.I) if word == "INSERT" else ()
        if any(
            letter not in "Nn" and (letter not in "Mm" or float(number) not in SILENT_M) for letter, number in words
        ):
            self.program.refuse(word, f"INSERT {short(block.strip(' /'))!r} sets or moves", MOVES, lost=True)
            return
        self.program.count(word)
        if word == "PPRINT":
            self._name(text)
            self.program.comments.append((text, self.program.tool, False))
        elif word == "PARTNO":
            self.program.title = self.program.title or text

    def _remark(self, text: str) -> None:
        """Remarks of Creo that state what others write as statements."""
        word, _, tail = text.removeprefix("->").partition("/")
        if word.strip() in ("CSYS", "CUTTER"):
            self._run(word.strip(), [value.strip() for value in tail.rstrip("$ ").split(",") if value.strip()])

    def _tool_path(self, tail: str) -> None:
        """TOOL PATH/operation,TOOL,name of NX."""
        operation, _, rest = tail.partition(",")
        self.program.name_feature(operation.strip() or "tool path")
        name = rest.partition(",")[2].strip()
        if name and not self.numbered:
            self.change_tool(name)
            self.program.known.setdefault(name, ProgramTool(name))

    def _load(self, values: list[str]) -> None:
        """LOADTL/1, TOOLNO/1,..., LOAD/TOOL,1; what follows is data of the tool, such as its length."""
        name = next((value for value in values if value not in ("TOOL", "TURRET")), "")
        if not name or name in ("LENGTH", "ADJUST", "OSETNO"):
            raise StatementError("LOADTL/ needs the number of the tool first")
        if not name[:1].isalpha():
            number = _number(name)
            if number != int(number):
                raise StatementError(f"the number {short(name)} of the tool is not whole")
            name = f"T{int(number)}"
        self.numbered = True
        self.retracted = 0
        self.program.spindle_speed = 0.0  # as M6 stops it
        self.change_tool(name)

    def change_tool(self, tool: str) -> None:
        self.program.named = True  # statements name the features, not the tools
        super().change_tool(tool)

    def _cutter(self, values: list[str]) -> None:
        """CUTTER/d, r, e, f, a, b, h and TLDATA/MILL, d, r, h, b, a say the diameter and the corner radius of a mill.

        a and b are the angles of the bottom and of the side. TLDATA begins with the kind: MILL, DRILL, TCUTTER.
        """
        self.program.count("CUTTER")
        sizes = [value for value in values if not value[:1].isalpha()]
        diameter = _number(sizes[0]) * self.unit if sizes else 0.0
        if 0 < diameter <= 0.2:  # [m]
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
            self.cutter = ProgramTool("", diameter=diameter, corner_radius=radius, kind=kind)

    def _feed_to(self, *args) -> None:
        tool, known = self.program.tool, self.program.known
        if self.cutter is not None:
            cutter, self.cutter = dataclasses.replace(self.cutter, name=tool), None
            if known.setdefault(tool, cutter).diameter and known[tool] != cutter:
                reason = f"CUTTER/ states a second size of {tool or 'the tool'}"
                self.program.refuse("CUTTER", reason, "write LOADTL/ with a further number")
            known[tool] = cutter
        super()._feed_to(*args)

    # --- moves ---

    def _goto(self, values: list[str]) -> None:
        numbers = [_number(v) for v in values]
        points = len(numbers) > 6 or (len(numbers) == 6 and abs(math.hypot(*numbers[3:]) - 1) > 1e-3)
        if self.circle is not None and points and len(numbers) % 3 == 0:
            numbers = numbers[-3:]  # Creo lists points of the arc, the last one is its end
        if len(numbers) not in (3, 6):
            raise StatementError(f"GOTO/ needs x, y, z or x, y, z, i, j, k, not {len(numbers)} numbers")
        if len(numbers) == 6:
            self._turn(numbers[3:])
        self._block(numbers[:3])

    def _axis(self, values: list[str]) -> None:
        """TLAXIS/i, j, k: of the GOTO that follow without an axis."""
        numbers = [_number(value) for value in values]
        if len(numbers) != 3:
            raise StatementError("TLAXIS/ needs i, j, k")
        self._turn(numbers)

    def _turn(self, axis: list[float]) -> None:
        try:
            quaternion = tool_along(axis)
        except ValueError as fault:
            raise StatementError(str(fault)) from None
        if self.circle is not None and quaternion != self.program.quaternion:
            raise StatementError("a CIRCLE/ along which the tool axis changes; let the CAM output GOTO moves")
        if self.holes:
            self.program.turn(quaternion)
        self.program.quaternion = quaternion

    @contextlib.contextmanager
    def _plane(self, axis: Sequence[float]) -> Iterator[Callable[[Sequence[float]], list[float]]]:
        """Run what follows in a plane whose z is ``axis``; yields the map of places and directions into the plane."""
        turn = rotation_from_quaternion(np.array(tool_along(axis))) @ np.diag([1.0, -1.0, -1.0])
        self.set_tilt(Pose(np.zeros(3), turn))
        yield lambda place: (turn.T @ np.array(place)).tolist()
        self.set_tilt(None)

    def _block(self, end: list[float]) -> None:
        if self.retracted:
            reason = "RETRCT lifts the tool to a plane of the machine"
            self.program.refuse("RETRCT", reason, MOVES, lost=True, line=self.retracted)
            self.retracted = 0
        if self.holes:
            self._drilled(end)
            return
        axes = dict(zip("XYZ", end, strict=True))
        mode = 0 if self.rapid or not self.started else 1
        circle, self.rapid, self.circle = self.circle, False, None
        if circle is None or not mode:
            self.move(axes, mode)
            return
        (*centre, i, j, k), more = circle[0][:6], circle[0][6:]
        mode = 2 if (k < 0) == (len(more) == 1) else 3
        if abs(abs(k) - 1) < 1e-6:
            self.move(axes | {"I": centre[0], "J": centre[1]}, mode)
            return
        with self._plane([-i, -j, -k] if k < 0 else [i, j, k]) as inside:
            x, y, z = inside(end)
            centre = inside(centre)
            self.move({"X": x, "Y": y, "Z": z, "I": centre[0], "J": centre[1]}, mode)

    def _cycle(self, values: list[str]) -> None:
        """CYCLE/DRILL and others in the words of Creo (fixed and couplet), NX, CATIA: each GOTO that follows is a hole.

        Distances are counted from the point of the GOTO. PTC Creo help, "CL output for holemaking cycles": CYCLE/type,
        depth, feed, unit, clear, step, or DEPTH, unit and feed, CLEAR, STEP, RETURN; RETURN,0 leads to the height
        before the cycle, as RTRCTO,AUTO of NX does. Without either the tool returns to the clear height.
        """
        # word of CYCLE/ -> the distance that follows
        distances = {"DEPTH": "depth", "FEDTO": "depth", "CLEAR": "clear", "RAPTO": "clear", "STEP": "step",
                     "INCR": "step", "RETURN": "back", "RTRCTO": "back"}  # fmt: skip
        if self.holes:
            (self.feed_mode, self.feed), self.holes = self.feed_beside, {}
        self.cycle = None
        if values in (["OFF"], ["NOMORE"]):
            self.program.count("CYCLE")
            return
        kinds, units, numbers, holes = [], [], [], {}
        rest = iter(values)
        for value in rest:
            if value in CYCLES:
                kinds.append(value)
            elif value in FEEDS:
                units.append(value)
            elif name := distances.get(value):
                number = next(rest, "")
                if name in holes:
                    raise StatementError(f"CYCLE/ has two words for one distance, the second is {value}")
                holes[name] = math.inf if (name == "back" and number == "AUTO") else _number(number) * self.unit
            elif value == "DWELL":
                _number(next(rest, ""))
                self.program.silent["DWELL"] += 1
            elif value[:1].isalpha():
                raise StatementError(f"CYCLE/ with {short(value)}; {ADVICE['CYCLE']}")
            else:
                numbers.append(value)
        bare = (["depth"] if "depth" not in holes else []) + (["feed"] if units else [])
        if len(bare) == 2:
            bare += ["clear", "step"]
        if len(numbers) > len(bare) or len(units) > 1 or len(numbers) < len(units):
            sentence = f"CYCLE/ with {len(numbers)} numbers and {len(units)} units of feed"
            raise StatementError(f"{sentence}; {ADVICE['CYCLE']}")
        stated = dict(zip(bare, numbers, strict=False))
        for name in stated.keys() - {"feed"}:
            if name in holes:
                raise StatementError(f"CYCLE/ states the {name} twice")
            holes[name] = _number(stated[name]) * self.unit
        depth, step, deep = abs(holes.get("depth", 0.0)), holes.get("step", 0.0), CYCLES[kinds[-1]] if kinds else 0
        if not (kinds and depth and "clear" in holes) or (deep in (73, 83)) != (step > 0.0):
            raise StatementError("CYCLE/ needs a kind, a depth, a height to go to rapidly and, if DEEP or BRKCHP, STEP")
        if not self.started:
            raise StatementError("CYCLE/ before a first GOTO/")
        self.feed_beside = self.feed_mode, self.feed
        if units:
            self._feed([stated["feed"], *units])
        self.holes = holes | {"depth": depth}
        self.cycle = Cycle(deep, self.position[2], math.nan, peck=step)

    def _drilled(self, point: list[float]) -> None:
        """Drill a hole at the point of a GOTO."""
        if self.program.quaternion == TOOL_DOWN:
            self._drilled_along_z(point)
            return
        axis = tool_axis(np.array(self.program.quaternion))
        with self._plane(axis.tolist()) as inside:
            self._drilled_along_z(inside(point))

    def _drilled_along_z(self, point: list[float]) -> None:
        cycle, holes, (x, y, z) = self.cycle, self.holes, (value * self.unit for value in point)
        if cycle is None:
            raise StatementError("CYCLE/ is not active")
        cycle.retract, cycle.bottom = z + holes["clear"], z - holes["depth"]
        back = holes.get("back", 0.0)
        before = cycle.initial
        self.to_initial = "back" in holes
        if math.isfinite(back) and back > 0.0:
            cycle.initial = z + back
        self._hole((x, y, z), cycle, 2)
        cycle.initial = before

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
        if not abs(math.hypot(*numbers[3:6]) - 1) < 1e-3:
            raise StatementError(f"the axis of CIRCLE/ has the length {math.hypot(*numbers[3:6]):g} instead of 1")
        if not self.started:
            raise StatementError("CIRCLE/ before a first GOTO/")
        self.circle = numbers, self.program.line

    def _from(self, values: list[str]) -> None:
        self.rapid = True
        self._goto(values)

    def _delta(self, values: list[str]) -> None:
        numbers = [_number(v) for v in values]
        if len(numbers) == 1:  # along the tool axis
            numbers = (numbers[0] * tool_axis(np.array(self.program.quaternion))).tolist()
        if len(numbers) != 3 or not self.started:
            raise StatementError("GODLTA/ needs dx, dy, dz after a first GOTO/")
        self.incremental = True
        self._block(numbers)
        self.incremental = False

    def _home(self, values: list[str]) -> None:
        self.retracted = 0
        self.program.count("GOHOME")
        if self.started:
            self.home(["Z"])

    def _rapid(self, values: list[str]) -> None:
        if values:
            raise StatementError(f"RAPID/{short(','.join(values))} is not supported; RAPID holds for one move")
        self.rapid = True

    def _retract(self, values: list[str]) -> None:
        """Harmless where the tool is changed or the program ends next."""
        self.retracted = self.program.line
        self.program.count("RETRCT")

    def _end_program(self, values: list[str]) -> None:
        self.ended = True

    # --- settings ---

    def _feed(self, values: list[str]) -> None:
        units = [v for v in values if v in FEEDS]
        rest = [v for v in values if v not in FEEDS]
        if len(rest) != 1 or len(units) > 1:
            raise StatementError("FEDRAT/ needs one number and, if any, MMPM, IPM, MMPR or IPR")
        length, per_turn = FEEDS[units[0]] if units else (None, False)
        self.metric |= length == MM
        if length == INCH and not self.units_given:
            raise StatementError(f"FEDRAT/ in {units[0]} without UNITS/; add UNITS/INCHES or UNITS/MM before it")
        self.set_feed_mode(95 if per_turn else 94)
        self.set_feed(_number(rest[0]), length or self.unit)
        self.rapid = False

    def _spindle(self, values: list[str]) -> None:
        spindle_words = ("ON", "RPM", "LOW", "MEDIUM", "HIGH", "AUTO")
        sense, speeds = 0, []
        rest = iter(values)
        for value in rest:
            if value == "OFF":
                self.program.spindle_speed = 0.0
                return
            if value in ("RANGE", "MAXRPM"):  # a gear or a limit
                next(rest, "")
            elif value in ("CLW", "CCLW"):
                sense = 1 if value == "CLW" else -1
            elif value[:1].isalpha() and value not in spindle_words:
                raise StatementError(f"SPINDL/{short(value)} is not supported (ON, OFF, a number, RPM, CLW, CCLW are)")
            elif value not in spindle_words:
                speeds.append(_number(value) * 2 * math.pi / 60)
                if not 0 <= speeds[-1] <= 1e6:  # [rad/s]
                    raise StatementError(f"the spindle speed {short(value)} is out of range")
        if len(speeds) > 1:
            raise StatementError(f"SPINDL/{short(','.join(values))} has {len(speeds)} speeds")
        sense = sense or (-1 if not speeds and self.speed < 0 else 1)  # SPINDL/ON: as before
        self.program.spindle_speed = self.speed = sense * abs(speeds[0] if speeds else self.speed)

    def _units(self, values: list[str]) -> None:
        if len(values) != 1 or values[0] not in LENGTHS:
            raise StatementError(f"UNITS/ needs MM or INCHES, not {short(','.join(values))!r}")
        if (self.started or self.cutter) and not self.units_given and self.unit != LENGTHS[values[0]]:
            raise StatementError(f"UNITS/{values[0]} comes after lengths that are read in mm; write UNITS/ first")
        self.unit = LENGTHS[values[0]]
        self.units_given = True

    def _compensation(self, values: list[str]) -> None:
        """Count the compensation of the tool's length and the end of each; refuse all others."""
        side = {"LEFT", "RIGHT"} & set(values) or not {"OFF", "ADJUST", "LENGTH"} & set(values)
        if values and side:
            self.program.refuse("CUTCOM", advice="let the CAM output the path of the tool's centre", lost=True)
        else:
            self.program.count("CUTCOM")

    def _system(self, word: str, values: list[str]) -> None:
        """MSYS/, ORIGIN/, CSYS/: the coordinates are counted from one system of the machine, whichever it is."""
        numbers = [_number(value) for value in values]
        late = self.started and word not in self.systems
        if late or self.systems.setdefault(word, numbers) != numbers:
            raise StatementError(f"a second {word}/; {DATUM}")
        self.program.count(word)

    def _auxiliary(self, values: list[str]) -> None:
        """AUXFUN/8 is M8."""
        if len(values) != 1 or _number(values[0]) not in SILENT_M:
            raise StatementError(f"AUXFUN/{short(','.join(values))} is not known; leave it out where it moves no axis")
        self.program.count("AUXFUN")

    def _preparatory(self, values: list[str]) -> None:
        """PREFUN/17 is G17."""
        if len(values) != 1 or _number(values[0]) not in (17, 40, 49, 61, 64, 80, 90, 94):
            raise StatementError(f"PREFUN/{short(','.join(values))} sets or moves what GOTO does not state; {MOVES}")
        self.program.count("PREFUN")


def _without_numbers(lines: list[str]) -> list[str]:
    """Return the lines of punched cards without the rising numbers of their columns 73 to 80, other lines unchanged."""
    # columns 73 to 80 of a punched card number it
    cards = [re.fullmatch(r".{72}\s{0,7}[A-Z]{0,5}([0-9]{1,8})\s*", line) for line in lines if line.strip()]
    numbers = [int(card[1]) for card in cards if card]
    rising = all(a < b for a, b in itertools.pairwise(numbers))
    return [line[:72] for line in lines] if len(numbers) == len(cards) > 1 and rising else lines


def _number(text: str) -> float:
    try:
        value = float(text.upper().replace("D", "E")) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise StatementError(f"{short(text)!r} is not a finite number")
    return value
