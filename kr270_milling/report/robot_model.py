"""The robot for the page's 3-D picture: the URDF's solids as triangles, and the chain that moves them."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from kr270_milling.base.frames import rotation_from_abc
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, commanded_joints
from kr270_milling.robot.urdf import COLOURS, urdf
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Link", "Mesh", "RobotModel", "links_of", "robot_model"]

SIDES = 20  #: of the prism that stands for a cylinder
MOST_POSTURES = 240


@dataclass(frozen=True, eq=False)
class Mesh:
    colour: str
    vertex: np.ndarray  #: in the frame of the link [m], (v, 3)
    triangle: np.ndarray  #: rows of ``vertex``, (t, 3)


@dataclass(frozen=True, eq=False)
class Link:
    """parent: row of the link that it hangs on, -1 for the base; joint: 0 to 5 turn it, -1: fixed."""

    name: str
    parent: int
    rotation: np.ndarray  #: of the joint's frame in that of the parent, (3, 3)
    xyz: np.ndarray  #: its origin there [m], (3,)
    axis: np.ndarray  #: (3,)
    joint: int
    meshes: tuple[Mesh, ...]


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Links in an order in which each comes after its parent; joints at p times of the pass that is shown."""

    name: str
    links: tuple[Link, ...]
    colours: dict[str, str]
    pass_name: str
    time: np.ndarray  #: [s], (p,)
    joints: np.ndarray  #: commanded positions [rad], (p, 6)
    stock_corners: np.ndarray  #: of the box, base_link [m], (8, 3)
    workpiece_rotation: np.ndarray  #: workpiece -> base_link, (3, 3)
    workpiece_xyz: np.ndarray  #: [m], (3,)


def robot_model(cell: Cell, shown: ScoredPass) -> RobotModel:
    """The robot with the postures that are commanded in a pass."""
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


def links_of(text: str) -> tuple[Link, ...]:
    """The links of a URDF whose solids are boxes and cylinders, parents first. Raises ValueError for another text."""
    try:
        return _links(ET.fromstring(text))  # noqa: S314  expat itself stops texts that grow without bounds
    except (ET.ParseError, AttributeError, IndexError, TypeError) as error:
        raise ValueError(f"is no URDF of joints, boxes and cylinders: {error}") from None


def _links(root) -> tuple[Link, ...]:
    links = {link.get("name"): link for link in root.iter("link")}
    joints = {joint.find("child").get("link"): joint for joint in root.iter("joint")}
    order = [name for name in links if name not in joints]
    moving = 0
    found: list[Link] = []
    for name in order:
        order.extend(child for child, joint in joints.items() if joint.find("parent").get("link") == name)
        joint = joints.get(name)
        number = -1
        if joint is not None and joint.get("type") == "revolute":
            number, moving = moving, moving + 1
        parent, axis = -1, np.zeros(3)
        if joint is not None:
            parent = order.index(joint.find("parent").get("link"))
            if number >= 0:
                axis = _numbers(joint.find("axis").get("xyz"))
        rotation, xyz = _origin(None if joint is None else joint.find("origin"))
        meshes = tuple(_mesh(visual) for visual in links[name].iter("visual"))
        found.append(Link(name, parent, rotation, xyz, axis, number, meshes))
    return tuple(found)


def _numbers(text: str) -> np.ndarray:
    return np.array([float(v) for v in text.split()])


def _origin(element) -> tuple[np.ndarray, np.ndarray]:
    if element is None:
        return np.eye(3), np.zeros(3)
    return rotation_from_abc(_numbers(element.get("rpy"))[::-1]), _numbers(element.get("xyz"))


def _mesh(visual) -> Mesh:
    rotation, xyz = _origin(visual.find("origin"))
    shape = visual.find("geometry")[0]
    if shape.tag == "box":
        vertex, triangle = _prism(4, np.pi / 4)
        size = _numbers(shape.get("size")) * [np.sqrt(0.5), np.sqrt(0.5), 1.0]
    else:
        vertex, triangle = _prism(SIDES, 0.0)
        size = np.array([float(shape.get(key)) for key in ("radius", "radius", "length")])
    return Mesh(visual.find("material").get("name"), (vertex * size) @ rotation.T + xyz, triangle)


def _prism(sides: int, first: float) -> tuple[np.ndarray, np.ndarray]:
    """Of height 1, its corners on a circle of radius 1, the first one at an angle [rad]."""
    angle = first + 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    ends = [np.column_stack([ring, np.full(sides, side)]) for side in (-0.5, 0.5)]
    k = np.arange(sides)
    n = (k + 1) % sides
    below, above = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    parts = [(k, n, n + sides), (k, n + sides, k + sides), (below, n, k), (above, k + sides, n + sides)]
    return np.vstack([*ends, [[0, 0, -0.5], [0, 0, 0.5]]]), np.vstack([np.column_stack(part) for part in parts])
