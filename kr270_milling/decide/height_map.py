"""The stock under the programmed path as depths at points: one removal for contacts, depths of cut and arcs.

A node is cut where the axis of the tool comes nearer than its radius, whatever the distance of the places of the path.
The cells of ``physics.cutting.engagement``, which are cut in part, are right for forces, but not for such a contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from kr270_milling.base.compiled import INNER, compiled, inner
from kr270_milling.physics.cutting import Stock, Tool
from kr270_milling.physics.cutting.profile import outline

#: [rad], from x of the workpiece to the first axis of the map. The tangent is the golden ratio less 1: no wall along x,
#: y or a diagonal lies on a row of nodes, so that a long contact far narrower than the node step still covers nodes
MAP_TURN = math.atan((math.sqrt(5.0) - 1.0) / 2.0)
ROUNDING = 1e-7  #: [m], of depths (float32) and radii
merged = njit(**INNER, inline="always")
ENTRIES = 512  #: of a profile
VERTICAL = 1e-20  #: [m^2], square of the horizontal length below which a move is vertical
LONGEST = 8  #: nodes of a move of a flat end at once; the profile of another end is compared at a node's distance


class HeightMap(NamedTuple):
    """Node (i, j) is at (x + i step, y + j step) in the turned axes; only nodes that were cut take memory."""

    depth: np.ndarray  # removed below the top of the stock [m], float32, (n, m)
    first: np.ndarray  # first node of each column over the stock, (n,)
    end: np.ndarray  # one after the last such node, (n,)
    x: float
    y: float
    step: float
    top: float
    profile: np.ndarray  # height of the tool by the distance from its axis, up to ``radius`` [m]; (0,): a flat end
    radius: float  # of the profile [m]
    rim: np.ndarray  # scratch: two ranges of nodes of each column, int32, (4, n)


def on_map(position: np.ndarray) -> np.ndarray:
    """Positions (m, 3) of the workpiece frame in the axes of a map [m]."""
    c, s = math.cos(MAP_TURN), math.sin(MAP_TURN)
    x, y, z = np.asarray(position).T
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def with_profile(grid: HeightMap, tool: Tool | None) -> HeightMap:
    """Return the map for a tool; None: a flat end."""
    if tool is None or tool.has_flat_end:
        return grid._replace(profile=np.zeros(0), radius=0.0)
    points = outline(tool)
    radius = float(points[-1, 0])
    profile = np.interp(np.arange(ENTRIES + 1) / ENTRIES * radius, *points.T)
    return grid._replace(profile=profile, radius=radius)


def height_map(stock: Stock, step: float, position: np.ndarray, radius: float) -> HeightMap:
    """The uncut stock where a tool of a radius [m] reaches it from the positions (m, 3) [m]; step [m]: of the nodes."""
    low, high = stock.min, stock.max
    near = np.maximum(low[:2], position[:, :2].min(axis=0) - radius)
    far = np.maximum(near, np.minimum(high[:2], position[:, :2].max(axis=0) + radius))
    corners = on_map(np.array([[x, y, 0.0] for x in (near[0], far[0]) for y in (near[1], far[1])]))[:, :2]
    origin = corners.min(axis=0) + 0.5 * step
    columns, rows = np.maximum(1, np.ceil(np.ptp(corners, axis=0) / step)).astype(int).tolist()
    along = origin[0] + step * np.arange(columns)
    c, s = math.cos(MAP_TURN), math.sin(MAP_TURN)  # x = c u - s v, y = s u + c v
    least = np.maximum((c * along - high[0]) / s, (low[1] - s * along) / c)
    most = np.minimum((c * along - low[0]) / s, (high[1] - s * along) / c)
    return HeightMap(
        np.zeros((columns, rows), np.float32),
        np.clip(np.ceil((least - origin[1]) / step), 0, rows).astype(np.int32),
        np.clip(np.floor((most - origin[1]) / step) + 1, 0, rows).astype(np.int32),
        float(origin[0]),
        float(origin[1]),
        step,
        float(high[2]),
        np.zeros(0),
        0.0,
        np.zeros((4, columns), np.int32),
    )


@merged
def chord(away_x, y, square, origin, step):
    """First and last node of a column within a circle about (0, y), to a node; away_x: of the column; square: of the
    radius. A column beside the circle gives an empty range.
    """
    rest = square - away_x**2
    if rest <= 0.0:
        return 1 << 30, -(1 << 30)
    half = np.sqrt(rest)
    return int((y - half - origin) / step), int((y + half - origin) / step) + 1


@inner
def lower(grid, depth, radius, start, end, cleared):
    """Lower the nodes of ``depth`` to the end of the tool on a straight way from one place (3,) to another.

    Only nodes count that neither ``depth`` nor ``grid`` has as deep. cleared: whether all nodes within the radius of
    the start are that deep. Returns the deepest material of ``grid`` within the radius [m], and its volume [m^3].
    """
    nodes = math.hypot(end[0] - start[0], end[1] - start[1]) / grid.step
    parts = 1 + int(nodes if grid.profile.size else (nodes - 1e-6) / LONGEST)
    deepest = volume = 0.0
    x, y, below = start[0], start[1], grid.top - start[2]
    for k in range(parts):
        share = (k + 1.0) / parts
        to_x, to_y = start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])
        to_below = grid.top - start[2] - share * (end[2] - start[2])
        if max(below, to_below) > 0.0:
            part = _lower(grid, depth, radius, x, y, below, to_x, to_y, to_below, cleared or k > 0)
            deepest, volume = max(deepest, part[0]), volume + part[1]
        x, y, below = to_x, to_y, to_below
    return deepest, volume


@inner
def _lower(grid, depth, radius, x, y, below, to_x, to_y, to_below, cleared):
    """``lower`` on a way of at most ``LONGEST`` nodes; below, to_below: depths of the tip at its ends."""
    step, square, move_x, move_y = grid.step, radius**2, to_x - x, to_y - y
    way, most = move_x**2 + move_y**2, max(below, to_below)
    flat = grid.profile.size == 0
    cleared = cleared and to_below <= below and flat  # the tool is nowhere deeper than at the start
    deepest = volume = 0.0
    first_i = max(int((min(x, to_x) - radius - grid.x) / step), 0)
    end_i = max(min(int((max(x, to_x) + radius - grid.x) / step) + 2, depth.shape[0]), first_i)
    rim = grid.rim
    _rim(grid, square, x, y, move_x, move_y, cleared, first_i, end_i)
    for i in range(first_i, end_i):
        away_x = grid.x + i * step - x
        for part in range(0, 4, 2):
            for j in range(max(rim[part, i], grid.first[i]), min(rim[part + 1, i] + 1, grid.end[i])):
                before = grid.depth[i, j]
                if max(before, depth[i, j]) + ROUNDING >= most:
                    continue
                away_y = grid.y + j * step - y
                along, beside = 0.0, away_x**2 + away_y**2
                if way > VERTICAL:
                    along = (away_x * move_x + away_y * move_y) / way
                    beside -= along**2 * way
                tip = _deepest(along, beside, way, square, below, to_below)
                if not flat and tip > before:
                    tip = _deepest_of_profile(grid, along, beside, way, radius, below, to_below, before)
                if max(before, depth[i, j]) + ROUNDING < tip:
                    deepest = max(deepest, tip - before)
                    volume += (tip - before) * step**2
                    depth[i, j] = tip
    return deepest, volume


@inner
def _rim(grid, square, x, y, move_x, move_y, cleared, first_i, end_i):
    """Fill ``grid.rim`` with the nodes of each column that a move may lower, last ones included.

    cleared: the circle about (x, y) is as deep; the ranges are then below and above the circle, else the first has all.
    An end of the chord that is not farthest at an end of the move has a slack of twice the move, and each has that of a
    rounding.
    """
    scale, tiny, rim = 1.0 / grid.step, 1e-6, grid.rim
    slack = tiny + 2.0 * scale * math.sqrt(move_x**2 + move_y**2)
    for i in range(first_i, end_i):
        u = grid.x + i * grid.step - x
        w = u - move_x
        rest, to_rest = square - u * u, square - w * w
        half, to_half = np.sqrt(max(rest, 0.0)), np.sqrt(max(to_rest, 0.0))
        meets, to_meets = rest > 0.0, to_rest > 0.0
        low, high = (y - half - grid.y) * scale, (y + half - grid.y) * scale
        to_low, to_high = (y + move_y - to_half - grid.y) * scale, (y + move_y + to_half - grid.y) * scale
        both = meets and to_meets and cleared
        down = both and (move_y * half - u * move_x) * (move_y * to_half - w * move_x) > 0.0
        up = both and (move_y * half + u * move_x) * (move_y * to_half + w * move_x) > 0.0
        least = min(low if meets else np.inf, to_low if to_meets else np.inf) - (tiny if down else slack)
        most = max(high if meets else -np.inf, to_high if to_meets else -np.inf) + (tiny if up else slack)
        beside = not (meets and cleared)
        none = not (meets or to_meets)
        rim[0, i] = np.int32(0 if none else np.ceil(least))
        rim[1, i] = np.int32(-1 if none else np.floor(most if beside else low + tiny))
        rim[2, i] = np.int32(0 if beside else max(np.ceil(high - tiny), np.floor(low + tiny) + 1.0))
        rim[3, i] = np.int32(-1 if beside else np.floor(most))


@merged
def _deepest(along, beside, way, square, below, to_below):
    """Deepest place of a straight way while a node is within the radius; -inf where no place is.

    along: of the node's projection, a share of the way; beside: square of its distance from the line of the way; way:
    square of the horizontal length; square: of the radius; below, to_below: depths at both ends.
    """
    if beside >= square:
        return -np.inf
    if way <= VERTICAL:
        return max(below, to_below)
    half = np.sqrt((square - beside) / way)
    first, last = max(along - half, 0.0), min(along + half, 1.0)
    if first > last:
        return -np.inf
    return below + (to_below - below) * (last if to_below > below else first)


@merged
def _deepest_of_profile(grid, along, beside, way, radius, below, to_below, before):
    """As ``_deepest``, less the height of the profile: the deepest of the place next to the node and of both ends.

    radius: of the tool, less than that of the profile where its sides are taken back. -inf: not below ``before``.
    """
    entry, back, tip = (grid.profile.size - 1) / grid.radius, grid.radius - radius, -np.inf
    for place in (min(max(along, 0.0), 1.0), 0.0, 1.0):
        distance = np.sqrt(max(beside + (along - place) ** 2 * way, 0.0))
        if distance >= radius:
            continue
        at = (distance + back) * entry
        k = min(int(at), grid.profile.size - 2)
        height = grid.profile[k] + (at - k) * (grid.profile[k + 1] - grid.profile[k])
        if tip == -np.inf and max(below, to_below) - height <= before:
            return -np.inf
        tip = max(tip, below + place * (to_below - below) - height)
    return tip


@inner
def near_axis(grid, lost, radius, place, number):
    """Return the largest depth that a node lost while the axis of the tool stayed near [m], and the least depth [m].

    Near is within ``radius`` of ``place``. lost: depth of each node when the axis came near, and the number of the
    last place that was near, (2, n, m); number: of this place, one more than that of the place before; below 0: no
    node loses.
    """
    most, least = 0.0, np.inf
    first_i = max(int((place[0] - radius - grid.x) / grid.step), 0)
    for i in range(first_i, min(int((place[0] + radius - grid.x) / grid.step) + 2, grid.depth.shape[0])):
        away_x = grid.x + i * grid.step - place[0]
        first_j, last_j = chord(away_x, place[1], radius**2, grid.y, grid.step)
        for j in range(max(first_j, grid.first[i]), min(last_j + 1, grid.end[i])):
            if away_x**2 + (grid.y + j * grid.step - place[1]) ** 2 >= radius**2:
                continue
            least = min(least, grid.depth[i, j])
            if number < 0:
                continue
            if lost[1, i, j] != number - 1:
                lost[0, i, j] = grid.depth[i, j]
            lost[1, i, j] = number
            most = max(most, grid.depth[i, j] - lost[0, i, j])
    return most, least


@compiled
def lower_along(grid, radius, path):
    """Lower the map along straight ways through the places (m, 3) of a tool."""
    for k in range(path.shape[0]):
        lower(grid, grid.depth, radius, path[max(k - 1, 0)], path[k], k > 0)
