"""What a program says beside its moves, and what of it cannot be run: collected until its end, then put together."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from kr270_milling.base.errors import one_line
from kr270_milling.base.text import short
from kr270_milling.trajectory.comments import described_tool
from kr270_milling.trajectory.source_program import ProgramTool, ReadOver, Refusal, SourceProgram
from kr270_milling.trajectory.toolpath import PathBuilder

__all__ = ["Observed", "Refusals", "source_program"]

SAME_SPEED = 0.1  #: [rad/s], 1 rpm: spindle speeds that differ by less are one


@dataclass
class Observed:
    """What a reader notes on its way through a program."""

    selected: str  #: the tool whose moves are wanted, "" for all
    title: str = ""
    unit: float = 1e-3  #: [m], of lengths in comments
    tools: dict[str, int] = field(default_factory=dict)  #: name -> line of its first change
    known: dict[str, ProgramTool] = field(default_factory=dict)  #: what words, not comments, say of tools
    comments: list[tuple[str, str]] = field(default_factory=list)  #: with the tool of their line
    cuts: Counter = field(default_factory=Counter)  #: tool -> cutting blocks
    offset: str = ""
    offsets: dict[tuple[str, str], int] = field(default_factory=dict)  #: (tool, offset) while cutting -> first line
    silent: Counter = field(default_factory=Counter)  #: words that move nothing


def source_program(seen: Observed, path: PathBuilder, refusals: Refusals, last: int) -> SourceProgram:
    """The record of a program that a reader has been through up to the line ``last``."""
    tools = _tools(seen)
    cutting = [tool for tool in tools if tool.cuts]
    chosen = seen.selected or (cutting[0].name if cutting else "")
    speeds = path.cutting_speeds()
    offsets = {name: line for (tool, name), line in seen.offsets.items() if tool == chosen or not seen.selected}
    refused = list(refusals.of(seen.selected))
    refused += _selection(seen.selected, tools, last)
    if not refused or len(cutting) < 2:
        refused += _speeds(speeds) + _offsets(offsets)
    return SourceProgram(
        title=seen.title,
        tool=chosen,
        tools=tools,
        spindle_speeds=tuple(speed for speed in speeds if speed),
        feeds=path.cutting_feeds(),
        work_offset=next(filter(None, offsets), seen.offset),
        operations=path.cut_features(),
        read_over=tuple(ReadOver(word, count) for word, count in seen.silent.most_common()),
        refused=tuple(sorted(refused, key=lambda refusal: refusal.line)),
    )


def _tools(seen: Observed) -> tuple[ProgramTool, ...]:
    """Every tool that the program changes to, with what its comments say; "" for cuts before the first one."""
    names, cuts = dict(seen.tools), seen.cuts
    if cuts[""]:
        names = {"": 1} | names
    said = dict(seen.known)
    only = next(iter(names)) if len(names) == 1 else None
    for comment, changed in seen.comments:
        tool = described_tool(comment, seen.unit, changed or only)
        if tool is not None:
            said[tool.name] = _merged(said.get(tool.name, ProgramTool(tool.name)), tool)
    found = []
    for name, line in names.items():
        known = said.get(name, ProgramTool(name))
        found.append(ProgramTool(name, known.description, known.diameter, known.teeth, line, cuts[name]))
    return tuple(found)


def _merged(one: ProgramTool, other: ProgramTool) -> ProgramTool:
    return ProgramTool(
        one.name, one.description or other.description, one.diameter or other.diameter, one.teeth or other.teeth
    )


def _selection(selected: str, tools: tuple[ProgramTool, ...], last: int) -> list[Refusal]:
    cutting = [tool for tool in tools if tool.cuts]
    listing = ", ".join(f"{tool.label or 'the one before the first T'} from line {tool.line}" for tool in cutting)
    if selected and selected not in [tool.name for tool in cutting]:
        return [Refusal(last, selected, f"the program does not cut with {selected}; it does with {listing}", "")]
    if selected or len(cutting) < 2:
        return []
    advice = f"choose one with path.tool (init: --tool), for example {cutting[0].name or cutting[1].name}"
    reason = f"the program cuts with {len(cutting)} tools: {listing}"
    return [Refusal(cutting[1].line, cutting[1].name, reason, advice)]


def _speeds(speeds: dict[float, int]) -> list[Refusal]:
    distinct: list[tuple[float, int]] = []
    for speed, line in speeds.items():
        if speed and all(abs(speed - known) > SAME_SPEED for known, _ in distinct):
            distinct.append((speed, line))
    if len(distinct) < 2:
        return []
    shown = [f"S{abs(speed) * 30 / math.pi:.6g}{' M4' if speed < 0 else ''} (line {line})" for speed, line in distinct]
    reason = f"{len(distinct)} spindle speeds: {', '.join(shown[:6])}"
    return [Refusal(distinct[1][1], shown[1].split()[0], reason, "post one program for each")]


def _offsets(offsets: dict[str, int]) -> list[Refusal]:
    named = {name or "G54": line for name, line in offsets.items()}
    if len(named) < 2:
        return []
    shown = ", ".join(f"{name} (line {line})" for name, line in named.items())
    line = list(named.values())[1]
    return [Refusal(line, list(named)[1], f"{len(named)} work offsets: {shown}", "post one program for each")]


MOST = 10_000  #: refusals that are kept; a file with more is no program


class Refusals:
    """Collects what cannot be run, apart for each tool, so that one tool's part of a program can be run alone."""

    def __init__(self):
        self._found: list[tuple[str, Refusal]] = []
        self.tool = ""  #: in the spindle
        self.lost = False  #: a move was refused: where the tool stands is not known any more

    @property
    def full(self) -> bool:
        return len(self._found) >= MOST

    def add(self, line: int, word: str, reason: str = "", advice: str = "", lost: bool = False) -> None:
        """lost: the word may have moved the tool, so that what follows from its place is not refused once more."""
        self._found.append((self.tool, Refusal(line, one_line(short(word)), one_line(reason), advice)))
        self.lost = self.lost or lost

    def add_derived(self, line: int, word: str, reason: str, advice: str = "") -> None:
        """A refusal that may only follow from an earlier one."""
        if not self.lost:
            self.add(line, word, reason, advice)

    def of(self, tool: str) -> tuple[Refusal, ...]:
        """Those that concern the path of a tool, "" for all; words before the first tool concern every one."""
        found = [refusal for name, refusal in self._found if not tool or name in ("", tool)]
        return tuple(sorted(found, key=lambda refusal: refusal.line))
