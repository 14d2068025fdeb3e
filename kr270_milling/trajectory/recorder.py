"""The moves of one tool as a path, also where the program leaves the workpiece and comes back."""

from __future__ import annotations

import math

from kr270_milling.trajectory.path_builder import PathBuilder

__all__ = ["Recorder", "TOP"]

#: height of a tool that was sent home: the highest one of the program, which ``PathBuilder.build`` puts in
TOP = math.inf


class Recorder:
    """Hands moves to a PathBuilder; after a retract or a tool change the tool travels at the top height."""

    def __init__(self, path: PathBuilder):
        self.path = path
        self.active = True  #: whether the tool in the spindle is the one whose path is wanted
        self.away = False  #: whether the tool was taken away since the last move
        self.last: tuple | None = None

    def rapid(self, end: tuple, line: int) -> None:
        """Go to a point; nothing is recorded until X, Y and Z are known."""
        if not self.active or any(map(math.isnan, end)):
            return
        if self.last is not None and (self.away or self.last[2] == TOP):
            self._move((*self.last[:2], TOP), 0.0, True, line, 0.0)
            self._move((*end[:2], TOP), 0.0, True, line, 0.0)
        self.away = False
        self._move(end, 0.0, True, line, 0.0)

    def cut(self, start: tuple, ends: list, feed: float, line: int, curvature: float = 0.0) -> None:
        """Feed through points, from a start that is known."""
        if not self.active:
            return
        if self.last != start or self.away:
            self.rapid(start, line)
        for end in ends:
            self._move(end, feed, False, line, curvature)

    def _move(self, end: tuple, feed: float, rapid: bool, line: int, curvature: float) -> None:
        self.path.move(end, feed, rapid, line, curvature)
        self.last = end
