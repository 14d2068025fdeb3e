"""The motion of a robot program between its points: a C2 spline with an exact stop at both ends of each SPLINE block.

A program has points and no slopes. The planner, the score of a program and the reader of a program take the slopes
from here, so that all of them use the motion that the controller runs. LIN: straight lines, ``velocity=None``.

The rule of a real controller is not public. ``other_motion`` is a second rule for the same points.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from kr270_milling.path.trajectory import AT_REST, Trajectory

__all__ = ["block_ends", "controller_motion", "other_motion", "spline_slopes"]


def block_ends(target: Trajectory) -> np.ndarray:
    """(n,) True at the knots where the slope is given: the first, the stops of the target and the last."""
    ends = target.standing.copy()
    ends[[0, -1]] = True
    return ends


def controller_motion(points: Trajectory, target: Trajectory, stops: np.ndarray | None = None) -> Trajectory:
    """Return the C2 spline in time through the points of the SPLINE blocks of a program for ``target``.

    It rests at the stops (n,) of the blocks; None: ``block_ends`` of a target with the same knots. A target that starts
    or ends in motion, as a straight cut does, gives the spline its velocity at that end.
    """
    stops = block_ends(target) if stops is None else stops
    slopes = np.zeros_like(points.position)
    ends = target.sample_velocity(target.time_ns[[0, -1]])
    slopes[[0, -1]] = np.where(np.linalg.norm(ends, axis=1, keepdims=True) <= AT_REST, 0.0, ends)
    return points.with_position(points.position, spline_slopes(points.time, points.position, stops, slopes))


def other_motion(run: Trajectory, target: Trajectory, share: float, blend_distance: float) -> Trajectory:
    """Return the motion through the points of ``run`` of a controller that joins them by another rule.

    share: 0 is ``run`` itself, 1 the other rule. A spline has the slope of the parabola through a point and its two
    neighbours, v_k = (h_k s_(k-1) + h_(k-1) s_k) / (h_(k-1) + h_k), h the durations and s the slopes of the chords.
    Straight lines are blended by parabolas, which leave their legs at d, the ``blend_distance`` [m] or half a leg, and
    miss the corner by d (e_k - e_(k-1)) / 4, e the directions. The ends and the stops of the target are kept.
    """
    inner = np.linalg.norm(target.sample_velocity(run.time_ns[1:-1]), axis=1) > AT_REST
    move, step = np.diff(run.position, axis=0), np.diff(run.time)[:, None]
    if run.velocity is not None:
        slope, velocity = move / step, run.velocity.copy()
        local = (step[1:] * slope[:-1] + step[:-1] * slope[1:]) / (step[1:] + step[:-1])
        velocity[1:-1][inner] += share * (local - velocity[1:-1])[inner]
        return run.with_position(run.position, velocity)
    length = np.linalg.norm(move, axis=1, keepdims=True)
    turn = np.diff(move / np.where(length > 0.0, length, 1.0), axis=0)
    distance = np.minimum(blend_distance, np.minimum(length[:-1], length[1:]) / 2.0)
    position = run.position.copy()
    position[1:-1][inner] += share * (distance * turn / 4.0)[inner]
    return run.with_position(position)


def spline_slopes(time: np.ndarray, values: np.ndarray, fixed: np.ndarray, slopes=0.0) -> np.ndarray:
    """Slopes (n, 3) at times (n,) of the cubic spline through ``values`` (n, 3), C2 but at the knots ``fixed`` (n,).

    There the slope is that of ``slopes`` (n, 3), and the spline C1. The first and the last knot must be fixed.
    """
    step = np.diff(time)
    slope = np.diff(values, axis=0) / step[:, None]
    below, middle, above = np.zeros(time.size), np.ones(time.size), np.zeros(time.size)
    right = np.array(np.broadcast_to(slopes, values.shape))
    inner = 1 + np.flatnonzero(~fixed[1:-1])
    below[inner], above[inner] = step[inner], step[inner - 1]  # C2
    middle[inner] = 2.0 * (step[inner] + step[inner - 1])
    right[inner] = 3.0 * (step[inner, None] * slope[inner - 1] + step[inner - 1, None] * slope[inner])
    bands = np.stack([np.append(0.0, above[:-1]), middle, np.append(below[1:], 0.0)])
    return solve_banded((1, 1), bands, right)
