"""Arc of engagement along a programmed path: between which angles, and how deep, the teeth are in material.

The tool runs without deflection through a coarse height map. At a place the map still holds the material of the last
``LAG`` of the path; a node of it at the distance y to the left of the feed is cut by a tooth at asin(y / R).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.cell.cell import Cell

__all__ = ["Arcs", "arcs_along"]

NODES_PER_RADIUS = 50  #: of the height map: a narrower cut is not seen
MOST_VISITS = 1e9  #: of nodes; a longer path takes a coarser map
LAG = 10  #: nodes, a fifth of the radius: the crescent in front of the tool is then several nodes thick
EVERY = 2  #: places from one evaluation to the next
FEWEST_NODES = 3  #: in material; fewer are the rounding of a curve
CUTS = 1e-6  #: [m] of depth, less is rounding
STEEP = 0.5  #: horizontal part of a unit tangent below which the tool drills rather than mills


@dataclass(frozen=True, eq=False)
class Arcs:
    """The m places of a path where the tool feeds through material, workpiece frame."""

    position: np.ndarray  #: tool tip [m], (m, 3)
    time: np.ndarray  #: [s], (m,)
    heading: np.ndarray  #: of the feed, from x [rad], (m,)
    feed: np.ndarray  #: programmed [m/s], (m,)
    feature: np.ndarray  #: index into ``features``, (m,)
    features: tuple[str, ...]
    depth: np.ndarray  #: deepest material above the tip [m], (m,)
    entry: np.ndarray  #: first angle of a tooth in material, from the feed in the sense of rotation [rad], (m,)
    exit: np.ndarray  #: last such angle [rad], (m,)
    spacing: float  #: [m], from place to place on the path


def arcs_along(cell: Cell) -> Arcs:
    """The engagements of the programmed path, without rapid moves and steep ways down."""
    radius = float(cell.tool.radii.max())
    timed, target = cell.timed_path, cell.target()
    length = timed.toolpath.length if timed else cell.path.length
    step = max(radius / NODES_PER_RADIUS, (2.0 * np.pi * length * radius**2 / MOST_VISITS) ** (1.0 / 3.0))
    distance = np.linspace(0.0, length, 2 + int(length / step))
    if timed:
        path, block = timed.toolpath, timed.toolpath.block_at(distance)
        position, tangent, _ = path.on_path(distance)
        time = np.interp(distance, timed.distance_at(target.time_ns), target.time)
        rapid, feed, feature = path.rapid[block], path.feed[block], path.feature[block]
        features = tuple(name or "unnamed" for name in path.features)
    else:
        time = np.linspace(0.0, target.time[-1], distance.size)
        position = target.sample(np.round(1e9 * time).astype(np.int64))
        along = target.position[-1] - target.position[0]
        tangent = np.tile(along / np.linalg.norm(along), (distance.size, 1))
        rapid, feed = np.zeros(distance.size, bool), np.full(distance.size, cell.path.feed_rate)
        feature, features = np.zeros(distance.size, np.int64), ("straight cut",)
    level = np.hypot(tangent[:, 0], tangent[:, 1])
    heading = np.arctan2(tangent[:, 1], tangent[:, 0])
    look = ~rapid & (level > STEEP)
    look[1::EVERY] = False
    low, high = cell.stock.min, cell.stock.max
    surface = np.full(tuple(np.maximum(1, np.ceil((high - low)[:2] / step)).astype(int)), high[2])
    count, (depth, least, most) = np.zeros(distance.size, np.int64), np.zeros((3, distance.size))
    _engage(surface, low[:2] + step / 2, step, position, heading, radius, look, (count, depth, least, most))
    some = count >= FEWEST_NODES
    left = (
        np.arcsin(np.clip((least[some] - step / 2) / radius, -1, 1)),
        np.arcsin(np.clip((most[some] + step / 2) / radius, -1, 1)),
    )
    entry, leave = left if cell.tool.sense > 0.0 else (-left[1], -left[0])
    return Arcs(
        position[some], time[some], heading[some], feed[some], feature[some], features, depth[some], entry, leave,
        EVERY * step,
    )  # fmt: skip


@njit(cache=True)
def _engage(surface, origin, step, position, heading, radius, look, met):
    """Material in the tool at each place of ``look``: nodes, largest depth, least and largest distance to the left."""
    count, depth, least, most = met
    reach = int(radius / step) + 1
    for k in range(position.shape[0]):
        before = max(k - LAG, 0)
        if k >= LAG:
            _lower(surface, origin, step, position[before], radius, reach)
        if not look[k]:
            continue
        x, y, z = position[k]
        level = max(z, position[before, 2]) + CUTS  # a tool on its way down removes a little floor everywhere
        left_x, left_y = -np.sin(heading[k]), np.cos(heading[k])
        middle_x, middle_y = int((x - origin[0]) / step), int((y - origin[1]) / step)
        for i in range(max(middle_x - reach, 0), min(middle_x + reach + 2, surface.shape[0])):
            away_x = origin[0] + i * step - x
            for j in range(max(middle_y - reach, 0), min(middle_y + reach + 2, surface.shape[1])):
                away_y = origin[1] + j * step - y
                if surface[i, j] <= level or away_x**2 + away_y**2 >= radius**2:
                    continue
                left = left_x * away_x + left_y * away_y
                if count[k] == 0:
                    least[k], most[k] = left, left
                least[k], most[k] = min(least[k], left), max(most[k], left)
                depth[k] = max(depth[k], surface[i, j] - z)
                count[k] += 1


@njit(cache=True)
def _lower(surface, origin, step, tip, radius, reach):
    """Lower the surface to the tool's end at one place."""
    middle_x, middle_y = int((tip[0] - origin[0]) / step), int((tip[1] - origin[1]) / step)
    for i in range(max(middle_x - reach, 0), min(middle_x + reach + 2, surface.shape[0])):
        away_x = origin[0] + i * step - tip[0]
        for j in range(max(middle_y - reach, 0), min(middle_y + reach + 2, surface.shape[1])):
            if surface[i, j] > tip[2] and away_x**2 + (origin[1] + j * step - tip[1]) ** 2 < radius**2:
                surface[i, j] = tip[2]
