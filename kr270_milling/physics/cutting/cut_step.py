"""Steps of both cutting models for compiled loops.

Arguments choose the model and the shape of the tool. Where an argument is None, Numba leaves out what is below
``if ... is not None``: it does not compile the other model.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.compiled import compiled
from kr270_milling.physics.cutting.engagement import (
    CONTACT,
    FLOOR_LEVEL,
    FLOOR_NEAR,
    FLOORS_KEPT,
    FLOORS_KNOWN,
    LAST,
    LOAD,
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
from kr270_milling.physics.cutting.revolution import edge_load, lower_upright
from kr270_milling.physics.cutting.state import LEVEL_SUM, LOGGED
from kr270_milling.physics.cutting.sweep import copy_numbers, sweep, undo
from kr270_milling.physics.cutting.tilted import lower_tilted


@compiled
def cut_undo(s, teeth, mean):
    """Take the last step back; False where the undo log was too small and nothing was done.

    teeth, mean: the model of the state s. Of the sweep of the teeth True and None; of the mean force None, and
    ``tilts`` and ``upright`` of ``engage``.
    """
    undone = False
    if teeth is not None:
        undone = undo(s)
    if mean is not None:
        undone = undo_engagement(s, s.edge)
    return undone


@compiled
def engage(s, p, flat, profile, tilts, upright, poses, steps, wrench, torque, volume):
    """Cut from each pose to the next, straight, with the mean force of the engagement.

    s: state, changed; p: params; flat, profile: fields of p; tilts: True: poses have an axis; upright: True: of some
    steps that cut the axis is upright. Where one of the four is None, Numba compiles none of its parts. poses: (n, 3)
    [m], workpiece frame, or (n, 6) with the axis after the tip; steps: micro-steps at which they are reached.
    Fills the rows from 1 on: mean wrench about the tip on the tool (n, 6) [N, N m], mean torque of the spindle (n,)
    [N m], removed volume (n,) [m^3].
    """
    for k in range(1, poses.shape[0]):
        before, pose_from, pose_to, mean = s.floats[LEVEL_SUM], poses[k - 1], poses[k], wrench[k]
        n = steps[k] - steps[k - 1]
        copy_numbers(s.ints, s.saved_ints)
        copy_numbers(s.floats, s.saved_floats)
        follows = True  # the tool comes from its last place
        for j in range(pose_from.size):
            follows = follows and s.floats[LAST + j] == pose_from[j]
        s.ints[LOGGED] = 0
        s.ints[FLOORS_KEPT] = s.ints[FLOORS_KNOWN]
        if not follows:
            s.ints[FLOOR_LEVEL] = -1  # what the footprint of the tool has cut is not known
            s.ints[FLOORS_KNOWN] = s.ints[FLOORS_KEPT] = 0
            s.floats[RISE], s.floats[CONTACT] = 0.0, p.teeth * p.end_radius
        for j in range(6):
            mean[j] = 0.0
        dx, dy, turn = pose_to[0] - pose_from[0], pose_to[1] - pose_from[1], n * p.micro_step
        tilted, way = False, math.sqrt(dx * dx + dy * dy)
        if tilts is not None and (upright is None or max(slant(pose_from), slant(pose_to)) > UPRIGHT * UPRIGHT):
            tilted, dz = True, pose_to[2] - pose_from[2]
            ax, ay, az = pose_to[3] - pose_from[3], pose_to[4] - pose_from[4], pose_to[5] - pose_from[5]
            way = math.sqrt(dx * dx + dy * dy + dz * dz) + SWING * p.radius * math.sqrt(ax * ax + ay * ay + az * az)
        parts = 1 + int(way / (LONGEST * p.radius))
        passes = turn * p.teeth / (2.0 * math.pi) / parts  # of teeth, in a part
        start, rise, s.ints[FLOOR_NEAR] = pose_from[2], 0.0, -1
        if upright is not None and not tilted:
            start += s.floats[RISE]
            s.ints[FLOOR_NEAR] = floor_near(s, p, pose_from) if p.give > 0.0 else -1
            rise = rise_of_step(s, p, pose_to[2], passes * parts, p.give * turn / (turn + p.lag))
        s.floats[RISE], dz = rise, pose_to[2] + rise - start
        moment = height = thrust = 0.0
        for part in range(parts):
            a, b = part / parts, (part + 1.0) / parts
            x0, y0, z0 = pose_from[0] + a * dx, pose_from[1] + a * dy, start + a * dz
            x1, y1, z1 = pose_from[0] + b * dx, pose_from[1] + b * dy, start + b * dz
            load, removed = (0.0, 0.0, 0.0), s.floats[LEVEL_SUM]
            if flat is not None:
                load = flat_part(s, p, x0, y0, z0, x1, y1, z1, passes, mean)
            if profile is not None:
                # of the type that ``lower_upright`` returns: one ``edge_load`` for both
                used = 2 * p.widths.size, np.int64(0), p.profile.pieces.shape[0] - 1
                motion, frame = (0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                if upright is not None and not tilted:
                    motion, frame, used = lower_upright(s, p, x0, y0, z0, x1, y1, z1, passes)
                if tilts is not None and tilted:
                    motion, frame = lower_tilted(s, p, pose_from, pose_to, a, b, passes)
                if passes > 0.0 and s.floats[LEVEL_SUM] > removed:
                    load = edge_load(s, p, motion, frame, passes, used, tilted, mean)
            moment += load[0]
            height += load[1]
            thrust += load[2]
        for j in range(6):
            mean[j] /= parts
        moment /= parts
        if p.moments and not tilted:
            mean[5] = -p.sense * moment
        for j in range(pose_to.size):
            s.floats[LAST + j] = pose_to[j]
        fresh = turn / (turn + p.lag + p.twist * height / parts)
        faded = 1e-3  # [N, N m] of a tool in the air, which ends the lag: a pass counts where its wrench is not 0
        for j in range(6):
            s.floats[LOAD + j] += fresh * (mean[j] - s.floats[LOAD + j])
            if mean[j] == 0.0 and abs(s.floats[LOAD + j]) < faded:
                s.floats[LOAD + j] = 0.0
            mean[j] = s.floats[LOAD + j]
        s.floats[LOAD + 6] += fresh * (moment - s.floats[LOAD + 6])
        s.floats[THRUST] += fresh * (thrust / parts - s.floats[THRUST])
        torque[k] = s.floats[LOAD + 6]
        volume[k] = (s.floats[LEVEL_SUM] - before) * p.spacing * p.spacing


@compiled
def sweep_teeth(s, p, positions, steps, forces, wrench, torque, volume):
    """``engage`` with the sweep of the teeth; forces: of each micro-step of a single step, filled, or NO_FORCES."""
    for k in range(1, positions.shape[0]):
        before, n = s.floats[LEVEL_SUM], steps[k] - steps[k - 1]
        torque[k] = sweep(s, p, positions[k - 1], positions[k], steps[k - 1], n, forces, wrench[k])
        volume[k] = (s.floats[LEVEL_SUM] - before) * p.spacing * p.spacing
