"""The mean force of a cutter of revolution with an upright axis: ball, bull nose, taper, and any profile that widens.

State, lag, rise and undo are those of ``engagement``; this is the part of a step for a tool whose end is not flat. A
node at the distance rho from the axis is lowered to the height zeta(rho) of the profile above the tip. Where the axis
passes beside the node within the step, it is lowered to the lowest place of the tool on its straight way. The volume
that a column loses is sorted by its place on the tool: its angle phi from the direction of the move, seen from the
middle of the way that cuts the column, and the piece of the edge at its height. With the normal n of ``profile``, the
move d of the tip, P passes of a tooth, N teeth and the mean < > over a bin:

    share = dV / (<r (d.n)+> dphi dsigma)                  part of the bin that cuts: the volume is conserved
    h = <(d.n)+> / P                                       mean chip thickness normal to the edge
    F = N / (2 pi) sum [F_t(h) (-t) + F_r(h) (-n) + F_a(h) b] share dphi dsigma

F_t, F_r, F_a per length of the edge, t the direction of the tooth, b along the edge towards the tip. The lever of the
torque is <r (d.n)> / <d.n>; with F_t = K h the torque times the speed is therefore K dV/dt for every shape.

A cell that the rim covers in part has the height of the middle of its covered part. Above the height that the rim had
there before the step, only the rest of the cell is left. The rim of a sinking tool leaves a node with its middle.

A tilted tool also sums dV cos(phi) of each bin. The edge within a bin changes as a line of d.n, whose slope follows
from the mean d.n of the volume; with v the variance of d.n over a bin, the mean of the edge is that of a chip

    <d.n> of the edge = (<d.n>^2 - v) / (2 <d.n> - <d.n> of the volume)

and the force is that of two chips, <d.n> -+ sqrt(v), each with its share of the edge: the volume is conserved.

Where no piece of an angle moves into the material, its volume has the chip of the whole move and so little edge. A bin
that loses more than MOST of its volume lies beside the line d.n = 0, where nodes fall into a wrong bin, or below
a flat end that sank by a level of the map at once. Its chip is then thicker, and the volume stays.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.compiled import inlined
from kr270_milling.physics.cutting.engagement import (
    BEYOND,
    CONTACT,
    FLOOR_LEVEL,
    FLOOR_NEAR,
    LOG_LOST,
    RIM,
    SINES,
    layer_force,
    outside,
    remember,
    take_tile,
)
from kr270_milling.physics.cutting.force_law import forces_at
from kr270_milling.physics.cutting.grid import LEVELS
from kr270_milling.physics.cutting.profile import (
    BEND,
    COSINE_K,
    COSINE_R,
    ENTRIES,
    HEIGHT,
    LENGTH,
    LEVEL,
    LEVER,
    RUN,
    SINE_K,
    SINE_R,
)
from kr270_milling.physics.cutting.state import LEVEL_SUM, LOGGED, NODES_CUT

# Rows of ``EdgeBins.work``, a number for each node of a run
GOAL = 0  # level of the tool; below 0: the node stays
PART = RUN  # covered part of the cell
SHARE = 2 * RUN  # of the step, after which the tool is lowest
LOST = 3 * RUN  # levels that the cell loses
REST = 4 * RUN  # level before of what the tool had not covered
ALONG, BESIDE, AT, SINE, FAR, END, COVER, START = (RUN * k for k in range(5, 13))  # further rows of ``EdgeBins.work``
ONE = np.uint64(1)
MOST = 2.0  # share of a bin; the nodes of the map scatter it about 1


@inlined
def lower_nodes(s, p, base, first):
    """Lower the nodes of the run from ``first`` to GOAL, log what they were, and fill LOST and REST."""
    work, none, zero, one, half = s.edge.work, np.int32(0), np.float32(0), np.float32(1), np.float32(0.5)
    total, new, least, start = np.int32(0), np.int32(0), np.int32(LEVELS), np.uint64(base + first)
    logged = s.ints[LOGGED]
    s.ints[LOGGED] = LOG_LOST
    if logged + RUN < s.log_place.size:
        for n in range(RUN):
            k, place = np.uint64(logged + n), start + np.uint64(n)
            s.log_place[k], s.log_level[k], s.log_rest[k] = place, s.pool[place], s.rest[place]
        s.ints[LOGGED] = logged + RUN
    for n in range(RUN):  # numbers are cut to 32 bits at once: more of them fit a register
        place = start + np.uint64(n)
        before, rest, part, goal = np.int32(s.pool[place]), np.int32(s.rest[place]), work[PART + n], work[GOAL + n]
        height, whole = goal - np.float32(rest), part >= one
        after = np.int32(goal + half) if whole else np.int32(rest + np.int32(part * height + half))
        lost = max(np.int32(after - before), none) if height > zero else none
        level = np.int32(before + lost)
        s.pool[place] = np.uint16(level)
        s.rest[place] = np.uint16(after if whole and lost > none else rest)
        work[LOST + n], work[REST + n] = np.float32(lost), np.float32(rest)
        total, least = np.int32(total + lost), min(least, level)
        new = np.int32(new + np.int32(before == none and lost > none))
    s.ints[NODES_CUT] += new
    s.floats[LEVEL_SUM] += total * p.level_step
    s.edge.highest[start // np.uint64(RUN)] = least


@inlined
def lower_upright(s, p, x0, y0, z0, x1, y1, z1, passes):
    """Lower the nodes on a straight move of at most a quarter of the radius; return motion, frame and ``used``."""
    deepest, levels = p.top - min(z0, z1), 1.0 / p.level_step
    dx, dy, sinks = x1 - x0, y1 - y0, (z0 - z1) * levels
    m = math.sqrt(dx * dx + dy * dy)
    ahead_x, ahead_y = (dx / m, dy / m) if m > 0.0 else (1.0, 0.0)
    behind = s.ints[FLOOR_LEVEL] < 0 or sinks > 0.0 or m == 0.0  # a tool that does not sink cuts nothing behind
    highest = p.profile.pieces.shape[0] - 1
    while highest > 0 and p.profile.edges[highest] >= deepest * levels:
        highest -= 1
    lowest = np.uint64(p.profile.pieces.shape[0])
    if deepest <= 1e-3 * p.level_step or outside(p, x1, y1):
        remember(s, x1, y1, np.int64(0))
    else:
        depth = (p.top - z0) * levels
        lowest = _lower(s, p, x0, y0, m / p.spacing, ahead_x, ahead_y, depth, sinks, behind, highest, passes)
        remember(s, x1, y1, np.int64(max((p.top - z1) * levels, 0.0)))
    angles = 2 * p.widths.size if behind or sinks < 0.0 else p.widths.size
    frame = (ahead_x, ahead_y, 0.0, -ahead_y, ahead_x, 0.0, 0.0, 0.0, 1.0)
    return (m, 0.0, z1 - z0, 0.0, 0.0), frame, (angles, np.int64(lowest), highest)


@inlined
def _lower(s, p, x0, y0, m, ahead_x, ahead_y, below, sinks, behind, highest, passes):
    """Lower the nodes that the tool reaches on its way of m nodes from (x0, y0), ``below`` the top [levels].

    sinks: depth at the end beyond that at the start [levels]; behind: nodes behind the start may be lowered too;
    highest: piece above which the tool is above the top of the stock.
    """
    scale, levels = 1.0 / p.spacing, 1.0 / p.level_step
    u0, v0, r = (x0 - p.origin_x) * scale, (y0 - p.origin_y) * scale, p.radius * scale
    u1, v1 = u0 + m * ahead_x, v0 + m * ahead_y
    entry, most = ENTRIES / r, max(below, below + sinks)
    slope = -sinks / m if m > 1e-6 else 0.0  # rise of the tip [levels a node]
    inverse = 1.0 / m if m > 1e-6 else 0.0
    runs, count, wide = s.edge.runs, 0, p.profile.rims[min(highest + 1, p.profile.rims.size - 1)] * scale
    wide = wide if wide < r else r + RIM
    rims = p.profile.height[int((r - RIM) * entry)] < most
    start, stop = min(u0, u1) - wide, max(u0, u1) + wide
    if not behind and abs(ahead_y) < 1e-9:
        start, stop = (max(start, u0), stop) if ahead_x > 0.0 else (start, min(stop, u0))
    for i in range(max(int(math.ceil(start)), 0), min(int(math.floor(stop)), p.nx - 1) + 1):
        a, b = i - u0, i - u1
        near = min(abs(a), abs(b)) if a * b > 0.0 else 0.0
        half = math.sqrt(max(wide * wide - near * near, 0.0))
        start, stop = min(v0, v1) - half, max(v0, v1) + half
        if not behind and abs(ahead_y) >= 1e-9:  # what is ahead
            side = v0 - a * ahead_x / ahead_y
            start, stop = (max(start, side), stop) if ahead_y > 0.0 else (start, min(stop, side))
        low, high = max(int(math.ceil(start)), 0), min(int(math.floor(stop)), p.ny - 1)
        first = low & ~(RUN - 1)
        while first <= high:
            j, first = max(first, low), first + RUN
            end = min(first - 1, high)
            middle = first - 0.5 * (RUN + 1) - v0
            along, beside = a * ahead_x + middle * ahead_y, a * ahead_y - middle * ahead_x
            beyond = along - min(max(along, 0.0), m)
            nearest = math.sqrt(beside * beside + beyond * beyond) - 0.5 * (RUN - 1)
            if nearest > wide:
                continue
            goal = most - p.profile.height[min(int(max(nearest, 0.0) * entry), ENTRIES)]
            slot = s.table[i >> 8, j >> 8]
            if goal < 0.5:
                continue
            if slot < 0:
                slot = take_tile(s, i, j)
                if slot < 0:
                    return np.uint64(0)
            place = ((np.int64(slot) << 16) | ((i & 255) << 8)) - (j & ~255)
            run = np.uint64((place + j) // RUN)
            if goal < s.edge.highest[run] + 0.5:
                continue
            beyond = max(abs(along), abs(along - m))
            rim = rims and math.sqrt(beside * beside + beyond * beyond) + 0.5 * (RUN - 1) > r - RIM
            for k, number in enumerate((i, j, end, place, np.int64(rim), int(nearest))):
                runs[count, k] = number
            count += 1
    # after the choice of all runs: a processor that guesses a branch of the bins wrong then waits less
    step = (m, ahead_x, ahead_y, below, sinks, behind, slope, inverse, r, entry, p.spacing * levels)
    lowest = np.uint64(p.profile.pieces.shape[0])
    for k in range(count):
        lowest = min(lowest, _run(s, p, runs[k], u0, v0, step, passes))
    return lowest


@inlined
def _run(s, p, run, u0, v0, step, passes):
    """Lower the nodes of one run, add what they lose to their bins, and return the lowest piece of these.

    run: i, first and last j, place of j = 0 in the pool, whether the rim is near, distance to the way [nodes].
    The loops over all nodes of the run have no branches, so that they become vector instructions.
    """
    m, ahead_x, ahead_y, below, sinks, behind, slope, inverse, r, entry, size = step
    i, low, high, base, rim, nearest = run[0], run[1], run[2], run[3], run[4] > 0, run[5]
    a = i - u0
    shape, edges, work, index, first = p.profile, s.edge, s.edge.work, s.edge.entries, low & ~(RUN - 1)
    zero, one, half, tiny = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e-9)
    most, deepest, table = np.float32(ENTRIES), np.float32(LEVELS), np.float32(SINES + 2 * BEYOND)
    a_, v_, m_, x_, y_ = np.float32(a), np.float32(first - v0), np.float32(m), np.float32(ahead_x), np.float32(ahead_y)
    inverse_, entry_, r_ = np.float32(inverse), np.float32(entry), np.float32(r)
    below_, sinks_ = np.float32(below), np.float32(sinks)
    outer, sines, beyond = np.float32((r - RIM) * (r - RIM)), np.float32(0.5 * SINES), np.float32(BEYOND + 0.5 * SINES)
    moves = inverse > 0.0
    whole, side = (zero, most) if moves else (one, most - one)  # a way straight down has no side
    still, reach = not moves, np.float32(r * r) if moves and behind else np.float32(np.inf)
    for n in range(RUN):
        v = v_ + np.float32(n)
        along = a_ * x_ + v * y_
        work[ALONG + n] = along
        work[BESIDE + n] = v * x_ - a_ * y_
        work[SHARE + n] = min(max(along * inverse_, whole), one)
    if slope != 0.0:
        for n in range(low - first, high - first + 1):
            bar = s.rest[np.uint64(base + first + n)] + 0.5
            work[SHARE + n] = _ramp_share(
                p, work[ALONG + n], work[BESIDE + n], m, slope, inverse, r, entry, below, sinks, bar
            )
    for n in range(RUN):
        along, beside, gone = work[ALONG + n], work[BESIDE + n], work[SHARE + n] * m_
        away, middle = along - gone, along - half * gone
        work[AT + n] = min(math.sqrt(away * away + beside * beside) * entry_, most)
        # seen from the middle of the way on which the tool cuts this column
        sine = beyond + sines * (beside / (math.sqrt(middle * middle + beside * beside) + tiny))
        work[SINE + n] = sine if middle >= zero else sine + table
        far = along * along + beside * beside
        work[FAR + n] = min(math.sqrt(far) * entry_ if far < outer else most, side if middle >= zero else most - one)
        work[PART + n] = one
    if rim:
        for n in range(RUN):
            along, beside, gone = work[ALONG + n], work[BESIDE + n], work[SHARE + n] * m_
            away = math.sqrt((along - gone) * (along - gone) + beside * beside)
            gone = min(max(along, zero), m_)  # at the nearest; what the tool leaves it has covered
            sides = abs(a_ - gone * x_) + abs(v_ + np.float32(n) - gone * y_)
            square = (along - gone) * (along - gone) + beside * beside
            part = min(max(half * (r_ * r_ - square) / sides + half, zero), one)
            part = part if square > outer and (along > zero or still) else one
            work[PART + n] = part
            work[AT + n] = min((away - half * (one - part) * sides / (away + tiny)) * entry_, most)
            far = along * along + beside * beside
            sides, away = abs(a_) + abs(v_ + np.float32(n)), math.sqrt(far)
            part = min(max(half * (r_ * r_ - far) / sides + half, zero), one)
            work[START + n] = min((away - half * (one - part) * sides / (away + tiny)) * entry_, most)
            work[COVER + n] = part if far > outer and along > zero else zero
        # a literal row and no ``np.int64``, whose one copy for both rows makes a slot 15 % slower
        _heights(shape, work, START, nearest, nearest + RUN + m, size, r)
        for n in range(RUN):
            work[START + n] = work[GOAL + n] + half * work[SHARE + n] * sinks_
    _heights(shape, work, AT, nearest, nearest + RUN, size, r)
    begin, stop = np.float32(low - first) - half, np.float32(high - first) + half
    for n in range(RUN):
        goal = min(below_ + work[SHARE + n] * sinks_ - work[GOAL + n], deepest)
        along, beside = work[ALONG + n], work[BESIDE + n]
        meets = along > zero or (behind and along * along + beside * beside < reach)
        work[GOAL + n] = goal if meets and np.float32(n) > begin and np.float32(n) < stop else -one
    lower_nodes(s, p, base, first)
    if passes == 0.0:  # no force, no bins
        return np.uint64(shape.pieces.shape[0])
    for n in range(RUN):
        level = below_ + half * work[SHARE + n] * sinks_
        work[END + n], work[GOAL + n] = level - work[REST + n], level - work[GOAL + n]
        at, far = min(work[AT + n], max(work[FAR + n], most - one)), work[FAR + n]
        index[AT + n], index[FAR + n] = np.int32(min(at, far)), np.int32(max(at, far))
        index[SINE + n] = np.int32(work[SINE + n])
    lowest = np.uint64(shape.pieces.shape[0])
    for n in range(RUN):
        lost = np.float64(work[LOST + n])
        if lost == 0.0:
            continue
        angle = p.front[np.uint32(index[SINE + n])]
        b, top = np.uint64(shape.piece[np.uint32(index[AT + n])]), np.uint64(shape.piece[np.uint32(index[FAR + n])])
        z, end = np.float64(work[GOAL + n]), np.float64(work[END + n])
        while b < top and shape.edges[b + ONE] <= z:
            b += ONE
        while b < top and shape.edges[top] >= end:
            top -= ONE
        lowest = min(lowest, b)
        if rim and work[COVER + n] > zero:  # above the height at which the rim covered a part before, less is left
            left = max(1.0 - np.float64(work[COVER + n] / work[PART + n]), 1e-3)
            bend = min(max(np.float64(work[START + n]), z), end)
            each = lost / (bend - z + left * (end - bend))
            middle = b
            while middle < top and shape.edges[middle + ONE] <= bend:
                middle += ONE
            _fill(shape, edges, angle, middle, top, bend, end, each * left)
            end, top = bend, middle
        else:
            each = lost / (end - z)
        _fill(shape, edges, angle, b, top, z, end, each)
    return lowest


@inlined
def _heights(shape, work, row, near, far, size, r):
    """Fill GOAL with the heights of the profile at a row of distances from the axis [entries], near to far [nodes].

    size: levels of a node; r: radius [nodes].
    """
    near_, far_, scale = np.float32((near - 1) * size), np.float32(far * size), np.float32(r * size / ENTRIES)
    for k in range(shape.curves.shape[0]):
        curve = shape.curves[k]
        start, bottom, corner, slope = curve[0], curve[1], curve[3], curve[4]
        if start <= far_ and curve[2] >= near_:
            for n in range(RUN):
                out = work[row + n] * scale - start
                up = bottom + slope * out + corner - math.sqrt(max((corner - out) * (corner + out), np.float32(0)))
                work[GOAL + n] = up if out >= np.float32(0) else work[GOAL + n]


@inlined
def _fill(shape, edges, angle, b, top, z, end, each):
    """Add ``each`` level of a column from z to ``end`` [levels] to the pieces b to ``top`` of an angle."""
    low, high = edges.lost[angle, b], edges.lost[angle, top]
    low[0] += each  # no branch: the force adds what lies between both pieces
    low[1] -= each * z
    high[0] -= each
    high[1] += each * end
    if top == np.uint64(shape.pieces.shape[0] - 1):
        start = max(z, shape.edges[top])
        edges.raised[angle] += each * (end - start) * 0.5 * (end + start)


@inlined
def _ramp_share(p, along, beside, m, slope, inverse, r, entry, below, sinks, bar):
    """Return the share of a step that sinks or rises after which the tool is deepest above a node."""
    share = 1.0
    if along < m + r:
        lead = slope * p.profile.lead[min(np.int64(abs(beside) * entry), ENTRIES)]
        if lead > 0.5 * r:  # over a flat end that rises
            near = along - min(max(along, 0.0), m)
            k = min(np.int64(math.sqrt(near * near + beside * beside) * entry), ENTRIES)
            if max(below, below + sinks) - p.profile.height[k] < bar:
                return 1.0
            lead = _lead(p, slope, beside, r, entry)
        share = min(max((along - lead) * inverse, 0.0), 1.0)
    away, outer = along - share * m, (r - RIM) * (r - RIM)
    if away * away + beside * beside > outer:  # deepest where the rim comes to cover the node, or leaves it
        half = math.sqrt(max(r * r - beside * beside, 0.0))
        share = min(max(share, (along - half) * inverse), max((along + half) * inverse, 0.0), 1.0)
    return share


@inlined
def _lead(p, slope, beside, r, entry):
    """Return how far ahead of the axis a ramp cuts deepest, at a distance ``beside`` its line [nodes]."""
    low, high = 0.0, math.sqrt(max(r * r - beside * beside, 0.0))
    for _ in range(8):
        middle = 0.5 * (low + high)
        k = min(np.int64(math.sqrt(middle * middle + beside * beside) * entry), ENTRIES)
        if middle < slope * p.profile.lead[k]:
            low = middle
        else:
            high = middle
    return high


@inlined
def edge_load(s, p, motion, frame, passes, used, tilted, wrench):
    """Add the mean wrench of the removed bins; returns mean torque, height above the tip and thrust of the flat end.

    motion: of the tip along e1, e2 and a [m], rotation about e1 and e2 [rad]; frame: e1, e2 and a, nine numbers;
    used: angles, lowest and highest piece of the bins that may have lost something, which are emptied.
    """
    m, side, dz, turn_1, turn_2 = motion
    shape, cell, each = p.profile, p.spacing * p.spacing * p.level_step, 1.0 / passes
    teeth, bins, last = p.teeth / (2.0 * math.pi), p.widths.size, shape.pieces.shape[0] - 1
    size = math.sqrt(m * m + side * side + dz * dz) + p.radius * math.sqrt(turn_1 * turn_1 + turn_2 * turn_2)
    local_x = local_y = force_z = moment_x = moment_y = torque = total = raised = thrust = contact = 0.0
    angles, lowest, highest = used
    for k in range(angles):
        q, ahead = (k, 1.0) if k < bins else (k - bins, -1.0)
        width, c, d = p.widths[q], ahead * p.directions[q, 0], p.directions[q, 1]
        mean_c = ahead * p.cosines[q] / width
        mean_d = d * p.cosines[q] / (width * p.directions[q, 0])
        forward, turning, left = m * mean_c + side * mean_d, turn_2 * mean_c - turn_1 * mean_d, 0.0
        spread_c = 0.5 + 0.5 * (c * c - d * d) * math.sin(width) / width - mean_c * mean_c  # variance of cos(phi)
        left_c = through = 0.0
        push = pull = rise = lift = sway = push_high = pull_high = 0.0  # of the angle: out, across it, up, moments
        own, changes = np.uint64(0), (forward > 0.0) != (dz <= 0.0)
        for n in range(lowest if k < bins else last - highest, last + 1):
            if n > highest and k < bins and left == 0.0:
                break
            b = np.uint64(n if k < bins else last - n)
            here = s.edge.lost[k, b]
            volume_c, lost_here = here[0], here[1]
            here[0] = here[1] = 0.0
            volume = lost_here + left
            if not tilted:
                volume += volume_c * shape.edges[b]
                through += volume_c if k < bins else 0.0
                if b < np.uint64(last) and through > 1e-9:
                    volume += through * (shape.edges[b + ONE] - shape.edges[b])
                through -= 0.0 if k < bins else volume_c
                volume_c = 0.0
            volume_c += left_c
            if volume <= 1e-9:  # [levels], or rounding
                continue
            if volume > left:
                own = b
            piece = shape.pieces[b]
            sine, cosine, lever, room = piece[SINE_K], piece[COSINE_K], piece[LEVER], width * piece[LENGTH]
            middle = piece[HEIGHT]
            if b == np.uint64(last) and volume > left:
                middle = s.edge.raised[k] / (volume - left) * p.level_step
            swing = turning * (middle * sine + piece[COSINE_R])
            normal = forward * sine - dz * cosine + swing
            area = forward * piece[SINE_R] - dz * piece[COSINE_R] + swing * lever
            crossed, amount = False, volume * cell
            if changes:
                spread = 0.5 * width * abs(m * d) * sine + piece[BEND] * abs(forward * cosine + dz * sine)
                crossed = normal < spread
                if crossed:  # d.n changes its sign within the bin
                    room *= 0.5 * (normal + spread) / max(spread, 1e-12)
                    normal = 0.5 * (normal + spread)
                    area = normal * lever
            lost = not area > 0.0 or not room > 0.0  # the next piece, with more d.n, has lost this volume
            if lost and n < last:
                left, left_c = volume, volume_c
                continue
            if lost:  # no piece moves into the material at this angle: nodes beside the line d.n = 0
                b = own
                piece = shape.pieces[b]
                sine, cosine, lever, room = piece[SINE_K], piece[COSINE_K], piece[LEVER], width * piece[LENGTH]
                normal = max(size, amount / (room * lever))
                area = normal * lever
            left = left_c = 0.0
            points, skew, spread, thinner = 1, 0.0, 0.0, 1.0
            if not lost and not crossed and volume_c > 0.0 and m * sine > 0.0:
                spread = min(m * sine * math.sqrt(spread_c), 0.9 * normal)
                own_c = m * sine * (ahead * volume_c / volume - mean_c)
                skew = (normal * normal - spread * spread) / max(normal - own_c, 0.1 * normal) - normal
                skew = min(max(skew / spread, -1.0), 1.0)
                thinner = normal / (normal + skew * spread)
                points = 2 if spread > 0.05 * normal else 1
            # a volume beside d.n = 0 had up to 70 m of edge; of a flank, the height that counts is its radius
            most = MOST * room if crossed else 50.0 * min(room, width * p.radius)
            length, arm = amount / area, area / normal
            if length > most:
                normal, spread, length = normal * length / most, spread * length / most, most
            whole = teeth * length * thinner
            for point in range(points):
                place, weight = (2.0 * point - 1.0, 0.5 + (point - 0.5) * skew) if points == 2 else (skew, 1.0)
                edge, h = whole * weight, (normal + place * spread) * each
                if cosine > 1.0 - LEVEL:
                    f_t, f_r = layer_force(p, h)
                    f_a = 0.0
                    contact += edge
                    thrust += f_r * edge
                else:
                    f_t, f_r, f_a = forces_at(p.law, h)
                out, up = -f_r * sine - f_a * cosine, f_r * cosine - f_a * sine
                x, y, z = edge * out, p.sense * edge * f_t, edge * up
                torque += f_t * edge * arm
                lever_z = lever * z
                if points == 2:  # turned from the direction of the chip to that of the bin
                    chip_c = mean_c + ahead * place * math.sqrt(spread_c)
                    chip_d = math.copysign(math.sqrt(1.0 - chip_c * chip_c), d)
                    turn_c, turn_d = c * chip_c + d * chip_d, c * chip_d - d * chip_c
                    x, y, sway = x * turn_c + y * turn_d, y * turn_c - x * turn_d, sway + lever_z * turn_d
                    lever_z *= turn_c
                push, pull, rise, lift = push + x, pull + y, rise + z, lift + lever_z
                push_high, pull_high = push_high + middle * x, pull_high + middle * y
            total, raised = total + volume, raised + volume * middle
        local_x, local_y, force_z = local_x + push * c + pull * d, local_y + push * d - pull * c, force_z + rise
        moment_x += lift * d + sway * c - push_high * d + pull_high * c
        moment_y += push_high * c + pull_high * d - lift * c + sway * d
        s.edge.raised[k] = 0.0
    if s.ints[FLOOR_LEVEL] > s.ints[FLOOR_NEAR]:
        s.floats[CONTACT] = max(contact, 0.9 * s.floats[CONTACT])
    for j in range(3):
        wrench[j] += frame[j] * local_x + frame[3 + j] * local_y + frame[6 + j] * force_z
    if p.moments:
        for j in range(3):
            wrench[3 + j] += frame[j] * moment_x + frame[3 + j] * moment_y - p.sense * torque * frame[6 + j]
    return torque, raised / total if total > 0.0 else 0.0, thrust
