"""Checks of the cut: is anything removed, do rapid moves or plunges meet material, can tool and spindle do it.

What the programmed path meets in the stock: depth of cut, rapid contact, material under the tool's middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.path_limits import Violation, exceeding, violations
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Engagement", "cut_violations", "engagement"]

NODES_PER_RADIUS = 50  #: of the height map; a contact narrower than a fiftieth of the radius is not seen
MOST_VISITS = 2e9  #: of nodes, about a nanosecond each; a longer path takes a coarser map
CORE = 0.2  #: share of the radius about the axis where a cutter that is not centre-cutting has no edge


@dataclass(frozen=True, eq=False)
class Engagement:
    """At m places along the programmed path, workpiece frame."""

    position: np.ndarray  #: tool tip [m], (m, 3)
    time: np.ndarray  #: [s], (m,)
    rapid: np.ndarray  #: on a rapid move, (m,)
    depth: np.ndarray  #: deepest material above the tip within the tool's radius [m], (m,)
    inner: np.ndarray  #: the same within the radius less ``margin`` [m], (m,)
    core: np.ndarray  #: the same about the tool's axis, (m,)


def engagement(cell: Cell, margin: float) -> Engagement:
    """Run the programmed path through the stock; margin [m]: contacts no deeper than that are not in ``inner``.

    The tool runs along its path without deflection through a coarse height map. That is blind to what the cut does to
    the arm, and so tells a fault of the program from the little that a springy arm shaves off when it lifts out.
    """
    position, time, rapid, step = _places(cell)
    low, high = cell.stock.min, cell.stock.max
    shape = np.maximum(1, np.ceil((high - low)[:2] / step)).astype(int)
    surface = np.full(tuple(shape), high[2])
    depth, inner, core = np.zeros((3, len(position)))
    radius = float(cell.tool.radii.max())
    radii = radius, max(radius - margin, 0.0), CORE * radius
    _mill(surface, low[:2] + step / 2, step, position, radii, margin, (depth, inner, core))
    return Engagement(position, time, rapid, depth, inner, core)


def _places(cell: Cell) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Tool tips, times and rapid flags half a node step apart, and the node step [m]."""
    target, timed = cell.target(), cell.timed_path
    radius = float(cell.tool.radii.max())
    length = timed.toolpath.length if timed else cell.path.length
    # length / (step / 2) places of pi (radius / step)^2 nodes each are to stay below MOST_VISITS
    step = max(radius / NODES_PER_RADIUS, (2.0 * np.pi * length * radius**2 / MOST_VISITS) ** (1.0 / 3.0))
    count = 2 + int(2.0 * length / step)
    if timed is None:
        time_ns = np.linspace(0, target.duration_ns, count).astype(np.int64)
        return target.sample(time_ns), time_ns * 1e-9, np.zeros(count, bool), step
    ends = np.cumsum(timed.toolpath.block_length)
    distance = np.sort(np.concatenate([np.linspace(0.0, timed.toolpath.length, count), ends[1:]]))  # every corner too
    block = np.clip(np.searchsorted(ends, distance), 1, len(ends) - 1)  # where two meet, the one that ends
    time = np.interp(distance, timed.distance_at(target.time_ns), target.time)
    return timed.toolpath.on_path(distance)[0], time, timed.toolpath.rapid[block], step


@njit(cache=True)
def _mill(surface, origin, step, position, radii, margin, found):
    """Lower the surface to the tool's end at each place, and note the deepest material that was there before."""
    depth, inner, core = found
    reach = int(radii[0] / step) + 1
    for k in range(position.shape[0]):
        x, y, z = position[k]
        middle_x, middle_y = int((x - origin[0]) / step), int((y - origin[1]) / step)
        for i in range(max(middle_x - reach, 0), min(middle_x + reach + 2, surface.shape[0])):
            away_x = origin[0] + i * step - x
            for j in range(max(middle_y - reach, 0), min(middle_y + reach + 2, surface.shape[1])):
                away = np.sqrt(away_x**2 + (origin[1] + j * step - y) ** 2)
                over = surface[i, j] - z
                if over <= 0.0 or away >= radii[0]:
                    continue
                depth[k] = max(depth[k], over)
                if away < radii[1] and over > margin:
                    inner[k] = max(inner[k], over)
                if away < radii[2]:
                    core[k] = max(core[k], over)
                surface[i, j] = z


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
