"""Kienzle's force law: a third law, which the tests add to a copy of the package as one file and one row of LAWS."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kr270_milling.base.record import parameter
from kr270_milling.physics.cutting.force_law import ForceLaw

__all__ = ["KienzleLaw"]

MILLIMETRE = 1e-3  # [m]


def _force(h, c):
    """F_t / a_p = k_c1.1 h (h / 1 mm)^-m_c [Kienzle1952], F_r = k_r F_t, each per depth of cut [N/m]."""
    tangential = 0.0
    if h > 0.0:
        tangential = c[0] * h * (h / MILLIMETRE) ** -c[1]
    return tangential, c[2] * tangential, 0.0


@dataclass(frozen=True, eq=False)
class KienzleLaw(ForceLaw):
    """F_t = k_c1.1 h^(1 - m_c) a_p and F_r / F_t."""

    specific_force: float = parameter(math.nan, unit="n_per_mm2", above=0.0, text="k_c1.1, at 1 mm of chip thickness")
    exponent: float = parameter(math.nan, low=0.0, high=0.9, text="m_c")
    radial_ratio: float = parameter(math.nan, low=0.0, high=10.0, text="k_r = F_r / F_t")

    force = staticmethod(_force)
    scattered = ("specific_force", "exponent", "radial_ratio")
    start = (1e9, 0.3, 0.3)
    searched = ((1e7, 1e11), (0.0, 0.9), (0.0, 10.0))
