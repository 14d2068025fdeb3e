"""Checks of the cut: is anything removed, where does a rapid move do so, can the spindle do it."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.check_arm import runs
from kr270_milling.trajectory.limits import Finding, exceeding
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["cut_findings"]

#: share of the largest removal between two points that a rapid move may remove: an arm that springs back as the tool
#: lifts off shaves a little from the wall
SCRAPE = 0.02


def _inside(cell: Cell, position: np.ndarray) -> np.ndarray:
    """(n,) True where the tool's end reaches into the box of the stock."""
    low, high = cell.stock.min, cell.stock.max
    beside = position[:, :2] - np.clip(position[:, :2], low[:2], high[:2])
    return (np.hypot(*beside.T) < cell.tool.radii.max()) & (position[:, 2] < high[2] - 1e-9)


def cut_findings(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Finding]:
    """What the simulated pass along ``run`` shows, by the points of the program."""
    result = ran.result
    if not result.removed_volume > 0.0:
        return [Finding("stock missed", 1, 0.0, 0.0, "stop", "the path removes nothing from the stock")]
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
    rapid = into & np.concatenate([into[:1], into[:-1]]) & (removed > SCRAPE * removed.max())
    found = []
    for k, where in runs(rapid, removed):
        sentence = f"a rapid move cuts at {where}"
        found.append(Finding("rapid in material", k + 1, float(removed[k]), 0.0, "stop", sentence))
    return found
