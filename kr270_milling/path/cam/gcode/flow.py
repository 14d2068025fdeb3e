"""Control flow of G-code: sub-programs, conditions and loops, as a list of lines with a table of jumps.

O words and M98/M99 of LinuxCNC, M97 of Haas, IF, GOTO, WHILE and G65 of Fanuc, L sub-programs of Sinumerik. A program
without them is run line by line, without this module. A sub-program that is called by its name or number, and is not in
the program, is that of a file with this name in the folder of the program, in its subroutines or in its subs.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import read_lines, short
from kr270_milling.path.cam.gcode import ENDINGS
from kr270_milling.path.cam.gcode.expressions import ExpressionError, Scanner, Variables
from kr270_milling.path.cam.gcode.interpreter import Interpreter
from kr270_milling.path.cam.gcode.words import MACROS

MOST_BLOCKS = 1_000_000  #: lines that a program with sub-programs or loops runs; assumed
DEEPEST = 10  #: sub-programs in sub-programs: LinuxCNC, INTERP_SUB_ROUTINE_LEVELS
MOST_FILES, MOST_BYTES = 100, 16_000_000  #: files with sub-programs of a program, bytes of each; assumed
#: a text that has one of these somewhere may jump
MAY_JUMP = re.compile(
    r"M[ \t]*0*9[789](?![0-9])|G[ \t]*65(?![0-9])|GOTO|WHILE|(?<![A-Z])IF[ \t]*\["
    r"|^[ \t/]*(?:N[ \t0-9]+)?(?:L[ \t]*[0-9]|O[ \t]*(?:[<\[#]|[0-9]+[ \t]*[A-Z]))",
    re.M,
)
WORDS = "SUB|ENDSUB|RETURN|CALL|ELSEIF|IF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE"
CONTROL = re.compile(
    rf"/*(?:N[0-9.]+)?/*(?:O(?P<label>[0-9]+|<[^>]*>|\[.*?\]|\#.*?)(?P<word>{WORDS})(?P<rest>[\[\#0-9.+-].*)?"
    r"|(?P<fanuc>IF(?=\[)|WHILE(?=\[)|GOTO(?=[0-9\[\#])|END(?=[0-9]+\Z))(?P<condition>.*))"
)
NUMBER = re.compile(r"N[ \t]*0*([0-9]+)(?![0-9.])", re.I)
#: a comment; the words before a bracket are not the name of a cycle here
REMARK = re.compile(r"\([^)]*\)|;.*")
CHANGE = re.compile(r"[Mm](?<![A-Za-z].)0*6(?![0-9.])")
MISSING = "the sub-program {} is not in this file, and no file of this name that has it is beside it"
ENDS = {"ENDSUB": "SUB", "ENDIF": "IF", "ENDWHILE": "WHILE", "ENDREPEAT": "REPEAT", "END": "WHILE"}
#: letters of G65 -> numbers of the parameters (Fanuc, argument specification I)
ARGUMENTS = dict(zip("ABCIJKDEFHQRSTUVWXYZ", (*range(1, 10), 11, *range(17, 27)), strict=True))


class _Line(NamedTuple):
    """A line that jumps."""

    label: str
    word: str
    rest: str  #: condition, arguments


class _Call(NamedTuple):
    """A sub-program that runs."""

    back: int  #: index of the line after the call
    start: int  #: its first line
    repeats: int  #: how often it is still to run after this time
    scoped: bool  #: it has its own parameters


class _Stop(Exception):
    """The place where the program continues is not known."""


def has_flow(text: str) -> bool:
    """Return whether a program in upper case may jump."""
    return MAY_JUMP.search(text) is not None


class Flow:
    """Runs the lines of a program in the order that its jumps give."""

    def __init__(self, machine: Interpreter, variables: Variables, run_line: Callable[[str], None], lines: list[str]):
        self.machine = machine
        self.variables = variables
        self.run_line = run_line
        self.called = False  #: a sub-program was run
        self.jumped = False  #: a line was not run in the order of the file
        self.lines = list(lines)  #: of the program and, each after an empty line, of the files that it calls
        self.files: list[tuple[int, Path]] = [(0, Path(machine.program.source))]  #: with their first lines
        self.ends: set[int] = set()  #: the empty lines
        self.part = 0  #: file of the line that runs
        self.controls: dict[int, _Line] = {}
        self.programs: dict[str, int] = {}  #: name of a sub-program -> index of its line
        self.heads: set[int] = set()  #: lines after the numbers of programs
        self.numbers: dict[tuple[int, int], list[int]] = {}  #: file, N -> indices of its lines
        self.pairs: dict[int, int] = {}  #: line -> the line that ends its construct, or begins it for an end
        self.branches: dict[int, int] = {}  #: if, elseif -> the next branch
        self.loops: dict[int, int] = {}  #: break, continue -> the line that begins their loop
        self.calls: list[_Call] = []
        self.counters: dict[tuple[int, int], int] = {}
        self.furthest = 0  #: index after the last line that ran
        self.faults: list[tuple[int, str]] = []
        self._take(self._scan(self.programs))

    # --- the table of jumps ---

    def _take(self, calls: set[str]) -> None:
        """Take the sub-programs that are called, and those that they call, from their files."""
        tried = set(self.programs)
        while new := calls - tried:
            name = min(new)
            tried.add(name)
            calls |= self._load(name)

    def _load(self, name: str) -> set[str]:
        """Take a sub-program that the program has not from its file, and return those that it calls; raises InputError.

        A file outside of the folder of the program is not read, whatever a link says.
        """
        main, paths = self.files[0][1], self._beside.get(name.removeprefix("SUB ").strip("<>"), [])
        paths = [path for path in paths if path.is_file() and path.resolve().is_relative_to(main.parent.resolve())]
        if not paths:
            return set()
        if len(paths) > 1:
            raise InputError(main, f"{paths[0].name} and {paths[1].name} are the same sub-program; remove one")
        path = paths[0]
        if len(self.files) > MOST_FILES:
            raise InputError(main, f"calls sub-programs of more than {MOST_FILES} files")
        if path.stat().st_size > MOST_BYTES:
            raise InputError(path, f"has more than {MOST_BYTES} bytes, too many for a sub-program")
        self.ends.add(len(self.lines))
        self.files.append((len(self.lines) + 1, path))
        lines = read_lines(path)
        self.lines += ["", *lines]
        self.machine.program.files.append(path)
        self.machine.changes |= any(CHANGE.search(REMARK.sub("", line)) for line in lines)
        names: dict[str, int] = {}
        calls = self._scan(names)
        if not names and not name.startswith("SUB "):  # without its number
            first = self.files[-1][0]
            names[name] = first + (self.lines[first].lstrip()[:1] == "%")
        if name in names:  # the file has no other one
            self.programs[name] = names[name]
        return calls

    @cached_property
    def _beside(self) -> dict[str, list[Path]]:
        """Return the files of sub-programs by the name or number that calls them: 7 for O0007.nc, L100, POCKET."""
        # of files with a sub-program, from the folder of the program; those of the first folder with such a file count
        folders = (".", "subroutines", "subs")
        main = self.files[0][1]
        files: dict[str, list[Path]] = {}
        for folder in folders[::-1]:
            names: dict[str, list[Path]] = {}
            with contextlib.suppress(OSError):  # no such folder
                for path in sorted((main.parent / folder).iterdir()):
                    name = "".join(path.stem.split()).upper()
                    if numbered := re.fullmatch(r"(?:O|(L))?0*([0-9]+)", name):
                        name = (numbered[1] or "") + numbered[2]
                    if path.suffix.lower() in ("", *ENDINGS) and path.name != main.name:
                        names.setdefault(name, []).append(path)
            files |= names
        return files

    def _scan(self, names: dict[str, int]) -> set[str]:
        """Note the jumps of the last file, and its sub-programs in ``names``; return the names that it calls."""
        opened: list[tuple[int, str, str]] = []
        calls: set[str] = set()
        part = len(self.files) - 1
        for index in range(self.files[-1][0], len(self.lines)):
            text = "".join(REMARK.sub("", self.lines[index]).split()).upper()
            if match := NUMBER.match(text.lstrip("/")):
                self.numbers.setdefault((part, int(match[1])), []).append(index)
            if match := re.fullmatch(r"[O:]0*([0-9]+)", text):
                names.setdefault(match[1], index + 1)
                if not part:
                    self.heads.add(index + 1)
            elif match := re.match(r"(?:%_N_|PROC)(L[0-9]+)", text, re.I):
                names[match[1].upper()] = index + 1  # PROC follows %_N_
            elif match := CONTROL.fullmatch(text):
                control = _Line(_label(match["label"] or ""), match["word"] or match["fanuc"], match["rest"] or "")
                if match["fanuc"]:
                    control = self._fanuc(match["fanuc"], match["condition"])
                self.controls[index] = control
                self._pair(index, control, opened, names)
                calls |= {f"SUB {control.label}"} if control.word == "CALL" else set()
            # calls of a number
            if "P" in text and (match := re.match(r"(?=.*(?:M0*98|G65)(?![0-9])).*?P0*([0-9]+)(?![0-9.])", text)):
                calls |= {match[1], f"{int(match[1]) % 10_000}"}  # P30012 is three times O12
            elif "L" in text and (match := re.fullmatch(r"/*(?:N[0-9]+)?L0*([0-9]+)(?:P[0-9]+)?", text)):
                calls.add(f"L{match[1]}")
        self.faults += [(index, f"{word} of {label or 'its loop'} has no end") for index, label, word in opened]
        return calls

    def _fanuc(self, word: str, rest: str) -> _Line:
        """WHILE [...] DO1, END1; IF [...] GOTO 10, IF [...] THEN #1=5; GOTO 10."""
        if word == "WHILE":
            condition, _, label = rest.rpartition("DO")
            return _Line(f"DO{label}", "WHILE", condition)
        return _Line(f"DO{rest}", "END", "") if word == "END" else _Line("", f"F{word}", rest)

    def _pair(self, index: int, line: _Line, opened: list, names: dict[str, int]) -> None:
        label, word, _ = line
        if word in ("SUB", "IF", "DO", "REPEAT") or (word == "WHILE" and (label, "DO") != self._top(opened)):
            if word == "SUB" and any(kind == "SUB" for _, _, kind in opened):
                self.faults.append((index, f"O{label} is defined in another sub-program"))
            opened.append((index, label, word))
            if word == "SUB":
                names.setdefault(f"SUB {label}", index + 1)
        elif word in ("ELSEIF", "ELSE", "WHILE", *ENDS):
            if (label, ENDS.get(word, "DO" if word == "WHILE" else "IF")) != self._top(opened):
                self.faults.append((index, f"{word} of O{label} does not follow its beginning"))
                return
            begin = opened[-1][0]
            if word in ("ELSEIF", "ELSE", "ENDIF"):
                last = begin
                while last in self.branches:
                    last = self.branches[last]
                self.branches[last] = index
            if word in ("ELSEIF", "ELSE"):
                self.pairs[index] = begin
            else:
                self.pairs[begin], self.pairs[index] = index, begin
                opened.pop()
        elif word in ("BREAK", "CONTINUE"):
            loop = [begin for begin, other, kind in opened if other == label and kind in ("WHILE", "DO", "REPEAT")]
            if loop:
                self.loops[index] = loop[-1]
            else:
                self.faults.append((index, f"{word} of O{label} is in no loop of this label"))

    @staticmethod
    def _top(opened: list) -> tuple[str, str]:
        return opened[-1][1:] if opened else ("", "")

    # --- the run ---

    def run(self) -> None:
        """Run up to the end of the program, or to the first line after which its way is not known."""
        machine, program = self.machine, self.machine.program
        machine.calls = True
        if self.faults:
            for index, reason in self.faults:
                self._go(index)
                program.refuse("O", reason, MACROS, line=0 if self.part else index + 1)
            return
        index = executed = 0
        refused: set[int] = set()
        count = min(self.ends, default=len(self.lines))  # of the lines of the program
        while index != count and not machine.ended and not program.hopeless:
            if self.part or index >= count:
                self._go(index)
            if not self.part:
                program.line = index + 1
            refusals = program.refusals
            executed += 1
            try:
                if self.part and (index in self.ends or index == len(self.lines)):
                    raise _Stop("the sub-program does not end; end it with M99, or with endsub")
                if executed > MOST_BLOCKS:
                    raise _Stop(f"the program runs more than {MOST_BLOCKS} lines; does a loop end?")
                following = self._step(index)
            except (_Stop, ExpressionError) as fault:
                line = self.lines[index] if index < len(self.lines) else ""
                program.refuse(short(line.strip()), str(fault), MACROS, lost=True)
                program.words["refused"] += 1
                break
            if index < count:
                self.furthest = max(self.furthest, index + 1)
            if program.refusals > refusals:
                if index in refused:
                    break
                refused.add(index)
            index = following
        program.go_to("")

    def _go(self, index: int) -> None:
        """Note the file of a line; a line of another file than the program is named after the line that calls it."""
        program = self.machine.program
        self.part = sum(first <= index for first, _ in self.files) - 1
        first, path = self.files[self.part]
        program.go_to(f"{path.name}, line {index - first + 1}" if self.part else "")

    def _step(self, index: int) -> int:
        """Run a line and return the index of the next one."""
        machine = self.machine
        if index in self.controls:
            program = machine.program
            program.words["used"] += 1
            if self.lines[index].lstrip("Nn.0123456789 \t").startswith("/"):
                program.silent["/"] += 1
                program.skippable[program.place, program.line] = None
            self.jumped = True
            return self._control(index, self.controls[index])
        title = not self.called and not (self.jumped and len(self.machine.program))  # of the main program
        if index + 1 in self.heads and (self.calls or index + 1 != min(self.heads) or not title):
            raise _Stop("the program runs into a sub-program; end it with M30, and the sub-program with M99")
        self.run_line(self.lines[index])
        if machine.call is not None:
            self.jumped = True
            (kind, number, repeats, arguments), machine.call = machine.call, None
            return self._called(kind, number, repeats, arguments, index + 1)
        if machine.ended and self.calls and machine.end_word in (99, 17):
            machine.ended = False
            return self._leave()
        return index + 1

    def _value(self, text: str) -> float:
        scanner = Scanner(text, self.variables)
        value = scanner.value()
        if not scanner.ended:
            raise ExpressionError(f"{short(text[scanner.place :])!r} follows the value")
        return value

    def _control(self, index: int, line: _Line) -> int:
        label, word, rest = line
        if word[0] == "F":
            return self._jump(index, word, rest)
        if word in ("SUB", "ELSEIF", "ELSE"):  # a definition; the end of the branch that ran
            return self.pairs[index if word == "SUB" else self.pairs[index]] + 1
        if word in ("ENDSUB", "RETURN"):
            return self._return(rest)
        if word == "CALL":
            return self._call_of(label, rest, index + 1)
        if word == "IF":
            return self._branch(index)
        if word in ("BREAK", "CONTINUE"):
            begin = self.loops[index]
            self.counters.pop((len(self.calls), begin), None) if word == "BREAK" else None
            end = self.pairs[begin]
            return end + 1 if word == "BREAK" else end
        if word == "WHILE" and self.pairs[index] < index:  # of a do loop
            return self.pairs[index] + 1 if self._value(rest) else index + 1
        if word == "WHILE":
            return index + 1 if self._value(rest) else self.pairs[index] + 1
        if word == "REPEAT":
            return self._repeat(index, round(self._value(rest)))
        if word == "ENDREPEAT":
            begin = self.pairs[index]
            return self._repeat(begin, self.counters.pop((len(self.calls), begin)))
        return self.pairs[index] if word in ("ENDWHILE", "END") else index + 1  # DO, ENDIF

    def _branch(self, index: int) -> int:
        """Return the line after the first branch of an if whose condition holds."""
        while self.controls[index].word in ("IF", "ELSEIF"):
            if self._value(self.controls[index].rest):
                return index + 1
            index = self.branches[index]
        return index + 1

    def _repeat(self, begin: int, count: int) -> int:
        if count <= 0:
            return self.pairs[begin] + 1
        self.counters[len(self.calls), begin] = count - 1
        return begin + 1

    def _jump(self, index: int, word: str, rest: str) -> int:
        """IF [...] GOTO 10, IF [...] THEN ..., GOTO 10."""
        scanner = Scanner(rest, self.variables)
        if word == "FIF":
            holds = scanner.value()
            if scanner.take("THEN"):
                if holds:
                    self.run_line(rest[scanner.place :])
                return index + 1
            if not scanner.take("GOTO"):
                raise ExpressionError("IF [...] takes GOTO or THEN")
            if not holds:
                return index + 1
        number = scanner.value()
        return self._numbered(number) if scanner.ended else self._numbered(-1)

    def _numbered(self, number: float) -> int:
        places = self.numbers.get((self.part, int(number)), [])
        if len(places) != 1 or number != int(number):
            raise _Stop(f"{len(places)} lines have the number N{number:g}")
        return places[0]

    # --- sub-programs ---

    def _called(self, kind: str, number: float, repeats: float, arguments: dict, back: int) -> int:
        """M98 P, M97 P, G65 P, L of Sinumerik."""
        if repeats != int(repeats) or not 0 <= repeats <= 9999:
            raise _Stop(f"a sub-program does not run {repeats:g} times")
        if kind == "M97":
            return self._enter(self._numbered(number), back, int(repeats), None)
        name = f"L{number:g}" if kind == "L" else f"{number:g}"
        if kind == "M98" and number >= 10_000 and repeats == 1 and self._start(name) is None:  # P30012: 3 times O12
            repeats, name = number // 10_000, f"{number % 10_000:g}"
        start = self._start(name)
        if start is None:
            raise _Stop(MISSING.format(name if kind == "L" else "O" + name))
        scope = None
        if kind == "G65":
            scope = 33, {ARGUMENTS[letter]: value for letter, value in arguments.items()}
        return self._enter(start, back, int(repeats), scope)

    def _start(self, name: str) -> int | None:
        """Return the first line of a sub-program; the file of a computed name is read now."""
        if name not in self.programs:
            self._take({name})
        if self.faults:
            raise _Stop(self.faults[0][1])
        return self.programs.get(name)

    def _call_of(self, label: str, rest: str, back: int) -> int:
        if label[:1] in ("#", "["):
            label = f"{round(self._value(label))}"
        scanner = Scanner(rest, self.variables)
        arguments: list[float] = []
        while not scanner.ended:
            arguments.append(scanner.value())
        start = self._start(f"SUB {label}")
        if start is None:
            raise _Stop(MISSING.format("O" + label.lower()))
        if len(arguments) > 30:
            raise _Stop("a sub-program takes 30 values at most")
        values: dict[int | str, float] = dict(enumerate([*arguments, *[0.0] * (30 - len(arguments))], 1))
        return self._enter(start, back, 1, (30, values))

    def _enter(self, start: int, back: int, repeats: int, scope: tuple[int, dict] | None) -> int:
        if not repeats:
            return back
        if len(self.calls) >= DEEPEST:
            raise _Stop(f"more than {DEEPEST} sub-programs call one another")
        self.calls.append(_Call(back, start, repeats - 1, scope is not None))
        self.machine.modes.append(None)
        self.called = True
        if scope:
            self.variables.scopes.append(scope)
        return start

    def _return(self, rest: str) -> int:
        if not self.calls:
            raise _Stop("RETURN or ENDSUB is in no sub-program that runs")
        value = self._value(rest) if rest else None
        values = self.variables.values
        values["_VALUE_RETURNED"] = float(value is not None)
        values["_VALUE"] = value or 0.0
        return self._leave()

    def _leave(self) -> int:
        """Return from a sub-program, or run it once more."""
        call, modes = self.calls.pop(), self.machine.modes.pop()
        if modes and modes["at_end"]:
            self.machine.restore(modes)
        self.counters = {key: count for key, count in self.counters.items() if key[0] <= len(self.calls)}
        if call.repeats:
            self.calls.append(call._replace(repeats=call.repeats - 1))
            self.machine.modes.append(None)
            return call.start
        if call.scoped:
            self.variables.scopes.pop()
        return call.back


def _label(text: str) -> str:
    """Return the label of an O word: a number without zeros before it, a name, or what computes a number."""
    return f"{int(text)}" if text.isdigit() else text
