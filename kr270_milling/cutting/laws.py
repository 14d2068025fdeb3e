"""Cutting force against uncut chip thickness: the fractional law (26)-(28) and the linear-edge law.

Both give force per depth of cut [N/m]. The functions are compiled, take a number or an array of chip thicknesses,
and are the very ones that the sweep of the teeth calls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.record import Record, parameter

__all__ = ["FractionalLaw", "LinearEdgeLaw", "Cutting", "fractional", "linear_edge", "force_per_depth"]

#: The paper's k_0 is read as the slope for one millimetre of depth: F_t = k_0 h_s psi(h / h_s) a_p / (1 mm).
READING_DEPTH = 1e-3  # [m]

law = njit(cache=True, error_model="numpy")  # not ``compiled``: with arrays of h they make arrays


@law
def fractional(h, k_0, h_s, r):
    """(26), (27): force per depth [N/m] at chip thickness h [m]; k_0 [N/m for 1 mm of depth], h_s [m]."""
    u = np.maximum(h, 0.0) / h_s
    return k_0 * h_s * (u + r * u * u) / (1.0 + u) / READING_DEPTH


@law
def linear_edge(h, k_c, k_e):
    """Force per depth k_c h + k_e [N/m] at chip thickness h [m], 0 without a chip; k_c [N/m^2], k_e [N/m]."""
    return k_c * np.maximum(h, 0.0) + k_e * (h > 0.0)


@law
def force_per_depth(is_fractional, c, h):
    """Tangential and radial force per depth [N/m] at chip thickness h [m]; c as in Cutting.coefficients."""
    if is_fractional:
        tangential = fractional(h, c[0], c[1], c[2])
        return tangential, c[3] * tangential  # (28)
    return linear_edge(h, c[0], c[1]), linear_edge(h, c[2], c[3])


@dataclass(frozen=True, eq=False)
class FractionalLaw(Record):
    """Coefficients of (26) and (28); the defaults are the paper's."""

    stiffness: float = parameter(5e6, unit="n_per_m", above=0.0, text="k_0, slope at h = 0 for 1 mm of depth")
    specific_chip_thickness: float = parameter(18e-6, unit="um", above=0.0, text="h_s")
    ratio: float = parameter(0.1, low=0.0, high=1.0, text="r = k_inf / k_0")
    radial_ratio: float = parameter(0.3, low=0.0, high=10.0, text="k_r = F_r / F_t")


@dataclass(frozen=True, eq=False)
class LinearEdgeLaw(Record):
    """F = (K_c h + K_e) a_p, tangential and radial; the defaults are for Al7075-T6."""

    tangential_cutting: float = parameter(600.46e6, unit="n_per_mm2", low=0.0, text="K_tc")
    tangential_edge: float = parameter(17.9e3, unit="n_per_mm", low=0.0, text="K_te")
    radial_cutting: float = parameter(180.96e6, unit="n_per_mm2", low=0.0, text="K_rc")
    radial_edge: float = parameter(20.42e3, unit="n_per_mm", low=0.0, text="K_re")


@dataclass(frozen=True, eq=False)
class Cutting(Record):
    """Which law holds, and the coefficients of both."""

    law: str = parameter("fractional", choices=("fractional", "linear_edge"), text="force law")
    fractional: FractionalLaw = FractionalLaw()
    linear_edge: LinearEdgeLaw = LinearEdgeLaw()

    @property
    def coefficients(self) -> np.ndarray:
        """(4,): k_0, h_s, r, k_r or K_tc, K_te, K_rc, K_re [SI]."""
        if self.law == "fractional":
            law = self.fractional
            return np.array([law.stiffness, law.specific_chip_thickness, law.ratio, law.radial_ratio])
        law = self.linear_edge
        return np.array([law.tangential_cutting, law.tangential_edge, law.radial_cutting, law.radial_edge])

    def force_per_depth(self, h):
        """Tangential and radial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return force_per_depth(self.law == "fractional", self.coefficients, h)
