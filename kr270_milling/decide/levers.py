"""Levers beside the correction: softer ramps, the feed of each stretch, a finishing pass, a turn of the tool.

An arm swings after each stop and corner. The swing of the slowest mode follows from the acceleration of the path. A
ramp that lasts longer than a period of this mode leaves little. Scaling the acceleration by s and the jerk by s^2 makes
all ramps 1/s times as long; the feed stays.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column, computed
from kr270_milling.base.errors import InputError, ModelError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import PLANNED, compensated, compensator, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import coarser
from kr270_milling.decide.decision import ENOUGH
from kr270_milling.decide.part.assessment import Judgement, assess_result, gauge_of, judge_part
from kr270_milling.decide.programs.written import written_trajectory
from kr270_milling.decide.verdict import CHOOSING_SEED, NO_METHOD, drawn_errors, each_robot, run_sample
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult

RATIOS = (1.0, 1.1, 1.25, 1.5)  #: cycle times of softer ramps, of the programmed one; also feeds stay below the last
NEEDS = "needs part.tolerance_um, and a program without times in path.file"
QUICK = "inverse"  #: method that plans while feeds are chosen; ``robust`` takes eight times as long
ROUNDS = 5  #: feeds that are tried; each plans the correction again
FAILED = 1e6  #: error of a robot that fails, as a share of the tolerance


@dataclass(frozen=True)
class Lever:
    """A cell with some of the levers, run by the simulated robots of a verdict."""

    name: str = column("lever", short="lever")
    within: int = column("within_tolerance", short="within")
    robots: int = column("robots", short="of")
    median: float = column("median_um", 1e6, unit="um", short="median")
    high: float = column("q95_um", 1e6, unit="um", short="95 %")
    duration: float = column("duration_s", unit="s", short="time")
    cell: Cell = column("")
    feeds: dict | None = column("", default=None)  #: of ``scheduled``

    @property
    def enough(self) -> bool:
        return self.within >= ENOUGH * self.robots

    @property
    def rank(self) -> tuple[int, float, float]:
        """Greater for a better row: robots within the tolerance, then their median error, then the time."""
        return self.within, -self.median, -self.duration

    @computed("set")
    def keys(self) -> list[str]:
        """The values of the cell file, as behind ``--set``."""
        timing, settings = self.cell.timing, self.cell.compensation
        return [
            f"timing.acceleration_m_per_s2={timing.acceleration:.3g}",
            f"timing.jerk_m_per_s3={timing.jerk:.3g}",
            *(f"compensation.{name}={getattr(settings, name)}" for name in ("feed", "finish", "turn")),
        ]


def softened(cell: Cell, ratio: float) -> Cell:
    """Return the cell with softer ramps, so that its path takes at most ``ratio`` times as long."""
    # shares of the programmed acceleration
    limit, low, high = ratio * path_of(cell).target.duration_ns, 0.02, 1.0
    for _ in range(12):  # to 0.1 % of the acceleration
        share = 0.5 * (low + high)
        slow = path_of(_with_share(cell, share)).target.duration_ns > limit
        low, high = (share, high) if slow else (low, share)
    return _with_share(cell, high) if ratio > 1.0 else cell


def _with_share(cell: Cell, share: float) -> Cell:
    rounded = (float(f"{value:.3g}") for value in (share * cell.timing.acceleration, share**2 * cell.timing.jerk))
    acceleration, jerk = rounded
    return cell.replace(timing=cell.timing.replace(acceleration=acceleration, jerk=jerk))


def scheduled(
    cell: Cell,
    method: str,
    motion: str,
    count: Callable[[int, int], None] | None = None,
    longest: float = math.inf,
) -> tuple[Cell, dict]:
    """Return the cell with a feed for each stretch of its path, and a summary.

    The feed of a stretch is as high as the programmed one, times ``compensation.feed_most``, where 90 % of the robots
    stay within the tolerance there; else lower. They are the same robots everywhere, those with the least errors as
    programmed: else another tenth may miss each stretch. r(f), their largest load in a stretch as a share of its limit
    (``_loads``), is taken as linear in the feed f, through its last two values; the first slope is r / f. Where a feed
    of 0 would leave 90 % of the load, it does not respond to the feed: the edges plough, or the servo lags. The
    programmed feed stays. The error of the next stretch is a load, too, since the arm still swings there. A slope is at
    most 2 r / f: no error grows faster than the square of the feed. Where the path would take too long, all stretches
    aim at the same larger load. Feeds that are not enough for 90 % of the robots must be no worse for half of them, and
    for the worst tenth, than the programmed ones.

    method: that plans the correction in these rounds; motion: of the programs; count(done, total): in robots;
    longest [ns]: duration of the path, default ``RATIOS[-1]`` times the programmed one.
    """
    path, settings = cell.path.loaded().read(), cell.compensation
    if not isinstance(path, Toolpath) or not any(cell.tolerances.of()):
        raise InputError("compensation.feed", NEEDS)
    ends = _stretches(path)
    middle = ends - 0.5 * np.diff(ends, prepend=0.0)
    feed, fixed = path.feed[path.block_at(middle)], (path.rapid | path.drilling)[path.block_at(middle)]
    pitch = 2.0 * np.pi / (cell.tool.spindle_speed * cell.tool.teeth)
    chip = np.maximum(feed * pitch, 1e-12)  # [m], feed per tooth
    # share of the programmed feed, above that of the least chip
    least = np.minimum(1.0, np.maximum(0.25, cell.limits.least_chip / chip))
    most = np.full(len(ends), settings.feed_most)
    if cell.tool.max_feed_per_tooth:
        most = np.minimum(most, np.maximum(cell.tool.max_feed_per_tooth / chip, least))
    least[fixed] = most[fixed] = 1.0
    share, before = np.minimum(1.0, most), None
    slope = silent = np.zeros(len(ends))
    programmed = path_of(cell).target.duration_ns
    rounds: list[tuple] = []

    def report(turn: int, done: int) -> None:
        if count:
            count(turn * PLANNED + done, ROUNDS * PLANNED)

    for turn in range(ROUNDS):
        tried = cell.replace(path=cell.path.loaded().replace(content=path.with_feeds(ends, share)))
        rows, shares = _loads(tried, method, motion, ends, functools.partial(report, turn))
        if not turn:
            chosen = np.argsort(np.nan_to_num(shares, nan=FAILED))[: math.ceil(ENOUGH * PLANNED)]
        loads = rows[chosen].max(axis=0)
        loads = np.vstack([loads, np.append(loads[0, 1:], 0.0)])  # the arm still swings in the next stretch
        enough = bool(np.sum(shares <= 1.0) >= ENOUGH * PLANNED)
        seconds = path_of(tried).target.duration_ns
        within = int(np.sum(shares <= 1.0))
        half, high = np.quantile(np.nan_to_num(shares, nan=FAILED), (0.5, ENOUGH)).tolist()
        rounds.append((not enough, seconds if enough else -within, half, high, tried, share, seconds))
        if before is None:
            slope = loads / share
        else:
            moved = share - before[1]
            own = np.abs(moved) > 0.02
            slope = np.where(own, (loads - before[0]) / np.where(own, moved, 1.0), slope)
            slope = np.minimum(slope, 2.0 * loads / share)
        # the feed stays where less than this share of the deviation comes from it
        still = slope * share < 0.1 * loads
        silent = (still & (loads > 1.0))[:-1].any(axis=0)
        before, aiming = (loads, share), functools.partial(_aimed, share, loads, slope, still, least, most)
        missed = float(loads[:, ~fixed].max(initial=0.0, where=~still[:, ~fixed])) if turn else 0.0
        aim = 0.95 / max(1.0, missed)  # the linear rule misses by some percent, and as much again
        share = _within_time(cell, path, ends, aiming, aim, min(longest, RATIOS[-1] * programmed))
        if np.abs(share - before[1]).max() < 0.01:
            break
    sound = (row for row in rounds if not row[0] or (row[2] <= rounds[0][2] and row[3] <= rounds[0][3]))
    *_, best, share, seconds = min(sound, key=lambda row: row[:4])
    lines = sorted(set(path.line[path.block_at(middle[silent & (share >= 1.0) & ~fixed])].tolist()))
    percent = 100.0 * share[~fixed]
    summary = {
        "stretches": len(percent),
        "slower": int(np.sum(percent < 99.5)),
        "feed_percent": [float(percent.min()), float(percent.max())],
        "duration_s": [programmed * 1e-9, seconds * 1e-9],
        "lines_without_response": lines,
    }
    return best, summary


def _aimed(share, loads, slope, still, least, most, level: float) -> np.ndarray:
    """Return the shares of the feed with which the largest load of each stretch is ``level``, between least and most.

    still: loads that do not respond; where they are above the level the feed stays as programmed.
    """
    wanted = share + (level - loads) / np.maximum(slope, 1e-9)
    wanted = np.where(still, np.where(loads > level, 1.0, np.inf), wanted)
    return np.clip(wanted.min(axis=0), least, most)


def _within_time(
    cell: Cell, path: Toolpath, ends: np.ndarray, aiming: Callable[[float], np.ndarray], aim: float, limit: float
) -> np.ndarray:
    """Return the shares that aim at the least load, from ``aim`` on, with which the path takes at most a time [ns]."""

    def late(level: float) -> bool:
        content = path.with_feeds(ends, aiming(level))
        return path_of(cell.replace(path=cell.path.loaded().replace(content=content))).target.duration_ns > limit

    low, high, highest = aim, aim, 100.0  # with a higher load the feeds are the programmed ones at least
    while late(high) and high < highest:
        low, high = high, 1.5 * high
    for _ in range(5 if high > low else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if late(middle) else (low, middle)
    return aiming(high)


def _stretches(path: Toolpath) -> np.ndarray:
    """Ends of the stretches [m]: pieces of 0.25 s of a cut, which ends at a corner or with its feed or feature."""
    usual = 0.25  # [s] of a stretch at the programmed feed: ramps of 2 m/s2 and 20 m/s3 to 4 m/min take 0.12 s
    k = np.arange(1, len(path))
    start, end = path.tangent(k, np.zeros(k.size)), path.tangent(k, path.plane_length[k])
    # [rad], turn of the path that ends a stretch
    corner = np.sum(start[1:] * end[:-1], axis=1) < np.cos(0.1)
    changed = [values[2:] != values[1:-1] for values in (path.feed, path.rapid, path.drilling, path.feature)]
    last = np.append(np.flatnonzero(np.any([corner, *changed], axis=0)) + 1, len(path) - 1)
    border = np.cumsum(path.block_length)[last]
    length = np.diff(border, prepend=0.0)
    steady = path.rapid[last] | path.drilling[last]
    count = np.where(steady, 1, np.ceil(length / np.maximum(path.feed[last] * usual, 1e-6))).astype(int)
    return np.repeat(border - length, count) + np.repeat(length / count, count) * (
        1 + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    )


def _loads(
    cell: Cell, method: str, motion: str, ends: np.ndarray, count: Callable[[int], object]
) -> tuple[np.ndarray, np.ndarray]:
    """Plan a cell, run drawn robots, and return the largest loads of each robot in each stretch, (robots, 3, s).

    Loads are shares of their limits: the errors that stay on walls and floors, the force, torque and power of the
    spindle; 0 of a robot that fails. Also returns the error of each robot as a share of the tolerance, (robots,).
    """
    nominal = coarser(cell)
    path, gauge = path_of(nominal), gauge_of(nominal)
    stamps, along, ideal = gauge.stamps, gauge.path, gauge.ideal
    distance, length, every = along.distance, float(ends[-1]), path.length
    if cell.compensation.finish:
        again = (every - length) / cell.compensation.finish
        distance = np.where(distance > length, (distance - length) % again + length - again, distance)
    stretch = np.clip(np.searchsorted(ends, distance), 0, len(ends) - 1)
    wall, floor = np.array([cell.tolerances.of(name) for name in along.features]).T
    wall, floor = (np.where(values > 0.0, values, np.inf) for values in (wall, floor))
    place = tuple(
        np.clip(np.searchsorted(axis, target), 0, len(axis) - 1)
        for axis, target in zip((ideal.x, ideal.y), path.target.sample(stamps)[:, :2].T, strict=True)
    )
    same_height = 20e-6  # [m], of the path and a floor that stays
    stays = np.abs(ideal.height[place] - path.target.sample(stamps)[:, 2]) < same_height
    mark = ideal.marks["period"][ideal.staying]
    force, torque, power = cell.limits.cutting_force or np.inf, cell.limits.spindle_torque, cell.limits.spindle_power
    loads = np.zeros((PLANNED, 3, len(ends)))

    def watch(load: np.ndarray, ran: PassResult) -> Judgement:
        part = assess_result(nominal, "", ran, ideal, along)
        cuts = part.cutting & ~along.drilling
        side = np.abs(part.deviation)
        if part.floors.curved:
            least = np.minimum(wall, floor)[along.feature[cuts]]
            np.maximum.at(load[0], stretch[cuts], np.hypot(side[cuts, 1], side[cuts, 2]) / least)
        else:
            np.maximum.at(load[0], stretch[mark], np.abs(part.walls.error) / wall[part.walls.feature])
            bottom = cuts & stays
            np.maximum.at(load[0], stretch[bottom], side[bottom, 2] / floor[along.feature[bottom]])
        np.maximum.at(load[1], stretch[cuts], part.force[cuts] / force)
        np.maximum.at(load[2], stretch[cuts], np.maximum(part.torque / torque, part.power / power)[cuts])
        return judge_part(cell.tolerances, part)

    program = (_program(cell, method, motion),)

    def share(number: int, robot: Cell) -> float:
        return float(run_sample(robot, path_of(cell).target, program, functools.partial(watch, loads[number]))[0, 1])

    shares = np.array(each_robot(nominal, PLANNED, CHOOSING_SEED, share, count))
    if np.isnan(shares).all():
        raise ModelError("no simulated robot survives the path: check force law, compliances and depth of cut")
    return loads, shares


def _program(cell: Cell, method: str, motion: str) -> Trajectory:
    """Plan the correction of a cell and return its program as written."""
    original = simulate(cell)
    if method == NO_METHOD:
        return written_trajectory(cell, original.reference, motion)
    by = compensator(cell, path_of(cell).target, cell.compensation.replace(method=method).planned_method)
    return written_trajectory(cell, compensated(cell, original, by.method, None, by).reference, motion)


def levers(
    cell: Cell,
    robots: int,
    seed: int,
    motion: str,
    progress: Callable[[int, int], None] | None = None,
    turned: Callable[[Cell], Cell] | None = None,
    method: str | None = None,
) -> tuple[list[Lever], Lever]:
    """Try the levers, and return a row for each and the row to run.

    That row is the one with the shortest time of those that are enough, or else the one with the most robots within
    the tolerance. A lever that takes longer than one that is enough is not tried. Without a finishing pass the path
    takes at most ``RATIOS[-1]`` times as long. turned: the cell with the best turn of the tool; method: of the
    correction, default: that of the cell. Raises InputError for a straight cut and for a cell without a tolerance.
    """
    fed = path_of(cell).fed
    if fed is None or fed.timed_by_source or not any(cell.tolerances.of()):
        raise InputError("--reach", NEEDS)
    rows: list[Lever] = []
    longest, most_tried, done = RATIOS[-1] * path_of(cell).target.duration_ns, 10, 0

    def count(robot: float) -> None:
        if progress:
            progress(round(done * robots + robot), most_tried * robots)

    def tried(name: str, variant: Cell, feeds: dict | None = None) -> Lever:
        """Plan the variant, run the robots, and append its row; the first one also has the path as programmed."""
        nonlocal done
        count(0)
        program = _program(variant, method or variant.compensation.method, motion)
        names, references = [name], [program]
        if not rows:
            names, references = ["nothing", name], [path_of(variant).target, program]
        first = 2 - len(references)  # the program is pass 1 of a robot, as in the verdict
        errors = drawn_errors(variant, references, robots, seed, count, first=first)
        done += 1
        seconds = path_of(variant).target.duration_ns * 1e-9
        for shown, (error, share) in zip(names, np.moveaxis(errors, 0, -1), strict=True):
            median, high = np.quantile(np.nan_to_num(error, nan=1.0), (0.5, 0.95)).tolist()
            within = int(np.sum(share <= 1.0))
            rows.append(Lever(shown, within, robots, median, high, seconds, variant, feeds))
        return rows[-1]

    def fed_by(name: str, variant: Cell) -> Lever:
        nonlocal done
        variant = variant.replace(compensation=variant.compensation.replace(feed="schedule"))
        fed_cell, feeds = scheduled(variant, QUICK, motion, lambda k, n: count(robots * k / n), longest)
        done += 1
        return tried(name, fed_cell, feeds)

    def none_enough() -> bool:
        return not any(row.enough for row in rows)

    def softer(ratio: float) -> Cell:
        return softened(best.cell, ratio * plain.duration / best.duration)

    plain = tried("correction", cell)
    if none_enough() and turned is not None:
        other = turned(cell.replace(compensation=cell.compensation.replace(turn="best")))
        if other.path.content is not cell.path.content:
            tried("turn of the tool", other)
    best = max(rows[1:], key=lambda row: row.rank)
    turn = "" if best is plain else "turn, "
    for ratio in RATIOS[1:]:
        if none_enough():
            tried(f"{turn}softer ramps, {ratio:g} x", softer(ratio))
    fastest = min((row.duration for row in rows if row.enough), default=np.inf)
    if fastest > plain.duration:
        fed_by(f"{turn}feed", best.cell)
    if none_enough():
        fed_by("all without finish", softer(RATIOS[-2]))
    if none_enough():
        once = cell.compensation.replace(finish=min(3, cell.compensation.finish + 1))
        tried("finishing pass", cell.replace(compensation=once))
    if none_enough():
        last = next(row for row in rows if row.name == "all without finish")
        tried("all", last.cell.replace(compensation=last.cell.compensation.replace(finish=once.finish)), last.feeds)
    enough = [row for row in rows[1:] if row.enough]
    return rows, min(enough, key=lambda row: row.duration) if enough else max(rows[1:], key=lambda row: row.rank)
