"""Removal of material by a cutter of revolution with a tilted axis; forces and bins are those of ``revolution``.

The axis a points from the tip to the holder: sine s and cosine c of its tilt, in the vertical plane of u. The vertical
line through a node at (u, v) from the tip meets the plane at the height zeta of the axis at the distance rho from it:

    rho^2 = v^2 + (u - zeta s)^2 / c^2,   z = (zeta - u s) / c

The lowest point of the tool is the smallest zeta with rho <= r(zeta). For each line and arc of the profile, this is the
root of a quadratic; the torus of a corner takes some Newton steps, which approach the root from below.

In a step a node is lowered to the lowest point that the tool has there on its way. The height falls with the rate
(d.n) / n_z, d the move of that point of the tool and n its normal. As the height is convex, its least value lies where
the rate changes its sign. The volume that a column loses is divided into slices, the thinnest at its lower end. Each is
sorted by its angle phi and its piece of the edge, seen from the middle of the way that cuts the column. Beside a level
end d.n falls to zero within a step: there a slice is seen from the place where the tool meets it.

A column of the map also loses the material above a leaning flank. Where the tool meets this material on its way ahead,
its force counts now. Where the tool has passed it, it has no force, and is counted as ``UNDERCUT``.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.physics.cutting.compiled import compiled, inlined
from kr270_milling.physics.cutting.engagement import BEYOND, LOG_LOST, RIM, SINES, take_tile
from kr270_milling.physics.cutting.grid import LEVELS
from kr270_milling.physics.cutting.profile import ENTRIES, RUN
from kr270_milling.physics.cutting.state import LEVEL_SUM, LOGGED, NODES_CUT, UNDERCUT

MISSED = math.inf  # height of a tool that does not cover a node
SLICES = 40  # of a column as high as the radius; 20 leave 1 % beside a corner of R/5, 40 and 80 less than 0.2 %
NEWTON = 2  # steps to the moment at which the tool meets a slice
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
    return sine * x * c / rho - cosine * s, sine * v / rho, -sine * x * s / rho - cosine * c


@compiled
def touch(parts, u, v, s, c):
    """Return the lowest point of the tool at (u, v) from its tip and its outward normal along u, v, z; or MISSED."""
    for k in range(parts.shape[0]):
        r0, z0, r1, z1, corner = parts[k, 0], parts[k, 1], parts[k, 2], parts[k, 3], parts[k, 4]
        if corner > 0.0 and r0 < FLAT:  # a sphere
            middle = z0 + corner
            x = u - middle * s
            square = corner * corner - x * x - v * v
            if square < 0.0:
                continue
            root = math.sqrt(square)
            z = middle * c - root
            if u * s + z * c <= z1:
                return z, x / corner, v / corner, -root / corner
        elif corner > 0.0:  # a torus
            h, middle = z0, z0 + corner
            touches = False
            x = rho = out = far = 1.0
            for _ in range(12):
                x = (u - h * s) / c
                rho = math.sqrt(x * x + v * v) + 1e-15
                out = max(rho - r0, 0.0)
                far = math.sqrt(out * out + (middle - h) * (middle - h))
                slope = (-out * x * s / (c * rho) - (middle - h)) / far
                if far - corner <= 2e-9:  # [m]
                    touches = True
                    break
                if slope >= 0.0:
                    break
                h -= (far - corner) / slope
                if h > z1 + FLAT:
                    break
            if touches:
                return (h - u * s) / c, *_normal(x, v, rho, out / corner, (middle - h) / corner, s, c)
        elif parts[k, 5] < FLAT:  # level: the end, or a ledge
            x = (u - z0 * s) / c
            square = x * x + v * v
            if r0 * r0 <= square <= r1 * r1:
                return (z0 - u * s) / c, -s, 0.0, -c
        else:  # a cone or a cylinder
            sine, cosine = parts[k, 5], parts[k, 6]
            rise = cosine / sine
            base = r0 - z0 * rise
            a = s * s / (c * c) - rise * rise
            b = u * s / (c * c) + base * rise
            square = b * b - a * (v * v + u * u / (c * c) - base * base)
            if square < 0.0:
                continue
            h = (v * v + u * u / (c * c) - base * base) / (b + math.sqrt(square))
            if z0 <= h <= z1:
                x, rho = (u - h * s) / c, base + rise * h + 1e-15
                return (h - u * s) / c, *_normal(x, v, rho, sine, cosine, s, c)
    return MISSED, 0.0, 0.0, -1.0


@compiled
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


@compiled
def inside(parts, u, v, s, c):
    """Return how far a node is inside the shadow of the tool [m], and the direction out of it along u and v."""
    best, best_u, best_v = -1e9, 1.0, 0.0
    for k in range(parts.shape[0]):
        corner, r, h = parts[k, 4], parts[k, 2], parts[k, 3]
        if corner > 0.0:
            r, h = parts[k, 0], parts[k, 1] + corner
        elif parts[k, 5] > FLAT:  # the height at which the line is widest beside the node
            rise = parts[k, 6] / parts[k, 5]
            bend = rise * c / max(s, FLAT)
            if bend < 1.0:
                h = (u + c * bend * abs(v) / math.sqrt(1.0 - bend * bend)) / max(s, FLAT)
                h = min(max(h, parts[k, 1]), parts[k, 3])
                r = parts[k, 0] + rise * (h - parts[k, 1])
        x = (u - h * s) / c
        q = math.sqrt(x * x + v * v) + 1e-15
        slope = math.sqrt(x * x / (c * c) + v * v) / q
        depth, out_u, out_v = (r - q) / slope + corner, x / (c * q * slope), v / (q * slope)
        if depth > best:
            best, best_u, best_v = depth, out_u, out_v
    return best, best_u, best_v


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
def _look(p, step, t, x, y):
    """Return the height of the tool above a node at the share t of the step, its rate over the step and its slope.

    x, y: of the node from the tip at the end of the step [m]; the height is above that tip. The slope is along y.
    """
    dx, dy, dz, wx, wy, wz, ax, ay, az, bx, by, bz, ux, uy, s, c = step
    back = 1.0 - t
    x, y = x + back * dx, y + back * dy
    turning = bx != 0.0 or by != 0.0 or bz != 0.0
    if turning and t < 1.0:
        a, b, e = ax - back * bx, ay - back * by, az - back * bz
        scale = 1.0 / math.sqrt(a * a + b * b + e * e)
        ux, uy, s, c = turned_axis(a * scale, b * scale, e * scale)
    u, v = x * ux + y * uy, y * ux - x * uy
    z, nu, nv, nz = touch(p.profile.parts, u, v, s, c)
    if z == MISSED:
        return z, 0.0, 0.0
    nx, ny = nu * ux - nv * uy, nu * uy + nv * ux
    move = dx * nx + dy * ny + dz * nz
    if turning:
        move += wx * (y * nz - z * ny) + wy * (z * nx - x * nz) + wz * (x * ny - y * nx)
    scale = 1.0 / min(nz, -1e-6)
    return z - back * dz, move * scale, -ny * scale


@inlined
def _behind(p, step, x, y, rim):
    """Return whether a whole cell is below the back of the tool where the step begins: the step does not lower it."""
    z, rate, _ = _look(p, step, 0.0, x, y)
    if z == MISSED or rate < 0.0:
        return False
    x, y, ux, uy = x + step[0], y + step[1], step[12], step[13]
    return inside(p.profile.parts, x * ux + y * uy, y * ux - x * uy, step[14], step[15])[0] > rim


@inlined
def _lowest_on_way(p, step, x, y, last, rate, enough):
    """Return the share of the step at which the tool is lowest above a node, and its height there.

    last, rate: height and rate at the end of the step, where the tool rises; enough: a height that the tool must get
    below.
    """
    first, falls, _ = _look(p, step, 0.0, x, y)
    low, high = 0.0, 1.0
    if first != MISSED and falls >= 0.0:
        return 0.0, first
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
        z, now, _ = _look(p, step, t, x, y)
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
def lower_tilted(s, p, tip, axis_from, axis, move, frame, follows):
    """Lower the nodes that the tool reaches on a step that ends at ``tip`` with ``axis``, and fill the bins.

    tip, axis_from, axis, move: three numbers each; frame: e1, e2 and a in the middle of the step, nine numbers;
    follows: the tool comes from its last place, so that it has cut all that its back covers.
    """
    tip_x, tip_y, tip_z = tip
    ax, ay, az = axis
    dx, dy, dz = move
    ux, uy, sine, cosine = turned_axis(ax, ay, az)
    bx, by, bz = ax - axis_from[0], ay - axis_from[1], az - axis_from[2]
    wx, wy, wz = frame[7] * bz - frame[8] * by, frame[8] * bx - frame[6] * bz, frame[6] * by - frame[7] * bx
    step = (dx, dy, dz, wx, wy, wz, ax, ay, az, bx, by, bz, ux, uy, sine, cosine)
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
        return
    levels, hollow = 1.0 / p.level_step, p.profile.hollow
    most = under * levels
    rim = RIM * p.spacing
    reach = p.radius + rim
    start_u = parts[0, 4] * sine if parts[0, 4] > 0.0 and parts[0, 0] < FLAT else 0.0
    end_u = max(start_u, (p.top - tip_z + p.radius * sine) / cosine * sine)
    low_x, high_x = min(start_u * ux, end_u * ux) - reach, max(start_u * ux, end_u * ux) + reach
    first_i = max(int(math.ceil((tip_x + low_x - p.origin_x) / p.spacing)), 0)
    last_i = min(int(math.floor((tip_x + high_x - p.origin_x) / p.spacing)), p.nx - 1)
    shift_y = tip_y - p.origin_y
    for i in range(first_i, last_i + 1):
        x = p.origin_x + i * p.spacing - tip_x
        low_y, high_y = shadow_rows(x, start_u, end_u, ux, uy, reach)
        if low_y > high_y:
            continue
        low = max(int(math.ceil((shift_y + low_y) / p.spacing)), 0)
        high = min(int(math.floor((shift_y + high_y) / p.spacing)), p.ny - 1)
        first = low & ~(RUN - 1)
        while first <= high:
            j, first = max(first, low), first + RUN
            end = min(first - 1, high)
            slot = s.table[i >> 8, j >> 8]
            known = 0.0
            if slot >= 0:
                place = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
                known = float(s.edge.highest[np.uint64((place + j) // RUN)])
            if most < known + 0.5:
                continue
            half = 0.5 * (end - j) * p.spacing
            y = (j * p.spacing - shift_y) + half
            z, rate, slope = _look(p, step, 1.0, x, y)
            if hollow:
                z = MISSED  # of no use for the other nodes of the run
            bound = p.top - tip_z - z + max(rate, 0.0)
            if z != MISSED and (bound + abs(slope) * half) * levels < known + 0.5:
                continue
            if follows and z != MISSED and _behind(p, step, x, y - half, rim) and _behind(p, step, x, y + half, rim):
                continue
            if slot < 0:
                slot = take_tile(s, i, j)
                if slot < 0:
                    return
                place = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
            plane = (bound, slope, y) if z != MISSED else (1e9, 0.0, 0.0)
            _lower_run(s, p, step, frame, tip_z, i, j, end, place, x, shift_y, plane)
            run = np.uint64((place + j) // RUN)
            least = np.uint16(LEVELS)
            for n in range(RUN):
                least = min(least, s.pool[run * np.uint64(RUN) + np.uint64(n)])
            s.edge.highest[run] = least


@inlined
def _lower_run(s, p, step, frame, tip_z, i, low, high, base, x, shift_y, plane):
    """Lower the nodes (i, low..high) of one run, and add what they lose to their bins.

    plane: depth of the tangent plane below the top at a place y, its slope and y: no node is lowered further.
    """
    ux, uy, sine, cosine = step[12], step[13], step[14], step[15]
    depth, levels, rim = p.top - tip_z, 1.0 / p.level_step, RIM * p.spacing
    logged, total, new = s.ints[LOGGED], 0, 0
    room = logged + high - low < s.log_place.size
    if not room:
        logged = LOG_LOST
    near = False
    for j in (low, high):
        y = j * p.spacing - shift_y
        within, _, _ = inside(p.profile.parts, x * ux + y * uy, y * ux - x * uy, sine, cosine)
        near = near or within < rim
    for j in range(low, high + 1):
        y, at_x = j * p.spacing - shift_y, x
        place = np.uint64(base + j)
        before, rest = np.int64(s.pool[place]), np.int64(s.rest[place])
        part = 1.0
        if (plane[0] - plane[1] * (y - plane[2])) * levels < rest + 0.5 and not near:
            continue
        if near:
            within, out_u, out_v = inside(p.profile.parts, x * ux + y * uy, y * ux - x * uy, sine, cosine)
            if within < rim:
                out_x, out_y = out_u * ux - out_v * uy, out_u * uy + out_v * ux
                part = min(0.5 + within / (p.spacing * (abs(out_x) + abs(out_y))), 1.0)
                if part <= 0.0:
                    continue
                pull = max(0.02 * p.spacing - within, 0.0)
                at_x, y = x - pull * out_x, y - pull * out_y
        z, rate, _ = _look(p, step, 1.0, at_x, y)
        if z == MISSED:
            continue
        share = 1.0
        if rate > 0.0:
            enough = depth - (rest + 0.5) * p.level_step
            if z - rate > enough:
                continue
            share, z = _lowest_on_way(p, step, at_x, y, z, rate, enough)
        goal = min((depth - z) * levels, float(LEVELS))
        if goal < rest + 0.5:
            continue
        after = np.int64(goal + 0.5) if part >= 1.0 else rest + np.int64(part * (goal - rest) + 0.5)
        if after <= before:
            continue
        if room:
            s.log_place[np.uint64(logged)], s.log_level[np.uint64(logged)] = place, before
            s.log_rest[np.uint64(logged)] = rest
            logged += 1
        s.pool[place] = after
        if part >= 1.0:
            s.rest[place] = after
        lost = after - before
        total += lost
        new += before == 0
        slack = 0.0 if part >= 1.0 else p.spacing
        column = (x, j * p.spacing - shift_y, z, (goal - rest) * p.level_step, slack)
        _sort_column(s, p, step, frame, share, column, lost)
    s.ints[LOGGED] = logged
    s.ints[NODES_CUT] += new
    s.floats[LEVEL_SUM] += total * p.level_step


@inlined
def _sort_column(s, p, step, frame, share, column, lost):
    """Add the levels that a column loses to the bins.

    column: place and lower end from the tip at the end of the step, height, and how far it may be beside the tool [m].
    """
    x, y, z, height, slack = column
    shape, bins, last = p.profile, p.widths.size, p.profile.length.size - 1
    back = 1.0 - share
    end_x, end_y, end_z = x + back * step[0], y + back * step[1], z + back * step[2]  # from the tip where it is lowest
    m = step[0] * frame[0] + step[1] * frame[1] + step[2] * frame[2]
    side = step[0] * frame[3] + step[1] * frame[4] + step[2] * frame[5]
    sink = step[0] * frame[6] + step[1] * frame[7] + step[2] * frame[8]
    count = 1 + min(int(SLICES * math.sqrt(height / p.radius)), 1000)
    thin = height / (count * count)
    entry = ENTRIES / p.radius
    slant = end_x * step[6] + end_y * step[7]
    at = (end_z + height) * step[8] + slant
    leaves = False
    if at > 0.0 and slant < at * step[14] * step[14]:
        square = end_x * end_x + end_y * end_y + (end_z + height) * (end_z + height) - at * at
        wide = _radius_at(p.profile.parts, at) + p.spacing
        leaves = square > wide * wide
    b = np.int64(-1)
    for n in range(count):
        up, each = (n * n + n + 0.5) * thin, (2 * n + 1) * lost / (count * count)  # from n^2 to (n + 1)^2
        beyond, at = False, (end_z + up) * step[8] + slant
        if leaves:
            square = end_x * end_x + end_y * end_y + (end_z + up) * (end_z + up) - at * at
            radius = _radius_at(p.profile.parts, at) + slack
            beyond = at > 0.0 and square > radius * radius and slant < at * step[14] * step[14]
        before = 0.5 * share  # of the lowest place
        for left in range(NEWTON if p.end_radius > 0.0 else 0, -1, -1):
            u, v, w = end_x + before * step[0], end_y + before * step[1], end_z + before * step[2] + up
            h = u * frame[6] + v * frame[7] + w * frame[8]
            e1 = u * frame[0] + v * frame[1] + w * frame[2]
            e2 = u * frame[3] + v * frame[4] + w * frame[5]
            rho = math.sqrt(e1 * e1 + e2 * e2) + 1e-15
            across = e2 / rho
            if beyond:
                across, rho = e2 / radius, radius
            if b < 0:
                b = np.int64(shape.piece[min(np.int64(rho * entry), ENTRIES)])
            while b < last and _above(shape, b, rho, h / p.level_step, p.level_step):
                b += 1
            while b > 0 and not _above(shape, b - 1, rho, h / p.level_step, p.level_step):
                b -= 1
            if left == 0 and h > p.end_radius - rho and shape.sine[b] < FLAT and shape.edges[b] < 0.5:
                while b < last and shape.sine[b] < FLAT:  # nearer to the side, which left it in a cell of its rim
                    b += 1
            if beyond or left == 0:
                break
            gap = (rho - shape.rims[b]) * shape.sine[b] - (h - shape.edges[b] * p.level_step) * shape.cosine[b]
            speed = (m * e1 + side * e2) / rho * shape.sine[b] - sink * shape.cosine[b]
            before = min(max(before - gap / max(speed, 1e-15), 0.0), share)
        if beyond and (e1 <= 0.0 or abs(e2) >= radius):
            s.floats[UNDERCUT] += each * p.level_step
            continue
        angle = np.int64(p.front[np.int64(BEYOND + 0.5 * SINES * (1.0 + across))])
        if e1 < 0.0:
            angle += bins
        s.edge.lost[angle, b] += each
        if b == last:
            s.edge.raised[angle] += each * h / p.level_step


@inlined
def _above(shape, b, rho, level, level_step):
    """Return whether a place at a distance [m] from the axis and a level above the tip is beyond the piece b."""
    up = (level - shape.edges[b + 1]) * level_step
    return (rho - shape.rims[b + 1]) * shape.cosine[b] + up * shape.sine[b] > 0.0
