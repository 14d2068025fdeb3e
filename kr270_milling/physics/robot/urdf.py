"""URDF of the arm: links with inertias and simple solids, joint limits, flange, tcp and, if wanted, the workpiece.

The inertias are those of the mass model ``rigid``: thin tubes, and spindle and tool on the flange. The solids of arm,
spindle and tool are boxes and cylinders, sized by the link lengths. They are for the eye only: own primitives by the
look of a heavy arm, no maker's meshes. ``check`` compares the capsules within them with obstacles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from kr270_milling.base.frames import JOINT_NAMES, TOOL, TOOL0, Pose, abc_from_rotation, rotation_from_abc
from kr270_milling.physics.robot.arm import AXES, Arm, Mount
from kr270_milling.physics.robot.mass import own_inertia

#: material of a solid -> red, green, blue, from 0 to 1
COLOURS = {
    "arm": (0.90, 0.45, 0.10),
    "dark": (0.22, 0.24, 0.27),
    "metal": (0.62, 0.65, 0.69),
    "tool": (0.80, 0.70, 0.30),
}
ORIGIN = NO_TURN = np.zeros(3)
STICK_OUT = 0.04  # [m] of the tool from its holder, as shown


@dataclass(frozen=True, eq=False)
class Solid:
    """A box of ``size`` (x, y, z), or a cylinder of ``size`` (radius, length) along its z axis [m]."""

    size: tuple[float, ...]
    xyz: np.ndarray  #: middle in the frame of the link [m], (3,)
    rpy: np.ndarray  #: rotation in the frame of the link, URDF's roll, pitch, yaw [rad], (3,)
    colour: str


def urdf(
    arm: Arm,
    mount: Mount,
    tool_radius: float = 0.01,
    workpiece: Pose | None = None,
    joint_names: Sequence[str] = JOINT_NAMES,
) -> str:
    """URDF text: base_link, link_1 to link_6, flange, tcp [m, rad, kg], and ROS-Industrial's frames base and tool0.

    tool_radius [m] of the cutter that is shown; workpiece: its frame on base_link, as a further fixed link;
    joint_names: of the six joints.
    """
    root = ET.Element("robot", name="kr270")
    for name, rgb in COLOURS.items():
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=_text([*rgb, 1.0]))
    solids, ends = _arm_solids(arm), arm.link_vectors
    _link(root, "base_link", solids[0])
    for j in range(6):
        link = _link(root, f"link_{j + 1}", solids[j + 1])
        _inertial(link, arm.link_mass[j], arm.link_mass_centre[j] * ends[j], own_inertia(arm, j))
    for j in range(6):
        parent, offset = (f"link_{j}", ends[j - 1]) if j else ("base_link", ORIGIN)
        joint = _joint(root, joint_names[j], "revolute", parent, f"link_{j + 1}", offset, NO_TURN)
        ET.SubElement(joint, "axis", xyz=_text(AXES[j]))
        low, high, speed = arm.joint_lower[j], arm.joint_upper[j], arm.joint_speed_limit[j]
        ET.SubElement(joint, "limit", lower=f"{low:.9g}", upper=f"{high:.9g}", velocity=f"{speed:.9g}", effort="0")
    flange = _fixed(root, "flange", "link_6", Pose(ends[5], np.eye(3)), _adapter(mount))
    if mount.mass > 0.0:
        _inertial(flange, mount.mass, mount.mass_centre, np.diag(mount.inertia))
    _fixed(root, TOOL, "flange", mount.pose, _spindle(mount, tool_radius))
    _fixed(root, "tool0", "flange", TOOL0, [])
    _fixed(root, "base", "base_link", Pose(ORIGIN, np.eye(3)), [])
    if workpiece is not None:
        _fixed(root, "workpiece", "base_link", workpiece, [])
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _text(values) -> str:
    return " ".join(f"{float(v) + 0.0:.9g}" for v in values)


def _link(root, name: str, solids: list[Solid]):
    link = ET.SubElement(root, "link", name=name)
    for solid in solids:
        visual = ET.SubElement(link, "visual")
        ET.SubElement(visual, "origin", xyz=_text(solid.xyz), rpy=_text(solid.rpy))
        geometry = ET.SubElement(visual, "geometry")
        if len(solid.size) == 3:
            ET.SubElement(geometry, "box", size=_text(solid.size))
        else:
            ET.SubElement(geometry, "cylinder", radius=f"{solid.size[0]:.9g}", length=f"{solid.size[1]:.9g}")
        ET.SubElement(visual, "material", name=solid.colour)
    return link


def _inertial(link, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    """Mass [kg], its centre (3,) [m] and inertia (3, 3) [kg m^2] about the centre, frame of the link, as ``rigid``."""
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(f"{v + 0.0:.15g}" for v in centre.tolist()), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.15g}")
    # simulators refuse a body without inertia, as a point mass is
    full = inertia + 1e-10 * np.eye(3)
    moments = {f"i{'xyz'[i]}{'xyz'[k]}": f"{full[i, k] + 0.0:.15g}" for i in range(3) for k in range(i, 3)}
    ET.SubElement(inertial, "inertia", moments)


def _joint(root, name: str, kind: str, parent: str, child: str, xyz: np.ndarray, rpy: np.ndarray):
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
    return joint


def _fixed(root, name: str, parent: str, place: Pose, solids: list[Solid]):
    """A link fixed in its parent; URDF's roll, pitch, yaw are KUKA's C, B, A."""
    link = _link(root, name, solids)
    _joint(root, f"{parent}_{name}", "fixed", parent, name, place.position, abc_from_rotation(place.rotation)[::-1])
    return link


def _cylinder(start, end, radius: float, colour: str) -> Solid:
    """From one point to another [m]."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    along = end - start
    length = float(np.linalg.norm(along))
    axis = along / max(length, 1e-12)  # roll about x, then pitch about y, then yaw about z bring z there
    rpy = np.array([0.0, np.arctan2(np.hypot(axis[0], axis[1]), axis[2]), np.arctan2(axis[1], axis[0])])
    return Solid((radius, length), (start + end) / 2, rpy, colour)


def _box(size, middle, colour: str, rpy=NO_TURN) -> Solid:
    return Solid(tuple(map(float, size)), np.asarray(middle, float), rpy, colour)


def _hub(at, radius: float, length: float, colour: str) -> Solid:
    """A cylinder along y about a joint axis."""
    half = np.array([0.0, length / 2, 0.0])
    return _cylinder(np.asarray(at, float) - half, np.asarray(at, float) + half, radius, colour)


def _arm_solids(arm: Arm) -> list[list[Solid]]:
    """Return the solids of base_link and link_1 to link_6, each in the frame of its link."""
    s = (arm.a2 + arm.d4) / 2.35  # a2 + d4 of the KR 270-2, by whose look the widths are chosen
    return [
        [
            _box((0.80 * s, 0.80 * s, 0.06 * s), (0.0, 0.0, 0.03 * s), "dark"),
            _cylinder((0, 0, 0.06 * s), (0, 0, 0.42 * arm.d1), 0.30 * s, "dark"),
        ],
        [
            _cylinder((0, 0, 0.42 * arm.d1), (0, 0, 0.80 * arm.d1), 0.33 * s, "arm"),
            _box((abs(arm.a1) + 0.2 * s, 0.30 * s, 0.36 * s), (0.5 * arm.a1, 0.0, arm.d1 - 0.06 * s), "arm"),
            _hub((arm.a1, 0.0, arm.d1), 0.20 * s, 0.46 * s, "dark"),
        ],
        [
            _box((arm.a2, 0.20 * s, 0.26 * s), (0.5 * arm.a2, 0.0, 0.0), "arm"),
            _hub(ORIGIN, 0.19 * s, 0.34 * s, "arm"),
            _hub((arm.a2, 0.0, 0.0), 0.16 * s, 0.30 * s, "arm"),
        ],
        [
            _hub(ORIGIN, 0.13 * s, 0.40 * s, "dark"),
            _box((0.42 * s, 0.26 * s, 0.28 * s), (-0.04 * s, 0.0, arm.a3), "arm"),
        ],
        [
            _cylinder((0.12 * s, 0, 0), (0.55 * arm.d4, 0, 0), 0.125 * s, "arm"),
            _cylinder((0.55 * arm.d4, 0, 0), (arm.d4 - 0.10 * s, 0, 0), 0.105 * s, "arm"),
            _box((0.20 * s, 0.18 * s, 0.16 * s), (arm.d4 - 0.06 * s, 0.0, 0.0), "arm"),
        ],
        [_hub(ORIGIN, 0.095 * s, 0.22 * s, "dark")],
        [_cylinder((0.02 * s, 0, 0), (arm.d6, 0, 0), 0.085 * s, "metal")],
    ]


def _adapter(mount: Mount) -> list[Solid]:
    """A box from the flange to the nearest place of the spindle axis."""
    axis = mount.pose.rotation[:, 2]
    across = np.asarray(mount.xyz) - axis * float(axis @ mount.xyz)
    length = float(np.linalg.norm(across))
    if length < 0.02:
        return []
    direction = across / length
    rotation = np.column_stack([direction, np.cross(axis, direction), axis])
    return [_box((length, 0.16, 0.20), across / 2, "dark", abc_from_rotation(rotation)[::-1])]


def _spindle(mount: Mount, tool_radius: float) -> list[Solid]:
    """Tool, holder and, where the tip is far enough from the flange, the housing; tcp's z points to the tip."""
    solids = [_cylinder((0, 0, -STICK_OUT), (0, 0, 0), tool_radius, "tool")]
    holder = 0.06  # [m] of the holder from the spindle nose
    if float(np.linalg.norm(mount.xyz)) > STICK_OUT + holder:
        nose = -(STICK_OUT + holder)
        solids.append(_cylinder((0, 0, nose), (0, 0, -STICK_OUT), max(0.025, 1.4 * tool_radius), "metal"))
        solids.append(_cylinder((0, 0, nose - 0.36), (0, 0, nose), 0.075, "metal"))  # the spindle
    return solids


LINKS = ("the base", *(f"link {k + 1}" for k in range(6)), "the adapter of the spindle", "the spindle")


def link_capsules(arm: Arm, mount: Mount, stick_out: float = 0.0) -> list[tuple[int, np.ndarray, np.ndarray, float]]:
    """Return the capsules within the solids: index in LINKS, ends in the frame of the link (3,), radius [m].

    The column of base and link 1 is one solid. stick_out [m]: the spindle begins above it. Cutter and holder are left
    out, and link 6 where nothing is mounted on it: it is the tool then.
    """
    base, first, *others = _arm_solids(arm)
    column = _cylinder(ORIGIN, (0.0, 0.0, 0.8 * arm.d1), base[1].size[0], "dark")
    spindle, mounted = _spindle(mount, 0.01)[2:], [_adapter(mount)]
    up = np.array([0.0, 0.0, -max(stick_out - STICK_OUT, 0.0)])
    if not spindle:
        others, mounted = others[:-1], []
    capsules = []
    for link, solids in enumerate([[column], first[1:], *others, *mounted, spindle]):
        for solid in solids:
            size = solid.size  # of a box, else radius and length
            sides = size if len(size) == 3 else (2.0 * size[0], 2.0 * size[0], size[1])
            along, radius = int(np.argmax(sides)), 0.5 * min(sides)
            axis = rotation_from_abc(solid.rpy[::-1])[:, along] * (0.5 * max(sides) - radius)
            middle = solid.xyz + up if LINKS[link] == LINKS[-1] else solid.xyz
            capsules.append((link, middle - axis, middle + axis, radius))
    return capsules


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
