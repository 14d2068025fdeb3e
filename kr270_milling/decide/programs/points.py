"""The points of a robot program: as few knots as keep the motion of the controller on the planned path.

A point more is a block more for the planner of the controller. The points therefore begin with the stops. A stretch
between two points is halved where a knot is farther than ``program.tolerance`` from its place on the path through the
points (``path.controller_motion``), and points that are not needed are left out again. A spline is compared in the
middle between two knots too, where it can be near. The controller plans the ramps along the path itself.

LIN motions have arcs where one replaces points. SPLINE blocks have none: a controller stops where SCIRC meets SLIN or
another SCIRC, and SPL segments need a tenth fewer points with arcs between them than without.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.column import column, computed
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.cell.sections import Program
from kr270_milling.path.controller_motion import natural_slopes, places_on_program
from kr270_milling.path.trajectory import LEVER, Trajectory, turned

SHORT_NS = 30_000_000  #: [ns]: a block is shorter only where the tolerance needs it
#: [rad], [m], least turn of an arc and least distance of its three points; assumed: places are written to 0.1 um
SMALLEST, APART = math.radians(5.0), 1e-4
CURVED = 0.25  #: share of the tolerance that straight lines between ``dense_times`` take


def fixed_knots(stops: np.ndarray, feeds: np.ndarray | None) -> np.ndarray:
    """Return the knots that must be points, (n,) bool: the stops, and where the feed changes.

    feeds: of the block of each knot [m/s], (n,), NaN at a stop. The point is the knot in the faster block, so that the
    way to it, or from it, has the lower feed as a whole.
    """
    fixed = stops.copy()
    if feeds is not None:
        fixed[1:] |= feeds[1:] > feeds[:-1]
        fixed[:-1] |= feeds[1:] < feeds[:-1]
    return fixed


def point_numbers(
    program: Program,
    original: Trajectory,
    revised: Trajectory,
    fixed: np.ndarray | None = None,
    stops: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """Return the knots that become points, (p,), in both trajectories; the first, the fixed and the last are points.

    stops: mask (n,) of the knots where the robot stops; None: the standing ones; fixed: None: the stops; known: points
    with fewer stops, which stay. Knots closer than ``program.point_spacing`` are left out. A tolerance of 0 takes all
    other knots.
    """
    stops = original.standing if stops is None else stops
    fixed = stops if fixed is None else fixed
    knots = _apart(program.point_spacing, fixed, _places(original), _places(revised))
    if not program.tolerance:
        return knots
    fixed = fixed[knots]
    fixed[[0, -1]] = True
    if known is not None:
        fixed |= np.isin(knots, known)
    errors = _errors(program, original, revised, stops, knots)
    chosen = _refined(program.tolerance, errors, knots, original.time_ns[knots], fixed)
    return knots[_thinned(program.tolerance, errors, knots, chosen, fixed)]


def _refined(tolerance: float, errors: Callable, knots: np.ndarray, time: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Halve the stretches between fixed knots until the error is in the tolerance; return indices into ``knots``.

    errors: of ``_errors``; time: of the knots [ns].
    """
    chosen = np.flatnonzero(fixed)
    while True:
        middle = (time[chosen[1:]] + time[chosen[:-1]]) // 2
        later = np.searchsorted(time, middle)
        middle = later - (time[later] - middle > middle - time[later - 1])  # the knot nearest to the middle
        inside = (middle > chosen[:-1]) & (middle < chosen[1:])
        wrong = errors(knots[chosen]) > tolerance
        split = inside & np.logical_or.reduceat(wrong, knots[chosen[:-1]])
        if not split.any():
            return chosen
        new = middle[split]
        sides = np.minimum(time[new] - time[chosen[:-1][split]], time[chosen[1:][split]] - time[new])
        wide = sides >= SHORT_NS
        chosen = _merged(chosen, new[wide] if wide.any() else new)


def _thinned(
    tolerance: float, errors: Callable, knots: np.ndarray, chosen: np.ndarray, fixed: np.ndarray
) -> np.ndarray:
    """Leave out points that the tolerance does not need: every third one at a time, then back where it is needed."""
    limit = np.maximum(tolerance, errors(knots[chosen]))  # rounded corners miss by more
    thinnings = 4  # times that each point is left out on trial
    reach = 2  # stretches to both sides in which a point that is left out changes the path
    for turn in range(3 * thinnings):
        out = np.arange(len(chosen)) % 3 == turn % 3
        out &= ~fixed[chosen]
        while out.any():
            points = knots[chosen[~out]]
            over = np.logical_or.reduceat(errors(points) > limit, points[:-1])
            if not over.any():
                break
            near = np.convolve(over, np.ones(2 * reach + 1), "same") > 0.0
            back = near[np.cumsum(~out)[out] - 1]  # the stretch in which the point was
            out[np.flatnonzero(out)[back if back.any() else slice(None)]] = False
        chosen = chosen[~out]
    return chosen


def program_points(
    program: Program,
    original: Trajectory,
    revised: Trajectory,
    fixed: np.ndarray | None = None,
    stops: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of ``point_numbers`` with the arcs of LIN motions, (p,), and which are auxiliary points, (p,).

    An arc has its auxiliary point in the middle and replaces two points or more, none of them fixed (n,). It is as near
    to the knots of both trajectories as the lines are, or in the tolerance, and the tool does not turn on it.
    """
    stops = original.standing if stops is None else stops
    fixed = stops if fixed is None else fixed
    points = point_numbers(program, original, revised, fixed, stops, known)
    stays, auxiliary = np.ones(len(points), bool), np.zeros(len(points), bool)
    if program.motion == "LIN" and program.tolerance:
        runs = [original] if revised is original else [original, revised]
        errors = _errors(program, original, revised, stops)
        for run in runs:
            turning = np.any(np.diff(run.quaternion, axis=0) != 0, axis=1)
            fixed = fixed | np.append(turning, False) | np.append(False, turning)
        places = np.array([run.position for run in runs])
        stays, auxiliary = _arcs(program.tolerance, places, points, fixed[points])
        before = errors(points)
        while auxiliary.any():
            chosen = np.flatnonzero(stays)
            after = errors(points[chosen], auxiliary[chosen])
            limit, worst = (np.maximum.reduceat(error, points[chosen[:-1]]) for error in (before, after))
            wrong = worst > np.maximum(program.tolerance, limit)
            near = np.convolve(wrong, np.ones(3), "same") > 0.0  # with the blending to both sides
            middle = np.flatnonzero(auxiliary[chosen])
            middle = middle[near[middle - 1] | near[middle]]
            if not middle.size:
                break
            auxiliary[chosen[middle]] = False
            for k in middle:
                stays[chosen[k - 1] : chosen[k + 1]] = True
    return points[stays], auxiliary[stays]


@njit(cache=True, nogil=True)
def _arcs(tolerance, places, points, fixed):
    """Return which points stay and which are auxiliary; each arc as long as it can be, from the first point on."""
    last, stays, auxiliary = len(points) - 1, np.ones(len(points), np.bool_), np.zeros(len(points), np.bool_)
    start = stop = 0
    while start < last:
        if stop <= start:
            stop = start + 1
            while stop < last and not fixed[stop]:
                stop += 1
        end, step, fits = start + 2, 1, False
        while step:
            middle, turn = (start + end + step) // 2, -1.0
            if end + step <= stop:
                turn = _turn(tolerance, places, points[start], points[middle], points[end + step])
            if turn >= 0.0:
                end, step, fits = end + step, 2 * step, turn > SMALLEST
            else:
                step //= 2
        if fits:
            middle = (start + end) // 2
            stays[start + 1 : end] = False
            stays[middle] = auxiliary[middle] = True
        start = end if fits else start + 1
    return stays, auxiliary


@njit(cache=True, nogil=True)
def _turn(tolerance, places, first, middle, last):
    """Return the smallest turn [rad] of the arcs of all runs through three knots; below 0 where a knot is not near."""
    least = math.pi
    for run in places:
        a, u, v = run[first], run[middle] - run[first], run[last] - run[first]
        normal = np.cross(u, v)
        size = np.sqrt(np.sum(normal**2))
        if size == 0.0:
            return -1.0
        turn = 2 * (np.arctan2(size, np.sum(v * (v - u))) + np.arctan2(size, np.sum(u * v)))
        normal /= size
        centre = (np.cross(normal, u) * np.sum(v**2) - np.cross(normal, v) * np.sum(u**2)) / (2 * size)
        radius, length = np.sqrt(np.sum(centre**2)), 0.0
        for k in range(first + 1, last + 1):
            way = run[k] - a - centre
            across = np.sum(way * normal)
            along = np.sqrt(np.sum((way - across * normal) ** 2)) - radius
            if along**2 + across**2 > tolerance**2:
                return -1.0
            length += np.sqrt(np.sum((run[k] - run[k - 1]) ** 2))
        if turn > math.pi or length > 1.001 * radius * turn + tolerance:  # more than one turn
            return -1.0
        least = min(least, turn if min(np.sum(u**2), np.sum((v - u) ** 2)) > APART**2 else 0.0)
    return least


def dense_times(run: Trajectory, tolerance: float) -> np.ndarray:
    """Return times [ns], the knots of a run among them, so dense that straight lines between them keep to its path.

    A line between two points of a curve misses the curve by a h^2 / 8, a the acceleration across the line and h the
    time between the points. Without a tolerance the knots alone.
    """
    knots = run.time_ns
    if not tolerance or run.velocity is None:
        return knots
    step = np.diff(knots)
    line = np.diff(run.position, axis=0)
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-12)
    across = np.zeros(len(step))
    for bend in (run.sample_acceleration(knots[:-1], "right"), run.sample_acceleration(knots[1:], "left")):
        across = np.maximum(across, np.linalg.norm(bend - np.sum(bend * line, axis=1, keepdims=True) * line, axis=1))
    parts = np.ceil(1e-9 * step * np.sqrt(across / (8.0 * CURVED * tolerance)))
    most_parts = 64  # of one step of the controller
    parts = np.clip(parts, 1, most_parts).astype(int)
    part = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(knots[:-1], parts) + part * np.repeat(step, parts) // np.repeat(parts, parts), knots[-1])


@dataclass(frozen=True)
class ProgramBlocks:
    """Load on the planner of a controller."""

    points: int = column("points")
    duration: float = column("")  #: [s]
    most: int = column("most_points_in_one_second")
    shortest: float = column("shortest_block_ms", 1e3)  #: [s]
    length: float = column("shortest_block_mm", 1e3)  #: [m], length of the shortest block
    short: int = column("short_blocks")  #: blocks shorter than ``SHORT_NS``
    error: float = column("error_um", 1e6)  #: [m], distance of the motion through the points from the planned path

    @computed("points_per_second")
    def points_per_second(self) -> float:
        return self.points / self.duration

    @property
    def text(self) -> str:
        """Return one line."""
        short = f", {self.short} shorter than {SHORT_NS / 1e6:g} ms" if self.short else ""
        return (
            f"program: {self.points} points, {self.points_per_second:.3g} a second, at most {self.most} in one; "
            f"shortest block {1e3 * self.shortest:.3g} ms, {1e3 * self.length:.3g} mm{short}; the motion through the "
            f"points is within {1e6 * self.error:.2g} um of the planned path"
        )


def program_blocks(
    program: Program,
    original: Trajectory,
    revised: Trajectory,
    points: np.ndarray,
    auxiliary: np.ndarray,
    stops: np.ndarray,
) -> ProgramBlocks:
    """Return the size of the blocks of the program of ``revised``; points, auxiliary, stops: its layout."""
    error = _errors(program, original, revised, stops)(points, auxiliary).max()
    points = points[~auxiliary]
    time = original.time_ns[points]
    step = np.diff(time)
    shortest = int(np.argmin(step))
    ahead = np.searchsorted(time, time + 1_000_000_000) - np.arange(len(time))
    length = math.dist(*revised.position[points[shortest : shortest + 2]])
    return ProgramBlocks(
        len(points),
        original.duration_ns * 1e-9,
        int(ahead.max()),
        1e-9 * int(step[shortest]),
        length,
        int((step < SHORT_NS).sum()),
        float(error),
    )


def _merged(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return two sorted arrays as one without repeats; ``np.union1d`` takes half of the time of a long program."""
    both = np.sort(np.append(values, others), kind="stable")
    return both[np.append(True, both[1:] > both[:-1])]


def _places(run: Trajectory) -> np.ndarray:
    """Return the positions (n, 3), of a run that turns with the axes of the tool, (n, 12), as far apart as a holder."""
    if not run.turns:
        return run.position
    axes = rotation_from_quaternion(run.quaternion).reshape(-1, 9)
    places = np.hstack([run.position, LEVER / math.sqrt(2.0) * axes])
    places.setflags(write=False)  # as positions are, so that Numba compiles ``_apart`` once
    return places


@njit(cache=True, nogil=True)
def _apart(spacing, stops, original, revised):
    """Return the knots that are farther than ``spacing`` [m] from the knot before in both runs, and stops."""
    last, chosen, count = len(stops) - 1, np.zeros(len(stops), np.int64), 1
    for k in range(1, last + 1):
        while (stops[k] or k == last) and count > 1 and _near(spacing, original, revised, k, chosen[count - 1]):
            count -= 1  # a corner must not move to the knot before it
        if k == last or not _near(spacing, original, revised, k, chosen[count - 1]):
            chosen[count] = k
            count += 1
    return chosen[:count]


@njit(cache=True, nogil=True)
def _near(spacing, original, revised, k, before):
    apart = np.sqrt(np.sum((original[k] - original[before]) ** 2))
    return min(apart, np.sqrt(np.sum((revised[k] - revised[before]) ** 2))) < spacing


def _errors(
    program: Program,
    original: Trajectory,
    revised: Trajectory,
    stops: np.ndarray,
    knots: np.ndarray | None = None,
) -> Callable:
    """Return the function of points and auxiliary points that yields the distance [m] of each knot from the program.

    The larger one of both runs, (n,), of a knot or, on a spline, of the middle of the step after it. knots: those that
    may be points, (k,); middles that all of them miss by more than the tolerance are left out. None: no middle is.
    The function may return the same array again.
    """
    runs, first = [original] if revised is original else [original, revised], np.arange(len(stops))
    spline = program.motion == "SPLINE"

    def unknown() -> list[tuple]:
        return [(np.zeros(2, int), np.full((1, 2, 3), np.nan), np.zeros(len(stops))) for _ in runs]

    def errors(points: np.ndarray, auxiliary: np.ndarray | None = None) -> np.ndarray:
        rests, at, distances = stops[points], first[points], []
        for i, run in enumerate(runs):
            places = run.position[at]
            if spline:  # spans with the points and slopes of the time before keep their errors
                slopes = natural_slopes(run.travelled[at], places, rests)
                _farthest(run.travelled, run.position, first, points, slopes, *latest[i])
                away = latest[i][2]
                latest[i] = points, slopes, away
            else:
                place = places_on_program(run, at, places, rests, False, program.blend_distance, auxiliary)
                away = np.linalg.norm(place - run.position, axis=1)
            distances.append(away)
            if run.turns:
                written = Trajectory(run.time_ns[at], places, run.quaternion[at])
                angle = turned(written.sample_orientation(run.time_ns[first]), run.quaternion[first])
                distances.append(LEVER * angle)
        return distances[0] if len(distances) == 1 else np.max(distances, axis=0)

    latest = unknown()
    if spline and original.velocity is not None and revised.velocity is not None:
        time_ns = _merged(original.time_ns, original.time_ns[:-1] + np.diff(original.time_ns) // 2)
        first = np.searchsorted(time_ns, original.time_ns)
        runs = [Trajectory(time_ns, run.sample(time_ns), run.sample_orientation(time_ns)) for run in runs]
        latest = unknown()
        if knots is not None:
            near = np.ones(len(time_ns), bool)
            near[first[:-1] + 1] = errors(knots)[:-1] <= program.tolerance
            near[first] = True
            time_ns, first = time_ns[near], (np.cumsum(near) - 1)[first]
            turns = [run.quaternion[near] if run.turns else run.quaternion[0] for run in runs]
            runs = [Trajectory(time_ns, run.position[near], turn) for run, turn in zip(runs, turns, strict=True)]
            latest = unknown()
    return errors


@njit(cache=True, error_model="numpy", nogil=True)
def _farthest(travelled, position, first, knots, slopes, before, known, away):
    """Fill the largest distance of the spline from positions (m, 3), from a knot to the next one.

    travelled, first: see ``places_on_program`` and ``_errors``; slopes: of ``natural_slopes``. before, known: knots and
    slopes for which ``away`` is filled.
    """
    earlier = 0
    for k in range(len(knots) - 1):
        while earlier < len(before) - 2 and before[earlier] < knots[k]:
            earlier += 1
        same = before[earlier] == knots[k] and before[earlier + 1] == knots[k + 1]
        for i in range(2):
            for j in range(3):
                same = same and known[earlier, i, j] == slopes[k, i, j]
        if same:
            continue
        start, end = first[knots[k]], first[knots[k + 1]]
        for n in range(knots[k], knots[k + 1]):
            most = 0.0
            for i in range(first[n], first[n + 1]):
                u, square = (travelled[i] - travelled[start]) / (travelled[end] - travelled[start]), 0.0
                for j in range(3):
                    move, a, b = position[end, j] - position[start, j], slopes[k, 0, j], slopes[k, 1, j]
                    cubic = position[start, j] + u * (a + u * (3 * move - 2 * a - b + u * (a + b - 2 * move)))
                    square += (cubic - position[i, j]) * (cubic - position[i, j])
                most = max(most, square)
            away[n] = math.sqrt(most)
