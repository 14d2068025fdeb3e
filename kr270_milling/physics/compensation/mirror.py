"""The static mirror (30)-(32), Fig. 8: the target point that the load moves onto the programmed point."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ModelError
from kr270_milling.base.frames import Pose
from kr270_milling.physics.robot import Arm, Mount, equilibrium, inverse_near

LEVER = 0.1  # [m]; weighs a rotation against a displacement in the convergence measure: about a tool's length


def loaded_pose(arm: Arm, mount: Mount, joints, wrench, sag_compensated: bool, tool_compliance: float = 0.0) -> Pose:
    """t_F = f^-1(F | t_0), (30): loaded tool pose for commanded joints (n, 6), under wrenches (n, 6), base axes.

    With ``sag_compensated`` the controller sees to it that the link weights alone do not move the tool; they still
    load the arm. tool_compliance [m/N]: of the tool tip against the spindle, lateral, in series with the arm.
    """
    loaded = equilibrium(arm, mount, joints, wrench, gravity=True).pose
    if tool_compliance:
        axis, force = loaded.rotation[..., 2], np.asarray(wrench, float)[..., :3]
        lateral = force - np.sum(force * axis, axis=-1, keepdims=True) * axis
        loaded = Pose(loaded.position + tool_compliance * lateral, loaded.rotation)
    if not sag_compensated:
        return loaded
    sagged = equilibrium(arm, mount, joints, np.zeros_like(wrench), gravity=True).pose
    commanded = equilibrium(arm, mount, joints, np.zeros_like(wrench), gravity=False).pose
    turned = loaded.rotation @ np.swapaxes(sagged.rotation, -1, -2)
    return Pose(commanded.position + loaded.position - sagged.position, turned @ commanded.rotation)


def mirror(
    arm: Arm,
    mount: Mount,
    target: Pose,
    wrench: np.ndarray,
    seed: np.ndarray,
    *,
    tool_compliance: float = 0.0,
    relaxation: float = 0.9,
    sag_compensated: bool = True,
    tolerance: float = 1e-9,
    max_iterations: int = 60,
) -> tuple[Pose, np.ndarray, list[float]]:
    """Solve (31) by the iteration (32) for target poses (n,) in base_link under wrenches (n, 6) [N, N m], base axes.

    Returns the modified target points t_0^(F), the joint positions (n, 6) [rad] that command them, the inverse
    kinetostatic model, and the largest remaining error [m] before each iteration.

    seed: a posture [rad], (6,), of the branch that the first target is on. tolerance [m]; a rotation error counts
    with a lever of 0.1 m. Raises ModelError, and the errors of the inverse kinematics and of the equilibrium.
    """
    wrench = np.broadcast_to(wrench, target.position.shape[:-1] + (6,))
    modified, history = target, []
    for _ in range(max_iterations):
        joints = inverse_near(arm, mount, modified, seed)
        loaded = loaded_pose(arm, mount, joints, wrench, sag_compensated, tool_compliance)
        shift = target.position - loaded.position
        turn = Rotation.from_matrix(target.rotation @ np.swapaxes(loaded.rotation, -1, -2))
        vector = turn.as_rotvec()
        history.append(float(np.max(np.linalg.norm(shift, axis=-1) + LEVER * np.linalg.norm(vector, axis=-1))))
        if history[-1] <= tolerance:
            return modified, joints, history
        step = Rotation.from_rotvec(relaxation * vector).as_matrix()
        modified = Pose(modified.position + relaxation * shift, step @ modified.rotation)  # (32)
    raise ModelError(
        f"the compensated target point did not converge: {history[-1]:.3g} m left after {len(history)} iterations "
        f"of (32), wanted {tolerance:.3g} m; lower compensation.relaxation or check the load"
    )
