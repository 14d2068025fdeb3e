"""Checks of the cut: is anything removed, do rapid moves or plunges meet material, can tool and spindle do it."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.check_arm import runs
from kr270_milling.decision.engagement import Engagement, engagement
from kr270_milling.decision.path_limits import Violation, exceeding
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["cut_violations"]

PLUNGE = 0.5  #: sine of the slope below which a way down is a ramp: 30 deg
UNLIKELY_FEED = 0.25  #: of the diameter, a tooth: no cutter takes that, so a unit has slipped


def cut_violations(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    """What the simulated pass along ``run``, and the programmed path in the stock, show; by the points of ``run``."""
    result = ran.result
    if not result.removed_volume > 0.0:
        return [Violation("stock missed", 1, 0.0, 0.0, "stop", "the path removes nothing from the stock")]
    found = _spindle(cell, run, ran) + _tool(cell)
    # what springs back when the tool lifts off shaves as much from a wall
    spring_back = float(np.max(np.linalg.norm(result.deflection[:, :3], axis=1)))
    margin = spring_back + cell.limits.rapid_contact
    met = engagement(cell, margin)
    found += _rapid(run, met, margin) + _below(cell, run, met) + _fixtures(cell, run, met)
    return found + _flutes(cell, run, met) + _plunges(cell, run, met)


def _points(run: Trajectory, met: Engagement) -> np.ndarray:
    """The point of the program that each place of the path leads to, from 1."""
    return np.clip(np.searchsorted(run.time, met.time - 1e-9), 0, len(run) - 1) + 1


def _worst(run: Trajectory, met: Engagement, over: np.ndarray, badness: np.ndarray) -> list[tuple[int, int]]:
    """For each stretch of the path where ``over``: its worst place and the point of the program there."""
    points = _points(run, met)
    return [(k, int(points[k])) for k, _ in runs(over, badness)]


def _spindle(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    result = ran.result
    knot = np.clip(np.searchsorted(run.time_ns, result.time_ns), 1, len(run) - 1)  # the one that is next

    def most(values: np.ndarray) -> np.ndarray:
        largest = np.zeros(len(run))
        np.maximum.at(largest, knot, values)
        return largest

    torque, power = most(result.torque), most(result.torque * cell.tool.spindle_speed)
    found = exceeding("spindle torque", torque, cell.limits.spindle_torque, "the spindle torque", "N m")
    return found + exceeding("spindle power", power, cell.limits.spindle_power, "the spindle power", "kW", 1e-3)


def _tool(cell: Cell) -> list[Violation]:
    """Feed per tooth and cutting speed, from the fastest cutting move."""
    tool, found = cell.tool, []
    teeth_a_second = tool.spindle_speed / (2.0 * np.pi) * tool.teeth
    feed, speed = cell.feed_rate / teeth_a_second, tool.spindle_speed * tool.radius
    if tool.max_feed_per_tooth and feed > tool.max_feed_per_tooth:
        sentence = f"{1e3 * feed:.4g} mm a tooth, but the cutter takes {1e3 * tool.max_feed_per_tooth:.4g} mm"
        found.append(Violation("feed per tooth", None, feed, tool.max_feed_per_tooth, "stop", sentence))
    elif feed > UNLIKELY_FEED * tool.diameter:
        sentence = f"{1e3 * feed:.4g} mm a tooth is more than a quarter of the cutter's diameter"
        found.append(Violation("feed per tooth", None, feed, UNLIKELY_FEED * tool.diameter, "warning", sentence))
    if tool.max_cutting_speed and speed > tool.max_cutting_speed:
        sentence = f"the teeth run at {60 * speed:.4g} m/min, but the cutter takes {60 * tool.max_cutting_speed:.4g}"
        found.append(Violation("cutting speed", None, speed, tool.max_cutting_speed, "stop", sentence))
    return found


def _rapid(run: Trajectory, met: Engagement, margin: float) -> list[Violation]:
    found = []
    for k, point in _worst(run, met, met.rapid & (met.inner > margin), met.inner):
        sentence = f"a rapid move goes through material {1e3 * met.inner[k]:.4g} mm deep at point {point}"
        found.append(Violation("rapid in material", point, float(met.inner[k]), margin, "stop", sentence))
    return found


def _below(cell: Cell, run: Trajectory, met: Engagement) -> list[Violation]:
    low, high, allowed = cell.stock.min, cell.stock.max, cell.limits.below_stock
    beside = met.position[:, :2] - np.clip(met.position[:, :2], low[:2], high[:2])
    inside = np.hypot(*beside.T) < cell.tool.radii.max()
    deep = np.where(inside, low[2] - met.position[:, 2], -np.inf)
    found = []
    for k, point in _worst(run, met, deep > allowed + 1e-9, deep):
        sentence = f"the tool is {1e3 * deep[k]:.4g} mm below the bottom of the stock at point {point}"
        found.append(Violation("below the stock", point, float(deep[k]), allowed, "stop", sentence))
    return found


def _fixtures(cell: Cell, run: Trajectory, met: Engagement) -> list[Violation]:
    found = []
    for number, (low, high) in enumerate(cell.workpiece.fixture_boxes, 1):
        beside = met.position[:, :2] - np.clip(met.position[:, :2], low[:2], high[:2])
        over = (np.hypot(*beside.T) < cell.tool.radii.max()) & (met.position[:, 2] < high[2])
        deep = np.where(over, high[2] - met.position[:, 2], 0.0)
        for k, point in _worst(run, met, over, deep):
            sentence = f"the tool enters fixture {number} at point {point}, {1e3 * deep[k]:.4g} mm below its top"
            found.append(Violation("in the fixture", point, float(deep[k]), 0.0, "stop", sentence, f"fixture {number}"))
    return found


def _flutes(cell: Cell, run: Trajectory, met: Engagement) -> list[Violation]:
    flutes = cell.tool.flute_length
    found = []
    for k, point in _worst(run, met, met.depth > flutes, met.depth) if flutes else []:
        sentence = f"the cut is {1e3 * met.depth[k]:.4g} mm deep at point {point}, the flutes are {1e3 * flutes:.4g} mm"
        found.append(Violation("depth of cut", point, float(met.depth[k]), flutes, "stop", sentence))
    return found


def _plunges(cell: Cell, run: Trajectory, met: Engagement) -> list[Violation]:
    """Steep ways down into material of a cutter that has no edge in its middle."""
    if cell.tool.centre_cutting:
        return []
    move = np.diff(met.position, axis=0, prepend=met.position[:1])
    steep = -move[:, 2] > PLUNGE * np.linalg.norm(move, axis=1)
    found = []
    for k, point in _worst(run, met, steep & (met.core > 0.0), met.core):
        sentence = f"the cutter plunges into material at point {point}, but it is not centre-cutting"
        found.append(Violation("plunge", point, float(met.core[k]), 0.0, "stop", sentence))
    return found
