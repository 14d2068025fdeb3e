"""Checks of the cut: is anything removed, do rapid moves or plunges meet material, can tool and spindle do it;
does it chatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.findings import Violation, stretches, violation, violations
from kr270_milling.simulation.milling_pass import PassResult
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Engagement", "Stability", "cut_violations", "engagement", "stability_of"]

NODES_PER_RADIUS = 50  #: of the height map; a contact narrower than a fiftieth of the radius is not seen
MOST_VISITS = 2e9  #: of nodes, about a nanosecond each; a longer path takes a coarser map
CORE = 0.2  #: share of the radius about the axis where a cutter that is not centre-cutting has no edge
PLUNGE = 0.5  #: sine of the slope below which a way down is a ramp: 30 deg
UNLIKELY_FEED = 0.25  #: of the diameter, a tooth: no cutter takes that, so a unit has slipped
FEWEST_TEETH = 60  #: in one stretch of cutting; fewer say nothing about growth
CHATTERS = 0.02  #: share of the feed per tooth, root mean square
#: limit over grid step per feed per tooth; the grid makes a stable pocket ring by 0.016 to 0.019 of it (measured at
#: steps of 0.25 to 2.5 feeds per tooth), so that the factor is two
GRID_NOISE = 0.04
GROWS = 1.5  #: ratio of the last third of a straight cut to the middle one
SMALL = 0.001  #: share of the feed per tooth below which growth is numerical noise


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
    length = cell.programmed.length
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


def cut_violations(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    """What the simulated pass along ``run``, and the programmed path in the stock, show; by the points of ``run``."""
    if not ran.result.removed_volume > 0.0:
        return [violation("stock missed", 0.0, 0.0, 1)]
    return _spindle(cell, run, ran) + _tool(cell) + _contacts(cell, run, _spring_back(cell, ran))


def _spring_back(cell: Cell, ran: ScoredPass) -> float:
    """[m], largest deflection while the tool feeds through material: what springs back when it lifts off shaves as
    much from a wall."""
    result = ran.result
    cutting = result.volume > 0.0
    cutting &= ~cell.programmed.rapid_at(result.time_ns)
    return float(np.max(np.linalg.norm(result.deflection[cutting, :3], axis=1), initial=0.0))


def _spindle(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    knot = np.clip(np.searchsorted(run.time_ns, ran.result.time_ns), 1, len(run) - 1)  # the one that is next
    torque = np.zeros(len(run))
    np.maximum.at(torque, knot, ran.result.torque)
    found = violations("spindle torque", torque, cell.limits.spindle_torque)
    return found + violations("spindle power", torque * cell.tool.spindle_speed, cell.limits.spindle_power)


def _tool(cell: Cell) -> list[Violation]:
    """Feed per tooth and cutting speed, from the fastest cutting move."""
    tool, found = cell.tool, []
    teeth_a_second = tool.spindle_speed / (2.0 * np.pi) * tool.teeth
    feed, speed = cell.feed_rate / teeth_a_second, tool.spindle_speed * tool.radius
    if tool.max_feed_per_tooth and feed > tool.max_feed_per_tooth:
        found.append(violation("feed per tooth", feed, tool.max_feed_per_tooth, most="the cutter takes"))
    elif feed > (unlikely := UNLIKELY_FEED * tool.diameter):
        most = "a quarter of the cutter's diameter"
        found.append(violation("feed per tooth", feed, unlikely, severity="warning", most=most))
    if tool.max_cutting_speed and speed > tool.max_cutting_speed:
        found.append(violation("cutting speed", speed, tool.max_cutting_speed))
    return found


def _contacts(cell: Cell, run: Trajectory, spring_back: float) -> list[Violation]:
    """What the tool meets along the programmed path: material at rapid, below the stock, fixtures."""
    low, high, radius = cell.stock.min, cell.stock.max, cell.tool.radii.max()
    margin, below, flutes = spring_back + cell.limits.rapid_contact, cell.limits.below_stock, cell.tool.flute_length
    met = engagement(cell, margin)
    #: the point of the program that each place of the path leads to, from 1
    points = np.clip(np.searchsorted(run.time, met.time - 1e-6), 0, len(run) - 1) + 1
    beneath = np.where(_over(met, low, high, radius), low[2] - met.position[:, 2], -np.inf)
    found = violations("rapid in material", met.inner, margin, met.rapid & (met.inner > margin), points=points)
    found += violations("below the stock", beneath, below, beneath > below + 1e-9, points=points)
    for number, (least, most) in enumerate(cell.workpiece.fixture_boxes, 1):
        inside = np.where(_over(met, least, most, radius), most[2] - met.position[:, 2], 0.0)
        found += violations(
            "in the fixture", inside, 0.0, inside > 0.0, points=points, subject=f"fixture {number}"
        )  # fmt: skip
    if flutes:
        found += violations("depth of cut", met.depth, flutes, met.depth > flutes, points=points)
    if not cell.tool.centre_cutting:
        depth, over = _plunges(met)
        found += violations("plunge", depth, 0.0, over, points=points)
    return found


def _over(met: Engagement, low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """Where the tool stands over or in a box, seen from above, (m,)."""
    beside = met.position[:, :2] - np.clip(met.position[:, :2], low[:2], high[:2])
    return np.hypot(*beside.T) < radius


def _plunges(met: Engagement) -> tuple[np.ndarray, np.ndarray]:
    """Steep ways down into material: depth of the whole way so far [m] and whether it is one, (m,) each."""
    move = np.diff(met.position, axis=0, prepend=met.position[:1])
    steep = -move[:, 2] > PLUNGE * np.linalg.norm(move, axis=1)
    over = steep & (met.core > 0.0)
    so_far = np.cumsum(np.where(over, met.core, 0.0))
    return so_far - np.maximum.accumulate(np.where(over, 0.0, so_far)), over


@dataclass(frozen=True)
class Stability:
    """What a pass says about chatter."""

    word: str  #: "stable", "chatter" or "no statement"
    residue: float  #: root mean square from tooth to tooth, a share of the feed per tooth; NaN without a statement
    limit: float = CHATTERS  #: the same share, from which on it is chatter

    @property
    def text(self) -> str:
        """One line."""
        if self.word == "no statement":
            return f"stability: no statement, no cut of {FEWEST_TEETH} teeth without a break"
        share = f"{100 * self.residue:.2g}" if self.residue >= SMALL else f"less than {100 * SMALL:g}"
        return f"stability: {self.word}, from tooth to tooth {share} % of the feed per tooth remain"

    def as_dict(self) -> dict:
        """For JSON."""
        return {"word": self.word, "residue_share": self.residue, "limit_share": self.limit}


def stability_of(cell: Cell, result: PassResult) -> Stability:
    """Does a pass chatter: what remains of the tool's motion from tooth to tooth in its worst stretch of cutting.

    Seen once a tooth period T, a stable cut repeats itself but for the slow swinging of the arm, whose fourth
    difference over teeth is small: A (w T)^4 / 16 for a swing of amplitude A and circular frequency w, 0.02 % of it at
    20 Hz and 533 teeth a second. A chattering cut does not repeat itself: its motion is no multiple of the tooth
    period and grows until the teeth leave the material, so that a straight cut is also judged by whether its residue
    grows. What swings slower than a tenth of the tooth frequency is left to the deviation.
    """
    period = 2.0 * np.pi / (cell.tool.spindle_speed * cell.tool.teeth)
    feed_per_tooth = cell.feed_rate * period
    limit = max(CHATTERS, GRID_NOISE * cell.stock.grid_step / max(feed_per_tooth, 1e-12))
    worst, grows, seconds = np.nan, False, result.time
    for first, last in stretches(result.volume > 0.0):
        time = seconds[first:last]
        teeth = np.arange(time[0], time[-1], period)
        if teeth.size < FEWEST_TEETH:
            continue
        at_teeth = np.stack([np.interp(teeth, time, result.deflection[first:last, k]) for k in range(2)], 1)
        residue = np.linalg.norm(np.diff(at_teeth, 4, axis=0), axis=1) / 16.0  # a motion that alternates counts whole
        parts = [float(np.sqrt(np.mean(part**2))) / feed_per_tooth for part in np.array_split(residue, 3)]
        worst = np.fmax(worst, parts[2])
        grows |= cell.programmed.straight and parts[2] > SMALL and parts[2] > GROWS * parts[1]
    if np.isnan(worst):
        return Stability("no statement", np.nan, limit)
    return Stability("chatter" if grows or worst > limit else "stable", float(worst), limit)
