"""Cutting force against uncut chip thickness: the fractional law (26)-(28) and the linear-edge law.

Both give force per depth of cut [N/m]: tangential, radial, and axial by coefficients of its own. The functions are
compiled, take a number or an array of chip thicknesses, and are the very ones that the sweep of the teeth calls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter, specs

__all__ = [
    "AL7075_T6", "KLIMCHIK2012", "FractionalLaw", "LinearEdgeLaw", "Cutting", "axial_per_depth", "fractional",
    "linear_edge", "force_per_depth",
]  # fmt: skip

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


@law
def axial_per_depth(is_fractional, c, h):
    """F_a / a_p = k_a F_t / a_p or K_ac h + K_ae [N/m] at chip thickness h [m]; c as in Cutting.coefficients."""
    if is_fractional:
        return c[4] * fractional(h, c[0], c[1], c[2])
    return linear_edge(h, c[4], c[5])


MISSING = math.nan  #: a coefficient that nobody gave; the law that is in use must have all of its own

AXIAL = "above 0 it pulls the tool out of its holder, toward the part"


@dataclass(frozen=True, eq=False)
class FractionalLaw(Record):
    """Coefficients of (26) and (28), and F_a / F_t."""

    stiffness: float = parameter(MISSING, unit="n_per_m", above=0.0, text="k_0, slope at h = 0 for 1 mm of depth")
    specific_chip_thickness: float = parameter(MISSING, unit="um", above=0.0, text="h_s")
    ratio: float = parameter(MISSING, low=0.0, high=1.0, text="r = k_inf / k_0")
    radial_ratio: float = parameter(MISSING, low=0.0, high=10.0, text="k_r = F_r / F_t")
    axial_ratio: float = parameter(0.0, low=-10.0, high=10.0, text=f"k_a = F_a / F_t; {AXIAL}")


@dataclass(frozen=True, eq=False)
class LinearEdgeLaw(Record):
    """F = (K_c h + K_e) a_p, tangential, radial and axial."""

    tangential_cutting: float = parameter(MISSING, unit="n_per_mm2", low=0.0, text="K_tc")
    tangential_edge: float = parameter(MISSING, unit="n_per_mm", low=0.0, text="K_te")
    radial_cutting: float = parameter(MISSING, unit="n_per_mm2", low=0.0, text="K_rc")
    radial_edge: float = parameter(MISSING, unit="n_per_mm", low=0.0, text="K_re")
    axial_cutting: float = parameter(0.0, unit="n_per_mm2", text=f"K_ac; {AXIAL}")
    axial_edge: float = parameter(0.0, unit="n_per_mm", text="K_ae, likewise")


KLIMCHIK2012 = FractionalLaw(5e6, 18e-6, 0.1, 0.3)  #: [Klimchik2012], section 6
AL7075_T6 = LinearEdgeLaw(600.46e6, 17.9e3, 180.96e6, 20.42e3)  #: review in the Chinese Journal of Mech. Eng., table 5


@dataclass(frozen=True, eq=False)
class Cutting(Record):
    """YAML ``cutting``: which law holds, and its coefficients; raises ParameterError where one of them is missing."""

    law: str = parameter("fractional", choices=("fractional", "linear_edge"), text="force law")
    fractional: FractionalLaw = FractionalLaw()
    linear_edge: LinearEdgeLaw = LinearEdgeLaw()
    chip_angle: str = parameter(
        "previous_centre",
        choices=("previous_centre", "nominal"),
        text="dphi of h = A / (R dphi): as seen from the tool centre of the step before, as section 4 has it; nominal: "
        "the spindle's, which damps vibrations along the tooth's motion too much",
    )
    moments: bool = parameter(
        True, text="moments of the forces about the tool tip, reaction torque of the spindle; false: forces only, (29)"
    )

    def check(self) -> None:
        law = getattr(self, self.law)
        for spec in specs(type(law)):
            if math.isnan(getattr(law, spec.name)):
                must = f"given where cutting.law is {self.law}: {spec.allowed} ({spec.text})"
                raise ParameterError(f"{self.law}.{spec.key}", None, must)

    @property
    def coefficients(self) -> np.ndarray:
        """(6,): k_0, h_s, r, k_r, k_a, 0 or K_tc, K_te, K_rc, K_re, K_ac, K_ae [SI]."""
        law = getattr(self, self.law)
        values = [getattr(law, spec.name) for spec in specs(type(law))]
        return np.array([*values, 0.0][:6])

    @property
    def axial(self) -> bool:
        """Whether the law has an axial force at all."""
        return bool(self.coefficients[4:].any())

    def force_per_depth(self, h):
        """Tangential and radial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return force_per_depth(self.law == "fractional", self.coefficients, h)

    def axial_per_depth(self, h):
        """Axial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return axial_per_depth(self.law == "fractional", self.coefficients, h)
