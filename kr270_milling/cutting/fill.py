"""Clearing of grid nodes: a run of nodes in one column, the sector of one tooth, any quadrilateral (compiled).

Lengths here are in node distances and node (i, j) stands at (i, j). Intervals are closed and SLACK wider than
computed: a node on the line between two sectors belongs to both and is cleared, and counted, by the first.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kr270_milling.cutting.state import FAILED, LOG_LOST, LOGGED, TILES

SLACK = 1e-9
VECTOR = 32  # nodes from which on it pays to look first whether anything is left


@njit(cache=True, error_model="numpy")
def clear_column(s, ix, ja, jb, level):
    """Lower the nodes (ix, ja..jb) to ``level``; adds count, sum of level differences to s.tally, keeps the minimum."""
    j = ja
    while j <= jb:
        end = min(jb, j | 255)
        slot = s.table[ix >> 8, j >> 8]
        if slot < 0:
            slot = np.int32(s.ints[TILES])
            if (slot + 1) << 16 > s.pool.size:
                s.ints[FAILED] = 1
                return
            s.table[ix >> 8, j >> 8] = slot
            s.ints[TILES] += 1
        base = (np.int64(slot) << 16) | ((ix & 255) << 8)
        _clear_run(s, base | (j & 255), end - j + 1, level)
        j = end + 1


@njit(cache=True, error_model="numpy")
def _clear_run(s, start, length, level):
    pool, index, old = s.pool, s.log_index, s.log_level
    if length >= VECTOR:
        lowest = pool[start]
        for p in range(start, start + length):
            lowest = min(lowest, pool[p])
        if lowest >= level:
            return
    n = s.ints[LOGGED]
    if n + length > index.size:
        s.ints[LOG_LOST] = 1
        n = 0
    first, deficit, lowest, new = n, np.int64(0), np.int64(s.tally[2]), np.uint16(level)
    for p in range(start, start + length):
        k = pool[p]
        index[n] = p  # written always, kept only if the node is cleared: no branch
        old[n] = k
        missing = max(np.int64(level) - np.int64(k), 0)
        n += missing > 0
        deficit += missing
        lowest = min(lowest, np.int64(k))
        pool[p] = max(k, new)
    s.ints[LOGGED] = n
    s.tally[0] += n - first
    s.tally[1] += deficit
    s.tally[2] = lowest


@njit(cache=True, error_model="numpy")
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
            clear_column(s, ix, ja, jb, level)


@njit(cache=True, error_model="numpy")
def clear_quad(s, xs, ys, nx, ny, level):
    """Clear the inside (even-odd) of the closed polygon through the four corners xs, ys; it may cross itself."""
    ia = max(math.ceil(min(min(xs[0], xs[1]), min(xs[2], xs[3])) - SLACK), 0)
    ib = min(math.floor(max(max(xs[0], xs[1]), max(xs[2], xs[3])) + SLACK), nx - 1)
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
                clear_column(s, ix, ja, jb, level)
