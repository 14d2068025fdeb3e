"""Checks of the cut: is anything removed, do rapid moves or plunges meet material, can tool and spindle do it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.engagement import Engagement, engagement
from kr270_milling.decision.path_limits import Violation, exceeding, violations
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["cut_violations"]

Stops = Callable[..., list[Violation]]

PLUNGE = 0.5  #: sine of the slope below which a way down is a ramp: 30 deg
UNLIKELY_FEED = 0.25  #: of the diameter, a tooth: no cutter takes that, so a unit has slipped


def cut_violations(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    """What the simulated pass along ``run``, and the programmed path in the stock, show; by the points of ``run``."""
    result = ran.result
    if not result.removed_volume > 0.0:
        return [Violation("stock missed", 1, 0.0, 0.0, "stop", "the path removes nothing from the stock")]
    margin = _spring_back(cell, ran) + cell.limits.rapid_contact
    met = engagement(cell, margin)
    #: the point of the program that each place of the path leads to, from 1
    points = np.clip(np.searchsorted(run.time, met.time - 1e-6), 0, len(run) - 1) + 1

    def stops(kind: str, over: np.ndarray, deep: np.ndarray, limit: float, text: str, subject: str = "", **more):
        """text: with {deep} for the depth in mm and {point} for its point."""

        def sentence(k: int, point: int, where: str) -> str:
            return text.format(deep=f"{1e3 * deep[k]:.4g}", point=point)

        return violations(kind, over, deep, limit, sentence, subject=subject, points=points, **more)

    found = _spindle(cell, run, ran) + _tool(cell)
    over = met.rapid & (met.inner > margin)
    text = "a rapid move goes through material {deep} mm deep at point {point}"
    found += stops("rapid in material", over, met.inner, margin, text)
    found += _below(cell, met, stops) + _fixtures(cell, met, stops)
    if flutes := cell.tool.flute_length:
        text = f"the cut is {{deep}} mm deep at point {{point}}, the flutes are {1e3 * flutes:.4g} mm"
        found += stops("depth of cut", met.depth > flutes, met.depth, flutes, text)
    return found + ([] if cell.tool.centre_cutting else _plunges(met, stops))


def _spring_back(cell: Cell, ran: ScoredPass) -> float:
    """[m], largest deflection while the tool feeds through material: what springs back when it lifts off shaves as
    much from a wall."""
    result = ran.result
    cutting = result.volume > 0.0
    if cell.timed_path is not None:
        cutting &= ~cell.timed_path.toolpath.rapid[cell.timed_path.block_at(result.time_ns)]
    return float(np.max(np.linalg.norm(result.deflection[cutting, :3], axis=1), initial=0.0))


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


def _over(met: Engagement, low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """Where the tool stands over or in a box, seen from above, (m,)."""
    beside = met.position[:, :2] - np.clip(met.position[:, :2], low[:2], high[:2])
    return np.hypot(*beside.T) < radius


def _below(cell: Cell, met: Engagement, stops: Stops) -> list[Violation]:
    low, allowed = cell.stock.min, cell.limits.below_stock
    inside = _over(met, low, cell.stock.max, cell.tool.radii.max())
    deep = np.where(inside, low[2] - met.position[:, 2], -np.inf)
    text = "the tool is {deep} mm below the bottom of the stock at point {point}"
    return stops("below the stock", deep > allowed + 1e-9, deep, allowed, text)


def _fixtures(cell: Cell, met: Engagement, stops: Stops) -> list[Violation]:
    found = []
    for number, (low, high) in enumerate(cell.workpiece.fixture_boxes, 1):
        deep = np.where(_over(met, low, high, cell.tool.radii.max()), high[2] - met.position[:, 2], 0.0)
        text = f"the tool enters fixture {number} at point {{point}}, {{deep}} mm below its top"
        found += stops("in the fixture", deep > 0.0, deep, 0.0, text, f"fixture {number}")
    return found


def _plunges(met: Engagement, stops: Stops) -> list[Violation]:
    """Steep ways down into material of a cutter that has no edge in its middle; the depth is that of the whole way."""
    move = np.diff(met.position, axis=0, prepend=met.position[:1])
    steep = -move[:, 2] > PLUNGE * np.linalg.norm(move, axis=1)
    over = steep & (met.core > 0.0)
    so_far = np.cumsum(np.where(over, met.core, 0.0))
    deep = so_far - np.maximum.accumulate(np.where(over, 0.0, so_far))
    text = "the cutter plunges {deep} mm into material at point {point}, but it is not centre-cutting"
    return stops("plunge", over, deep, 0.0, text)
