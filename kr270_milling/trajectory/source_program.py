"""What a CAM program says beside its path, and what of it cannot be run: records for all readers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from kr270_milling.base.errors import InputError

__all__ = ["ProgramError", "ProgramTool", "ReadOver", "Refusal", "SourceProgram"]

MOST_KINDS = 8  #: kinds of refused words that one sentence lists; the error carries all of them
MOST_LINES = 40  #: kinds that a terminal lists


@dataclass(frozen=True)
class ReadOver:
    """A word that does not move the tool, and how often it stands in the program."""

    word: str
    count: int


@dataclass(frozen=True)
class Refusal:
    """A word that cannot be run."""

    line: int  #: from 1
    word: str
    reason: str  #: what is wrong; "" where the advice says it
    advice: str  #: what to do; "" where the reason says it

    @property
    def sentence(self) -> str:
        text = "; ".join(part for part in (self.reason, self.advice) if part)
        return text if self.reason else f"{self.word}: {text}"


@dataclass(frozen=True)
class ProgramTool:
    """A tool of the program, as far as its words and comments describe it."""

    name: str  #: as ``path.tool`` selects it, "T1"
    description: str = ""  #: what its comment calls it
    diameter: float = 0.0  #: [m], 0: the program does not say
    teeth: int = 0  #: 0: the program does not say
    line: int = 0  #: of its first tool change
    cuts: int = 0  #: cutting blocks that it makes

    @property
    def label(self) -> str:
        """T1 (flat end mill, 10 mm)."""
        known = [self.description] if self.description else []
        known += [f"{1e3 * self.diameter:g} mm"] if self.diameter else []
        return f"{self.name} ({', '.join(known)})" if known else self.name

    def completed(self, other: ProgramTool) -> ProgramTool:
        """With what another description of the tool says where this one says nothing."""
        words = self.description or other.description
        return ProgramTool(self.name, words, self.diameter or other.diameter, self.teeth or other.teeth)


@dataclass(frozen=True)
class SourceProgram:
    """What the file of a path says beside the moves; empty for a path without a program."""

    title: str = ""
    tool: str = ""  #: the tool whose moves the path holds, "" where the program names none
    tools: tuple[ProgramTool, ...] = ()  #: all that the program changes to
    spindle_speeds: tuple[float, ...] = ()  #: [rad/s], of the cutting moves, negative counterclockwise; 0 is left out
    feeds: tuple[float, ...] = ()  #: [m/s], of the cutting moves
    work_offset: str = ""  #: the one that the path is counted from, "G54"
    operations: tuple[str, ...] = ()  #: names of the features with cutting moves
    read_over: tuple[ReadOver, ...] = ()
    refused: tuple[Refusal, ...] = ()

    @property
    def summary(self) -> str:
        """One line about what was read over, "" if nothing was."""
        words = ", ".join(f"{r.count} {r.word}" for r in self.read_over)
        return f"read over: {words}" if words else ""

    @property
    def current(self) -> ProgramTool | None:
        """The tool whose moves the path holds."""
        return next((tool for tool in self.tools if tool.name == self.tool), None)


class ProgramError(InputError):
    """A program with words that cannot be run: all of them, each with its line and advice."""

    def __init__(self, source, program: SourceProgram):
        self.program = program
        kinds = _kinds(program.refused)
        lines = [f"{source}, line {line}: {text}" for line, text in kinds]
        self.listing = tuple(_first(lines, MOST_LINES, f"{source}: "))  #: one text for each kind, for a terminal
        texts = [kinds[0][1], *(f"line {line}: {text}" for line, text in kinds[1:])]
        super().__init__(source, " | ".join(_first(texts, MOST_KINDS)), program.refused[0].line)


def _first(texts: list[str], most: int, before: str = "") -> list[str]:
    """So many of the texts, and how many more there are."""
    return texts[:most] + [f"{before}and {len(texts) - most} other kinds of words"] * (len(texts) > most)


def _kinds(refused: Iterable[Refusal]) -> list[tuple[int, str]]:
    """First line and sentence of each kind of refused words; like ones are counted."""
    kinds: dict[tuple[str, str], list[Refusal]] = {}
    for refusal in refused:
        kinds.setdefault((refusal.reason, refusal.advice), []).append(refusal)
    return [(like[0].line, like[0].sentence + _more(like)) for like in kinds.values()]


def _more(like: list[Refusal]) -> str:
    if len(like) == 1:
        return ""
    shown = ", ".join(str(refusal.line) for refusal in like[1:4])
    return f" (also line {shown}{f' and {len(like) - 4} more' if len(like) > 4 else ''})"
