"""Checks of the cut: is anything removed, do rapid moves or plunges meet material, can tool and spindle do it;
does vibration grow in the simulated pass."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from kr270_milling.base.column import column
from kr270_milling.base.compiled import compiled
from kr270_milling.base.frames import lifted, tool_axis
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import path_of
from kr270_milling.cell.stage import cleared
from kr270_milling.decide.findings import Finding, stretches, violation, violations
from kr270_milling.decide.height_map import ROUNDING, height_map, lower, lower_along, near_axis, on_map, with_profile
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import EngagementCut, Stock
from kr270_milling.physics.cutting.contact import below_top, bodies_of, contact, lowest_point
from kr270_milling.physics.cutting.engagement import RIM, SWING
from kr270_milling.physics.cutting.profile import cutter_of, cylinder, outline
from kr270_milling.physics.cutting.tilted import FLAT
from kr270_milling.physics.motion.milling_pass import PassResult

#: sine of the slope above which a way down is a plunge: no maker allows a steeper ramp without centre cutting
PLUNGE = math.sin(math.radians(20.0))  # [Kyocera2021]: 20 deg at 25 mm, 16, 12.5, 11, 8.5, 6 deg at 28 to 50 mm
INSERT_RAMP = math.tan(math.radians(20.0))
#: [m], [Kyocera2021]: a bore of 2 D - 16 mm at least, so that the inserts cut 8 mm of the radius. A ramp at the angles
#: above sinks 3.3 to 3.7 mm while the core passes a place (3.5 mm a turn are allowed): the depth of the hollow
INSERT_WIDTH, HOLLOW = 8e-3, 3.7e-3
#: [m], and share of the radius: the centre hole in the end of a solid mill, DIN 332-1 A (4.25 mm wide at 10 mm)
CENTRE_HOLE, CENTRE_SHARE = 2e-3, 0.4
#: share of the diameter, and [m], a tooth. Makers give 0.005 to 0.02 of the diameter for aluminium ([Tungaloy2020]:
#: 0.03 to 0.17 mm at 5 to 20 mm), and at most 0.41 mm for any cutter ([Mitsubishi2020]: 0.016 in at up to 125 mm)
USUAL_FEED, LARGEST_USUAL_FEED = 0.03, 0.41e-3
#: assumed: five times those shares; and 2.3 times that feed, as thin chips allow at a width of 5 % of the diameter
MOST_FEED, LARGEST_FEED = 0.1, 0.94e-3
#: [N/m^2]. Cemented carbide: the largest stress of rotating bending tests, 700 to 1400 N/mm2 [Stephenson1984], 70 % of
#: a flexural strength of 2000 N/mm2, as at 10^7 cycles [Nakajima2007]. High-speed steel: assumed
CARBIDE_STRENGTH, STEEL_STRENGTH = 1400e6, 1000e6
FEWEST_TEETH = 60  #: in one stretch of cutting; fewer say nothing about growth
#: share of the feed per tooth, median of the thirds of ``FEWEST_TEETH``: measured up to 0.11 in sound cuts of 8 to
#: 80 um a tooth, mostly noise of the grid in thin chips, and 0.19 to 8 where teeth leave the material in chatter
CHATTERS = 0.15


@dataclass(frozen=True, eq=False)
class Engagement:
    """At m places along the programmed path, workpiece frame."""

    position: np.ndarray  #: tool tip [m], (m, 3)
    axes: np.ndarray  #: unit vector from the tip to the holder, (m, 3)
    lowest: np.ndarray  #: height of the lowest point of the whole tool [m], (m,)
    time: np.ndarray  #: [s], (m,)
    rapid: np.ndarray  #: on a rapid move, (m,)
    block: np.ndarray  #: block of the tool path that leads to the place, (m,)
    series: np.ndarray  #: number of the rapid moves between two cutting moves, from 1; 0: a cutting move; (m,)
    depth: np.ndarray  #: deepest material within the radius of the tool above its tip, along a tilted axis [m], (m,)
    inner: np.ndarray  #: deepest material that a rapid move meets within a smaller radius, see ``engagement`` [m], (m,)
    sunk: np.ndarray  #: largest depth that material lost while it was below the core of a cutter with one [m], (m,)
    shank: np.ndarray  #: depth of the shank in material along the axis [m], (m,)
    holder: np.ndarray  #: depth of the holder in material along the axis [m], (m,)
    margin: np.ndarray  #: [m], (m,), up to which ``inner`` is no contact
    volume: np.ndarray  #: volume that rapid moves remove on the way to the place [m^3], (m,)


Contacts = tuple[list[Finding], list[Finding]]


def engagement(cell: Cell, margin: float, ran: ScoredPass | None = None) -> Engagement:
    """Run the programmed path through the stock on a height map of nodes; default: without deflection.

    ``inner`` compares the rapid moves between two cutting moves, as a whole, with the material before the first of
    them. The distance between places and the stiffness of the arm therefore do not matter.

    margin [m]: ``inner`` leaves out contacts that are no deeper or no wider; ran: a pass whose deviation the
    places have. ``inner`` belongs to the place that removes the material. Where the tool leaves along its axis, or goes
    down again along its cut, the deflection of the arm at this moment is no contact either: it is in its hole, and
    inertia may bend the arm by more than the cut did.
    """
    position, axes, time, block, rapid, step, apart = _places(cell)
    series = np.where(rapid, np.cumsum(np.diff(rapid, prepend=False) & rapid), 0)
    depth, inner, volume, sunk, shank, holder = met = np.zeros((6, len(position)))
    radius = float(cell.tool.radii.max())
    moved, lowest, (sideways, lengthwise) = position, position[:, 2], np.zeros((2, len(position)))
    if ran is not None:
        at_ns, passed, moved = 1e9 * time, ran.result, position.copy()
        for k in range(3):
            moved[:, k] += np.interp(at_ns, passed.time_ns, passed.actual[:, k] - passed.target[:, k])
        bend = np.stack([np.interp(at_ns, passed.time_ns, passed.deflection[:, k]) for k in range(3)], axis=1)
        across, along = (np.maximum(d, np.r_[d[:1], d[:-1]]) for d in map(np.abs, _split(bend, axes)))  # at both ends
        leaves, again = _along_axis(position, axes, rapid, math.hypot(apart, cell.limits.rapid_contact))
        sideways, lengthwise = np.where(leaves | again, across, 0.0), np.where(leaves, along, 0.0)
    core = core_radius(radius) if ran is None and not cell.tool.centre_cutting else 0.0
    bodies = bodies_of(cell.tool) if ran is None else []
    if path_of(cell).lean:
        lowest = lowest + lowest_point(outline(cell.tool), axes)
        for _, body in bodies:
            lowest = np.minimum(lowest, position[:, 2] + lowest_point(body[:1, 2:4], axes))
        margins = np.stack([max(margin, ROUNDING) + sideways, margin + lengthwise])
        _meet_tilted(cell, np.hstack([moved, axes]), block, series, margins, core, bodies, met)
        if ran is None:
            _meet_above(cell, np.hstack([position, axes]), rapid, margins[0], inner)
    else:
        discs = _discs(bodies, float(cell.stock.max[2] - position[:, 2].min()))
        grid = height_map(cell.stock, step, moved, max([radius, *discs[:, 0]]))
        moved = on_map(moved)
        for removal in cell.stage.earlier if cell.stage else ():
            way = removal.programmed if ran is None else removal.actual
            lower_along(with_profile(grid, removal.cutter), removal.radius, on_map(way))
        grid = with_profile(grid, cell.tool)
        narrow = np.maximum(radius - max(margin, ROUNDING) - sideways, 0.0)
        lost = np.full((2, *(grid.depth.shape if core else (0, 0))), -2.0, np.float32)
        wanted = (
            np.ones(len(moved), bool) if ran is None else _near_rapid(moved, rapid, grid.top, 2.0 * (radius + apart))
        )
        every = round(4.0 * step / apart)  # places between two at which shank and holder are compared
        _meet(grid, np.zeros_like(grid.depth), moved, series, wanted, (radius, core), narrow, discs, every, lost, met)
    return Engagement(
        position,
        axes,
        lowest,
        time,
        rapid,
        block,
        series,
        depth,
        inner,
        sunk,
        shank,
        holder,
        margin + lengthwise,
        volume,
    )


def _near_rapid(position: np.ndarray, rapid: np.ndarray, top: float, reach: float) -> np.ndarray:
    """Return the rapid places (m,), and those less than ``reach`` [m] from one below ``top``, whose cut it may meet."""
    low = position[:, 2] < top
    low[1:] |= low[:-1].copy()
    square = (np.floor((position[:, :2] - position[:, :2].min(axis=0)) / reach)).astype(int)
    near = np.zeros(square.max(axis=0) + 1, bool)
    near[tuple(square[rapid & low].T)] = True
    return maximum_filter(near, 3)[tuple(square.T)] | rapid


def _coarse(cell: Cell) -> Stock:
    """The stock on the grid of the map that a leaning tool is compared with."""
    return cell.stock.for_engagement(float(cell.tool.radii.max()))


def _split(vectors: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of vectors (m, 3) across unit axes, and their part along the axes, (m,)."""
    along = np.einsum("ij,ij->i", vectors, axes)
    across = vectors - along[:, None] * axes
    return np.sqrt(np.einsum("ij,ij->i", across, across)), along


def _meet_tilted(
    cell: Cell,
    poses: np.ndarray,
    block: np.ndarray,
    series: np.ndarray,
    margins: np.ndarray,
    core: float,
    bodies: list[tuple[str, np.ndarray]],
    met: np.ndarray,
) -> None:
    """Fill ``met`` with what a tilted tool meets on the way to each pose (m, 6), on the map of its cut.

    A series of rapid moves is compared with the material before the series. The flutes are compared with the material
    before the tool cuts it, shank and holder with what the tool leaves; at corners and at every eighth place. The map
    is lowered in straight steps of a node.
    """
    depth, inner, volume, sunk, shank, holder = met
    tool, top, stock = cell.tool, float(cell.stock.max[2]), _coarse(cell)
    # a map for any axis of the tool, whether its teeth are swept, or lean in rapid moves alone
    common = tool, cell.cutting, stock, cell.exchange.micro_step
    cut = EngagementCut(*common, tilts=True, upright=path_of(cell).upright)  # compiled as for the pass
    if cell.earlier:
        cut.continue_from(cleared(cell.earlier, stock, False))
    cutter, position, axes = cutter_of(tool), poses[:, :3], poses[:, 3:]
    if core:
        bodies = [("core", cylinder(core, 0.0)), *bodies]
    near = [position[:, 2] + lowest_point(body[:1, 2:4], axes) < top for _, body in bodies]
    rapid = series > 0
    rapid[rapid] = position[rapid, 2] + lowest_point(outline(tool), axes[rapid]) < top
    move = np.diff(position, axis=0, prepend=position[:1])
    across, along = _split(move, axes)
    way = np.linalg.norm(move, axis=1)
    turn = np.linalg.norm(np.diff(axes, axis=0, prepend=axes[:1]), axis=1)
    gone = np.cumsum(way + SWING * cutter[-1, 2] * turn)  # of the flutes; the holder moves further
    cuts = np.diff(gone // stock.grid_step, append=-1.0) != 0.0
    cuts[:-1] |= block[1:] != block[:-1]
    every, corner = 8, 0.9  # cosine of a turn of the path
    stops = np.arange(len(poses)) % every == 0
    stops[:-1] |= np.einsum("ij,ij->i", move[1:], move[:-1]) < corner * way[1:] * way[:-1]
    stops &= np.any(near, axis=0) if near else False
    stops[:-1] |= series[1:] != series[:-1]
    stops[-1] = True
    meets_core = np.zeros(len(poses), bool)
    first = 0
    for last in (np.flatnonzero(stops[1:]) + 1).tolist():
        part = slice(first + 1, last + 1)
        if series[last] and series[last] != series[first] * (first > 0):
            rows = np.flatnonzero((series == series[last]) & rapid)
            inner[rows] = contact(cut, cutter, poses[rows], *margins[:, rows])[:, 0]
        for early in (True, False):
            for (name, body), close in zip(bodies, near, strict=True):
                if close[last] and early == (name in ("core", "flutes")):
                    over = contact(cut, body, poses[last : last + 1])[0, 1]
                    if name == "core":
                        meets_core[part] = over > 0.0
                    elif name == "flutes":
                        depth[part] = over
                    else:
                        values = shank if name == "shank" else holder
                        values[part] = np.maximum(values[part], over)
            if early:
                rows = np.r_[first, first + 1 + np.flatnonzero(cuts[first + 1 : last]), last]
                removed = cut.along(position[rows], np.zeros(len(rows), np.int64), axes=axes[rows])[2]
                volume[part] = np.diff(np.interp(gone[first : last + 1], gone[rows], np.cumsum(removed)))
        first = last
    mean = volume / np.maximum(2.0 * float(tool.radii.max()) * way, 1e-12)
    flutes = tool.flute_length or math.inf
    depth[:] = np.where(depth > 0.0, flutes + depth, np.minimum(mean, flutes))
    volume[series == 0] = 0.0
    sinks, gone = np.cumsum(np.where(meets_core, np.maximum(-along, 0.0), 0.0)), np.cumsum(across)
    before = np.searchsorted(gone, gone - 2.0 * core)
    sunk[:] = np.where(meets_core, sinks - sinks[before], 0.0)


def _meet_above(cell: Cell, poses: np.ndarray, rapid: np.ndarray, margin: np.ndarray, inner: np.ndarray) -> None:
    """Raise ``inner`` to the depth of rapid moves in material above a leaning flank, which no height map holds.

    A place of the tool in the box of the stock is in material where no earlier pose of the cut covered the place. A
    move along the axis meets nothing there. Poses are compared at a tenth of the radius, with a cusp of R/800.
    """
    points, stock = outline(cell.tool), _coarse(cell)
    radius, (heights, radii) = float(points[-1, 0]), (points[:, 1], points[:, 0])
    move = np.diff(poses[:, :3], axis=0, prepend=poses[:1, :3])
    part = np.floor(np.cumsum(np.linalg.norm(move, axis=1)) / (0.1 * radius))
    first = np.diff(part, prepend=-1.0) > 0.0
    across, along = _split(move, poses[:, 3:])
    sine = np.hypot(poses[:, 3], poses[:, 4])
    high = np.maximum(stock.max[2] - poses[:, 2] + radius * sine, 0.0) / poses[:, 5]  # on the axis, below the top
    leaves = rapid & first & (sine > FLAT) & (high > 0.0) & (across > 1e-3 * np.abs(along))
    first[:-1] |= rapid[1:]  # the end of a cut
    cuts = np.flatnonzero(first & ~rapid)
    if not cuts.size:
        return
    tips, turn = cKDTree(poses[cuts, :3]), np.arange(24)[:, None] / 12.0 * np.pi
    for k in np.flatnonzero(leaves).tolist():
        axis, height = poses[k, 3:], np.linspace(0.0, high[k], 16)[1:, None]
        level = np.array([axis[1], -axis[0], 0.0]) / sine[k]
        ring = np.cos(turn) * level + np.sin(turn) * np.cross(axis, level)
        near = cuts[tips.query_ball_point(poses[k, :3], 2.0 * radius + high[k], return_sorted=True)]
        near = near[near < k][::-1]  # the last pose first
        for share in (0.0, 0.1, 0.3):
            deep = margin[k] + RIM * stock.grid_step + share * radius
            out = np.maximum(np.interp(height, heights, radii) - deep, 0.0)
            places = (poses[k, :3] + height * axis)[:, None] + out[..., None] * ring
            places = places[((places > stock.min) & (places < stock.max)).all(axis=2)]
            for some in np.array_split(near, 1 + len(near) // 200):
                tip, up = np.split(poses[some], 2, axis=1)
                from_tip = places[:, None] - tip
                at = np.einsum("ijk,jk->ij", from_tip, up)
                square = np.einsum("ijk,ijk->ij", from_tip, from_tip) - at**2
                covered = (at >= 0.0) & (square <= np.interp(at, heights, radii) ** 2)
                places = places[~covered.any(axis=1)]
                if not len(places):
                    break
            if len(places):
                inner[k] = max(inner[k], deep)


def _tilted(cell: Cell, ran: ScoredPass) -> list[Finding]:
    """Report the share of the volume above a leaning tool, and a holder that is not known."""
    results = []
    if not cell.tool.stick_out:
        results.append(violation("holder unknown", 0.0, 0.0, degrees=math.degrees(path_of(cell).lean)))
    most = 0.01  # share of the removed volume above which forces are bounds (issue: 1 %)
    share = ran.result.undercut_volume / ran.result.removed_volume
    if share > most:
        results.append(violation("undercut", share, most))
    return results


def _along_axis(
    position: np.ndarray, axes: np.ndarray, rapid: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places where a rapid move leaves along the tool axis, and where it returns along an earlier cut, (m,).

    position: of the programmed path; near [m]: from a place of the move to the places of the cut.
    """
    across, up = _split(np.diff(position, axis=0, prepend=position[:1]), axes)
    same_axis = 1e-9  # [m], sideways, of a move along the tool axis; a program rounds the move of a tilted tool
    along = rapid & (across < np.maximum(same_axis, 1e-3 * np.abs(up)))
    leaves, again = along & (up >= 0.0), np.zeros(len(rapid), bool)
    down, cuts = np.flatnonzero(along & ~leaves), np.flatnonzero(~rapid)
    if down.size and cuts.size:
        places = cKDTree(position[cuts]).query_ball_point(position[down], near, return_sorted=True)
        again[down] = [bool(near_cut) and cuts[near_cut[0]] < k for near_cut, k in zip(places, down, strict=True)]
    return leaves, again


def core_radius(radius: float) -> float:
    """Radius of the middle without edge of a cutter of a radius that is not centre-cutting [m]."""
    return max(min(CENTRE_SHARE * radius, CENTRE_HOLE), radius - INSERT_WIDTH)


def _discs(bodies: list[tuple[str, np.ndarray]], deepest: float) -> np.ndarray:
    """Radius and height above the tip of discs below an upright tool's bodies [m], (n, 2), and row of ``met``.

    deepest [m]: of the tip below the top of the stock. A cone has eight discs.
    """
    rows = []
    for name, body in bodies:
        (_, _, r0, z0), (_, _, r1, z1) = body[:, :4]
        count = 8 if math.isfinite(z1) else 1
        for share in np.arange(count) / count if name != "flutes" and z0 < deepest else ():
            rise = share * (z1 - z0) if share else 0.0
            rows.append([r0 + share * (r1 - r0), z0 + rise, 4 if name == "shank" else 5])
    return np.array(rows).reshape(-1, 3)


@compiled
def _meet(grid, ahead, path, series, wanted, radii, narrow, bodies, body_every, lost, met):
    """Fill ``met`` with what the tool meets on the way to each place that is wanted, and lower the map there.

    A series of rapid moves runs twice: first with the smaller radius of each place on the map ``ahead``, against the
    material before the series.
    """
    depth, inner, volume, sunk = met[:4]
    for k in range(path.shape[0]):
        last, count = path[max(k - 1, 0)], path.shape[0]
        if not wanted[k]:
            continue
        if series[k] and (k == 0 or series[k] != series[k - 1]):
            n = k
            while n < count and series[n] == series[k]:
                cleared = n > 0 and wanted[n - 1] and (n == k or narrow[n] <= narrow[n - 1])
                inner[n] = lower(grid, ahead, narrow[n], path[max(n - 1, 0)], path[n], cleared)[0]
                n += 1
        depth[k], removed = lower(grid, grid.depth, radii[0], last, path[k], k > 0 and wanted[k - 1])
        volume[k] = removed if series[k] else 0.0
        if radii[1] > 0.0:
            sunk[k] = near_axis(grid, lost, radii[1], path[k], k)[0]
        below = grid.top - path[k, 2]
        for n in range(bodies.shape[0]):
            upright = path[k, 0] == last[0] and path[k, 1] == last[1]
            if below > bodies[n, 1] and (upright or k % body_every == 0):
                highest = near_axis(grid, lost, bodies[n, 0], path[k], ~k)[1]
                row = int(bodies[n, 2])
                met[row, k] = max(met[row, k], below - bodies[n, 1] - highest)


@functools.lru_cache(maxsize=1)  # both calls of ``engagement`` need them
def _places(cell: Cell) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, float, float]:
    """Tool tips, axes, times, blocks and whether these are rapid, the node step and the distance between two
    places [m]: half a node, in a long path more.

    A tilted tool has a place at each node of the map of its cut; its path has approach and retract of the robot program
    at both ends.
    """
    target, timed = path_of(cell).target, path_of(cell).timed
    radius = float(cell.tool.radii.max())
    length = path_of(cell).length
    reach = np.array([target.position.min(axis=0) - radius, target.position.max(axis=0) + radius])
    area = float(np.prod(np.ptp(np.clip(reach, cell.stock.min, cell.stock.max), axis=0)[:2]))
    # length / (step / 2) places of pi (radius / step)^2 nodes each are to stay below MOST_VISITS
    nodes_per_radius = 50  # of the height map, along its axes
    most_visits = 2e9  # of nodes, about a nanosecond each; a longer path takes a coarser map
    most_nodes = 2e7  # of the height map; a small cutter in a large stock takes a coarser map
    step = max(
        radius / nodes_per_radius,
        (2.0 * np.pi * length * radius**2 / most_visits) ** (1.0 / 3.0),
        math.sqrt(area / most_nodes),
    )
    most_places = 4e5  # of a longer path the places are up to two nodes apart
    apart = max(0.5 * step, min(length / most_places, 2.0 * step))
    if path_of(cell).lean:
        apart = _coarse(cell).grid_step
        step = 2.0 * apart
    count, upright = 2 + int(length / apart), np.array([0.0, 0.0, 1.0])
    if timed is None:
        time_ns = np.linspace(0, target.duration_ns, count).astype(np.int64)
        axes = np.broadcast_to(upright, (count, 3))
        return target.sample(time_ns), axes, time_ns * 1e-9, np.zeros(count, int), np.zeros(count, bool), step, apart
    ends = np.cumsum(timed.toolpath.block_length)
    ways = np.cumsum(timed.toolpath.ways)  # the tool above the tip moves where it turns
    count = max(count, 2 + int(ways[-1] / apart))
    between = np.interp(np.linspace(0.0, ways[-1], count), ways, ends)
    distance = np.sort(np.concatenate([between, ends[1:]]))  # every corner too
    block = np.clip(np.searchsorted(ends, distance), 0, len(ends) - 1)  # where two meet, the one that ends
    time = np.interp(distance, timed.distance, target.time)
    rapid = timed.toolpath.rapid[block]
    if not path_of(cell).lean:
        position = timed.toolpath.position_at(distance)
        return position, np.broadcast_to(upright, position.shape), time, block, rapid, step, apart
    position, _, quaternion = timed.toolpath.on_path(distance)
    axes, safe = tool_axis(quaternion), cell.stock.max[2] + cell.krl.safe_height
    rises = [np.linalg.norm(lifted(position[k], axes[k], safe) - position[k]) for k in (0, -1)]
    up, away = (np.linspace(0.0, way, 2 + int(way / apart))[1:] for way in rises)
    lift = np.concatenate([up[::-1], np.zeros(len(position)), away])
    row = np.clip(np.arange(len(lift)) - len(up), 0, len(position) - 1)
    rapid = rapid[row] | (lift > 0.0)
    return position[row] + lift[:, None] * axes[row], axes[row], time[row], block[row], rapid, step, apart


def cut_violations(cell: Cell, run: Trajectory, ran: ScoredPass, programmed: Contacts) -> list[Finding]:
    """Check the simulated pass along ``run`` in the stock, by the points of ``run``; programmed: ``path_contacts``.

    Where the rapid moves of the path meet no material, the simulated pass decides: its rapid moves must not enter the
    material that its cutting moves leave, further than the arm springs back.
    """
    if not ran.result.removed_volume > 0.0:
        return [violation("stock missed", 0.0, 0.0, 1)]
    tilted, (contacts, results) = _tilted(cell, ran) if path_of(cell).lean else [], programmed
    timed = path_of(cell).timed
    if not contacts and timed is not None and timed.toolpath.rapid.any():
        earlier = cell.stage.earlier if cell.stage else ()
        springs = [spring_back(cell, ran), *(removal.spring_back for removal in earlier)]
        contacts = rapid_violations(run, engagement(cell, cell.limits.rapid_contact + max(springs), ran))
    return [*tilted, *_spindle(cell, run, ran), *_tool(cell, run, ran), *contacts, *results]


def spring_back(cell: Cell, ran: ScoredPass) -> float:
    """[m], largest deflection while the tool feeds through material: a tool that springs back when the cut ends removes
    as much from a wall."""
    result = ran.result
    cutting = result.volume > 0.0
    cutting &= ~path_of(cell).rapid_at(result.time_ns)
    return float(np.max(np.linalg.norm(result.deflection[cutting, :3], axis=1), initial=0.0))


def _spindle(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Finding]:
    torque = _by_points(run, ran, ran.result.torque)
    speed, limits = cell.tool.spindle_speed, cell.limits
    results = [violation("spindle speed", speed, limits.spindle_speed)] if speed > limits.spindle_speed else []
    results += violations("spindle torque", torque, limits.spindle_torque)
    return results + violations("spindle power", torque * speed, limits.spindle_power)


def _by_points(run: Trajectory, ran: ScoredPass, values: np.ndarray) -> np.ndarray:
    """The largest value of a pass on the way to each point of ``run``, (n,)."""
    knot = np.clip(np.searchsorted(run.time_ns, ran.result.time_ns), 1, len(run) - 1)  # the one that is next
    most = np.zeros(len(run))
    np.maximum.at(most, knot, values)
    return most


def _tool(cell: Cell, run: Trajectory, ran: ScoredPass) -> list[Finding]:
    """Cutting speed, and the bending stress of the tool by the lateral force of the pass."""
    tool, results = cell.tool, []
    speed = tool.spindle_speed * tool.radius
    if tool.max_cutting_speed and speed > tool.max_cutting_speed:
        results.append(violation("cutting speed", speed, tool.max_cutting_speed))
    # one tooth in a slot feels K f a, K of tangent and radius; the mean of all is K f a teeth / 4
    peak = max(1.0, 4.0 / tool.teeth) if cell.cutting.by_engagement else 1.0
    stress = peak * tool.bending_stress * np.linalg.norm(ran.result.wrench[:, :2], axis=1)
    carbide_modulus = 400e9  # [N/m^2], above that of any steel
    limit = CARBIDE_STRENGTH if tool.modulus > carbide_modulus else STEEL_STRENGTH
    return results + violations("tool bending", _by_points(run, ran, stress), limit)


def path_contacts(cell: Cell, run: Trajectory) -> Contacts:
    """Contacts of the programmed path without deflection: of rapid moves with material, and with all else."""
    low, high, radius = cell.stock.min, cell.stock.max, cell.tool.radii.max()
    below, flutes = cell.limits.below_stock, cell.tool.flute_length
    met = engagement(cell, cell.limits.rapid_contact)
    points = _points(run, met)
    table = cell.workpiece.table_z
    beside = met.position[:, :2] - np.clip(met.position[:, :2], low[:2], high[:2])
    over = math.isnan(table) | (np.hypot(*beside.T) < radius)  # the stock, seen from above
    beneath, under = np.where(over, low[2] - met.lowest, -np.inf), table - met.lowest
    results = violations(
        "below the stock",
        beneath,
        below,
        beneath > below + 1e-9,
        points=points,
        block=met.block,
        level="the bottom of the stock",
    )
    results += violations(
        "below the stock", under, 0.0, under > 1e-9, points=points, block=met.block, level="the table"
    )
    whole = [("tool", cutter_of(cell.tool)), *bodies_of(cell.tool)]
    poses = np.hstack([met.position, met.axes]) if len(cell.workpiece.fixture_boxes) else np.zeros((0, 6))
    for number, (least, most) in enumerate(cell.workpiece.fixture_boxes, 1):
        for name in ("tool", "shank", "holder"):
            inside = np.zeros(len(poses))
            for _, body in (part for part in whole if part[0] == name):
                below_top(body, poses, least, most, inside)
            results += violations(
                "in the fixture",
                inside,
                0.0,
                inside > ROUNDING,
                points=points,
                block=met.block,
                subject=f"fixture {number}",
                body=name,
            )
    if flutes:
        results += violations("depth of cut", met.depth, flutes, met.depth > flutes, points=points, block=met.block)
    for name, depth, need in (
        ("shank", met.shank, "the flutes need"),
        ("holder", met.holder, "the tool must stick out"),
    ):
        over = depth > ROUNDING
        results += violations("tool body", depth, 0.0, over, points=points, block=met.block, subject=name, need=need)
    results += _feed(cell, met, points) + _plunges(cell, met, points)
    return rapid_violations(run, met), results


def _feed(cell: Cell, met: Engagement, points: np.ndarray) -> list[Finding]:
    """Programmed feeds per tooth, where the tool cuts, beyond what its maker or any maker gives."""
    tool, timed, source = cell.tool, path_of(cell).timed, "by what makers give for aluminium"
    programmed = path_of(cell).feed_rate if timed is None else timed.toolpath.feed[met.block]
    feed = programmed * 2.0 * np.pi / tool.spindle_speed / tool.teeth * ((met.depth > ROUNDING) & ~met.rapid)
    units = timed.toolpath.program.feed_units if timed else ()
    cause = f"; F is read in {' and '.join(units)}" if units else ""
    limit, usual = min(MOST_FEED * tool.diameter, LARGEST_FEED), min(USUAL_FEED * tool.diameter, LARGEST_USUAL_FEED)
    over = feed >= limit * (1.0 - ROUNDING)
    if tool.max_feed_per_tooth:
        limit, usual, source = tool.max_feed_per_tooth, math.inf, "by tool.max_feed_per_tooth_mm"
        over = feed > limit * (1.0 + ROUNDING)
    severity = "stop"
    if not over.any():
        limit, over, severity = usual, feed > usual, "warning"
    return violations(
        "feed per tooth",
        feed,
        limit,
        over,
        points=points,
        block=met.block,
        severity=severity,
        source=source,
        cause=cause,
    )


def _points(run: Trajectory, met: Engagement) -> np.ndarray:
    """The point of the program that each place of the path leads to, from 1."""
    return np.clip(np.searchsorted(run.time, met.time - 1e-6), 0, len(run) - 1) + 1


def rapid_violations(run: Trajectory, met: Engagement) -> list[Finding]:
    """Return a violation for each rapid move through material, by the points of ``run``: deepest contact, length of the
    contact, removed volume.

    The last move of a series counts what the moves without such a contact remove at the rim.
    """
    contacts, points = [], _points(run, met)
    length = np.linalg.norm(np.diff(met.position, axis=0, prepend=met.position[:1]), axis=1)
    length[0] = met.inner[0]  # the approach of the robot program, from above
    contact = met.inner > met.margin
    blocks = np.unique(met.block[contact])
    at_rim = ~np.isin(met.block, blocks)
    rest = np.bincount(met.series[at_rim], met.volume[at_rim], minlength=len(met.series) + 1)
    for block in blocks[::-1].tolist():
        rows = np.flatnonzero(met.block == block)
        worst = rows[np.argmax(met.inner[rows])]
        volume = met.volume[rows].sum() + rest[met.series[worst]]
        rest[met.series[worst]] = 0.0
        amounts = {"length_mm": 1e3 * float(length[rows[contact[rows]]].sum()), "volume_mm3": 1e9 * float(volume)}
        depth, point = met.inner[worst], int(points[worst])
        contacts.append(violation("rapid in material", depth, met.margin[worst], point, block=block, amounts=amounts))
    return contacts[::-1]


def _plunges(cell: Cell, met: Engagement, points: np.ndarray) -> list[Finding]:
    """Steep ways down into material, and ramps and helices whose core sinks deeper than makers allow.

    On a ramp of an angle a the core of a radius r is over a place of the floor for a way of 2 r, and sinks 2 r tan(a).
    """
    across, along = _split(np.diff(met.position, axis=0, prepend=met.position[:1]), met.axes)
    steep = (-along > PLUNGE * np.hypot(across, along)) & (met.sunk > 0.0)
    tool, where = cell.tool, {"points": points, "block": met.block}
    results = violations("plunge", met.sunk, 0.0, steep, part="cutter plunges", most="", **where)
    core = core_radius(tool.radius)
    solid_ramp = math.tan(math.radians(5.0))  # solid end mills take 2 to 5 deg (carbide-tooling.com, ramping angle)
    solid, part = 2.0 * core * solid_ramp, f"middle of the cutter, {2e3 * core:.3g} mm wide, sinks"
    timed = path_of(cell).timed
    program = timed.toolpath.program.current if timed else None
    inserts = tool.type == "indexable" or (tool.type == "program" and program is not None and program.inserts)
    least_inserts = 16e-3  # [m], assumed: a smaller cutter with inserts is taken as a solid one
    limit = min(2.0 * core * INSERT_RAMP, HOLLOW) if inserts and tool.diameter >= least_inserts else solid
    for allowed, severity in ((limit, "stop"), (solid, "warning")):
        if not results:
            most = f"; makers allow {1e3 * allowed:.2g} mm"
            results = violations("plunge", met.sunk, allowed, severity=severity, part=part, most=most, **where)
    return results


@dataclass(frozen=True)
class Residue:
    """Vibration from tooth to tooth in a simulated pass, in which the arm moves and tool and spindle are rigid."""

    word: str = column("word")  #: "repeats", "grows", "remains" or "no statement"
    #: median from tooth to tooth, a share of the feed per tooth; NaN without a statement
    residue: float = column("residue_share")
    #: the same share, above which the vibration does not repeat
    limit: float = column("limit_share", default=CHATTERS)
    teeth: bool = True  #: the pass resolves single teeth
    time: float = 0.0  #: at the place [s]

    @property
    def text(self) -> str:
        """Return one line."""
        small = 0.001  # share of the feed per tooth that is printed as a number
        if not self.teeth:
            return "simulated pass (arm only): no statement about vibration, the mean force has no teeth"
        if self.word == "no statement":
            return f"simulated pass (arm only): no cut of {FEWEST_TEETH} teeth without a break to compare"
        share = f"{100 * self.residue:.2g}" if self.residue >= small else f"less than {100 * small:g}"
        word = {"grows": "vibration grows", "remains": "vibration without growth"}.get(self.word, "the motion repeats")
        return f"simulated pass (arm only): {word}, from tooth to tooth {share} % of the feed per tooth remain"


def residue_of(cell: Cell, result: PassResult) -> Residue:
    """The part of the tool's motion that does not repeat from tooth to tooth, in the worst stretch of cutting.

    Sampled once a tooth period T, a stable cut repeats itself but for the slow swinging of the arm, whose fourth
    difference over teeth is small: A (w T)^4 / 16 for a swing of amplitude A and circular frequency w, 0.02 % of it at
    20 Hz and 533 teeth a second. What repeats with each revolution of unequal teeth is subtracted, by ``_unrepeated``.

    A chattering cut does not repeat itself. Its vibration grows over the thirds of a stretch, or lasts, at a size at
    which teeth leave the material. Medians leave out entries, exits and corners, after which the arm swings for a few
    teeth. What swings slower than a tenth of the tooth frequency is left to the deviation.
    """
    # largest noise in sound cuts of thin chips as a share of grid step over feed per tooth: 0.48 at 6 um a tooth
    grid_noise = 0.5
    growth = 1.5  # ratio of one third of a stretch to the third before
    if cell.cutting.by_engagement:
        return Residue("no statement", np.nan, teeth=False)
    tool = cell.tool
    period = 2.0 * np.pi / (tool.spindle_speed * tool.teeth)
    feed_per_tooth = path_of(cell).feed_rate * period
    noise = grid_noise * cell.stock.grid_step / max(feed_per_tooth, 1e-12)
    limit, sure = max(CHATTERS, noise), max(0.2 * CHATTERS, noise)  # growth below ``sure`` may be that of the noise
    unequal = tool.teeth if np.ptp(tool.radii) > 0.0 or np.ptp(tool.pitches) > 0.0 else 0
    worst, grows, seconds = (-1.0, 0.0), False, result.time  # residue, time of its place
    cuts = result.volume > 0.0
    if seconds.size > 1:  # between two teeth of a narrow cut nothing is removed
        cuts = np.convolve(cuts, np.ones(1 + math.ceil(period / (seconds[1] - seconds[0]))))[: cuts.size] > 0.0
    lasts = 2.0 / 3.0  # share of the vibration that a third of ``FEWEST_TEETH`` later is left, less dies out
    for first, last in stretches(cuts) if result.every == 1 else ():
        time = seconds[first:last]
        teeth = np.arange(time[0], time[-1], period)
        if teeth.size < FEWEST_TEETH:
            continue
        at_teeth = np.stack([np.interp(teeth, time, result.deflection[first:last, k]) for k in range(2)], 1)
        change = np.diff(at_teeth, 4, axis=0) / (16.0 * feed_per_tooth)  # a motion that alternates counts whole
        windows = np.array_split(change, max(1, teeth.size // FEWEST_TEETH))
        if unequal:
            windows = [_unrepeated(window, unequal) for window in windows]
        early, middle, late = _medians(np.concatenate(windows))
        if late > sure and late > growth * middle > growth**2 * early:
            grows, worst = True, max(worst, (late, float(time[-1])))
        for k, thirds in enumerate(map(_medians, windows)):
            place = float(time[0] + (k + 0.5) / len(windows) * (time[-1] - time[0]))
            worst = max(worst, (sorted(thirds)[1] if thirds[2] > lasts * thirds[0] else 0.0, place))
    if worst[0] < 0.0:
        return Residue("no statement", np.nan, limit)
    word = "grows" if grows or worst[0] > limit else "repeats"
    return Residue(word, worst[0], limit, time=worst[1])


def _unrepeated(change: np.ndarray, teeth: int) -> np.ndarray:
    """Subtract from the rows of each tooth a parabola over the revolutions.

    The parabola is what repeats with each revolution, and how that changes where a cut begins or ends.
    """
    whole = change[: len(change) // teeth * teeth].reshape(-1, 2 * teeth)
    powers = np.linspace(-1.0, 1.0, len(whole))[:, None] ** np.arange(3)
    return (whole - powers @ np.linalg.lstsq(powers, whole, rcond=None)[0]).reshape(-1, 2)


def _medians(change: np.ndarray) -> list[float]:
    """Median size in each third."""
    return [float(np.median(part)) for part in np.array_split(np.linalg.norm(change, axis=1), 3)]
