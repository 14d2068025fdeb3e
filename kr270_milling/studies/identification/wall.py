"""Measured walls and floors against the predicted ones: table of places, prediction of the model, band of robots."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from kr270_milling.base.column import counted
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.table import read_table
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import at_once
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import Plant, coarser, perturbed
from kr270_milling.decide.part.surface import ideal_part, neighbours, remaining_walls, stations_of, tooth_tips
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.studies.identification.comparison import LinearFit, line_through

PLACE = ("x_mm", "y_mm")
COLUMNS = (*PLACE, "z_mm", "error_um", "sigma_um", "surface", "note")
FEWEST = 3  #: places for a gain and an offset
BAND = (0.05, 0.95)


@dataclass(frozen=True, eq=False)
class WallPlaces:
    """n places of walls and floors, workpiece frame."""

    path: str
    lines: tuple[int, ...]  #: line of the file, (n,)
    place: np.ndarray  #: nominal [m], (n, 2)
    height: np.ndarray  #: z [m], (n,); NaN: not given
    error: np.ndarray  #: measured, along the normal, positive where material is left standing [m], (n,)
    sigma: np.ndarray  #: standard deviation of the measurement [m], (n,); 0: not given
    floor: np.ndarray  #: on a floor, (n,) bool; else on a wall


@dataclass(frozen=True, eq=False)
class WallComparison:
    """Measured and predicted errors at n places."""

    measured: WallPlaces
    predicted: np.ndarray  #: error by the model [m], (n,)
    low: np.ndarray  #: 5 % of the plants, with the noise of the measurement [m], (n,)
    high: np.ndarray  #: 95 % [m], (n,)
    plants: int  #: drawn
    line: LinearFit  #: measured = gain * predicted + offset

    @property
    def inside(self) -> np.ndarray:
        """Measured errors in their band, (n,) bool."""
        return (self.low <= self.measured.error) & (self.measured.error <= self.high)


def read_wall(path) -> WallPlaces:
    """Read a CSV file of places, one a row; the columns are COLUMNS. Raises InputError."""
    table = read_table(path, COLUMNS, (*PLACE, "error_um"))
    error, sigma = 1e-6 * table.number("error_um"), 1e-6 * table.number("sigma_um", 0.0)
    largest = 5e-3  # [m] of a measured error; more is a wrong unit
    table.refuse(np.abs(error) > largest, f"error_um must be in um and at most {1e6 * largest:g}")
    table.refuse(sigma < 0.0, "sigma_um must be at least 0")
    surface = np.array(table.texts("surface") if "surface" in table else [""] * len(table))
    surfaces = ("wall", "floor")
    table.refuse(~np.isin(surface, ("", *surfaces)), f"surface must be one of {', '.join(surfaces)}; empty: wall")
    if len(table) < FEWEST:
        raise InputError(path, f"has {counted(len(table), 'place')}, but a comparison needs at least {FEWEST}")
    place, height = 1e-3 * table.numbers(PLACE), 1e-3 * table.number("z_mm", np.nan)
    return WallPlaces(table.path, table.lines, place, height, error, sigma, surface == "floor")


class PredictedPlaces:
    """Predicts the errors at measured places from passes along the path of a cell.

    Raises InputError where a place is farther than 2 mm from every predicted wall, or on no floor.
    """

    def __init__(self, cell: Cell, measured: WallPlaces):
        path = path_of(cell)
        stamps = path.clock.stamp(np.arange(path.clock.steps(path.target.duration_ns) + 1))
        self.measured, self._path = measured, stations_of(path, stamps)
        self._ideal = ideal_part(cell, self._path, path.target.sample(stamps))
        staying = self._ideal.marks[self._ideal.staying]
        if not len(staying) and not measured.floor.all():
            raise InputError(measured.path, "the pass of the cell leaves no wall that could be compared")
        self.normal = np.zeros((len(measured.error), 3))  #: out of the material
        tree, self._near = (cKDTree(tooth_tips(staying)) if len(staying) else None), []
        for k in range(len(measured.error)):
            near = self._floor(k) if measured.floor[k] else self._wall(k, tree, staying["centre"][:, 2])
            self._near.append(near)
            self.normal[k] = (0.0, 0.0, 1.0) if measured.floor[k] else (*-staying["normal"][near].mean(axis=0), 0.0)
        on_walls = [near for near, floor in zip(self._near, measured.floor, strict=True) if not floor]
        used = np.unique(np.concatenate([np.zeros(0, int), *on_walls]))
        ideal, near = self._ideal, self._ideal.staying[used]
        self._used = dataclasses.replace(
            ideal,
            staying=near,
            wall_height=ideal.wall_height[used],
            near=neighbours(ideal.marks, near, 2.0 * ideal.level),
        )
        self._near = [
            n if floor else np.searchsorted(used, n) for n, floor in zip(self._near, measured.floor, strict=True)
        ]

    def _wall(self, k: int, tree: cKDTree, bottom: np.ndarray) -> np.ndarray:
        """Indices of the nearest points of the walls, at the height of the place where that is given."""
        z, height = self.measured.height[k], self._ideal.wall_height
        farthest = 2e-3  # [m] from a place to the predicted wall
        nearest = 5  # points of the predicted wall, whose mean is the prediction
        distance, near = tree.query(
            self.measured.place[k], k=min(8 * nearest, bottom.size), distance_upper_bound=farthest
        )
        near = np.atleast_1d(near)[np.isfinite(np.atleast_1d(distance))]
        if np.isfinite(z):
            near = near[(bottom[near] - 1e-5 <= z) & (z <= bottom[near] + height[near] + 1e-5)]
        if not near.size:
            self._refuse(k, f"is farther than {1e3 * farthest:g} mm from every wall that the cell leaves")
        return near[:nearest]

    def _floor(self, k: int) -> np.ndarray:
        """Indices of the level nodes around a place, in the map as one row."""
        ideal, (x, y) = self._ideal, self.measured.place[k]
        patch = 1e-3  # [m], radius of the floor whose median is the prediction: the ball of a probe
        near = np.hypot(ideal.x[:, None] - x, ideal.y - y) <= patch
        depth = ideal.height[near]
        level = near & ~ideal.unjudged & (ideal.owner >= 0)
        if depth.size:
            level &= np.abs(ideal.height - np.median(depth)) <= 2.0 * ideal.level
        if not level.any():
            self._refuse(k, "is on no floor that the cell mills")
        return np.flatnonzero(level)

    def _refuse(self, k: int, reason: str) -> None:
        x, y = 1e3 * self.measured.place[k]
        raise InputError(self.measured.path, f"the place {x:g}, {y:g} mm {reason}", self.measured.lines[k])

    def errors(self, result: PassResult) -> np.ndarray:
        """Errors [m], (n,), of a pass; with places on floors it needs ``result.heights``."""
        walls = remaining_walls(self._used, self._path, result.actual - result.target).error
        rise = np.zeros(0) if result.heights is None else (result.heights - self._ideal.height).ravel()
        pairs = zip(self._near, self.measured.floor, strict=True)
        return np.array([np.median(rise[near]) if floor else walls[near].mean() for near, floor in pairs])


def compare_wall(
    cell: Cell, measured: WallPlaces, reference: Trajectory | None = None, plants: int = 16,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> WallComparison:  # fmt: skip
    """Predict the wall of a pass along ``reference`` (default: the target) by the model and by drawn plants.

    Raises InputError as ``PredictedPlaces`` does.
    """
    predicted = _errors(cell, cell, reference, PredictedPlaces(cell, measured))
    nominal, rng = coarser(cell), np.random.default_rng(1)
    drawn, places = [perturbed(nominal, rng) for _ in range(plants)], PredictedPlaces(nominal, measured)
    rows: list[np.ndarray] = []
    for row in robot_errors(drawn, nominal, [(reference, places)]):
        rows.append(row)
        progress(len(rows), plants)
    noise = measured.sigma * rng.normal(size=(len(rows), len(predicted)))
    low, high = np.nanquantile(np.array(rows) + noise, BAND, axis=0)
    line = line_through(measured.error, predicted, len(predicted))
    return WallComparison(measured, predicted, low, high, plants, line)


def robot_errors(
    robots: Iterable[Cell], cell: Cell, parts: Sequence[tuple[Trajectory | None, PredictedPlaces]]
) -> Iterator[np.ndarray]:
    """Errors [m], (n,), that each robot leaves at places of the parts of a cell; NaN for a robot that fails.

    parts: the reference that was run, None: the target, and the places of each part.
    """

    def errors(robot: Cell) -> np.ndarray:
        try:
            return np.concatenate([_errors(robot, cell, reference, places) for reference, places in parts])
        except MillingError:
            return np.full(sum(places.normal.shape[0] for _, places in parts), np.nan)

    with ThreadPoolExecutor(at_once(path_of(cell))) as pool:
        yield from pool.map(errors, robots)


def _errors(robot: Cell, cell: Cell, reference: Trajectory | None, places: PredictedPlaces) -> np.ndarray:
    """Errors [m], (n,), that a robot leaves at places of the part of a cell; raises MillingError where it fails."""
    reference = path_of(cell).target if reference is None else reference
    return places.errors(Plant(cell, robot).run(reference, heights=bool(places.measured.floor.any())))
