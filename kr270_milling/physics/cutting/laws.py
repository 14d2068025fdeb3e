"""The section ``cutting`` of a parameter file: the force laws and their table.

The fractional law (26)-(28) [Klimchik2014]; the linear-edge law [Altintas2012, section 2.8], a part that grows with
the chip and a part of the edge; published coefficients of materials, the rows of ``config/materials.csv``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.errors import ConfigError, InputError, ParameterError, nearest
from kr270_milling.base.extensions import load_as, registered
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import Record, parameter, specs
from kr270_milling.base.table import read_table
from kr270_milling.physics.cutting.force_law import ChartLine, Cuts, ForceLaw


@njit(cache=True, error_model="numpy")
def linear_edge(h, k_c, k_e):
    """F / a_p = k_c h + k_e where h > 0, else 0, [N/m]; h: number or array [m]; k_c [N/m^2], k_e [N/m]."""
    return k_c * np.maximum(h, 0.0) + k_e * (h > 0.0)


def _edge_force(h, tangential_cutting, tangential_edge, radial_cutting, radial_edge, axial_cutting, axial_edge):
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

    force = staticmethod(_edge_force)
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


#: The paper's k_0 is read as the slope for one millimetre of depth: F_t = k_0 h_s psi(h / h_s) a_p / (1 mm).
READING_DEPTH = 1e-3  # [m]


@njit(cache=True, error_model="numpy")
def fractional(h, k_0, h_s, r):
    """F_t / a_p = k_0 h_s (u + r u^2) / (1 + u) / (1 mm), u = h / h_s   (26), (27) [Klimchik2014], [N/m].

    h: chip thickness, number or array [m]; k_0 [N/m for 1 mm of depth]; h_s [m]; r = k_inf / k_0.
    """
    u = np.maximum(h, 0.0) / h_s
    return k_0 * h_s * (u + r * u * u) / (1.0 + u) / READING_DEPTH


def _fractional_force(h, stiffness, specific_chip_thickness, ratio, radial_ratio, axial_ratio):
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

    force = staticmethod(_fractional_force)
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


#: every force law, by its name in a parameter file
LAWS: dict[str, type[ForceLaw]] = {"fractional": FractionalLaw, "linear_edge": LinearEdgeLaw}


def _is_law(kind) -> bool:
    return isinstance(kind, type) and issubclass(kind, ForceLaw)


LAWS |= {point.name: load_as(point, _is_law, "subclass of ForceLaw") for point in registered("force_laws", LAWS)}


def refuse_fault(name: str, law: type[ForceLaw]) -> None:
    """Raise ConfigError for a law that cannot be used."""
    if law.fault():
        raise ConfigError(f"force law {name}", "", None, law.fault())


for name, law in LAWS.items():
    refuse_fault(name, law)


def _with_laws(record: type) -> type:
    """Give a record a group of coefficients for each law, after its first field."""
    first, *others = record.__annotations__.items()
    record.__annotations__ = dict([first, *((name, law) for name, law in LAWS.items()), *others])
    for name, law in LAWS.items():
        setattr(record, name, law())
    return record


@dataclass(frozen=True, eq=False)
@_with_laws
class Cutting(Record):
    """YAML ``cutting``: which law applies, and its coefficients; raises ParameterError for a missing coefficient."""

    law: str = parameter("fractional", choices=tuple(LAWS), text="force law")
    chip_angle: str = parameter(
        "previous_centre",
        choices=("previous_centre", "nominal"),
        text="dphi of h = A / (R dphi): as seen from the tool centre of the step before, as section 4 has it; nominal: "
        "the spindle's, which damps vibrations along the tooth's motion too much",
    )
    detail: str = parameter(
        "auto",
        choices=("teeth", "engagement", "auto"),
        text="model of the cut: the sweep of the teeth, or the mean force of the engagement for long programs; auto: "
        "teeth for a straight cut and for programs of up to 60 s of cutting with an upright flat end",
    )
    # assumed: the dish of an end mill keeps the inner part of its end off the floor; no measured thrust is published
    end_share: float = parameter(
        0.2,
        low=0.0,
        high=1.0,
        text="share of the radius over which the end edge of a sinking tool touches the floor",
    )
    moments: bool = parameter(
        True, text="moments of the forces about the tool tip, reaction torque of the spindle; false: forces only, (29)"
    )

    def check(self) -> None:
        for spec in specs(type(self.active)):
            if math.isnan(getattr(self.active, spec.name)):
                must = f"given where cutting.law is {self.law}: {spec.allowed} ({spec.text})"
                raise ParameterError(f"{self.law}.{spec.key}", None, must)
        # the ranges of the coefficients leave no other forces of the laws of this file
        wrong = "" if type(self.active).__module__ == __name__ else self.active.wrong_forces()
        if wrong:
            raise ParameterError("law", self.law, f"a law of finite forces whose F_t is not negative, but {wrong}")

    @property
    def by_engagement(self) -> bool:
        """Return whether the model of the cut is the mean force of the engagement, and not the sweep of the teeth."""
        return self.detail == "engagement"

    @property
    def active(self) -> ForceLaw:
        """The law that applies, with its coefficients."""
        return getattr(self, self.law)

    @property
    def coefficients(self) -> np.ndarray:
        """Coefficients of the law that applies [SI], (p,)."""
        return self.active.coefficients

    @property
    def axial(self) -> bool:
        """Return whether the law has an axial force at all."""
        return self.active.axial

    def force_per_depth(self, h):
        """Tangential and radial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return self.active.per_depth(h)[:2]

    def axial_per_depth(self, h):
        """Axial force per depth of cut [N/m] at chip thickness h [m] (number or array)."""
        return self.active.per_depth(h)[2]


FILE = "materials.csv"
#: K_tc, K_te, K_rc, K_re, K_ac, K_ae as keys of JSON, in the order and the units of LinearEdgeLaw
NAMES = LinearEdgeLaw.result_keys()
SCALE = np.array([spec.scale for spec in specs(LinearEdgeLaw)])  #: [N/m^2, N/m per file unit]


@dataclass(frozen=True, eq=False)
class Material:
    """A row of the file."""

    name: str
    cutter: str
    lubrication: str
    values: np.ndarray  #: K_tc, K_te, K_rc, K_re, K_ac, K_ae [N/m^2, N/m], (6,), NaN: not given
    source: str


def materials() -> list[Material]:
    """All rows, in the order of the file."""
    fields = ("material", "cutter", "lubrication", "reference")
    columns = (*fields, *NAMES)
    table = read_table(find_file(FILE), columns, columns)
    values = table.numbers(NAMES, np.nan) * SCALE
    texts = zip(*map(table.texts, fields), strict=True)
    journal = "Chinese Journal of Mechanical Engineering (2021), doi 10.1186/s10033-021-00536-9, table 5"
    return [
        Material(name, cutter, cooling, row, f"{journal}, reference [{reference}] there")
        for (name, cutter, cooling, reference), row in zip(texts, values, strict=True)
    ]


def spread(name: str) -> float | None:
    """Relative standard deviation of the published K_tc of an alloy of any temper; None: fewer than 3 rows."""
    alloy = name.lower().partition("-")[0]
    rows = [row.values[0] for row in materials() if row.name.lower().partition("-")[0] == alloy]
    return float(np.std(np.log(rows), ddof=1)) if len(rows) >= 3 else None


def find_material(name: str) -> list[Material]:
    """The rows of a material, in any case; raises InputError with the known ones."""
    rows = materials()
    matches = [row for row in rows if row.name.lower() == name.lower()]
    if not matches:
        known = sorted({row.name for row in rows})
        hint = nearest(name, known, f"; it has {', '.join(known)}")
        raise InputError(FILE, f"has no material {name[:40]!r}{hint}")
    return matches
