"""URDF of the arm for viewers: links as boxes between the joints, limits, flange and tool0."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from kr270_milling.base.frames import abc_from_rotation
from kr270_milling.robot.arm import Arm, Mount

__all__ = ["urdf"]

AXES = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]  # KUKA signs


def urdf(arm: Arm, mount: Mount) -> str:
    """URDF text: base_link, link_1 to link_6, flange, tool0; joints joint_a1 to joint_a6 [m, rad, kg]."""
    root = ET.Element("robot", name="kr270")
    ET.SubElement(root, "link", name="base_link")
    ends = arm.link_vectors
    for j in range(6):
        _link(root, f"link_{j + 1}", ends[j], float(arm.link_mass[j]))
    offsets = [np.zeros(3), *ends[:5]]
    for j, (axis, offset) in enumerate(zip(AXES, offsets, strict=True)):
        parent = "base_link" if j == 0 else f"link_{j}"
        _joint(root, arm, j, parent, axis, offset)
    _fixed(root, "flange", "link_6", ends[5], np.zeros(3))
    _fixed(root, "tool0", "flange", mount.xyz, abc_from_rotation(mount.pose.rotation)[::-1])
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _text(values) -> str:
    return " ".join(f"{float(v):.9g}" for v in values)


def _link(root, name: str, end: np.ndarray, mass: float) -> None:
    link = ET.SubElement(root, "link", name=name)
    length = float(np.linalg.norm(end))
    if length > 0.0:
        axis = end / length  # a URDF cylinder lies along z: roll about x, then pitch about y, brings z there
        rpy = (0.0, float(np.arctan2(np.hypot(axis[0], axis[1]), axis[2])), float(np.arctan2(axis[1], axis[0])))
        visual = ET.SubElement(link, "visual")
        ET.SubElement(visual, "origin", xyz=_text(end / 2), rpy=_text(rpy))
        geometry = ET.SubElement(visual, "geometry")
        ET.SubElement(geometry, "cylinder", radius="0.08", length=f"{length:.9g}")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_text(end / 2), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.9g}")
    moment = f"{mass * max(length, 0.1) ** 2 / 12:.9g}"  # a rod, as a viewer needs some number
    ET.SubElement(inertial, "inertia", ixx=moment, iyy=moment, izz=moment, ixy="0", ixz="0", iyz="0")


def _joint(root, arm: Arm, j: int, parent: str, axis, offset: np.ndarray) -> None:
    joint = ET.SubElement(root, "joint", name=f"joint_a{j + 1}", type="revolute")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=f"link_{j + 1}")
    ET.SubElement(joint, "origin", xyz=_text(offset), rpy="0 0 0")
    ET.SubElement(joint, "axis", xyz=_text(axis))
    low, high, speed = arm.joint_lower[j], arm.joint_upper[j], arm.joint_speed_limit[j]
    ET.SubElement(joint, "limit", lower=f"{low:.9g}", upper=f"{high:.9g}", velocity=f"{speed:.9g}", effort="0")


def _fixed(root, name: str, parent: str, xyz: np.ndarray, rpy: np.ndarray) -> None:
    ET.SubElement(root, "link", name=name)
    joint = ET.SubElement(root, "joint", name=f"{parent}_{name}", type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=name)
    ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))
