"""Coordinate systems of a program: work offsets, G92, G52, G10 L2 and rotation, relative to the frame of the path.

A place is offset + turn (preset + pattern), as in LinuxCNC; G68 turns the pattern about a point (Fanuc).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

#: work offsets with a number, as G10 L2 P and the parameters 5221 ff. count them
NAMES = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")


class Offsets:
    """Work offsets [m, rad] and shifts [m]; where none is known the frame of the path is that of the first move."""

    def __init__(self, places: Sequence[float]):
        """places: x, y, z of G54, G55 ... in the workpiece frame; without any the path starts in its own frame."""
        self.given = bool(places)
        self.systems = {name: [*places[3 * n : 3 * n + 3], 0.0] for n, name in enumerate(NAMES[: len(places) // 3])}
        self.active = NAMES[0]
        self.preset = [0.0] * 3  #: G92 or G52
        self.stored = [0.0] * 3  #: that of G92 before G92.2
        self.local = False  #: the preset is one of G52
        self.turn = 1 + 0j  #: G68
        self.centre = 0j
        self.base: tuple[complex, complex, float] | None = (1 + 0j, 0j, 0.0) if places else None

    def known(self, name: str) -> bool:
        """Return whether the place of a work offset is known."""
        return name in self.systems and all(map(math.isfinite, self.systems[name]))

    @property
    def affine(self) -> tuple[complex, complex, float]:
        """Factor, xy and z of the map from coordinates of the program to those of the machine."""
        x, y, z, angle = self.systems[self.active] if self.known(self.active) else (0.0,) * 4
        turn = cmath.rect(1.0, angle) if angle else 1 + 0j
        pattern = self.centre - self.turn * self.centre
        return turn * self.turn, complex(x, y) + turn * (complex(*self.preset[:2]) + pattern), z + self.preset[2]

    @property
    def shift(self) -> tuple[complex, complex, float] | None:
        """Factor, xy [m] and z [m] of the map from coordinates of the program to the path; None where they agree."""
        if self.base is None:
            return None
        (turn, xy, z), (base_turn, base_xy, base_z) = self.affine, self.base
        shift = turn / base_turn, (xy - base_xy) / base_turn, z - base_z
        return None if shift == (1, 0, 0) else shift
