"""From the arm's elastostatics and mass to eq. (1) in workpiece axes, at one posture or along a path."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.frames import Pose
from kr270_milling.robot import Arm, Mount, cartesian_mass, compliance, equilibrium
from kr270_milling.simulation.dynamics import ArmModel, ModalModel, discretise, discretise_reference, modes
from kr270_milling.simulation.parameters import Dynamics, MeasuredModes

__all__ = ["arm_model", "measured_model", "modal_models"]

#: where rotation and translation of the reference cannot both be met, a radian counts as much as this way [m]:
#: what a turn about the tool tip moves at the radius of an ordinary cutter
RADIUS = 0.01


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


def measured_model(measured: MeasuredModes) -> ModalModel:
    """eta'' + 2 zeta omega eta' + omega^2 eta = phi^T F - gamma r'', delta = phi eta.

    gamma = phi^T M for a mass matrix M. No M comes with measured modes, but with six of them phi^T M = phi^-1; with
    fewer, gamma is the least-squares inverse of phi: above all modes the tool stays where it is in every direction in
    which some mode moves it, and follows the reference in the others.
    """
    shapes = measured.shape.reshape(-1, 6).T  # (6, r)
    weight = np.array([1.0] * 3 + [RADIUS] * 3)
    r = measured.frequency.size
    return ModalModel(
        inertial=np.arange(r),
        frequency=2 * np.pi * measured.frequency,
        shape=np.eye(r),
        mass=np.eye(r),
        force=shapes.T,
        output=shapes,
        feedthrough=np.zeros((6, 6)),
        reference=np.linalg.pinv(weight[:, None] * shapes) * weight,
        damping=measured.damping_ratio,
    )


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
