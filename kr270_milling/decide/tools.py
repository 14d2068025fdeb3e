"""The tools of a program one after the other: each begins with the workpiece that the one before leaves."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from kr270_milling.base.column import computed
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import removal_of
from kr270_milling.cell.stage import Removal
from kr270_milling.decide.check_cut import spring_back
from kr270_milling.decide.compensation import Compensated
from kr270_milling.decide.decision import CAUTION, NO, YES, Decision

Done = TypeVar("Done")


def in_turn(
    cells: Sequence[Cell], job: Callable[[Cell], Done], passed: Callable[[Done], ScoredPass | None]
) -> list[tuple[Cell, Done]]:
    """Do a job for the tools of a program in their order; a cell without other tools stays unchanged.

    passed: the pass of a job, whose workpiece the next tool begins with; None: the pass must not be run, and the tool
    leaves its programmed part. Returns each cell, on its workpiece, and the result of its job.
    """
    done: list[tuple[Cell, Done]] = []
    earlier: tuple[Removal, ...] = cells[0].stage.earlier if cells[0].stage else ()
    for next_cell in cells:
        cell = next_cell.after(earlier)
        result = job(cell)
        done.append((cell, result))
        if cell is not cells[-1] and len(done) < len(cells):
            earlier += (_removal(cell, passed(result)),)
    return done


def _removal(cell: Cell, ran: ScoredPass | None) -> Removal:
    """Return the material that the tool of a cell removes in a pass; None: on its programmed path."""
    programmed = removal_of(cell)
    if ran is None:
        return programmed
    actual = ran.result.actual
    same_place = 1e-9  # [m]
    moved = np.linalg.norm(np.diff(actual, axis=0), axis=1) > same_place
    actual = np.ascontiguousarray(actual[np.concatenate([[True], moved])])
    return dataclasses.replace(programmed, actual=actual, spring_back=spring_back(cell, ran))


@dataclass(frozen=True)
class DecisionOnTools:
    """The decision on a program with several tools: that of the worst tool."""

    tools: tuple[tuple[str, Decision], ...]  #: decisions by name of the tool, in the order of the program

    @classmethod
    def of(cls, jobs: Sequence[tuple[Cell, Compensated]]) -> DecisionOnTools:
        """The decision on the compensations of all tools; jobs: as ``in_turn`` returns them."""
        return cls(tuple((cell.stage.tool, done.decision) for cell, done in jobs if cell.stage))

    @computed("decision")
    def level(self) -> str:
        """``yes``, ``caution`` or ``no``. A tool without a wall or floor that stays is judged by its stops alone."""
        levels = [tool.level for _, tool in self.tools if tool.level == NO or not math.isnan(tool.compensated.error)]
        return next((level for level in (NO, CAUTION, YES) if level in levels), CAUTION)

    @property
    def worst(self) -> tuple[str, Decision]:
        """The tool that decides: of those of this level the first with a stop, else that with the largest share."""
        same = [pair for pair in self.tools if pair[1].level == self.level]
        shares = [math.inf if tool.stops else np.nan_to_num(tool.compensated.share, nan=-1.0) for _, tool in same]
        return same[int(np.argmax(shares))]

    @property
    def exit_code(self) -> int:
        """0, or 1 for ``no``."""
        return int(self.level == NO)

    @computed("may_be_run")
    def may_be_run(self) -> bool:
        """Return whether no tool has a stop."""
        return all(tool.may_be_run for _, tool in self.tools)

    @computed("deciding_tool")
    def _deciding_tool(self) -> str:
        return self.worst[0]

    @computed("sentence")
    def sentence(self) -> str:
        """Return the reason, with the name of the tool."""
        name, decision = self.worst
        return f"{name}: {decision.sentence}"

    @property
    def text(self) -> str:
        """Return level and sentence in one line."""
        return f"decision: {self.level}: {self.sentence}"

    def lines(self, tool: str = "") -> list[str]:
        """The decision, then the lines of each tool, or of one."""
        lines = [self.text]
        for name, one in self.tools:
            if tool in ("", name):
                lines += [f"{name}: {line}" for line in (f"{one.level}: {one.sentence}", *one.lines()[1:])]
        return lines
