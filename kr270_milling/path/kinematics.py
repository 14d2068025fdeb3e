"""The machine that a five-axis program was posted for: its two rotary axes, in the head or below the workpiece.

The axes are listed from the workpiece to the tool. Their positive sense is that of the tool against the workpiece, by
the right-hand rule (ISO 841), whichever of the two moves. The tool axis against the workpiece is therefore R1 R2 z for
every machine. The places of the axes matter only while the control does not follow the tip (G43.4, TRAORI, M128).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import Record, parameter

LETTERS = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Kinematics(Record):
    """YAML ``machine``: the rotary axes of the machine that the G-code in ``path.file`` was posted for."""

    kinematics: str = parameter(
        "none",
        choices=("none", "table_table", "head_table", "head_head"),
        text="machine that G-code with A, B, C was posted for: what carries its rotary axes",
    )
    axes: tuple[str, ...] = parameter(
        ("C", "B"), choices=tuple(LETTERS), text="two rotary axes of the machine, from the workpiece to the tool"
    )
    first_direction: np.ndarray = parameter(
        [], text="direction of the first axis in the frame of the program; empty: x for A, y for B, z for C"
    )
    second_direction: np.ndarray = parameter(
        [], text="direction of the second axis; a nutating axis is not along x, y, z"
    )
    centre: np.ndarray = parameter(
        [0.0, 0.0, 0.0], unit="mm", low=-1e5, high=1e5, text="a point on both axes of a table, frame of the program"
    )
    pivot: float = parameter(
        0.0,
        unit="mm",
        low=0.0,
        high=1e4,
        text="from the tip to the axes of a head; for programs without G43.4, TRAORI, M128",
    )

    def check(self) -> None:
        if len(self.axes) != 2 or self.axes[0] == self.axes[1]:
            raise ParameterError("axes", list(self.axes), "two different ones of A, B, C")
        if self.centre.size not in (3, 6):
            allowed = "x, y, z of a point on both axes of the table, or of one point on each"
            raise ParameterError("centre_mm", (1e3 * self.centre).tolist(), allowed)
        for key in ("first_direction", "second_direction"):
            value = getattr(self, key)
            if value.size and (value.size != 3 or not abs(np.linalg.norm(value) - 1) < 1e-3):
                raise ParameterError(key, value.tolist(), "x, y, z of a vector of length 1")

    @property
    def letters(self) -> tuple[str, ...]:
        return () if self.kinematics == "none" else self.axes

    @functools.cached_property
    def _directions(self) -> list[tuple[float, ...]]:
        """The directions of both axes, of length 1."""
        stated = self.first_direction, self.second_direction
        rows = [given if given.size else LETTERS[letter] for given, letter in zip(stated, self.axes, strict=True)]
        return [tuple((np.array(row) / np.linalg.norm(row)).tolist()) for row in rows]

    def tool_axis(self, angles) -> tuple[float, ...]:
        """Return the tool axis from tip to holder, (3,), in the frame of the program at angles [deg], (2,): R1 R2 z.

        Each rotation by Rodrigues' formula, v cos + (k x v) sin + k (k . v) (1 - cos).
        """
        axis: tuple[float, ...] = (0.0, 0.0, 1.0)
        for k, angle in reversed(list(zip(self._directions, angles, strict=True))):
            s, c = math.sin(math.radians(angle)), math.cos(math.radians(angle))
            along = (k[0] * axis[0] + k[1] * axis[1] + k[2] * axis[2]) * (1 - c)
            x, y, z = axis
            axis = (
                x * c + (k[1] * z - k[2] * y) * s + k[0] * along,
                y * c + (k[2] * x - k[0] * z) * s + k[1] * along,
                z * c + (k[0] * y - k[1] * x) * s + k[2] * along,
            )
        return axis

    def tip(self, angles) -> Pose:
        """Return the map from X, Y, Z of the linear axes to the place of the tip on the workpiece, at angles [deg].

        A head turns the tip about its pivot: m = x + p - H p. A table turns the workpiece about its axes, so that the
        place on it is c1 + R1 (c2 - c1 + R2 (m - c2)).
        """
        turns = np.array(self._directions) * np.reshape(angles, (2, 1))
        first, second = Rotation.from_rotvec(turns, degrees=True).as_matrix()
        pivot, centres = np.array([0.0, 0.0, self.pivot]), np.resize(self.centre, 6).reshape(2, 3)
        if self.kinematics == "head_head":
            return Pose(pivot - first @ second @ pivot, np.eye(3))
        c1, c2 = centres
        if self.kinematics == "head_table":
            return Pose(c1 - first @ c1, first) @ Pose(pivot - second @ pivot, np.eye(3))
        return Pose(c1 - first @ c1, first) @ Pose(c2 - second @ c2, second)


NO_ROTARY_AXES = Kinematics()
