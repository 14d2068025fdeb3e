"""URDF of the arm for viewers: links with simple solids, joint limits, flange, tool0 and, if wanted, the workpiece."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from kr270_milling.base.frames import Pose, abc_from_rotation
from kr270_milling.robot.arm import AXES, Arm, Mount
from kr270_milling.robot.solids import COLOURS, Solid, link_solids

__all__ = ["urdf"]


def urdf(arm: Arm, mount: Mount, tool_radius: float = 0.01, workpiece: Pose | None = None) -> str:
    """URDF text: base_link, link_1 to link_6, flange, tool0; joints joint_a1 to joint_a6 [m, rad, kg].

    tool_radius [m] of the cutter that is shown; workpiece: its frame on base_link, as a further fixed link.
    """
    root = ET.Element("robot", name="kr270")
    for name, rgb in COLOURS.items():
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=_text([*rgb, 1.0]))
    solids, ends = link_solids(arm, mount, tool_radius), arm.link_vectors
    _visuals(ET.SubElement(root, "link", name="base_link"), solids["base_link"])
    for j in range(6):
        name = f"link_{j + 1}"
        link = ET.SubElement(root, "link", name=name)
        _visuals(link, solids[name])
        _inertial(link, ends[j], float(arm.link_mass[j]))
    offsets = [np.zeros(3), *ends[:5]]
    for j, (axis, offset) in enumerate(zip(AXES, offsets, strict=True)):
        parent = "base_link" if j == 0 else f"link_{j}"
        _joint(root, arm, j, parent, axis, offset)
    _fixed(root, "flange", "link_6", ends[5], np.zeros(3), solids["flange"])
    _fixed(root, "tool0", "flange", mount.xyz, _rpy(mount.pose.rotation), solids["tool0"])
    if workpiece is not None:
        _fixed(root, "workpiece", "base_link", workpiece.position, _rpy(workpiece.rotation), [])
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _rpy(rotation: np.ndarray) -> np.ndarray:
    """URDF's roll, pitch, yaw are KUKA's C, B, A."""
    return abc_from_rotation(rotation)[::-1]


def _text(values) -> str:
    return " ".join(f"{float(v) + 0.0:.9g}" for v in values)


def _visuals(link, solids: list[Solid]) -> None:
    for solid in solids:
        visual = ET.SubElement(link, "visual")
        ET.SubElement(visual, "origin", xyz=_text(solid.xyz), rpy=_text(solid.rpy))
        geometry = ET.SubElement(visual, "geometry")
        if solid.is_box:
            ET.SubElement(geometry, "box", size=_text(solid.size))
        else:
            radius, length = solid.size
            ET.SubElement(geometry, "cylinder", radius=f"{radius:.9g}", length=f"{length:.9g}")
        ET.SubElement(visual, "material", name=solid.colour)


def _inertial(link, end: np.ndarray, mass: float) -> None:
    """A rod from the link's origin to its end, as a viewer needs some number."""
    length = float(np.linalg.norm(end))
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(end / 2), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.9g}")
    moment = f"{mass * max(length, 0.1) ** 2 / 12:.9g}"
    ET.SubElement(inertial, "inertia", ixx=moment, iyy=moment, izz=moment, ixy="0", ixz="0", iyz="0")


def _joint(root, arm: Arm, j: int, parent: str, axis, offset: np.ndarray) -> None:
    joint = ET.SubElement(root, "joint", name=f"joint_a{j + 1}", type="revolute")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=f"link_{j + 1}")
    ET.SubElement(joint, "origin", xyz=_text(offset), rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz=_text(axis))
    low, high, speed = arm.joint_lower[j], arm.joint_upper[j], arm.joint_speed_limit[j]
    ET.SubElement(joint, "limit", lower=f"{low:.9g}", upper=f"{high:.9g}", velocity=f"{speed:.9g}", effort="0")


def _fixed(root, name: str, parent: str, xyz: np.ndarray, rpy: np.ndarray, solids: list[Solid]) -> None:
    _visuals(ET.SubElement(root, "link", name=name), solids)
    joint = ET.SubElement(root, "joint", name=f"{parent}_{name}", type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=name)
    ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
