"""YAML ``part``: how far the part may be from what was programmed."""

from __future__ import annotations

from dataclasses import dataclass

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter

__all__ = ["Part"]


@dataclass(frozen=True, eq=False)
class Part(Record):
    """Tolerances [m]: half widths of the band about the nominal surface; 0: none is asked for.

    A feature takes its own tolerance, else that of walls or floors, else ``tolerance``.
    """

    tolerance: float = parameter(0.0, unit="um", low=0.0, high=1e5, text="of walls and floors; 0: not asked for")
    wall_tolerance: float = parameter(0.0, unit="um", low=0.0, high=1e5, text="of walls; 0: that of the part")
    floor_tolerance: float = parameter(0.0, unit="um", low=0.0, high=1e5, text="of floors; 0: that of the part")
    features: tuple[str, ...] = parameter((), text="tolerances of single features in um, as name=30")

    def check(self) -> None:
        for text in self.features:
            _feature(text)

    def of(self, feature: str | None = None) -> tuple[float, float]:
        """Tolerance of the walls and of the floors [m] of a feature, or of the whole part; 0: none is asked for."""
        own = dict(map(_feature, self.features))
        if feature in own:
            return own[feature], own[feature]
        return self.wall_tolerance or self.tolerance, self.floor_tolerance or self.tolerance


def _feature(text: str) -> tuple[str, float]:
    name, equals, number = text.rpartition("=")
    try:
        value = float(number) * 1e-6
    except ValueError:
        value = -1.0
    if not (equals and name and 0.0 < value < 0.1):
        raise ParameterError("features", text, "the name of a feature, =, and its tolerance in um")
    return name, value
