"""The robot for the page's 3-D picture: the URDF's solids as triangles, and the chain that moves them."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.arm import PlacedArm, commanded_joints
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.cutting import Stock
from kr270_milling.physics.robot.urdf import COLOURS, urdf
from kr270_milling.physics.robot.urdf_links import links_of

__all__ = ["robot_model"]

MOST_POSTURES = 240


def robot_model(placed: PlacedArm, settings: CompensationSettings, stock: Stock, shown: ScoredPass) -> dict:
    """Return links, parents first, and the commanded postures [rad] at p times of a pass; base_link, lengths in m."""
    thinned = _thinned(shown.reference)
    joints, low, high = commanded_joints(placed, settings, thinned), stock.min, stock.max
    corners = np.array([[(low, high)[(c >> k) & 1][k] for k in range(3)] for c in range(8)])
    colours = {name: "#" + "".join(f"{round(255 * v):02x}" for v in rgb) for name, rgb in COLOURS.items()}
    return {
        "name": placed.arm.name,
        "links": links_of(urdf(placed.arm, placed.mount, placed.tool.radius)),
        "colours": colours,
        "pass_name": shown.name,
        "time": thinned.time,
        "joints": joints,
        "stock_corners": placed.place.apply(corners),
        "workpiece_rotation": placed.place.rotation,
        "workpiece_xyz": placed.place.position,
    }


def _thinned(reference: Trajectory) -> Trajectory:
    time_ns = np.unique(np.linspace(0, reference.duration_ns, MOST_POSTURES).round().astype(np.int64))
    return Trajectory(time_ns, reference.sample(time_ns), reference.sample_orientation(time_ns), None, reference.frame)
