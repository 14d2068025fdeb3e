"""Removal of material by a cutter of revolution with a tilted axis; forces and bins are those of ``revolution``.

The axis a points from the tip to the holder: sine s and cosine c of its tilt, in the vertical plane of u. The vertical
line through a node at (u, v) from the tip meets the plane at the height zeta of the axis at the distance rho from it:

    rho^2 = v^2 + (u - zeta s)^2 / c^2,   z = (zeta - u s) / c

The lowest point of the tool is the smallest zeta with rho <= r(zeta). For each line and arc of the profile, this is the
root of a quadratic; the torus of a corner takes some Newton steps, which approach the root from below.

In a step a node is lowered to the lowest point that the tool has there on its way. The height falls with the rate
(d.n) / n_z, d the move of that point of the tool and n its normal. As the height is convex, its least value lies where
the rate changes its sign. Where the surface leaves the top of the stock within a cell, the node is lowered to the mean
over the cell.

The volume that a column loses is divided into slices, the thinnest at its lower end. Each is sorted by its angle phi
and its piece of the edge. A tool that moves across its axis meets a slice where e2 = r sin(phi), r the radius at its
height; so does a steep flank. Beside a level end d.n falls to zero within a step, and some Newton steps find the place.
Arcs are seen from the middle of the way. A column is at a scattered place of its cell and a slice at a scattered
height, in proportion to the volume there: rows of nodes in the middle of their cells left bins beside d.n = 0 empty,
and forces of a strip of 5 % of the width, of some four rows of nodes, were up to 7 % wrong.

A column of the map also loses the material above a leaning flank. Where the tool meets this material on its way ahead,
its force counts now. Where the tool has passed it, it has no force, and is counted as ``UNDERCUT``.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.compiled import compiled, inlined, inner
from kr270_milling.physics.cutting.engagement import BEYOND, FLOOR_LEVEL, RIM, SINES, SWING, take_tile
from kr270_milling.physics.cutting.grid import LEVELS
from kr270_milling.physics.cutting.profile import BEND, COSINE_K, ENTRIES, RUN, SINE_K
from kr270_milling.physics.cutting.revolution import GOAL, LOST, PART, REST, SHARE, lower_nodes
from kr270_milling.physics.cutting.state import UNDERCUT

# Rows of ``EdgeBins.work`` beside those of ``revolution``
BOUND = 5 * RUN  # level below which no node of a whole run is lowered
FALL = 7 * RUN  # half of the difference of the levels of the tool over a cell
NEAR = 6 * RUN  # 2: the tool covers cells of a whole run in part; 1: it did so at the start of the step
MISSED = math.inf  # height of a tool that does not cover a node
U, V, X, Y, Z, NU, NV, NZ, LAST, RISE, COVER, SLOPE = (RUN * k for k in range(12))  # rows of ``EdgeBins.place``
# a column is at a place in its cell, and a slice at a height in the column, so that a row of nodes along the feed
# fills all bins that its cells meet: SCATTER_X i + SCATTER_Y j and SCATTER_U i + SCATTER_V j, as shares of 2^32
SCATTER_X, SCATTER_Y = np.uint32(0.5698402910 * 2.0**32), np.uint32(0.7548776662 * 2.0**32)
SCATTER_U, SCATTER_V = np.uint32(0.8191725134 * 2.0**32), np.uint32(0.6710436067 * 2.0**32)
MIDDLE = COVER  # level of the tool in the middle of a cell
STAYS = -1e9  # level of a tool that does not cover a node
FLAT = 1e-9  # [m] and sine of an angle below which a length and a tilt are none


@inlined
def turned_axis(x, y, z):
    """Return the frame of an axis: direction of its tilt in the plane (2), sine and cosine of the tilt."""
    s = math.sqrt(x * x + y * y)
    if s < FLAT:
        return 1.0, 0.0, 0.0, 1.0
    return x / s, y / s, s, z


@inlined
def _normal(x, v, rho, sine, cosine, s, c):
    """Return the outward normal along u, v and z, at the place (x, v) of a circle about the axis."""
    each = sine / rho
    return each * x * c - cosine * s, each * v, -each * x * s - cosine * c


@inlined
def _sphere(part, u, v, s, c):
    """``touch`` of the ball at the tip of the profile."""
    corner, middle, each = part[4], part[1] + part[4], 1.0 / part[4]
    x = u - middle * s
    square = corner * corner - x * x - v * v
    root = math.sqrt(max(square, 0.0))
    z = middle * c - root
    touches = square >= 0.0 and u * s + z * c <= part[3]
    return z if touches else MISSED, x * each, v * each, -root * each


@inlined
def _torus(part, u, v, s, c):
    """``touch`` of a corner that begins beside the axis."""
    r0, h, top, corner, by_c = part[0], part[1], part[3], part[4], 1.0 / c
    middle = h + corner
    for _ in range(12):
        x = (u - h * s) * by_c
        rho = math.sqrt(x * x + v * v) + 1e-15
        out = max(rho - r0, 0.0)
        far = math.sqrt(out * out + (middle - h) * (middle - h))
        if far - corner <= 2e-9:  # [m]
            return (h - u * s) * by_c, *_normal(x, v, rho, out / corner, (middle - h) / corner, s, c)
        slope = -out * x * s * by_c / rho - (middle - h)  # times far
        if slope >= 0.0:
            break
        h -= (far - corner) * far / slope
        if h > top + FLAT:
            break
    return MISSED, 0.0, 0.0, -1.0


@inlined
def _level(part, u, v, s, c):
    """``touch`` of the end, or of a ledge."""
    x = (u - part[1] * s) / c
    square = x * x + v * v
    touches = part[0] * part[0] <= square <= part[2] * part[2]
    return (part[1] - u * s) / c if touches else MISSED, -s, 0.0, -c


@inlined
def _cone(part, u, v, s, c):
    """``touch`` of a cone or a cylinder."""
    sine, cosine, by_c = part[5], part[6], 1.0 / c
    rise, at = cosine / sine, u * by_c
    base = part[0] - part[1] * rise
    a, b = s * by_c * s * by_c - rise * rise, at * s * by_c + base * rise
    rest = v * v + at * at - base * base
    square = b * b - a * rest
    h = rest / (b + math.sqrt(max(square, 0.0)))
    touches = square >= 0.0 and part[1] <= h <= part[3]
    x, rho = (u - h * s) * by_c, base + rise * h + 1e-15
    return (h - u * s) * by_c if touches else MISSED, *_normal(x, v, rho, sine, cosine, s, c)


@compiled
def touch(parts, u, v, s, c):
    """Return the lowest point of the tool at (u, v) from its tip and its outward normal along u, v, z; or MISSED."""
    for k in range(parts.shape[0]):
        part = parts[k]
        if part[4] > 0.0:
            touched = _sphere(part, u, v, s, c) if part[0] < FLAT else _torus(part, u, v, s, c)
        else:
            touched = _level(part, u, v, s, c) if part[5] < FLAT else _cone(part, u, v, s, c)
        if touched[0] != MISSED:
            return touched
    return MISSED, 0.0, 0.0, -1.0


@inner
def _touch_run(parts, place, s, c):
    """``touch`` of the nodes of a run, at U and V of ``place``; fills Z and the normal."""
    for n in range(RUN):
        place[Z + n] = MISSED
    for k in range(parts.shape[0]):
        part = parts[k]
        kind = (0 if part[0] < FLAT else 1) if part[4] > 0.0 else (2 if part[5] < FLAT else 3)
        missed = 0
        for n in range(RUN):
            missed += place[Z + n] == MISSED
        if missed == 0:
            break
        if kind == 0:
            for n in range(RUN):
                _keep(place, n, _sphere(part, place[U + n], place[V + n], s, c))
        elif kind == 1:
            for n in range(RUN):
                if place[Z + n] == MISSED:
                    _keep(place, n, _torus(part, place[U + n], place[V + n], s, c))
        elif kind == 2:
            for n in range(RUN):
                _keep(place, n, _level(part, place[U + n], place[V + n], s, c))
        else:
            for n in range(RUN):
                _keep(place, n, _cone(part, place[U + n], place[V + n], s, c))


@inlined
def _keep(place, n, touched):
    """Keep the first touch of a node."""
    z = place[Z + n]
    first = z == MISSED
    place[Z + n] = touched[0] if first else z
    place[NU + n] = touched[1] if first else place[NU + n]
    place[NV + n] = touched[2] if first else place[NV + n]
    place[NZ + n] = touched[3] if first else place[NZ + n]


@inlined
def _radius_at(parts, h):
    """Return the radius of the tool at a height above its tip [m]."""
    radius = 0.0
    for k in range(parts.shape[0]):
        if h >= parts[k, 1]:
            corner, up = parts[k, 4], h - parts[k, 1]
            if corner > 0.0:
                up = min(up, parts[k, 3] - parts[k, 1])
                radius = parts[k, 0] + math.sqrt(max(up * (2.0 * corner - up), 0.0))
            elif parts[k, 5] > FLAT:
                radius = min(parts[k, 0] + up * parts[k, 6] / parts[k, 5], parts[k, 2])
            else:
                radius = parts[k, 2]
    return radius


@inlined
def _widest(part, s, c):
    """Return radius, lower and upper height and rise of a part of the shadow, and the factor of |v| in its height."""
    corner, rise, low, high = part[4], 0.0, part[3], part[3]
    if corner > 0.0:
        low = high = part[1] + corner
    elif part[5] > FLAT:  # the height at which the line is widest beside the node
        bend = part[6] / part[5] * c / max(s, FLAT)
        if bend < 1.0:
            return part[0], part[1], part[3], part[6] / part[5], c * bend / math.sqrt(1.0 - bend * bend)
    return part[0] if corner > 0.0 else part[2], low, high, rise, 0.0


@inlined
def _depth(part, widest, u, v, s, c):
    """Return how far a node is inside the shadow of a part [m], and the direction out of it along u and v."""
    r, low, high, rise, beside = widest
    by_s, by_c = 1.0 / max(s, FLAT), 1.0 / c
    h = min(max((u + beside * abs(v)) * by_s, low), high)
    x = (u - h * s) * by_c
    q, out = math.sqrt(x * x + v * v) + 1e-15, x * by_c
    each = 1.0 / (math.sqrt(out * out + v * v) + 1e-15)
    return (r + rise * (h - low) - q) * q * each + part[4], out * each, v * each


@compiled
def inside(parts, u, v, s, c):
    """Return how far a node is inside the shadow of the tool [m], and the direction out of it along u and v."""
    best = -1e9, 1.0, 0.0
    for k in range(parts.shape[0]):
        within = _depth(parts[k], _widest(parts[k], s, c), u, v, s, c)
        if within[0] > best[0]:
            best = within
    return best


@inner
def _inside_run(parts, place, s, c):
    """``inside`` of the nodes of a run, at U and V of ``place``; fills Z, NU and NV."""
    for n in range(RUN):
        place[Z + n] = -1e9
    for k in range(parts.shape[0]):
        widest = _widest(parts[k], s, c)
        for n in range(RUN):
            depth, out_u, out_v = _depth(parts[k], widest, place[U + n], place[V + n], s, c)
            best = place[Z + n]
            deeper = depth > best
            place[Z + n] = depth if deeper else best
            place[NU + n] = out_u if deeper else place[NU + n]
            place[NV + n] = out_v if deeper else place[NV + n]


@inlined
def shadow_rows(x, start_u, end_u, ux, uy, reach):
    """Return the least and largest y of the stadium of a radius ``reach`` about (start_u..end_u) (ux, uy), at one x."""
    low_y, high_y = 1e9, -1e9
    for end in (start_u, end_u):
        half = reach * reach - (x - end * ux) * (x - end * ux)
        if half >= 0.0:
            root = math.sqrt(half)
            low_y, high_y = min(low_y, end * uy - root), max(high_y, end * uy + root)
    if abs(ux) > FLAT and end_u > start_u:  # its sides, |v| <= reach
        for side in (-reach, reach):
            y = (side + x * uy) / ux
            u = x * ux + y * uy
            if start_u <= u <= end_u:
                low_y, high_y = min(low_y, y), max(high_y, y)
    return low_y, high_y


@inlined
def _axis_at(step, t):
    """Return ``turned_axis`` at the share t of a step."""
    _, _, _, _, _, _, ax, ay, az, bx, by, bz, ux, uy, s, c = step
    if t < 1.0 and (bx != 0.0 or by != 0.0 or bz != 0.0):
        a, b, e = ax - (1.0 - t) * bx, ay - (1.0 - t) * by, az - (1.0 - t) * bz
        scale = 1.0 / math.sqrt(a * a + b * b + e * e)
        ux, uy, s, c = turned_axis(a * scale, b * scale, e * scale)
    return ux, uy, s, c


@inlined
def _look(p, step, t, x, y):
    """Return the height of the tool above a node at the share t of the step, and its rate over the step.

    x, y: of the node from the tip at the end of the step [m]; the height is above that tip.
    """
    dx, dy, dz, wx, wy, wz, _, _, _, bx, by, bz, _, _, _, _ = step
    back = 1.0 - t
    x, y = x + back * dx, y + back * dy
    turning = bx != 0.0 or by != 0.0 or bz != 0.0
    ux, uy, s, c = _axis_at(step, t)
    u, v = x * ux + y * uy, y * ux - x * uy
    z, nu, nv, nz = touch(p.profile.parts, u, v, s, c)
    if z == MISSED:
        return z, 0.0
    nx, ny = nu * ux - nv * uy, nu * uy + nv * ux
    move = dx * nx + dy * ny + dz * nz
    if turning:
        move += wx * (y * nz - z * ny) + wy * (z * nx - x * nz) + wz * (x * ny - y * nx)
    return z - back * dz, move / min(nz, -1e-6)


@inlined
def _lowest_on_way(p, step, x, y, first, falls, last, rate, enough):
    """Return the share of the step at which the tool is lowest above a node, and its height there.

    first, falls: height and rate at the start of the step, where the tool falls, or MISSED; last, rate: those at its
    end, where the tool rises; enough: a height that the tool must get below.
    """
    low, high = 0.0, 1.0
    for _ in range(8):
        missed = first == MISSED
        t = 0.5 * (low + high)
        if not missed:
            t = (last - first + falls * low - rate * high) / (falls - rate)
            bound = first + falls * (t - low)
            if bound > enough:
                return t, MISSED
            if t <= low or t >= high:
                break
        z, now = _look(p, step, t, x, y)
        if z == MISSED:
            low = t
            continue
        if not missed and z - bound < 1e-7:  # [m]
            return t, z
        if now > 0.0:
            high, last, rate = t, z, now
        else:
            low, first, falls = t, z, now
    return (high, last) if last <= first else (low, first)


@inlined
def _pose(pose_from, pose_to, share):
    """Return tip and unit axis at a share of a step, six numbers."""
    rest = 1.0 - share
    a, b, e, x, y, z = (rest * pose_from[0] + share * pose_to[0], rest * pose_from[1] + share * pose_to[1],
                        rest * pose_from[2] + share * pose_to[2], rest * pose_from[3] + share * pose_to[3],
                        rest * pose_from[4] + share * pose_to[4], rest * pose_from[5] + share * pose_to[5])  # fmt: skip
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return a, b, e, x * scale, y * scale, z * scale


@inlined
def _way(p, first, second):
    """Return step, frame and motion of the tool between two poses of ``_pose``.

    step: move of the tip, turn of the axis, axis at the end, its change, and ``turned_axis`` of the end, 16 numbers;
    frame, motion: as in ``edge_load``.
    """
    dx, dy, dz = second[0] - first[0], second[1] - first[1], second[2] - first[2]
    ax, ay, az = first[3] + second[3], first[4] + second[4], first[5] + second[5]
    scale = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax * scale, ay * scale, az * scale
    bx, by, bz = second[3] - first[3], second[4] - first[4], second[5] - first[5]
    sink = dx * ax + dy * ay + dz * az
    if abs(sink) < 1e-9 * (abs(dx) + abs(dy) + abs(dz)):  # rounding, which would press the end on the floor
        sink = 0.0
    e1x, e1y, e1z = dx - sink * ax + p.radius * bx, dy - sink * ay + p.radius * by, dz - sink * az + p.radius * bz
    swing = e1x * ax + e1y * ay + e1z * az
    e1x, e1y, e1z = e1x - swing * ax, e1y - swing * ay, e1z - swing * az
    length = math.sqrt(e1x * e1x + e1y * e1y + e1z * e1z)
    if length < 1e-12:
        length = math.sqrt(az * az + ay * ay)
        e1x, e1y, e1z = 0.0, az, -ay
    e1x, e1y, e1z = e1x / length, e1y / length, e1z / length
    e2x, e2y, e2z = ay * e1z - az * e1y, az * e1x - ax * e1z, ax * e1y - ay * e1x
    # omega = a x da; its parts along e1 and e2 are -da.e2 and da.e1
    wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    turn_1, turn_2 = -(bx * e2x + by * e2y + bz * e2z), bx * e1x + by * e1y + bz * e1z
    ux, uy, sine, cosine = turned_axis(second[3], second[4], second[5])
    step = (dx, dy, dz, wx, wy, wz, second[3], second[4], second[5], bx, by, bz, ux, uy, sine, cosine)
    motion = (dx * e1x + dy * e1y + dz * e1z, dx * e2x + dy * e2y + dz * e2z, sink, turn_1, turn_2)
    return step, (e1x, e1y, e1z, e2x, e2y, e2z, ax, ay, az), motion


@inlined
def lower_tilted(s, p, pose_from, pose_to, a, b, passes):
    """Lower the nodes that the tool reaches between the shares a and b of a step; return motion and frame.

    pose_from, pose_to: tip and axis, (6,).
    """
    second = _pose(pose_from, pose_to, b)
    step, frame, motion = _way(p, _pose(pose_from, pose_to, a), second)
    tip_x, tip_y, tip_z, dz = second[0], second[1], second[2], step[2]
    ux, uy, sine, cosine = step[12], step[13], step[14], step[15]
    follows = s.ints[FLOOR_LEVEL] >= 0
    s.ints[FLOOR_LEVEL] = 0  # known
    parts = p.profile.parts
    lowest = 1e9
    for k in range(parts.shape[0] - 1):
        corner = parts[k, 4]
        if corner > 0.0:
            lowest = min(lowest, (parts[k, 1] + corner) * cosine - parts[k, 0] * sine - corner)
        else:
            lowest = min(lowest, parts[k, 1] * cosine - parts[k, 0] * sine, parts[k, 3] * cosine - parts[k, 2] * sine)
    under = p.top - tip_z - lowest + max(dz, 0.0)  # depth of the lowest point
    if under <= 1e-3 * p.level_step:
        return motion, frame
    most = under / p.level_step
    reach = p.radius + RIM * p.spacing
    start_u = parts[0, 4] * sine if parts[0, 4] > 0.0 and parts[0, 0] < FLAT else 0.0
    end_u = max(start_u, (p.top - tip_z + p.radius * sine) / cosine * sine)
    low_x, high_x = min(start_u * ux, end_u * ux) - reach, max(start_u * ux, end_u * ux) + reach
    first_i = max(int(math.ceil((tip_x + low_x - p.origin_x) / p.spacing)), 0)
    last_i = min(int(math.floor((tip_x + high_x - p.origin_x) / p.spacing)), p.nx - 1)
    shift_y = tip_y - p.origin_y
    reached = False
    for i in range(first_i, last_i + 1):
        x = p.origin_x + i * p.spacing - tip_x
        low_y, high_y = shadow_rows(x, start_u, end_u, ux, uy, reach)
        if low_y > high_y:
            continue
        low = max(int(math.ceil((shift_y + low_y) / p.spacing)), 0)
        high = min(int(math.floor((shift_y + high_y) / p.spacing)), p.ny - 1)
        first, reaches = low & ~(RUN - 1), False
        while first <= high:
            j, first = max(first, low), first + RUN
            end, n = min(first - 1, high), (j - low // RUN * RUN) // RUN & (RUN - 1)
            if n == 0:
                start, last = (j & ~(RUN - 1)) * p.spacing - shift_y, high // RUN - j // RUN
                reaches = _bound_runs(s, p, step, tip_z, x, start, last) or reaches
            slot = s.table[i >> 8, j >> 8]
            known = 0.0
            if slot >= 0:
                place = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
                known = float(s.edge.highest[np.uint64((place + j) // RUN)])
            if most < known + 0.5 or s.edge.work[BOUND + n] < known + 0.5:
                continue
            start = (j & ~(RUN - 1)) * p.spacing - shift_y
            if not _look_at_run(s, p, step, tip_z, x, start, j, end, s.edge.work[NEAR + n], known, follows):
                continue
            if slot < 0:
                slot = take_tile(s, i, j)
                if slot < 0:
                    return motion, frame
                place = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
            reached = True
            _lower_run(s, p, step, frame, tip_z, j, place, x, start, passes)
        if reached and not reaches:  # what is below the top is convex: the rows beyond do not meet it either
            break
    return motion, frame


@inner
def _rates(parts, place, step, t):
    """Fill Z and NZ with height and rate of ``_look`` at U and V, NU and NV with the slopes along y and x."""
    dx, dy, dz, wx, wy, wz, _, _, _, bx, by, bz, _, _, _, _ = step
    turning = bx != 0.0 or by != 0.0 or bz != 0.0
    ux, uy, s, c = _axis_at(step, t)
    _touch_run(parts, place, s, c)
    for n in range(RUN):
        u, v, z, nz = place[U + n], place[V + n], place[Z + n], place[NZ + n]
        nx, ny = place[NU + n] * ux - place[NV + n] * uy, place[NU + n] * uy + place[NV + n] * ux
        move = dx * nx + dy * ny + dz * nz
        if turning:
            x, y = u * ux - v * uy, u * uy + v * ux
            move += wx * (y * nz - z * ny) + wy * (z * nx - x * nz) + wz * (x * ny - y * nx)
        each = 1.0 / min(nz, -1e-6)
        place[Z + n] = z - (1.0 - t) * dz
        place[NU + n], place[NV + n], place[NZ + n] = -ny * each, -nx * each, move * each


@inlined
def _beside(step):
    """Return the direction across a step, (2,)."""
    way = math.sqrt(step[0] * step[0] + step[1] * step[1]) + 1e-15
    return -step[1] / way, step[0] / way


@inlined
def _bound_runs(s, p, step, tip_z, x, start, last):
    """Fill BOUND and NEAR of RUN runs from the y ``start``, of which ``last`` is the last in use.

    No node of a run is lowered below BOUND. NEAR is 2 where the tool covers cells of a run in part, 1 where it did so
    at the start of the step. Return whether a node of the row may be lowered.
    """
    place, work, half, depth = s.edge.place, s.edge.work, 0.5 * (RUN - 1) * p.spacing, p.top - tip_z
    ux, uy, rim, lowest = step[12], step[13], RIM * p.spacing, 0
    turn = math.sqrt(step[3] * step[3] + step[4] * step[4] + step[5] * step[5])
    way = 1.5 * math.sqrt(step[0] * step[0] + step[1] * step[1]) + SWING * p.radius * turn
    for n in range(RUN):
        y = start + half + min(n, last) * (RUN * p.spacing)
        place[U + n], place[V + n] = x * ux + y * uy, y * ux - x * uy
    _rates(p.profile.parts, place, step, 1.0)
    for n in range(RUN):
        z, slope = place[Z + n], place[NU + n]
        known = z != MISSED and not p.profile.hollow
        bound = depth - z + max(place[NZ + n], 0.0) + 0.125 * p.spacing * (abs(slope) + abs(place[NV + n]))
        work[BOUND + n] = np.float32((bound + abs(slope) * half) / p.level_step if known else float(LEVELS + 1))
        # the next runs, where the middle may miss the tool
        bound += rim * (abs(slope) + abs(place[NV + n]))
        near, far = slope * (half + p.spacing), slope * (3.0 * half + p.spacing)
        place[LAST + n] = (bound - min(near, far)) / p.level_step if known else float(LEVELS + 1)
        place[RISE + n] = (bound + max(near, far)) / p.level_step if known else float(LEVELS + 1)
    for n in range(RUN):
        bound = min(place[LAST + max(n - 1, 0)], place[RISE + min(n + 1, RUN - 1)])
        if place[Z + n] == MISSED:
            work[BOUND + n] = np.float32(bound)
        lowest += n <= last and work[BOUND + n] >= np.float32(0.5)
    if lowest > 0:
        for n in range(RUN):
            y = start + n * (RUN * p.spacing)
            place[U + n], place[V + n] = x * ux + y * uy, y * ux - x * uy
        _inside_run(p.profile.parts, place, step[14], step[15])
        for n in range(RUN):
            within = -rim if n == RUN - 1 else min(place[Z + n], place[Z + min(n + 1, RUN - 1)])
            work[NEAR + n] = np.float32(2.0 if within < rim else within < rim + way)
    return lowest > 0


@inlined
def _look_at_run(s, p, step, tip_z, x, start, low, high, near, known, follows):
    """Fill GOAL, PART and SHARE of the nodes low..high of a run; return whether the step may lower any.

    start: y of the first node of the run [m]; near: NEAR of the run; known: least level of the run;
    follows: the tool comes from its last place, so that it has cut all that its back covers.
    """
    ux, uy, sine, cosine = step[12], step[13], step[14], step[15]
    side_x, side_y = _beside(step)
    place, work, first = s.edge.place, s.edge.work, low & ~(RUN - 1)
    depth, levels, rim = p.top - tip_z, 1.0 / p.level_step, RIM * p.spacing
    for n in range(RUN):
        y = start + min(max(n, low - first), high - first) * p.spacing
        place[U + n], place[V + n] = x * ux + y * uy, y * ux - x * uy
        work[PART + n] = np.float32(1.0)
    if near > 1.0:
        _inside_run(p.profile.parts, place, sine, cosine)
        for n in range(RUN):
            within, out_u, out_v = place[Z + n], place[NU + n], place[NV + n]
            sides = abs(out_u * ux - out_v * uy) + abs(out_u * uy + out_v * ux)
            part = min(max(0.5 + within / (p.spacing * sides), 0.0), 1.0)
            work[PART + n] = np.float32(part if within < rim else 1.0)
            pull = max(0.02 * p.spacing - within, 0.0)
            place[U + n], place[V + n] = place[U + n] - pull * out_u, place[V + n] - pull * out_v
    _rates(p.profile.parts, place, step, 1.0)
    rises = 0
    for n in range(RUN):
        hit = place[Z + n] != MISSED and first + n >= low and first + n <= high and work[PART + n] > np.float32(0.0)
        goal = min((depth - place[Z + n]) * levels, float(LEVELS))
        work[GOAL + n] = np.float32(goal if hit else STAYS)
        place[SLOPE + n] = slope = min(max(place[NV + n] * side_x + place[NU + n] * side_y, -3.0), 3.0)
        work[FALL + n] = np.float32(0.5 * p.spacing * levels * abs(slope) + 1e-9)
        work[SHARE + n] = np.float32(1.0)
        place[LAST + n], place[RISE + n] = place[Z + n], place[NZ + n]
        place[X + n], place[Y + n] = place[U + n] * ux - place[V + n] * uy, place[U + n] * uy + place[V + n] * ux
        rises += hit and place[NZ + n] > 0.0
    most = np.int32(0)
    if rises > 0:
        ux, uy, s0, c0 = _axis_at(step, 0.0)
        for n in range(RUN):
            x, y = place[X + n] + step[0], place[Y + n] + step[1]
            place[U + n], place[V + n], place[COVER + n] = x * ux + y * uy, y * ux - x * uy, p.spacing
        if near > 0.0:
            _inside_run(p.profile.parts, place, s0, c0)
            for n in range(RUN):
                place[COVER + n] = place[Z + n]
        _rates(p.profile.parts, place, step, 0.0)
        for n in range(RUN):
            goal = (depth - place[Z + n]) * levels
            if place[RISE + n] > 0.0 and work[GOAL + n] > np.float32(STAYS):
                lowest = place[Z + n] != MISSED and place[NZ + n] >= 0.0
                work[SHARE + n] = np.float32(0.0 if lowest else -1.0)
                bound = goal if lowest else (depth - place[LAST + n] + place[RISE + n]) * levels
                cut = lowest and follows and place[COVER + n] > rim
                work[GOAL + n] = np.float32(STAYS if cut else min(bound, float(LEVELS)))
    for n in range(RUN):
        near_top = np.float32(0.25) * work[FALL + n] * np.float32(work[FALL + n] > abs(work[GOAL + n]))
        most = max(most, np.int32(work[GOAL + n] + near_top + np.float32(0.5)))
    return most > np.int32(known)


@inlined
def _lower_run(s, p, step, frame, tip_z, low, base, x, start, passes):
    """Lower the nodes of a run to the depths of ``_look_at_run``; teeth that pass: add what they lose to their bins."""
    place, work, first = s.edge.place, s.edge.work, low & ~(RUN - 1)
    depth, levels = p.top - tip_z, 1.0 / p.level_step
    side_x, side_y = _beside(step)
    for n in range(RUN):
        if work[SHARE + n] < np.float32(0.0):
            enough = s.rest[np.uint64(base + first + n)] + 0.5
            enough -= np.float64(work[FALL + n]) if enough < work[FALL + n] else 0.0
            bound, work[GOAL + n] = work[GOAL + n], np.float32(STAYS)
            if bound >= enough:
                share, z = _lowest_on_way(
                    p, step, place[X + n], place[Y + n], place[Z + n], place[NZ + n], place[LAST + n], place[RISE + n],
                    depth - enough * p.level_step,
                )  # fmt: skip
                work[SHARE + n] = np.float32(share)
                work[GOAL + n] = np.float32(min((depth - z) * levels, float(LEVELS)))
    for n in range(RUN):  # the surface leaves the top within a cell: the mean of its depth over the cell
        goal, fall = work[GOAL + n], work[FALL + n]
        part = np.float32(0.5) * (goal + fall) / fall
        place[MIDDLE + n] = goal
        work[GOAL + n] = part * part * fall if abs(goal) < fall else goal
    lower_nodes(s, p, base, first)
    if passes == 0.0:
        return
    hashed = np.uint32(base >> 8) * SCATTER_X + np.uint32(first) * SCATTER_Y
    jitter = np.uint32(base >> 8) * SCATTER_U + np.uint32(first) * SCATTER_V
    ux, uy = step[12], step[13]
    for n in range(RUN):
        at, place[RISE + n] = _place_in_cell(
            place[MIDDLE + n],
            np.float64(work[REST + n]),
            np.float64(work[FALL + n]),
            np.float64(np.uint32(hashed + np.uint32(n) * SCATTER_Y)) * 2.0**-32,
        )
        place[LAST + n] = depth - (place[MIDDLE + n] + 2.0 * at * np.float64(work[FALL + n])) * p.level_step
        shift, part = -math.copysign(at, at * place[SLOPE + n]), np.float64(work[PART + n])
        # in the covered part; a node that the tool does not cover is at its rim
        out = math.copysign(1.0, place[X + n] * frame[3] + place[Y + n] * frame[4] + place[LAST + n] * frame[5])
        covered = out * part * (out * shift - 0.5) + (0.0 if part < 0.5 else out * (part - 0.5))
        shift = p.spacing * (covered if part < 1.0 else shift)
        place[X + n], place[Y + n] = place[X + n] + shift * side_x, place[Y + n] + shift * side_y
        place[U + n] = place[X + n] * ux + place[Y + n] * uy
        place[V + n] = place[Y + n] * ux - place[X + n] * uy
    _touch_run(p.profile.parts, place, step[14], step[15])
    for n in range(RUN):
        lost, share = np.float64(work[LOST + n]), np.float64(work[SHARE + n])
        if lost > 0.0:
            x, y, z = place[X + n], place[Y + n], place[Z + n]
            if share < 1.0:
                z, _ = _look(p, step, share, x, y)
            z = place[LAST + n] if z == MISSED else z
            within = np.float64(np.uint32(jitter + np.uint32(n) * SCATTER_V)) * 2.0**-32
            _sort_column(s, p, step, frame, share, (x, y, z, place[RISE + n] * p.level_step, within), lost)


@inlined
def _place_in_cell(goal, rest, fall, chance):
    """Return the place of a column in its cell, -0.5 at the high side to 0.5 at the deep side, and its height [levels].

    The tool is goal - fall to goal + fall below the top. ``rest``: mean depth of the former surface of the same slope.
    chance, 0 to 1: of the volume between both, the share on the high side of the column.
    """
    began = math.sqrt(min(rest / fall, 1.0))  # part of the cell below the former surface
    before = rest if began >= 1.0 else (2.0 * began - 1.0) * fall
    start, low, full = max(0.5 - 0.5 * goal / fall, 0.0), max(goal - fall, 0.0), goal + (1.0 - 2.0 * began) * fall
    rising = 0.5 * (low + full) * max(1.0 - began - start, 0.0)  # volume where the top was whole
    volume = chance * (rising + max(full, 0.0) * began)
    if volume > rising:
        at = 0.5 - began + (volume - rising) / full
    else:
        at = start - 0.5 + 2.0 * volume / (math.sqrt(low * low + 4.0 * fall * volume) + low + 1e-30)
    return at, max(goal + 2.0 * at * fall - max(before + 2.0 * at * fall, 0.0), 0.0)


@inlined
def _sort_column(s, p, step, frame, share, column, lost):
    """Add the levels that a column loses to the bins.

    column: place and lower end from the tip at the end of the step, height [m], and where its slices are seen, 0 to 1.
    """
    x, y, z, height, within = column
    shape, bins, last, levels = p.profile, p.widths.size, p.profile.pieces.shape[0] - 1, 1.0 / p.level_step
    back = 1.0 - share
    end_x, end_y, end_z = x + back * step[0], y + back * step[1], z + back * step[2]  # from the tip where it is lowest
    m = step[0] * frame[0] + step[1] * frame[1] + step[2] * frame[2]
    side = step[0] * frame[3] + step[1] * frame[4] + step[2] * frame[5]
    sink = step[0] * frame[6] + step[1] * frame[7] + step[2] * frame[8]
    most = 8 if p.end_radius > 0.0 else 2  # slices of a column as high as the radius
    count = 1 + min(int(most * math.sqrt(height / p.radius)), 1000)
    thin = height / (count * count)
    entry = ENTRIES / p.radius
    slant = end_x * step[6] + end_y * step[7]
    at = (end_z + height) * step[8] + slant
    leaves = False
    if at > 0.0 and slant < at * step[14] * step[14]:
        square = end_x * end_x + end_y * end_y + (end_z + height) * (end_z + height) - at * at
        radius = _radius_at(p.profile.parts, at)
        leaves = square > radius * radius
    first_h = end_x * frame[6] + end_y * frame[7] + end_z * frame[8]
    first_1 = end_x * frame[0] + end_y * frame[1] + end_z * frame[2]
    first_2 = end_x * frame[3] + end_y * frame[4] + end_z * frame[5]
    b, level = np.int64(-1), abs(sink) < 1e-6 * m and abs(side) < 1e-6 * m
    for n in range(count):
        up, each = (n * n + (2 * n + 1) * within) * thin, (2 * n + 1) * lost / (count * count)  # from n^2 to (n + 1)^2
        beyond, at = False, (end_z + up) * step[8] + slant
        if leaves:
            square = end_x * end_x + end_y * end_y + (end_z + up) * (end_z + up) - at * at
            radius = _radius_at(p.profile.parts, at)
            beyond = at > 0.0 and square > radius * radius and slant < at * step[14] * step[14]
        before = 0.5 * share  # of the lowest place
        end_1, end_2, end_h = first_1 + up * frame[2], first_2 + up * frame[5], first_h + up * frame[8]
        # steps to the moment at which the tool meets a slice
        for left in range(2, -1, -1):
            e1, e2, h = end_1 + before * m, end_2 + before * side, end_h + before * sink
            rho = math.sqrt(e1 * e1 + e2 * e2) + 1e-15
            across = e2 / rho
            if b < 0:
                b = np.int64(shape.piece[min(np.int64(rho * entry), ENTRIES)])
            if not (level or beyond):
                while b < last and _above(shape, b, rho, h * levels, p.level_step):
                    b += 1
                while b > 0 and not _above(shape, b - 1, rho, h * levels, p.level_step):
                    b -= 1
            steep = level or beyond or (shape.pieces[b, COSINE_K] < 0.3 and abs(sink) < m)
            if steep:  # a height and its e2 meet the circle at this height
                h = max(h, 0.0)
                while b < last and h * levels >= shape.edges[b + 1]:
                    b += 1
                while b > 0 and h * levels < shape.edges[b]:
                    b -= 1
                radius = _radius_at(p.profile.parts, h) + 1e-15
                across = min(max(e2 / radius, -1.0), 1.0)
            # above the end at the start: the side left it in a cell of its rim
            if left == 0 and end_h + share * sink > 2.0 * p.level_step and shape.edges[b] < 0.5:
                while b < last and shape.pieces[b, SINE_K] < FLAT:
                    b += 1
            piece = shape.pieces[b]
            if beyond or left == 0 or level or (not steep and piece[BEND] > 0.0 and piece[COSINE_K] < 0.9):
                break
            if steep:
                now = (radius * math.sqrt(1.0 - across * across) - end_1) / m
            else:
                gap = (rho - shape.rims[b]) * piece[SINE_K] - (h - shape.edges[b] * p.level_step) * piece[COSINE_K]
                speed = (m * e1 + side * e2) / rho * piece[SINE_K] - sink * piece[COSINE_K]
                now = before - gap / max(speed, 1e-15)
            before = min(max(now, 0.0), share)
        if beyond and (e1 <= 0.0 or abs(e2) >= radius):
            s.floats[UNDERCUT] += each * p.level_step
            continue
        angle = np.int64(p.front[np.int64(BEYOND + 0.5 * SINES * (1.0 + across))])
        if e1 < 0.0 and not level:
            angle += bins
        s.edge.lost[angle, b, 1] += each
        s.edge.lost[angle, b, 0] += each * math.sqrt(max(1.0 - across * across, 0.0))
        if b == last:
            s.edge.raised[angle] += each * h * levels


@inlined
def _above(shape, b, rho, level, level_step):
    """Return whether a place at a distance [m] from the axis and a level above the tip is beyond the piece b."""
    up = (level - shape.edges[b + 1]) * level_step
    return (rho - shape.rims[b + 1]) * shape.pieces[b, COSINE_K] + up * shape.pieces[b, SINE_K] > 0.0
