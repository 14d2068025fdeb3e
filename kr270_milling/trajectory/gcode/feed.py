"""The feed of a block: per minute (G94), per revolution (G95) or as the inverse of its time (G93)."""

from __future__ import annotations

import math

from kr270_milling.trajectory.toolpath import REACH

__all__ = ["Feed"]


class Feed:
    """The modal feed."""

    def __init__(self, default: float):
        self.mode = 94
        self.given: float | None = default or None  #: [m/s], [m/rev] or [1/s]; at first what the cell says

    def change(self, mode: int) -> None:
        """A feed of one kind means nothing as another."""
        if mode != self.mode:
            self.mode = mode
            self.given = None

    def give(self, value: float, unit: float) -> str:
        """Take a number F, lengths in ``unit`` [m]; returns what is wrong with it, "" if nothing."""
        most = 60 * REACH / unit
        if not 0 <= value <= most:
            return f"the feed F{value:g} must lie between 0 and {most:g} per minute"
        self.given = {94: value * unit / 60, 95: value * unit, 93: value / 60}[self.mode]
        return ""

    def rate(self, length: float, speed: float) -> float | None:
        """[m/s] over a move of ``length`` [m] at a spindle speed [rad/s]; None where no feed was given."""
        if self.given is None or self.mode == 94:
            return self.given
        if self.mode == 95:
            return self.given * abs(speed) / (2 * math.pi) if speed else None
        return self.given * length
