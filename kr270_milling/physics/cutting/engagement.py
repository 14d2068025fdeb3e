"""The mean force of the engagement: the removed volume by its angle about the tool, and the mean force of each angle.

This is the second cutting model behind the interface of ``Cut``. The sweep of the teeth resolves each tooth; this model
resolves steps of some milliseconds, in which many teeth pass, on a height map with a coarse step.

A step first sinks the tool, then moves the tool tip by d, with m = |d_xy|. Angles phi are counted about the tool axis
from the direction of d. The new footprint removes a crescent; seen from the middle between both centres the thickness
of the crescent is m cos(phi). Bin k of the front half covers dphi:

    h_k = m C_k / dphi / (passes of a tooth),  C_k = int_k cos(phi) dphi          mean chip thickness
    a_k f_k = dV_k / (R m C_k)                                                    depth times share of the bin that cuts
    F = N / (2 pi) sum_k [F_t(h_k) t_k - F_r(h_k) r_k - F_a(h_k) z] a_k f_k dphi  mean force on the tool

dV_k is the volume that the bin removes from the map. h_k is free of the noise of the map, and dV_k conserves the
volume, so the mean force over a length of path has no bias from the step of the map.
The formula equals the mean of (29) over a revolution [Altintas2012, section 2.8] where the engagement is constant.

A cell of the map that the footprint covers in part is lowered in part: level = rest + c (tip - rest), c the covered
share, rest the level of what the tool has not covered. c rises linearly over |cos(n)| + |sin(n)| nodes, n the direction
of the rim; a sum over such cells has no aliasing where a row of nodes is parallel to the rim.

A tooth cuts what the axis moved over since the tooth before: on average half a pitch later, at the height z of a helix
later by z tan(helix) / R. The force of a step therefore acts with the lag of first order T,

    load += theta / (theta + T) (F - load),  T = pi / N + tan(helix) / R (mean height above the tip)

theta the spindle angle of the step. Without the lag the model damps vibrations too early.

The robot predicts the end of a step with the last load. The thrust of the end edges rises within some micrometres, less
than the arm moves in a step. Therefore the step ends where the corrected tip will be, above the predicted one by

    rise = give theta / (theta + T) (thrust(floor - z - rise) - last thrust)

give: the displacement of the tip along z after a step under a unit force, which the cell computes from the arm.

End edges that press over a large share make an arm bounce: a tooth meets the floor of the lowest tooth before it,

    h(t) = min_k z(t - k pitch) - z(t),   thrust = N s R F_r(h)

and the tip lifts off for a part of each bounce of some milliseconds. ``mean_thrusts`` integrates this at constant axial
feeds; the mean thrust, as a share of that of an even layer, multiplies the thrust of a step.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numba import njit

from kr270_milling.base.compiled import inlined
from kr270_milling.physics.cutting.fill import any_above
from kr270_milling.physics.cutting.force_law import forces_at
from kr270_milling.physics.cutting.grid import MAX_TILES, TILE, Stock, tile_count
from kr270_milling.physics.cutting.laws import Cutting
from kr270_milling.physics.cutting.load import end_force
from kr270_milling.physics.cutting.profile import RUN, EdgeBins, Profile, profile_of
from kr270_milling.physics.cutting.state import FAILED, FLOATS, INTS, LEVEL_SUM, LOGGED, NODES_CUT, TILES, common_params
from kr270_milling.physics.cutting.sweep import copy_numbers
from kr270_milling.physics.cutting.tool import Tool

BINS = 72  #: K, of a whole turn
SECTORS = 18  # bins of a whole turn below a sinking tool, whose force is nearly axial
SINES = 4096  # entries of the table ``front`` from one side of the tool to the other
BEYOND = SINES // 4  # further entries at both ends: a crescent and the shift of a node reach beyond the sides
FINE = 1 << 20  # parts of an entry in which the compiled loop counts
FAR = 1e9  # [nodes], beyond every grid
LONGEST = 0.25  # share of the radius: a longer move is divided
UPRIGHT = 1e-5  # [rad], least tilt; the heel of a flat end of 10 mm then rises by less than a level of a map
SWING = 4.0  # assumed: radii above the tip, up to which a turn of the axis counts as a move
RIM = 0.71  # [nodes], half of the widest ramp from an uncovered cell to a covered one: 1 / sqrt(2)
BLOCK = 16  # nodes, a power of two
LOG_LOST = 1 << 62  # in place of the number of logged nodes: the log had no room for all
FLOORS = 64  # places that a state remembers
#: axial feeds per tooth, in edge radii, of the mean thrusts: a thinner layer is as the first, a thicker one as the last
LAYERS = np.geomspace(0.125, 8.0, 13)
LOWEST, SPACING = float(LAYERS[0]), math.log(LAYERS[1] / LAYERS[0])
# Places in EngagementState.ints
FLOOR_LEVEL = 5  # the whole footprint is cut at least to this level (-1: not known)
FLOORS_KNOWN = 6  # rows in use of ``floors``
FLOORS_KEPT = 8  # of these rows, the first ones that the last step has not changed
FLOOR_NEAR = 9  # deepest level to which a footprint near the present one is cut (-1: not known)
# Places in EngagementState.floats
LOAD = FLOATS  # wrench and torque that act in the last step [N, N m], 7
THRUST = LOAD + 7  # thrust of the end edges [N]
CONTACT = LOAD + 8  # mean length of all end edges on the floor when the tool last went below FLOOR_NEAR [m]
RISE = LOAD + 9  # rise of the tip above the predicted pose [m]
LAST = LOAD + 10  # tip at the end of the last step [m] and the axis; NaN: none, 6


class EngagementParams(NamedTuple):
    """Constants of a cut; lengths in metres."""

    radius: float
    end_radius: float  # of the flat end
    teeth: int
    sense: float
    micro_step: float  # [rad]
    lag: float  # [rad]: half a pitch, after which on average a tooth cuts what the footprint covers
    twist: float  # [rad/m], further lag of the edge by height above the tip
    spacing: float  # distance of nodes
    origin_x: float  # place of node 0
    origin_y: float
    nx: int
    ny: int
    top: float
    thickness: float
    level_step: float
    law: np.ndarray  # ``ForceLaw.table``
    end_share: float  # share of the end edge that presses on the floor
    edge_radius: float  # below this layer the force of the end edge is in proportion to the layer
    give: float  # compliance of the predicted tip along z in a step [m/N]; 0: poses are not predicted
    bounce: np.ndarray  # mean thrust of a bouncing tip, as a share of that of an even layer of LAYERS, (LAYERS.size,)
    moments: bool  # forces turn the tool about its tip
    front: np.ndarray  # uint16, 2 (SINES + 2 BEYOND): bin ahead by BEYOND + SINES (1 + sin(phi)) / 2, then those behind
    around: np.ndarray  # int16, (2 reach + 1, 2 reach + 1): sector by the place beside the axis [nodes]
    inverse: np.ndarray  # float32, same shape: mean of R / r over the nodes of a block, by the middle of the block
    reach: int  # nodes
    shift: np.ndarray  # int64, (64, 64): of a node within its cell across the feed [entries / FINE], by its last bits
    widths: np.ndarray  # (ahead,): of the front bins [rad]
    cosines: np.ndarray  # (ahead,): C_k
    directions: np.ndarray  # (ahead, 2): cos and sin of the middle of each front bin
    turns: np.ndarray  # (sectors, 2): cos and sin of the middle of each sector
    flat: bool | None  # True: a flat end and no profile, compiled without ``revolution``
    profile: Profile | None  # None: a flat end


class EngagementState(NamedTuple):
    """The height map and the last step. Names and layout of the map are those of ``state.State``."""

    pool: np.ndarray  # uint16, (tiles * TILE * TILE + BLOCK,): mean of the cell of a node
    rest: np.ndarray  # uint16, same shape: level of that part of the cell which the tool has not covered
    table: np.ndarray  # int32, tile -> place in the pool or -1
    ints: np.ndarray  # int64, (INTS,)
    floats: np.ndarray  # (LAST + 6,)
    saved_ints: np.ndarray  # as they were before the last step
    saved_floats: np.ndarray
    log_place: np.ndarray  # int64: nodes that the last step lowered
    log_level: np.ndarray  # uint16: their levels before
    log_rest: np.ndarray  # uint16
    floors: np.ndarray  # (FLOORS, 3): x and y of former tips [m], level to which that footprint is cut; deepest first
    spans: np.ndarray  # int32, (6, columns): scratch: first and last nodes of each column in ``_clear``
    ahead: np.ndarray  # int64, (ahead, 2): removed in the present step, by bin: levels, and these times their thickness
    sunk: np.ndarray  # (sectors, 3): removed below the former footprint: levels, nodes, and nodes times R / r
    edge: EdgeBins | None  # None: a flat end


def make_engagement_params(
    tool: Tool,
    cutting: Cutting,
    stock: Stock,
    micro_step: float,
    bins: int = BINS,
    give: float = 0.0,
    tilts: bool = False,
    bounce: np.ndarray | None = None,
    upright: bool = True,
) -> EngagementParams:
    """stock: with the coarse step of this model; micro_step [rad]: the unit in which a step counts spindle angle.

    bins: K, of a whole turn; half of them are ahead. Below a sinking tool there are SECTORS. give, bounce: as in the
    record; None: the tip does not bounce.
    tilts: poses have an axis, and a flat end has a profile, too; upright: of some steps that cut the axis is upright.
    """
    widest = float(tool.radii.max())
    flat_end = tool.has_flat_end and not tilts
    turn = math.radians(5.0 if upright else 3.0)  # of the edge in a piece: a thin strip at 45 deg needs the smaller
    profile, radius, flat = (None, widest, widest) if flat_end else profile_of(tool, stock, turn)
    return EngagementParams(
        **common_params(tool, cutting, stock, micro_step),
        radius=radius,
        end_radius=flat,
        teeth=tool.teeth,
        lag=math.pi / tool.teeth,
        twist=math.tan(tool.helix) / widest,
        give=give,
        bounce=np.ones(LAYERS.size) if bounce is None else bounce,
        flat=flat_end or None,
        profile=profile,
        **tables(widest, stock.grid_step, bins),
    )


@functools.lru_cache(maxsize=8)
def tables(radius: float, spacing: float, bins: int) -> dict:
    """The fields of EngagementParams that hang on the radius of the tool and the spacing of the nodes alone."""
    ahead = bins // 2
    reach = int((1.0 + 0.5 * LONGEST) * radius / spacing) + 3
    offset = np.arange(-reach, reach + 1)
    angle = np.arctan2(offset[None, :], offset[:, None])  # [x, y]
    sectors = np.clip(np.floor((angle + np.pi) * SECTORS / (2.0 * np.pi)), 0, SECTORS - 1)
    along = np.arange(-reach - BLOCK // 2, reach + BLOCK // 2 + 1)  # half a block beyond both ends
    nearest = 0.2837  # [nodes]: 1 / the mean of 1 / r over the cell at the axis, 4 ln(1 + sqrt(2))
    far = np.maximum(np.hypot(offset[:, None], along), nearest) * spacing / radius
    window = np.pad(np.ones(BLOCK - 1), 1, constant_values=0.5) / BLOCK  # half of the axis to either side
    inverse = np.stack([np.convolve(row, window, "valid") for row in 1.0 / far])
    # every row of nodes along the feed meets each bin: the outermost bins are at least a node wide across the feed
    # nodes across the feed in the outermost bins
    last = max(2.0 * np.pi / bins, math.acos(max(0.0, 1.0 - 0.4 * spacing / radius)))
    inner = np.linspace(last - 0.5 * np.pi, 0.5 * np.pi - last, ahead - 1)
    edges = np.concatenate([[-0.5 * np.pi], inner, [0.5 * np.pi]])
    middles = 0.5 * (edges[1:] + edges[:-1])
    sines = np.arange(-BEYOND, SINES + BEYOND) * (2.0 / SINES) - 1.0
    front = np.clip(np.searchsorted(np.sin(edges), sines) - 1, 0, ahead - 1).astype(np.uint16)
    node = 0.5 * SINES * spacing / radius * FINE
    whole = (np.arange(SECTORS) + 0.5) * (2.0 * np.pi / SECTORS) - np.pi
    return {
        "front": np.concatenate([front, front + ahead]),
        "around": sectors.astype(np.int16),
        "inverse": inverse.astype(np.float32),
        "reach": reach,
        "shift": np.rint(np.random.default_rng(0).uniform(-0.5, 0.5, (64, 64)) * node).astype(np.int64),
        "widths": np.diff(edges),
        "cosines": np.diff(np.sin(edges)),
        "directions": np.stack([np.cos(middles), np.sin(middles)], -1),
        "turns": np.stack([np.cos(whole), np.sin(whole)], -1),
    }


def make_engagement_state(p: EngagementParams, stock: Stock) -> EngagementState:
    """Return an untouched stock."""
    tiles, bins, edge = tile_count(stock), p.widths.size, None
    nodes = min(tiles[0] * tiles[1], MAX_TILES) * TILE**2 + BLOCK  # of which a last block may look beyond its tile
    footprint = (2 * p.reach + 3) ** 2
    if p.profile is not None:
        lost = np.zeros((2 * bins, p.profile.pieces.shape[0] + 1, 2))
        runs, scratch = (2 * p.reach + 3) * ((2 * p.reach + 3) // RUN + 2), 13 * RUN
        edge = EdgeBins(
            np.zeros(nodes // RUN + 1, np.uint16), lost, np.zeros(2 * bins), np.zeros(scratch, np.float32),
            np.zeros(scratch, np.int32), np.zeros((runs, 6), np.int64), np.zeros(scratch),
        )  # fmt: skip
    ints = np.zeros(INTS, np.int64)
    ints[FLOOR_LEVEL] = -1
    return EngagementState(
        pool=np.zeros(nodes, np.uint16),
        rest=np.zeros(nodes, np.uint16),
        table=np.full(tiles, -1, np.int32),
        ints=ints,
        floats=np.append(np.zeros(LAST), np.full(6, math.nan)),
        saved_ints=ints.copy(),
        saved_floats=np.zeros(LAST + 6),
        log_place=np.empty(8 * footprint, np.int64),
        log_level=np.empty(8 * footprint, np.uint16),
        log_rest=np.empty(8 * footprint, np.uint16),
        floors=np.zeros((FLOORS, 3)),
        spans=np.zeros((6, 2 * p.reach + 3), np.int32),
        ahead=np.zeros((bins, 2), np.int64),
        sunk=np.zeros((SECTORS, 3)),
        edge=edge,
    )


def mean_thrusts(modes: tuple[np.ndarray, ...], tool: Tool, cutting: Cutting, pitch: float) -> np.ndarray:
    """Mean thrust of the end edges as a share of that of an even layer, at the axial feeds LAYERS, (LAYERS.size,).

    modes: frequencies [rad/s], damping ratios, motion of the tip along z by each mode, and its answer to a unit force
    along z, (r,) each; pitch [s]: time from tooth to tooth. Above the edge radius the thrust is a straight line.
    """
    thin, thick = (float(cutting.active.per_depth(k * tool.edge_radius)[1]) for k in (1.0, 10.0))
    length = tool.teeth * float(tool.radii.max()) * cutting.end_share
    law = length * thin, length * (thick - thin) / (9.0 * tool.edge_radius), tool.edge_radius
    stiff = math.sqrt(max(0.0, law[0] / law[2] * float(modes[2] @ modes[3])))  # [rad/s] of the free tip on the contact
    steps = int(min(max(128.0, 12.0 * pitch * max(stiff, float(modes[0].max()))), 1000.0))

    def share(layer: float) -> float:
        numbers: tuple = (*modes, *law, layer * law[2] / pitch, pitch / steps, steps)
        return _bouncing(*numbers)

    if share(1.0) > 0.99:  # an arm bounces first where the layer is as thick as the edge is round
        return np.ones(LAYERS.size)
    return np.minimum(1.0, [share(layer) for layer in LAYERS.tolist()])


@njit(cache=True, error_model="numpy", nogil=True)
def _bouncing(frequency, damping, moved, answer, thin, slope, edge, rate, step, steps):
    """Mean thrust of a tip that sinks at ``rate`` [m/s], from the air, as a share of that of an even layer."""
    turns = 200  # pitches; the means are those of the second half, in which a soft arm may still rise
    half = turns * steps // 2
    place, speed = np.zeros(frequency.size), np.zeros(frequency.size)
    floor, thrust, total, middle, z = np.zeros(steps), 0.0, 0.0, 0.0, 0.0
    for n in range(2 * half + 1):
        z = -rate * step * n
        for m in range(frequency.size):
            push = answer[m] * thrust - 2.0 * damping[m] * frequency[m] * speed[m] - frequency[m] ** 2 * place[m]
            speed[m] += step * push
            place[m] += step * speed[m]
            z += moved[m] * place[m]
        h, thrust = floor[n % steps] - z, 0.0
        if h > 0.0:
            floor[n % steps] = z
            thrust = min(h / edge, 1.0) * thin + slope * max(h - edge, 0.0)
        if n == half:
            middle = z
        elif n > half:
            total += thrust
    h = (middle - z) / half * steps
    even = min(h / edge, 1.0) * thin + slope * max(h - edge, 0.0)
    return total / half / even if even > 0.0 else 1.0


@inlined
def layer_force(p, h):
    """``end_force`` of an axial feed per tooth h [m], with the mean thrust of a tip that may bounce."""
    f_t, f_r = end_force(p, h)
    last = p.bounce.size - 1
    at = math.log(max(h / max(p.edge_radius, 1e-12), 1e-9) / LOWEST) / SPACING
    k = min(max(int(at), 0), last - 1)
    part = min(max(at - k, 0.0), 1.0)
    return f_t, f_r * (p.bounce[k] + part * (p.bounce[k + 1] - p.bounce[k]))


@inlined
def floor_near(s, p, tip):
    """Deepest known level of a footprint near the tip; -1: none is known."""
    near = 0.1  # assumed, of the radius: a floor as far away is below nearly the whole tool
    for k in range(s.ints[FLOORS_KNOWN]):
        u, v = s.floors[k, 0] - tip[0], s.floors[k, 1] - tip[1]
        if u * u + v * v < (near * p.radius) ** 2:
            return np.int64(s.floors[k, 2])
    return np.int64(-1)


@inlined
def rise_of_step(s, p, z, passes, give):
    """Height of the tip above the predicted z at the end of a step [m]; give: of the tip for the whole thrust [m/N]."""
    if passes == 0.0 or s.ints[FLOOR_NEAR] < 0:
        return 0.0
    sinks = p.top - s.ints[FLOOR_NEAR] * p.level_step - z
    low, high = -give * s.floats[THRUST], sinks
    for _ in range(20 if low < high else 0):  # halve the interval of the rise from 1 mm to 1 nm
        rise = 0.5 * (low + high)
        thrust = s.floats[CONTACT] * layer_force(p, (sinks - rise) / passes)[1]
        if rise < give * (thrust - s.floats[THRUST]):
            low = rise
        else:
            high = rise
    return low


@inlined
def slant(pose):
    """Return the square of the sine of the tilt of a pose (6,)."""
    return pose[3] * pose[3] + pose[4] * pose[4]


@inlined
def flat_part(s, p, x0, y0, z0, x1, y1, z1, passes, wrench):
    """Cut along a straight move of at most a quarter of the radius: down, then level; return torque, height, thrust.

    A tool that sinks is as low as at the end, a tool that rises as high as in the middle of the move.
    """
    level = _level(p, min(z1, 0.5 * (z0 + z1)))
    if level == 0 or outside(p, x1, y1):
        remember(s, x1, y1, level)
        return 0.0, 0.0, 0.0
    for k in range(s.ahead.shape[0]):
        s.ahead[k, 0] = s.ahead[k, 1] = 0
    dx, dy = x1 - x0, y1 - y0
    m = math.sqrt(dx * dx + dy * dy)
    ahead_x, ahead_y = (dx / m, dy / m) if m > 0.0 else (1.0, 0.0)
    sinking = level > s.ints[FLOOR_LEVEL]
    if sinking:
        for k in range(SECTORS):
            s.sunk[k, 0] = s.sunk[k, 1] = s.sunk[k, 2] = 0.0
        cut_x, cut_y = _cut_before(s, level)
        # where a tool sinks by less than a tenth of the move, its rim ahead removes the layer with the crescent
        slight = m > 0.5 * p.spacing and (level - s.ints[FLOOR_LEVEL]) * p.level_step < 0.1 * m
        to_middle = 0.5 * m if slight else FAR
        _clear(s, p, cut_x, cut_y, x0, y0, level, True, to_middle, ahead_x, ahead_y)
    if m > 0.0:
        _clear(s, p, x0, y0, x1, y1, level, False, -0.5 * m, ahead_x, ahead_y)
    remember(s, x1, y1, level)
    if passes <= 0.0:
        return 0.0, 0.0, 0.0
    return _load(s, p, m, sinking, ahead_x, ahead_y, passes, wrench)


@inlined
def remember(s, x, y, level):
    """Note that the whole footprint at (x, y) is cut to ``level``. A later sinking tool need not visit it again.

    Only places matter that are deeper than all later ones.
    """
    s.ints[FLOOR_LEVEL] = level
    known = s.ints[FLOORS_KNOWN]
    while known > 0 and s.floors[known - 1, 2] <= level:
        known -= 1
    if known == FLOORS:  # the older half is forgotten
        known = FLOORS // 2
        s.ints[FLOORS_KEPT] = 0
        for k in range(known):
            for j in range(3):
                s.floors[k, j] = s.floors[k + FLOORS - known, j]
    s.ints[FLOORS_KEPT] = min(s.ints[FLOORS_KEPT], known)
    s.floors[known, 0], s.floors[known, 1], s.floors[known, 2] = x, y, level
    s.ints[FLOORS_KNOWN] = known + 1


@inlined
def _level(p, z):
    """Level of the map at a height of the tip; 0: above the stock."""
    depth = min(p.top - z, p.thickness)
    return max(1, int(depth / p.level_step + 0.5)) if depth > 1e-3 * p.level_step else 0


@inlined
def outside(p, x, y):
    """Return whether the footprint of the tool misses the stock."""
    return (
        x + p.radius < p.origin_x - p.spacing
        or x - p.radius > p.origin_x + p.nx * p.spacing
        or y + p.radius < p.origin_y - p.spacing
        or y - p.radius > p.origin_y + p.ny * p.spacing
    )


@inlined
def _cut_before(s, level):
    """The last tip (x, y) whose whole footprint is cut at least to ``level``; FAR away: none is known."""
    known = s.ints[FLOORS_KNOWN]
    while known > 0 and s.floors[known - 1, 2] < level:
        known -= 1
    return (s.floors[known - 1, 0], s.floors[known - 1, 1]) if known > 0 else (FAR, FAR)


@inlined
def _clear(s, p, x0, y0, x1, y1, level, sinking, to_middle, ahead_x, ahead_y):
    """Lower the footprint at (x1, y1) to ``level``, without the inside of that at (x0, y0), which is cut.

    to_middle: along the feed from (x1, y1) to the place from which nodes count as ahead. A moving tool lowers only what
    is ahead. A sinking tool lowers all but the rim ahead, which the move that follows lowers further.
    """
    scale = 1.0 / p.spacing
    u0, v0 = (x0 - p.origin_x) * scale, (y0 - p.origin_y) * scale
    u1, v1 = (x1 - p.origin_x) * scale, (y1 - p.origin_y) * scale
    r = p.radius * scale
    across = 0.5 * SINES * FINE / r
    side_x, side_y = -ahead_y * across, ahead_x * across  # sin(phi) in parts of the table, a node
    middle_u, middle_v = u1 + to_middle * scale * ahead_x, v1 + to_middle * scale * ahead_y
    zero = (0.5 * SINES + 0.5 + BEYOND) * FINE - (middle_u * side_x + middle_v * side_y)
    about_i, about_j = int(math.floor(u1 + 0.5)) - p.reach, int(math.floor(v1 + 0.5)) - p.reach
    frame = (ahead_y, side_x, np.int64(side_y), zero, about_i, about_j, u1, v1, r)
    start = max(int(math.ceil(u1 - r - RIM)), 0)
    end = min(int(math.floor(u1 + r + RIM)), p.nx - 1) + 1
    if not sinking:  # columns that reach ahead of the chord through the middle
        half = (r + RIM) * abs(ahead_y) + abs(to_middle) * scale + 1.0
        if ahead_x > 0.0:
            start = max(start, int(math.floor(u1 - half)))
        else:
            end = min(end, int(math.ceil(u1 + half)) + 1)
    count = max(end - start, 0)
    low, high, before, behind = s.spans[0], s.spans[1], s.spans[2], s.spans[3]
    _spans(low, high, start, count, u1, v1, (r + RIM) ** 2)
    _spans(before, behind, start, count, u0, v0, (r - RIM) ** 2)
    for n in range(count):
        low[n], high[n] = max(low[n], 0), min(high[n], p.ny - 1)
        before[n], behind[n] = min(before[n] - 1, high[n]), max(behind[n] + 1, low[n])
        if behind[n] <= low[n] or before[n] >= high[n]:  # the column misses the former footprint
            before[n], behind[n] = high[n], high[n] + 1
    if sinking:
        _lower_inside(s, p, start, count, u1, v1, r, level, x0 == FAR, about_i, about_j)
    for n in range(count):
        i = start + n
        along = middle_v * ahead_y - (i - middle_u) * ahead_x  # nodes ahead have j ahead_y above this
        if low[n] <= before[n] and _any_wanted(low[n], before[n], ahead_y, along, sinking):
            _column(s, p, i, low[n], before[n], level, sinking, along, frame)
        if behind[n] <= high[n] and _any_wanted(behind[n], high[n], ahead_y, along, sinking):
            _column(s, p, i, behind[n], high[n], level, sinking, along, frame)


@inlined
def _any_wanted(low, high, ahead_y, along, sinking):
    """Return whether a node j of low..high is ahead; for a sinking tool, whether a node is not ahead."""
    a, b = low * ahead_y, high * ahead_y
    return min(a, b) <= along if sinking else max(a, b) > along


@inlined
def _lower_inside(s, p, start, count, u, v, r, level, sparse, about_i, about_j):
    """Lower the whole cells below a sinking tool at (u, v) to ``level``; ``spans`` then has the nodes of the rim."""
    low, high, before, behind, first, last = s.spans[0], s.spans[1], s.spans[2], s.spans[3], s.spans[4], s.spans[5]
    _spans(first, last, start, count, u, v, (r - RIM) ** 2)
    for n in range(count):
        i, begin, end = start + n, max(low[n], first[n]), min(high[n], last[n])
        if begin > end:
            continue
        missed = before[n] > end or behind[n] < begin  # or nearly so
        upper, lower = (end, high[n] + 1) if missed else (before[n], behind[n])
        if begin <= upper:
            _lower_blocks(s, p, i, begin, upper, level, sparse, about_i, about_j)
        if lower <= end:
            _lower_blocks(s, p, i, lower, end, level, sparse, about_i, about_j)
        before[n], behind[n] = min(upper, begin - 1), end + 1 if missed else max(lower, end + 1)


@inlined
def _spans(low, high, start, count, u, v, square):
    """Fill the first and the last node of each column within a footprint at (u, v) [nodes]; none: first above last."""
    for n in range(count):
        beside = start + n - u
        half = square - beside * beside
        root = math.sqrt(max(half, 0.0))
        low[n] = np.int32(np.ceil(v - root) if half >= 0.0 else FAR)
        high[n] = np.int32(np.floor(v + root) if half >= 0.0 else -FAR)


@inlined
def take_tile(s, i, j):
    """Place in the pool of the tile of a node, which is taken where there is none; -1 and FAILED: no tile is left."""
    slot = s.table[i >> 8, j >> 8]
    if slot < 0:
        slot = np.int32(s.ints[TILES])
        if (np.int64(slot) + 1) << 16 > s.pool.size:
            s.ints[FAILED] = 1
            return np.int32(-1)
        s.table[i >> 8, j >> 8] = slot
        s.ints[TILES] += 1
    return slot


@inlined
def _lower_blocks(s, p, i, low, high, level, sparse, about_i, about_j):
    """Lower the nodes (i, low..high), whose cells a sinking tool covers, to ``level`` and add what they lose.

    A block of nodes at once, in the sector of its middle. sparse: most nodes may be cut already.
    """
    pool, rests, log_place, log_level, log_rest = s.pool, s.rest, s.log_place, s.log_level, s.log_rest
    j, logged, sunk = np.int64(low), s.ints[LOGGED], s.sunk
    new = total = 0
    lost = not sparse  # whether the last block lost something: the next one does, too
    room = logged + high - low < log_place.size
    if not room:
        logged = LOG_LOST
    deep, axis = np.uint16(level), about_j + p.reach
    while j <= high:
        slot = take_tile(s, i, j)
        if slot < 0:
            return
        stop = min(high, j | 255) + 1
        base = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
        while j < stop:
            begin = axis + ((j - axis) & ~(BLOCK - 1))  # blocks begin at the axis
            end = min(stop, begin + BLOCK)
            first, count = np.uint64(base + j), np.uint16(end - j)
            if not lost and not any_above(pool, first, np.uint64(end - j), deep):
                j = end
                continue
            if room:
                for n in range(end - j):
                    place = first + np.uint64(n)
                    if pool[place] < deep:
                        log_place[np.uint64(logged)], log_level[np.uint64(logged)] = place, pool[place]
                        log_rest[np.uint64(logged)] = rests[place]
                        logged += 1
            levels, lowered, untouched = np.uint32(0), np.uint16(0), np.uint16(0)
            for n in range(BLOCK):  # vector instructions: no branch, numbers as narrow as they may be
                place, lane = first + np.uint64(n), np.uint16(n)
                mean = pool[place]
                goal = deep if lane < count else np.uint16(0)
                left = np.uint16(max(mean, goal) - mean)
                cut = min(left, np.uint16(1))
                levels = np.uint32(levels + np.uint32(left))
                lowered = np.uint16(lowered + cut)
                untouched = np.uint16(untouched + np.uint16(left == deep))
                pool[place] = np.uint16(mean + left)
                rests[place] = max(rests[place], np.uint16(cut * deep))
            middle = min(max(begin + BLOCK // 2 - about_j, 0), 2 * p.reach)
            k = np.uint64(p.around[np.uint64(i - about_i), np.uint64(middle)])
            sunk[k, 0] += levels
            sunk[k, 1] += lowered
            sunk[k, 2] += lowered * p.inverse[np.uint64(i - about_i), np.uint64(middle)]
            total += np.int64(levels)
            new += np.int64(untouched)
            lost = not sparse or lowered > 0
            j = end
    s.ints[LOGGED] = logged
    s.ints[NODES_CUT] += new
    s.floats[LEVEL_SUM] += total * p.level_step


@inlined
def _column(s, p, i, low, high, level, sinking, along, frame):
    """Lower the nodes (i, low..high) to ``level`` and add what they lose to their bins; a sinking tool: the rim."""
    pool, rests, log_place, log_level, log_rest = s.pool, s.rest, s.log_place, s.log_level, s.log_rest
    ahead_y, side_x, side_y, zero, about_i, about_j, u, v, r = frame
    du = i - u
    inside, beside = r * r - du * du, abs(du)
    across = np.int64(zero + i * side_x)
    j, logged = np.int64(low), s.ints[LOGGED]
    ahead, sunk, shift = s.ahead, s.sunk, p.shift[i & 63]
    new = total = 0
    room = logged + high - low < log_place.size
    if not room:
        logged = LOG_LOST
    while j <= high:
        slot = take_tile(s, i, j)
        if slot < 0:
            return
        stop = min(high, j | 255) + 1
        base = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
        while j < stop:
            place = np.uint64(base + j)
            before = np.int64(pool[place])
            if before < level and not (sinking and j * ahead_y > along):
                dv = j - v
                rest = np.int64(rests[place])
                full = 4.0 * (beside + abs(dv))
                cover = 2.0 * (inside - dv * dv) + 0.5 * full  # ``full`` times the covered share
                after = rest + np.int64(min(cover, full) * (level - rest) / full + 0.5)
                if after > before:
                    if room:
                        log_place[np.uint64(logged)], log_level[np.uint64(logged)] = place, before
                        log_rest[np.uint64(logged)] = rest
                        logged += 1
                    pool[place] = after
                    if cover >= full:
                        rests[place] = level
                    lost = after - before
                    total += lost
                    new += before == 0
                    if sinking:
                        k = np.uint64(p.around[np.uint64(i - about_i), np.uint64(j - about_j)])
                        covered = min(cover / full, 1.0)
                        sunk[k, 0] += lost
                        sunk[k, 1] += covered
                        sunk[k, 2] += covered
                    else:
                        sine = np.uint64((across + j * side_y + shift[np.uint64(j & 63)]) >> 20)
                        k = np.uint64(p.front[sine])
                        ahead[k, 0] += lost
                        ahead[k, 1] += lost * (level - rest)
            j += 1
    s.ints[LOGGED] = logged
    s.ints[NODES_CUT] += new
    s.floats[LEVEL_SUM] += total * p.level_step


@inlined
def _load(s, p, m, sinking, ahead_x, ahead_y, passes, wrench):
    """Add the mean wrench of the removed bins; returns mean torque, height above the tip and thrust of the ends."""
    cell = p.spacing * p.spacing * p.level_step
    share = p.teeth / (2.0 * math.pi)
    local_x = local_y = force_z = moment_x = moment_y = torque = total = raised = 0.0
    for k in range(s.ahead.shape[0]):
        volume = float(s.ahead[k, 0])
        if volume > 0.0:
            h = m * p.cosines[k] / p.widths[k] / passes
            height = share * p.widths[k] * volume * cell / (p.radius * m * p.cosines[k])  # a_k f_k N dphi / (2 pi)
            f_t, f_r, f_a = forces_at(p.law, h)
            c, d = p.directions[k, 0], p.directions[k, 1]
            x = (-f_r * c + p.sense * f_t * d) * height
            y = (-f_r * d - p.sense * f_t * c) * height
            z = -f_a * height
            middle = 0.5 * s.ahead[k, 1] / volume * p.level_step  # height above the tip
            local_x, local_y, force_z = local_x + x, local_y + y, force_z + z
            moment_x += p.radius * d * z - middle * y
            moment_y += middle * x - p.radius * c * z
            torque += f_t * height * p.radius
            total, raised = total + volume, raised + volume * middle
    thrust = end_x = end_y = side_x = side_y = turning = layers = contact = 0.0
    for k in range(SECTORS if sinking else 0):
        volume, nodes = s.sunk[k, 0], s.sunk[k, 1]
        if volume > 0.0:  # each tooth takes a layer with its end edge: N / 2 pi int int dr dphi, and int int r dr dphi
            f_t, f_r = layer_force(p, volume / nodes * p.level_step / passes)
            length = share * s.sunk[k, 2] * p.spacing * p.spacing / p.radius
            moment = share * nodes * p.spacing * p.spacing
            c, d = p.turns[k, 0], p.turns[k, 1]
            side_x, side_y = side_x + p.sense * f_t * d * length, side_y - p.sense * f_t * c * length
            thrust, end_x, end_y = thrust + f_r * length, end_x + d * f_r * moment, end_y - c * f_r * moment
            turning += f_t * moment
            layers, contact = layers + volume, contact + length
    if s.ints[FLOOR_LEVEL] > s.ints[FLOOR_NEAR]:
        # assumed: 90 % of an earlier contact still count; a tool that swings meets the whole floor again
        s.floats[CONTACT] = max(contact, 0.9 * s.floats[CONTACT])
    torque, total = torque + turning, total + layers
    wrench[0] += ahead_x * local_x - ahead_y * local_y + side_x
    wrench[1] += ahead_y * local_x + ahead_x * local_y + side_y
    wrench[2] += force_z + thrust
    if p.moments:
        wrench[3] += ahead_x * moment_x - ahead_y * moment_y + end_x
        wrench[4] += ahead_y * moment_x + ahead_x * moment_y + end_y
    return torque, raised / total if total > 0.0 else 0.0, thrust


@inlined
def undo_engagement(s, edge):
    """Take the last step back; False where the log was too small and nothing was done. edge: that of the state."""
    logged = s.ints[LOGGED]
    if edge is not None:
        for k in range(min(logged, s.log_place.size)):
            run = s.log_place[k] // RUN
            edge.highest[run] = min(edge.highest[run], s.log_level[k])
    if logged >= s.log_place.size:
        return False
    for k in range(logged - 1, -1, -1):
        s.pool[s.log_place[k]] = s.log_level[k]
        s.rest[s.log_place[k]] = s.log_rest[k]
    tiles, floors = s.ints[TILES], s.ints[FLOORS_KEPT]
    copy_numbers(s.saved_ints, s.ints)
    copy_numbers(s.saved_floats, s.floats)
    s.ints[TILES] = tiles  # an untouched tile equals none
    s.ints[FLOORS_KNOWN] = floors
    s.ints[LOGGED] = 0
    return True
