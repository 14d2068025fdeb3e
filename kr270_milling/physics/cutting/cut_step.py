"""Steps of both cutting models for compiled loops.

Arguments choose the model and the shape of the tool. Where an argument is None, Numba leaves out what is below
``if ... is not None``: it does not compile the other model.
"""

from __future__ import annotations

import math

from numba import njit

from kr270_milling.physics.cutting.compiled import compiled, inner
from kr270_milling.physics.cutting.engagement import (
    CONTACT,
    FLOOR_LEVEL,
    FLOOR_NEAR,
    FLOORS_KEPT,
    FLOORS_KNOWN,
    LONGEST,
    RISE,
    SWING,
    THRUST,
    UPRIGHT,
    flat_part,
    floor_near,
    rise_of_step,
    slant,
    undo_engagement,
)
from kr270_milling.physics.cutting.revolution import edge_load, empty_bins, lower_upright
from kr270_milling.physics.cutting.state import LEVEL_SUM, LOGGED
from kr270_milling.physics.cutting.sweep import sweep, undo
from kr270_milling.physics.cutting.tilted import lower_tilted


@inner
def engage(s, p, flat, profile, tilts, pose_from, pose_to, n, wrench):
    """Move the tool tip straight from one position to another while the spindle turns by n micro-steps.

    s: state, changed; p: params; flat, profile, tilts: fields of p, by which Numba chooses the parts; positions (3,)
    [m], workpiece frame, or (6,) with the axis after them; wrench: (6,), filled with the mean force and moment about
    the tip on the tool [N, N m]. Returns the mean spindle torque [N m].
    """
    for j in range(s.ints.size):
        s.saved_ints[j] = s.ints[j]
    for j in range(s.floats.size):
        s.saved_floats[j] = s.floats[j]
    follows = True  # the tool comes from its last place
    for j in range(s.last.size):
        s.saved_last[j] = s.last[j]
        follows = follows and s.last[j] == pose_from[j]
    for j in range(s.load.size):
        s.saved_load[j] = s.load[j]
    s.ints[LOGGED] = 0
    s.ints[FLOORS_KEPT] = s.ints[FLOORS_KNOWN]
    if not follows:
        s.ints[FLOOR_LEVEL] = -1  # what the footprint of the tool has cut is not known
        s.ints[FLOORS_KNOWN] = s.ints[FLOORS_KEPT] = 0
        s.load[RISE], s.load[CONTACT] = 0.0, p.teeth * p.end_radius
    for j in range(6):
        wrench[j] = 0.0
    dx, dy, turn = pose_to[0] - pose_from[0], pose_to[1] - pose_from[1], n * p.micro_step
    tilted, way = False, math.sqrt(dx * dx + dy * dy)
    if tilts is not None and max(slant(pose_from), slant(pose_to)) > UPRIGHT * UPRIGHT:
        tilted, dz = True, pose_to[2] - pose_from[2]
        ax, ay, az = pose_to[3] - pose_from[3], pose_to[4] - pose_from[4], pose_to[5] - pose_from[5]
        way = math.sqrt(dx * dx + dy * dy + dz * dz) + SWING * p.radius * math.sqrt(ax * ax + ay * ay + az * az)
    parts = 1 + int(way / (LONGEST * p.radius))
    passes = turn * p.teeth / (2.0 * math.pi) / parts  # of teeth, in a part
    if tilted:
        s.load[RISE] = 0.0
    start = pose_from[2] + s.load[RISE]
    s.ints[FLOOR_NEAR] = floor_near(s, p, pose_from) if p.give > 0.0 and not tilted else -1
    s.load[RISE] = rise_of_step(s, p, pose_to[2], passes * parts, p.give * turn / (turn + p.lag))
    dz = pose_to[2] + s.load[RISE] - start
    torque = height = thrust = 0.0
    for k in range(parts):
        a, b = k / parts, (k + 1.0) / parts
        x0, y0, z0 = pose_from[0] + a * dx, pose_from[1] + a * dy, start + a * dz
        x1, y1, z1 = pose_from[0] + b * dx, pose_from[1] + b * dy, start + b * dz
        part, removed = (0.0, 0.0, 0.0), s.floats[LEVEL_SUM]
        if flat is not None:
            part = flat_part(s, p, x0, y0, z0, x1, y1, z1, passes, wrench)
        if profile is not None:
            used = 2 * p.widths.size, p.profile.length.size - 1
            motion, frame = (0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            if not tilted:
                motion, frame, used = lower_upright(s, p, x0, y0, z0, x1, y1, z1)
            if tilts is not None and tilted:
                motion, frame = lower_tilted(s, p, pose_from, pose_to, a, b)
            if passes == 0.0:
                empty_bins(s)
            elif s.floats[LEVEL_SUM] > removed:
                part = edge_load(s, p, motion, frame, passes, used, tilted, wrench)
        torque += part[0]
        height += part[1]
        thrust += part[2]
    for j in range(6):
        wrench[j] /= parts
    torque /= parts
    if p.moments and not tilted:
        wrench[5] = -p.sense * torque
    for j in range(s.last.size):
        s.last[j] = pose_to[j]
    fresh = turn / (turn + p.lag + p.twist * height / parts)
    faded = 1e-3  # [N, N m] of a tool in the air, which ends the lag: a pass counts where its wrench is not 0
    for j in range(6):
        s.load[j] += fresh * (wrench[j] - s.load[j])
        if wrench[j] == 0.0 and abs(s.load[j]) < faded:
            s.load[j] = 0.0
        wrench[j] = s.load[j]
    s.load[6] += fresh * (torque - s.load[6])
    s.load[THRUST] += fresh * (thrust / parts - s.load[THRUST])
    return s.load[6]


@compiled
def cut_undo(s, teeth, mean):
    """Take the last step back; False where the undo log was too small and nothing was done.

    teeth, mean: one is True, the model of the state s: the sweep of the teeth or the mean force; the other is None.
    """
    undone = False
    if teeth is not None:
        undone = undo(s)
    if mean is not None:
        undone = undo_engagement(s, s.edge)
    return undone


@njit(cache=True, error_model="numpy", nogil=True)  # several workpieces are cut at once
def cut_poses(s, p, teeth, mean, positions, steps, forces, wrench, torque, volume):
    """Cut from each position (n, 3) [m] to the next, which is reached at micro-steps (n,) counted from the start.

    s, p: state, changed, and params; teeth, mean: see ``cut_undo``; forces: of each micro-step of a single step, filled
    by the sweep of the teeth, or NO_FORCES. Fills the rows from 1 on: mean wrench (n, 6) [N, N m], mean torque (n,)
    [N m], removed volume (n,) [m^3].
    """
    per_node = p.spacing * p.spacing
    for k in range(1, positions.shape[0]):
        before, start, end = s.floats[LEVEL_SUM], positions[k - 1], positions[k]
        first, n = steps[k - 1], steps[k] - steps[k - 1]
        if teeth is not None:
            torque[k] = sweep(s, p, start, end, first, n, forces, wrench[k])
        if mean is not None:
            torque[k] = engage(s, p, p.flat, p.profile, p.tilts, start, end, n, wrench[k])
        volume[k] = (s.floats[LEVEL_SUM] - before) * per_node
