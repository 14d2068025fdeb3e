"""A program under construction by its reader: the path of one tool, its statements, refused words; drilling cycles."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.column import counted
from kr270_milling.base.errors import InputError, one_line
from kr270_milling.base.files import short
from kr270_milling.path.cam.comments import ABOUT_TOOL, described_tool, kind_of
from kr270_milling.path.cam.contour import NEAR
from kr270_milling.path.source_program import ProgramError, ProgramTool, Refusal, SourceProgram
from kr270_milling.path.toolpath import TOP, PathBuilder, Toolpath, cut_features

ROUNDING = 1e-12  #: [m] of a place that a shift of the coordinates leads away from and back to


class ProgramBuilder(PathBuilder):
    """Collects the moves of one tool and, of all of them, what cannot be run.

    After a retract or a tool change the tool travels at the top height. A tool that cuts again after another one, or at
    another spindle speed after a rapid move, begins a further run: T1_2. Refusals are separate for each run, so that
    one run's part of a program can be run alone.
    """

    def __init__(self, source, selected: str):
        super().__init__(source)
        self.selected = selected  #: the run whose moves are wanted, "" for all
        self.active = True  #: True if the tool makes that run
        self.away = False  #: True if the tool was taken away since the last move
        self.named = False  #: True if a comment named the operation since the last cut
        self.moved = False  #: True if the tool moved since then: a comment that follows is inside the operation
        self.unknown: list[str] = []  #: axes whose place was not known at the last move without a place
        self.lost = False  #: a move was refused: the place of the tool is unknown
        self.places: dict[str, int] = {"": 0}  #: lines of further files that were run, "O7.nc, line 3"
        self.files: list[Path] = []  #: further files that were read
        self.title = ""
        self.tool = ""  #: in the spindle
        self.run = ""  #: of the tool: its name, from the second run on with the number
        self.frame = {"work offsets": "", "tool lengths": "", "tool edges": ""}  #: kind -> word that is active
        self.comments: list[tuple[str, str, bool]] = []  #: with the tool, and whether it is the tool of their line
        self.external: tuple[float, ...] = (0.0,) * 6  #: external axes E1 to E6 during the cuts
        self.rounding = 0.0  #: largest P of G64 [m]
        self.stock: tuple[float, ...] = ()  #: as in ``SourceProgram``
        self.displayed: dict[str, tuple[float, ...]] = {}  #: $TOOL and $BASE of the cuts, X, Y, Z [mm], A, B, C [deg]
        self.beside: dict[str, float] = {}  #: tool -> radius in its comment [m], by which G41 and G42 move the path
        self.length_offsets: set[str] = set()  #: tools with a length that the program switches on
        self.known: dict[str, ProgramTool] = {}  #: tools by the words of the program, not by its comments
        self.diameters: dict[str, tuple[float, float]] = {}  #: tools whose comments state two [m]
        self.feed_units: dict[str, None] = {}  #: units of the F words, in their order
        self.silent: Counter[str] = Counter()  #: words that move nothing
        self.doubtful: list[tuple[str, str, int]] = []  #: as in ``SourceProgram``
        self.sideways: list[tuple[str, float, int]] = []  #: as in ``SourceProgram``
        self.skippable: dict[tuple[int, int], None] = {}  #: lines with an effect that have the sign of block skip
        self._before_change = 0  #: number of comments up to the last move
        self.words = {"used": 0, "counted": 0, "refused": 0}  #: the numbers of words: all that were read
        self.refusals = 0  #: with those that follow from earlier ones
        self._runs: dict[str, tuple[str, int]] = {}  #: run -> tool, line of its begin
        self._before: tuple = (math.nan,)  #: end of the last move of a run that is not wanted
        self._rapid = False  #: the last move of any run was a rapid one
        self._cuts: Counter[str] = Counter()  #: run -> cutting blocks
        self._speeds: dict[str, float] = {}  #: run -> first spindle speed of its cuts [rad/s]
        self._frames: dict[tuple[str, ...], int] = {}  #: (run, its frame) while cutting -> first line
        self._key = ("", *self.frame.values())
        self._refused: list[tuple[str, Refusal]] = []  #: with the run

    # --- moves ---

    def rapid(self, end: tuple) -> None:
        """Go to a point; nothing is recorded until X, Y and Z are known."""
        (*_, height), before = self._before, self.active
        # the tool stays where it is
        if self._new_speed() and self.active > before and not self.away and math.isfinite(height):
            self.move(self._before, 0.0, True, self.line)
        self.moved = self._rapid = True
        self._before_change = len(self.comments)
        if not self.active or any(map(math.isnan, end)):
            self._before, self.away = end, self.away and self.active
            self.unknown = [axis for axis, value in zip("XYZ", end, strict=True) if math.isnan(value)]
            return
        if self.last is not None and (self.away or self.last[2] == TOP):
            turned, self.quaternion = self.quaternion, self._last_quaternion
            self.move((*self.last[:2], TOP), 0.0, True, self.line)
            self.quaternion = turned
            self.move((*end[:2], TOP), 0.0, True, self.line)
        self.away = False
        self.move(end, 0.0, True, self.line)

    def turn(self, quaternion: tuple[float, ...]) -> None:
        """Turn the tool: in place or, of a tool that was taken away, on its way to the next move."""
        if quaternion == self.quaternion:
            return
        self.quaternion = quaternion
        if self.active and self.last is not None and not self.away and self.last[2] != TOP:
            self.move(self.last, 0.0, True, self.line)

    def cut(self, start: tuple, ends: list, feed: float, curvature: float = 0.0, turned: Sequence = ()) -> None:
        """Feed through points, from a start that is known; turned: orientations at the points, empty: as before."""
        if self._rapid:
            self._new_speed()
        self.named = self._rapid = False
        self._before_change = len(self.comments)
        self._cuts[self.run] += 1
        if self.spindle_speed:
            self._speeds.setdefault(self.run, self.spindle_speed)
        self._frames.setdefault(self._key, self.line)
        if not self.active:
            self.quaternion, self._before = turned[-1] if turned else self.quaternion, ends[-1]
            return
        if self.away or (self.last != start and not (self.last and math.dist(self.last, start) < ROUNDING)):
            self.rapid(start)
        for end, quaternion in zip(ends, turned or [self.quaternion], strict=False):
            self.quaternion = quaternion
            self.move(end, feed, False, self.line, curvature)
        self.moves(ends[len(turned) or 1 :], itertools.repeat(self.line), feed, curvature)

    def cuts_from(self, place: list[float]) -> bool:
        """Return whether the tool whose moves are wanted cut up to a place."""
        return self.active and not self._rapid and not self.away and self.last == tuple(place)

    def cut_row(self, ends, lines, feed: float, blocks: int, curvature: np.ndarray | None = None) -> None:
        """Feed through points, each with its line, from the place of the tool, as ``cut`` does for as many blocks.

        Lists of straight blocks, or arrays with the curvatures where arcs are among them.
        """
        self.named = False
        self._before_change = len(self.comments)
        self._cuts[self.run] += blocks
        if self.spindle_speed:
            self._speeds.setdefault(self.run, self.spindle_speed)
        self.line = int(lines[-1])
        self._frames.setdefault(self._key, int(lines[0]))
        if curvature is None:
            self.moves(ends, lines, feed)
        else:
            self.append_row(ends, lines, feed, curvature)

    def change_tool(self, tool: str) -> None:
        """The tool of the moves that follow; they make a feature of its name where no comment names the operation.

        Comments since the last move are about this tool; before the first tool those that begin as comments on tools.
        """
        for k, (comment, _, beside) in enumerate(self.comments[self._before_change :], self._before_change):
            if not beside and (self.tool or ABOUT_TOOL.match(comment)):
                self.comments[k] = comment, tool, False
        self.away = self.away or bool(self.tool) or len(self) > 0
        self.tool = tool
        self.moved = False
        self._begin_run()
        if not self.named:
            self.name_feature(tool)

    def _new_speed(self) -> bool:
        """Begin a further run where the spindle has another speed than at the cuts of this one; return whether."""
        if not (self.tool and self.spindle_speed and _differ(self.spindle_speed, self._speeds.get(self.run))):
            return False
        self._begin_run()
        return True

    def _begin_run(self) -> None:
        """Begin a run of the tool: its first one, that which did not cut yet, or a further one."""
        runs = [run for run, (tool, _) in self._runs.items() if tool == self.tool]
        if not runs:
            self.run = self.tool
        elif self._cuts[runs[-1]]:
            self.run = f"{self.tool}_{len(runs) + 1}"
        else:
            self.run = runs[-1]
            self._runs.pop(self.run)
        if self._runs.get(self.run, (self.tool, 0))[0] != self.tool:
            self.refuse(self.run, f"{self.run} is the name of a tool and of a further run", "rename the tool")
        self._runs[self.run] = self.tool, self.line
        self._key = (self.run, *self.frame.values())
        self.active = self.selected in ("", self.run)

    def set_frame(self, kind: str, word: str) -> None:
        """Note a word that places the coordinates of the moves that follow, such as G55 or H1."""
        self.frame[kind] = word
        self._key = (self.run, *self.frame.values())

    def count(self, word: str, words: int = 1) -> None:
        """Count a word that moves nothing, with the words that belong to it."""
        self.silent[word] += 1
        self.words["counted"] += words

    def doubt(self, kind: str, sentence: str) -> None:
        """Note a word of the tool whose moves are wanted that another control may run in another way."""
        if self.active:
            self.doubtful.append((kind, self._elsewhere(sentence), self.line))

    def go_to(self, place: str) -> None:
        """Note the line of a further file that runs, such as "O7.nc, line 3"; "": the line is one of the source."""
        self.place = self.places.setdefault(place, len(self.places))

    def _elsewhere(self, sentence: str) -> str:
        """Return a sentence that begins with the line that runs, where this line is in another file."""
        return f"{list(self.places)[self.place]}: {sentence}" if self.place else sentence

    @property
    def cuts(self) -> int:
        """Return the number of cutting moves of all tools."""
        return self._cuts.total()

    @property
    def inside_operation(self) -> bool:
        """Return whether the operation has its name, and its tool moves to the first cut.

        A program without tools may be written by hand, and there each comment names the moves after it.
        """
        return self.named and self.moved and bool(self.tool)

    def state_stock(self, corners: Sequence[float]) -> None:
        """The blank that the program states, x, y, z of both corners [m]; one without an inside is none."""
        if all(low < high for low, high in zip(corners[:3], corners[3:], strict=True)):
            self.stock = tuple(corners)

    def name_operation(self, name: str, title: bool) -> None:
        """The operation of the moves that follow; title: the name is that of the whole program."""
        self.name_feature(name)
        self.named, self.moved = not title, False

    # --- what cannot be run ---

    @property
    def hopeless(self) -> bool:
        """Return whether there are too many refusals to continue."""
        return len(self._refused) >= 10_000  # a file with more is no program

    def refuse(
        self, word: str, reason: str = "", advice: str = "", lost: bool = False, derived: bool = False, line: int = 0
    ) -> None:
        """A word that cannot be run.

        lost: it may have moved the tool, so that what follows from its place is not refused once more; derived: it may
        only follow from an earlier one; line: other than the one that is read.
        """
        self.refusals += 1
        if derived and self.lost:
            return
        if self.place:
            reason = self._elsewhere(reason or word)
        refusal = Refusal(line or self.line, one_line(short(word)), one_line(reason), advice)
        self._refused.append((self.run, refusal))
        self.lost = self.lost or lost

    # --- at the end ---

    def finish(self, unit: float) -> Toolpath:
        """The path with its program; unit [m]: of lengths in comments. Raises ProgramError with all refusals."""
        program = self._program(unit)
        if program.refused:
            raise ProgramError(self.source, program)
        if not len(self) and self.unknown:
            axes = " and ".join(self.unknown)
            raise InputError(self.source, f"the tool moves, but the program never states {axes}", self.line)
        return self.build(program)

    def _program(self, unit: float) -> SourceProgram:
        columns = self.columns()
        cutting = np.flatnonzero(columns["rapid"] == 0)
        speed, feed = columns["spindle_speed"][cutting], columns["feed"][cutting]
        first = np.flatnonzero(np.diff(speed, prepend=np.nan))
        speeds = dict(
            zip(speed[first][::-1].tolist(), columns["line"][cutting[first]][::-1].astype(int).tolist(), strict=True)
        )
        speeds = dict(sorted(speeds.items(), key=lambda item: item[1]))  # each with the first line that it holds in
        tools = self.described_tools(unit)
        cutters = [tool for tool in tools if tool.cuts]
        chosen = self.selected or (cutters[0].name if cutters else "")
        frames = {kind: self._of_frame(number, chosen) for number, kind in enumerate(self.frame, 1)}
        # words before the first tool concern every one
        refused = [r for tool, r in self._refused if not self.selected or tool in ("", self.selected)]
        refused += self._selection(cutters)
        if not refused or len(cutters) < 2:
            refused += _several_speeds(speeds)
            for kind, words in frames.items():
                refused += _several(kind, list({name or "G54": line for name, line in words.items()}.items()))
        if self.skippable:
            skipped = f"{counted(len(self.skippable), 'line')} with / run; block delete is assumed off"
            self.doubtful.append(("block skip", skipped, next(iter(self.skippable))[1]))
        name, begin = self._runs.get(chosen, (chosen, 0))
        if sizes := self.diameters.get(name):
            text = f"the comments on {name or 'the tool'} state {1e3 * sizes[0]:g} and {1e3 * sizes[1]:g} mm"
            self.doubtful.append(("two diameters", text, begin))
        names = list(self.features)
        return SourceProgram(
            title=self.title,
            tool=chosen,
            tools=tools,
            spindle_speeds=tuple(speed for speed in speeds if speed),
            feeds=tuple(np.unique(feed[np.flatnonzero(np.diff(feed, prepend=np.nan))]).tolist()),
            feed_units=tuple(self.feed_units),
            external=self.external,
            rounding=self.rounding,
            stock=self.stock,
            tool_frame=self.displayed.get("$TOOL", ()),
            base_frame=self.displayed.get("$BASE", ()),
            beside=self.beside.get(name, 0.0),
            work_offset=next(filter(None, frames["work offsets"]), self.frame["work offsets"]),
            files=tuple(map(str, self.files)),
            places=tuple(self.places),
            operations=tuple(names[k] for k in cut_features(columns)),
            read_over=tuple(self.silent.most_common()),
            doubtful=tuple(self.doubtful),
            sideways=tuple(self.sideways),
            refused=tuple(sorted(refused, key=lambda refusal: refusal.line)),
        )

    def _of_frame(self, number: int, tool: str) -> dict[str, int]:
        """Words of one kind that a tool cut with, and their first lines; a length that no word gives is none."""
        words: dict[str, int] = {}
        for key, line in self._frames.items():
            if (not self.selected or key[0] == tool) and (number == 1 or key[number]):
                words.setdefault(key[number], line)
        return words

    def described_tools(self, unit: float) -> tuple[ProgramTool, ...]:
        """Every tool that the program changes to, with what its comments say; "" for cuts before the first one."""
        runs = ({"": ("", 1)} if self._cuts[""] else {}) | self._runs
        names = {tool for tool, _ in runs.values()}
        only = next(iter(names)) if len(names) == 1 else None
        known = dict(self.known)
        for comment, changed, beside in self.comments:
            tool = described_tool(comment, unit, changed or only, beside)
            if tool is not None:
                first, numbered = known.get(tool.name, tool), beside or described_tool(comment, unit) is not None
                if numbered and abs(first.diameter - tool.diameter) > 0.02 * first.diameter > 0.0 < tool.diameter:
                    self.diameters[tool.name] = first.diameter, tool.diameter
                known[tool.name] = known[tool.name].completed(tool) if tool.name in known else tool
        if only == "" and len(known) == 1:  # no T word: the one tool of the comments, whatever its number
            known = {"": next(iter(known.values()))}
        return tuple(
            dataclasses.replace(
                tool,
                name=run,
                changed_as=name,
                line=line,
                cuts=self._cuts[run],
                kind=tool.kind or kind_of(name),
                length_offset=name in self.length_offsets,
            )
            for run, (name, line) in runs.items()
            for tool in (known.get(name, ProgramTool(name)),)
        )

    def _selection(self, cutters: list[ProgramTool]) -> list[Refusal]:
        listing = ", ".join(f"{tool.label or 'the one before the first T'} from line {tool.line}" for tool in cutters)
        if self.selected and self.selected not in [tool.name for tool in cutters]:
            reason = f"the program does not cut with {self.selected}; it does with {listing}"
            return [Refusal(self.line, self.selected, reason, "")]
        if self.selected or len(cutters) < 2:
            return []
        name = cutters[0].name or cutters[1].name
        advice = f"write a cell with tools (kr270_milling init), or choose one tool with path.tool, for example {name}"
        reason = f"the program cuts with {len(cutters)} tools: {listing}"
        return [Refusal(cutters[1].line, cutters[1].name, reason, advice)]


def _differ(speed: float, other: float | None) -> bool:
    """Return whether two spindle speeds differ by more than 1 rpm, 0.1 rad/s; None: no speed."""
    return other is not None and abs(speed - other) > 0.1


def _several_speeds(speeds: dict[float, int]) -> list[Refusal]:
    distinct: list[tuple[float, int]] = []
    for speed, line in speeds.items():
        if speed and all(_differ(speed, known) for known, _ in distinct):
            distinct.append((speed, line))
    words = [(f"S{abs(speed) * 30 / math.pi:.6g}{' M4' if speed < 0 else ''}", line) for speed, line in distinct]
    return _several("spindle speeds", words)


EACH = "post one program for each"
_SEVERAL = {"work offsets": f"state their places with path.offsets_mm in the cell, or {EACH}"}


def _several(what: str, words: list[tuple[str, int]]) -> list[Refusal]:
    """A refusal of the second of several words, with their lines."""
    if len(words) < 2:
        return []
    listing = ", ".join(f"{word} (line {line})" for word, line in words[:6])
    return [Refusal(words[1][1], words[1][0].split()[0], f"{len(words)} {what}: {listing}", _SEVERAL.get(what, EACH))]


#: [m] how far above the last depth a peck starts again: 0.01 inch, as in LinuxCNC
CLEARANCE = 0.254e-3


@dataclass
class Cycle:
    """As the words of a block define it, lengths in [m]; each hole repeats it."""

    kind: int  #: 73, 76, 81, 82, 83, 85, 86, 89
    initial: float  #: height where the cycle was called
    retract: float  #: R
    bottom: float = math.nan  #: Z
    peck: float = 0.0  #: Q, 0: in one stroke
    modes: tuple = ()  #: G91 or not, and unit [m], of the last block with the cycle

    def strokes(self) -> list[tuple[float, bool]]:
        """Heights [m] that the tool goes to from R on, each with whether it goes there rapidly; the last is R again.

        81, 82, 86: in, out rapidly; 76 also, without its small shift by Q at the bottom of the bored hole; 83: out to R
        after each peck; 73: back by the clearance; 85, 89: out at the feed.
        """
        most_pecks = 10_000
        if self.kind not in (73, 83) or not 0 < self.peck < self.retract - self.bottom:
            return [(self.bottom, False), (self.retract, self.kind not in (85, 89))]
        depth = self.retract
        path: list[tuple[float, bool]] = []
        while depth > self.bottom:  # a peck that ends at the bottom may differ from it by rounding
            above = min(self.retract, depth + CLEARANCE)
            if path:
                path += [(above, True)] if self.kind == 73 else [(self.retract, True), (above, True)]
            depth = depth - self.peck if depth - self.peck > self.bottom + NEAR else self.bottom
            path.append((depth, False))
            if len(path) > 3 * most_pecks:
                raise ValueError(f"the hole takes more than {most_pecks} pecks; wrong Q?")
        return [*path, (self.retract, True)]
