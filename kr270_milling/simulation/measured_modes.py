"""Modes from an experiment in the place of stiffness and mass: eq. (1) in modal coordinates."""

from __future__ import annotations

import numpy as np

from kr270_milling.simulation.dynamics import ModalModel
from kr270_milling.simulation.parameters import MeasuredModes

__all__ = ["measured_model"]

#: where rotation and translation of the reference cannot both be met, a radian counts as much as this way [m]:
#: what a turn about the tool tip moves at the radius of an ordinary cutter
RADIUS = 0.01


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
