"""APT source and CL text in: one statement after the other.

GOTO, GODLTA, FROM, CIRCLE before its GOTO, about an axis along z in the sense of Creo or of NX, RAPID, FEDRAT, SPINDL,
UNITS, tools, FINI. Words that move nothing are counted; those that cannot be run are listed all at once. Without UNITS/
the unit is mm. A comment, PPRINT or TOOL PATH names the feature that follows. A tool axis i, j, k points from the tip
to the spindle; the tool turns about no more than it must.
"""

from __future__ import annotations

import re

from kr270_milling.base.text import read_lines, short, unended
from kr270_milling.trajectory.apt_machine import ADVICE, SILENT, Machine
from kr270_milling.trajectory.comments import operation_name
from kr270_milling.trajectory.source_program import ProgramError, ProgramTool, SourceProgram
from kr270_milling.trajectory.summary import Observed, Refusals, source_program
from kr270_milling.trajectory.toolpath import PathBuilder, Toolpath

__all__ = ["read_apt"]

WORD = re.compile(r"[A-Z][A-Z0-9 _-]*")


def read_apt(path, tool: str = "", feed: float = 0.0) -> Toolpath:
    """Read an APT source or CL text file; tool: "T1" where several cut; feed [m/s]: for a program without FEDRAT/."""
    reader = _Reader(path, tool, feed)
    program = reader.read()
    if program.refused:
        raise ProgramError(path, program)
    return reader.path.build(reader.lines, program)


class _Reader:
    """Lines to statements, statements to the machine."""

    def __init__(self, source, tool: str, feed: float):
        self.text = read_lines(source)
        self.lines = len(self.text)
        self.path = PathBuilder(source)
        self.refusals = Refusals()
        self.seen = Observed(tool if not tool.isdigit() else f"T{int(tool)}")
        self.machine = Machine(self.path, self.refusals, self.seen, feed)

    def read(self) -> SourceProgram:
        held, first, number = "", 0, 0
        body = self.text if self.text[-1].strip() else self.text[:-1]
        for number, line in enumerate(body, 1):
            code, comment, note = line.partition("$$")
            code, continued, _ = code.partition("$")  # what follows the sign is a remark
            if comment and not (code.strip() or continued):
                self._name(note.strip())
            first = first if held else number
            held += code.strip()
            if continued:
                continue
            if held:
                self._statement(held, first)
            held = ""
            if self.machine.ended or self.refusals.full:
                break
        else:
            self._check_end(held, len(body))
        self.machine.finish()
        return source_program(self.seen, self.path, self.refusals, max(number, 1))

    def _check_end(self, held: str, last: int) -> None:
        if held:
            self.refusals.add(last, "$", "the file ends in a statement that is continued with $")
        elif reason := unended(self.text):
            self.refusals.add(self.lines, "", reason)

    def _name(self, text: str) -> None:
        name, _ = operation_name(text)
        if name:
            self.path.name_feature(name)

    def _statement(self, statement: str, number: int) -> None:
        head, slash, tail = statement.partition("/")
        word = " ".join(head.split()).upper()
        values = [value.strip().upper() for value in tail.split(",")] if slash else []
        first = word.split(" ")[0]
        if word in self.machine.actions:
            self.machine.run(word, values, number)
        elif first in ("PPRINT", "PARTNO"):
            self._text(first, (tail or head.strip()[6:]).strip())
        elif word == "TOOL PATH":
            self._tool_path(tail, number)
        elif first in SILENT:
            self.seen.silent[first] += 1
        elif advice := ADVICE.get(first):
            self.refusals.add(number, first, advice=advice, lost=True)
        elif WORD.fullmatch(word):
            self.refusals.add(number, word, f"{short(word)} is not supported", ADVICE[""], lost=True)
        else:
            self.refusals.add(number, short(statement), f"{short(statement)!r} is no APT statement", lost=True)

    def _text(self, word: str, text: str) -> None:
        self.seen.silent[word] += 1
        if word == "PARTNO" and not self.seen.title:
            self.seen.title = text
        elif word == "PPRINT":
            self._name(text)
            self.seen.comments.append((text, self.machine.tool))

    def _tool_path(self, tail: str, number: int) -> None:
        """TOOL PATH/operation,TOOL,name of NX."""
        operation, _, rest = tail.partition(",")
        self.path.name_feature(operation.strip() or "tool path")
        name = rest.partition(",")[2].strip()
        if name and not self.machine.numbered:
            self.machine.change_tool(name, number)
            self.seen.known.setdefault(name, ProgramTool(name))
