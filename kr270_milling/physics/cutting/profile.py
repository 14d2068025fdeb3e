"""Profile of a cutter of revolution: radius over height from the tip upwards, and the pieces of its edge.

The arc length sigma runs along the profile from the tip. The outward normal is n = sin(kappa) e - cos(kappa) a, with e
radial and a the axis from the tip to the holder: kappa is 0 at a flat end and at the tip of a ball, 90 deg on a
cylinder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kr270_milling.physics.cutting.tool import Tool

__all__ = ["Pieces", "outline", "pieces"]

ARC = math.radians(0.25)  # between two points of an arc: a chord stays within 2.4e-6 of its radius
TURN = math.radians(3.0)  # of the edge within a piece


class Pieces(NamedTuple):
    """Pieces of the edge from the tip upwards; above the last one the tool is a cylinder. Means are over the piece."""

    radius: np.ndarray  # edges of the pieces [m], (n + 1,)
    height: np.ndarray  # edges of the pieces [m], (n + 1,)
    length: np.ndarray  # of the edge [m], (n,)
    bend: np.ndarray  # half of its turn [rad], (n,)
    lever: np.ndarray  # mean r [m], (n,)
    middle: np.ndarray  # mean height [m], (n,)
    sine: np.ndarray  # mean sin(kappa), (n,)
    cosine: np.ndarray  # mean cos(kappa), (n,)
    sine_area: np.ndarray  # mean r sin(kappa) [m], (n,)
    cosine_area: np.ndarray  # mean r cos(kappa) [m], (n,)


def outline(tool: Tool) -> np.ndarray:
    """Return points (radius, height) [m] of the profile from the axis up to the largest radius, (n, 2)."""
    radius = float(tool.radii.max())
    if tool.type == "ball":
        points = _arc(0.0, radius, 0.5 * math.pi)
    elif tool.type == "bull_nose":
        points = _arc(radius - tool.corner_radius, tool.corner_radius, 0.5 * math.pi)
    elif tool.type == "tapered":
        points = _cone(tool, radius)
    elif tool.type == "points":
        points = tool.profile.reshape(-1, 2)
    else:
        points = np.array([[radius, 0.0]])
    return points if points[0, 0] == 0.0 else np.vstack([[0.0, points[0, 1]], points])


def _arc(centre: float, radius: float, turn: float) -> np.ndarray:
    """Return an arc about (centre, radius) [m] that begins level at the height 0 and turns up by an angle [rad]."""
    kappa = np.linspace(0.0, turn, 2 + int(turn / ARC))
    return np.column_stack([centre + radius * np.sin(kappa), radius * (1.0 - np.cos(kappa))])


def _cone(tool: Tool, radius: float) -> np.ndarray:
    """Return the tip and the cone of a tapered tool; a corner radius rounds the tip."""
    corner, turn = tool.corner_radius, 0.5 * math.pi - tool.taper
    tip = tool.tip_diameter / 2 or corner * math.tan(0.5 * turn)  # of the cone at the height of the tip
    if corner == 0.0:
        start = np.array([[tip, 0.0]])
    else:
        start = _arc(tip - corner * math.tan(0.5 * turn), corner, turn)
    return np.vstack([start, [radius, start[-1, 1] + (radius - start[-1, 0]) / math.tan(tool.taper)]])


def pieces(points: np.ndarray, radius: float) -> Pieces:
    """Divide the edge of an outline (n, 2) [m]: a piece turns by at most TURN and is at most WIDTH wide and 4 high."""
    fine = [points[:1]]
    # of a piece across the axis, as a share of the radius: the tip of a ball meets several in a shallow cut
    width = 0.05
    for before, after in zip(points, points[1:], strict=False):
        wide, high = np.abs(after - before) / radius
        count = max(1, math.ceil(wide / width - 1e-9), math.ceil(high / (4.0 * width) - 1e-9))
        fine.append(before + np.arange(1, count + 1)[:, None] / count * (after - before))
    fine_points = np.vstack(fine)
    step = np.diff(fine_points, axis=0)
    kappa = np.arctan2(step[:, 1], step[:, 0])
    first = [0]
    for k in range(1, len(step)):
        size = (fine_points[k + 1] - fine_points[first[-1]]) / radius
        if abs(kappa[k] - kappa[first[-1]]) > TURN or size[0] > 1.001 * width or size[1] > 4.004 * width:
            first.append(k)
    length, middle = np.hypot(*step.T), 0.5 * (fine_points[1:] + fine_points[:-1])
    total = np.add.reduceat(length, first)
    edges, last = fine_points[[*first, len(step)]], np.append(first[1:], len(step)) - 1
    bend = 0.5 * (kappa[last] - kappa[first]) + 0.5 * ARC * (kappa[last] > kappa[first])  # chords lie within the arc

    def mean(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values * length, first) / total

    sine, cosine, lever = np.sin(kappa), np.cos(kappa), middle[:, 0]
    means = (lever, middle[:, 1], sine, cosine, lever * sine, lever * cosine)
    return Pieces(edges[:, 0], edges[:, 1], total, bend, *map(mean, means))
