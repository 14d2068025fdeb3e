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
    toward 0, so the largest, which tell stability, are among them to rounding.
    """
    step = delay / len(matrices)
    rows, loads = _advance(modes, step), depth * matrices
    size = 2 * (len(modes.frequency) + len(matrices))
    if size <= 2 * KRYLOV:
        return np.linalg.eigvals(_period(rows, modes.shape, loads, np.eye(size)))
    return np.linalg.eigvals(_arnoldi(rows, modes.shape, loads, KRYLOV))


def _advance(modes: Modes, step: float) -> np.ndarray:
    """Rows of (q, q') after a step: from q, q', force at its start, force at its end; (n, 2, 4).

    For q'' + 2 zeta w q' + w^2 q = f0 + (f1 - f0) t / h the particular solution is f0 / w^2 + (f1 - f0) / (h w^2)
    (t - 2 zeta / w); the rest is the free motion from what it leaves at t = 0.
    """
    w, z, h = modes.frequency, modes.damping_ratio, step
    damped = w * np.sqrt(1.0 - z * z)
    decay, c, s = np.exp(-z * w * h), np.cos(damped * h), np.sin(damped * h)
    a11, a12 = decay * (c + z * w / damped * s), decay * s / damped
    a21, a22 = -decay * w * w / damped * s, decay * (c - z * w / damped * s)
    lag, slope = 2.0 * z / w, 1.0 / (h * w * w)
    # a ramp f = t / h from rest: particular (t - lag) slope, so free motion starts with (lag slope, -slope)
    end = (h - lag) * slope + a11 * lag * slope - a12 * slope
    end_rate = slope + a21 * lag * slope - a22 * slope
    held, held_rate = (1.0 - a11) / w**2, -a21 / w**2
    return np.stack(
        [np.stack([a11, a12, held - end, end], -1), np.stack([a21, a22, held_rate - end_rate, end_rate], -1)], 1
    )


@njit(cache=True, nogil=True)
def _arnoldi(rows, shape, matrices, count):
    """H = V^T M V (count, count), V an orthonormal basis of v, M v, M^2 v, ...; M the map of one tooth period."""
    size = 2 * (shape.shape[0] + matrices.shape[0])
    basis, small = np.zeros((count + 1, size)), np.zeros((count + 1, count))
    for i in range(size):
        basis[0, i] = np.cos(1.0 * i * i)  # a part of everything
    basis[0] /= np.sqrt(np.sum(basis[0] ** 2))
    for k in range(count):
        image = _period(rows, shape, matrices, basis[k].copy().reshape(size, 1))[:, 0]
        for _ in range(2):  # twice is enough
            for j in range(k + 1):
                share = np.sum(basis[j] * image)
                small[j, k] += share
                image = image - share * basis[j]
        length = np.sqrt(np.sum(image**2))
        if length < 1e-14:
            return small[: k + 1, : k + 1].copy()
        small[k + 1, k] = length
        basis[k + 1] = image / length
    return small[:count].copy()


@njit(cache=True, nogil=True)
def _period(rows, shape, matrices, start):
    """Columns of the state (q (n), q' (n), u of the last period at its m nodes (m, 2), oldest first) after m steps."""
    n, m = shape.shape[0], matrices.shape[0]
    size = start.shape[1]
    state = start[: 2 * n].copy()
    past = np.zeros((2 * m, 2, size))  # u at the nodes: m of the period before, then those of this one
    for k in range(m):
        for j in range(2):
            past[k, j] = start[2 * n + 2 * k + j]
    force, free = np.zeros(3), np.zeros(2)
    new_state = np.zeros((2 * n, size))
    gain = np.zeros((2, 3))  # u at the end of a step from the force there
    for j in range(2):
        for i in range(3):
            for mode in range(n):
                gain[j, i] += shape[mode, j] * rows[mode, 0, 3] * shape[mode, i]
    for k in range(m):
        here, there = matrices[k], matrices[(k + 1) % m]
        s00 = 1.0 - (gain[0, 0] * there[0, 0] + gain[0, 1] * there[1, 0] + gain[0, 2] * there[2, 0])
        s01 = -(gain[0, 0] * there[0, 1] + gain[0, 1] * there[1, 1] + gain[0, 2] * there[2, 1])
        s10 = -(gain[1, 0] * there[0, 0] + gain[1, 1] * there[1, 0] + gain[1, 2] * there[2, 0])
        s11 = 1.0 - (gain[1, 0] * there[0, 1] + gain[1, 1] * there[1, 1] + gain[1, 2] * there[2, 1])
        determinant = s00 * s11 - s01 * s10
        for column in range(size):
            now0, now1 = 0.0, 0.0
            for mode in range(n):
                now0 += shape[mode, 0] * state[mode, column]
                now1 += shape[mode, 1] * state[mode, column]
            d0, d1 = now0 - past[k, 0, column], now1 - past[k, 1, column]
            for i in range(3):
                force[i] = here[i, 0] * d0 + here[i, 1] * d1
            free[:] = 0.0
            for mode in range(n):
                load = shape[mode, 0] * force[0] + shape[mode, 1] * force[1] + shape[mode, 2] * force[2]
                q = rows[mode, 0, 0] * state[mode, column] + rows[mode, 0, 1] * state[n + mode, column]
                q += rows[mode, 0, 2] * load
                rate = rows[mode, 1, 0] * state[mode, column] + rows[mode, 1, 1] * state[n + mode, column]
                new_state[mode, column] = q
                new_state[n + mode, column] = rate + rows[mode, 1, 2] * load
                free[0] += shape[mode, 0] * q
                free[1] += shape[mode, 1] * q
            # u = free + gain F_end with F_end = B_end (u - u_delayed)
            if k + 1 < m:
                old0, old1 = past[k + 1, 0, column], past[k + 1, 1, column]
            else:
                old0, old1 = past[m, 0, column], past[m, 1, column]
            b0, b1 = 0.0, 0.0
            for i in range(3):
                delayed = there[i, 0] * old0 + there[i, 1] * old1
                b0 += gain[0, i] * delayed
                b1 += gain[1, i] * delayed
            r0, r1 = free[0] - b0, free[1] - b1
            u0, u1 = (s11 * r0 - s01 * r1) / determinant, (s00 * r1 - s10 * r0) / determinant
            for i in range(3):
                force[i] = there[i, 0] * (u0 - old0) + there[i, 1] * (u1 - old1)
            for mode in range(n):
                load = shape[mode, 0] * force[0] + shape[mode, 1] * force[1] + shape[mode, 2] * force[2]
                new_state[mode, column] += rows[mode, 0, 3] * load
                new_state[n + mode, column] += rows[mode, 1, 3] * load
            past[m + k, 0, column], past[m + k, 1, column] = now0, now1
        state, new_state = new_state, state
    result = np.zeros(start.shape)
    result[: 2 * n] = state
    for k in range(m):
        for j in range(2):
            result[2 * n + 2 * k + j] = past[m + k, j]
    return result
