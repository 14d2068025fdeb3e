"""Mass of the arm as the tool feels it: beam matrices (18)-(23), assembly (24), reduction (25), natural frequencies.

Three models. "lumped" is the paper's apparent reading: all links ride with the tool point. "consistent" is the
energy-consistent reduction of the paper's link beams to the tool point; their shapes let links bend and twist that the
stiffness model holds rigid, so that joints 4 and 6 feel 45 % and 33 % of their inertia. "rigid" is the mass that fits
the stiffness model: rigid links on joint springs.
"""

from __future__ import annotations

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.kinematics import LinkFrames, check_regular, cross, forward, jacobian_at, rotate_matrix

MODELS = ("lumped", "consistent", "rigid")
POINT = 1e-9  #: a link shorter than this [m] is a point mass in its end node


def beam_mass(mass: float, length: float, rho_i_p: float, rho_i_y: float, rho_i_z: float) -> np.ndarray:
    """Reduced mass matrix M_j^red (23) of one uniform beam, (12, 12), in its own axes with x along the beam.

    Order: displacement (x, y, z, rx, ry, rz) of the base end, then of the tip [m, rad]. rho_i: section inertia about
    x, y, z per length [kg m]. Exact integrals of (19) with the shapes (20), (21), a Q_j (18) with six entries and a
    D (22) with the sign of right-handed rotations.
    """
    m, l = mass, length
    upper = np.zeros((12, 12))

    def put(row, column, value):
        upper[row - 1, column - 1] = value

    put(1, 1, m / 3), put(1, 7, m / 6), put(7, 7, m / 3)
    for axis in (2, 3):
        put(axis, axis, 17 * m / 35), put(axis, axis + 6, 39 * m / 280), put(axis + 6, axis + 6, 33 * m / 140)
    put(2, 6, 3 * m * l / 35), put(3, 5, -3 * m * l / 35)
    put(6, 8, 11 * m * l / 280), put(5, 9, -11 * m * l / 280)
    put(4, 4, rho_i_p * l / 3), put(4, 10, rho_i_p * l / 6), put(10, 10, rho_i_p * l / 3)
    for axis, rho_i in ((5, rho_i_y), (6, rho_i_z)):
        put(axis, axis, 2 * m * l**2 / 105 + rho_i * l / 5)
        put(axis, axis + 6, 2 * rho_i * l / 15), put(axis + 6, axis + 6, 8 * rho_i * l / 15)
    return upper + np.triu(upper, 1).T


def _link_mass(arm: Arm, j: int) -> np.ndarray:
    """M_j^red of link j = 0..5 in the axes of the link's frame, (12, 12); a thin tube of ``link_section_radius``."""
    vector, mass, radius = arm.link_vectors[j], arm.link_mass[j], arm.link_section_radius[j]
    length = float(np.linalg.norm(vector))
    if length < POINT:
        return np.diag([0.0] * 6 + [mass] * 3 + [0.0] * 3)
    per_length = mass * radius**2 / length  # thin tube: I_p = A r^2, I_y = I_z = A r^2 / 2
    beam = beam_mass(mass, length, per_length, per_length / 2, per_length / 2)
    return rotate_matrix(beam, _axes_along(vector / length))


def _axes_along(x: np.ndarray) -> np.ndarray:
    """A rotation whose first column is the unit vector x; the other two may lie anywhere for a round section."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(x))], x)
    side /= np.linalg.norm(side)
    return np.stack([x, side, np.cross(x, side)], -1)


def assembled_mass(arm: Arm, mount: Mount, frames: LinkFrames) -> np.ndarray:
    """M_tot (24) over the displacements of the nodes O_0..O_6 in base axes, (..., 42, 42).

    Neighbouring links share a node, so their blocks overlap. Spindle and tool are a rigid point mass on O_6.
    """
    total = np.zeros(frames.axes.shape[:-2] + (42, 42))
    for j in range(6):
        span = slice(6 * j, 6 * j + 12)
        total[..., span, span] += rotate_matrix(_link_mass(arm, j), frames.rotations[..., j, :, :])
    offset = np.zeros((3, 6))  # velocity of the mass centre from that of the flange, in flange axes
    offset[:, :3] = np.eye(3)
    offset[:, 3:] = np.cross(np.eye(3), mount.mass_centre).T  # omega x r
    rider = mount.mass * offset.T @ offset
    total[..., 36:, 36:] += rotate_matrix(rider, frames.rotations[..., 5, :, :])
    return total


def joint_mass(arm: Arm, mount: Mount, q) -> np.ndarray:
    """M_theta = sum J_j^T M_j J_j [kg m^2/rad^2], (..., 6, 6): the beams' inertia against the joint springs' motion.

    (..., k + 6, k + 6) of postures with the k turns of a compliant base.
    """
    frames = forward(arm, mount, q)
    nodes = [jacobian_at(frames, frames.nodes[..., j, :], j) for j in range(7)]
    jacobians = np.concatenate(nodes, -2)
    return np.swapaxes(jacobians, -1, -2) @ assembled_mass(arm, mount, frames) @ jacobians


def own_inertia(arm: Arm, j: int) -> np.ndarray:
    """Inertia (3, 3) [kg m^2] of link j = 0..5 about its mass centre, in the axes of its frame.

    A thin tube of length L and radius r: m r^2 along it, m (L^2 / 12 + r^2 / 2) across it.
    """
    vector, mass, radius = arm.link_vectors[j], arm.link_mass[j], arm.link_section_radius[j]
    length = np.linalg.norm(vector)
    if length < POINT:
        return np.zeros((3, 3))
    along = np.outer(vector, vector) / length**2
    return mass * radius**2 * along + mass * (length**2 / 12 + radius**2 / 2) * (np.eye(3) - along)


def spatial_inertia(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(..., 6, 6) about the origin: [[m 1, -m c x], [m c x, I - m c x c x]] for a mass centre c (..., 3) [m].

    inertia: (..., 3, 3) about the mass centre; v . (this) . v is twice the kinetic energy.
    """
    crossing = cross(np.asarray(centre)[..., None, :], np.eye(3))  # rows c x e_k: the matrix of c x, transposed
    out = np.zeros(inertia.shape[:-2] + (6, 6))
    out[..., :3, :3] = mass * np.eye(3)
    out[..., :3, 3:] = mass * crossing
    out[..., 3:, :3] = -mass * crossing
    out[..., 3:, 3:] = inertia - mass * crossing @ crossing
    return out


def _bodies(arm: Arm, mount: Mount, frames: LinkFrames) -> list[np.ndarray]:
    """Spatial inertia (..., 6, 6) of what rides on each joint alone: its link, on joint 6 spindle and tool too."""
    inertias = []
    for j in range(6):
        start, turn = frames.nodes[..., j, :], frames.rotations[..., j, :, :]
        centre = start + arm.link_mass_centre[j] * (frames.nodes[..., j + 1, :] - start)
        inertias.append(
            spatial_inertia(arm.link_mass[j], centre, turn @ own_inertia(arm, j) @ np.swapaxes(turn, -1, -2))
        )
    turn = frames.rotations[..., 5, :, :]
    rider = turn @ np.diag(mount.inertia) @ np.swapaxes(turn, -1, -2)
    inertias[5] = inertias[5] + spatial_inertia(mount.mass, frames.mass_centre, rider)
    return inertias


def rigid_joint_mass(arm: Arm, mount: Mount, q) -> np.ndarray:
    """M_theta [kg m^2/rad^2], (..., n, n), of the composite-rigid-body algorithm: M_ij = S_i^T I_max(i,j) S_j.

    q: (..., 6), or with the k turns of a compliant base, (..., k + 6), which carry all bodies.

    S_j is the velocity (v, omega) of the body point at the origin of base_link, base axes, of a body that joint j turns
    by 1 rad/s, I_j the inertia of all bodies that joint j moves: thin tubes, and spindle and tool on joint 6.
    """
    frames = forward(arm, mount, q)
    screws = np.concatenate([cross(frames.origins, frames.axes), frames.axes], -1)  # S_j, (..., n, 6)
    count = screws.shape[-2]
    mass = np.zeros(screws.shape[:-2] + (count, count))
    composite = np.zeros(screws.shape[:-2] + (6, 6))
    bodies = [np.zeros((6, 6))] * (count - 6) + _bodies(arm, mount, frames)  # nothing rides on the base alone
    for j, body in reversed(list(enumerate(bodies))):
        composite = composite + body
        carried = np.einsum("...ij,...j->...i", composite, screws[..., j, :])
        mass[..., j, : j + 1] = mass[..., : j + 1, j] = np.einsum("...ki,...i->...k", screws[..., : j + 1, :], carried)
    return mass


def cartesian_mass(arm: Arm, mount: Mount, q, model: str = "lumped") -> np.ndarray:
    """M_C [kg, kg m, kg m^2], (..., 6, 6) at the tool point in base axes, for one of MODELS.

    Rigid: M_C = J^-T M_theta J^-1, M_theta of the composite-rigid-body algorithm. Consistent:
    M_C = sum Phi_j^T M_j^red Phi_j, where Phi_j = J_j K^-1 J^T K_C is the motion of node j that goes with one of the
    tool. J being square, K_C = J^-T K J^-1 leaves Phi_j = J_j J^-1 whatever the springs K are, so that the load does
    not enter except through the posture q. Under a compliant base J has k columns more than rows: base and joints
    then move with the tool as Phi = K^-1 J^T K_C says, K the springs without load, and M_C = Phi^T M_theta Phi. Raises
    SingularityError where J has no inverse.
    """
    if model == "lumped":
        mass = float(arm.link_mass.sum()) + mount.mass
        return np.broadcast_to(np.diag([mass] * 3 + [0.0] * 3), np.shape(q)[:-1] + (6, 6)).copy()
    if model not in MODELS:
        raise ParameterError("model", model, "one of " + ", ".join(MODELS))
    check_regular(arm, np.asarray(q, float))
    of_joints = joint_mass if model == "consistent" else rigid_joint_mass
    q = arm.on_base(q)
    frames = forward(arm, mount, q)
    jacobian = jacobian_at(frames, frames.tool.position)
    if arm.base_axes.size:
        bent = arm.spring_compliance[:, None] * np.swapaxes(jacobian, -1, -2)  # K^-1 J^T
        inverse = bent @ np.linalg.inv(jacobian @ bent)
    else:
        inverse = np.linalg.inv(jacobian)
    return np.swapaxes(inverse, -1, -2) @ of_joints(arm, mount, q) @ inverse  # (25) as J^-T M_theta J^-1


def mode_frequencies(compliance: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Natural frequencies [Hz], ascending, (..., modes), of a compliance and a mass matrix (..., n, n) of one point.

    Directions without mass follow statically (they are condensed), so there are as many modes as the mass has rank.
    """
    values, vectors = np.linalg.eigh(mass)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    squares = np.linalg.eigvals(np.swapaxes(root, -1, -2) @ compliance @ root).real  # 1 / omega^2
    squares = -np.sort(-squares, -1)
    moving = squares > 1e-12 * squares[..., :1]
    modes = int(np.max(moving.sum(-1))) if moving.size else 0
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(moving, 1 / (2 * np.pi * np.sqrt(np.abs(squares))), np.inf)[..., :modes]
