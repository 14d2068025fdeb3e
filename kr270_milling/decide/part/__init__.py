"""The part that a pass leaves: deviations along the path, errors of floors and walls, the part as STL."""

from kr270_milling.decide.part.assessment import FeatureRow, PartAssessment, assess, assess_all
from kr270_milling.decide.part.surface import heights_at, ideal_part, machined, surface, write_part, write_stl

__all__ = [
    "FeatureRow",
    "PartAssessment",
    "assess",
    "assess_all",
    "heights_at",
    "ideal_part",
    "machined",
    "surface",
    "write_part",
    "write_stl",
]
