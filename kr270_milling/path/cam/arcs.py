"""Arcs of one plane as chords that touch the arc at both ends; x and y are its axes here, z the one across it."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import BSpline

from kr270_milling.path.toolpath import REACH

FAR = f"the arc leads more than {REACH:g} m away; wrong unit?"


class ArcError(ValueError):
    """An arc that its numbers do not define; the text says why, lengths in mm."""


def centre_from_radius(start, end, radius: float, clockwise: bool, tolerance: float) -> tuple[float, float]:
    """Centre (x, y) [m] of the arc from start to end; a negative radius takes the longer of the two arcs."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    chord = math.hypot(dx, dy)
    if chord == 0:
        raise ArcError("an arc given by R must end elsewhere than it starts; give I and J for a full circle")
    if not chord <= 2 * (abs(radius) + tolerance):
        raise ArcError(f"the arc does not close: radius {1e3 * radius:g} mm, but {1e3 * chord:g} mm from start to end")
    height = math.sqrt(max(0.0, radius**2 - chord**2 / 4))
    side = -1.0 if clockwise == (radius > 0) else 1.0  # side of the centre, seen along the chord: +1 left, -1 right
    return (start[0] + dx / 2 - side * height * dy / chord, start[1] + dy / 2 + side * height * dx / chord)


def curve_points(control: list[complex], tolerance: float) -> tuple[list[complex], float]:
    """Points of a Bezier curve of degree 2 or 3 [m] after its start, its end being the last one, and its length.

    control: its control points x + i y. Between n chords of equal parameter steps the curve is within B'' / (8 n^2),
    with B'' <= d (d - 1) max |P_k - 2 P_k+1 + P_k+2| for degree d (Farin 2002, 5.6).
    """
    if not all(abs(point) <= REACH for point in control):
        raise ArcError("the control points of the curve lie too far away; wrong unit?")
    degree = len(control) - 1
    bends = [abs(a - 2 * b + c) for a, b, c in zip(control, control[1:], control[2:], strict=False)]
    count = max(1, math.ceil(math.sqrt(degree * (degree - 1) * max(bends) / (8 * tolerance))))
    points = [control[0]]
    for k in range(1, count):
        row = control
        while len(row) > 1:  # de Casteljau
            row = [a + (b - a) * k / count for a, b in zip(row, row[1:], strict=False)]
        points += row
    points.append(control[-1])
    return points[1:], sum(abs(b - a) for a, b in zip(points, points[1:], strict=False))


def nurbs_points(
    control: list[complex], weights: list[float], knots: list[float], tolerance: float
) -> tuple[list[complex], float]:
    """Points of a rational B-spline after its start [m], and its length; control: its points x + i y.

    The knots state the degree. Chords are halved until their middle and quarters are within ``tolerance``.
    """
    degree = len(knots) - len(control) - 1
    inside = knots[degree : len(control) + 1]
    if degree < 1 or len(control) <= degree or knots != sorted(knots) or not inside[-1] > inside[0]:
        raise ArcError("the knots of the curve do not belong to its points")
    if not all(abs(point) <= REACH for point in control) or not min(weights) > 0:
        raise ArcError("a curve needs weights above zero and points within reach")
    place, weight = np.array(control), np.array(weights)
    spline = BSpline(knots, np.column_stack([weight * place.real, weight * place.imag, weight]), degree)

    def at(u: np.ndarray) -> np.ndarray:
        x, y, w = spline(u).T
        return (x + 1j * y) / w

    u = np.unique(inside)
    for _ in range(20):
        start, way = at(u[:-1]), np.diff(at(u))
        off = [np.abs(at(u[:-1] + share * np.diff(u)) - start - share * way) for share in (0.25, 0.5, 0.75)]
        far = np.max(off, axis=0) > tolerance
        if not far.any():
            break
        u = np.sort(np.concatenate([u, (u[:-1] + 0.5 * np.diff(u))[far]]))
    points = at(u)
    return points[1:].tolist(), float(np.abs(np.diff(points)).sum())


def arc_points(
    start, end, centre, clockwise: bool, closing: float, tolerance: float, turns: int = 0
) -> tuple[list[tuple[float, ...]], float, float]:
    """Ends (x, y, z) of the chords [m] of an arc or a helix about ``centre``, its curvature [1/m] and length in xy [m].

    start, end [m], (3,); equal in x and y they mean a full circle. closing: how far start and end may differ in their
    distance from the centre; tolerance: largest distance of the arc from a chord; turns: full ones before the arc.
    The last point is ``end`` itself.
    """
    first = math.hypot(start[0] - centre[0], start[1] - centre[1])
    last = math.hypot(end[0] - centre[0], end[1] - centre[1])
    if not abs(first - last) <= closing:
        raise ArcError(
            f"the arc does not close: its start is {1e3 * first:.4f} mm from the centre, its end {1e3 * last:.4f} mm"
        )
    if not min(first, last) > 0:
        raise ArcError("the arc has no radius")
    angle = math.atan2(start[1] - centre[1], start[0] - centre[0])
    sweep = (math.atan2(end[1] - centre[1], end[0] - centre[0]) - angle) % (2 * math.pi)
    if math.hypot(end[0] - start[0], end[1] - start[1]) < 1e-9:
        sweep = 2 * math.pi
    elif clockwise:
        sweep -= 2 * math.pi
    if clockwise and sweep > 0:
        sweep = -sweep
    if not 0 <= turns <= 1000:
        raise ArcError(f"a helix of {turns} turns is not meant")
    sweep += math.copysign(2 * math.pi * turns, -1.0 if clockwise else 1.0)
    length = abs(sweep) * (first + last) / 2
    if not length <= 8 * REACH * (turns + 1):  # around the square of all places within reach
        raise ArcError(FAR)
    radius = max(first, last)
    step = 2 * math.acos(max(1 - tolerance / radius, math.cos(math.pi / 4)))  # at least 4 chords to the circle
    count = max(1, math.ceil(abs(sweep) / step))
    points: list[tuple[float, ...]] = []
    for k in range(1, count):
        place = k / count
        around, distance = angle + place * sweep, first + place * (last - first)
        x, y = centre[0] + distance * math.cos(around), centre[1] + distance * math.sin(around)
        points.append((x, y, start[2] + place * (end[2] - start[2])))
    points.append(tuple(end))
    if not all(min(row) >= -REACH and max(row) <= REACH for row in zip(*points, strict=True)):
        raise ArcError(FAR)
    return points, math.copysign(2 / (first + last), sweep), length
