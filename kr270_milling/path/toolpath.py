"""A tool path of a milling program: blocks with feed rates, without times; the builder that collects blocks;
and the progress of a point on a path."""

from __future__ import annotations

import dataclasses
import functools
import math
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.blocks import BLOCK, blocks
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.frames import tool_axis
from kr270_milling.path.source_program import SourceProgram
from kr270_milling.path.trajectory import LEVER, TOOL_DOWN, turned

#: [m] largest coordinate of a part in a robot cell; a larger one has a wrong unit
REACH = 100.0


NO_PROGRAM = SourceProgram()


class ToolpathError(MillingError):
    """A tool path that cannot be run; index: the first wrong block, None if the fault is not in a single block."""

    def __init__(self, reason: str, index: int | None = None):
        self.reason, self.index = reason, index
        super().__init__(f"tool path{'' if index is None else f', block {index}'}: {reason}")


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Blocks of a path: block k runs from position k-1 to position k; block 0 is the start. Arrays become read-only.

    An arc is a row of chords with both ends on the arc; the curvature of the arc is stored with each chord.
    """

    position: np.ndarray  #: [m], (n, 3), end of each block, of the tool tip in the workpiece frame
    feed: np.ndarray  #: [m/s], (n,), as programmed; not used where ``rapid``
    rapid: np.ndarray  #: (n,) bool
    line: np.ndarray  #: (n,) int64, line in the source, from 1
    feature: np.ndarray  #: (n,) int64, index into ``features``
    features: tuple[str, ...]  #: names of the features of the part; the first is "" for blocks of no feature
    curvature: np.ndarray  #: [1/m], (n,), in the xy plane, positive counterclockwise seen from +z; 0: straight
    spindle_speed: np.ndarray  #: [rad/s], (n,), clockwise, negative: counterclockwise; 0: off or not given
    quaternion: np.ndarray  #: (n, 4), x, y, z, w, of tcp in the workpiece frame at the end of each block
    drilling: np.ndarray = field(
        default_factory=lambda: np.zeros(0, bool)
    )  #: strokes of a cycle, (n,) bool; empty: none
    place: np.ndarray = field(
        default_factory=lambda: np.zeros(0, np.int64)
    )  #: (n,) int64, index into ``program.places``, the lines in further files; empty: none
    program: SourceProgram = NO_PROGRAM  #: statements of the source in addition to its moves

    def __post_init__(self):
        position = np.asarray(self.position, float)
        if position.ndim != 2 or position.shape[1] != 3 or len(position) < 2:
            raise ToolpathError("it needs a start and at least one move")
        for name in ("drilling", "place"):
            if not np.size(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(len(position), np.int64))
        for name in (
            "position",
            "feed",
            "rapid",
            "drilling",
            "place",
            "line",
            "feature",
            "curvature",
            "spindle_speed",
            "quaternion",
        ):
            kinds = {"rapid": bool, "drilling": bool} | dict.fromkeys(("line", "feature", "place"), np.int64)
            kind = kinds.get(name, float)
            values = np.array(getattr(self, name), kind)
            shape = (len(position),) + {"position": (3,), "quaternion": (4,)}.get(name, ())
            if values.shape != shape:
                raise ToolpathError(f"{name} has the shape {values.shape}, but must have {shape}")
            finite = np.isfinite(values)
            if not finite.all():
                raise ToolpathError(f"its {name} is not finite", int(np.argwhere(~finite)[0, 0]))
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        stuck = ~(self.feed > 0) & ~self.rapid
        if stuck[1:].any():
            raise ToolpathError("a cutting move needs a feed above 0", int(np.argmax(stuck[1:])) + 1)

    def __len__(self) -> int:
        return len(self.position)

    @functools.cached_property
    def block_length(self) -> np.ndarray:
        """Return the length of each block [m], (n,), along the arcs; 0 for block 0, LEVER times a turn in place."""
        length = np.hypot(self.plane_length, np.diff(self.position[:, 2], prepend=self.position[0, 2]))
        turns = np.flatnonzero(length[1:] == 0) + 1
        if turns.size:
            length[turns] = LEVER * turned(self.quaternion[turns - 1], self.quaternion[turns])
        length.setflags(write=False)
        return length

    @property
    def ways(self) -> np.ndarray:
        """Return the way of the tool in each block [m], (n,): its length, at least LEVER times its turn."""
        ways = self.block_length.copy()
        if np.any(self.quaternion != self.quaternion[0]):
            ways[1:] = np.maximum(ways[1:], LEVER * turned(self.quaternion[:-1], self.quaternion[1:]))
        return ways

    @functools.cached_property
    def plane_length(self) -> np.ndarray:
        """Return the length of each block in the xy plane [m], (n,)."""
        chord = np.hypot(*np.diff(self.position[:, :2], axis=0, prepend=self.position[:1, :2]).T)
        bent = np.abs(self.curvature) > 0
        curvature = np.where(bent, np.abs(self.curvature), 1.0)
        return np.where(bent, 2 / curvature * np.arcsin(np.clip(curvature * chord / 2, 0, 1)), chord)

    @functools.cached_property
    def tilt(self) -> np.ndarray:
        """Return the angle between the tool and z of the workpiece at the end of each block [rad], (n,)."""
        axis = tool_axis(self.quaternion)
        return np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), axis[:, 2])

    @property
    def cutting_tilt(self) -> float:
        """Return the largest ``tilt`` of a cutting move [rad]."""
        return float(self.tilt[~self.rapid].max(initial=0.0))

    @property
    def length(self) -> float:
        """Return the length of the path [m]."""
        return float(self.block_length.sum())

    def repeated(self, times: int, height: float) -> Toolpath:
        """Return the path and then the same path again, ``times`` times; in between rapid moves at a height [m]."""
        top = max(height, float(self.position[:, 2].max()))
        start, end = self.position[[0, -1]]
        between = np.array([[*end[:2], top], [*start[:2], top], start])
        between = between[np.any(between != np.vstack([end, between[:-1]]), axis=1)]
        again = np.append(np.zeros(len(between), int), np.arange(1, len(self)))
        back = np.tile(np.arange(len(again)) < len(between), times)
        back = np.append(np.zeros(len(self), bool), back)
        taken = self._rows(np.append(np.arange(len(self)), np.tile(again, times)))
        taken["position"][back] = np.tile(between, (times, 1))
        taken["rapid"][back] = True
        for name in ("drilling", "feature", "curvature"):
            taken[name][back] = 0
        return dataclasses.replace(self, **taken)

    def _rows(self, rows: np.ndarray) -> dict[str, Any]:
        """Return the columns of some blocks."""
        columns = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: values[rows] for name, values in columns.items() if isinstance(values, np.ndarray)}

    def with_feeds(self, ends: np.ndarray, shares: np.ndarray) -> Toolpath:
        """Return the path with blocks that end at the stretches, and shares (s,) of the feed of each stretch.

        ends: distances along the path [m], (s,), the last one is the end of the path. Rapid moves and drilling cycles
        keep their feed.
        """
        own = np.cumsum(self.block_length)
        apart = 1e-6  # [m], shorter blocks are not made
        after = np.clip(np.searchsorted(own, ends), 1, len(own) - 1)
        inner = ends[np.minimum(np.abs(own[after] - ends), np.abs(own[after - 1] - ends)) > apart]
        distance = np.union1d(own, inner)
        middle = (distance[1:] + distance[:-1]) / 2.0
        divided = self._rows(np.append(0, self.block_at(middle)))
        new = ~np.isin(distance, own)
        if new.any():
            divided["position"][new], _, divided["quaternion"][new] = self.on_path(distance[new])
        stretch = np.clip(np.searchsorted(ends, middle), 0, len(ends) - 1)
        changed = ~divided["rapid"] & ~divided["drilling"]
        divided["feed"] = np.where(changed, divided["feed"] * np.append(1.0, shares[stretch]), divided["feed"])
        return dataclasses.replace(self, **divided)

    def block_at(self, distance) -> np.ndarray:
        """Return the block, from 1, at each distance [m] along the path."""
        ends = np.cumsum(self.block_length)
        return np.clip(np.searchsorted(ends, distance, side="right"), 1, len(self) - 1)

    def tangent(self, block: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        """Return the unit tangent, (m, 3), ``travelled`` [m] in the xy plane from the start; 0 for a turn in place."""
        move = self.position[block] - self.position[block - 1]
        plane = self.plane_length[block]
        heading = np.arctan2(move[:, 1], move[:, 0]) + self.curvature[block] * (travelled - plane / 2)
        flat = np.stack([plane * np.cos(heading), plane * np.sin(heading), move[:, 2]], axis=1)
        length = np.linalg.norm(flat, axis=1, keepdims=True)
        return flat / np.where(length > 0, length, 1.0)

    def position_at(self, distance: np.ndarray) -> np.ndarray:
        """Return the position [m], (m, 3), at distances [m], (m,); only a block of the tangents is in memory."""
        return np.concatenate([self.on_path(distance[part])[0] for part in blocks(distance.size)])

    def on_path(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position [m], unit tangent and quaternion at distances [m], (m,), on the true arcs of the path."""
        if distance.size > BLOCK:
            parts = [self.on_path(distance[part]) for part in blocks(distance.size)]
            position, tangent, quaternion = (np.concatenate(part) for part in zip(*parts, strict=True))
            return position, tangent, quaternion
        block, length = self.block_at(distance), self.block_length
        share = np.clip((distance - np.cumsum(length)[block - 1]) / length[block], 0, 1)
        plane, bend = self.plane_length[block], self.curvature[block]
        start, move = self.position[block - 1], self.position[block] - self.position[block - 1]
        position = start + share[:, None] * move
        arc = bend != 0
        heading = (np.arctan2(move[:, 1], move[:, 0]) - bend * plane / 2)[arc]
        turned, bent = heading + (bend * share * plane)[arc], bend[arc]
        position[arc, 0] = start[arc, 0] + (np.sin(turned) - np.sin(heading)) / bent
        position[arc, 1] = start[arc, 1] - (np.cos(turned) - np.cos(heading)) / bent
        return position, self.tangent(block, share * plane), self._orientation(block, share[:, None])

    def _orientation(self, block: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the quaternions at shares (m, 1) of blocks: those of the program at its points, and smooth in between.

        The rotation vector from the start of a block is a monotone cubic, whose rates at the points are those of
        PCHIP: a tool that turns along rows of short blocks has no jumps of its rate, and none overshoots.
        """
        if self._turns is None:
            return np.broadcast_to(self.quaternion[0], (len(block), 4))
        turn, first, last = (rows[block] for rows in self._turns)
        bent = share**2 * (3 * turn - 2 * first - last) + share**3 * (first + last - 2 * turn)
        moved = Rotation.from_rotvec(share * first + bent) * Rotation.from_quat(self.quaternion[block - 1])
        return moved.as_quat()

    @functools.cached_property
    def _turns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Rotation vectors [rad] of the blocks, (n, 3), and their rates at both ends, a block; None: no turn."""
        if not np.any(self.quaternion != self.quaternion[0]):
            return None
        length, at = self.block_length[:, None], Rotation.from_quat(self.quaternion)
        turn = np.zeros((len(self), 3))
        turn[1:] = (at[1:] * at[:-1].inv()).as_rotvec()
        rate = turn[1:] / length[1:]
        before, after, a, b = rate[:-1], rate[1:], length[1:-1], length[2:]
        same = before * after > 0
        safe = np.where(same, before, 1.0), np.where(same, after, 1.0)
        mean = np.where(same, 3 * (a + b) / ((2 * b + a) / safe[0] + (b + 2 * a) / safe[1]), 0.0)
        in_place = (np.diff(self.position, axis=0) == 0).all(axis=1)
        apart = (in_place[:-1] | in_place[1:])[:, None]  # the tool rests there
        first, last = np.zeros_like(turn), np.zeros_like(turn)
        first[1:] = np.vstack([rate[:1], np.where(apart, after, mean)]) * length[1:]
        last[1:] = np.vstack([np.where(apart, before, mean), rate[-1:]]) * length[1:]
        return turn, first, last


#: height of a tool at its home position, before ``PathBuilder.build`` sets the largest height
TOP = math.inf
#: largest number of blocks (a full circle of 100 m radius within 2 um has 16,000)
MOST_BLOCKS = 20_000_000
#: columns of the blocks while they are collected
COLUMNS: dict[str, int | slice] = {
    "position": slice(0, 3), "quaternion": slice(3, 7), "feed": 7, "curvature": 8, "spindle_speed": 9, "rapid": 10,
    "line": 11, "feature": 12, "drilling": 13, "place": 14,
}  # fmt: skip


class PathBuilder:
    """Collects blocks; leaves out moves of length 0 and features without a cutting move."""

    def __init__(self, source):
        self.source = source
        self.line = 1  #: current line of the source
        self.place = 0  #: of the current line in a further file
        self.features: dict[str, int] = {"": 0}
        self.feature = 0  #: feature of the next moves
        self.spindle_speed = 0.0  #: [rad/s]
        self.drilling = False  #: True for moves of a drilling cycle
        self.quaternion: tuple[float, ...] = TOOL_DOWN
        self.last: tuple[float, float, float] | None = None  #: end of the last move
        self._last_quaternion: tuple[float, ...] = TOOL_DOWN
        self._blocks = array("d")

    def __len__(self) -> int:
        return len(self._blocks) // 15

    def name_feature(self, name: str) -> None:
        """Start a feature: the next moves belong to it."""
        self.feature = self.features.setdefault(name, len(self.features))

    def move(self, position: tuple[float, float, float], feed: float, rapid: bool, line: int, curvature=0.0) -> None:
        """Append one block; position [m], feed [m/s], curvature [1/m]."""
        self.line = line
        if position == self.last and self.quaternion == self._last_quaternion:
            return
        if len(self) >= MOST_BLOCKS:
            raise InputError(self.source, f"the path has more than {MOST_BLOCKS} blocks", line)
        self.last, self._last_quaternion = position, self.quaternion
        numbers = (feed, curvature, self.spindle_speed, rapid, line, self.feature, self.drilling, self.place)
        self._blocks.extend((*position, *self.quaternion, *numbers))

    def moves(self, ends: list, lines: Iterable[int], feed: float, curvature: float = 0.0) -> None:
        """Append feed blocks to points [m], each with its line; the orientation is that of the last block."""
        if len(self) + len(ends) > MOST_BLOCKS:
            raise InputError(self.source, f"the path has more than {MOST_BLOCKS} blocks", self.line)
        rest = 0.0, 0.0, self.feature, self.drilling, self.place
        numbers = array("d", (*self._last_quaternion, feed, curvature, self.spindle_speed, *rest))
        extend, last, place = self._blocks.extend, self.last, 8  # of the line in ``numbers``
        for end, line in zip(ends, lines):  # noqa: B905, the line of an arc is repeated without an end
            if end != last:
                last, numbers[place] = end, line
                extend(end)
                extend(numbers)
        self.last = last

    def append_row(self, ends: np.ndarray, lines: np.ndarray, feed: float, curvature: np.ndarray) -> None:
        """Append feed blocks to points [m], (n, 3), as ``moves``; lines, curvature: of each, (n,)."""
        if len(self) + len(ends) > MOST_BLOCKS:
            raise InputError(self.source, f"the path has more than {MOST_BLOCKS} blocks", self.line)
        blocks = np.empty((len(ends), 15))
        rest = (
            *self._last_quaternion,
            feed,
            0.0,
            self.spindle_speed,
            0.0,
            0.0,
            self.feature,
            self.drilling,
            self.place,
        )
        blocks[:, :3], blocks[:, 3:] = ends, rest
        blocks[:, COLUMNS["curvature"]], blocks[:, COLUMNS["line"]] = curvature, lines
        moves = np.append((ends[:1] != self.last).any(axis=1), (ends[1:] != ends[:-1]).any(axis=1))
        self._blocks.frombytes((blocks if moves.all() else blocks[moves]).view(np.uint8).data)
        self.last = tuple(ends[-1].tolist())

    def columns(self) -> dict[str, np.ndarray]:
        """Return the blocks so far, by the names of the fields of a Toolpath."""
        blocks = np.frombuffer(self._blocks).reshape(-1, 15)
        return {name: blocks[:, column] for name, column in COLUMNS.items()}

    def build(self, program: SourceProgram = NO_PROGRAM) -> Toolpath:
        """Return the path; raise InputError for a path that cannot be run."""
        columns = self.columns()
        away = np.isinf(columns["position"][:, 2])
        if away.any():
            blocks = _taken_away(np.frombuffer(self._blocks).reshape(-1, 15), away)
            moves = np.append(True, np.any(np.diff(blocks[:, :7], axis=0) != 0, axis=1))
            columns = {name: blocks[moves, column] for name, column in COLUMNS.items()}
        line, feature = columns["line"], columns["feature"].astype(np.int64)
        if len(line) < 2:
            raise InputError(self.source, "the path never moves", int(line[0]) if len(line) else self.line)
        cut = cut_features(columns)
        index = np.zeros(len(self.features), np.int64)
        index[cut] = np.arange(1, len(cut) + 1)
        names = list(self.features)
        columns["feature"] = index[feature]
        try:
            return Toolpath(**columns, features=("", *(names[k] for k in cut)), program=program)
        except ToolpathError as error:
            at = None if error.index is None else int(line[error.index])
            raise InputError(self.source, error.reason, at) from None


def _taken_away(blocks: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Return the blocks with the largest height for tools that were taken away; a tilted tool leaves along its axis.

    It leaves the box of all places and, beside them, LEVER more, then goes up; it comes back in the same manner.
    """
    blocks, places = blocks.copy(), blocks[~away, :3]
    top = places[:, 2].max() if len(places) else 0.0
    blocks[away, 2] = top
    turned = blocks[:, 5] ** 2 + blocks[:, 6] ** 2 > 1e-12  # z and w: the tool is not along z
    if not turned.any():
        return blocks
    low, high = places.min(axis=0), places.max(axis=0)

    def outside(block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The blocks of a place where a tool has left the box, and of the place above it."""
        axis = tool_axis(block[3:7])
        room = np.where(axis > 0, high - block[:3], block[:3] - low) / np.maximum(np.abs(axis), 1e-12)
        room[:2] += LEVER / np.maximum(np.abs(axis[:2]), 1e-12)
        out, above = block.copy(), block.copy()
        out[:3] += max(room.min(), 0.0) * axis
        above[:3] = *out[:2], top
        for new in (out, above):
            new[[COLUMNS["feed"], COLUMNS["curvature"], COLUMNS["drilling"]]] = 0.0
            new[COLUMNS["rapid"]] = 1.0
        return out, above

    rows: list[np.ndarray] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], away.astype(int), [0]])))
    begin = 0
    for first, end in edges.reshape(-1, 2).tolist():
        before, after = first > 0, end < len(blocks)
        rows.append(blocks[begin:first])
        begin = end
        if not (before and turned[first - 1]) and not (after and turned[end]):
            rows.append(blocks[first:end])
            continue
        if before:
            rows.append(np.array(outside(blocks[first - 1])))
        if after:
            rows.append(np.array(outside(blocks[end]))[::-1])
    return np.concatenate([*rows, blocks[begin:]])


def cut_features(columns: dict[str, np.ndarray]) -> list[int]:
    """Return the numbers of the named features with cutting moves, in the order of the program."""
    numbers = np.flatnonzero(np.bincount(columns["feature"][columns["rapid"] == 0].astype(int))).tolist()
    return [k for k in numbers if k][:200]  # with more names, the comments do not name features


class PathProgress:
    """Place on the straight lines between points (n, 3) [m]; points at rest have one place.

    reach [m]: a point farther from the path gives no progress.
    """

    def __init__(self, position: np.ndarray, reach: float = 1e-3):
        step = np.linalg.norm(np.diff(position, axis=0), axis=1)
        self.moved = np.concatenate([[True], step > 0.0])  #: (n,) bool: points that do not repeat the one before
        self.distance = np.concatenate([[0.0], np.cumsum(step[step > 0.0])])  #: [m], of the points that moved
        self.progress = 0.0  #: [m] along the path
        self._point = position[self.moved]
        self.reach = reach

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.distance[-1])

    def advance(self, point: np.ndarray) -> float:
        """Move the progress to the projection of the point, and return the distance [m] of the point from it."""
        window = 10e-3  # [m], length of the path ahead of the last progress that is searched
        first = max(0, int(np.searchsorted(self.distance, self.progress, side="right")) - 1)
        last = min(int(np.searchsorted(self.distance, self.progress + window)), len(self.distance) - 1)
        first = min(first, len(self.distance) - 2)
        last = max(last, first + 1)
        start, along = self._point[first:last], np.diff(self._point[first : last + 1], axis=0)
        length = np.diff(self.distance[first : last + 1])
        share = np.clip(np.einsum("ij,ij->i", point - start, along) / length**2, 0.0, 1.0)
        reached = np.maximum(self.distance[first:last] + share * length, self.progress)
        share = (reached - self.distance[first:last]) / length
        distance = np.linalg.norm(point - start - share[:, None] * along, axis=1)
        least = np.concatenate([[np.inf], distance, [np.inf]])
        # of two places that are equally near within 20 um, the earlier place is the progress
        local = (distance <= least[:-2]) & (distance <= least[2:]) & (distance <= distance.min() + 2e-5)
        chosen = int(np.argmax(local))
        if distance[chosen] <= self.reach:
            self.progress = float(reached[chosen])
        return float(distance[chosen])
