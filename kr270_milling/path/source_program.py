"""Records for all readers: what a CAM program states in addition to its path, and the words that cannot be run."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from kr270_milling.base.errors import InputError


@dataclass(frozen=True)
class Refusal:
    """A word that cannot be run."""

    line: int  #: from 1
    word: str
    reason: str  #: fault; "" where the advice states it
    advice: str  #: remedy; "" where the reason states it

    @property
    def sentence(self) -> str:
        text = "; ".join(part for part in (self.reason, self.advice) if part)
        return text if self.reason else f"{self.word}: {text}"


@dataclass(frozen=True)
class ProgramTool:
    """A tool of the program, as far as its words and comments describe it."""

    name: str  #: as ``path.tool`` selects it, "T1"; "T1_2" for a second run of T1
    description: str = ""  #: name in its comment
    diameter: float = 0.0  #: [m], 0: the program does not say
    teeth: int = 0  #: 0: the program does not say
    line: int = 0  #: line of its tool change, or where a further run begins
    cuts: int = 0  #: cutting blocks that it makes
    changed_as: str = ""  #: name of the tool in the program: that of the first run
    corner_radius: float = 0.0  #: [m], 0: sharp corners, or the program does not say
    kind: str = ""  #: kind of a tool that is no flat end mill; "": a flat one, or the program does not say
    inserts: bool = False  #: its comment names inserts, or a kind of mill that has inserts
    wear: bool = False  #: its comment states that the path is that of the centre, and G41 and G42 add the wear alone
    length_offset: bool = False  #: the program switches on a length for this tool (G43)

    @property
    def first(self) -> bool:
        """Return whether this is the first run of the tool."""
        return self.name == self.changed_as

    @property
    def label(self) -> str:
        """T1 (flat end mill, 10 mm); without a name "the tool (...)"."""
        known = [self.description] if self.description else []
        known += [f"{1e3 * self.diameter:g} mm"] if self.diameter else []
        return f"{self.name or 'the tool'} ({', '.join(known)})" if known else self.name

    @property
    def shape(self) -> str:
        """Return the kind of a tool that is no flat end mill, by its name or its corner; "" for all other tools."""
        if self.kind or not self.corner_radius:
            return self.kind
        return "ball-end mill" if self.corner_radius > 0.49 * self.diameter > 0.0 else "bull-nose mill"

    def end(self, radius: float) -> dict:
        """Return the keys of ``tool`` for an end that is not flat and is stated in full; radius [m]: of the tool."""
        corner, digits = self.corner_radius, 0.01 * radius  # digits of a comment
        if self.shape == "ball-end mill" and (corner == 0.0 or abs(corner - radius) < digits):
            return {"type": "ball"}
        if self.shape == "bull-nose mill" and 0.0 < corner < radius - digits:
            return {"type": "bull_nose", "corner_radius": corner}
        return {}

    def completed(self, other: ProgramTool) -> ProgramTool:
        """Return this description, with missing values taken from another description of the same tool."""
        names = "description", "kind", "diameter", "teeth", "corner_radius", "inserts", "wear"
        return dataclasses.replace(self, **{name: getattr(self, name) or getattr(other, name) for name in names})


@dataclass(frozen=True)
class SourceProgram:
    """Statements of a program in addition to its moves; empty for a path without a program."""

    title: str = ""
    tool: str = ""  #: the tool that runs the moves of the path; "" if the program names no tool
    tools: tuple[ProgramTool, ...] = ()  #: all tools of the program
    spindle_speeds: tuple[float, ...] = ()  #: [rad/s], of the cutting moves, negative counterclockwise; 0 is left out
    feeds: tuple[float, ...] = ()  #: [m/s], of the cutting moves
    feed_units: tuple[str, ...] = ()  #: unit of the F words, such as "mm a minute"
    external: tuple[float, ...] = (0.0,) * 6  #: external axes E1 to E6 during the cuts, of a KRL program
    tool_frame: tuple[float, ...] = ()  #: $TOOL of a KRL program, X, Y, Z [mm], A, B, C [deg]; empty: none by numbers
    base_frame: tuple[float, ...] = ()  #: $BASE
    rounding: float = 0.0  #: P of G64 [m], by which the control may leave a corner; 0: the program states none
    stock: tuple[float, ...] = ()  #: x, y, z of the lower and of the upper corner of the blank [m]; empty: not stated
    beside: float = 0.0  #: radius in the comment on the tool, by which G41 and G42 move the path [m]; 0: they do not
    work_offset: str = ""  #: the origin of the coordinates, such as "G54"
    files: tuple[str, ...] = ()  #: further files that were read: sub-programs, data of a KRL program
    places: tuple[str, ...] = ("",)  #: lines of these files that were run, such as "O7.nc, line 3"; "": of the program
    operations: tuple[str, ...] = ()  #: names of the features with cutting moves
    read_over: tuple[tuple[str, int], ...] = ()  #: words without effect on the path, and how often there are
    #: words that another control may run in another way: kind of the finding, sentence, line
    doubtful: tuple[tuple[str, str, int], ...] = ()
    #: moves home along X or Y by a tool that was not taken up before: their axes, height [m] where they begin, line
    sideways: tuple[tuple[str, float, int], ...] = ()
    refused: tuple[Refusal, ...] = ()

    @property
    def summary(self) -> str:
        """Return one line about the ignored words, "" if there are none."""
        words = ", ".join(f"{count} {word}" for word, count in self.read_over)
        return f"read over: {words}" if words else ""

    @property
    def current(self) -> ProgramTool | None:
        """Return the tool that runs the moves of the path."""
        return next((tool for tool in self.tools if tool.name == self.tool), None)


class ProgramError(InputError):
    """A program with words that cannot be run; lists all of these words with line and advice."""

    def __init__(self, source, program: SourceProgram):
        self.program = program
        kinds: dict[tuple[str, str], list[Refusal]] = {}
        for refusal in program.refused:
            kinds.setdefault((refusal.reason, refusal.advice), []).append(refusal)
        texts = [(like[0].line, like[0].sentence + _lines_of(like[1:])) for like in kinds.values()]
        most_kinds = 8  # kinds of refused words that one sentence lists; the error carries all of them
        most_lines = 40  # kinds that a terminal lists
        more = len(texts) - most_lines, len(texts) - most_kinds
        #: one text for each kind, for a terminal
        self.listing = tuple(f"{source}, line {line}: {text}" for line, text in texts[:most_lines])
        self.listing += (f"{source}: and {more[0]} other kinds of words",) * (more[0] > 0)
        sentence = " | ".join([texts[0][1], *(f"line {line}: {text}" for line, text in texts[1:most_kinds])])
        sentence += f" | and {more[1]} other kinds of words" * (more[1] > 0)
        super().__init__(source, sentence, program.refused[0].line)


def _lines_of(others: list[Refusal]) -> str:
    """Return the lines of the other words of the same kind, as text."""
    if not others:
        return ""
    lines = ", ".join(str(refusal.line) for refusal in others[:3])
    return f" (also line {lines}{f' and {len(others) - 3} more' if len(others) > 3 else ''})"
