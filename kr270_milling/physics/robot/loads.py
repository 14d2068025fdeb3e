"""Loads on the joint springs: torque of the wrench and of the link weights (6), and its derivative (14), (15).

An arm with a gravity compensator has its moment on joint 2 as well, wherever the weights count.

Wrenches are force and moment on the tool at the tool point, constant in base_link axes, translations first [N, N m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.compiled import compiled
from kr270_milling.physics.robot.arm import Arm, GravityCompensator, Mount
from kr270_milling.physics.robot.kinematics import LinkFrames, cross, rows_of

GRAVITY = 9.80665  #: standard acceleration of free fall [m/s^2], [BIPM, SI brochure]


@dataclass(frozen=True, eq=False)
class LinkLoads:
    """The auxiliary loads: masses in the node points O_0..O_6 and in the mount's mass centre, in one gravity field.

    G_j = mass_j * gravity does not depend on the posture, so dG/dtheta, the last term of (15), vanishes.
    """

    mass: np.ndarray  #: [kg], (8,)
    gravity: np.ndarray  #: [m/s^2] in base_link, (3,)
    compensator: GravityCompensator = GravityCompensator()  #: balances the weights
    share: float = 1.0  #: share of the whole load; gravity contains it already, the compensator's moment not yet

    def part(self, share: float) -> LinkLoads:
        """The same share of every load."""
        return LinkLoads(self.mass, share * self.gravity, self.compensator, share * self.share)

    @property
    def forces(self) -> np.ndarray:
        """G_j [N], (8, 3)."""
        return self.mass[:, None] * self.gravity


def link_loads(arm: Arm, mount: Mount, gravity: float = GRAVITY) -> LinkLoads:
    """Weights split to the ends of each link by its mass centre; gravity [m/s^2] points down, 0 switches it off.

    Exact for a rigid link: the axis of joint j passes through O_(j-1), so that end of link j does not move with it.
    """
    mass = np.zeros(8)
    mass[:6] += arm.link_mass * (1 - arm.link_mass_centre)
    mass[1:7] += arm.link_mass * arm.link_mass_centre
    mass[7] = mount.mass
    weight = np.array([0.0, 0.0, -gravity])
    return LinkLoads(mass, weight, arm.compensator) if gravity else LinkLoads(mass, weight)


def moment_arms(frames: LinkFrames, loads: LinkLoads) -> np.ndarray:
    """First moment of all masses beyond joint i about O_(i-1) [kg m], (..., 6, 3): what weights need, made once.

    With k axes of the base before the joints, (..., k + 6, 3): these have the moment of joint 1, about O_0 as well.
    """
    batch = frames.nodes.shape[:-2]
    moments = np.empty((*batch, 7, 3))
    _first_moments(
        rows_of(frames.nodes, batch, 2),
        rows_of(frames.mass_centre, batch, 1),
        np.array(loads.mass),
        moments.reshape(-1, 7, 3),
    )
    moments = moments[..., :6, :]
    base = frames.axes.shape[-2] - 6
    return moments[..., [0] * base + list(range(6)), :] if base else moments


def load_torque(frames: LinkFrames, wrench: np.ndarray, loads: LinkLoads, masses=None) -> np.ndarray:
    """Right-hand side of (6): J_G^T G + J_F^T F [N m], one an axis, (..., 6) or (..., k + 6).

    masses: ``moment_arms``, where they are known.
    """
    masses = moment_arms(frames, loads) if masses is None else masses
    force, moment = wrench[..., None, :3], wrench[..., None, 3:]
    arms = frames.tool.position[..., None, :] - frames.origins
    about_axis = cross(arms, force) + moment + cross(masses, loads.gravity)
    torque = np.einsum("...ij,...ij->...i", frames.axes, about_axis)
    if loads.compensator.present:
        torque[..., -5] += loads.share * loads.compensator.moment(*_joint_2(frames))
    return torque


def _joint_2(frames: LinkFrames):
    """Cosine and sine of q2, (...,): Ry(q2) = R_1^T R_2."""
    forward = frames.rotations[..., 0, :, 0]
    upper_arm = frames.rotations[..., 1, :, :]
    cosine = np.einsum("...i,...i->...", forward, upper_arm[..., 0])
    sine = np.einsum("...i,...i->...", forward, upper_arm[..., 2])
    return cosine, sine


def load_hessian(frames: LinkFrames, wrench: np.ndarray, loads: LinkLoads, masses=None) -> np.ndarray:
    """H_theta_theta of (14), (15) [N m/rad], (..., 6, 6): the derivative of ``load_torque`` by the angles of its axes.

    A point x beyond both joints has d2x / dq_i dq_k = a_min x (a_max x (x - O_max)), which is symmetric. A moment m
    adds (a_k x a_i) . m for k < i only, because joint k turns the axis i and not the other way round.
    """
    masses = moment_arms(frames, loads) if masses is None else masses
    axes = frames.axes
    force, moment = wrench[..., None, :3], wrench[..., None, 3:]
    arms = frames.tool.position[..., None, :] - frames.origins
    weight = cross(cross(axes, masses), loads.gravity)
    pulled, twisted = cross(cross(axes, arms), force) + weight, cross(axes, moment)
    batch, count = pulled.shape[:-2], pulled.shape[-2]
    bent = np.empty((*batch, count, count))
    _bend(
        rows_of(axes, batch, 2), rows_of(pulled, batch, 2), rows_of(twisted, batch, 2), bent.reshape(-1, count, count)
    )
    if loads.compensator.present:
        bent[..., -5, -5] += loads.share * loads.compensator.moment_slope(*_joint_2(frames))
    return bent


@compiled
def _first_moments(nodes, mount, mass, out):
    """Fill the first moments of the masses beyond each node (n, 7, 3), with the mount (n, 3), about that node."""
    for p in range(len(out)):
        for axis in range(3):
            beyond, moment = mass[-1], mass[-1] * mount[p, axis]
            for i in range(nodes.shape[1] - 1, -1, -1):
                out[p, i, axis] = moment - beyond * nodes[p, i, axis]
                beyond += mass[i]
                moment += mass[i] * nodes[p, i, axis]


@compiled
def _bend(axes, pulled, twisted, out):
    """a_i . pulled_k at (i, k) and (k, i), i <= k, and twisted_k . a_i more at (k, i), i < k; each (n, k, 3)."""
    for p in range(len(out)):
        a, f, m = axes[p], pulled[p], twisted[p]
        for k in range(len(a)):
            for i in range(k + 1):
                out[p, i, k] = out[p, k, i] = a[i, 0] * f[k, 0] + a[i, 1] * f[k, 1] + a[i, 2] * f[k, 2]
                if i < k:
                    out[p, k, i] += m[k, 0] * a[i, 0] + m[k, 1] * a[i, 1] + m[k, 2] * a[i, 2]
