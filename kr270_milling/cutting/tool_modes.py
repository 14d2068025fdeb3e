"""Measured modes of tool, holder and spindle: YAML ``tool.modes``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter

__all__ = ["ToolModes"]


@dataclass(frozen=True, eq=False)
class ToolModes(Record):
    """YAML ``tool.modes``: a list with one group a mode, or one group of lists; at the tool tip, workpiece axes.

    A mode of modal mass m along the unit vector d answers a force F at the tip with d (d . F) / m / (omega^2 - s^2 +
    2 i zeta omega s). They are too fast for the exchange of the nodes; ``stability`` takes them beside the arm's.
    """

    direction: np.ndarray = parameter([], low=-1.0, high=1.0, text="unit vector x, y, z of each mode")
    frequency: np.ndarray = parameter([], unit="hz", above=0.0, high=1e5, text="undamped natural frequency of each")
    damping_ratio: np.ndarray = parameter([], low=0.0, high=0.99, text="damping ratio of each mode")
    mass: np.ndarray = parameter([], unit="kg", above=0.0, high=1e4, text="modal mass of each mode")

    def check(self) -> None:
        n = self.frequency.size
        for key, size in (("damping_ratio", n), ("mass", n), ("direction", 3 * n)):
            values = getattr(self, key)
            if values.size != size:
                raise ParameterError(key, values.tolist(), f"a list of {size} numbers for {n} modes")
        length = np.linalg.norm(self.direction.reshape(n, 3), axis=1)
        if n and not np.allclose(length, 1.0, atol=1e-3):
            raise ParameterError("direction", self.direction.tolist(), "unit vectors")

    @property
    def shapes(self) -> np.ndarray:
        """Mass-normalised shapes [kg^-1/2], (n, 3)."""
        n = self.frequency.size
        return self.direction.reshape(n, 3) / np.sqrt(self.mass)[:, None]
