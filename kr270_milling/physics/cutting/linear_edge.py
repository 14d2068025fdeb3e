"""The linear-edge force law [Altintas2012, section 2.8]: a part that grows with the chip and a part of the edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.record import parameter
from kr270_milling.physics.cutting.force_law import Cuts, ForceLaw


@njit(cache=True, error_model="numpy")
def linear_edge(h, k_c, k_e):
    """F / a_p = k_c h + k_e where h > 0, else 0, [N/m]; h: number or array [m]; k_c [N/m^2], k_e [N/m]."""
    return k_c * np.maximum(h, 0.0) + k_e * (h > 0.0)


def _force(h, tangential_cutting, tangential_edge, radial_cutting, radial_edge, axial_cutting, axial_edge):
    """F_t = (K_tc h + K_te) a_p, F_r = (K_rc h + K_re) a_p, F_a = (K_ac h + K_ae) a_p, each per depth [N/m]."""
    tangential = linear_edge(h, tangential_cutting, tangential_edge)
    radial = linear_edge(h, radial_cutting, radial_edge)
    return tangential, radial, linear_edge(h, axial_cutting, axial_edge)


@dataclass(frozen=True, eq=False)
class LinearEdgeLaw(ForceLaw):
    """F = (K_c h + K_e) a_p, tangential, radial and axial."""

    tangential_cutting: float = parameter(math.nan, unit="n_per_mm2", low=0.0, text="K_tc")
    tangential_edge: float = parameter(math.nan, unit="n_per_mm", low=0.0, text="K_te")
    radial_cutting: float = parameter(math.nan, unit="n_per_mm2", low=0.0, text="K_rc")
    radial_edge: float = parameter(math.nan, unit="n_per_mm", low=0.0, text="K_re")
    axial_cutting: float = parameter(
        0.0, unit="n_per_mm2", text="K_ac; above 0 it pulls the tool out of its holder, toward the part"
    )
    axial_edge: float = parameter(0.0, unit="n_per_mm", text="K_ae, with the sign of K_ac")

    force = staticmethod(_force)
    scattered = ("tangential_cutting", "tangential_edge", "radial_cutting", "radial_edge")
    axial_names = ("axial_cutting", "axial_edge")
    symbol = "line-ew-open"

    def mean_forces(self, cuts: Cuts) -> np.ndarray:
        """Closed form, see ``design``."""
        return self.design(cuts) @ self.coefficients

    @classmethod
    def design(cls, cuts: Cuts) -> np.ndarray:
        """Derivatives of the mean forces by the coefficients, (n, 3, 6), clockwise [Altintas2012, section 2.8].

        With c_2 = int cos^2, sc = int sin cos, c_1 = int cos, s_1 = int sin, 1_ = int 1 from entry to exit, all times
        N a / 2 pi:
        F_x = K_tc f sc + K_te s_1 - K_rc f c_2 - K_re c_1, F_y = K_tc f c_2 + K_te c_1 + K_rc f sc + K_re s_1,
        F_z = -(K_ac f c_1 + K_ae 1_). F_y has the other sign where the tool turns counterclockwise.
        """
        ends = np.stack([cuts.entry, cuts.exit])

        def between(integral):
            return np.diff(integral(ends), axis=0)[0]

        c_2 = between(lambda p: p / 2 + np.sin(2 * p) / 4)
        sc, c_1, s_1 = between(lambda p: np.sin(p) ** 2 / 2), between(np.sin), between(lambda p: -np.cos(p))
        arc, f = cuts.exit - cuts.entry, cuts.feed_per_tooth
        zero = np.zeros_like(f)
        rows = [
            [f * sc, s_1, -f * c_2, -c_1, zero, zero],
            [-cuts.tool.sense * term for term in (f * c_2, c_1, f * sc, s_1, zero, zero)],
            [zero, zero, zero, zero, -f * c_1, -arc],
        ]
        share = cuts.tool.teeth * cuts.depth / (2 * np.pi)
        return share[:, None, None] * np.moveaxis(np.array(rows), -1, 0)


AL7075_T6 = LinearEdgeLaw(600.46e6, 17.9e3, 180.96e6, 20.42e3)  #: review in the Chinese Journal of Mech. Eng., table 5
