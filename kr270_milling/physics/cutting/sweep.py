"""Sweep of the teeth through the workpiece: material out, force back (Figs. 5 to 7, eqs. 26 to 29); compiled."""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.compiled import inlined, inner
from kr270_milling.physics.cutting.fill import clear_quad, clear_sector, tally_log
from kr270_milling.physics.cutting.load import end_force, load
from kr270_milling.physics.cutting.state import (
    FLOOR,
    LEVEL_SUM,
    LOG_LOST,
    LOGGED,
    LOGGED_RUNS,
    NEXT_STEP,
    NODES_CUT,
    RUN,
    RUN_LEVEL,
    TALLIED,
    TILES,
)

NO_FORCES = np.empty((0, 3))  #: pass this as ``forces`` if the force of each micro-step is not wanted
TURN = 1.26  # a point beyond ``near`` seen from a centre that moves by x turns by at most TURN x / radius
JUMP = 0.125  # share of a tooth's way in a micro-step: a centre that moves further is a jump


@inner
def sweep(s, p, pose_from, pose_to, first, n, forces, wrench):
    """Move the tool centre straight from one position to another in n micro-steps of the spindle angle.

    s: State, changed; p: Params; poses (3,) [m], tool tip in the workpiece frame; first: number of the first
    micro-step since the pass began (int); forces: (n, 3) filled with the force of each micro-step [N], or NO_FORCES;
    wrench: (6,) filled with the mean of force and moment about the tool tip on the tool [N, N m]. Returns the mean of
    the spindle torque [N m].
    """
    _open(s, p, pose_from, first, n)
    _clear(wrench)
    sum_torque = 0.0
    x1, y1 = pose_from[0], pose_from[1]
    for k in range(n):
        step, x0, y0, part = first + k, x1, y1, (k + 1.0) / n
        turn = step % p.steps
        if k == n - 1:
            x1, y1 = pose_to[0], pose_to[1]
        else:
            x1 = pose_from[0] + part * (pose_to[0] - pose_from[0])
            y1 = pose_from[1] + part * (pose_to[1] - pose_from[1])
        moved = math.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
        _remember(s, step + 1, x1, y1, moved)
        z = pose_from[2] + (k + 0.5) / n * (pose_to[2] - pose_from[2])
        depth = min(p.top - z, p.thickness)
        level = max(1, int(depth / p.level_step + 0.5)) if depth > 1e-3 * p.level_step else 0
        whole, path = _plan(s, p, step, level)
        if level > 0:
            for i in range(p.radii.size):
                h, height = _tooth(s, p, i, step, turn, x0, y0, x1, y1, moved, depth, level, whole, path)
                if h > 0.0:
                    load(s, p, i, step, turn, h, height)
        now = s.loads[step & (s.loads.shape[0] - 1)]
        if forces.shape[0] > 0:
            forces[k, 0], forces[k, 1], forces[k, 2] = now[0], now[1], now[2]
        for j in range(5):
            wrench[j] += now[j]
        sum_torque += now[5]
        _clear(now)
    s.ints[NEXT_STEP] = first + n
    for j in range(5):
        wrench[j] /= n
    if p.moments:
        wrench[5] = -p.sense * (sum_torque / n)  # what turns the spindle turns its housing the other way
    return sum_torque / n


@inner
def undo(s):
    """Take the last sweep back; False if its log overflowed and nothing was done."""
    if s.ints[LOG_LOST]:
        return False
    end = s.ints[LOGGED]
    for run in range(s.ints[LOGGED_RUNS] - 1, -1, -1):  # backwards: a node may have been lowered twice
        start, length = s.log_runs[run]
        for i in range(length):
            s.pool[start + i] = s.log_level[end - length + i]
        end -= length
    tiles = s.ints[TILES]
    copy_numbers(s.saved_ints, s.ints)
    copy_numbers(s.saved_floats, s.floats)
    for k in range(s.loads.shape[0]):
        copy_numbers(s.saved_loads[k], s.loads[k])
    s.ints[TILES] = tiles  # an untouched tile says the same as none
    s.ints[LOGGED] = s.ints[LOGGED_RUNS] = s.ints[TALLIED] = 0
    return True


@inner
def copy_numbers(source, target):
    """Copy the numbers of an array into another."""
    for i in range(target.size):
        target[i] = source[i]


@inner
def _clear(target):
    for i in range(target.size):
        target[i] = 0.0


@inner
def _open(s, p, pose_from, first, n):
    """Save the state, empty the log, and forget the history if this sweep does not continue the last one."""
    s.ints[LOGGED] = s.ints[LOGGED_RUNS] = s.ints[LOG_LOST] = s.ints[TALLIED] = 0
    copy_numbers(s.ints, s.saved_ints)
    copy_numbers(s.floats, s.saved_floats)
    for k in range(s.loads.shape[0]):
        copy_numbers(s.loads[k], s.saved_loads[k])
    for i in range(s.chips.size):
        s.chips[i] = 0.0
    here = s.history[first & (s.history.shape[0] - 1)]
    if s.ints[NEXT_STEP] != first or here[0] != pose_from[0] or here[1] != pose_from[1]:
        here[0], here[1], here[2] = pose_from[0], pose_from[1], 0.0
        s.ints[RUN], s.ints[RUN_LEVEL], s.ints[FLOOR] = first, 65536, -1
        s.saved_ints[NEXT_STEP] = -1  # the old history is not to be taken up again
        for k in range(s.loads.shape[0]):
            _clear(s.loads[k])
    if n > p.steps:
        s.saved_ints[NEXT_STEP] = -1  # its places will be written over


@inlined
def _remember(s, step, x, y, moved):
    mask = s.history.shape[0] - 1
    here = s.history[step & mask]
    here[0], here[1], here[2] = x, y, s.history[(step - 1) & mask, 2] + moved


@inlined
def _path(s, start, end):
    """Return the distance that the centre moved between two micro-steps [m]."""
    mask = s.history.shape[0] - 1
    return s.history[end & mask, 2] - s.history[start & mask, 2]


@inlined
def _plan(s, p, step, level):
    """Return whether a full-sector sweep is needed; otherwise the distance the centre moved in the last window [m].

    Only the rim is new ground if the footprint was swept before: by a run of whole sectors over one window and half a
    turn, as far as a point near the axis turns away from the teeth when the centre goes by, and from then on because
    the tool moves little in a window. A tool that sinks below the FLOOR so left needs a new run.
    """
    far = 0.1 * p.shortest  # the rim band is used where the tool moves by less in a window
    if s.ints[RUN] >= 0:
        if _path(s, s.ints[RUN], step + 1) > far:
            s.ints[RUN], s.ints[RUN_LEVEL] = step, level
        elif step - s.ints[RUN] >= p.window + p.steps // 2:
            s.ints[FLOOR], s.ints[RUN] = s.ints[RUN_LEVEL], -1
    path = 0.0
    if s.ints[RUN] < 0:
        path = _path(s, step + 1 - p.window, step + 1)
        if path > far or level > s.ints[FLOOR] + p.tolerance:
            s.ints[RUN], s.ints[RUN_LEVEL] = step, level
        else:
            s.ints[FLOOR] = min(s.ints[FLOOR], level)
    if s.ints[RUN] >= 0:
        s.ints[RUN_LEVEL] = min(s.ints[RUN_LEVEL], level)
    return s.ints[RUN] >= 0, path


@inlined
def _tooth(s, p, i, step, turn, x0, y0, x1, y1, moved, depth, level, whole, path):
    """Clear the sector of tooth i in one micro-step; thickness and height of its chip [m]."""
    scale, radius, layer = 1.0 / p.spacing, p.radii[i], 0.0
    a, b = p.directions[i, turn, 0], p.directions[i, turn, 1]
    c, d = p.directions[i, turn + 1, 0], p.directions[i, turn + 1, 1]
    inner = 0.0
    near = 0.8  # share of the radius: the rim band goes no deeper
    if whole:
        layer = _end(s, p, i, step, turn, x1, y1, depth, level)
    else:
        inner = _inner_radius(s, p, i, step + 1, x1, y1, c, d, moved, path)
        if inner >= radius + 2.0 * moved:
            return 0.0, 0.0
        whole = inner < near * p.shortest
    s.tally[0] = s.tally[1] = s.tally[3] = 0
    s.tally[2] = level
    u0, v0 = (x0 - p.origin_x) * scale, (y0 - p.origin_y) * scale
    u1, v1 = (x1 - p.origin_x) * scale, (y1 - p.origin_y) * scale
    reach = (radius + moved) * scale + 1.0
    if u1 + reach < 0.0 or v1 + reach < 0.0 or u1 - reach > p.nx or v1 - reach > p.ny:
        return 0.0, 0.0
    r = radius * scale
    if moved > JUMP * radius * p.micro_step:
        _jump(s, p, u0, v0, a, b, u1, v1, r, level)
    else:
        if whole:  # within the crossing of the two lines the tooth sweeps a bow tie
            inner = 3.0 * moved / p.micro_step
            t = inner * scale
            xs, ys = (u0, u0 + t * a, u1 + t * c, u1), (v0, v0 + t * b, v1 + t * d, v1)
            clear_quad(s, xs, ys, p.nx, p.ny, level)
        clear_sector(s, p.sense, u0, v0, a, b, u1, v1, c, d, r, inner * scale, p.nx, p.ny, level)
    tally_log(s.ints, s.log_level, s.tally, level)
    if s.tally[0] == 0:
        return 0.0, 0.0
    return _chip(s, p, i, turn, x1 - x0, y1 - y0, depth, level, layer)


@inner
def _end(s, p, i, step, turn, x, y, depth, level):
    """Add the load of the end edge of tooth i, which lowers the floor below a sinking tool; the volume cut so [m^3].

    The floor is cut at least to FLOOR, and where that is not known to the shallowest level of this run; the side edge
    cuts what is higher. The floor is measured ``lead`` ahead of the tooth, where nodes near the axis are not cut yet.
    """
    floor = s.ints[RUN_LEVEL] - 1
    if s.ints[FLOOR] >= 0:
        floor = min(floor, s.ints[FLOOR])
    if level <= floor:
        return 0.0
    lead = 0.02  # [rad]
    ahead = (turn + 1 + int(lead / p.micro_step)) % p.steps
    c, d = p.directions[i, ahead, 0], p.directions[i, ahead, 1]
    end_points = 64  # points of the radius, at which the layer below a sinking tool is measured
    step_r = p.radii[i] / end_points
    volume = tangential = thrust = moment = torque = 0.0
    for n in range(end_points):
        r = (n + 0.5) * step_r
        u = int(math.floor((x + r * c - p.origin_x) / p.spacing + 0.5))
        v = int(math.floor((y + r * d - p.origin_y) / p.spacing + 0.5))
        if u < 0 or v < 0 or u >= p.nx or v >= p.ny:
            continue
        slot = np.int64(s.table[u >> 8, v >> 8])
        before = np.int64(s.pool[slot << 16 | (u & 255) << 8 | (v & 255)]) if slot >= 0 else np.int64(0)
        if floor <= before < level:
            h = depth - before * p.level_step
            f_t, f_r = end_force(p, h)
            tangential, torque = tangential + f_t * step_r, torque + f_t * r * step_r
            thrust, moment = thrust + f_r * step_r, moment + f_r * r * step_r
            volume += h * r * step_r * p.micro_step
    if volume > 0.0:
        c, d = p.middles[i, turn, 0], p.middles[i, turn, 1]
        now = s.loads[step & (s.loads.shape[0] - 1)]
        now[0] += p.sense * tangential * d
        now[1] -= p.sense * tangential * c
        now[2] += thrust
        if p.moments:
            now[3] += d * moment
            now[4] -= c * moment
        now[5] += torque
    return volume


@inlined
def _chip(s, p, i, turn, dx, dy, depth, level, layer):
    """Chip thickness and height of the chip of a tooth, of the nodes in the tally [m]; dx, dy: step of the centre [m].

    layer: volume in the tally that the end edge has cut [m^3].
    h is the volume over the height: A_i / (R dphi_i) if the ground is flat. dphi_i is the tooth's angle as seen from
    the centre before the step: R dphi_i = R dphi + d . t, t the tooth's direction of motion in the middle of the step.
    """
    per_node = p.spacing * p.spacing
    total = s.tally[0] * (depth - level * p.level_step) + s.tally[1] * p.level_step
    height = depth - s.tally[2] * p.level_step
    h = max(total * per_node - layer, 0.0) / (height * p.radii[i] * p.micro_step)
    if not p.nominal:
        c, d = p.middles[i, turn, 0], p.middles[i, turn, 1]
        along = p.sense * (dy * c - dx * d) / (p.radii[i] * p.micro_step)
        h /= max(1.0 + along, JUMP)  # a centre that jumps may outrun the tooth
    s.floats[LEVEL_SUM] += total
    s.ints[NODES_CUT] += s.tally[3]
    s.chips[i] = max(s.chips[i], h)
    return h, height


@inlined
def _inner_radius(s, p, i, now, x, y, c, d, moved, path):
    """Radius around the centre within which tooth i cannot meet material, because the tooth ahead of it passed there.

    That one came by a pitch ago, give or take the ``spread`` by which the moving centre turns the point's direction.
    A point at distance rho in direction e was then at most rho + e . (way since) + path^2 / (2 rho) from the centre.
    """
    mask = s.history.shape[0] - 1
    spread = int(TURN * path / (p.shortest * p.micro_step)) + 3
    then = now - p.pitch_steps[i]
    stray = max(_path(s, then - spread, then), _path(s, then, min(then + spread, now)))
    ahead = i + 1 if i + 1 < p.radii.size else 0
    back = c * (x - s.history[then & mask, 0]) + d * (y - s.history[then & mask, 1])
    turn = p.micro_step + (TURN * moved + path / 1.6) / p.shortest
    # twice the stray: the arc of a sector may lie inside the tooth's radius by the way of one micro-step
    return p.radii[ahead] - back - 2.0 * (stray + moved) - path * turn - 0.02 * p.spacing


@inner
def _jump(s, p, u0, v0, a, b, u1, v1, r, level):
    """Clear what the tooth line passes over while its centre goes a long way: in parts, each a quadrilateral."""
    length = math.sqrt((u1 - u0) * (u1 - u0) + (v1 - v0) * (v1 - v0))
    # so many that neither the arc nor the envelope of the line leaves its chord by more than 1/100 of a node
    parts = int(min(max(p.micro_step * math.sqrt(12.5 * r), math.sqrt(12.5 * length * p.micro_step)), 1e4)) + 1
    turn_c, turn_s = math.cos(p.micro_step / parts), p.sense * math.sin(p.micro_step / parts)
    for k in range(parts):
        ua, va = u0 + k / parts * (u1 - u0), v0 + k / parts * (v1 - v0)
        ub, vb = u0 + (k + 1) / parts * (u1 - u0), v0 + (k + 1) / parts * (v1 - v0)
        c, d = a * turn_c - b * turn_s, a * turn_s + b * turn_c
        xs, ys = (ua, ua + r * a, ub + r * c, ub), (va, va + r * b, vb + r * d, vb)
        clear_quad(s, xs, ys, p.nx, p.ny, level)
        a, b = c, d
