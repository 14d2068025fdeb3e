"""G-code in: the path of one tool, and what the program says beside it.

Fanuc, Haas, LinuxCNC, GRBL and Sinumerik dialects: planes and helices, units, incremental moves and centres, retracts
(G28, G30, G53, SUPA), drilling cycles, feeds per minute, revolution and inverse time, parameters (``expressions``) and
jumps (``flow``). Words that move nothing are counted (``SourceProgram.read_over``); those that cannot be run are listed
all at once. Without a unit word the unit is mm. A line with the sign of block skip is run, as with the switch off.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from kr270_milling.base.files import read_lines, short, unended
from kr270_milling.path.cam.comments import operation_name
from kr270_milling.path.cam.gcode.expressions import ExpressionError, Scanner, Variables
from kr270_milling.path.cam.gcode.flow import CHANGE, Flow, has_flow
from kr270_milling.path.cam.gcode.interpreter import VECTOR, Interpreter
from kr270_milling.path.cam.gcode.words import ADVICE, HEIDENHAIN, MACROS, SILENT, UNKNOWN
from kr270_milling.path.cam.machine import CORNERS
from kr270_milling.path.cam.program_builder import ProgramBuilder
from kr270_milling.path.kinematics import NO_ROTARY_AXES, Kinematics
from kr270_milling.path.toolpath import REACH, Toolpath

#: an E directly after the digits begins an exponent if an integer follows; else, as after a blank, it is a letter of
#: its own. One of two alternatives, so that a row of E words has one meaning.
EXPONENT = r"E[-+]?[0-9]+(?![0-9.])"
NUMBER = rf"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:{EXPONENT}|(?!{EXPONENT}))"
WORD = re.compile(rf"([A-Z])[ \t]*({NUMBER})")
SIMPLE = re.compile(rf"(?:[ \t]*[A-Z][ \t]*{NUMBER})*[ \t]*")  # a line of words of one letter alone
#: a straight cutting move, or an arc, and nothing else: most lines of a long program. Blanks belong to the word before
#: them; where words share a row of blanks, the time grows by a power of its length
PLAIN = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
STRAIGHT, ARC = (
    re.compile(
        rf"[ \t]*(?:(N[ \t]*[0-9]+)[ \t]*)?(?:({word}(?![0-9.]))[ \t]*)?"
        + "".join(rf"(?:{letter}[ \t]*({PLAIN})[ \t]*)?" for letter in letters)
    )
    for word, letters in (("G0?1", "XYZF"), ("G0?[23]", "XYZIJKRF"))
)
#: a comment in brackets, nested twice at most where they pair, or after a semicolon; the brackets of a call are none
COMMENT = re.compile(
    r"(?P<call>(?<![A-Z_])[A-Z_]{2,}(?:[0-9][0-9_]*)?[ \t]*\([^()]*\))"
    r"|\((?P<nested>(?:[^()]|\((?:[^()]|\([^()]*\))*\))*)\)|\((?P<plain>[^)]*)\)|;(?P<last>.*)|(?P<open>\(.*)",
    re.I,
)
#: the pieces of an upper-case line without comments, whose names say what they are
PIECE = re.compile(
    rf"""(?P<blank>[ \t]+)
    |(?P<macro>[\#\[\]<]\S*|O[ \t]*<\S*|R[0-9]*[ \t]*=\S*)
    |(?P<call>[A-Z_]{{2,}}(?:[0-9][0-9_]*)?[ \t]*\([^()]*\))
    |(?P<assigned>[A-Z][A-Z0-9_]{{0,15}}[ \t]*=[ \t]*(?:(?:AC|IC|DC)[ \t]*\([ \t]*{NUMBER}[ \t]*\)|{NUMBER}|"[^"]*"))
    |(?P<word>(?:,[ \t]*(?=[RC]))?[A-Z@^][ \t]*{NUMBER})
    |(?P<name>[A-Z_]{{2}}[A-Z0-9_]*(?![A-Z0-9_]*[ \t]*=))
    |(?P<expression>[A-Z][-+.]*(?:[ \t]*[\#\[\]<]|=)\S*)
    |(?P<bare>[A-Z][-+.]*(?![A-Z0-9]))
    |(?P<rest>\S+|.)""",
    re.VERBOSE | re.DOTALL,
)
ASSIGNED = re.compile(rf"([A-Z][A-Z0-9_]*)[ \t]*=[ \t]*(?:(AC|IC|DC)[ \t(]*)?(?:({NUMBER})|\"(.*)\")")
#: a word that Sinumerik computes from R parameters or functions; and its name
COMPUTED = re.compile(
    r"(?:^|[ \t])R[0-9]+[ \t]*="
    r"|[A-Z][0-9]*[ \t]*=[ \t]*(?:[-+(]*(?:R[0-9]|[A-Z]{3,}2?[ \t]*\()|[-+]?[0-9.]*[ \t]*[*/(])",
    re.I,
)
NAMED = re.compile(r"[A-Z]+[0-9]*[ \t]*=[ \t]*")
BLANK = re.compile(r"[ \t]+")
LETTER = re.compile(r"[A-Z@^]")
LABEL = re.compile(r"\s*(?:N\s*[0-9]+|[O:]\s*[0-9]+)?\s*", re.I)
SKIP = re.compile(r"(N[ \t]*[0-9]+)?[ \t]*/[/0-9 \t]*", re.I)  #: the sign of block skip, before or after N


def read_gcode(
    path, tool: str = "", feed: float = 0.0, offsets: Sequence[float] = (), machine: Kinematics = NO_ROTARY_AXES
) -> Toolpath:
    """Read the path of one tool; raises ProgramError with all words that cannot be run.

    tool: "T1", needed where the program cuts with several; feed [m/s]: for a program without F, 0 for none; offsets
    [m]: x, y, z of G54, G55 ... in the workpiece frame, where the cell states them; machine: for A, B and C.
    """
    return gcode_path(path, read_lines(path), tool, feed, offsets, machine)


def gcode_path(
    path, lines: list[str], tool: str, feed: float, offsets: Sequence[float] = (), machine: Kinematics = NO_ROTARY_AXES
) -> Toolpath:
    """Return the path of the lines of a program, as ``read_gcode``; path: their file."""
    number = re.fullmatch(r"\s*[Tt]?0*([0-9]+)\s*", tool)
    program = ProgramBuilder(path, f"T{number.group(1)}" if number else tool.strip())
    interpreter = Interpreter(program, feed, changes_by_m6(lines), offsets)
    interpreter.kinematics = machine
    GcodeReader(program, interpreter).read(lines)
    if not interpreter.stated:
        program.doubtful.append(("no unit", "the program states no unit (G20 or G21): its lengths count in mm", 0))
    return program.finish(interpreter.first_unit or interpreter.unit)


def changes_by_m6(lines: list[str]) -> bool:
    """Return whether a tool comes with M6, else with its T."""
    return CHANGE.search("\n".join(lines)) is not None and any(
        CHANGE.search(_split_comments(line)[0]) for line in lines if "6" in line and CHANGE.search(line)
    )


class GcodeReader:
    """Lines to words, comments to names."""

    def __init__(self, program: ProgramBuilder, machine: Interpreter):
        self.program = program
        self.machine = machine
        self.variables = Variables(machine.parameter)
        self.computed = False  #: words were computed, or lines not run in their order
        self.announced = ""  #: operation that a post announced by word
        self.percent = 0
        self.spindle = ""  #: number of the spindle of S2=3000 and M2=3

    def read(self, lines: list[str]) -> None:
        """Up to the end of the program, or of the file."""
        program, cuts, read = self.program, 0, len(lines)
        text = "\n".join(lines).upper()
        flow = Flow(self.machine, self.variables, self.run_line, lines) if has_flow(text) else None
        if flow and program.files:
            text = "\n".join(flow.lines).upper()
        beside = re.search(r"G[ \t]*0*4[12](?![0-9])|[GOP][ \t]*[#\[=]", text)  # the contour, perhaps
        if self.machine.contour is None and (beside or any(word in text for word in CORNERS)):
            self.machine.look_ahead(lambda machine: type(self)(machine.program, machine).read(lines))
        if flow:
            flow.run()
            self.computed = self.computed or flow.jumped
            read = flow.furthest if self.machine.ended else read
        else:
            index = 0
            while index < len(lines) and not self.machine.ended and not program.hopeless:
                index = self._plain_moves(lines, index)
                if index == len(lines) - 1:
                    cuts, program.moved = program.cuts, False
                program.line = index + 1
                self.run_line(lines[index])
                index += 1
            read = index
        if self.machine.ended or program.hopeless:
            codes = (_split_comments(rest)[0].strip("% \t") for rest in lines[read:])
            program.silent["lines after the end"] += sum(map(bool, codes))
            if self.machine.end_word in (99, 47):
                program.silent[f"M{self.machine.end_word:g} of the program, which is run once"] += 1
            program.silent = +program.silent
            return
        # a last line without an end may be cut off: harmless if it ends in M words or only in a rapid move
        retract = program.moved and program.cuts == cuts > 0
        last = _split_comments(lines[-1])[0]
        harmless = retract or re.fullmatch(r"\s*%?\s*(?:N\s*[0-9]+)?(?:\s*M\s*[0-9]{1,2})*\s*", last, re.I)
        if not harmless and (reason := unended(lines)):
            program.refuse("", reason)

    def _plain_moves(self, lines: list[str], index: int) -> int:
        """Run the lines from ``index`` that are straight cuts or arcs at the same feed, but for the last line.

        Return the next index. The result is that of ``run_line``.
        """
        machine, program = self.machine, self.program
        if not machine.cuts_alone or not program.cuts_from(machine.position):
            return index
        unit, feed_word, match_line, mode = machine.unit, machine.feed_word, STRAIGHT.fullmatch, machine.mode
        x, y, z = machine.position
        ends: list[tuple[float, float, float]] = []
        words: list[int] = []
        modes: list[float | None] = []
        centres: dict[int, tuple[float, float, bool]] = {}  # of arcs, by the number of their block
        for number in range(index, min(len(lines) - 1, index + 4096)):  # arrays of some MB
            match, arc = match_line(lines[number]), None
            if match is not None:
                _, word, to_x, to_y, to_z, feed = groups = match.groups()
                mode = 1 if word else mode
            elif match := ARC.fullmatch(lines[number]):
                _, word, to_x, to_y, to_z, *arc, feed = groups = match.groups()
                mode = int(word[-1]) if word else mode
            else:
                break
            if (feed is not None and float(feed) != feed_word) or (mode == 1) != (arc is None):
                break
            start = x, y, z
            if to_x is not None:
                x = float(to_x) * unit
            if to_y is not None:
                y = float(to_y) * unit
            if to_z is not None:
                z = float(to_z) * unit
            elif to_x is None and to_y is None and arc is None:
                break
            if arc is not None:
                centre = machine.centre_of(start, (x, y, z), arc, mode == 2)
                if centre is None:
                    break
                centres[len(ends)] = (*centre, mode == 2)
            ends.append((x, y, z))
            words.append(len(groups) - groups.count(None))
            modes.append(mode)
        if len(centres) == 1 and len(ends) < 20:  # arrays take longer
            ends = ends[: min(centres)]
            centres = {}
        if centres:
            points, numbers, curvature = machine.row_of_arcs(ends, centres)
            run = len(numbers)
        else:
            run = next((k for k, end in enumerate(ends) if not max(map(abs, end)) <= REACH), len(ends))
        if not run:
            return index
        row = range(index + 1, index + run + 1)
        if centres:
            program.cut_row(points, np.repeat(row, numbers), machine.feed or 0.0, run, np.repeat(curvature, numbers))
        else:
            program.cut_row(ends[:run], row, machine.feed or 0.0, run)
        program.words["used"] += sum(words[:run])
        machine.position, machine.mode, machine.leaving = list(ends[run - 1]), modes[run - 1], None
        return index + run

    def run_line(self, line: str) -> None:
        """Run the blocks of one line."""
        if SIMPLE.fullmatch(line):
            self._run(line)
        else:
            self._line(line.strip())

    def _run(self, line: str) -> None:
        words = [(letter, float(text)) for letter, text in WORD.findall(line)]
        if words:
            self.machine.run(words)

    def _line(self, line: str) -> None:
        if "=" in line and '"' not in line:
            text = line.partition(";")[0]
            computed = COMPUTED.search(text)
            if computed and "(" not in text[: computed.start()]:  # else it is in a comment
                self._assigned_values(text.upper())
                return
        code, comments = _split_comments(line)
        if code[:1] == "%":
            self.percent += 1
            self.machine.ended = line == "%" and self.percent > 1 and len(self.program) > 1
            # start or end of a program, with a name
            if not re.fullmatch(r"%[ \t]*(?:[O:]?[0-9]*|[A-Z_][A-Z0-9_]*)[ \t]*", code, re.I):
                self.program.refuse(code, f"{short(code)!r} is no start of a program", "write blocks in lines after %")
            return
        if skip := SKIP.match(code):
            code = (skip[1] or "") + " " + code[skip.end() :]
            self.program.silent["/"] += 1
        if code[:1] == ":":
            code = "O" + code[1:]
        # title of a program of LinuxCNC
        if re.fullmatch(r"[ \t]*O?[ \t]*<[^>]*>[ \t]*", code, re.I):
            code = ""
        if comments:
            self._comments(code, comments)
        code, used = code.upper(), self.program.words["used"]
        if SIMPLE.fullmatch(code):
            self._run(code)
        elif "#" in code or "[" in code:
            self._macro("".join(code.split()))
        else:
            self._pieces(code)
        if skip and self.program.words["used"] - used > code.lstrip().startswith("N"):  # more than its number
            self.program.skippable[self.program.place, self.program.line] = None

    def _macro(self, code: str) -> None:
        """A line with parameters or expressions; assignments count after all values of the line are known."""
        self.computed = True
        scanner = Scanner(code, self.variables)
        words: list[tuple[str, Any]] = []
        assigned: list[tuple[int | str, float]] = []
        try:
            while not scanner.ended:
                if scanner.take("#"):
                    key = scanner.key()
                    if not scanner.take("="):
                        raise ExpressionError("a parameter without a word or the sign =")
                    assigned.append((key, scanner.expression()))
                elif letter := scanner.match(LETTER):
                    words.append((letter, scanner.value()))
                else:
                    raise ExpressionError(f"{short(code[scanner.place :])!r} is no word")
            for key, value in assigned:
                self.variables.set(key, value)
        except ExpressionError as fault:
            self._no_value(code, fault)
            return
        self.program.words["used"] += len(assigned)
        if words:
            self.machine.run(words)

    def _assigned_values(self, code: str) -> None:
        """A line of Sinumerik with R parameters: R1=5, G1 X=R1+2 F=R3, S1=R4."""
        self.computed = True
        scanner = Scanner(code, self.variables)
        words: list[tuple[str, Any]] = []
        try:
            while not scanner.ended:
                if scanner.match(BLANK):
                    continue
                name = scanner.match(NAMED).partition("=")[0].strip()
                if not name:
                    word = scanner.match(WORD).replace(" ", "").replace("\t", "")
                    if not word:
                        raise ExpressionError(f"{short(code[scanner.place :])!r} is no word")
                    words.append((word[0], float(word[1:])))
                    continue
                value = scanner.expression()
                if name[0] == "R" and name[1:].isdigit():
                    self.variables.set(f"R {name[1:]}", value)
                    self.program.words["used"] += 1
                elif name in ("CR", "TURN") or len(name) == 1:
                    words.append((name, value))
                else:
                    raise ExpressionError(f"{name} takes no computed value")
        except ExpressionError as fault:
            self._no_value(code.strip(), fault)
            return
        if words:
            self.machine.run(words)

    def _no_value(self, code: str, fault: ExpressionError) -> None:
        self.program.refuse(short(code), str(fault), MACROS, lost=True)
        self.program.words["refused"] += 1

    def _pieces(self, code: str) -> None:
        """A line that is more than words of one letter; nothing of it is run where one piece cannot be."""
        words: list[tuple[str, Any]] = []
        names: list[tuple[str, str]] = []  # with the text after them
        count = 0
        for match in PIECE.finditer(code):
            kind, text = match.lastgroup, match.group()
            count += kind != "blank"
            if text == "SUPA":
                words.append(("G", 53.0))
            elif kind == "word":
                size = 1 + (text[0] == ",")
                text = text.replace(" ", "").replace("\t", "")
                words.append((text[:size], float(text[size:])))
            elif kind == "assigned":
                self._assigned(text, words, names)
            elif text == "RET":
                words.append(("M", 17.0))
            elif kind in ("name", "call"):
                name, bracket, rest = text.partition("(")
                names.append((name.strip(), bracket + rest))
            elif kind != "blank":
                if stated := [name for name, _ in names if name in ADVICE]:  # IF, GOTO ... with what they compute
                    self.program.refuse(stated[0], advice=ADVICE[stated[0]], lost=True)
                else:
                    self._refuse(kind, text)
                break
        else:
            if self._known(names, any(letter != "N" for letter, _ in words)):
                self.machine.run(words)
                count = 0
        self.program.words["refused"] += count  # nothing of a line is run where a piece of it cannot be
        self.machine.absolute = {}

    def _assigned(self, text: str, words: list, names: list) -> None:
        """Take words of Sinumerik with a sign of equality: X=AC(1), CR=5, S1=3000, Z1=0, T="MILL 10"."""
        homes = (("G", 74), ("G", 75), ("G", 28))
        name, mode, number, quoted = ASSIGNED.findall(text)[0]
        letter, numbered = name[0], name[1:].isdigit()
        if not number and name == "T" and quoted.strip():
            words.append(("T", quoted.strip()))
        elif number and (name in ("CR", "TURN", *VECTOR, *CORNERS) or len(name) == 1):
            words.append((name, float(number)))
            if mode in ("AC", "IC"):
                self.machine.absolute[name] = mode == "AC"
        elif name == "FP" and ("G", 75.0) in words:
            self.program.count("FP")
        elif number and numbered and letter in "SM":
            if letter == "S" or float(number) in (3, 4, 5):
                self.spindle = self.spindle or ("1" if self.machine.speed else name[1:])
                if self.spindle != name[1:]:
                    reason = f"{name} is another spindle than S{self.spindle}"
                    self.program.refuse(name, reason, "post the words of the milling spindle alone")
            words.append((letter, float(number)))
        elif numbered and letter in "XYZ" and any(word in words for word in homes):  # of the machine: it goes home
            words[:] = [word for word in words if word not in homes[:2]]
            words += [("G", 28.0), (letter, 0.0)]
            self.machine.absolute[letter] = False  # it has no place between
        else:
            names.append((name, text[len(name) :]))

    def _refuse(self, kind: str | None, text: str) -> None:
        if kind in ("macro", "expression"):
            self.program.refuse(text, advice=MACROS, lost=True)
        elif kind == "bare":
            advice = HEIDENHAIN if text in ("L", "C") else ""
            self.program.refuse(text, f"the word {text} has no number", advice)
        elif re.match(r",[0-9]", text):
            reason = f"a number with a decimal comma before {short(text)!r}"
            self.program.refuse(text, reason, "write a decimal point", lost=True)
        elif text[0] == "(":
            self.program.refuse("(", "a comment is opened with ( but not closed", "close the bracket")
        elif re.match(r",[RCA][0-9.]", text):
            self.program.refuse(text, f"{short(text)!r} is no G-code word", ADVICE["RND"], lost=True)
        else:
            advice = "a word is a letter and a number, or put a remark in brackets"
            self.program.refuse(text, f"{short(text)!r} is no G-code word", advice)

    def _known(self, names: list[tuple[str, str]], further: bool) -> bool:
        """Return whether the words of several letters in a line let it be run; further: the line has other words."""
        silent, refusals = [], self.program.refusals
        for name, rest in names:
            reset = not rest and not further and name in ("TRANS", "ROT", "SCALE", "MIRROR")
            fields = [text.strip() for text in rest.strip("() ").split(",")]
            if name in SILENT or reset or name in ("TRAORI", "TRAFOOF"):
                silent += [name] * (name != "WORKPIECE" or not self._blank(fields))
            elif name == "CYCLE800" and not further:
                reason = self.machine.swivel(fields)
                if reason:
                    self.program.refuse(name, reason, lost=True)
                else:
                    silent.append(name)
            else:
                self.program.refuse(name, advice=ADVICE.get(name, UNKNOWN), lost=True)
        known = self.program.refusals == refusals
        for name in silent if known else ():
            self.program.count(name)
            if name in ("TRAORI", "TRAFOOF"):
                self.machine.follow_tip(name == "TRAORI")
        return known

    def _blank(self, fields: list[str]) -> bool:
        """Return whether WORKPIECE of Sinumerik states the blank, as a box with absolute coordinates (112) does."""
        if fields[3:5] == ['"BOX"', "112"]:
            with contextlib.suppress(ValueError):
                top, bottom, _, *sides = map(float, fields[5:12])
                corners = np.sort(np.reshape([*sides[:2], top, *sides[2:], bottom], (2, 3)), axis=0)
                self.program.state_stock((self.machine.unit * corners).ravel().tolist())
        return bool(self.program.stock)

    def _comments(self, code: str, comments: list[str]) -> None:
        title = re.fullmatch(r"\s*[O:]\s*[0-9]+\s*", code, re.I) is not None
        if len(self.program.comments) < 2000:
            match = re.search(r"T\s*0*([0-9]+)", code, re.I)
            in_spindle = self.program.tool if not self.program.moved else ""  # another one may be chosen already
            tool = f"T{match.group(1)}" if match else in_spindle or self.machine.next_tool
            self.program.comments += [(comment, tool, match is not None) for comment in comments]
        if title and not self.program.title:
            self.program.title = comments[0]
        if LABEL.fullmatch(code):
            self._name(comments[0], title)
        if any(comment.lower().startswith("abort,") for comment in comments):
            self.program.refuse("(abort,", "the program stops itself with (abort, ...)", lost=True)
            self.machine.ended = True

    def _name(self, comment: str, title: bool) -> None:
        name, announced = operation_name(comment)
        if announced:
            self.announced = name
        elif comment.lower().startswith("finish operation"):
            self.announced = ""
            return
        if name and (announced or not (self.announced or self.program.inside_operation)):
            self.program.name_operation(name, title)


def _split_comments(line: str) -> tuple[str, list[str]]:
    """Code and comments of a line; a bracket that is opened and not closed stays in the code."""
    comments: list[str] = []

    def code(match: re.Match) -> str:
        if match["call"] or match["open"]:
            return match.group()
        comments.append((match["nested"] or match["plain"] or match["last"] or "").strip())
        return " "

    return COMMENT.sub(code, line), comments
