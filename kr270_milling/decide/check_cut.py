"""Checks of the cut: is anything removed, do rapid moves or plunges meet material, can tool and spindle do it;
does vibration grow in the simulated pass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decide.findings import Violation, stretches, violation, violations
from kr270_milling.decide.height_map import ROUNDING, height_map, lower, lower_along, on_map
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.physics.motion.stability import has_uniform_pitch

__all__ = [
    "Engagement",
    "Residue",
    "contact_violations",
    "cut_violations",
    "engagement",
    "rapid_violations",
    "residue_of",
    "spring_back",
]

NODES_PER_RADIUS = 50  #: of the height map, along its axes
MOST_VISITS = 2e9  #: of nodes, about a nanosecond each; a longer path takes a coarser map
MOST_NODES = 2e7  #: of the height map; a small cutter in a large stock takes a coarser map
CORE = 0.2  #: share of the radius about the axis where a cutter that is not centre-cutting has no edge
PLUNGE = 0.5  #: sine of the slope below which a way down is a ramp: 30 deg
UNLIKELY_FEED = 0.25  #: of the diameter, a tooth: no cutter takes that, so a unit has slipped
FEWEST_TEETH = 60  #: in one stretch of cutting; fewer say nothing about growth
#: share of the feed per tooth, median of the thirds of ``FEWEST_TEETH``: measured up to 0.11 in sound cuts of 8 to
#: 80 um a tooth, mostly noise of the grid in thin chips, and 0.19 to 8 where teeth leave the material in chatter
CHATTERS = 0.15
GRID_NOISE = (
    0.4  #: ``CHATTERS`` per grid step per feed per tooth: larger where the grid is no finer than ``init`` writes
)
LASTS = 2.0 / 3.0  #: share of the vibration that a third of ``FEWEST_TEETH`` later is left, less dies out
GROWS = 1.5  #: ratio of one third of a stretch to the third before
SURE = 0.2  #: share of the limit below which growth may be noise
SMALL = 0.001  #: share of the feed per tooth that is printed as a number


@dataclass(frozen=True, eq=False)
class Engagement:
    """At m places along the programmed path, workpiece frame."""

    position: np.ndarray  #: tool tip [m], (m, 3)
    time: np.ndarray  #: [s], (m,)
    rapid: np.ndarray  #: on a rapid move, (m,)
    block: np.ndarray  #: of the tool path that leads to the place, (m,)
    series: np.ndarray  #: number of the rapid moves between two cutting moves, from 1; 0: a cutting move; (m,)
    depth: np.ndarray  #: deepest material above the tip within the tool's radius [m], (m,)
    inner: np.ndarray  #: deepest material that a rapid move meets within the radius less ``margin`` [m], (m,)
    core: np.ndarray  #: deepest material above the tip about the tool's axis [m], (m,)
    margin: float  #: [m]
    volume: np.ndarray  #: that rapid moves remove on the way to the place [m^3], (m,)


def engagement(cell: Cell, margin: float, ran: ScoredPass | None = None) -> Engagement:
    """Run the programmed path through the stock on a height map of nodes; default: without deflection.

    ``inner`` compares the rapid moves between two cutting moves, as a whole, with the material before the first of
    them. The distance between places and the stiffness of the arm therefore do not matter.

    margin [m]: ``inner`` leaves out contacts that are no deeper or no wider; ran: a pass whose deviation the
    places have. ``inner`` belongs to the place that removes the material.
    """
    position, time, block, step = _places(cell)
    timed = cell.timed_path
    rapid = np.zeros(len(block), bool) if timed is None else timed.toolpath.rapid[block]
    series = np.where(rapid, np.cumsum(np.diff(rapid, prepend=False) & rapid), 0)
    depth, inner, core, volume = met = np.zeros((4, len(position)))
    radius = float(cell.tool.radii.max())
    moved = position
    if ran is not None:
        at_ns, passed, moved = 1e9 * time, ran.result, position.copy()
        for k in range(3):
            moved[:, k] += np.interp(at_ns, passed.time_ns, passed.actual[:, k] - passed.target[:, k])
    grid = height_map(cell.stock, step, moved, radius)
    moved = on_map(moved)
    for removal in cell.stage.earlier if cell.stage else ():
        lower_along(grid, removal.radius, on_map(removal.programmed if ran is None else removal.actual))
    radii = radius, max(radius - max(margin, ROUNDING), 0.0), CORE * radius
    _meet(grid, np.zeros_like(grid.depth), moved, series, radii, met)
    return Engagement(position, time, rapid, block, series, depth, inner, core, margin, volume)


@njit(cache=True)
def _meet(grid, ahead, path, series, radii, met):
    """Fill ``met`` with what the tool meets on the way to each place, and lower the map.

    A series of rapid moves runs twice: first with the smaller radius on the map ``ahead``, against the material before
    the series.
    """
    depth, inner, core, volume = met
    for k in range(path.shape[0]):
        last, count = path[max(k - 1, 0)], path.shape[0]
        if series[k] and (k == 0 or series[k] != series[k - 1]):
            n = k
            while n < count and series[n] == series[k]:
                inner[n] = lower(grid, ahead, radii[1], 0.0, path[max(n - 1, 0)], path[n], n > 0)[0]
                n += 1
        depth[k], core[k], removed = lower(grid, grid.depth, radii[0], radii[2], last, path[k], k > 0)
        volume[k] = removed if series[k] else 0.0


def _places(cell: Cell) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Tool tips, times and blocks half a node step apart, and the node step [m]."""
    target, timed = cell.target(), cell.timed_path
    radius = float(cell.tool.radii.max())
    length = cell.programmed.length
    area = float(np.prod((cell.stock.max - cell.stock.min)[:2]))
    # length / (step / 2) places of pi (radius / step)^2 nodes each are to stay below MOST_VISITS
    step = max(
        radius / NODES_PER_RADIUS,
        (2.0 * np.pi * length * radius**2 / MOST_VISITS) ** (1.0 / 3.0),
        math.sqrt(area / MOST_NODES),
    )
    count = 2 + int(2.0 * length / step)
    if timed is None:
        time_ns = np.linspace(0, target.duration_ns, count).astype(np.int64)
        return target.sample(time_ns), time_ns * 1e-9, np.zeros(count, int), step
    ends = np.cumsum(timed.toolpath.block_length)
    distance = np.sort(np.concatenate([np.linspace(0.0, timed.toolpath.length, count), ends[1:]]))  # every corner too
    block = np.clip(np.searchsorted(ends, distance), 0, len(ends) - 1)  # where two meet, the one that ends
    time = np.interp(distance, timed.distance, target.time)
    return timed.toolpath.position_at(distance), time, block, step


def cut_violations(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    """What the simulated pass along ``run``, and the programmed path in the stock, show; by the points of ``run``."""
    if not ran.result.removed_volume > 0.0:
        return [violation("stock missed", 0.0, 0.0, 1)]
    return _spindle(cell, run, ran) + _tool(cell) + contact_violations(cell, run, ran)


def spring_back(cell: Cell, ran: ScoredPass) -> float:
    """[m], largest deflection while the tool feeds through material: a tool that springs back when the cut ends removes
    as much from a wall."""
    result = ran.result
    cutting = result.volume > 0.0
    cutting &= ~cell.programmed.rapid_at(result.time_ns)
    return float(np.max(np.linalg.norm(result.deflection[cutting, :3], axis=1), initial=0.0))


def _spindle(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Violation]:
    knot = np.clip(np.searchsorted(run.time_ns, ran.result.time_ns), 1, len(run) - 1)  # the one that is next
    torque = np.zeros(len(run))
    np.maximum.at(torque, knot, ran.result.torque)
    results = violations("spindle torque", torque, cell.limits.spindle_torque)
    return results + violations("spindle power", torque * cell.tool.spindle_speed, cell.limits.spindle_power)


def _tool(cell: Cell) -> list[Violation]:
    """Feed per tooth and cutting speed, from the fastest cutting move."""
    tool, results = cell.tool, []
    teeth_a_second = tool.spindle_speed / (2.0 * np.pi) * tool.teeth
    feed, speed = cell.feed_rate / teeth_a_second, tool.spindle_speed * tool.radius
    if tool.max_feed_per_tooth and feed > tool.max_feed_per_tooth:
        results.append(violation("feed per tooth", feed, tool.max_feed_per_tooth, most="the cutter takes"))
    elif feed > (unlikely := UNLIKELY_FEED * tool.diameter):
        most = "a quarter of the cutter's diameter"
        results.append(violation("feed per tooth", feed, unlikely, severity="warning", most=most))
    if tool.max_cutting_speed and speed > tool.max_cutting_speed:
        results.append(violation("cutting speed", speed, tool.max_cutting_speed))
    return results


def contact_violations(cell: Cell, run: Trajectory, ran: ScoredPass | None = None) -> list[Violation]:
    """What the tool meets along the programmed path: material at rapid, below the stock, fixtures.

    Where its rapid moves meet no material, the simulated pass ``ran`` decides: its rapid moves must not enter the
    material that its cutting moves leave, further than the arm springs back.
    """
    margin, timed = cell.limits.rapid_contact, cell.timed_path
    contacts, results = _along_path(cell, run, margin)  # its places are released here
    if not contacts and ran is not None and timed is not None and timed.toolpath.rapid.any():
        earlier = cell.stage.earlier if cell.stage else ()
        margin += max([spring_back(cell, ran), *(removal.spring_back for removal in earlier)])
        contacts = rapid_violations(run, engagement(cell, margin, ran))
    return contacts + results


def _along_path(cell: Cell, run: Trajectory, margin: float) -> tuple[list[Violation], list[Violation]]:
    """Contacts of rapid moves without deflection, and the rest of what the tool meets."""
    low, high, radius = cell.stock.min, cell.stock.max, cell.tool.radii.max()
    below, flutes = cell.limits.below_stock, cell.tool.flute_length
    met = engagement(cell, margin)
    points = _points(run, met)
    beneath = np.where(_over(met, low, high, radius), low[2] - met.position[:, 2], -np.inf)
    results = violations("below the stock", beneath, below, beneath > below + 1e-9, points=points, block=met.block)
    for number, (least, most) in enumerate(cell.workpiece.fixture_boxes, 1):
        inside = np.where(_over(met, least, most, radius), most[2] - met.position[:, 2], 0.0)
        results += violations(
            "in the fixture", inside, 0.0, inside > 0.0, points=points, block=met.block, subject=f"fixture {number}"
        )  # fmt: skip
    if flutes:
        results += violations("depth of cut", met.depth, flutes, met.depth > flutes, points=points, block=met.block)
    if not cell.tool.centre_cutting:
        depth, over = _plunges(met)
        results += violations("plunge", depth, 0.0, over, points=points, block=met.block)
    return rapid_violations(run, met), results


def _points(run: Trajectory, met: Engagement) -> np.ndarray:
    """The point of the program that each place of the path leads to, from 1."""
    return np.clip(np.searchsorted(run.time, met.time - 1e-6), 0, len(run) - 1) + 1


def rapid_violations(run: Trajectory, met: Engagement) -> list[Violation]:
    """One violation for each rapid move through material, by the points of ``run``: deepest contact, length of the
    contact, removed volume.

    The last move of a series counts what the moves without such a contact remove at the rim.
    """
    contacts, points = [], _points(run, met)
    length = np.linalg.norm(np.diff(met.position, axis=0, prepend=met.position[:1]), axis=1)
    contact = met.inner > met.margin
    blocks = np.unique(met.block[contact])
    at_rim = ~np.isin(met.block, blocks)
    rest = np.bincount(met.series[at_rim], met.volume[at_rim], minlength=len(met.series) + 1)
    for block in blocks[::-1].tolist():
        rows = np.flatnonzero(met.block == block)
        worst = rows[np.argmax(met.inner[rows])]
        volume = met.volume[rows].sum() + rest[met.series[worst]]
        rest[met.series[worst]] = 0.0
        amounts = {"length_mm": 1e3 * float(length[rows[contact[rows]]].sum()), "volume_mm3": 1e9 * float(volume)}
        depth, point = met.inner[worst], int(points[worst])
        contacts.append(violation("rapid in material", depth, met.margin, point, block=block, amounts=amounts))
    return contacts[::-1]


def _over(met: Engagement, low: np.ndarray, high: np.ndarray, radius: float) -> np.ndarray:
    """Where the tool is over or in a box, seen from above, (m,)."""
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
class Residue:
    """Vibration from tooth to tooth in a simulated pass, in which the arm moves and tool and spindle are rigid."""

    word: str  #: "repeats", "grows", "remains" or "no statement"
    residue: float  #: median from tooth to tooth, a share of the feed per tooth; NaN without a statement
    limit: float = CHATTERS  #: the same share, above which the vibration does not repeat
    teeth: bool = True  #: the pass resolves single teeth
    time: float = 0.0  #: of the place [s]

    @property
    def text(self) -> str:
        """One line."""
        if not self.teeth:
            return "simulated pass (arm only): no statement about vibration, the mean force has no teeth"
        if self.word == "no statement":
            return f"simulated pass (arm only): no cut of {FEWEST_TEETH} teeth without a break to compare"
        share = f"{100 * self.residue:.2g}" if self.residue >= SMALL else f"less than {100 * SMALL:g}"
        word = {"grows": "vibration grows", "remains": "vibration without growth"}.get(self.word, "the motion repeats")
        return f"simulated pass (arm only): {word}, from tooth to tooth {share} % of the feed per tooth remain"

    def as_dict(self) -> dict:
        """For JSON."""
        return {"word": self.word, "residue_share": self.residue, "limit_share": self.limit}


def residue_of(cell: Cell, result: PassResult) -> Residue:
    """The part of the tool's motion that does not repeat from tooth to tooth, in the worst stretch of cutting.

    Sampled once a tooth period T, a stable cut repeats itself but for the slow swinging of the arm, whose fourth
    difference over teeth is small: A (w T)^4 / 16 for a swing of amplitude A and circular frequency w, 0.02 % of it at
    20 Hz and 533 teeth a second. What repeats with each revolution of unequal teeth is subtracted.

    A chattering cut does not repeat itself. Its vibration grows over the thirds of a stretch, or lasts, at a size at
    which teeth leave the material. Medians leave out entries, exits and corners, after which the arm swings for a few
    teeth. What swings slower than a tenth of the tooth frequency is left to the deviation.
    """
    if cell.by_engagement:
        return Residue("no statement", np.nan, teeth=False)
    tool = cell.tool
    period = 2.0 * np.pi / (tool.spindle_speed * tool.teeth)
    feed_per_tooth = cell.feed_rate * period
    limit = max(CHATTERS, GRID_NOISE * cell.stock.grid_step / max(feed_per_tooth, 1e-12))
    unequal = tool.teeth if np.ptp(tool.radii) > 0.0 or not has_uniform_pitch(tool) else 0
    worst, grows, seconds = (-1.0, 0.0), False, result.time  # residue, time of its place
    cuts = result.volume > 0.0
    if seconds.size > 1:  # between two teeth of a narrow cut nothing is removed
        cuts = np.convolve(cuts, np.ones(1 + math.ceil(period / (seconds[1] - seconds[0]))))[: cuts.size] > 0.0
    for first, last in stretches(cuts) if result.every == 1 else ():
        time = seconds[first:last]
        teeth = np.arange(time[0], time[-1], period)
        if teeth.size < FEWEST_TEETH:
            continue
        at_teeth = np.stack([np.interp(teeth, time, result.deflection[first:last, k]) for k in range(2)], 1)
        change = np.diff(at_teeth, 4, axis=0) / (16.0 * feed_per_tooth)  # a motion that alternates counts whole
        early, middle, late = _medians(change, unequal)
        if late > SURE * limit and late > GROWS * middle > GROWS**2 * early:
            grows, worst = True, max(worst, (late, float(time[-1])))
        windows = np.array_split(change, max(1, teeth.size // FEWEST_TEETH))
        for k, thirds in enumerate(_medians(window, unequal) for window in windows):
            place = float(time[0] + (k + 0.5) / len(windows) * (time[-1] - time[0]))
            worst = max(worst, (sorted(thirds)[1] if thirds[2] > LASTS * thirds[0] else 0.0, place))
    if worst[0] < 0.0:
        return Residue("no statement", np.nan, limit)
    word = "grows" if grows or worst[0] > limit else "repeats"
    return Residue(word, worst[0], limit, time=worst[1])


def _medians(change: np.ndarray, teeth: int) -> list[float]:
    """Median size in each third, without what repeats every ``teeth`` rows; 0: nothing is subtracted."""
    if teeth:
        whole = change[: len(change) // teeth * teeth].reshape(-1, teeth, 2)
        change = (whole - whole.mean(0)).reshape(-1, 2)
    return [float(np.median(part)) for part in np.array_split(np.linalg.norm(change, axis=1), 3)]
