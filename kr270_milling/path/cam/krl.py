"""Robot programs in KRL in: lines to statements, statements to moves of the one machine.

PTP and SPTP are rapid moves; LIN, CIRC, SLIN, SCIRC and SPL cut with $VEL.CP. Coordinates are those of $BASE, which is
the frame of the path. Blending (C_DIS) is not simulated. The tool axis is z of $TOOL, or x where x points down.
"""

from __future__ import annotations

import cmath
import contextlib
import itertools
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from kr270_milling.base.files import read_lines, short
from kr270_milling.base.frames import quaternion_from_rotation, rotation_from_abc
from kr270_milling.path.cam.arcs import ArcError, arc_points
from kr270_milling.path.cam.comments import operation_name
from kr270_milling.path.cam.krl_values import FRAME, KrlError, UnknownValueError, composed, evaluated, parts
from kr270_milling.path.cam.machine import CHORD, MM, Machine
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.toolpath import REACH, Toolpath

DEEPEST, MOST_STATEMENTS = 10, 1_000_000
#: first word of a block -> words that end it or its parts
BLOCKS = {
    "IF": ("ELSE", "ENDIF"), "FOR": ("ENDFOR",), "WHILE": ("ENDWHILE",), "REPEAT": ("UNTIL",), "LOOP": ("ENDLOOP",),
    "SWITCH": ("CASE", "DEFAULT", "ENDSWITCH"), "SPLINE": ("ENDSPLINE",), "PTP_SPLINE": ("ENDSPLINE",),
}  # fmt: skip
#: words of statements without effect on the path
SILENT = frozenset({
    "INTERRUPT", "TRIGGER", "WAIT", "PULSE", "ANOUT", "ANIN", "DIGIN", "CWRITE", "HALT", "CONTINUE", "SIGNAL", "EXT",
    "EXTFCT", "IMPORT", "ENUM", "STRUC", "USERSPOT", "USER_GRP", "IR_STOPM", "CONST_VEL", "INI", "CLEAR",
})  # fmt: skip
TYPES = ("INT", "REAL", "BOOL", "CHAR", "FRAME", "POS", "E6POS", "AXIS", "E6AXIS", "FDAT", "LDAT", "PDAT")
#: variables of the controller without effect on the path; those of speed, tool and base have a branch
SILENT_SYSTEM = re.compile(
    r"\$(?:ACC|JERK|APO|ADVANCE|ORI_TYPE|CIRC_TYPE|CIRC_MODE|SPL_|LOAD|OUT|ANOUT|BWDSTART|H_POS|VEL_AXIS|ACC_AXIS|GEAR_"
    r"|VEL\.ORI|TIMER|FLAG|CYCFLAG|ACT_TOOL|ACT_BASE|VEL_EXTAX|ACC_EXTAX|TORQMON|CP_|RED_|PRO_|LOOP|MSG|NUM_|OUT_C)",
)
MOTION = re.compile(r"(S?PTP|S?LIN|S?CIRC|SPL)(_REL)?\b(?=\s*[{$\w(])", re.I)
ASSIGNMENT = re.compile(r"(\$?\w+(?:\[[^=]*\])?(?:\.\w+)*)\s*=(?!=)\s*(.*)")
AXES = ("X", "Y", "Z")
POST = "post the moves as LIN, CIRC and PTP with their coordinates"
EXTERNAL = tuple(f"E{k}" for k in range(1, 7))


def read_krl_program(path, tool: str = "", feed: float = 0.0) -> Toolpath:
    """Read the main routine of a .src file, its .dat file, and the routines of the folder that the main one calls.

    tool: "T1" of $TOOL=TOOL_DATA[1] where several cut; feed [m/s]: for a program without $VEL.CP.
    """
    program = ProgramBuilder(path, f"T{int(tool)}" if tool.isdigit() else tool)
    reader = _KrlReader(program, feed, Path(path))
    reader.read()
    return program.finish(reader.unit)


class _Statement(NamedTuple):
    """A line of a routine; a block has its parts: the line that begins each, and the statements of each."""

    file: Path
    line: int
    text: str
    blocks: tuple[tuple[str, list[_Statement]], ...] = ()

    @property
    def word(self) -> str:
        match = re.match(r"\$?\w+", self.text)
        return match[0].upper() if match else self.text[:1]


class _Segment(NamedTuple):
    """A cut: LIN, CIRC, or PL for SPL."""

    kind: str
    start: tuple[float, ...]  #: [m]
    points: list[tuple[float, ...]]  #: [m], after the start
    length: float  #: [m]
    curvature: float  #: in the xy plane [1/m]
    feed: float | None  #: [m/s]
    line: int
    quaternion: tuple[float, ...]


class _Leave(Exception):
    """EXIT of a loop, or RETURN."""


class _Values(dict[str, Any]):
    """Variables by their upper-case names, P[3] with its index; None: declared, without a value."""

    def __init__(self) -> None:
        super().__init__()
        self.whole: set[str] = set()  #: names of INT variables


class _KrlReader(Machine):
    """Runs statements."""

    def __init__(self, program: ProgramBuilder, feed: float, path: Path):
        super().__init__(program, feed)
        self.path = path
        self.stated_feed = self.feed  #: that of the cell
        self.shared = _Values()  #: variables that no file of the program declares, and GLOBAL ones
        self.data = _Values()  #: those of the .dat file of the routine that runs
        self.locals: list[_Values] = []  #: those of the routine, then of routines of the same file that called it
        self.routines: dict[str, list[_Statement]] = {}  #: of the file that runs
        self.loaded: dict[Path, tuple[_Values, dict[str, list[_Statement]]]] = {}  #: data and routines of each file
        self.public: dict[str, Path] = {}  #: routine -> file, of those that other files may call
        self.depth = self.statements = 0
        self.override = 1.0
        self.abc: tuple[float, ...] | None = None  #: A, B, C [deg] of the tool
        self.external: dict[str, float] = {}  #: E1 to E6 where the tool is
        self.cut_external: dict[str, float] | None = None  #: those of the first cut
        self.frames: dict[str, dict] = {}  #: $TOOL and $BASE that are given by numbers
        self.along_x = False  #: the tool is along x of $TOOL
        self.cut_along_x: bool | None = None  #: that of the first cut
        self.spline: list[_Segment] | None = None  #: segments of the SPLINE block that is read

    # --- files to routines ---

    def read(self) -> None:
        try:
            self._load(self.path)
            if self.loaded[self.path][1]:
                self._routine(self.path, next(iter(self.loaded[self.path][1])))
        except RecursionError:
            self.program.refuse("IF", "too many blocks are in each other")

    def _load(self, path: Path) -> None:
        """Take the routines of a .src file and the data of its .dat file."""
        outside = self.locals, self.data
        self.data, routines = self.loaded[path] = _Values(), {}
        self.locals = [self.data]
        for data in (path.with_suffix(end) for end in (".dat", ".DAT")):
            if data != path and data.is_file():
                self.program.files.append(data)
                for number, text in _lines(data):
                    with contextlib.suppress(KrlError):  # only a statement that needs the value is refused
                        self._declare(_Statement(data, number, text), text)
                break
        self.program.files += [path] * (path != self.path)
        lines = iter(_lines(path))
        for number, text in lines:
            match = re.fullmatch(r"(?:GLOBAL\s+)?DEF\s+(\w+)\s*\((.*)\)", text, re.I)
            if match:
                self.program.title = self.program.title or match[1]
                body, last = _tree(path, lines, ("END",))
                if not routines or text[:1].upper() == "G":
                    self.public.setdefault(match[1].upper(), path)
                routines.setdefault(match[1].upper(), body)
                if match[2].strip():
                    routines[match[1].upper()] = [_Statement(path, number, f"DEF {match[2]}")]
                if last is None:
                    self.program.line = number
                    self.program.refuse("END", f"{match[1]} has no END; the file may be cut off")
            elif re.match(r"(?:GLOBAL\s+)?DEFFCT\b", text, re.I):
                _tree(path, lines, ("ENDFCT",))
        if not routines:
            self.program.refuse("DEF", "a KRL program begins with DEF NAME( )")
        self.locals, self.data = outside

    def _routine(self, path: Path, name: str) -> None:
        """Run a routine of a file: its own variables hide those of the file, which hide shared ones."""
        if self.depth >= DEEPEST:
            raise KrlError(f"routines call each other more than {DEEPEST} deep")
        self.depth += 1
        outside = self.locals, self.data, self.routines
        self.data, self.routines = self.loaded[path]
        self.locals = [_Values(), *(self.locals if outside[2] is self.routines else [])]
        try:
            self._run(self.routines[name])
        except _Leave:
            pass
        finally:
            self.depth -= 1
            self.locals, self.data, self.routines = outside

    # --- statements ---

    def _run(self, statements: list[_Statement]) -> None:
        for statement in statements:
            if self.program.hopeless:
                return
            inside = statement.file == self.path
            self.program.line = statement.line if inside else self.program.line
            self.program.go_to("" if inside else f"{statement.file.name}, line {statement.line}")
            refusals, counted, refused = self.program.refusals, self.program.words["counted"], False
            if statement.text[:1] == ";":
                name, announced = operation_name(statement.text.lstrip("; "))
                if name and (announced or not self.program.inside_operation):
                    self.program.name_operation(name, title=False)
                continue
            if self._spent(statement.word, 1):
                return
            try:
                self._statement(statement)
            except (KrlError, ArcError) as error:
                self.program.refuse(statement.word, str(error), lost=True)
                refused = True
            except (TypeError, ValueError, AttributeError, IndexError):  # of a value of another kind, as $VEL=5
                self.program.refuse(statement.word, f"{short(statement.text)!r} has a value of another kind", lost=True)
                refused = True
            words = self.program.words
            if refused or (not statement.blocks and self.program.refusals > refusals):
                words["refused"] += 1
            elif statement.blocks or words["counted"] == counted or MOTION.match(statement.text):
                words["used"] += 1

    def _spent(self, word: str, count: int) -> bool:
        """Count statements and return whether there are too many, which is refused once."""
        self.statements += count
        if self.statements > MOST_STATEMENTS and not self.ended:
            self.ended = True
            self.program.refuse(word, f"more than {MOST_STATEMENTS} statements are run")
        return self.ended

    def _statement(self, statement: _Statement) -> None:
        word, text = statement.word, statement.text
        if statement.blocks:
            self._block(statement)
        elif match := MOTION.match(text):
            self._motion(match[1].upper().removeprefix("S"), bool(match[2]), text[match.end() :])
        elif word == "DEF":
            raise KrlError("a routine with parameters; " + POST)
        elif word in ("EXIT", "RETURN"):
            raise _Leave(word)
        elif (match := re.search(r"\bDO\s+(\$[\w.]+).*=", text, re.I)) and not SILENT_SYSTEM.match(match[1].upper()):
            raise KrlError(f"{word} sets {match[1]} within a move")
        elif word in SILENT or (word == "GLOBAL" and "INTERRUPT" in text.upper()):
            self.program.count(word)
        elif word in ("DECL", "GLOBAL", "CONST", *TYPES) and not text[len(word) :].lstrip().startswith("="):
            self._declare(statement, text)
        elif word == "BAS":
            self._bas(text)
        elif match := ASSIGNMENT.fullmatch(text):
            self._assign(match[1].upper().replace(" ", ""), match[2])
        elif match := re.fullmatch(r"(\w+)\s*\(\s*(.*?)\s*\)", text):
            self._call(match[1], match[2])
        elif word in ("GOTO", "RESUME", "BRAKE") or re.fullmatch(r"\w+:", text):
            raise KrlError(f"{word} is not supported; {POST}")
        else:
            raise KrlError(f"{short(text)!r} is not known; {POST}")

    def _block(self, statement: _Statement) -> None:
        word, (head, body) = statement.word, statement.blocks[0]
        if word == "SPLINE":
            self._spline(head, body)
        elif word == "PTP_SPLINE":
            raise KrlError(f"PTP_SPLINE is not supported; {POST}")
        elif word == "IF":
            condition = self._value(re.sub(r"\s+THEN\Z", "", head[2:], flags=re.I))
            branches = [part for _, part in statement.blocks]
            self._run(branches[0] if condition is True else branches[1] if len(branches) > 1 else [])
        elif word == "SWITCH":
            value = self._value(head[6:])
            for line, part in statement.blocks[1:]:
                cases = parts(re.sub(r"\A\w+", "", line))
                if line.upper().startswith("DEFAULT") or value in [self._value(case) for case in cases]:
                    self._run(part)
                    break
        else:
            self._loop(word, head, statement.blocks)

    def _loop(self, word: str, head: str, blocks) -> None:
        body, until = blocks[0][1], blocks[-1][0]
        name = ""
        if word == "FOR":
            match = re.fullmatch(r"FOR\s+(\w+)\s*=\s*(.*?)\s+TO\s+(.*?)(?:\s+STEP\s+(.*))?", head, re.I)
            if match is None:
                raise KrlError(f"{short(head)!r} is no FOR loop")
            name, values = match[1].upper(), [self._value(text or "1") for text in match.groups()[1:]]
            if not all(isinstance(value, int) for value in values) or not values[2]:
                raise KrlError("a FOR loop counts in whole numbers")
            of_loop = self._holder(name)
            of_loop[name] = values[0]
        try:
            while not self._spent(word, not body) and not self.program.hopeless:
                if word == "FOR" and (of_loop[name] - values[1]) * values[2] > 0:
                    return
                if word == "WHILE" and self._value(head[5:]) is not True:
                    return
                self._run(body)
                if word == "FOR":
                    of_loop[name] += values[2]
                if word == "REPEAT" and self._value(until[5:]) is True:
                    return
        except _Leave as leave:
            if leave.args == ("RETURN",):
                raise

    # --- variables ---

    def _value(self, text: str) -> Any:
        return evaluated(text, self._variable)

    def _holder(self, name: str) -> _Values:
        """Return the variables among which a name is declared: of the routine, of the file, or shared."""
        stem = name.partition("[")[0]
        return next((values for values in (*self.locals, self.data) if stem in values), self.shared)

    def _variable(self, name: str) -> Any:
        if name == "$POS_ACT" and not any(map(math.isnan, self.position)):
            place = [value / MM for value in self.position]
            return dict(zip(FRAME, [*place, *(self.abc or (0.0, 0.0, 0.0))], strict=True)) | self.external
        if name == "$VEL" and self.feed:
            return {"CP": self.feed}
        if name == "$NULLFRAME":
            return dict.fromkeys(FRAME, 0.0)
        value = self._holder(name).get(name)
        if value is None:
            raise UnknownValueError(name)
        return value

    def _declare(self, statement: _Statement, text: str) -> None:
        """``DECL E6POS XP1={...}``, ``INT I, K``, ``REAL A=1.5``; without a value the name has none."""
        if statement.word in ("DEFDAT", "ENDDAT", *SILENT):
            return
        if match := ASSIGNMENT.fullmatch(text):
            self._store(match[1].upper(), match[2])
            return
        words = re.match(r"(?:(?:DECL|GLOBAL|CONST)\s+)*", text, re.I)[0]  # type: ignore[index]  # it may be empty
        holder = self.shared if "GLOBAL" in words.upper() else self.locals[0]
        kind, _, names = text[len(words) :].partition(" ")
        for name, _, value in (part.partition("=") for part in parts(names)):
            name = re.sub(r"\s", "", name).upper()
            stem = name.partition("[")[0]
            holder.setdefault(stem)
            if kind.upper() == "INT":
                holder.whole.add(stem)
            if value:
                self._store(name, value)

    def _store(self, name: str, text: str) -> None:
        if "[" in name:
            stem, _, rest = name.partition("[")
            index, _, tail = rest.partition("]")
            name = f"{stem}[{','.join(str(self._value(part)) for part in parts(index))}]{tail}" if index else name
        stem, _, component = name.partition(".")
        try:
            value = self._value(text)
        except UnknownValueError:
            value = None
        values = self._holder(stem)
        if component:
            values[stem] = dict(values.get(stem) or {}) | {component: value}
            return
        if stem.partition("[")[0] in values.whole and isinstance(value, float):
            value = round(value)
        values[stem] = value

    def _assign(self, name: str, text: str) -> None:
        if name == "$VEL.CP":
            self._set_speed(self._value(text))
        elif name == "$VEL":
            self._set_speed(self._value(text).get("CP"))
        elif name == "$OV_PRO":
            self.override = float(self._value(text)) / 100
        elif name in ("$TOOL", "$BASE"):
            self._set_frame(name, text)
        elif SILENT_SYSTEM.match(name):
            self.program.count(name)
        elif name == "$IPO_MODE":
            self._interpolate(self._value(text))
            self.program.count(name)
        elif name[0] == "$":
            raise KrlError(f"{name} may move the coordinates; {POST}")
        else:
            self._store(name, text)

    def _interpolate(self, mode: Any) -> None:
        """$IPO_MODE: with #TCP the robot holds the workpiece."""
        if isinstance(mode, str) and mode.upper() == "#TCP":
            raise KrlError(f"$IPO_MODE #TCP moves the workpiece at a fixed tool; {POST}")

    def _set_speed(self, value) -> None:
        if not isinstance(value, (int, float)) or not 0 < value <= REACH:
            raise KrlError(f"$VEL.CP must lie between 0 and {REACH:g} m/s")
        self.feed = float(value)

    def _set_frame(self, name: str, text: str) -> None:
        """TOOL_DATA[3] is the tool T3; the cell says where tool and base are."""
        text = " ".join(text.split()).upper()
        match = re.fullmatch(r"(?:TOOL_DATA|BASE_DATA|STOOL2?|SBASE)\s*[\[(](.*)[\])]", text)
        if match:
            number = self._value(match[1])
            number = number.get("TOOL_NO") if isinstance(number, dict) else number
            if not isinstance(number, int):
                raise KrlError(f"{short(text)!r} has no whole number")
            text = f"{name[1:]}_DATA[{number}]"
            self.frames.pop(name, None)
        else:
            frame = self.frames[name] = self._value(text)
            text = f"{name}={{{','.join(f'{axis} {frame[axis]:g}' for axis in FRAME if axis in frame)}}}"
        if name == "$BASE":
            self.program.set_frame("work offsets", text)
            return
        if match:
            self.change_tool(f"T{number}")
        self.program.set_frame("tool edges", text)

    def _bas(self, text: str) -> None:
        word, *rest = parts(text.partition("(")[2].rpartition(")")[0])
        word = word.upper()
        if word in ("#VEL_CP", "#CP_PARAMS"):
            self._set_speed(self._value(rest[0]))
        if word in ("#TOOL", "#BASE"):
            self._set_frame(f"${word[1:]}", f"{word[1:]}_DATA[{rest[0]}]")
        elif word in ("#FRAMES", "#CP_PARAMS", "#PTP_PARAMS"):
            data = self._holder("FDAT_ACT").get("FDAT_ACT")
            self._interpolate(data.get("IPO_FRAME") if isinstance(data, dict) else None)
            for name, key in (("$TOOL", "TOOL_NO"), ("$BASE", "BASE_NO")):
                if isinstance(data, dict) and key in data:
                    self._set_frame(name, f"{name[1:]}_DATA[{data[key]}]")
        elif word == "#INITMOV":  # the speed is that of the controller again
            self.program.count(f"BAS({word})")
            self.feed = self.stated_feed
        elif re.match(r"#(?:ACC_|VEL_PTP|PTP_DAT|CP_DAT|OUT_|EX_)", word):
            self.program.count(f"BAS({word})")
        elif word != "#VEL_CP":
            raise KrlError(f"BAS({short(word)}) is not known; {POST}")

    def _call(self, name: str, arguments: str) -> None:
        """Run a routine of the file, or of a file of that name beside it or in a folder P1 below it."""
        key = name.upper()
        here = next(path for path, (_, routines) in self.loaded.items() if routines is self.routines)
        if key not in self.routines and key not in self.public:
            paths = [path for folder in ("*", "P[0-9]*/*") for path in sorted(self.path.parent.glob(folder))]
            sources = (path for path in paths if path.suffix.lower() == ".src" and path.stem.upper() == key)
            file = next(sources, None)
            if file is None or arguments:
                raise KrlError(f"the routine {short(name)} is not in the folder of the program; {POST}")
            self._load(file)
        if arguments or not (key in self.routines or key in self.public):
            raise KrlError(f"{short(name)} is no routine without parameters; {POST}")
        self._routine(here if key in self.routines else self.public[key], key)

    # --- motions ---

    def _motion(self, kind: str, relative: bool, text: str) -> None:
        """kind: PTP, LIN, CIRC, PL (the S of the spline motions is gone)."""
        text, _, settings = re.sub(r"\s+WITH\s+", "\0", text, count=1, flags=re.I).partition("\0")
        own_feed = self.feed
        for setting in parts(settings) if settings else ():
            self._setting(setting)
        if blend := re.search(r"\s(?:C_(?:DIS|VEL|ORI|PTP|SPL)\b\s*)+\Z", text, re.I):
            self.program.count(blend[0].strip().upper())
            text = text[: blend.start()]
        if relative and re.search(r"#TOOL\Z", text, re.I):
            raise KrlError(f"{kind}_REL in the axes of the tool (#TOOL); {POST}")
        targets = parts(re.sub(r"\s*#BASE\Z", "", text, flags=re.I) if relative else text)
        angle = self._value(targets.pop().split(None, 1)[1]) if re.match(r"CA\s", targets[-1], re.I) else None
        if len(targets) != (2 if kind == "CIRC" else 1):
            raise KrlError(f"{kind} with {len(targets)} places; {POST}")
        if kind == "PTP":
            self._rapid(targets[0], relative)
        else:
            start, before = tuple(self.position), self.external
            places = [self._place(target, relative) for target in targets]
            known = all(map(math.isfinite, start))
            moving = [name for name in EXTERNAL if before.get(name, 0.0) != self.external.get(name, 0.0)]
            if known and moving and moving[0] in before:
                raise KrlError(f"{moving[0]} moves in a cut; an external axis keeps one place")
            if any(map(math.isnan, places[-1])):
                raise KrlError("a cut before X, Y and Z are known")
            arc = _circle(start, places, angle) if kind == "CIRC" and known else None
            points, length, curvature = arc or ([places[-1]], math.dist(start, places[-1]), 0.0)
            segment = _Segment(
                kind, start, points, length, curvature, self.feed, self.program.line, self.program.quaternion
            )
            if self.spline is None:
                self._cut_segment(segment)
            else:
                self.spline.append(segment)
            self.position = list(points[-1])
        self.feed = own_feed

    def _setting(self, text: str) -> None:
        """``$VEL.CP=0.05`` and ``$VEL=SVEL_CP(0.05, , LCPDAT1)`` behind WITH."""
        name, _, value = (part.strip() for part in text.partition("="))
        if match := re.fullmatch(r"SVEL_CP\((.*)\)", value, re.I):
            self._set_speed(self._value(parts(match[1])[0]))
        elif match := re.fullmatch(r"SBASE\((.*)\)", value, re.I):
            self._set_frame("$BASE", f"BASE_DATA[{self._value(match[1])}]")
        elif match := re.fullmatch(r"SIPO_MODE\((.*)\)", value, re.I):
            self._interpolate(self._value(match[1]))
            self.program.count(name.upper())
        elif re.fullmatch(r"(?:SVEL_JOINT|SLOAD|SACC_\w+|SAPO\w*|SGEAR_JERK|SJERK)\(.*\)", value, re.I):
            self.program.count(name.upper())
        else:
            self._assign(name.upper(), value)

    def _rapid(self, text: str, relative: bool) -> None:
        try:
            frame = self._value(text)
        except UnknownValueError:
            if not re.search(r"HOME|\A\s*\$", text, re.I):  # places of the controller
                raise
            frame = {"A1": 0.0}
        if not isinstance(frame, dict):
            raise KrlError(f"{short(text)!r} is no place")
        self._move_external(frame)
        if any(f"A{k}" in frame for k in range(1, 7)):
            self.home(["X", "Y", "Z"])
            return
        end = self._place(frame, relative)
        if all(map(math.isfinite, end)):
            self.go(end)
        self.position = list(end)

    def _place(self, target, relative: bool) -> tuple[float, ...]:
        """Return X, Y, Z [m] of a place and turn the tool to its A, B, C; what the place leaves out stays."""
        frame = self._value(target) if isinstance(target, str) else target
        if not isinstance(frame, dict) or any(f"A{k}" in frame for k in range(1, 7)):
            raise KrlError("a cut leads to coordinates, not to angles of the axes")
        if any(value is None for value in frame.values()):
            raise KrlError("a coordinate of the place has no value")
        if relative and set(frame) & {"A", "B", "C"}:
            raise KrlError(f"a relative turn of the tool; {POST}")
        end = list(self.position)
        for k, axis in enumerate(AXES):
            if axis in frame:
                end[k] = frame[axis] * MM + (self.position[k] if relative else 0.0)
        if not all(abs(value) <= REACH for value in end if math.isfinite(value)):
            raise KrlError(f"the place lies more than {REACH:g} m away")
        self._move_external(frame)
        angles = dict(zip("ABC", self.abc or (0.0, 0.0, 0.0), strict=True))
        if set(frame) & set(angles):
            self._turn(tuple(float(frame.get(name, angle)) for name, angle in angles.items()))
        return tuple(end)

    def _turn(self, abc: tuple[float, ...]) -> None:
        if abc == self.abc:
            return
        self.abc = abc
        rotation = rotation_from_abc(np.radians(abc))
        self.along_x = bool(rotation[2, 0] < -0.9 < rotation[2, 2])
        if self.along_x:  # x of the tool points down: z of tcp is x, y stays
            rotation = np.stack([-rotation[:, 2], rotation[:, 1], rotation[:, 0]], axis=1)
        quaternion = quaternion_from_rotation(rotation)
        if abs(quaternion @ self.program.quaternion) < 1 - 1e-12:
            self.program.quaternion = tuple(quaternion.tolist())

    def _move_external(self, frame: dict) -> None:
        self.external = self.external | {name: float(frame[name]) for name in EXTERNAL if name in frame}

    def _cut_segment(self, segment: _Segment) -> None:
        """Cut, or go to the end from a place that the program gives as angles of the axes."""
        self.program.line, self.program.quaternion = segment.line, segment.quaternion
        if not all(map(math.isfinite, segment.start)):
            self.go(segment.points[-1])
            return
        names = self.external if self.cut_external is None else self.cut_external
        moved = [name for name in names if self.external.get(name, 0.0) != names[name]]
        if moved:
            raise KrlError(f"{moved[0]} moves between cuts; an external axis keeps one place")
        self.cut_external = names
        if self.cut_along_x not in (None, self.along_x):
            raise KrlError("the tool is along z of $TOOL in one cut and along x, which points down, in another")
        self.cut_along_x = self.along_x
        self.program.external = tuple(names.get(name, 0.0) for name in EXTERNAL)
        for name, frame in self.frames.items():
            placed = composed(frame, {"B": 90.0}) if name == "$TOOL" and self.along_x else frame
            self.program.displayed[name] = tuple(float(placed.get(axis, 0.0)) for axis in FRAME)
        self._cut_through(segment.start, segment.points, segment.length, segment.curvature, segment.feed)

    def _cut_through(self, start, points: list, length: float, curvature: float, feed: float | None) -> None:
        own_feed, self.feed = self.feed, feed * self.override if feed else None
        self._feed_to(start, points, length, curvature)
        self.feed = own_feed

    def _spline(self, head: str, body: list[_Statement]) -> None:
        """SPL segments between lines and arcs are one C2 cubic spline over the chords; KUKA's rule is not public.

        The ends are tangential to a neighbouring line, else without curvature.
        """
        if self.spline is not None:
            raise KrlError("a SPLINE block in another one")
        self.spline, own_feed = [], self.feed
        for setting in parts(head.partition("WITH")[2]) if "WITH" in head.upper() else ():
            self._setting(setting)
        try:
            self._run(body)
        finally:
            segments, self.spline, self.feed = self.spline, None, own_feed
        turns = [True, *(a.quaternion != b.quaternion for a, b in itertools.pairwise(segments))]
        # a point again is no segment; a tool that turns in place rests there
        segments = [part for part, turned in zip(segments, turns, strict=False) if part.length > 0 or turned]
        k, line = 0, self.program.line
        while k < len(segments):
            last = k + 1
            if segments[k].kind == "PL" and segments[k].length > 0 and all(map(math.isfinite, segments[k].start)):
                while last < len(segments) and segments[last].kind == "PL" and segments[last].length > 0:
                    last += 1
                self._curve_through(segments, k, last)
            else:
                self._cut_segment(segments[k])
            k = last
        self.program.line = line

    def _curve_through(self, segments: list[_Segment], first: int, last: int) -> None:
        own = segments[first:last]
        knots = np.array([own[0].start, *(segment.points[-1] for segment in own)])
        chord = np.append(0.0, np.cumsum([segment.length for segment in own]))
        ends = []
        for beside in (segments[first - 1] if first else None, segments[last] if last < len(segments) else None):
            if beside is not None and beside.kind == "LIN" and beside.length > 0:
                ends.append((1, np.subtract(beside.points[-1], beside.start) / beside.length))
            else:
                ends.append((2, np.zeros(3)))
        curve = CubicSpline(chord, knots, bc_type=tuple(ends))
        for k, segment in enumerate(own):
            bend = max(np.linalg.norm(curve(chord[k : k + 2], 2), axis=1))
            count = max(1, math.ceil(segment.length * math.sqrt(bend / (8 * CHORD))))
            points = curve(np.linspace(chord[k], chord[k + 1], count + 1))
            points[-1] = knots[k + 1]
            length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            self._cut_segment(segment._replace(points=list(map(tuple, points[1:].tolist())), length=length))


def _circle(start, places, angle: float | None) -> tuple[list, float, float]:
    """Points of the arc from start through two places [m]; angle [deg]: CA, how far instead; its length, curvature."""
    a, b, c = (np.array(point, float) for point in (start, *places))
    u, v = b - a, c - a
    normal = np.cross(u, v)
    size = np.linalg.norm(normal)
    if size < 1e-12 * REACH or not np.all(np.isfinite(normal)):
        raise ArcError("the three places of CIRC lie on a line")
    normal /= size
    if abs(normal[2]) > 1 - 1e-12:  # keep x and y, so that the arc stays an arc of the xy plane
        normal = np.array([0.0, 0.0, math.copysign(1.0, normal[2])])
        axes = np.array([[1.0, 0.0, 0.0], [0.0, normal[2], 0.0], normal])
    else:
        first = u / np.linalg.norm(u)
        axes = np.array([first, np.cross(normal, first), normal])
    (ax, ay, az), (bx, by, _), (cx, cy, _) = (axes @ point for point in (a, b, c))
    determinant = 2 * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    p, q = bx * bx + by * by - ax * ax - ay * ay, cx * cx + cy * cy - ax * ax - ay * ay
    centre = ((cy - ay) * p - (by - ay) * q) / determinant, ((bx - ax) * q - (cx - ax) * p) / determinant
    last, clockwise, turns = (cx, cy), False, 0
    if angle is not None:
        if not 0 < abs(angle) <= 3600:
            raise ArcError(f"CA {angle:g} must lie within 3600 degrees")
        way = complex(ax - centre[0], ay - centre[1]) * cmath.rect(1.0, math.radians(angle))
        last, clockwise = (centre[0] + way.real, centre[1] + way.imag), angle < 0
        turns = int((abs(angle) - 1e-9) // 360)
        if abs(angle) % 360 < 1e-9:
            last = ax, ay
    closing = 1e-9 + 1e-6 * math.hypot(ax - centre[0], ay - centre[1])
    points, curvature, length = arc_points((ax, ay, az), (*last, az), centre, clockwise, closing, CHORD, turns)
    rows = (np.array(points) @ axes).tolist()
    if angle is None:
        rows[-1] = list(places[-1])
    level = abs(axes[2, 2]) == 1.0
    return [tuple(row) for row in rows], length, curvature * axes[2, 2] if level else 0.0


# --- lines ---


def _lines(path: Path) -> list[tuple[int, str]]:
    """Number and text of each line without its comment; a comment on a separate line stays, but not in a fold INI."""
    rows: list[tuple[int, str]] = []
    folds: list[bool] = []
    for number, line in enumerate(read_lines(path), 1):
        text = parts(line.strip(), ";")[0]
        if line.lstrip().startswith(";"):
            text = line.strip()
            fold = re.match(r";+\s*(END)?FOLD\b(.*)", text, re.I)
            if fold and fold[1]:
                folds = folds[:-1]
            elif fold:
                folds.append(re.search(r"\bINI\b", fold[2], re.I) is not None)
            if fold or any(folds) or ";%" in text:
                continue
        if text and text[0] != "&":
            rows.append((number, text))
    return rows


def _tree(path: Path, lines: Iterator[tuple[int, str]], ends: tuple[str, ...]) -> tuple[list[_Statement], str | None]:
    """Return the statements up to a line that begins with one of ``ends``, and that line; None: the file ended."""
    statements: list[_Statement] = []
    for number, text in lines:
        statement = _Statement(path, number, text)
        word = statement.word
        if word in ends:
            return statements, text
        if word in BLOCKS:
            blocks, line = [], text
            while True:
                body, last = _tree(path, lines, BLOCKS[word])
                blocks.append((line, body))
                if last is None:
                    return statements, None
                line = last
                if last.upper().startswith(("END", "UNTIL")):
                    break
            statements.append(statement._replace(blocks=(*blocks, (line, []))))
        else:
            statements.append(statement)
    return statements, None
