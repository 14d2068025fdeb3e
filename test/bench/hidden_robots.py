"""Parts of hidden robots: error as programmed, with ``robust``, and after one and two measured parts.

    python test/bench/hidden_robots.py CELL.yaml [--robots 30] [--seed 7] [--set KEY=VALUE ...]

A hidden robot is drawn from ``uncertainty`` of the cell: tilting base, lag and dead time, backlash, worn tool, joining.
Every second one cuts by the other force law, which no robot of the cell has, with the same force at the mean chip.
Twenty places of its part are measured, with 5 um. The next program is that of ``compensate --measured``. Printed are
the largest wall and floor error of each part, and the share of the places of the next part within the 90 % band of the
robots that were learned, with the stated errors of measurement and model.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import coarser, perturbed
from kr270_milling.decide.compensation import better_program
from kr270_milling.decide.part.assessment import gauge_of
from kr270_milling.decide.verdict import run_sample
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.studies.identification.measured_part import MODEL_ERROR, MODEL_SHARE, learn
from kr270_milling.studies.identification.wall import BAND, PredictedPlaces, WallPlaces, robot_errors

SIGMA = 5e-6  # [m] of a measured place
LAW = {"stiffness": 5e6, "specific_chip_thickness": 18e-6, "ratio": 0.1, "radial_ratio": 0.3}  # [Klimchik2014]
DRAWN = 16  # robots of a band


def places_of(x: float = 20e-3, on_walls: int = 12, on_floor: int = 8) -> WallPlaces:
    """Places of a square pocket of the outline +-x: three on each wall, the others on the path of the centre."""
    along = np.array([-0.425 * x, 0.0, 0.425 * x])  # near the corners, where an arm swings most
    walls = [p for a in along for p in ((x, a), (-x, a), (a, x), (a, -x))][:on_walls]
    half = 0.5 * x
    floor = [(half, -0.8 * half), (half, 0), (half, 0.8 * half), (0, half), (-0.8 * half, half), (-half, 0),
             (-half, -0.8 * half), (0, -half)][:on_floor]  # fmt: skip
    place = np.array(walls + floor)
    n = len(place)
    return WallPlaces("measured.csv", tuple(range(2, n + 2)), place, np.full(n, np.nan), np.zeros(n),
                      np.full(n, SIGMA), np.arange(n) >= on_walls)  # fmt: skip


def hidden_robots(cell: Cell, count: int, seed: int) -> list[Cell]:
    """Robots of the cell; every second one cuts by the fractional law with the same force at the mean chip."""
    model, rng, robots = coarser(cell), np.random.default_rng(seed), []
    chip = (
        0.64 * float(path_of(cell).fed.toolpath.feed.max()) / (cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth)
    )  # mean of a slot, 2 / pi of the feed per tooth
    for k in range(count):
        robot = perturbed(model, rng)
        if k % 2:
            own = robot.cutting.active.per_depth(chip)
            law = robot.cutting.fractional.replace(**LAW)
            size = own[0] / law.per_depth(chip)[0]
            law = law.replace(stiffness=float(size * law.stiffness), radial_ratio=float(own[1] / own[0]),
                              axial_ratio=float(own[2] / own[0]))  # fmt: skip
            robot = robot.replace(cutting=robot.cutting.replace(law="fractional", fractional=law))
        robots.append(robot)
    return robots


def plan(cell: Cell, former: Trajectory | None = None) -> Trajectory:
    """Return the reference of ``robust`` by quick passes, or the one that is better for the learned robots."""
    quick = coarser(cell)
    new = compensated(quick, simulate(quick), "robust").reference
    return new if former is None else better_program(cell, former, new)[0]


def parts_of(cell: Cell, robot: Cell, first: Trajectory, parts: int, rng: np.random.Generator):
    """Errors [m] of a robot as programmed, along the first program, after each measured part; and shares in bands."""
    target, model, gauge = path_of(cell).target, coarser(cell), gauge_of(coarser(cell))
    places = places_of()
    at = PredictedPlaces(model, places)
    errors, inside, reference, measured = [], [], first, []
    errors += [float(run_sample(robot, target, (run,), gauge)[0, 0]) for run in (target, first)]  # of the same shift
    for number in range(1, parts + 1):
        (true,) = robot_errors([robot], model, [(reference, at)])
        measured.append(
            (dataclasses.replace(places, error=true + SIGMA * rng.normal(size=true.size)), reference, "part")
        )
        learned = learn(cell, measured).cell
        reference = plan(learned, reference)
        drawn = [perturbed(coarser(learned), rng) for _ in range(DRAWN)]
        rows = np.array(list(robot_errors(drawn, model, [(reference, at)])))
        robot = robot.replace(imperfections=robot.imperfections.replace(first_pass=number))  # another shift
        (true,) = robot_errors([robot], model, [(reference, at)])
        noise = np.hypot(SIGMA, MODEL_ERROR) * rng.normal(size=rows.shape)
        noise += MODEL_SHARE * rng.normal(size=(len(rows), len(rows))) @ rows / np.sqrt(len(rows))
        low, high = np.nanquantile(rows + noise, BAND, axis=0)
        seen = true + SIGMA * rng.normal(size=true.size)
        inside.append(float(np.mean((low <= seen) & (seen <= high))))
        errors.append(float(run_sample(robot, target, (reference,), gauge)[0, 0]))
    return errors, inside


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cell")
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--parts", type=int, default=2)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--first", type=int, default=0, help="robots to leave out")
    parser.add_argument("--set", action="append", default=[])
    args = parser.parse_args()
    cell = read_cell(args.cell, args.set)
    first, rows, bands = plan(cell), [], []
    for k, robot in enumerate(hidden_robots(cell, args.robots, args.seed)):
        if k < args.first:
            continue
        try:
            errors, inside = parts_of(cell, robot, first, args.parts, np.random.default_rng([args.seed, k]))
        except MillingError as error:
            print(f"{k:3d} refused: {error}", flush=True)
            continue
        rows.append(errors)
        bands.append(inside)
        shown = " ".join(f"{1e6 * e:7.1f}" for e in errors)
        print(
            f"{k:3d} {robot.cutting.law[:4]} {shown}   in the band {' '.join(f'{b:.2f}' for b in inside)}", flush=True
        )
    table, inside = np.array(rows), np.array(bands)
    median = np.median(table, axis=0)
    print("median [um]:", " ".join(f"{1e6 * m:.1f}" for m in median))
    print("share of as programmed, median of robots:", " ".join(f"{m:.2f}" for m in np.median(table / table[:, :1], 0)))
    print("worse than as programmed:", np.sum(table > table[:, :1], axis=0)[1:])
    print("worse than the first program:", np.sum(table > table[:, 1:2], axis=0)[2:])
    print("in the band:", " ".join(f"{m:.2f}" for m in inside.mean(axis=0)))


if __name__ == "__main__":
    main()
