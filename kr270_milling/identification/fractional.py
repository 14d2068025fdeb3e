"""The fractional law (26)-(28) fitted to mean forces: its chip thickness is bent, so the means are integrated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kr270_milling.base.record import specs
from kr270_milling.cutting.laws import KLIMCHIK2012, FractionalLaw, fractional
from kr270_milling.identification.cuts import Cuts
from kr270_milling.identification.forces import OneFeedError
from kr270_milling.identification.linear import half_interval, scatter, solve

__all__ = ["FractionalFit", "fit_fractional", "fractional_mean_forces"]

POINTS = np.polynomial.legendre.leggauss(48)
LOWEST = np.array([1e3, 1e-7, 0.0, 0.0])
HIGHEST = np.array([1e9, 1e-2, 1.0, 10.0])


@dataclass(frozen=True, eq=False)
class FractionalFit:
    """k_0, h_s, r, k_r, k_a [N/m for 1 mm of depth, m] with their 95 % half widths; infinite: the data cannot tell.

    k_a is above 0 where the axial force pulls the tool toward the part, and NaN where fz was not measured.
    """

    cuts: Cuts
    values: np.ndarray  #: (5,)
    half_widths: np.ndarray  #: (5,)
    residuals: np.ndarray  #: measured less modelled [N], (n, 3)

    @property
    def residual_rms(self) -> float:
        """[N], of F_x and F_y."""
        return float(np.sqrt(np.nanmean(self.residuals[:, :2] ** 2)))

    def as_dict(self) -> dict:
        """In units of the parameter file."""
        keys = [(spec.key, spec.scale) for spec in specs(FractionalLaw)]
        values = {key: float(v / scale) for (key, scale), v in zip(keys, self.values, strict=True)}
        return {**values, "ci95": {key: float(w / s) for (key, s), w in zip(keys, self.half_widths, strict=True)}}


def fractional_mean_forces(cuts: Cuts, values) -> np.ndarray:
    """Mean forces on the tool [N], (n, 3): integrals of (26)-(29) over the engagement by Gauss' rule.

    values: k_0, h_s, r, k_r and k_a, if there is one; F_z = -k_a times the mean tangential force.
    """
    k_0, h_s, r, k_r, k_a = [*np.nan_to_num(values), 0.0][:5]
    half = (cuts.exit - cuts.entry)[:, None] / 2
    phi = cuts.entry[:, None] + half * (1 + POINTS[0])
    sine, cosine = np.sin(phi), np.cos(phi)
    tangential = fractional(cuts.feed_per_tooth[:, None] * cosine, k_0, h_s, r)
    weight = half * POINTS[1] * (cuts.tool.teeth * cuts.depth / (2 * np.pi))[:, None]
    f_x = np.sum(weight * tangential * (sine - k_r * cosine), axis=1)
    f_y = -cuts.tool.sense * np.sum(weight * tangential * (cosine + k_r * sine), axis=1)
    return np.stack([f_x, f_y, -k_a * np.sum(weight * tangential, axis=1)], -1)


def fit_fractional(cuts: Cuts, start: FractionalLaw | None = None) -> FractionalFit:
    """Non-linear least squares from the coefficients of ``start``. Raises OneFeedError for fewer than 3 feeds."""
    if cuts.feeds < 3 or 2 * len(cuts) <= 4:
        raise OneFeedError(cuts.feeds, len(cuts))
    law = start or KLIMCHIK2012
    scale = np.array([law.stiffness, law.specific_chip_thickness, max(law.ratio, 0.1), max(law.radial_ratio, 0.1)])
    first = np.array([law.stiffness, law.specific_chip_thickness, law.ratio, law.radial_ratio]) / scale

    def left(x):
        return ((fractional_mean_forces(cuts, x * scale) - cuts.force)[:, :2] / cuts.sigma[:, None]).ravel()

    first = np.clip(first, LOWEST / scale + 1e-9, HIGHEST / scale - 1e-9)
    solved = least_squares(left, first, bounds=(LOWEST / scale, HIGHEST / scale), x_scale="jac", xtol=1e-12, ftol=1e-12)
    freedom = 2 * len(cuts) - 4
    variance = scatter(2 * solved.cost, freedom, cuts.sigma_known)
    quantile = half_interval(freedom, cuts.sigma_known)
    _, singular, turned = np.linalg.svd(solved.jac, full_matrices=False)
    with np.errstate(divide="ignore"):
        inverse = (turned.T / np.where(singular > 1e-9 * singular[0], singular, 0.0) ** 2) @ turned
    widths = quantile * np.sqrt(variance * np.diag(inverse)) * scale
    ratio, width = _axial(cuts, solved.x * scale)
    values = np.append(solved.x * scale, ratio)
    residuals = cuts.force - fractional_mean_forces(cuts, values)
    return FractionalFit(cuts, values, np.append(np.nan_to_num(widths, nan=np.inf), width), residuals)


def _axial(cuts: Cuts, values: np.ndarray) -> tuple[float, float]:
    """k_a and its half width by a line through 0: F_z over the mean tangential force."""
    seen = np.isfinite(cuts.force[:, 2])
    if seen.sum() < 2:
        return np.nan, np.nan
    unit = fractional_mean_forces(cuts, [*values, 1.0])[seen, 2] / cuts.sigma[seen]
    ratio, _, width = solve(unit[:, None], cuts.force[seen, 2] / cuts.sigma[seen], cuts.sigma_known)
    return float(ratio[0]), float(width[0])
