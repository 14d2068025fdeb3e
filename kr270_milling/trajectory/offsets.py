"""What a revision moves: the revised trajectory minus the original one, at every tick of a controller."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.frames import abc_from_rotation, rotation_from_quaternion
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["offsets"]


def offsets(original: Trajectory, revised: Trajectory, tick_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Revised minus original at every tick: times [ns], (m,), shifts [m], (m, 3), turns as A, B, C [rad], (m, 3).

    Shifts and turns stand in the axes of the trajectories' frame ($BASE); a turn carries the original orientation into
    the revised one.
    """
    if original.duration_ns != revised.duration_ns or original.frame != revised.frame:
        raise TrajectoryError("the original and the revised trajectory must share duration and frame")
    time_ns = np.arange(0, original.duration_ns + tick_ns, tick_ns)
    before, after = (rotation_from_quaternion(t.sample_orientation(time_ns)) for t in (original, revised))
    turn = abc_from_rotation(after @ np.swapaxes(before, 1, 2))
    return time_ns, revised.sample(time_ns) - original.sample(time_ns), turn
