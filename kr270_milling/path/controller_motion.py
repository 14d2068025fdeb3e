"""The motion of a robot program between its points: a C2 spline with an exact stop at both ends of each SPLINE block.

A program has points and no slopes. The planner, the score of a program and the reader of a program take the slopes
from here, so that all of them use the motion that the controller runs. LIN: straight lines, ``velocity=None``.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from kr270_milling.path.trajectory import AT_REST, Trajectory

__all__ = ["block_ends", "controller_motion", "spline_slopes"]


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
