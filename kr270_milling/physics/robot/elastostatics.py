"""Elastostatics of [Klimchik2014]: the loaded equilibrium (7)-(10) and its Cartesian stiffness (11)-(17).

One virtual spring per joint: the links are at q + theta when the motors are at q. A compliant ground adds k springs in
front of joint 1, about axes of base_link (``Arm.base_axes``): axes of the chain without a motor. Base_link axes, tool
point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import Pose
from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.errors import DeflectionError, EquilibriumError, UnstableLoadError
from kr270_milling.physics.robot.kinematics import LinkFrames, check_regular, forward, jacobian_at
from kr270_milling.physics.robot.loads import GRAVITY, LinkLoads, link_loads, load_hessian, load_torque, moment_arms

RESIDUAL = 1e-9  #: a solved equilibrium is out of balance by no more than this [N m]
ITERATIONS = 25
#: a larger joint deflection [rad] is believed only when the load path leads there
LARGE = 0.05


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A loaded arm at rest, one or a batch."""

    wrench: np.ndarray  #: on the tool at the tool point, base axes [N, N m], (..., 6)
    tilt: np.ndarray  #: rotation of the base about its k compliant axes [rad], (..., k)
    theta: np.ndarray  #: deflection of the joint springs [rad], (..., 6)
    posture: np.ndarray  #: q + theta [rad], (..., 6)
    pose: Pose  #: pose of the loaded tcp in base_link
    jacobian: np.ndarray  #: at the tool point in the loaded posture, (..., 6, k + 6): base, then joints
    hessian: np.ndarray  #: H_theta_theta [N m/rad], (..., k + 6, k + 6)
    residual: np.ndarray  #: largest torque out of balance [N m], (...,)
    iterations: np.ndarray  #: Newton steps, (...,)


def equilibrium(arm: Arm, mount: Mount, q, wrench=None, gravity: bool = True) -> Equilibrium:
    """The loaded equilibrium of postures q [rad], (..., 6), under wrenches (..., 6): f^-1 of section 5.

    Newton iteration on (7) with its exact derivative K_theta - H (16). Where that fails or ends far away, the load is
    applied in steps. Raises UnstableLoadError, DeflectionError and EquilibriumError.
    """
    wrench = np.zeros(6) if wrench is None else wrench
    shape = np.broadcast_shapes(np.shape(q), np.shape(wrench))[:-1]
    q, wrench = arm.on_base(_flat(shape, q, 6)), _flat(shape, wrench, 6)
    loads = link_loads(arm, mount, GRAVITY if gravity else 0.0)
    theta, residual, count, frames = _newton(arm, mount, q, wrench, loads, np.zeros_like(q))
    doubtful = ~(residual <= RESIDUAL) | ~(np.abs(theta).max(-1) < LARGE)
    bent = load_hessian(frames, wrench, loads)
    doubtful |= ~_stable(arm, bent)
    for i in np.flatnonzero(doubtful).tolist():
        theta[i], residual[i], steps = _by_load_steps(arm, mount, q[i], wrench[i], loads, _index(i, shape))
        count[i] += steps
    if doubtful.any():
        frames = forward(arm, mount, q + theta)
        bent = load_hessian(frames, wrench, loads)
    return _record(wrench, theta, q, frames, bent, residual, count, shape)


def _record(wrench, theta, q, frames: LinkFrames, bent, residual, iterations, shape: tuple) -> Equilibrium:
    """The solved equilibria, so far n in a row, as a batch of this shape."""
    tool = frames.tool
    jacobian = jacobian_at(frames, tool.position)
    tilt, posture = np.split(q + theta, [-6], axis=-1)
    flat = (wrench, tilt, theta[:, -6:], posture, tool.position, tool.rotation, jacobian, bent, residual, iterations)
    wrench, tilt, theta, posture, *place, jacobian, bent, residual, iterations = (
        values.reshape(shape + values.shape[1:]) for values in flat
    )
    return Equilibrium(wrench, tilt, theta, posture, Pose(*place), jacobian, bent, residual, iterations)


def _index(i: int, shape: tuple) -> tuple:
    """Place in the batch of the i-th of its flattened members."""
    return tuple(int(k) for k in np.unravel_index(i, shape)) if shape else ()


def _flat(shape: tuple, values, *member: int) -> np.ndarray:
    """A copy of values, broadcast to a batch of members, as (n, *member)."""
    return np.broadcast_to(np.asarray(values, float), shape + member).reshape(-1, *member).copy()


def _newton(arm, mount, q, wrench, loads, theta):
    """(theta, residual, steps, frames) of each of the (n, k + 6) problems; a large or NaN residual: diverged."""
    theta = theta.copy()
    residual, count = np.full(len(q), np.inf), np.zeros(len(q), int)
    todo = np.arange(len(q))
    for _ in range(ITERATIONS):
        frames = forward(arm, mount, q[todo] + theta[todo])
        masses = moment_arms(frames, loads)
        error = load_torque(frames, wrench[todo], loads, masses) - arm.spring_stiffness * theta[todo]
        residual[todo] = np.abs(error).max(-1)
        going = (residual[todo] > RESIDUAL) & (np.abs(theta[todo]).max(-1) < np.pi)
        if not going.any():
            break
        springs = np.diag(arm.spring_stiffness) - load_hessian(frames, wrench[todo], loads, masses)
        todo = todo[going]
        theta[todo] += _solve(springs[going], error[going])
        count[todo] += 1
    whole = todo.size == len(q) and not going.any()  # the frames are those of all, and of the last theta
    return theta, residual, count, frames if whole else forward(arm, mount, q + theta)


def _solve(matrix, right):
    """Solutions of many small systems; NaN for a singular one, which its caller then finds."""
    try:
        return np.linalg.solve(matrix, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        regular = np.abs(np.linalg.det(matrix)) > 0
        solution = np.full(right.shape, np.nan)
        solution[regular] = np.linalg.solve(matrix[regular], right[regular, :, None])[..., 0]
        return solution


def _stable(arm: Arm, hessian: np.ndarray) -> np.ndarray:
    """(n,): whether every small motion is opposed, that is, K_theta - H has a positive symmetric part."""
    springs = np.diag(arm.spring_stiffness) - hessian
    springs = springs + np.swapaxes(springs, -1, -2)
    try:
        np.linalg.cholesky(springs)
        return np.ones(len(springs), bool)
    except np.linalg.LinAlgError:
        return np.array([np.isfinite(s).all() and np.linalg.eigvalsh(s)[0] > 0 for s in springs])


def _by_load_steps(arm, mount, q, wrench, loads: LinkLoads, index: tuple):
    """(theta, residual, iterations) of one posture, (k + 6,), its load raised from nothing in adaptive steps."""
    theta, carried, step, count = np.zeros((1, q.size)), 0.0, 0.25, 0
    residual = np.inf
    too_large = 0.2  # and a still larger one is refused: drives and bearings are no linear springs over 10 deg
    while carried < 1.0:
        share = min(1.0, carried + step)
        part = loads.part(share)
        trial, left, steps, frames = _newton(arm, mount, q[None], share * wrench[None], part, theta)
        count += int(steps[0])
        if left[0] <= RESIDUAL and np.abs(trial - theta).max() < LARGE:
            bent = load_hessian(frames, share * wrench[None], part)
            if not _stable(arm, bent)[0]:
                springs = np.diag(arm.spring_stiffness) - bent[0]
                raise UnstableLoadError(share, float(np.linalg.eigvalsh((springs + springs.T) / 2)[0]), index)
            theta, residual, carried, step = trial, left[0], share, 2 * step
            if np.abs(theta).max() > too_large:
                worst = int(np.argmax(np.abs(theta)))
                joint = max(0, worst + 7 - q.size)  # 0: the base
                raise DeflectionError(joint, float(theta[0, worst]), too_large, carried, index)
            continue
        residual, step = left[0], step / 2
        if step < 1 / 512:  # a load path that needs smaller steps ends at a limit point
            raise EquilibriumError(float(residual), count, carried, index)
    return theta[0], residual, count


def wrench_for_pose(arm: Arm, mount: Mount, q, pose: Pose, gravity: bool = True) -> Equilibrium:
    """The equilibrium whose loaded tool is at ``pose`` while the motors are at q: f of section 5.

    Unknown are theta and F of (7). Where (10) keeps the Jacobians from step to step, this takes the whole derivative
    (16), so that the convergence is quadratic. Raises SingularityError and EquilibriumError.
    """
    shape = np.broadcast_shapes(np.shape(q)[:-1], pose.position.shape[:-1])
    q = arm.on_base(_flat(shape, q, 6))
    target = Pose(_flat(shape, pose.position, 3), _flat(shape, pose.rotation, 3, 3))
    loads = link_loads(arm, mount, GRAVITY if gravity else 0.0)
    theta, wrench = np.zeros_like(q), np.zeros((len(q), 6))
    for count in range(ITERATIONS + 1):
        check_regular(arm, (q + theta)[:, -6:])
        frames = forward(arm, mount, q + theta)
        turn = Rotation.from_matrix(target.rotation @ np.swapaxes(frames.tool.rotation, -1, -2)).as_rotvec()
        missing = np.concatenate([target.position - frames.tool.position, turn], -1)
        balance = load_torque(frames, wrench, loads) - arm.spring_stiffness * theta
        residual = np.abs(balance).max(-1)
        # the pose is met within 1e-12 m and rad
        going = ~((residual <= RESIDUAL) & (np.abs(missing).max(-1) <= 1e-12))
        if not going.any() or count == ITERATIONS:
            break
        change = _solve(_system(arm, frames, wrench, loads), np.concatenate([missing, -balance], -1))  # (16)
        wrench[going] += change[going, :6]
        theta[going] += change[going, 6:]
    if going.any():
        i = int(np.flatnonzero(going)[0])
        raise EquilibriumError(float(residual[i]), count, 0.0, _index(i, shape))
    bent = load_hessian(frames, wrench, loads)
    return _record(wrench, theta, q, frames, bent, residual, np.full(len(q), count), shape)


def _system(arm: Arm, frames, wrench, loads) -> np.ndarray:
    """The block matrix of (16), (n, k + 12, k + 12)."""
    jacobian = jacobian_at(frames, frames.tool.position)
    size = 6 + jacobian.shape[-1]
    system = np.zeros(wrench.shape[:-1] + (size, size))
    system[..., :6, 6:] = jacobian
    system[..., 6:, :6] = np.swapaxes(jacobian, -1, -2)
    system[..., 6:, 6:] = load_hessian(frames, wrench, loads) - np.diag(arm.spring_stiffness)
    return system


def compliance(equilibrium: Equilibrium, arm: Arm) -> np.ndarray:
    """C_C = J (K_theta - H)^-1 J^T at the equilibrium, (..., 6, 6) in base axes; exists in singular postures too."""
    jacobian = equilibrium.jacobian
    springs = np.diag(arm.spring_stiffness) - equilibrium.hessian
    return jacobian @ np.linalg.solve(springs, np.swapaxes(jacobian, -1, -2))  # (17), its inverse


def stiffness(equilibrium: Equilibrium, arm: Arm) -> np.ndarray:
    """K_C at the equilibrium, (..., 6, 6) in base axes; raises SingularityError where J has no inverse."""
    check_regular(arm, equilibrium.posture)
    if arm.base_axes.size:
        return np.linalg.inv(compliance(equilibrium, arm))
    inverse = np.linalg.inv(equilibrium.jacobian)
    springs = np.diag(arm.spring_stiffness) - equilibrium.hessian
    return np.swapaxes(inverse, -1, -2) @ springs @ inverse  # (17) for a square J
