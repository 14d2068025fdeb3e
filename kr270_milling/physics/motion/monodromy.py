"""Stability of milling against regenerative chatter: Floquet multipliers over one tooth period.

Modes q_i'' + 2 zeta_i w_i q_i' + w_i^2 q_i = phi_i . F carry the tool tip, u = sum phi_i q_i. A tooth at the angle
with unit vector e (radial) and t (direction of motion) removes the dynamic chip e . (u(t) - u(t - tau)), so that

    F(t) = a B(t) (u(t) - u(t - tau)),   B = - sum over the teeth in cut of (K_r e + K_t t - K_a z) e^T

with a the depth of cut, tau the tooth period and K = dF/dh per depth at the static chip thickness. Between two of m
nodes the force is a straight line, for which each mode is advanced exactly; B at a node is its mean over the interval
about it. The method is of second order in tau / m, as the first-order semi-discretisation of [Insperger2004] is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

__all__ = ["Modes", "directional_matrices", "multipliers"]

KRYLOV = 40  #: vectors; 30 give the largest multiplier of 400 states to 1e-11
FINE = 20  #: angles in the interval about a node over which B is averaged


@dataclass(frozen=True, eq=False)
class Modes:
    """n modes at the tool tip, workpiece axes."""

    frequency: np.ndarray  #: undamped [rad/s], (n,)
    damping_ratio: np.ndarray  #: (n,)
    shape: np.ndarray  #: mass-normalised, of the translations [kg^-1/2], (n, 3)


def directional_matrices(gradients, sense: float, teeth: int, entry: float, leave: float, nodes: int) -> np.ndarray:
    """B at the nodes of one tooth period [N/m^2], (nodes, 3, 2).

    gradients(s): K_t, K_r, K_a [N/m^2] for an array of sines s of the engagement angle psi, at the chip thickness
    f_z s; entry, leave: psi [rad] from where a full slot is entered; sense: -1 for a spindle clockwise from +z.
    """
    pitch = 2.0 * np.pi / teeth
    offsets = (np.arange(FINE) + 0.5) / FINE - 0.5
    psi = (np.arange(nodes)[:, None] + offsets) * pitch / nodes  # of one tooth, the others follow at the pitch
    total = np.zeros((nodes, 3, 2))
    for tooth in range(teeth):
        angle = np.mod(psi + tooth * pitch, 2.0 * np.pi)
        cut = (angle > entry) & (angle < leave)
        phi = angle - 0.5 * np.pi  # from the feed, +x
        radial = np.stack([np.cos(phi), sense * np.sin(phi)], -1)
        motion = np.stack([-np.sin(phi), sense * np.cos(phi)], -1)
        k_t, k_r, k_a = (np.where(cut, k, 0.0) for k in gradients(np.abs(np.sin(angle))))
        plane = -(k_r[..., None] * radial + k_t[..., None] * motion)
        force = np.concatenate([plane, -k_a[..., None]], axis=-1)  # k_a above 0 pulls the tool toward the part, -z
        total += np.einsum("kfi,kfj->kij", force, radial) / FINE
    return total


def multipliers(modes: Modes, matrices: np.ndarray, depth: float, delay: float) -> np.ndarray:
    """Floquet multipliers over one tooth period; matrices: B at the nodes (m, 3, 2); delay: tau [s].

    Of more than 2 KRYLOV states only the KRYLOV Ritz values of Arnoldi's method: the multipliers of a delay die out
    toward 0, so the largest, which decide stability, are among them to rounding.
    """
    rows, shape, loads = _advance(modes, delay / len(matrices)), modes.shape, depth * matrices
    # F = B (u - u_delayed) at the end of a step, where u = free + gain F: F = B (1 - gain B)^-1 (free - u_delayed)
    gain = (shape[:, :2].T * rows[:, 0, 3]) @ shape
    ends = np.roll(loads, -1, axis=0)
    ends = ends @ np.linalg.inv(np.eye(2) - gain @ ends)
    size = 2 * (len(modes.frequency) + len(matrices))
    if size > 2 * KRYLOV:
        return np.linalg.eigvals(_arnoldi(rows, shape, loads, ends, size, KRYLOV))
    return np.linalg.eigvals(np.column_stack([_period(rows, shape, loads, ends, start) for start in np.eye(size)]))


def _advance(modes: Modes, step: float) -> np.ndarray:
    """Rows of (q, q') after a step h: from q, q', forces at the start and the end of the step; (n, 2, 4).

    a is the free vibration. A force 1 leaves q = (1 - a11) / w^2, and a force t / h leaves
    q = (1 - a12 / h - 2 zeta (1 - a11) / (w h)) / w^2; q' is the derivative of each by the time.
    """
    w, zeta = modes.frequency, modes.damping_ratio
    damped = w * np.sqrt(1.0 - zeta * zeta)
    decay, c, s = np.exp(-zeta * w * step), np.cos(damped * step), np.sin(damped * step)
    a11, a12 = decay * (c + zeta * w / damped * s), decay * s / damped
    a21, a22 = -decay * w * w / damped * s, decay * (c - zeta * w / damped * s)
    end = (1.0 - a12 / step - 2.0 * zeta * (1.0 - a11) / (w * step)) / w**2
    end_rate = (1.0 - a22 + 2.0 * zeta * a21 / w) / (w**2 * step)
    rows = np.array([[a11, a12, (1.0 - a11) / w**2 - end, end], [a21, a22, -a21 / w**2 - end_rate, end_rate]])
    return np.ascontiguousarray(np.moveaxis(rows, -1, 0))


@njit(cache=True, nogil=True)
def _arnoldi(rows, shape, loads, ends, size, count):
    """H = V^T M V (count, count), V an orthonormal basis of v, M v, M^2 v, ...; M the map of one tooth period."""
    basis, small = np.zeros((count + 1, size)), np.zeros((count + 1, count))
    start = np.cos(np.arange(size) ** 2.0)  # a part of everything
    length = np.linalg.norm(start)
    for i in range(size):  # one by one: Numba compiles the sentence on shapes of a slice for seconds
        basis[0, i] = start[i] / length
    for k in range(count):
        image = _period(rows, shape, loads, ends, basis[k])
        for _ in range(2):  # twice is enough
            share = basis[: k + 1] @ image
            for i in range(k + 1):
                small[i, k] += share[i]
            image = image - share @ basis[: k + 1]
        length = np.linalg.norm(image)
        if length < 1e-14:
            return small[: k + 1, : k + 1].copy()
        small[k + 1, k] = length
        for i in range(size):
            basis[k + 1, i] = image[i] / length
    return small[:count].copy()


@njit(cache=True, nogil=True)
def _period(rows, shape, loads, ends, start):
    """The state (q (n), q' (n), u of the last period at its m nodes (m, 2), oldest first) after m steps."""
    n, m = shape.shape[0], loads.shape[0]
    q, rate = start[:n].copy(), start[n : 2 * n].copy()
    past = np.zeros((2 * m, 2))  # u at the nodes: m of the period before, then those of this one
    for k in range(m):
        past[k, 0], past[k, 1] = start[2 * (n + k)], start[2 * (n + k) + 1]
    for k in range(m):
        past[m + k, 0], past[m + k, 1] = _tip(shape, q)
        x, y, z = _force(loads[k], past[m + k], past[k])
        for i in range(n):
            load = shape[i, 0] * x + shape[i, 1] * y + shape[i, 2] * z
            before = q[i]
            q[i] = rows[i, 0, 0] * before + rows[i, 0, 1] * rate[i] + rows[i, 0, 2] * load
            rate[i] = rows[i, 1, 0] * before + rows[i, 1, 1] * rate[i] + rows[i, 1, 2] * load
        x, y, z = _force(ends[k], _tip(shape, q), past[k + 1])
        for i in range(n):
            load = shape[i, 0] * x + shape[i, 1] * y + shape[i, 2] * z
            q[i] += rows[i, 0, 3] * load
            rate[i] += rows[i, 1, 3] * load
    return np.concatenate((q, rate, past[m:].copy().reshape(2 * m)))


@njit(cache=True, nogil=True)
def _tip(shape, q):
    """u, the sum of phi_i q_i, along x and y."""
    x, y = 0.0, 0.0
    for i in range(len(q)):
        x += shape[i, 0] * q[i]
        y += shape[i, 1] * q[i]
    return x, y


@njit(cache=True, nogil=True)
def _force(matrix, u, delayed):
    x, y = u[0] - delayed[0], u[1] - delayed[1]
    return (
        matrix[0, 0] * x + matrix[0, 1] * y,
        matrix[1, 0] * x + matrix[1, 1] * y,
        matrix[2, 0] * x + matrix[2, 1] * y,
    )
