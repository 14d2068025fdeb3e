"""Links of a URDF whose solids are boxes and cylinders, with the solids as triangles."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from kr270_milling.base.frames import rotation_from_abc


@dataclass(frozen=True, eq=False)
class Mesh:
    colour: str
    vertex: np.ndarray  #: in the frame of the link [m], (v, 3)
    triangle: np.ndarray  #: rows of ``vertex``, (t, 3)


@dataclass(frozen=True, eq=False)
class Link:
    """parent: row of the parent link, -1 for the base; joint: name of the joint that turns the link; empty: fixed."""

    name: str
    parent: int
    rotation: np.ndarray  #: rotation of the joint's frame in the frame of the parent, (3, 3)
    xyz: np.ndarray  #: its origin there [m], (3,)
    axis: np.ndarray  #: (3,)
    joint: str
    meshes: tuple[Mesh, ...]


def links_of(text: str) -> tuple[Link, ...]:
    """Return the links of a URDF, parents first. Raises ValueError for another text."""
    try:
        return _links(ET.fromstring(text))  # noqa: S314  expat limits the growth of entities
    except (ET.ParseError, AttributeError, IndexError, TypeError) as error:
        raise ValueError(f"not a URDF of joints, boxes and cylinders: {error}") from None


def _links(root) -> tuple[Link, ...]:
    links = {link.get("name"): link for link in root.iter("link")}
    joints = {joint.find("child").get("link"): joint for joint in root.iter("joint")}
    order = [name for name in links if name not in joints]
    parsed: list[Link] = []
    for name in order:
        order.extend(child for child, joint in joints.items() if joint.find("parent").get("link") == name)
        joint = joints.get(name)
        moving = joint.get("name") if joint is not None and joint.get("type") == "revolute" else ""
        parent, axis = -1, np.zeros(3)
        if joint is not None:
            parent = order.index(joint.find("parent").get("link"))
            if moving:
                axis = _numbers(joint.find("axis").get("xyz"))
        rotation, xyz = _origin(None if joint is None else joint.find("origin"))
        meshes = tuple(_mesh(visual) for visual in links[name].iter("visual"))
        parsed.append(Link(name, parent, rotation, xyz, axis, moving, meshes))
    return tuple(parsed)


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
        vertex, triangle = _prism(20, 0.0)  # a prism of 20 sides approximates a cylinder
        size = np.array([float(shape.get(key)) for key in ("radius", "radius", "length")])
    return Mesh(visual.find("material").get("name"), (vertex * size) @ rotation.T + xyz, triangle)


def _prism(sides: int, first: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a prism of height 1 with its corners on a circle of radius 1, the first corner at an angle [rad]."""
    angle = first + 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    ends = [np.column_stack([ring, np.full(sides, side)]) for side in (-0.5, 0.5)]
    k = np.arange(sides)
    n = (k + 1) % sides
    below, above = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    parts = [(k, n, n + sides), (k, n + sides, k + sides), (below, n, k), (above, k + sides, n + sides)]
    return np.vstack([*ends, [[0, 0, -0.5], [0, 0, 0.5]]]), np.vstack([np.column_stack(part) for part in parts])
