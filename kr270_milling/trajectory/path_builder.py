"""Collects the blocks of a source file into a tool path."""

from __future__ import annotations

import math
from array import array

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.trajectory.source_program import SourceProgram
from kr270_milling.trajectory.toolpath import Toolpath
from kr270_milling.trajectory.trajectory import TOOL_DOWN

__all__ = ["TOP", "PathBuilder"]

#: height of a tool that was sent home: the highest one of the program, which ``PathBuilder.build`` puts in
TOP = math.inf
#: more blocks than this cannot be meant (a full circle of 100 m radius within 2 um has 16,000)
MOST_BLOCKS = 20_000_000
MOST_FEATURES = 200  #: a part with more of them is named by something that is no feature


class PathBuilder:
    """Moves that go nowhere are left out; a feature without a cutting move is none.

    After a retract or a tool change the tool travels at the top height.
    """

    def __init__(self, source):
        self.source = source
        self.features: dict[str, int] = {"": 0}
        self.feature = 0
        self.spindle_speed = 0.0
        self.quaternion = TOOL_DOWN
        self.active = True  #: whether the tool in the spindle is the one whose path is wanted
        self.away = False  #: whether the tool was taken away since the last move
        self._positions = array("d")
        self._turns = array("d")
        self._numbers = array("d")  # feed, curvature, spindle speed per block
        self._marks = array("q")  # rapid, line, feature per block
        self._last = None

    def __len__(self) -> int:
        return len(self._marks) // 3

    @property
    def last(self) -> tuple[float, float, float] | None:
        """Where the last move went."""
        return self._last and self._last[0]

    def rapid(self, end: tuple, line: int) -> None:
        """Go to a point; nothing is recorded until X, Y and Z are known."""
        if not self.active or any(map(math.isnan, end)):
            return
        if self.last is not None and (self.away or self.last[2] == TOP):
            self.move((*self.last[:2], TOP), 0.0, True, line)
            self.move((*end[:2], TOP), 0.0, True, line)
        self.away = False
        self.move(end, 0.0, True, line)

    def cut(self, start: tuple, ends: list, feed: float, line: int, curvature: float = 0.0) -> None:
        """Feed through points, from a start that is known."""
        if not self.active:
            return
        if self.last != start or self.away:
            self.rapid(start, line)
        for end in ends:
            self.move(end, feed, False, line, curvature)

    def name_feature(self, name: str) -> None:
        """The moves that follow make this feature."""
        self.feature = self.features.setdefault(name, len(self.features))

    def move(self, position: tuple[float, float, float], feed: float, rapid: bool, line: int, curvature=0.0) -> None:
        """Append one block; position [m], feed [m/s], curvature [1/m]."""
        here = (position, self.quaternion)
        if here == self._last:
            return
        if len(self) >= MOST_BLOCKS:
            raise InputError(self.source, f"the path has more than {MOST_BLOCKS} blocks", line)
        if self._last is not None and position == self._last[0]:
            raise InputError(self.source, "the tool turns without moving; that has no feed", line)
        self._last = here
        self._positions.extend(position)
        self._turns.extend(self.quaternion)
        self._numbers.extend((feed, curvature, self.spindle_speed))
        self._marks.extend((rapid, line, self.feature))

    def cutting_speeds(self) -> dict[float, int]:
        """Spindle speeds [rad/s] of the cutting moves, each with the first line that it holds in."""
        rapid, line, _ = self._columns()
        cutting = np.flatnonzero(rapid == 0)
        speeds, first = np.unique(np.frombuffer(self._numbers).reshape(-1, 3)[cutting, 2], return_index=True)
        order = np.argsort(first)
        return dict(zip(speeds[order].tolist(), line[cutting[first[order]]].tolist(), strict=True))

    def cutting_feeds(self) -> tuple[float, ...]:
        """[m/s], of the cutting moves, ascending."""
        rapid, _, _ = self._columns()
        return tuple(np.unique(np.frombuffer(self._numbers).reshape(-1, 3)[rapid == 0, 0]).tolist())

    def cut_features(self) -> tuple[str, ...]:
        """Names of the features with cutting moves, without the unnamed one, in the order of the program."""
        rapid, _, feature = self._columns()
        names = list(self.features)
        return tuple(names[k] for k in np.unique(feature[rapid == 0]) if k)[:MOST_FEATURES]

    def build(self, last_line: int, program: SourceProgram | None = None) -> Toolpath:
        """The path; raises InputError where it never moves."""
        position = np.frombuffer(self._positions).reshape(-1, 3)
        rapid, line, feature = self._columns()
        kept = np.ones(len(position), bool)
        if not np.isfinite(position[:, 2]).all():
            position, kept = self._lifted(position)
        if kept.sum() < 2:
            raise InputError(self.source, "the path never moves", int(line[0]) if len(line) else last_line)
        numbers = np.frombuffer(self._numbers).reshape(-1, 3)[kept]
        features, feature = self._named(rapid[kept], feature[kept])
        return Toolpath(
            position=position[kept], feed=numbers[:, 0], rapid=rapid[kept], line=line[kept], feature=feature,
            features=features, curvature=numbers[:, 1], spindle_speed=numbers[:, 2],
            quaternion=np.frombuffer(self._turns).reshape(-1, 4)[kept], program=program or SourceProgram(),
        )  # fmt: skip

    def _columns(self) -> np.ndarray:
        """rapid, line, feature, (3, n)."""
        return np.frombuffer(self._marks, np.int64).reshape(-1, 3).T

    def _lifted(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions with the top height for infinite ones, and which blocks still lead somewhere."""
        height = position[:, 2]
        finite = height[np.isfinite(height)]
        top = finite.max() if finite.size else 0.0
        lifted = np.column_stack([position[:, :2], np.where(np.isfinite(height), height, top)])
        moves = np.any(np.diff(lifted, axis=0) != 0, axis=1)
        return lifted, np.concatenate([[True], moves])

    def _named(self, rapid: np.ndarray, feature: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
        """Names of the features that cut, "" first, and the index of each block into them."""
        names = list(self.features)
        cut = [k for k in np.unique(feature[rapid == 0]).tolist() if k][:MOST_FEATURES]
        index = np.zeros(len(names), np.int64)
        index[cut] = np.arange(1, len(cut) + 1)
        return ("", *(names[k] for k in cut)), index[feature]
