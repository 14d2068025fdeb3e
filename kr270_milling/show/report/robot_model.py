"""The robot for the page's 3-D picture: the URDF's solids as triangles, and the chain that moves them."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, commanded_joints
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot.urdf import COLOURS, urdf
from kr270_milling.physics.robot.urdf_links import links_of

__all__ = ["robot_model"]

MOST_POSTURES = 240


def robot_model(cell: Cell, shown: ScoredPass) -> dict:
    """Return links, parents first, and the commanded postures [rad] at p times of a pass; base_link, lengths in m."""
    time, joints = _postures(cell, shown.reference)
    low, high = cell.stock.min, cell.stock.max
    corners = np.array([[(low, high)[(c >> k) & 1][k] for k in range(3)] for c in range(8)])
    colours = {name: "#" + "".join(f"{round(255 * v):02x}" for v in rgb) for name, rgb in COLOURS.items()}
    links = links_of(urdf(cell.arm, cell.mount, cell.tool.radius))
    place = cell.workpiece.pose
    return {
        "name": cell.arm.name,
        "links": links,
        "colours": colours,
        "pass_name": shown.name,
        "time": time,
        "joints": joints,
        "stock_corners": place.apply(corners),
        "workpiece_rotation": place.rotation,
        "workpiece_xyz": place.position,
    }


def _postures(cell: Cell, reference: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    time_ns = np.unique(np.linspace(0, reference.duration_ns, MOST_POSTURES).round().astype(np.int64))
    thinned = Trajectory(
        time_ns, reference.sample(time_ns), reference.sample_orientation(time_ns), None, reference.frame
    )
    return thinned.time, commanded_joints(cell, thinned)
