"""The lifted model of a cell: how its tool follows a change of the reference along its path."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.compensation.response import ArmResponse
from kr270_milling.simulation.arm_model import modal_models
from kr270_milling.simulation.dynamics import ModalModel
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["arm_response"]


def arm_response(cell: Cell, target: Trajectory) -> ArmResponse:
    """The modes of the arm on each segment of the target, at one posture or along the path, as the pass has them."""
    if not cell.dynamics.follow_pose:
        return _response(cell, [cell.modal_model], np.zeros(len(target) - 1, int))
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(target.position, axis=0), axis=1))])
    place = np.rint(0.5 * (way[1:] + way[:-1]) / cell.dynamics.posture_spacing).astype(int)
    _, first, posture = np.unique(place, return_index=True, return_inverse=True)
    middle = (target.time_ns[1:] + target.time_ns[:-1])[first] // 2
    joints = cell.joints_at(target.sample(middle), target.sample_orientation(middle))
    models = modal_models(cell.arm, cell.mount, cell.dynamics, cell.workpiece.pose, joints)
    return _response(cell, models, posture)


def _response(cell: Cell, models: list[ModalModel], posture: np.ndarray) -> ArmResponse:
    """posture: number of the model of each segment, (m,)."""
    inward = [(model.shape.T @ model.mass @ model.reference)[:, :3] for model in models]
    ratios = [np.broadcast_to(cell.dynamics.damping_ratio if m.damping is None else m.damping, m.frequency.shape)
              for m in models]  # fmt: skip
    after = np.append(posture[1:], posture[-1])
    carry = np.array([_carry(models[k], models[n]) for k, n in zip(posture.tolist(), after.tolist(), strict=True)])

    def along(rows) -> np.ndarray:
        return np.ascontiguousarray(np.stack(rows)[posture])

    return ArmResponse(
        frequency=along([model.frequency for model in models]),
        damping=along(ratios),
        inward=along(inward),
        outward=along([(model.output @ model.shape)[:3] for model in models]),
        push=along([model.shape.T @ model.force for model in models]),
        carry=np.ascontiguousarray(carry),
        moves=cell.dynamics.reference_inertia,
    )


def _carry(before: ModalModel, after: ModalModel) -> np.ndarray:
    """The displacement stays from one posture to the next: u_after = Phi_after^T M_after Phi_before u_before."""
    if before is after:
        return np.eye(before.frequency.size)
    return after.shape.T @ after.mass @ before.shape
