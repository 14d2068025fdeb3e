"""Contact of a tool on any axis, and of what is above its flutes, with the height map and with boxes.

A body is a convex solid of revolution about the axis of the tool: rows of ``profile.edge_parts`` from its lower end
upwards, the last one a cone or a cylinder. The lowest point of a body above a node is that of ``tilted``. A contact is
as deep as the surface of the map is above this point, times the cosine of the slope of the body there. Along the axis,
it reaches from the lower end of the body up to the surface, or to the place where the vertical line leaves the body.

Cells at the rim of a cut keep part of their height. Therefore a node counts only where it is further within the shadow
of the body than half a cell, and its material further within the side of the body. The depth along the axis gets this
distance back: at 60 deg it is 0.12 mm of a map of 0.1 mm.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from kr270_milling.base.compiled import compiled
from kr270_milling.physics.cutting.cut import CutModel
from kr270_milling.physics.cutting.engagement import RIM
from kr270_milling.physics.cutting.profile import RUN, cylinder, lines
from kr270_milling.physics.cutting.tilted import FLAT, MISSED, inside, shadow_rows, touch, turned_axis
from kr270_milling.physics.cutting.tool import Tool


class Grid(NamedTuple):
    """Place of the nodes of a height map [m]."""

    x: float  # of node 0
    y: float
    spacing: float
    nx: int
    ny: int
    top: float
    level_step: float


def bodies_of(tool: Tool) -> list[tuple[str, np.ndarray]]:
    """Return name and body of all that is known above the flutes; "flutes": the cutter above their upper end."""
    shank, bodies = (tool.shank_diameter or tool.diameter) / 2.0, []
    if tool.flute_length:
        bodies.append(("flutes", cylinder(float(tool.radii.max()), tool.flute_length)))
        if shank > tool.radius:
            bodies.append(("shank", cylinder(shank, tool.flute_length)))
    if tool.stick_out:
        wall = 3e-3  # [m], assumed: around the shank, of a slim shrink-fit chuck; a wider holder meets more
        points = tool.holder.reshape(-1, 2) if tool.holder.size else np.array([[shank + wall, 0.0]])
        points = points + [0.0, tool.stick_out]
        for start, end in zip(points, points[1:], strict=False):
            if end[1] > start[1]:
                bodies.append(("holder", lines(np.array([start, end]))))
        bodies.append(("holder", cylinder(*points[-1].tolist())))
    return bodies


def lowest_point(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return the height of the lowest of the circles (radius, height) about the axis above the tip [m], (n,)."""
    across = np.hypot(axes[:, 0], axes[:, 1])
    return functools.reduce(np.minimum, (h * axes[:, 2] - r * across for r, h in points))


def contact(cut: CutModel, body: np.ndarray, poses: np.ndarray, wide=0.0, deep=0.0) -> np.ndarray:
    """Return how deep a body is in the workpiece along its normal and along its axis at poses (n, 6) [m], (n, 2).

    wide, deep [m], numbers or (n,): contacts that are no wider or no deeper are left out.
    """
    p, depth = cut.params, np.zeros((len(poses), 2))
    grid = Grid(p.origin_x, p.origin_y, p.spacing, p.nx, p.ny, p.top, p.level_step)
    inset = np.broadcast_to(wide + RIM * p.spacing, len(poses))
    least = np.broadcast_to(np.maximum(deep, 2.0 * p.level_step), len(poses))
    hollow = bool((np.diff(np.arctan2(body[:, 5], body[:, 6])) < -1e-9).any())
    highest = cut.state.edge.highest  # type: ignore[union-attr]  # a tool that tilts has an edge
    _contact(cut.state.pool, cut.state.table, highest, grid, body, poses, inset, least, hollow, depth)
    return depth


@compiled
def _contact(pool, table, highest, grid, body, poses, inset, least, hollow, depth):
    """Fill depth (n, 2) with the contacts of a body at poses (n, 6)."""
    last = body.shape[0] - 1
    r, foot = body[last, 2], body[0, 1]
    for m in range(poses.shape[0]):
        ux, uy, s, c = turned_axis(poses[m, 3], poses[m, 4], poses[m, 5])
        tip_x, tip_y, top = poses[m, 0] - grid.x, poses[m, 1] - grid.y, grid.top - poses[m, 2]
        lowest, end = foot * c - r * s, min((top + r * s) / c, body[last, 3])
        if lowest >= top:
            continue
        low_x, high_x = min(foot * s * ux, end * s * ux) - r, max(foot * s * ux, end * s * ux) + r
        first_i = max(int(math.ceil((tip_x + low_x) / grid.spacing)), 0)
        last_i = min(int(math.floor((tip_x + high_x) / grid.spacing)), grid.nx - 1)
        for i in range(first_i, last_i + 1):
            x = i * grid.spacing - tip_x
            low_y, high_y = shadow_rows(x, foot * s, end * s, ux, uy, r)
            if low_y > high_y:
                continue
            low = max(int(math.ceil((tip_y + low_y) / grid.spacing)), 0)
            high = min(int(math.floor((tip_y + high_y) / grid.spacing)), grid.ny - 1)
            first = low & ~(RUN - 1)
            while first <= high:
                j, first = max(first, low), first + RUN
                stop = min(first - 1, high)
                slot, place, known = table[i >> 8, j >> 8], 0, 0.0
                if slot >= 0:
                    place = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
                    known = float(highest[np.uint64((place + j) // RUN)])
                if top - known * grid.level_step <= lowest + least[m]:
                    continue
                half = 0.5 * (stop - j) * grid.spacing
                y = j * grid.spacing - tip_y + half
                z, nu, nv, nz = touch(body, x * ux + y * uy, y * ux - x * uy, s, c)
                slope = abs((nu * uy + nv * ux) / min(nz, -1e-6)) * half
                if z != MISSED and not hollow and top - known * grid.level_step <= z - slope:
                    continue
                for n in range(j, stop + 1):
                    level = float(pool[np.uint64(place + n)]) if slot >= 0 else 0.0
                    surface, y = top - level * grid.level_step, n * grid.spacing - tip_y
                    u, v = x * ux + y * uy, y * ux - x * uy
                    z, nu, nv, nz = touch(body, u, v, s, c)
                    if z == MISSED or (surface - z) * -nz <= least[m] or inside(body, u, v, s, c)[0] <= inset[m]:
                        continue
                    beside, to_beside = u * c - z * s, u * c - surface * s  # the axis, up the vertical line
                    nearest = min(abs(beside), abs(to_beside)) if beside * to_beside > 0.0 else 0.0
                    if r - math.sqrt(nearest * nearest + v * v) <= inset[m]:  # at the rim of the end
                        continue
                    depth[m, 0] = max(depth[m, 0], (surface - z) * -nz)
                    if s > FLAT:
                        surface = min(surface, (u * c + math.sqrt(max(r * r - v * v, 0.0))) / s)
                    rest = inset[m] * s / c  # to the side of the body, up the surface
                    depth[m, 1] = max(depth[m, 1], u * s + surface * c - foot + rest)


@compiled
def below_top(body, poses, low, high, depth):
    """Raise depth (n,) to how far a body is below the top of a box with the corners low and high [m], at poses (n, 6).

    The lowest point of a convex body is a convex function of x and y. It is taken at places of the box below the
    shadow of the body: borders, middles and corners belong to them, so that the result is exact for an upright tool.
    """
    last, places = body.shape[0] - 1, 16
    r, foot = body[last, 2], body[0, 1]
    for m in range(poses.shape[0]):
        ux, uy, s, c = turned_axis(poses[m, 3], poses[m, 4], poses[m, 5])
        top = high[2] - poses[m, 2]
        end = min((top + r * s) / c, body[last, 3])
        if foot * c - r * s >= top:
            continue
        x0 = max(low[0] - poses[m, 0], min(foot * s * ux, end * s * ux) - r)
        x1 = min(high[0] - poses[m, 0], max(foot * s * ux, end * s * ux) + r)
        y0 = max(low[1] - poses[m, 1], min(foot * s * uy, end * s * uy) - r)
        y1 = min(high[1] - poses[m, 1], max(foot * s * uy, end * s * uy) + r)
        if x0 > x1 or y0 > y1:
            continue
        for i in range(places + 1):
            x = x0 + (x1 - x0) * i / places
            for j in range(places + 1):
                y = y0 + (y1 - y0) * j / places
                z, _, _, _ = touch(body, x * ux + y * uy, y * ux - x * uy, s, c)
                if z != MISSED:
                    depth[m] = max(depth[m], top - z)
