"""From the arm's elastostatics and mass to eq. (1) in workpiece axes, at one posture or along a path."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.frames import Pose
from kr270_milling.robot import Arm, Mount, cartesian_mass, compliance, equilibrium
from kr270_milling.simulation.dynamics import ArmModel, ModalModel, discretise, discretise_reference, modes
from kr270_milling.simulation.measured_modes import measured_model
from kr270_milling.simulation.parameters import Dynamics

__all__ = ["arm_model", "modal_models"]


def modal_models(arm: Arm, mount: Mount, dynamics: Dynamics, workpiece: Pose, joints: np.ndarray) -> list[ModalModel]:
    """Modes at postures (n, 6) [rad] in workpiece axes; workpiece: its pose on base_link.

    Where the cell gives measured modes, these at every posture.
    """
    if dynamics.modes.frequency.size:
        return [measured_model(dynamics.modes)] * len(joints)
    loaded = equilibrium(arm, mount, joints, np.zeros(joints.shape), gravity=dynamics.gravity)
    turn = np.kron(np.eye(2), workpiece.rotation.T)  # base axes -> workpiece axes, translations and rotations
    flexible = turn @ compliance(loaded, arm) @ turn.T
    inert = turn @ cartesian_mass(arm, mount, joints, dynamics.mass_model) @ turn.T
    return [modes(c, _clean(m)) for c, m in zip(flexible, inert, strict=True)]


def _clean(mass: np.ndarray) -> np.ndarray:
    """Turning a matrix whose rotations carry no inertia must leave exact zeros there."""
    return np.where(np.abs(mass) < 1e-12 * np.abs(mass).max(), 0.0, 0.5 * (mass + mass.T))


def arm_model(
    models: list[ModalModel],
    damping_ratio: float,
    period: float,
    steps_per_knot: float = 1.0,
    reference_inertia: bool = False,
    approach: np.ndarray | None = None,
) -> ArmModel:
    """Eq. (1) over one exchange period [s]; with several models the arm passes one every steps_per_knot periods.

    reference_inertia: with the term -M r'' of the moving reference; approach: see ``ArmModel``.
    """
    stacked = zip(*(discretise(m, damping_ratio, period) for m in models), strict=True)
    a, b, p, q = (np.ascontiguousarray(s) for s in map(np.stack, stacked))
    response = np.zeros((*a.shape[:2], 0))
    if reference_inertia:
        response = np.stack([discretise_reference(m, damping_ratio, period) for m in models])
    return ArmModel(a, b, p, q, np.ascontiguousarray(response), float(steps_per_knot), approach)
