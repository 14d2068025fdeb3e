"""The part as machined, thinned for a picture: height, and the error of floors and walls; largest errors are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.stations import envelope_index

__all__ = ["PartSurface", "PassSurface", "part_surface"]

MOST_CELLS = 120  #: along the longer side
WALL_BUCKETS = 400


@dataclass(frozen=True, eq=False)
class PassSurface:
    """Errors that one pass leaves; positive: material is left standing."""

    name: str
    floor: np.ndarray  #: [um], (b, a), rows along y; NaN: no floor
    wall: np.ndarray  #: [um], (w,), at the walls of PartSurface


@dataclass(frozen=True, eq=False)
class PartSurface:
    """Axes of the workpiece frame [mm]."""

    x: np.ndarray  #: (a,)
    y: np.ndarray  #: (b,)
    z: np.ndarray  #: height of the part, (b, a)
    wall_x: np.ndarray  #: (w,)
    wall_y: np.ndarray
    wall_z: np.ndarray  #: of the upper edge
    passes: tuple[PassSurface, ...]


def part_surface(parts: Sequence[PartAssessment]) -> PartSurface:
    """The surfaces of all passes on one thinned grid; each cell shows its largest floor error."""
    first = parts[0].surface
    share = max(1, -(-max(first.floors.height.shape) // MOST_CELLS))
    x, y = (_blocks(axis[None], (1, share), np.mean)[0] * 1e3 for axis in (first.floors.x, first.floors.y))
    height = _blocks(first.floors.height, (share, share), np.mean) * 1e3
    same = [part for part in parts if part.surface.walls.error.size == first.walls.error.size]
    chosen = _wall_rows([part.surface.walls.error for part in same])
    place = first.walls.position[chosen] * 1e3
    place[:, 2] += first.walls.height[chosen] * 1e3
    passes = []
    for part in parts:
        floor = _blocks(part.surface.floors.error, (share, share), _largest).T * 1e6
        walls = part.surface.walls.error
        error = walls[chosen] * 1e6 if part in same else np.full(chosen.size, np.nan)
        passes.append(PassSurface(part.name, floor, error))
    return PartSurface(x, y, height.T, place[:, 0], place[:, 1], place[:, 2], tuple(passes))


def _wall_rows(errors: Sequence[np.ndarray]) -> np.ndarray:
    if not errors[0].size:
        return np.zeros(0, np.int64)
    return np.unique(np.concatenate([envelope_index(error, WALL_BUCKETS) for error in errors]))


def _blocks(values: np.ndarray, share: tuple[int, int], reduce) -> np.ndarray:
    """reduce over blocks of share[0] x share[1] cells; those at the far edges may be smaller."""
    rows, columns = (-(-n // s) for n, s in zip(values.shape, share, strict=True))
    padded = np.full((rows * share[0], columns * share[1]), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    blocks = padded.reshape(rows, share[0], columns, share[1]).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    if reduce is np.mean:
        return np.nanmean(blocks, axis=-1)
    return reduce(blocks)


def _largest(blocks: np.ndarray) -> np.ndarray:
    """The value of the largest magnitude, with its sign; NaN where there is none."""
    size = np.where(np.isnan(blocks), -1.0, np.abs(blocks))
    best = np.argmax(size, axis=-1)
    return np.take_along_axis(blocks, best[..., None], axis=-1)[..., 0]
