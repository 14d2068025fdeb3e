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
from scipy.linalg import solve_banded

from kr270_milling.base.blocks import blocks
from kr270_milling.base.compiled import compiled
from kr270_milling.path.trajectory import AT_REST, Trajectory


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
    if spline:
        first, last = np.ascontiguousarray(step * _natural_slopes(step, move / step, stops))
        _fill_places(travelled, knots, points, first, last, place := np.empty(run.position.shape))
        return place
    turn, normal = _arcs(points, auxiliary)
    across = np.sin(turn / 2) * np.cross(normal, move)
    first, last = ((np.cos(turn / 2) * move + sign * across) / np.sinc(turn / 2 / np.pi) for sign in (-1, 1))
    inward = np.cross(normal, first)
    place = np.empty(run.position.shape)
    for part in blocks(len(run)):
        span = np.searchsorted(knots, np.arange(part.start, part.stop), side="right") - 1
        span = np.clip(span, 0, len(knots) - 2)
        u = (travelled[part] - travelled[knots[span]])[:, None] / step[span]
        half = turn[span] * u / 2
        place[part] = points[span] + u * np.sinc(2 * half / np.pi) * first[span]
        place[part] += u * np.sin(half) * np.sinc(half / np.pi) * inward[span]
        if np.any(blend):
            place[part] += _rounding(first, last, turn[:, 0] > 0.0, np.where(stops, 0.0, blend), span, u[:, 0])
    return place


@compiled
def _fill_places(travelled, knots, points, first, last, place):
    """Fill the places (n, 3) at distances (n,) on the cubics between points; first, last: slopes of each over u."""
    k = 0
    for n in range(travelled.size):
        while k < knots.size - 2 and knots[k + 1] <= n:
            k += 1
        start = travelled[knots[k]]
        u = (travelled[n] - start) / (travelled[knots[k + 1]] - start)
        for i in range(3):
            move, a, b = points[k + 1, i] - points[k, i], first[k, i], last[k, i]
            place[n, i] = points[k, i] + u * a + u * u * (3 * move - 2 * a - b) + u * u * u * (a + b - 2 * move)


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


def _natural_slopes(step: np.ndarray, slope: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Slopes (2, p - 1, 3) at both ends of the spans of natural cubic splines, one spline from stop to stop.

    step (p - 1, 1): lengths of the spans; slope (p - 1, 3): mean slopes. Two unknowns for each span, so that a stop has
    a slope on both sides: equal slopes and curvatures inside of a block, no curvature at its ends.
    """
    count = len(step)
    ends = np.concatenate([[True], stops[1:-1], [True]])
    begins, closes = ends[:-1], ends[1:]  # of the spans
    h = step[:, 0]
    # unknowns in the order of the path: the first and the last slope of span 0, of span 1, ...
    bands, right = np.zeros((5, 2 * count)), np.zeros((2 * count, 3))

    def put(row: np.ndarray, offset: int, value) -> None:
        bands[2 - offset, row + offset] = value

    k = np.flatnonzero(begins)
    put(2 * k, 0, 2.0)
    put(2 * k, 1, 1.0)
    right[2 * k] = 3.0 * slope[k]
    k = np.flatnonzero(~begins)  # its first slope is the last one of the span before
    put(2 * k, 0, 1.0)
    put(2 * k, -1, -1.0)
    k = np.flatnonzero(closes)
    put(2 * k + 1, 0, 2.0)
    put(2 * k + 1, -1, 1.0)
    right[2 * k + 1] = 3.0 * slope[k]
    k = np.flatnonzero(~closes)  # equal curvatures at the end of span k and at the start of span k + 1
    put(2 * k + 1, -1, h[k + 1])
    put(2 * k + 1, 0, 2.0 * (h[k] + h[k + 1]))
    put(2 * k + 1, 2, h[k])
    right[2 * k + 1] = 3.0 * (h[k + 1, None] * slope[k] + h[k, None] * slope[k + 1])
    return solve_banded((2, 2), bands, right).reshape(count, 2, 3).swapaxes(0, 1)
