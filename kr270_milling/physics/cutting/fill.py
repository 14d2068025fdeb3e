"""Clearing of grid nodes: a run of nodes in one column, the sector of one tooth, any quadrilateral (compiled).

Lengths here are in node distances and node (i, j) is at (i, j). Intervals are closed and SLACK wider than
computed: a node on the line between two sectors belongs to both and is cleared, and counted, by the first.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.compiled import compiled, inlined
from kr270_milling.physics.cutting.grid import LEVELS, TILE
from kr270_milling.physics.cutting.lanes import LANES, lower_lanes
from kr270_milling.physics.cutting.state import BLOCK, FAILED, LOG_LOST, LOGGED, LOGGED_RUNS, TALLIED, TILES

SLACK = 1e-9
COLUMNS = np.arange(float(BLOCK))


@inlined
def tally_log(ints, old, tally, level):
    """Add to tally what the log holds since the last call: nodes, sum of level differences, lowest level, new nodes.

    The log is filled up to whole LANES with the deepest level, which adds nothing: vector instructions alone do it.
    """
    begin, end = np.uint64(ints[TALLIED]), np.uint64(ints[LOGGED])
    whole = (end - begin + np.uint64(LANES - 1)) & ~np.uint64(LANES - 1)
    for n in range(LANES):
        old[end + np.uint64(n)] = np.uint16(LEVELS)
    deepest = np.uint16(level)
    most_summed = 65_520  # nodes, of up to 65535 levels each; whole LANES
    for first in range(np.uint64(0), whole, np.uint64(most_summed)):  # so many at a time that their sum fits 32 bits
        stop = min(whole, first + np.uint64(most_summed))
        count, new, most, deficit = np.uint16(0), np.uint16(0), np.uint16(0), np.uint32(0)
        for n in range(first, stop):  # each sum is cut to its width at once, since more lanes then fit a register
            left = np.uint16(deepest - min(old[begin + n], deepest))
            count = np.uint16(count + np.uint16(left > 0))
            new = np.uint16(new + np.uint16(left == deepest))
            deficit = np.uint32(deficit + np.uint32(left))
            most = max(most, left)
        tally[0] += np.int64(count)
        tally[1] += np.int64(deficit)
        tally[2] = min(tally[2], np.int64(level) - np.int64(most))
        tally[3] += np.int64(new)
    ints[TALLIED] = ints[LOGGED]


@compiled
def _lose_log(ints, old, tally, level):
    """Empty a log that is full. Apart from its caller, whose loop then has more registers: 5 % of a pass."""
    tally_log(ints, old, tally, level)
    ints[TALLIED], ints[LOG_LOST] = 0, 1


@inlined
def _clear_columns(pool, table, ints, runs, old, tally, spans, first, count, low, high, level):
    """Lower the nodes (first + n, spans[0, n]..spans[1, n]), n < count, to ``level``; low, high: bounds of the spans.

    All columns cross the same tiles. The log keeps the old levels of the nodes and where each run of nodes was.
    """
    logged, logged_runs, column = np.uint64(ints[LOGGED]), np.uint64(ints[LOGGED_RUNS]), np.uint64(first & (TILE - 1))
    room, most_runs = np.uint64(old.size - LANES), np.uint64(runs.shape[0])
    for row in range(low >> 8, (high >> 8) + 1):
        slot, begin, end = table[first >> 8, row], np.int32(row << 8), np.int32(row << 8 | 255)
        for n in range(count):
            ja, jb = max(spans[0, n], begin), min(spans[1, n], end)
            if ja > jb:
                continue
            if slot < 0:
                slot = _take_tile(pool, table, ints, first >> 8, row)
                if slot < 0:
                    break
            length = np.uint64(jb - ja) + np.uint64(1)
            start = np.uint64(slot) << np.uint64(16) | (column + np.uint64(n)) << np.uint64(8) | np.uint64(ja - begin)
            # from 32 nodes on it pays to look first whether anything is left
            if length >= 32 and not any_above(pool, start, length, level):
                continue
            if logged + length > room or logged_runs == most_runs:
                ints[LOGGED] = logged
                _lose_log(ints, old, tally, level)
                logged = logged_runs = np.uint64(0)
            _lower(pool, old, start, logged, length, np.uint16(level))
            runs[logged_runs, 0], runs[logged_runs, 1] = start, length
            logged_runs += np.uint64(1)
            logged += length
    ints[LOGGED], ints[LOGGED_RUNS] = logged, logged_runs


@inlined
def _take_tile(pool, table, ints, tile_x, tile_y):
    """Place of a new tile in the pool; -1 and FAILED if the pool is full."""
    slot = np.int32(ints[TILES])
    if ((np.int64(slot) + 1) << 16) + LANES > pool.size:
        ints[FAILED] = 1
        return np.int32(-1)
    table[tile_x, tile_y] = slot
    ints[TILES] += 1
    return slot


@inlined
def _lower(pool, old, start, logged, length, level):
    """The innermost loop; unsigned numbers, because an index that cannot count from the end costs less."""
    first, lanes = np.uint64(0), np.uint64(LANES)
    while first < length:
        lower_lanes(pool, start + first, old, logged + first, np.uint16(min(length - first, lanes)), level)
        first += lanes


@inlined
def any_above(pool, start, length, level):
    lowest = pool[start]
    for p in range(length):
        lowest = min(lowest, pool[start + p])
    return lowest < level


@inlined
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
    # Beyond the square to the mid direction through the nearer inner corner: nothing below this line is needed.
    mx, my = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    base = min(mx * px + my * py, mx * qx + my * qy) - SLACK
    side0, side1 = sense * x0, -sense * x1  # > 0: the line bounds the sector from below
    slope0 = slope1 = inverse = 0.0
    if my != 0.0:
        inverse = 1.0 / my
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
    # A line that bounds the sector from one side only is moved to infinity on the other.
    low_base, high_base = 0.0 if my > 0.0 else -math.inf, 0.0 if my < 0.0 else math.inf
    low0, high0 = v0 if side0 > 0.0 else -math.inf, v0 if side0 < 0.0 else math.inf
    low1, high1 = v1 if side1 > 0.0 else -math.inf, v1 if side1 < 0.0 else math.inf
    bottom, top = max(math.floor(low), 0), min(math.ceil(high), ny - 1)
    pool, table, ints, runs, old, tally, spans = s.pool, s.table, s.ints, s.log_runs, s.log_level, s.tally, s.spans
    first = ia
    while first <= ib:
        count = min(ib, first | (BLOCK - 1)) + 1 - first  # a block of columns does not cross the border of a tile
        for n in range((count + 7) & -8):  # without a branch, so that it is compiled to vector instructions
            x = first + COLUMNS[n]
            square = radius * radius - (x - cx) * (x - cx)
            half = math.sqrt(max(square, 0.0))
            over = (base - mx * x) * inverse
            line0, line1 = (x - u0) * slope0, (x - u1) * slope1
            lo = max(max(low, cy - half), max(max(low_base + over, low0 + line0), low1 + line1))
            hi = min(min(high, cy + half), min(min(high_base + over, high0 + line0), high1 + line1))
            lo, hi = min(lo, ny + 1.0), max(hi, -2.0)  # what a 32-bit number can hold
            spans[0, n] = max(np.int32(np.ceil(lo - SLACK)), np.int32(0))
            spans[1, n] = min(np.int32(np.floor(hi + SLACK)), np.int32(ny - 1)) if square >= 0.0 else np.int32(-1)
        _clear_columns(pool, table, ints, runs, old, tally, spans, first, count, bottom, top, level)
        first += count


@compiled
def clear_quad(s, xs, ys, nx, ny, level):
    """Clear the inside (even-odd) of the closed polygon through the four corners xs, ys; it may cross itself."""
    ia = max(math.ceil(min(min(xs[0], xs[1]), min(xs[2], xs[3])) - SLACK), 0)
    ib = min(math.floor(max(max(xs[0], xs[1]), max(xs[2], xs[3])) + SLACK), nx - 1)
    pool, table, ints, runs, old, tally, spans = s.pool, s.table, s.ints, s.log_runs, s.log_level, s.tally, s.spans
    for ix in range(ia, ib + 1):
        n, a, b, c, d = 0, math.inf, math.inf, math.inf, math.inf
        for i in range(4):
            j = (i + 1) & 3
            if (xs[i] <= ix) != (xs[j] <= ix):
                y = ys[i] + (ix - xs[i]) / (xs[j] - xs[i]) * (ys[j] - ys[i])  # a share of 0 to 1: no overflow
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
                spans[0, 0], spans[1, 0] = ja, jb
                _clear_columns(pool, table, ints, runs, old, tally, spans, ix, np.int64(1), ja, jb, level)
