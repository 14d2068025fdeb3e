"""Trajectories that are splines."""

import numpy as np
from scipy.interpolate import CubicSpline

from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory

__all__ = ["spline"]


def spline(time_ns, position, quaternion=TOOL_DOWN, ends="natural") -> Trajectory:
    """The C2 cubic spline through the positions [m], (n, 3), as knots with velocities.

    ends: "natural", "not-a-knot", "clamped" (at rest), or a pair of end velocities [m/s].
    """
    line = Trajectory(time_ns, position, quaternion)
    if not isinstance(ends, str):
        ends = tuple((1, np.asarray(v, float)) for v in ends)
    velocity = CubicSpline(line.time, line.position, axis=0, bc_type=ends)(line.time, 1)
    return line.with_position(line.position, velocity)
