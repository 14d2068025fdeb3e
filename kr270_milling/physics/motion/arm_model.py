"""YAML ``dynamics``, and what it makes of the arm's elastostatics and mass: eq. (1) in workpiece axes, along a path."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import Record, parameter, section
from kr270_milling.physics.motion.dynamics import ArmModel, ModalModel, discretise, discretise_reference, modes
from kr270_milling.physics.robot import Arm, Mount, cartesian_mass, compliance, equilibrium, pose, rotate_matrix
from kr270_milling.physics.robot.mass import MODELS


@dataclass(frozen=True, eq=False)
class MeasuredModes(Record):
    """YAML ``dynamics.modes``: a list with one group a mode, or one group of lists; of one posture, at the tool tip.

    A mode of frequency f, ratio zeta and shape phi answers a wrench w on the tool with
    phi (phi . w) / (omega^2 - s^2 + 2 i zeta omega s) at the circular frequency s, omega = 2 pi f; workpiece axes.
    """

    frequency: np.ndarray = parameter([], unit="hz", above=0.0, high=1e4, text="undamped natural frequency of each")
    damping_ratio: np.ndarray = parameter([], low=0.0, high=0.99, text="damping ratio of each mode")
    shape: np.ndarray = parameter(
        [], text="x, y, z [kg^-1/2], rx, ry, rz [rad/m kg^-1/2] of each, mass-normalised; six numbers a mode"
    )

    def check(self) -> None:
        n = self.frequency.size
        if not n <= 6:
            raise ParameterError("frequency_hz", self.frequency.tolist(), "at most 6 modes")
        for key, size in (("damping_ratio", n), ("shape", 6 * n)):
            values = getattr(self, key)
            if values.size != size:
                raise ParameterError(key, values.tolist(), f"a list of {size} numbers for {n} modes")
        shapes = self.shape.reshape(n, 6)
        if n and np.linalg.matrix_rank(shapes) < n:
            raise ParameterError("shape", self.shape.tolist(), "shapes of which none is a combination of the others")


@dataclass(frozen=True, eq=False)
class Dynamics(Record):
    """YAML ``dynamics``: how the arm moves under load."""

    mass_model: str = parameter(
        text="M_C of (25): lumped, all links ride with the tool; consistent, the paper's beams; rigid, rigid links",
        choices=MODELS,
    )
    damping_ratio: float = parameter(low=0.0, high=0.99, text="damping ratio of every mode")
    gravity: bool = parameter(True, text="linearise about the equilibrium under the link weights")
    follow_pose: bool = parameter(
        False, text="stiffness and mass follow the posture along the path; false: at its start"
    )
    posture_spacing: float = parameter(5e-3, unit="mm", above=0.0, high=1000.0, text="way between two such postures")
    reference_inertia: bool = parameter(
        True, text="the reference moves the motor side: F - M r'' in (1); false: (1) as the paper prints it"
    )
    modes: MeasuredModes = section(MeasuredModes)

    def check(self) -> None:
        if self.modes.frequency.size and self.follow_pose:
            raise ParameterError("follow_pose", True, "false where dynamics.modes are given: they are of one posture")


def modal_models(
    arm: Arm, mount: Mount, dynamics: Dynamics, workpiece: Pose, joints: np.ndarray, tool_compliance: float = 0.0
) -> list[ModalModel]:
    """Modes at postures (n, 6) [rad] in workpiece axes; workpiece: its pose on base_link.

    Where the cell gives measured modes, these at every posture. tool_compliance: of the tool tip [m/N] against the
    spindle, C (1 - z z^T) with z the axis of the tool, in series with the arm.
    """
    models = _arm_modes(arm, mount, dynamics, workpiece, joints)
    if not tool_compliance:
        return models
    axes = pose(arm, mount, joints).rotation[..., 2] @ workpiece.rotation
    lateral = tool_compliance * (np.eye(3) - axes[:, :, None] * axes[:, None, :])
    return [dataclasses.replace(model, tool=bent) for model, bent in zip(models, lateral, strict=True)]


def _arm_modes(arm: Arm, mount: Mount, dynamics: Dynamics, workpiece: Pose, joints: np.ndarray) -> list[ModalModel]:
    if dynamics.modes.frequency.size:
        return [measured_model(dynamics.modes)] * len(joints)
    loaded = equilibrium(arm, mount, joints, np.zeros(joints.shape), gravity=dynamics.gravity)
    to_workpiece = workpiece.rotation.T
    flexible = rotate_matrix(compliance(loaded, arm), to_workpiece)
    inert = rotate_matrix(cartesian_mass(arm, mount, joints, dynamics.mass_model), to_workpiece)
    rounding = 1e-12 * np.abs(inert).max((-2, -1), keepdims=True)
    # turning matrices (n, 6, 6) whose rotations carry no inertia must leave exact zeros there
    return modes(flexible, np.where(np.abs(inert) < rounding, 0.0, 0.5 * (inert + inert.swapaxes(-1, -2))))


def measured_model(measured: MeasuredModes) -> ModalModel:
    """eta'' + 2 zeta omega eta' + omega^2 eta = phi^T F - gamma r'', delta = phi eta.

    gamma = phi^T M for a mass matrix M. No M comes with measured modes, but with six of them phi^T M = phi^-1; with
    fewer, gamma is the least-squares inverse of phi: above all modes the tool stays where it is in every direction in
    which some mode moves it, and follows the reference in the others.
    """
    shapes = measured.shape.reshape(-1, 6).T  # (6, r)
    # distance [m] that counts as much as a radian, where rotation and translation of the reference cannot both be met:
    # a turn about the tool tip moves the edge of an ordinary cutter by it
    lever = 0.01
    weight = np.array([1.0] * 3 + [lever] * 3)
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
    revolution: float = 0.0,
) -> ArmModel:
    """Eq. (1) over one exchange period H [s]; with several models the arm passes one every steps_per_knot periods.

    reference_inertia: with the term -M r'' of the moving reference; approach: see ``ArmModel``. revolution: of the
    spindle T [s]. A compliant tool bends statically, under the mean force of about a revolution; what it does at the
    frequency of the teeth belongs to ``tool.modes``:

        t_k = t_(k-1) + (1 - exp(-H / T)) (C_tool F_k - t_(k-1)),   deflection = delta + t
    """
    rows = {f.name: [getattr(model, f.name) for model in models] for f in dataclasses.fields(ModalModel)}
    every = ModalModel(**{name: np.stack(values) for name, values in rows.items() if values[0] is not None})
    a, b, p, q = discretise(every, damping_ratio, period)
    response = np.zeros((*a.shape[:2], 0))
    if reference_inertia:
        response = discretise_reference(every, damping_ratio, period)
    if every.tool is not None:
        share = -math.expm1(-period / revolution) if revolution else 1.0
        a, b, p, response = _with_tool(a, b, p, response, every.tool, share)
    # in memory as the loops of a pass take them, see ``ArmModel.arrays``
    a, b, p, q, response = (
        np.ascontiguousarray(matrix.swapaxes(-1, -2)).swapaxes(-1, -2) for matrix in (a, b, p, q, response)
    )
    return ArmModel(a, b, p, q, response, float(steps_per_knot), approach)


def _with_tool(a, b, p, response, tool: np.ndarray, share: float) -> tuple[np.ndarray, ...]:
    """A, B, P, R with three more states, the displacement of the tip of the tool: compliances (n, 3, 3) [m/N]."""
    n, order = a.shape[:2]
    larger = np.zeros((n, order + 3, order + 3))
    larger[:, :order, :order] = a
    larger[:, order:, order:] = (1.0 - share) * np.eye(3)
    bent = np.concatenate([share * tool, np.zeros((n, 3, 3))], -1)
    moved = np.broadcast_to(np.eye(6)[:, :3], (n, 6, 3))
    idle = np.zeros((n, 3, response.shape[-1]))
    joined = np.concatenate([b, bent], 1), np.concatenate([p, moved], -1)
    return larger, *joined, np.concatenate([response, idle], 1) if response.shape[-1] else np.zeros((n, order + 3, 0))
