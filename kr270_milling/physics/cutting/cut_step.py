"""Step of a cutting model for compiled loops; the type of the state chooses the model at compilation."""

from __future__ import annotations

from numba import njit, types
from numba.extending import overload

from kr270_milling.physics.cutting.engagement import EngagementState, engage, has_profile, undo_engagement
from kr270_milling.physics.cutting.revolution import undo_revolution
from kr270_milling.physics.cutting.state import LEVEL_SUM, State
from kr270_milling.physics.cutting.sweep import sweep, undo


def _step(s, p, pose_from, pose_to, first, n, forces, wrench):
    """Plain form of compiled code; see ``cut_step``."""
    raise NotImplementedError


def _undo(s):
    """Plain form of compiled code; see ``cut_undo``."""
    raise NotImplementedError


def _is(state, kind) -> bool:
    return isinstance(state, types.NamedTuple) and state.instance_class is kind


@overload(_step, inline="always")
def _step_of(s, p, pose_from, pose_to, first, n, forces, wrench):
    if _is(s, State):
        return lambda s, p, pose_from, pose_to, first, n, forces, wrench: sweep(
            s, p, pose_from, pose_to, first, n, forces, wrench
        )
    if _is(s, EngagementState):
        return lambda s, p, pose_from, pose_to, first, n, forces, wrench: engage(s, p, pose_from, pose_to, n, wrench)
    return None


@overload(_undo, inline="always")
def _undo_of(s):
    if _is(s, State):
        return lambda s: undo(s)
    if _is(s, EngagementState) and has_profile(s):
        return lambda s: undo_revolution(s)
    if _is(s, EngagementState):
        return lambda s: undo_engagement(s)
    return None


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def cut_step(s, p, pose_from, pose_to, first, n, forces, wrench):
    """Move the tool tip straight from one position (3,) [m] to another in n micro-steps of the spindle angle.

    s, p: state, changed, and params of either model; first: number of the first micro-step since the pass began;
    forces: (n, 3), filled with the force of each micro-step [N] by the sweep of the teeth, or NO_FORCES; wrench: (6,),
    filled with the mean wrench on the tool [N, N m]. Returns the mean spindle torque [N m].
    """
    return _step(s, p, pose_from, pose_to, first, n, forces, wrench)


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def cut_undo(s):
    """Take the last step back; False where the undo log was too small and nothing was done."""
    return _undo(s)


@njit(cache=True, error_model="numpy", nogil=True)  # several workpieces are cut at once
def cut_poses(s, p, positions, steps, no_forces, wrench, torque, volume):
    """Cut from each position (n, 3) [m] to the next, which is reached at micro-steps (n,) counted from the start.

    Fills the rows from 1 on: mean wrench (n, 6) [N, N m], mean torque (n,) [N m], removed volume (n,) [m^3].
    """
    per_node = p.spacing * p.spacing
    for k in range(1, positions.shape[0]):
        before = s.floats[LEVEL_SUM]
        torque[k] = _step(
            s, p, positions[k - 1], positions[k], steps[k - 1], steps[k] - steps[k - 1], no_forces, wrench[k]
        )
        volume[k] = (s.floats[LEVEL_SUM] - before) * per_node
