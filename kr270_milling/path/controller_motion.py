"""The motion of a robot program between its points: a C2 spline with an exact stop at both ends of each SPLINE block.

A program has points and no slopes. The planner, the score of a program and the reader of a program take the slopes
from here, so that all of them use the motion that the controller runs. LIN: straight lines and arcs,
``velocity=None``.

A program may have fewer points than the plan has knots. The points alone determine the path, ``places_on_program``; the
time law determines where on the path the tool is.

The rule of a real controller is not public. ``other_motion`` is a second rule for the same points.

[mxAutomation] KUKA.PLC mxAutomation Logix 1.0, manual, 2012, p. 25: CDIS is the distance to the end point at which
approximate positioning begins at the earliest; at most half the distance between start and end.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import solve_banded

from kr270_milling.base.blocks import blocks
from kr270_milling.path.trajectory import AT_REST, Trajectory, hermite


def block_ends(target: Trajectory) -> np.ndarray:
    """(n,) True at the knots where the slope is given: the first, the stops of the target and the last."""
    ends = target.standing.copy()
    ends[[0, -1]] = True
    return ends


def controller_motion(points: Trajectory, target: Trajectory, stops: np.ndarray | None = None) -> Trajectory:
    """Return the C2 spline in time through the points of the SPLINE blocks of a program for ``target``.

    It rests at the stops (n,) of the blocks; None: ``block_ends`` of a target with the same knots. A target that starts
    or ends in motion, as a straight cut does, gives the spline its velocity at that end.
    """
    stops = block_ends(target) if stops is None else stops
    slopes = np.zeros_like(points.position)
    ends = target.sample_velocity(target.time_ns[[0, -1]])
    slopes[[0, -1]] = np.where(np.linalg.norm(ends, axis=1, keepdims=True) <= AT_REST, 0.0, ends)
    return points.with_position(points.position, spline_slopes(points.time, points.position, stops, slopes))


def other_motion(run: Trajectory, target: Trajectory, share: float, blend_distance: float) -> Trajectory:
    """Return the motion through the points of ``run`` of a controller that joins them by another rule.

    share: 0 is ``run`` itself, 1 the other rule. A spline has the slope of the parabola through a point and its two
    neighbours, v_k = (h_k s_(k-1) + h_(k-1) s_k) / (h_(k-1) + h_k), h the durations and s the slopes of the chords.
    Straight lines are blended by parabolas, which leave their legs at d, the ``blend_distance`` [m] or half a leg, and
    miss the corner by d (e_k - e_(k-1)) / 4, e the directions. The ends and the stops of the target stay.
    """
    inner = np.linalg.norm(target.sample_velocity(run.time_ns[1:-1]), axis=1) > AT_REST
    move, step = np.diff(run.position, axis=0), np.diff(run.time)[:, None]
    if run.velocity is not None:
        slope, velocity = move / step, run.velocity.copy()
        local = (step[1:] * slope[:-1] + step[:-1] * slope[1:]) / (step[1:] + step[:-1])
        velocity[1:-1][inner] += share * (local - velocity[1:-1])[inner]
        return run.with_position(run.position, velocity)
    length = np.linalg.norm(move, axis=1, keepdims=True)
    turn = np.diff(move / np.where(length > 0.0, length, 1.0), axis=0)
    distance = np.minimum(blend_distance, np.minimum(length[:-1], length[1:]) / 2.0)
    position = run.position.copy()
    position[1:-1][inner] += share * (distance * turn / 4.0)[inner]
    return run.with_position(position)


def spline_slopes(time: np.ndarray, values: np.ndarray, fixed: np.ndarray, slopes=0.0) -> np.ndarray:
    """Slopes (n, 3) at times (n,) of the cubic spline through ``values`` (n, 3), C2 but at the knots ``fixed`` (n,).

    There the slope is that of ``slopes`` (n, 3), and the spline C1. The first and the last knot must be fixed.
    """
    step = np.diff(time)
    slope = np.diff(values, axis=0) / step[:, None]
    below, middle, above = np.zeros(time.size), np.ones(time.size), np.zeros(time.size)
    right = np.array(np.broadcast_to(slopes, values.shape))
    inner = 1 + np.flatnonzero(~fixed[1:-1])
    below[inner], above[inner] = step[inner], step[inner - 1]  # C2
    middle[inner] = 2.0 * (step[inner] + step[inner - 1])
    right[inner] = 3.0 * (step[inner, None] * slope[inner - 1] + step[inner - 1, None] * slope[inner])
    bands = np.stack([np.append(0.0, above[:-1]), middle, np.append(below[1:], 0.0)])
    return solve_banded((1, 1), bands, right)


def places_on_program(
    run: Trajectory,
    knots: np.ndarray,
    points: np.ndarray,
    stops: np.ndarray,
    spline: bool,
    blend: float | np.ndarray = 0.0,
    auxiliary: np.ndarray | None = None,
) -> np.ndarray:
    """Return the place [m], (n, 3), of each knot of a planned run on the path through the points of its program.

    knots: those that are points, (p,), the first and the last included; points [m], (p, 3); stops (p,) bool: ends of
    the SPLINE blocks. A place is as far along the path as the knot is along the chords of the run. spline: the C2 cubic
    spline over that distance in each block, without curvature at its ends; else straight lines, and arcs through the
    auxiliary points, (p,) bool, and the points before and after them. blend [m], a number or (p,): distance from a
    point where the tool leaves its line or arc for a parabola to the next one, at most half of a line or arc
    [mxAutomation]; none at stops.
    """
    travelled = run.travelled
    step, move = np.diff(travelled[knots])[:, None], np.diff(points, axis=0)
    slopes = natural_slopes(travelled[knots], points, stops) if spline else np.zeros((0, 2, 3))
    turn, normal = _arcs(points, None if spline else auxiliary)
    across = np.sin(turn / 2) * np.cross(normal, move)
    first, last = ((np.cos(turn / 2) * move + sign * across) / np.sinc(turn / 2 / np.pi) for sign in (-1, 1))
    inward = np.cross(normal, first)
    place = np.empty(run.position.shape)
    for part in blocks(len(run)):
        span = np.searchsorted(knots, np.arange(part.start, part.stop), side="right") - 1
        span = np.clip(span, 0, len(knots) - 2)
        u = (travelled[part] - travelled[knots[span]])[:, None] / step[span]
        if spline:
            place[part] = hermite(points[span], move[span], slopes[span, 0], slopes[span, 1], u)
            continue
        half = turn[span] * u / 2
        place[part] = points[span] + u * np.sinc(2 * half / np.pi) * first[span]
        place[part] += u * np.sin(half) * np.sinc(half / np.pi) * inward[span]
        if np.any(blend):
            place[part] += _rounding(first, last, turn[:, 0] > 0.0, np.where(stops, 0.0, blend), span, u[:, 0])
    return place


def _arcs(points: np.ndarray, auxiliary: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the turn [rad], (p - 1, 1), of the way from point to point about an axis, (p - 1, 3); 0 for a line.

    From the start a of an arc to its auxiliary point m the way turns by twice the angle at the end b, and from m to b
    by twice the angle at a (inscribed angles).
    """
    turn, normal = np.zeros((len(points) - 1, 1)), np.zeros((len(points) - 1, 3))
    middle = np.flatnonzero(np.zeros(0) if auxiliary is None else auxiliary)
    a, m, b = (points[middle + k] for k in (-1, 0, 1))
    across = np.cross(m - a, b - a)
    size = np.linalg.norm(across, axis=1)
    turn[middle - 1, 0] = 2.0 * np.arctan2(size, np.sum((a - b) * (m - b), axis=1))
    turn[middle, 0] = 2.0 * np.arctan2(size, np.sum((m - a) * (b - a), axis=1))
    normal[middle - 1] = normal[middle] = across / size[:, None]
    return turn, normal


def _rounding(
    first: np.ndarray, last: np.ndarray, arc: np.ndarray, blend: np.ndarray, span: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """Return the way [m], (m, 3), from places u (m,) on their lines ``span`` (m,) to the parabolas at the points.

    first, last (p - 1, 3): tangents of the lines and halves of arcs at both ends, as long as these; arc (p - 1,): half
    of an arc; blend (p,) [m]. From d before to d after a point the parabola is P + t^2 d e_k - (1 - t)^2 d e_(k-1), t
    from 0 to 1, e the directions: it misses the point by d (e_k - e_(k-1)) / 4. At an arc that way is added to it.
    """
    length = np.linalg.norm(first, axis=1)
    begins, ends = (row / np.where(length > 0.0, length, 1.0)[:, None] for row in (first, last))
    most = np.where(arc, length, length / 2.0)
    distance = np.zeros(len(blend))
    distance[1:-1] = np.minimum(blend[1:-1], np.minimum(most[:-1], most[1:]))
    way = np.zeros((len(u), 3))
    for point, signed in ((span, u * length[span]), (span + 1, (u - 1.0) * length[span])):
        d = distance[point]
        inside = np.abs(signed) < d
        at, d, signed = point[inside], d[inside, None], signed[inside, None]
        before, after = ends[at - 1], begins[at]
        t = 0.5 + 0.5 * signed / d
        line = signed * np.where(signed < 0.0, before, after)
        way[inside] = t**2 * d * after - (1.0 - t) ** 2 * d * before - line
    return way


def natural_slopes(travelled: np.ndarray, points: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Slopes over u, (p - 1, 2, 3), at both ends of the spans of natural cubic splines, one spline from stop to stop.

    travelled: distance to each point (p,). Equal slopes and curvatures inside of a block, no curvature at both ends.
    Row n of the system: a s_(n-1) + 2 s_n + b s_(n+1) = 3 (a c_(n-1) + b c_n), c the slopes of the chords, a + b = 1.
    With h the lengths of the spans a / b = h_n / h_(n-1); a = 0 at the start of a block, 1 where the block closes.
    """
    step, slopes = np.diff(travelled), np.empty((len(points) - 1, 2, 3))
    weight = np.append(0.0, step[1:] / (step[1:] + step[:-1]))
    weight[1:][stops[1:-1]] = 0.0
    _eliminate(weight, np.diff(points, axis=0) / step[:, None], np.append(weight[1:] == 0.0, True), slopes)
    return step[:, None, None] * slopes


@njit(cache=True, error_model="numpy", nogil=True)
def _eliminate(weight, chord, closes, slopes):
    """Fill the slopes over the distance; weight: a at the start of each span (p - 1,); closes: a block ends there."""
    last, ratio = len(weight) - 1, np.empty(len(weight))
    for n in range(last + 1):
        a, before = weight[n], max(n - 1, 0)
        pivot = 2.0 - a * ratio[before] if n else 2.0
        ratio[n] = (1.0 - a) / pivot
        for i in range(3):
            value = 3.0 * (1.0 - a) * chord[n, i]
            if n:
                value += a * (3.0 * chord[before, i] - slopes[before, 0, i])
            slopes[n, 0, i] = value / pivot
            slopes[n, 1, i] = (3.0 * chord[n, i] - slopes[n, 0, i]) / (2.0 - ratio[n])
    for n in range(last, -1, -1):
        for i in range(3):
            if not closes[n]:
                slopes[n, 1, i] = slopes[n + 1, 0, i]
            slopes[n, 0, i] -= ratio[n] * slopes[n, 1, i]
