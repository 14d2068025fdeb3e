"""A measured wall against the predicted wall: table of places, prediction of the model, band of drawn plants."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.table import read_table
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_model_of, cut_of, path_of
from kr270_milling.cell.plant import imperfect_arm, imperfect_course, perturbed
from kr270_milling.decide.part.stations import stations_of
from kr270_milling.decide.part.surface import IdealPart, Walls, ideal_part, remaining_walls
from kr270_milling.decide.verdict import coarser
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult, run_pass
from kr270_milling.studies.identification.comparison import LinearFit, line_through

__all__ = ["BAND", "COLUMNS", "PLANTS", "WallComparison", "WallPlaces", "compare_wall", "read_wall"]

PLACE = ("x_mm", "y_mm")
COLUMNS = (*PLACE, "z_mm", "error_um", "sigma_um", "note")
FARTHEST = 2e-3  #: [m] from a place to the predicted wall
LARGEST = 5e-3  #: [m] of a measured error; more is a wrong unit
FEWEST = 3  #: places for a gain and an offset
NEAR = 5  #: points of the predicted wall, whose mean is the prediction
PLANTS = 16
BAND = (0.05, 0.95)


@dataclass(frozen=True, eq=False)
class WallPlaces:
    """n places of a wall, workpiece frame."""

    path: str
    lines: tuple[int, ...]  #: line of the file, (n,)
    place: np.ndarray  #: nominal [m], (n, 2)
    height: np.ndarray  #: z [m], (n,); NaN: not given
    error: np.ndarray  #: measured, along the normal, positive where material is left standing [m], (n,)
    sigma: np.ndarray  #: standard deviation of the measurement [m], (n,); 0: not given


@dataclass(frozen=True, eq=False)
class WallComparison:
    """Measured and predicted error of a wall at n places."""

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
    table.refuse(np.abs(error) > LARGEST, f"error_um must be in um and at most {1e6 * LARGEST:g}")
    table.refuse(sigma < 0.0, "sigma_um must be at least 0")
    if len(table) < FEWEST:
        raise InputError(path, f"has {len(table)} places, but a comparison needs at least {FEWEST}")
    place, height = 1e-3 * table.numbers(PLACE), 1e-3 * table.number("z_mm", np.nan)
    return WallPlaces(table.path, table.lines, place, height, error, sigma)


def compare_wall(
    cell: Cell, measured: WallPlaces, reference: Trajectory | None = None, plants: int = PLANTS, seed: int = 1,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> WallComparison:  # fmt: skip
    """Predict the wall of a pass along ``reference`` (default: the target) by the model and by drawn plants.

    Raises InputError where a place is farther than 2 mm from every predicted wall.
    """
    result = simulate(cell, reference).result
    ideal = ideal_part(cell, stations_of(path_of(cell), result.time_ns), result.target)
    predicted = _errors_at(measured, _walls(cell, result, ideal))
    nominal, rng = coarser(cell), np.random.default_rng(seed)
    drawn = [perturbed(nominal, rng) for _ in range(plants)]
    path, target = path_of(nominal), path_of(nominal).target
    known = target if reference is None else reference
    stamps = path.clock.stamp(np.arange(path.clock.steps(target.duration_ns) + 1))
    coarse = ideal_part(nominal, stations_of(path, stamps), target.sample(stamps))
    rows: list[np.ndarray] = []
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for row in pool.map(lambda plant: _plant_errors(plant, nominal, known, measured, coarse), drawn):
            rows.append(row)
            progress(len(rows), plants)
    noise = measured.sigma * rng.normal(size=(len(rows), len(predicted)))
    low, high = np.nanquantile(np.array(rows) + noise, BAND, axis=0)
    line = line_through(measured.error, predicted, len(predicted))
    return WallComparison(measured, predicted, low, high, plants, line)


def _plant_errors(plant: Cell, nominal: Cell, reference: Trajectory, measured: WallPlaces, ideal: IdealPart):
    """Errors of the wall of one plant [m], (n,); NaN where the plant fails."""
    try:
        arm = imperfect_arm(plant, reference, arm_model_of(plant, reference))
        course_of = imperfect_course(plant, reference, 0)
        clock, iterations, silent = path_of(plant).clock, plant.exchange.iterations, path_of(plant).drilling_at
        target = path_of(nominal).target
        result = run_pass(arm, cut_of(plant), clock, target, course_of, iterations, silent=silent)
        return _errors_at(measured, _walls(nominal, result, ideal))
    except MillingError:
        return np.full(len(measured.error), np.nan)


def _walls(cell: Cell, result: PassResult, ideal: IdealPart) -> Walls:
    path = stations_of(path_of(cell), result.time_ns)
    return remaining_walls(ideal.walls, path, result.actual - result.target, ideal.level)


def _errors_at(measured: WallPlaces, walls: Walls) -> np.ndarray:
    """Mean error [m], (n,), of the nearest points of the walls, at the height of the place where that is given."""
    if not walls.error.size:
        raise InputError(measured.path, "the pass of the cell leaves no wall that could be compared")
    out = np.empty(len(measured.error))
    tree = cKDTree(walls.position[:, :2])
    for k, (place, z) in enumerate(zip(measured.place, measured.height, strict=True)):
        distance, near = tree.query(place, k=min(8 * NEAR, walls.error.size), distance_upper_bound=FARTHEST)
        near = np.atleast_1d(near)[np.isfinite(np.atleast_1d(distance))]
        if np.isfinite(z):
            low = walls.position[near, 2]
            near = near[(low - 1e-5 <= z) & (z <= low + walls.height[near] + 1e-5)]
        if not near.size:
            reason = f"is farther than {1e3 * FARTHEST:g} mm from every wall that the cell leaves"
            raise InputError(measured.path, f"the place {1e3 * place[0]:g}, {1e3 * place[1]:g} mm {reason}",
                             measured.lines[k])  # fmt: skip
        out[k] = walls.error[near[:NEAR]].mean()
    return out
