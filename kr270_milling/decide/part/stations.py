"""Stations of a pass on its tool path: directions, distances and features of its exchange periods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.paths import CellPath


@dataclass(frozen=True, eq=False)
class Stations:
    """The target of a pass at the ends of its n exchange periods (first row: the start), workpiece frame."""

    distance: np.ndarray  #: [m], (n + 1,), along the tool path
    tangent: np.ndarray  #: unit vectors, (n + 1, 3), also while the tool rests
    heading: np.ndarray  #: [rad], (n + 1,), of the tangent in the xy plane; moves along the spindle keep the last one
    feature: np.ndarray  #: (n + 1,), index into ``features``
    features: tuple[str, ...]
    drilling: np.ndarray  #: in a drilling cycle, (n + 1,) bool

    @property
    def left(self) -> np.ndarray:
        """Horizontal unit normal to the left of the path, (n + 1, 2)."""
        return np.column_stack([-np.sin(self.heading), np.cos(self.heading)])


def stations_of(programmed: CellPath, time_ns: np.ndarray) -> Stations:
    """Return the stations of the programmed path at times [ns], (n + 1,)."""
    timed = programmed.timed
    if timed is None:
        target = programmed.target
        distance = np.linalg.norm(target.sample(time_ns) - target.position[0], axis=1)
        along = target.position[-1] - target.position[0]
        tangent = np.tile(along / np.linalg.norm(along), (time_ns.size, 1))
        return Stations(
            distance,
            tangent,
            _headings(tangent),
            np.zeros(time_ns.size, np.int64),
            ("straight cut",),
            np.zeros(time_ns.size, bool),
        )
    path, distance = timed.toolpath, timed.distance_at(time_ns)
    _, tangent, _ = path.on_path(distance)
    feature = path.feature[path.block_at(distance)]
    names = tuple(name or "unnamed" for name in path.features)
    return Stations(distance, tangent, _headings(tangent), feature, names, programmed.drilling_at(time_ns))


def _headings(tangent: np.ndarray) -> np.ndarray:
    upright = 1e-6  # horizontal part of a unit tangent below which the tool moves along the spindle
    level = np.hypot(tangent[:, 0], tangent[:, 1]) > upright
    if not level.any():
        return np.zeros(len(tangent))
    last = np.maximum.accumulate(np.where(level, np.arange(level.size), -1))
    rows = tangent[np.where(last < 0, np.argmax(level), last)]
    return np.arctan2(rows[:, 1], rows[:, 0])


def deviations(path: Stations, error: np.ndarray) -> np.ndarray:
    """Tangential, normal (to the left) and vertical part of actual minus target, both (n + 1, 3) [m]."""
    normal = np.sum(error[:, :2] * path.left, axis=1)
    return np.column_stack([np.sum(error * path.tangent, axis=1), normal, error[:, 2]])
