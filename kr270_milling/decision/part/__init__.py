"""The part that a pass leaves: deviations along the path, errors of floors and walls, the part as STL."""

from __future__ import annotations

from kr270_milling.decision.part.assessment import FeatureRow, PartAssessment, assess, assess_all
from kr270_milling.decision.part.machined import heights_at, machined
from kr270_milling.decision.part.stl import write_part, write_stl
from kr270_milling.decision.part.surface import Floors, IdealPart, Surface, Walls, ideal_part, surface

__all__ = [
    "FeatureRow", "Floors", "IdealPart", "PartAssessment", "Surface", "Walls", "assess", "assess_all", "heights_at",
    "ideal_part", "machined", "surface", "write_part", "write_stl",
]  # fmt: skip
