"""The robot for the page's 3-D picture: the URDF's solids as triangles, and the chain that moves them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.arm import PlacedArm, commanded_joints
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.cutting import Stock
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


def robot_model(placed: PlacedArm, settings: CompensationSettings, stock: Stock, shown: ScoredPass) -> RobotModel:
    """Return the robot with the commanded postures of a pass."""
    thinned = _thinned(shown.reference)
    joints, low, high = commanded_joints(placed, settings, thinned), stock.min, stock.max
    corners = np.array([[(low, high)[(c >> k) & 1][k] for k in range(3)] for c in range(8)])
    colours = {name: "#" + "".join(f"{round(255 * v):02x}" for v in rgb) for name, rgb in COLOURS.items()}
    links = links_of(urdf(placed.arm, placed.mount, placed.tool.radius))
    place, name = placed.place, placed.arm.name
    return RobotModel(
        name, links, colours, shown.name, thinned.time, joints, place.apply(corners), place.rotation, place.position
    )


def _thinned(reference: Trajectory) -> Trajectory:
    time_ns = np.unique(np.linspace(0, reference.duration_ns, MOST_POSTURES).round().astype(np.int64))
    return Trajectory(time_ns, reference.sample(time_ns), reference.sample_orientation(time_ns), None, reference.frame)
