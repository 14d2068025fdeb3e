"""Mass-normalised shapes of measured modes, as ``dynamics.modes`` wants them.

A mode of shape phi answers an impulse along d with phi phi_d sin(omega_d t) exp(-zeta omega t) / omega_d; its residues
are R = phi phi_d / (2 i omega_d). With a hammer the drive point gives phi_d^2 = 2 i omega_d R_d, and the others follow.
Velocities and accelerations have s R and s^2 R.

Without a hammer only the direction psi of phi = alpha psi is known. The static compliance of the arm is the sum over
its modes, C = sum alpha_k^2 psi_k psi_k^T / omega_k^2, which gives alpha_k^2 >= 0 by least squares over the components
that were measured.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from kr270_milling.base.errors import InputError
from kr270_milling.cell.cell import Cell
from kr270_milling.identification.modes import Mode
from kr270_milling.identification.signals import AXES, Signals
from kr270_milling.robot import compliance, equilibrium, rotate_matrix

__all__ = ["by_compliance", "by_hammer", "tool_compliance"]

POWER = {"displacement": 0, "velocity": 1, "acceleration": 2}


def by_hammer(modes: list[Mode], signals: Signals, axis: str, quantity: str = "displacement") -> np.ndarray:
    """(n, 6) [kg^-1/2]; axis: of the hammer's force, one of the channels; signals in SI units. Raises InputError."""
    if signals.force is None or axis not in signals.names:
        raise InputError("--hammer", f"needs the columns force_n and {axis}: a hammer and the motion where it hits")
    drive, shapes = signals.names.index(axis), []
    for mode in modes:
        residues = mode.residues / mode.pole ** POWER[quantity]
        share = 2j * mode.pole.imag * residues
        square = float(share[drive].real)
        if not square > 0.0:
            raise InputError(
                "--hammer", f"the mode at {mode.frequency:.4g} Hz moves against the force: check the signs"
            )
        shapes.append(signals.along_axes(share.real / np.sqrt(square)))
    return np.array(shapes)


def by_compliance(modes: list[Mode], signals: Signals, soft: np.ndarray) -> np.ndarray:
    """(n, 6) [kg^-1/2]; soft: compliance at the tool tip [m/N, rad/N, ...], (6, 6), in the axes of the signals.

    Raises InputError where a mode has no part in the compliance.
    """
    seen = [AXES.index(name) for name in signals.names if name in AXES[:3]]
    pairs = np.triu_indices(len(seen))
    directions = np.array([signals.along_axes(mode.shape) for mode in modes])
    softness = np.array([np.outer(psi, psi)[np.ix_(seen, seen)][pairs] for psi in directions])
    omega = 2 * np.pi * np.array([mode.frequency for mode in modes])
    target = soft[np.ix_(seen, seen)][pairs]
    squares, _ = nnls((softness / omega[:, None] ** 2).T / np.abs(target).max(), target / np.abs(target).max())
    if not np.all(squares > 0.0):
        lost = modes[int(np.argmin(squares))].frequency
        raise InputError(
            "--cell", f"the mode at {lost:.4g} Hz has no part in the compliance there: use a hammer, or --modes"
        )
    return np.sqrt(squares)[:, None] * directions


def tool_compliance(cell: Cell) -> np.ndarray:
    """Of the arm at the start of the cell's path, workpiece axes, (6, 6)."""
    q = cell.joints(cell.target())[0]
    bent = equilibrium(cell.arm, cell.mount, q, gravity=cell.dynamics.gravity)
    return rotate_matrix(compliance(bent, cell.arm), cell.workpiece.pose.rotation.T)
