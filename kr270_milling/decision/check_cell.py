"""Checks of the cell itself: numbers that no arm, tool or placement has, mostly units that slipped."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.decision.path_limits import Violation

__all__ = ["cell_violations"]

#: [rad/(N m)], joint compliances of heavy arms lie at 0.1 to 10 urad/(N m) (Table 1 of [Klimchik2012]: 0.15 to 2.13)
COMPLIANCE = 1e-8, 1e-4
#: [kg], links of arms that carry a milling spindle (Table 1: 18 to 337)
LINK_MASS = 1.0, 2e3
WIDEST_GRID = 0.05  #: of the tool's radius: with fewer nodes across a cut its force is noise


def cell_violations(cell: Cell) -> list[Violation]:
    """What is unlikely in the parameter file; all are warnings, for the user may have an unlikely cell."""
    compliance, mass = np.asarray(cell.arm.joint_compliance), np.asarray(cell.arm.link_mass)
    gives = "joint {number} gives way by {value:.3g} urad/(N m), arms of this size by 0.01 to 100"
    weighs = "link {number} has {value:.3g} kg, links of arms of this size 1 to 2000 kg"
    found = _unlikely("compliance", compliance, COMPLIANCE, gives, 1e6) + _unlikely("mass", mass, LINK_MASS, weighs)
    return found + _tool(cell) + _envelope(cell) + _posture(cell)


def _warning(kind: str, value: float, limit: float, sentence: str) -> list[Violation]:
    return [Violation(kind, None, float(value), float(limit), "warning", sentence)]


def _unlikely(kind: str, values: np.ndarray, bounds: tuple, sentence: str, scale: float = 1.0) -> list[Violation]:
    """A warning of the first value that is not within the bounds."""
    over = np.flatnonzero(~((values >= bounds[0]) & (values <= bounds[1])))
    if not over.size:
        return []
    value = float(values[over[0]])
    text = sentence.format(number=over[0] + 1, value=scale * value)
    return _warning(kind, value, bounds[int(value > bounds[1])], text)


def _tool(cell: Cell) -> list[Violation]:
    step, radius = cell.stock.grid_step, cell.tool.radius
    if step <= WIDEST_GRID * radius:
        return []
    shown = f"the grid step of {1e3 * step:.4g} mm is coarse for a cutter of {2e3 * radius:.4g} mm diameter"
    return _warning("tool and grid", step, WIDEST_GRID * radius, shown)


def _envelope(cell: Cell) -> list[Violation]:
    arm = cell.arm
    reach = arm.a1 + arm.a2 + arm.forearm + arm.d6 + float(np.linalg.norm(cell.mount.xyz))
    away = float(np.hypot(*cell.workpiece.xyz[:2]))
    if away <= reach:
        return []
    return _warning(
        "envelope", away, reach, f"the workpiece is {away:.4g} m from axis 1, the arm reaches {reach:.4g} m"
    )


def _posture(cell: Cell) -> list[Violation]:
    """Joints outside the limits, or all so small that they must be radians."""
    q, arm = np.asarray(cell.posture), cell.arm
    key = "start_joints_deg" if cell.start_joints.size else "posture_hint_deg"
    beyond = np.maximum(q - arm.joint_upper, arm.joint_lower - q)
    k = int(np.argmax(beyond))
    if beyond[k] > 0.0:
        limit = arm.joint_upper[k] if q[k] > arm.joint_upper[k] else arm.joint_lower[k]
        return _warning("posture", q[k], limit, f"{key}: axis {k + 1} is at {np.degrees(q[k]):.4g} deg")
    degrees = np.degrees(np.abs(q))
    if np.any(degrees > 0.0) and np.all(degrees <= 2.0 * np.pi) and np.any(degrees % 1.0 > 1e-9):
        shown = f"{key} are all within {degrees.max():.3g} deg: are they radians?"
        return _warning("posture", np.radians(degrees.max()), 2.0 * np.pi / 180.0, shown)
    return []
