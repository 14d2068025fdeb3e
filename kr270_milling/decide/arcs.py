"""Arc of engagement along a programmed path: between which angles, and how deep, the teeth are in material.

The tool runs without deflection through a coarse height map. At a place the map still holds the material of the last
``LAG`` of the path; a node of it at the distance y to the left of the feed is cut by a tooth at asin(y / R).

The cells of ``physics.cutting.engagement`` are cut in part at the rim of the tool. There they keep the top of the
stock, so that a deeper pass along the same wall would seem as deep as all passes together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.compiled import compiled, inner
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.stage import Removal
from kr270_milling.decide.height_map import MAP_TURN, chord, height_map, lower, lower_along, on_map, with_profile

EVERY = 8  #: places from one evaluation to the next


@dataclass(frozen=True, eq=False)
class Arcs:
    """The m places of a path where the tool feeds through material, workpiece frame."""

    position: np.ndarray  #: tool tip [m], (m, 3)
    time: np.ndarray  #: [s], (m,)
    heading: np.ndarray  #: direction of the feed, from x [rad], (m,)
    feed: np.ndarray  #: programmed [m/s], (m,)
    feature: np.ndarray  #: index into ``features``, (m,)
    features: tuple[str, ...]
    depth: np.ndarray  #: deepest material above the tip [m], (m,)
    entry: np.ndarray  #: first angle of a tooth in material, from the feed in the sense of rotation [rad], (m,)
    exit: np.ndarray  #: last such angle [rad], (m,)
    spacing: float  #: [m], from place to place on the path


def arcs_along(path: CellPath, earlier: Sequence[Removal] = ()) -> Arcs:
    """The engagements of the programmed path, without rapid moves and steep ways down.

    earlier: material that other tools remove before.
    """
    radius = float(path.tool.radii.max())
    timed, target, stock = path.timed, path.target, path.stock
    length = path.length
    area = float(np.prod((stock.max - stock.min)[:2]))
    nodes_per_radius = 200  # of the height map: a finishing cut of 0.05 mm with a cutter of 20 mm covers a row of nodes
    most_visits = 1e9  # of nodes; a longer path takes a coarser map
    visits = 12.0  # nodes at each place, as a multiple of those in a radius
    most_nodes = 2e7  # of the height map
    step = max(
        radius / nodes_per_radius,
        (visits * length * radius / most_visits) ** 0.5,
        (area / most_nodes) ** 0.5,
    )
    distance = np.linspace(0.0, length, 2 + int(length / step))
    if timed:
        toolpath, swept = timed.toolpath, timed.toolpath.position_at(distance)
        distance = distance[::EVERY]
        block, (position, tangent, _) = toolpath.block_at(distance), toolpath.on_path(distance)
        time = np.interp(distance, timed.distance, target.time)
        rapid, feed, feature = toolpath.rapid[block], toolpath.feed[block], toolpath.feature[block]
        features = tuple(name or "unnamed" for name in toolpath.features)
    else:
        time = np.linspace(0.0, target.time[-1], distance.size)
        swept = target.sample(np.round(1e9 * time).astype(np.int64))
        time, position, distance = time[::EVERY], swept[::EVERY], distance[::EVERY]
        along = target.position[-1] - target.position[0]
        tangent = np.tile(along / np.linalg.norm(along), (distance.size, 1))
        rapid, feed = np.zeros(distance.size, bool), np.full(distance.size, path.feed_rate)
        feature, features = np.zeros(distance.size, np.int64), ("straight cut",)
    level = np.hypot(tangent[:, 0], tangent[:, 1])
    heading = np.arctan2(tangent[:, 1], tangent[:, 0])
    steep = 0.5  # horizontal part of a unit tangent below which the tool drills rather than mills
    look = ~rapid & (level > steep)
    grid = height_map(stock, step, swept, radius)
    for removal in earlier:
        lower_along(with_profile(grid, removal.cutter), removal.radius, on_map(removal.programmed))
    count, (depth, least, most) = np.zeros(distance.size, np.int64), np.zeros((3, distance.size))
    swept = on_map(swept)
    end = 1 + EVERY * int(np.flatnonzero(look)[-1]) if look.any() else 0  # a drill mills nothing
    _engage(grid, swept[:end], heading - MAP_TURN, radius, look, (count, depth, least, most))
    fewest_nodes = 3  # in material; fewer are the rounding of a curve
    some = count >= fewest_nodes
    left = (
        np.arcsin(np.clip((least[some] - step / 2) / radius, -1, 1)),
        np.arcsin(np.clip((most[some] + step / 2) / radius, -1, 1)),
    )
    entry, leave = left if path.tool.sense > 0.0 else (-left[1], -left[0])
    return Arcs(
        position[some],
        time[some],
        heading[some],
        feed[some],
        feature[some],
        features,
        depth[some],
        entry,
        leave,
        EVERY * step,
    )


@inner
def _lower_outside(grid, radius, path, start, k):
    """Lower what the tool cuts on a straight way; nodes below a tool that sinks follow when the tool leaves them.

    The deepest place of the tool above a node is the first, the last, or one where the tool stops to sink.
    """
    last, place = path[start], path[k]
    sinks, sank = place[2] < last[2], start > 0 and last[2] < path[start - 1, 2]
    if sinks:  # the same way back: what it finds cut is what the tool has not left yet
        lower(grid, grid.depth, radius, place, last, sinks)
        return
    if sank:
        lower(grid, grid.depth, radius, last, last, not sank)
    lower(grid, grid.depth, radius, last, place, k > 0)


@inner
def _straight(path, start, end):
    """Return whether evenly spaced places are on a straight line, on which the tool sinks all the way or never."""
    same_line = 1e-9  # [m]
    for k in range(start + 1, end + 1):
        if (path[k, 2] < path[k - 1, 2]) != (path[end, 2] < path[start, 2]):
            return False
        for j in range(3):
            line = path[start, j] + (k - start) / (end - start) * (path[end, j] - path[start, j])
            if abs(path[k, j] - line) > same_line:
                return False
    return True


@compiled
def _engage(grid, path, heading, radius, look, met):
    """Material in the tool at every eighth place: nodes, largest depth, least and largest distance to the left.

    heading, look: of the places that are evaluated; look: whether to evaluate the place.
    """
    lag = 10  # nodes: the crescent in front of the tool is then several nodes thick
    count, depth, least, most = met
    step = grid.step
    cuts = 1e-6  # [m] of depth, less is rounding
    for n in range(1 + (path.shape[0] - 1) // EVERY):
        k = n * EVERY
        before, at_once = max(k - lag, 0), 1
        if k >= lag:
            start = max(before - EVERY, 0)
            if start == 0:
                _lower_outside(grid, radius, path, 0, 0)
            if before > start and _straight(path, start, before):
                at_once = before - start
            for place in range(start, before, at_once):
                _lower_outside(grid, radius, path, place, place + at_once)
        if not look[n]:
            continue
        x, y, z = path[k]
        level = grid.top - max(z, path[before, 2]) - cuts  # a tool on its way down removes a little floor everywhere
        left_x, left_y = -np.sin(heading[n]), np.cos(heading[n])
        first_i = max(int((x - radius - grid.x) / step), 0)
        for i in range(first_i, min(int((x + radius - grid.x) / step) + 2, grid.depth.shape[0])):
            away_x = grid.x + i * step - x
            first_j, last_j = chord(away_x, y, radius**2, grid.y, step)
            skip_from, skip_to = 0, -1
            if k >= lag:  # there the tool was: the surface is no higher than ``level``
                skip_from, skip_to = chord(away_x + x - path[before, 0], path[before, 1], radius**2, grid.y, step)
            j, stop = max(first_j, grid.first[i]) - 1, min(last_j + 1, grid.end[i])
            while j + 1 < stop:
                j += 1
                if skip_from + 2 <= j <= skip_to - 2:
                    j = skip_to - 2
                    continue
                away_y = grid.y + j * step - y
                if grid.depth[i, j] >= level or away_x**2 + away_y**2 >= radius**2:
                    continue
                behind_x, behind_y = away_x + x - path[before, 0], away_y + y - path[before, 1]
                if k >= lag and behind_x**2 + behind_y**2 < radius**2:
                    continue
                left = left_x * away_x + left_y * away_y
                if count[n] == 0:
                    least[n], most[n] = left, left
                least[n], most[n] = min(least[n], left), max(most[n], left)
                depth[n] = max(depth[n], grid.top - z - grid.depth[i, j])
                count[n] += 1
