"""Simple solids for the links of the arm, spindle and tool: boxes and cylinders, sized by the link lengths.

They are for the eye only: own primitives by the look of a heavy arm, no maker's meshes. Collision is not their job.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.frames import abc_from_rotation
from kr270_milling.robot.arm import Arm, Mount

__all__ = ["COLOURS", "Solid", "link_solids"]

#: material of a solid -> red, green, blue, from 0 to 1
COLOURS = {
    "arm": (0.90, 0.45, 0.10),
    "dark": (0.22, 0.24, 0.27),
    "metal": (0.62, 0.65, 0.69),
    "tool": (0.80, 0.70, 0.30),
}
REACH = 2.35  #: [m], a2 + d4 of the KR 270-2, by whose look the widths are chosen
STICK_OUT = 0.04  #: [m] of the tool from its holder
HOLDER = 0.06  #: [m] of the holder from the spindle nose
HOUSING = 0.36  #: [m] of the spindle


@dataclass(frozen=True, eq=False)
class Solid:
    """A box of ``size`` (x, y, z), or a cylinder of ``size`` (radius, length) along its z axis [m]."""

    size: tuple[float, ...]
    xyz: np.ndarray  #: of its middle in the frame of the link [m], (3,)
    rpy: np.ndarray  #: of its axes there, URDF's roll, pitch, yaw [rad], (3,)
    colour: str

    @property
    def is_box(self) -> bool:
        return len(self.size) == 3


def _between(start, end, radius: float, colour: str) -> Solid:
    """A cylinder from one point to another [m]."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    along = end - start
    length = float(np.linalg.norm(along))
    axis = along / length  # roll about x, then pitch about y, then yaw about z bring z there
    rpy = np.array([0.0, np.arctan2(np.hypot(axis[0], axis[1]), axis[2]), np.arctan2(axis[1], axis[0])])
    return Solid((radius, length), (start + end) / 2, rpy, colour)


def _box(size, middle, colour: str, rpy=(0.0, 0.0, 0.0)) -> Solid:
    return Solid(tuple(map(float, size)), np.asarray(middle, float), np.asarray(rpy, float), colour)


def _hub(at, radius: float, length: float, colour: str) -> Solid:
    """A cylinder along y about a joint axis."""
    half = np.array([0.0, length / 2, 0.0])
    return _between(np.asarray(at, float) - half, np.asarray(at, float) + half, radius, colour)


def link_solids(arm: Arm, mount: Mount, tool_radius: float = 0.01) -> dict[str, list[Solid]]:
    """Name of each link of the URDF -> its solids, in the frame of the link."""
    s = (arm.a2 + arm.d4) / REACH
    return {
        "base_link": [
            _box((0.80 * s, 0.80 * s, 0.06 * s), (0.0, 0.0, 0.03 * s), "dark"),
            _between((0, 0, 0.06 * s), (0, 0, 0.42 * arm.d1), 0.30 * s, "dark"),
        ],
        "link_1": [
            _between((0, 0, 0.42 * arm.d1), (0, 0, 0.80 * arm.d1), 0.33 * s, "arm"),
            _box((arm.a1 + 0.2 * s, 0.30 * s, 0.36 * s), (0.5 * arm.a1, 0.0, arm.d1 - 0.06 * s), "arm"),
            _hub((arm.a1, 0.0, arm.d1), 0.20 * s, 0.46 * s, "dark"),
        ],
        "link_2": [
            _box((arm.a2, 0.20 * s, 0.26 * s), (0.5 * arm.a2, 0.0, 0.0), "arm"),
            _hub((0.0, 0.0, 0.0), 0.19 * s, 0.34 * s, "arm"),
            _hub((arm.a2, 0.0, 0.0), 0.16 * s, 0.30 * s, "arm"),
        ],
        "link_3": [
            _hub((0.0, 0.0, 0.0), 0.13 * s, 0.40 * s, "dark"),
            _box((0.42 * s, 0.26 * s, 0.28 * s), (-0.04 * s, 0.0, arm.a3), "arm"),
        ],
        "link_4": [
            _between((0.12 * s, 0, 0), (0.55 * arm.d4, 0, 0), 0.125 * s, "arm"),
            _between((0.55 * arm.d4, 0, 0), (arm.d4 - 0.10 * s, 0, 0), 0.105 * s, "arm"),
            _box((0.20 * s, 0.18 * s, 0.16 * s), (arm.d4 - 0.06 * s, 0.0, 0.0), "arm"),
        ],
        "link_5": [_hub((0.0, 0.0, 0.0), 0.095 * s, 0.22 * s, "dark")],
        "link_6": [_between((0.02 * s, 0, 0), (arm.d6, 0, 0), 0.085 * s, "metal")],
        "flange": _adapter(mount),
        "tool0": _spindle(mount, tool_radius),
    }  # fmt: skip


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
    """Tool, holder and, where the tip is far enough from the flange, the housing; tool0's z points to the tip."""
    solids = [_between((0, 0, -STICK_OUT), (0, 0, 0), tool_radius, "tool")]
    if float(np.linalg.norm(mount.xyz)) > STICK_OUT + HOLDER:
        nose = -(STICK_OUT + HOLDER)
        solids.append(_between((0, 0, nose), (0, 0, -STICK_OUT), max(0.025, 1.4 * tool_radius), "metal"))
        solids.append(_between((0, 0, nose - HOUSING), (0, 0, nose), 0.075, "metal"))
    return solids
