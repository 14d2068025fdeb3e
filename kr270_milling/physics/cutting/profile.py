"""Profile of a cutter of revolution: radius over height from the tip upwards, and the pieces of its edge.

The arc length sigma runs along the profile from the tip. The outward normal is n = sin(kappa) e - cos(kappa) a, with e
radial and a the axis from the tip to the holder: kappa is 0 at a flat end and at the tip of a ball, 90 deg on a
cylinder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kr270_milling.physics.cutting.grid import Stock
from kr270_milling.physics.cutting.tool import Tool

ENTRIES = 4096  # of the profile from the axis to the radius
LEVEL = 1e-6  # cos(kappa) of a flat end is 1 to this
RUN = 16  # nodes of a row whose highest one is known
# Columns of ``Profile.pieces``: length [m], half of the turn [rad], then means over the piece: r and height above the
# tip [m], sin(kappa), cos(kappa), r sin(kappa), r cos(kappa)
LENGTH, BEND, LEVER, HEIGHT, SINE_K, COSINE_K, SINE_R, COSINE_R = range(8)
ARC = math.radians(0.25)  # between two points of an arc: a chord stays within 2.4e-6 of its radius


class Profile(NamedTuple):
    """Edge of a cutter of revolution in n pieces from the tip upwards, and its cylinder as the last piece."""

    height: np.ndarray  # float32, (ENTRIES + 2,): of the profile by the distance from the axis [levels]
    # float32, (m - 1, 5): of the lines and arcs, radius and height of the start, radius of the end and of the arc
    # [levels], slope of a line
    curves: np.ndarray
    # float32, same shape: r / (d height / d r) [nodes^2 / level]; a ramp cuts deepest lead slope ahead
    lead: np.ndarray
    piece: np.ndarray  # uint16, same shape: piece of the edge by the distance from the axis
    edges: np.ndarray  # (n + 1,): heights of the edges of the pieces [levels]
    pieces: np.ndarray  # (n + 1, 8): columns LENGTH to COSINE_R
    rims: np.ndarray  # (n + 1,): radii of the edges of the pieces [m]
    parts: np.ndarray  # (m, 7): ``edge_parts`` and the cylinder above them
    hollow: bool  # the profile is not convex


class EdgeBins(NamedTuple):
    """Part of the state of a cut by a tool with a profile."""

    highest: np.ndarray  # uint16, (nodes / RUN,): least level of the nodes of a run, or less
    # (bins, n + 1, 2), by angle and piece: levels removed in the present step, and before them their sum times
    # |cos(phi)|. Of an upright cutter: with ``each`` level lost for each level of height from z to ``end``, ``each`` of
    # the columns that begin less those that end in the piece, and the sum of each end less the sum of each z
    lost: np.ndarray
    raised: np.ndarray  # (bins,): those of the cylinder times their height above the tip [levels]
    work: np.ndarray  # float32, (13 RUN,): scratch of the nodes of a run
    entries: np.ndarray  # int32, the same: places in tables
    runs: np.ndarray  # int64, (any, 6): of each run that a step may lower, the arguments of ``_run``
    place: np.ndarray  # (12 RUN,), the same: from the tip [m]


def edge_parts(tool: Tool) -> np.ndarray:
    """Return the lines and arcs of the profile from the axis up to the largest radius, (m, 7).

    A row: radius and height of its start and of its end, radius of the arc or 0 [m], and kappa of a line or of the end
    of an arc as sine and cosine. An arc begins level; its middle is above its start.
    """
    radius, corner = float(tool.radii.max()), tool.corner_radius
    if tool.type == "points":
        return lines(tool.profile.reshape(-1, 2))
    if tool.type == "ball":
        return np.array([[0.0, 0.0, radius, radius, radius, 1.0, 0.0]])
    if tool.type == "bull_nose":
        arc = np.array([[radius - corner, 0.0, radius, corner, corner, 1.0, 0.0]])
        return np.vstack([lines(np.array([[radius - corner, 0.0]])), arc])
    if tool.type != "tapered":
        return lines(np.array([[radius, 0.0]]))
    turn = 0.5 * math.pi - tool.taper
    tip = tool.tip_diameter / 2 or corner * math.tan(0.5 * turn)  # of the cone at the height of the tip
    start = np.array([[tip - corner * math.tan(0.5 * turn), 0.0]])
    end = start + corner * np.array([[math.sin(turn), 1.0 - math.cos(turn)]])
    top = [radius, end[0, 1] + (radius - end[0, 0]) / math.tan(tool.taper)]
    arc = np.hstack([start, end, [[corner, math.sin(turn), math.cos(turn)]]])
    return np.vstack([lines(start), arc[: int(corner > 0.0)], lines(np.vstack([end, top]))[-1:]])


def lines(points: np.ndarray) -> np.ndarray:
    """Return the lines through points (radius, height) [m] as rows of ``edge_parts``; the first starts on the axis."""
    points = points if points[0, 0] == 0.0 else np.vstack([[0.0, points[0, 1]], points])
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)[:, None]
    return np.hstack([points[:-1], points[1:], 0.0 * length, step[:, ::-1] / length])


def cylinder(radius: float, height: float) -> np.ndarray:
    """Return the rows of ``edge_parts`` of a cylinder from a height above the tip upwards without end [m], (2, 7)."""
    return np.vstack([lines(np.array([[radius, height]])), [radius, height, radius, math.inf, 0.0, 1.0, 0.0]])


def cutter_of(tool: Tool) -> np.ndarray:
    """Return ``edge_parts`` of a tool and the cylinder above them, (m, 7)."""
    rows = edge_parts(tool)
    return np.vstack([rows, cylinder(float(tool.radii.max()), rows[-1, 3])[1:]])


def outline(tool: Tool) -> np.ndarray:
    """Return points (radius, height) [m] of the profile from the axis up to the largest radius, (n, 2)."""
    rows = [np.zeros((1, 2))]
    for r0, z0, r1, z1, corner, sine, cosine in edge_parts(tool):
        if corner:
            kappa = np.linspace(0.0, math.atan2(sine, cosine), 2 + int(math.atan2(sine, cosine) / ARC))[1:]
            rows.append(np.column_stack([r0 + corner * np.sin(kappa), z0 + corner * (1.0 - np.cos(kappa))]))
        else:
            rows.append(np.array([[r1, z1]]))
    return np.vstack(rows)


def profile_of(tool: Tool, stock: Stock, turn: float) -> tuple[Profile, float, float]:
    """Return the profile of a tool on the map of a stock, its radius and the radius of its flat end [m].

    A piece turns by at most ``turn`` [rad] and is at most ``width`` wide and 4 high.
    """
    points = outline(tool)
    radius, fine = float(points[-1, 0]), [points[:1]]
    # of a piece, as a share of the radius: the tip of a ball meets several in a shallow cut. At the axis, where most of
    # the volume of a piece is far from the axis, pieces are narrower, those of a line most of all
    width, growth = 0.06, np.zeros(0)
    for before, after in zip(points, points[1:], strict=False):
        wide, high = np.abs(after - before) / radius
        count = max(1, math.ceil(wide / width - 1e-9), math.ceil(high / (4.0 * width) - 1e-9))
        count *= 5 if count > 1 else 1
        growth = np.append(growth, np.full(count, width if count > 1 else 5.0 * width))
        fine.append(before + np.arange(1, count + 1)[:, None] / count * (after - before))
    fine_points = np.vstack(fine)
    widest = np.clip(growth * fine_points[:-1, 0] / radius, 1.2 * stock.grid_step / radius, width)
    step = np.diff(fine_points, axis=0)
    kappa = np.arctan2(step[:, 1], step[:, 0])
    first = [0]
    for k in range(1, len(step)):
        size = (fine_points[k + 1] - fine_points[first[-1]]) / radius
        bent = abs(kappa[k] - kappa[first[-1]]) > (turn if kappa[first[-1]] else 0.0)
        if bent or size[0] > 1.001 * widest[first[-1]] or size[1] > 4.004 * width:
            first.append(k)
    length, middle = np.hypot(*step.T), 0.5 * (fine_points[1:] + fine_points[:-1])
    total = np.add.reduceat(length, first)
    edges, last = fine_points[[*first, len(step)]], np.append(first[1:], len(step)) - 1
    bend = 0.5 * (kappa[last] - kappa[first]) + 0.5 * ARC * (kappa[last] > kappa[first])  # chords lie within the arc

    def mean(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values * length, first) / total

    sine, cosine, lever = np.sin(kappa), np.cos(kappa), middle[:, 0]
    means = [*map(mean, (lever, middle[:, 1], sine, cosine, lever * sine, lever * cosine))]
    pieces = np.column_stack([total, bend, *means])
    flat = pieces[:, COSINE_K] > 1.0 - LEVEL
    # the cylinder; the height is that of the piece below
    pieces = np.vstack([pieces, [1.0, 0.0, radius, pieces[-1, HEIGHT], 1.0, 0.0, radius, 0.0]])
    distance = np.minimum(np.arange(ENTRIES + 2) / ENTRIES, 1.0) * radius
    height = np.interp(distance, *points.T)
    lead = np.minimum(distance, radius) / np.maximum(np.gradient(height, distance[1]), 1e-9)
    lead[0] = lead[1]
    piece = np.clip(np.searchsorted(edges[:, 0], distance, side="right") - 1, 0, total.size - 1)
    piece[ENTRIES:] = total.size
    parts = cutter_of(tool)
    slopes = np.where(parts[:-1, 4] > 0.0, 0.0, parts[:-1, 5] / np.maximum(parts[:-1, 6], 1e-9))
    hollow = bool((np.diff(np.arctan2(parts[:, 5], parts[:, 6])) < -1e-9).any())
    profile = Profile(
        (height / stock.level_step).astype(np.float32),
        np.column_stack([parts[:-1, [0, 1, 2, 4]] / stock.level_step, slopes]).astype(np.float32, order="C"),
        np.minimum(lead * stock.level_step / stock.grid_step**2, 1e9).astype(np.float32),
        piece.astype(np.uint16),
        np.append(edges[:, 1] / stock.level_step, [math.inf, math.inf]),
        pieces,
        edges[:, 0].copy(),
        parts,
        hollow,
    )
    return profile, radius, float(edges[1:, 0][flat].max(initial=0.0))
