"""The robot for the page's 3-D picture: the URDF's solids as triangles, and the chain that moves them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, commanded_joints
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot.urdf import COLOURS, urdf
from kr270_milling.physics.robot.urdf_links import Link, links_of

__all__ = ["RobotModel", "robot_model"]

MOST_POSTURES = 240


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Links, parents first, and joints at p times of the pass that is shown."""

    name: str
    links: tuple[Link, ...]
    colours: dict[str, str]
    pass_name: str
    time: np.ndarray  #: [s], (p,)
    joints: np.ndarray  #: commanded positions [rad], (p, 6)
    stock_corners: np.ndarray  #: corners of the box, base_link [m], (8, 3)
    workpiece_rotation: np.ndarray  #: workpiece -> base_link, (3, 3)
    workpiece_xyz: np.ndarray  #: [m], (3,)


def robot_model(cell: Cell, shown: ScoredPass) -> RobotModel:
    """Return the robot with the commanded postures of a pass."""
    time, joints = _postures(cell, shown.reference)
    low, high = cell.stock.min, cell.stock.max
    corners = np.array([[(low, high)[(c >> k) & 1][k] for k in range(3)] for c in range(8)])
    colours = {name: "#" + "".join(f"{round(255 * v):02x}" for v in rgb) for name, rgb in COLOURS.items()}
    links = links_of(urdf(cell.arm, cell.mount, cell.tool.radius))
    place = cell.workpiece.pose
    return RobotModel(
        cell.arm.name, links, colours, shown.name, time, joints, place.apply(corners), place.rotation, place.position
    )


def _postures(cell: Cell, reference: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    time_ns = np.unique(np.linspace(0, reference.duration_ns, MOST_POSTURES).round().astype(np.int64))
    thinned = Trajectory(
        time_ns, reference.sample(time_ns), reference.sample_orientation(time_ns), None, reference.frame
    )
    return thinned.time, commanded_joints(cell, thinned)
