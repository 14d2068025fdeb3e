"""Runs of nodes of the map, which a cutter of revolution lowers at once: loops that become vector instructions."""

from __future__ import annotations

import numpy as np

from kr270_milling.physics.cutting.compiled import inlined
from kr270_milling.physics.cutting.engagement import LOG_LOST
from kr270_milling.physics.cutting.grid import LEVELS
from kr270_milling.physics.cutting.profile import RUN
from kr270_milling.physics.cutting.state import LEVEL_SUM, LOGGED, NODES_CUT

# Rows of ``EdgeBins.work``, a number for each node of a run
GOAL = 0  # level of the tool; below 0: the node stays
PART = RUN  # covered part of the cell
SHARE = 2 * RUN  # of the step, after which the tool is lowest
LOST = 3 * RUN  # levels that the cell loses
REST = 4 * RUN  # level before of what the tool had not covered
BOUND = 5 * RUN  # level below which no node of a whole run is lowered
FALL = 7 * RUN  # half of the difference of the levels of the tool over a cell
NEAR = 6 * RUN  # 2: the tool covers cells of a whole run in part; 1: it did so at the start of the step


@inlined
def lower_nodes(s, p, base, first):
    """Lower the nodes of the run from ``first`` to GOAL, log what they were, and fill LOST and REST."""
    work, none, zero, one, half = s.edge.work, np.int32(0), np.float32(0), np.float32(1), np.float32(0.5)
    total, new, least, start = np.int32(0), np.int32(0), np.int32(LEVELS), np.uint64(base + first)
    for n in range(RUN):
        place = start + np.uint64(n)
        before, rest, part, goal = np.int32(s.pool[place]), s.rest[place], work[PART + n], work[GOAL + n]
        height = goal - np.float32(rest)
        after = np.int32(goal + half) if part >= one else np.int32(rest) + np.int32(part * height + half)
        lost = max(after - before, none) if height > zero else none
        s.pool[place] = np.uint16(before + lost)
        s.rest[place] = np.uint16(after) if part >= one and lost > none else rest
        work[LOST + n], work[REST + n] = np.float32(lost), np.float32(rest)
        total, least = total + lost, min(least, before + lost)
        new += np.int32(before == none and lost > none)
    s.ints[NODES_CUT] += new
    s.floats[LEVEL_SUM] += total * p.level_step
    s.edge.highest[start // np.uint64(RUN)] = least
    logged = s.ints[LOGGED]
    s.ints[LOGGED] = LOG_LOST
    if logged + RUN < s.log_place.size:
        for n in range(RUN):
            if work[LOST + n] > zero:
                place = start + np.uint64(n)
                s.log_place[np.uint64(logged)] = place
                s.log_level[np.uint64(logged)] = s.pool[place] - np.uint16(work[LOST + n])
                s.log_rest[np.uint64(logged)] = np.uint16(work[REST + n])
                logged += 1
        s.ints[LOGGED] = logged
