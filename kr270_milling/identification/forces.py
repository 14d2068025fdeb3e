"""Force coefficients from mean forces over a revolution [Altintas2012, section 2.8], for any immersion.

With h = f cos(phi), N teeth, depth a, and the means c_2 = int cos^2, sc = int sin cos, c_1 = int cos, s_1 = int sin,
1_ = int 1 over the engagement, all times N a / 2 pi, the forces on a tool that turns clockwise are

    F_x = K_tc f sc  + K_te s_1 - K_rc f c_2 - K_re c_1,
    F_y = K_tc f c_2 + K_te c_1 + K_rc f sc  + K_re s_1,
    F_z = s (K_ac f c_1 + K_ae 1_),

and F_y has the other sign where it turns counterclockwise. With z out of the part, s = -1 where the axial force pulls
the tool toward the part (as ``cutting`` has it), +1 where it pushes the tool into its holder; K_ac and K_ae then are
positive, as published ones are. A helix does not change means over whole revolutions.
The coefficients follow by weighted linear least squares over all cuts. The fractional law (26)-(28) bends its chip
thickness: its means are integrated, and its coefficients follow by non-linear least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import specs
from kr270_milling.cell.plant import SCATTERED, SCATTERED_AXIAL
from kr270_milling.cutting.laws import KLIMCHIK2012, FractionalLaw, LinearEdgeLaw, fractional
from kr270_milling.identification.cuts import Cuts
from kr270_milling.identification.intervals import MixedUpError, half_interval, scatter, solve

__all__ = [
    "NAMES", "SCALE", "TOWARD_PART", "LawFit", "OneFeedError", "fit_fractional", "fit_linear_edge",
    "fractional_mean_forces", "law_sections", "mean_forces",
]  # fmt: skip

#: K_tc, K_te, K_rc, K_re, K_ac, K_ae as keys of JSON, in the order and the units of LinearEdgeLaw
NAMES = ("k_tc_n_per_mm2", "k_te_n_per_mm", "k_rc_n_per_mm2", "k_re_n_per_mm", "k_ac_n_per_mm2", "k_ae_n_per_mm")
LAWS = {"linear_edge": specs(LinearEdgeLaw), "fractional": specs(FractionalLaw)}
SCALE = np.array([spec.scale for spec in LAWS["linear_edge"]])  #: [N/m^2, N/m per file unit]
TOWARD_PART, INTO_HOLDER = -1.0, 1.0  #: s of F_z
POINTS = np.polynomial.legendre.leggauss(48)
#: k_0, h_s, r, k_r [N/m for 1 mm of depth, m]
START = np.array([getattr(KLIMCHIK2012, spec.name) for spec in LAWS["fractional"][:4]])
BOUNDS = np.array([1e3, 1e-7, 0.0, 0.0]) / START, np.array([1e9, 1e-2, 1.0, 10.0]) / START


class OneFeedError(MillingError):
    """The cuts do not identify the coefficients."""

    def __init__(self, feeds: int, cuts: int):
        self.feeds, self.cuts = feeds, cuts
        what = "one feed per tooth" if feeds == 1 else f"{feeds} feeds per tooth"
        super().__init__(
            f"{cuts} cuts at {what} do not identify the coefficients: cutting and edge coefficients need at least "
            "two feeds, tangential and radial ones two force components"
        )


@dataclass(frozen=True, eq=False)
class LawFit:
    """Coefficients of one force law, identified from cuts; NaN: not measured; infinite half width: not identified.

    linear_edge: K_tc, K_te, K_rc, K_re, K_ac, K_ae [N/m^2, N/m]; fractional: k_0, h_s, r, k_r, k_a [N/m for 1 mm of
    depth, m], k_a above 0 where the axial force pulls the tool toward the part.
    """

    law: str
    cuts: Cuts
    values: np.ndarray  #: (p,)
    half_widths: np.ndarray  #: of their 95 % intervals, (p,)
    modelled: np.ndarray  #: mean forces [N], (n, 3)
    axial: float = TOWARD_PART  #: s of F_z, from the sign of what was measured

    @property
    def residuals(self) -> np.ndarray:
        """Measured less modelled [N], (n, 3)."""
        return self.cuts.force - self.modelled

    @property
    def lateral_rms(self) -> float:
        """Of the residuals of F_x and F_y [N]."""
        return float(np.sqrt(np.nanmean(self.residuals[:, :2] ** 2)))

    @property
    def residual_rms(self) -> float:
        """Of the residuals that the fit minimised [N]; the fractional law has its axial ratio from a separate fit."""
        return self.lateral_rms if self.law == "fractional" else float(np.sqrt(np.nanmean(self.residuals**2)))

    def as_dict(self) -> dict:
        """Values and half widths in units of the parameter file."""
        fields = LAWS[self.law]
        keys = NAMES if self.law == "linear_edge" else [spec.key for spec in fields]
        scale = np.array([spec.scale for spec in fields])
        values, widths = (
            dict(zip(keys, (numbers / scale).tolist(), strict=True)) for numbers in (self.values, self.half_widths)
        )
        return {**values, "ci95": widths}


def mean_forces(cuts: Cuts, values, axial: float = TOWARD_PART) -> np.ndarray:
    """Mean forces on the tool [N], (n, 3), workpiece axes, by the linear-edge law; values and axial as in LawFit."""
    return _design(cuts, axial) @ np.nan_to_num(np.asarray(values, float))


def _design(cuts: Cuts, axial: float) -> np.ndarray:
    """Derivatives of the mean forces by the coefficients, (n, 3, 6)."""
    ends = np.stack([cuts.entry, cuts.exit])

    def between(integral):
        return np.diff(integral(ends), axis=0)[0]

    c_2 = between(lambda p: p / 2 + np.sin(2 * p) / 4)
    sc, c_1, s_1 = between(lambda p: np.sin(p) ** 2 / 2), between(np.sin), between(lambda p: -np.cos(p))
    one, f, zero = cuts.exit - cuts.entry, cuts.feed_per_tooth, np.zeros(len(cuts))
    rows = [
        [f * sc, s_1, -f * c_2, -c_1, zero, zero],
        [-cuts.tool.sense * term for term in (f * c_2, c_1, f * sc, s_1, zero, zero)],
        [zero, zero, zero, zero, axial * f * c_1, axial * one],
    ]
    share = cuts.tool.teeth * cuts.depth / (2 * np.pi)
    return share[:, None, None] * np.moveaxis(np.array(rows), -1, 0)


def fit_linear_edge(cuts: Cuts) -> LawFit:
    """The linear-edge law; raises OneFeedError. The axial pair only where fz was measured in two cuts at least."""
    axial = INTO_HOLDER if np.nansum(cuts.force[:, 2]) > 0.0 else TOWARD_PART
    design = _design(cuts, axial)
    values, widths = np.full(6, np.nan), np.full(6, np.nan)
    for axes, columns in (((0, 1), slice(0, 4)), ((2,), slice(4, 6))):
        used = np.isfinite(cuts.force[:, axes])
        if axes == (2,) and used.sum() < 2:
            continue
        weight = np.broadcast_to(cuts.sigma[:, None], used.shape)[used]
        a = design[:, axes, columns][used] / weight[:, None]
        try:
            values[columns], widths[columns] = solve(a, cuts.force[:, axes][used] / weight, cuts.sigma_known)
        except MixedUpError:
            raise OneFeedError(cuts.feeds, len(cuts)) from None
    return LawFit("linear_edge", cuts, values, widths, mean_forces(cuts, values, axial), axial)


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


def fit_fractional(cuts: Cuts) -> LawFit:
    """Non-linear least squares from the coefficients of [Klimchik2012]. Raises OneFeedError for fewer than 3 feeds."""
    if cuts.feeds < 3 or 2 * len(cuts) <= 4:
        raise OneFeedError(cuts.feeds, len(cuts))

    def left(x):
        return ((fractional_mean_forces(cuts, x * START) - cuts.force)[:, :2] / cuts.sigma[:, None]).ravel()

    solved = least_squares(left, np.ones(4), bounds=BOUNDS, x_scale="jac", xtol=1e-12, ftol=1e-12)
    freedom = 2 * len(cuts) - 4
    variance = scatter(2 * solved.cost, freedom, cuts.sigma_known)
    quantile = half_interval(freedom, cuts.sigma_known)
    _, singular, turned = np.linalg.svd(solved.jac, full_matrices=False)
    with np.errstate(divide="ignore"):
        inverse = (turned.T / np.where(singular > 1e-9 * singular[0], singular, 0.0) ** 2) @ turned
    widths = np.nan_to_num(quantile * np.sqrt(variance * np.diag(inverse)) * START, nan=np.inf)
    ratio, width = _axial(cuts, solved.x * START)
    values = np.append(solved.x * START, ratio)
    return LawFit("fractional", cuts, values, np.append(widths, width), fractional_mean_forces(cuts, values))


def _axial(cuts: Cuts, values: np.ndarray) -> tuple[float, float]:
    """k_a and its half width by a line through 0: F_z over the mean tangential force."""
    seen = np.isfinite(cuts.force[:, 2])
    if seen.sum() < 2:
        return np.nan, np.nan
    unit = fractional_mean_forces(cuts, [*values, 1.0])[seen, 2] / cuts.sigma[seen]
    ratio, width = solve(unit[:, None], cuts.force[seen, 2] / cuts.sigma[seen], cuts.sigma_known)
    return float(ratio[0]), float(width[0])


def law_sections(law: str, values, half_widths, axial: float = TOWARD_PART) -> dict:
    """Return the sections of a parameter file: the law with its coefficients, and their uncertainty for the verdict.

    ``uncertainty.force_coefficients`` requires the intervals of all coefficients that the verdict draws; those of the
    axial force follow if they were measured.
    """
    group, relative = {}, {}
    for spec, value, width in zip(LAWS[law], values, half_widths, strict=True):
        if np.isnan(value):
            continue
        relative[spec.name] = width / 1.96 / max(abs(value), 1e-300)
        value = value * axial / TOWARD_PART if spec.name.startswith("axial") else max(value, 0.0)
        known = "" if np.isnan(width) else f"95 % +- {width / spec.scale:.3g}"
        group[spec.key] = (float(value / spec.scale), known)
    sections = {"cutting": {"law": law, law: group}}
    drawn = [*SCATTERED[law], *(SCATTERED_AXIAL[law] if set(SCATTERED_AXIAL[law]) <= set(relative) else ())]
    spread = np.array([relative.get(name, np.nan) for name in drawn])
    if np.isfinite(spread).all():
        shown = np.clip(spread, 1e-4, 1.0).tolist()
        sections["uncertainty"] = {"force_coefficients": (shown, "standard deviations from the same fit")}
    return sections
