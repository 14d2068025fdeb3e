"""Checks of the cut: does the path touch the stock, where does it do so in rapid, can the spindle do it."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell import Cell
from kr270_milling.checks.arm import runs
from kr270_milling.errors import InputError
from kr270_milling.passes import ScoredPass
from kr270_milling.trajectory.limits import Finding, exceeding
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["cut_findings", "demand_stock", "missed_stock"]


def missed_stock(cell: Cell, run: Trajectory) -> str | None:
    """The sentence about a path whose tool never comes into the stock, or None."""
    if _inside(cell, run.position).any():
        return None

    def extent(low, high) -> str:
        pairs = zip("xyz", 1e3 * low, 1e3 * high, strict=True)
        return ", ".join(f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in pairs)

    path = extent(run.position.min(axis=0), run.position.max(axis=0))
    stock = extent(cell.stock.min, cell.stock.max)
    return (
        f"the path never touches the stock: it goes through {path} mm, the stock fills {stock} mm; check the datum and "
        "the unit (G20, G21)"
    )


def demand_stock(cell: Cell) -> None:
    """Raise InputError, with the line of the first cutting move, for a path that never touches the stock.

    Told before the reach of the arm, which a path in the wrong unit misses as well.
    """
    fed = cell.fed_path
    sentence = missed_stock(cell, cell.target() if fed is None else fed.trajectory)
    if sentence is None:
        return
    if fed is None:
        raise InputError("path", sentence)
    cutting = np.flatnonzero(~fed.toolpath.rapid[1:]) + 1
    raise InputError(cell.path.file, sentence, int(fed.toolpath.line[cutting[0] if cutting.size else 0]))


def _inside(cell: Cell, position: np.ndarray) -> np.ndarray:
    """(n,) True where the tool's end reaches into the box of the stock."""
    low, high = cell.stock.min, cell.stock.max
    beside = position[:, :2] - np.clip(position[:, :2], low[:2], high[:2])
    return (np.hypot(*beside.T) < cell.tool.radii.max()) & (position[:, 2] < high[2] - 1e-9)


def cut_findings(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Finding]:
    """What the simulated pass along ``run`` shows, by the points of the program."""
    result = ran.result
    sentence = missed_stock(cell, run)
    if sentence is None and not result.removed_volume > 0.0:
        sentence = "the path removes nothing from the stock"
    if sentence is not None:
        return [Finding("stock missed", 1, 0.0, 0.0, "stop", sentence)]
    knot = np.clip(np.searchsorted(run.time_ns, result.time_ns), 1, len(run) - 1)  # the one that is next

    def most(values: np.ndarray) -> np.ndarray:
        largest = np.zeros(len(run))
        np.maximum.at(largest, knot, values)
        return largest

    torque, power = most(result.torque), most(result.torque * cell.tool.spindle_speed)
    found = exceeding("spindle torque", torque, cell.limits.spindle_torque, "the spindle torque", "N m")
    found += exceeding("spindle power", power, cell.limits.spindle_power, "the spindle power", "kW", 1e-3)
    deep = np.where(_inside(cell, run.position), cell.stock.min[2] - run.position[:, 2], 0.0)
    found += exceeding("below the stock", deep, 1e-9, "the depth of the tool below the stock", "mm", 1e3, "warning")
    if cell.timed_path is not None and len(cell.timed_path.block) == len(run):
        found += _rapid(cell, most(result.volume))
    return found


def _rapid(cell: Cell, removed: np.ndarray) -> list[Finding]:
    """removed [m^3], (n,): on the way to each point."""
    timed = cell.timed_path
    into = timed.toolpath.rapid[timed.block]  # both ends in rapid moves: a knot where a cut ends belongs to either
    rapid = into & np.concatenate([into[:1], into[:-1]]) & (removed > 0.0)
    found = []
    for k, where in runs(rapid, removed):
        sentence = f"a rapid move cuts at {where}"
        found.append(Finding("rapid in material", k + 1, float(removed[k]), 0.0, "stop", sentence))
    return found
