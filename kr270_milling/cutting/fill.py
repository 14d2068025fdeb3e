"""Clearing of grid nodes: a run of nodes in one column, the sector of one tooth, any quadrilateral (compiled).

Lengths here are in node distances and node (i, j) stands at (i, j). Intervals are closed and SLACK wider than
computed: a node on the line between two sectors belongs to both and is cleared, and counted, by the first.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.cutting.compiled import compiled
from kr270_milling.cutting.state import FAILED, LOG_LOST, LOGGED, TALLIED, TILES

SLACK = 1e-9
VECTOR = 32  # nodes from which on it pays to look first whether anything is left


@compiled
def tally_log(ints, old, tally, level):
    """Add to tally what the log holds since the last call: nodes, sum of level differences; the lowest level."""
    deficit, lowest, new = np.int64(0), np.uint16(level), np.int64(level)
    for n in range(ints[TALLIED], ints[LOGGED]):
        deficit += new - np.int64(old[n])
        lowest = min(lowest, old[n])
    tally[0] += ints[LOGGED] - ints[TALLIED]
    tally[1] += deficit
    tally[2] = min(tally[2], np.int64(lowest))
    ints[TALLIED] = ints[LOGGED]


@compiled
def _clear_column(pool, table, ints, index, old, tally, ix, ja, jb, level):
    """Lower the nodes (ix, ja..jb) to ``level``; those that were higher go into the log with their old level."""
    j = ja
    while j <= jb:
        length = min(jb, j | 255) - j + 1
        slot = table[ix >> 8, j >> 8]
        if slot < 0:
            slot = np.int32(ints[TILES])
            if (np.int64(slot) + 1) << 16 > pool.size:
                ints[FAILED] = 1
                return
            table[ix >> 8, j >> 8] = slot
            ints[TILES] += 1
        start = (np.int64(slot) << 16) | ((ix & 255) << 8) | (j & 255)
        j += length
        if length >= VECTOR and not _any_above(pool, start, length, level):
            continue
        if ints[LOGGED] + length > index.size:
            tally_log(ints, old, tally, level)
            ints[LOGGED] = ints[TALLIED] = 0
            ints[LOG_LOST] = 1
        n, new = ints[LOGGED], np.uint16(level)
        for p in range(start, start + length):
            k = pool[p]
            index[n] = p  # written always, kept only if the node is cleared: no branch
            old[n] = k
            n += k < new
            pool[p] = max(k, new)
        ints[LOGGED] = n


@compiled
def _any_above(pool, start, length, level):
    lowest = pool[start]
    for p in range(start, start + length):
        lowest = min(lowest, pool[p])
    return lowest < level


@compiled
def clear_sector(s, sense, u0, v0, x0, y0, u1, v1, x1, y1, radius, inner, nx, ny, level):
    """Clear what a tooth sweeps outside the radius ``inner`` (at least that, at most the whole sector).

    The tooth line goes from centre (u0, v0), direction (x0, y0), to centre (u1, v1), direction (x1, y1). The outer
    border is the arc of the tooth's radius through both tips, so that successive sectors tile the plane. Inside
    ``inner`` the two lines may cross; the caller keeps it beyond that point.
    """
    ax, ay, bx, by = u0 + radius * x0, v0 + radius * y0, u1 + radius * x1, v1 + radius * y1
    gx, gy = 0.5 * (bx - ax), 0.5 * (by - ay)
    g2 = gx * gx + gy * gy
    rise = math.sqrt((radius * radius - g2) / g2)  # the arc's centre lies this many half chords beside the chord
    cx, cy = ax + gx - sense * gy * rise, ay + gy + sense * gx * rise
    px, py, qx, qy = u0 + inner * x0, v0 + inner * y0, u1 + inner * x1, v1 + inner * y1
    bulge = g2 / radius + SLACK  # at least the height of the arc over its chord
    ia = max(math.ceil(min(min(ax, bx), min(px, qx)) - bulge), 0)
    ib = min(math.floor(max(max(ax, bx), max(px, qx)) + bulge), nx - 1)
    low = max(min(min(ay, by), min(py, qy)) - bulge, -1.0)
    high = min(max(max(ay, by), max(py, qy)) + bulge, ny + 1.0)
    if ia > ib or low > ny - 1 or high < 0.0:
        return
    side0, side1 = sense * x0, -sense * x1  # > 0: the line bounds the sector from below
    slope0 = slope1 = 0.0
    if side0 != 0.0:
        slope0 = y0 / x0
    elif sense * y0 < 0.0:
        ia = max(ia, math.ceil(u0 - SLACK))
    else:
        ib = min(ib, math.floor(u0 + SLACK))
    if side1 != 0.0:
        slope1 = y1 / x1
    elif sense * y1 > 0.0:
        ia = max(ia, math.ceil(u1 - SLACK))
    else:
        ib = min(ib, math.floor(u1 + SLACK))
    pool, table, ints, index, old, tally = s.pool, s.table, s.ints, s.log_index, s.log_level, s.tally
    for ix in range(ia, ib + 1):
        square = radius * radius - (ix - cx) * (ix - cx)
        if square < 0.0:
            continue
        half = math.sqrt(square)
        lo, hi = max(low, cy - half), min(high, cy + half)
        line0, line1 = v0 + (ix - u0) * slope0, v1 + (ix - u1) * slope1
        if side0 > 0.0:
            lo = max(lo, line0)
        elif side0 < 0.0:
            hi = min(hi, line0)
        if side1 > 0.0:
            lo = max(lo, line1)
        elif side1 < 0.0:
            hi = min(hi, line1)
        ja, jb = max(math.ceil(lo - SLACK), 0), min(math.floor(hi + SLACK), ny - 1)
        if ja <= jb:
            _clear_column(pool, table, ints, index, old, tally, ix, ja, jb, level)


@compiled
def clear_quad(s, xs, ys, nx, ny, level):
    """Clear the inside (even-odd) of the closed polygon through the four corners xs, ys; it may cross itself."""
    ia = max(math.ceil(min(min(xs[0], xs[1]), min(xs[2], xs[3])) - SLACK), 0)
    ib = min(math.floor(max(max(xs[0], xs[1]), max(xs[2], xs[3])) + SLACK), nx - 1)
    pool, table, ints, index, old, tally = s.pool, s.table, s.ints, s.log_index, s.log_level, s.tally
    for ix in range(ia, ib + 1):
        n, a, b, c, d = 0, math.inf, math.inf, math.inf, math.inf
        for i in range(4):
            j = (i + 1) & 3
            if (xs[i] <= ix) != (xs[j] <= ix):
                y = ys[i] + (ix - xs[i]) * ((ys[j] - ys[i]) / (xs[j] - xs[i]))
                n += 1  # insert y into a <= b <= c <= d
                d = min(d, max(c, y))
                c = min(c, max(b, y))
                b = min(b, max(a, y))
                a = min(a, y)
        for pair in range(n // 2):
            lo, hi = (a, b) if pair == 0 else (c, d)
            ja, jb = math.ceil(max(lo, -1.0) - SLACK), math.floor(min(hi, ny + 1.0) + SLACK)
            ja, jb = max(ja, 0), min(jb, ny - 1)
            if ja <= jb:
                _clear_column(pool, table, ints, index, old, tally, ix, ja, jb, level)
