"""A tool path as a milling programme gives it: blocks with a feed rate, not yet with times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.trajectory.source_program import SourceProgram
from kr270_milling.trajectory.trajectory import slerp

__all__ = ["Toolpath", "ToolpathError", "REACH"]

#: [m] no coordinate of a part in a robot cell is larger; beyond it the unit must be wrong
REACH = 100.0


class ToolpathError(MillingError):
    """A tool path that cannot be run; index is the first offending block, None where it is not one block."""

    def __init__(self, reason: str, index: int | None = None):
        self.reason, self.index = reason, index
        super().__init__(f"tool path{'' if index is None else f', block {index}'}: {reason}")


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Block k runs from position k-1 to position k; block 0 is where the path starts. Arrays become read-only.

    Arcs stand as chords that touch the arc at both ends, with its curvature beside them, so that the arc is not lost.
    """

    position: np.ndarray  #: [m], (n, 3), end of each block, of the tool tip in the workpiece frame
    feed: np.ndarray  #: [m/s], (n,), as programmed; not used where ``rapid``
    rapid: np.ndarray  #: (n,) bool
    line: np.ndarray  #: (n,) int64, line in the source, from 1
    feature: np.ndarray  #: (n,) int64, index into ``features``
    features: tuple[str, ...]  #: names of the features of the part; the first is "" for blocks of no feature
    curvature: np.ndarray  #: [1/m], (n,), in the xy plane, positive counterclockwise seen from +z; 0: straight
    spindle_speed: np.ndarray  #: [rad/s], (n,), clockwise, negative: counterclockwise; 0: off or not given
    quaternion: np.ndarray  #: (n, 4), x, y, z, w, of tool0 in the workpiece frame at the end of each block
    program: SourceProgram = SourceProgram()  #: what the source says beside its moves

    def __post_init__(self):
        position = np.array(self.position, float)
        if position.ndim != 2 or position.shape[1] != 3 or len(position) < 2:
            raise ToolpathError("it needs a start and at least one move")
        for name in ("position", "feed", "rapid", "line", "feature", "curvature", "spindle_speed", "quaternion"):
            kind = {"rapid": bool, "line": np.int64, "feature": np.int64}.get(name, float)
            values = np.array(getattr(self, name), kind)
            shape = (len(position),) + {"position": (3,), "quaternion": (4,)}.get(name, ())
            if values.shape != shape:
                raise ToolpathError(f"{name} has the shape {values.shape}, but must have {shape}")
            bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
            if bad.any():
                raise ToolpathError(f"its {name} is not finite", int(np.argmax(bad)))
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        stuck = ~(self.feed > 0) & ~self.rapid
        if stuck[1:].any():
            raise ToolpathError("a cutting move needs a feed above 0", int(np.argmax(stuck[1:])) + 1)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def block_length(self) -> np.ndarray:
        """[m], (n,), along the arcs; 0 for block 0."""
        return np.hypot(self.plane_length, np.diff(self.position[:, 2], prepend=self.position[0, 2]))

    @property
    def plane_length(self) -> np.ndarray:
        """[m], (n,), of the projection of each block onto the xy plane."""
        chord = np.hypot(*np.diff(self.position[:, :2], axis=0, prepend=self.position[:1, :2]).T)
        bent = np.abs(self.curvature) > 0
        curvature = np.where(bent, np.abs(self.curvature), 1.0)
        return np.where(bent, 2 / curvature * np.arcsin(np.clip(curvature * chord / 2, 0, 1)), chord)

    @property
    def length(self) -> float:
        """[m]"""
        return float(self.block_length.sum())

    def block_at(self, distance) -> np.ndarray:
        """The block, from 1, that holds each distance [m] along the path."""
        ends = np.cumsum(self.block_length)
        return np.clip(np.searchsorted(ends, distance, side="right"), 1, len(self) - 1)

    def tangent(self, block: np.ndarray, way: np.ndarray) -> np.ndarray:
        """Unit tangent, (m, 3), at the distance ``way`` [m] from the start of a block, measured in the xy plane."""
        move = self.position[block] - self.position[block - 1]
        plane = self.plane_length[block]
        heading = np.arctan2(move[:, 1], move[:, 0]) + self.curvature[block] * (way - plane / 2)
        flat = np.stack([plane * np.cos(heading), plane * np.sin(heading), move[:, 2]], axis=1)
        return flat / np.linalg.norm(flat, axis=1, keepdims=True)

    def on_path(self, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position [m], unit tangent and quaternion at distances [m], (m,), along the path; arcs are arcs again."""
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
        quaternion = slerp(self.quaternion[block - 1], self.quaternion[block], share[:, None])
        return position, self.tangent(block, share * plane), quaternion
