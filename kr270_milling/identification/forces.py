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

import difflib
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import specs
from kr270_milling.base.table import read_table
from kr270_milling.cutting.laws import KLIMCHIK2012, FractionalLaw, fractional
from kr270_milling.identification.cuts import Cuts
from kr270_milling.identification.intervals import MixedUpError, half_interval, scatter, solve

__all__ = [
    "FILE", "NAMES", "TOWARD_PART", "Coefficients", "FractionalFit", "Material", "OneFeedError", "find_material",
    "fit_fractional", "fit_linear_edge", "fractional_mean_forces", "materials", "mean_forces",
]  # fmt: skip

#: K_tc, K_te, K_rc, K_re, K_ac, K_ae as keys of JSON and file units [N/m^2, N/m per file unit]
NAMES = ("k_tc_n_per_mm2", "k_te_n_per_mm", "k_rc_n_per_mm2", "k_re_n_per_mm", "k_ac_n_per_mm2", "k_ae_n_per_mm")
SCALE = np.array([1e6, 1e3, 1e6, 1e3, 1e6, 1e3])
TOWARD_PART, INTO_HOLDER = -1.0, 1.0  #: s of F_z


class OneFeedError(MillingError):
    """The cuts do not tell the coefficients apart."""

    def __init__(self, feeds: int, cuts: int):
        self.feeds, self.cuts = feeds, cuts
        what = "one feed per tooth" if feeds == 1 else f"{feeds} feeds per tooth"
        super().__init__(
            f"{cuts} cuts at {what} do not tell the coefficients apart: cutting and edge coefficients need at least "
            "two feeds, tangential and radial ones two force components"
        )


@dataclass(frozen=True, eq=False)
class Coefficients:
    """What the cuts say; NaN: not measured."""

    cuts: Cuts
    values: np.ndarray  #: K_tc, K_te, K_rc, K_re, K_ac, K_ae [N/m^2, N/m], (6,)
    half_widths: np.ndarray  #: of their 95 % intervals, (6,)
    residuals: np.ndarray  #: measured less modelled [N], (n, 3)
    axial: float = TOWARD_PART  #: s of F_z, from the sign of what was measured

    @property
    def residual_rms(self) -> float:
        """[N], of what was measured."""
        return float(np.sqrt(np.nanmean(self.residuals**2)))


def mean_forces(cuts: Cuts, values, axial: float = TOWARD_PART) -> np.ndarray:
    """Mean forces on the tool [N], (n, 3), workpiece axes; values and axial as in Coefficients."""
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


def fit_linear_edge(cuts: Cuts) -> Coefficients:
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
    residuals = cuts.force - mean_forces(cuts, values, axial)
    return Coefficients(cuts, values, widths, residuals, axial)


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
    ratio, width = solve(unit[:, None], cuts.force[seen, 2] / cuts.sigma[seen], cuts.sigma_known)
    return float(ratio[0]), float(width[0])


FILE = "materials.csv"
COLUMNS = ("material", "cutter", "lubrication", *NAMES, "reference")
SOURCE = "Chinese Journal of Mechanical Engineering (2021), doi 10.1186/s10033-021-00536-9, table 5"


@dataclass(frozen=True, eq=False)
class Material:
    """One row of the table."""

    name: str
    cutter: str
    lubrication: str
    values: np.ndarray  #: K_tc, K_te, K_rc, K_re, K_ac, K_ae [N/m^2, N/m], (6,), NaN: not given
    source: str


def materials() -> list[Material]:
    """All rows."""
    table = read_table(find_file(FILE), COLUMNS, COLUMNS)
    values = table.numbers(NAMES, np.nan) * SCALE
    texts = zip(*(table.texts(name) for name in ("material", "cutter", "lubrication", "reference")), strict=True)
    return [
        Material(name, cutter, cooling, row, f"{SOURCE}, reference [{reference}] there")
        for (name, cutter, cooling, reference), row in zip(texts, values, strict=True)
    ]


def find_material(name: str) -> list[Material]:
    """The rows of a material, in any case; raises InputError with the known ones."""
    rows = materials()
    found = [row for row in rows if row.name.lower() == name.lower()]
    if not found:
        known = sorted({row.name for row in rows})
        near = difflib.get_close_matches(name, known, 1, 0.4)
        hint = f"; did you mean {near[0]}?" if near else f"; it has {', '.join(known)}"
        raise InputError(FILE, f"has no material {name[:40]!r}{hint}")
    return found
