"""The words of a program that cannot be run, collected until its end."""

from __future__ import annotations

from kr270_milling.base.errors import one_line
from kr270_milling.base.text import short
from kr270_milling.trajectory.source_program import Refusal

__all__ = ["Refusals"]

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
