"""A force sensor between flange and tool: its place in the cell, and the wrench at the tool tip from its readings."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import Record, parameter

WIDE = 5000.0  # [mm]


@dataclass(frozen=True, eq=False)
class ForceSensor(Record):
    """YAML ``sensor``: a force sensor with its own frame; the compensator subtracts offset and weight."""

    frame: str = parameter("", text="frame_id of the messages of a force sensor that is not tared; empty: no sensor")
    xyz: np.ndarray = parameter(
        [0.0, 0.0, 0.0], unit="mm", size=3, low=-WIDE, high=WIDE, text="origin of its frame in tool0"
    )
    abc: np.ndarray = parameter(
        [0.0, 0.0, 0.0], unit="deg", size=3, low=-360.0, high=360.0, text="A, B, C of its frame in tool0"
    )
    mass: float = parameter(0.0, unit="kg", low=0.0, high=5000.0, text="mass of what the sensor carries")
    mass_centre: np.ndarray = parameter(
        [0.0, 0.0, 0.0], unit="mm", size=3, low=-WIDE, high=WIDE, text="centre of this mass in the frame of the sensor"
    )

    def check(self) -> None:
        taken = ("workpiece", "tcp", "base", "base_link", "flange")  # frames whose wrenches are tared already
        if self.frame in taken:
            raise ParameterError("frame", self.frame, f"tool0 or a name other than {', '.join(taken)}")

    @functools.cached_property
    def pose(self) -> Pose:
        """Maps coordinates of the sensor to coordinates of tool0."""
        return Pose.from_abc(self.xyz, self.abc)

    def weight(self, gravity: np.ndarray) -> np.ndarray:
        """Return the reading [N, N m], (..., 6), under the weight alone: F = m g, M = c x m g.

        gravity: (..., 3) [m/s^2], axes of the sensor.
        """
        return np.concatenate([self.mass * gravity, np.cross(self.mass_centre, self.mass * gravity)], axis=-1)


def moved_wrench(wrench: np.ndarray, frame: Pose) -> np.ndarray:
    """Return wrenches (..., 6) [N, N m] in the axes and at the origin of another frame: F' = R F, M' = R M + p x R F.

    frame: maps coordinates (R, p) of the frame of ``wrench`` to the other frame (statics of a rigid body).
    """
    force, moment = (np.einsum("...ij,...j->...i", frame.rotation, part) for part in (wrench[..., :3], wrench[..., 3:]))
    return np.concatenate([force, moment + np.cross(frame.position, force)], axis=-1)
