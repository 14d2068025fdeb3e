"""A finish of a wavy surface with a tool along its normal, as five-axis posts write it, or with an upright tool."""

from __future__ import annotations

import math

import numpy as np

FEED = 1200.0  #: [mm/min]
SIZE = 120.0  #: [mm], length of a row
HEIGHT, WAVE = 4.0, 50.0  #: [mm], of the surface
MACHINE = {"kinematics": "head_table", "axes": ["A", "B"]}  #: section ``machine`` of the cell


def surface(x: float, y: float) -> tuple[float, float, float]:
    """Height and slopes along x and y."""
    k = 2 * math.pi / WAVE
    slope_x = HEIGHT * k * math.cos(k * x) * math.cos(k * y)
    slope_y = -HEIGHT * k * math.sin(k * x) * math.sin(k * y)
    return HEIGHT * math.sin(k * x) * math.cos(k * y) - 6, slope_x, slope_y


def program(rows: int, points: int, tilted: bool = True, step: float = 0.5) -> str:
    """G-code of rows [mm] along x with so many points each; the tool is along the normal of the surface."""
    lines = ["%", "O0005 (wavy surface)", "G21 G90 G17", "S9000 M3", "G43.4 H1" if tilted else "G43 H1"]
    for row in range(rows):
        for k in range(points) if row % 2 == 0 else reversed(range(points)):
            x, y = SIZE * (k / (points - 1) - 0.5), (row - 0.5 * (rows - 1)) * step
            z, slope_x, slope_y = surface(x, y)
            # (sin B, -sin A cos B, cos A cos B) is the normal (-slope_x, -slope_y, 1) / length
            b = math.degrees(math.atan2(-slope_x, math.hypot(slope_y, 1.0)))
            angles = f" A{math.degrees(math.atan2(slope_y, 1.0)):.4f} B{b:.4f}" if tilted else ""
            if row == 0 and k == 0:
                lines += [f"G0 X{x:.4f} Y{y:.4f} Z20.{angles}", f"G1 Z{z:.4f} F{FEED:g}"]
            else:
                lines.append(f"X{x:.4f} Y{y:.4f} Z{z:.4f}{angles}")
    return "\n".join([*lines, "G0 Z20.", "G49", "M5", "M30", "%", ""])


def row(y: float, points: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Tips (n, 3) [m] and axes (n, 3) of a row of ``program`` at y [mm], a step [m] apart."""
    x = SIZE * np.linspace(-0.5, 0.5, points)
    heights = np.array([surface(place, y) for place in x])
    tips, normals = np.column_stack([x, 0 * x + y, heights[:, 0]]), np.column_stack([-heights[:, 1:], 0 * x + 1.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1)))
    at = np.arange(0.0, way[-1], 1e3 * step)
    tips, axes = (np.column_stack([np.interp(at, way, column) for column in rows.T]) for rows in (tips, normals))
    return 1e-3 * tips, axes / np.linalg.norm(axes, axis=1, keepdims=True)
