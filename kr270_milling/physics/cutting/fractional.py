"""The fractional force law (26)-(28) [Klimchik2014]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.record import parameter
from kr270_milling.physics.cutting.force_law import ChartLine, ForceLaw

#: The paper's k_0 is read as the slope for one millimetre of depth: F_t = k_0 h_s psi(h / h_s) a_p / (1 mm).
READING_DEPTH = 1e-3  # [m]


@njit(cache=True, error_model="numpy")
def fractional(h, k_0, h_s, r):
    """F_t / a_p = k_0 h_s (u + r u^2) / (1 + u) / (1 mm), u = h / h_s   (26), (27) [Klimchik2014], [N/m].

    h: chip thickness, number or array [m]; k_0 [N/m for 1 mm of depth]; h_s [m]; r = k_inf / k_0.
    """
    u = np.maximum(h, 0.0) / h_s
    return k_0 * h_s * (u + r * u * u) / (1.0 + u) / READING_DEPTH


def _force(h, stiffness, specific_chip_thickness, ratio, radial_ratio, axial_ratio):
    """F_t by (26), F_r = k_r F_t   (28), F_a = k_a F_t, each per depth of cut [N/m]."""
    tangential = fractional(h, stiffness, specific_chip_thickness, ratio)
    return tangential, radial_ratio * tangential, axial_ratio * tangential


@dataclass(frozen=True, eq=False)
class FractionalLaw(ForceLaw):
    """Coefficients of (26) and (28), and F_a / F_t."""

    stiffness: float = parameter(math.nan, unit="n_per_m", above=0.0, text="k_0, slope at h = 0 for 1 mm of depth")
    specific_chip_thickness: float = parameter(math.nan, unit="um", above=0.0, text="h_s")
    ratio: float = parameter(math.nan, low=0.0, high=1.0, text="r = k_inf / k_0")
    radial_ratio: float = parameter(math.nan, low=0.0, high=10.0, text="k_r = F_r / F_t")
    axial_ratio: float = parameter(
        0.0, low=-10.0, high=10.0, text="k_a = F_a / F_t; above 0 it pulls the tool out of its holder, toward the part"
    )

    force = staticmethod(_force)
    scattered = ("stiffness", "specific_chip_thickness", "radial_ratio")  # the ratio of the slopes is the law's shape
    axial_names = ("axial_ratio",)
    start = (5e6, 18e-6, 0.1, 0.3)  # [Klimchik2014]
    searched = ((1e3, 1e9), (1e-7, 1e-2), (0.0, 1.0), (0.0, 10.0))
    least_feeds = 3
    symbol = "x-thin-open"
    caption = "Thin chips take more force for their size."

    def lines(self, h: np.ndarray) -> list[ChartLine]:
        """Tangent at h = 0, k_0 h, and asymptote, k_0 (r h + (1 - r) h_s)."""
        slope = self.stiffness / READING_DEPTH
        far = self.ratio * h + (1 - self.ratio) * self.specific_chip_thickness
        return [
            ChartLine("slope k_0 at h = 0", slope * h, 1),
            ChartLine("asymptote, slope k_∞ = r k_0", slope * far, 3),
        ]

    def marks(self) -> list[tuple[float, str]]:
        return [(self.specific_chip_thickness, "h_s")]

    def assumptions(self, feed_per_tooth: float) -> list[tuple[str, str, str]]:
        force = float(self.per_depth(feed_per_tooth)[0]) * 1e-3  # [N per mm of depth]
        printed = force * READING_DEPTH * 1e-3 / self.specific_chip_thickness  # (26) to the letter [kN per mm of depth]
        return [
            (
                "reading of (26)",
                f"k_0 per millimetre of depth: {force:.1f} N per mm of depth at h = {feed_per_tooth * 1e6:.0f} µm",
                f"As printed, k_0 ψ(h/h_s) a_p gives {printed:.1f} kN per mm of depth for one tooth, which would bend "
                "the arm by millimetres. F_t = k_0 h_s ψ(h/h_s) a_p / (1 mm) is the reading of ordinary size.",
            )
        ]
