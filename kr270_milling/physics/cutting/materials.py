"""Published force coefficients of materials: the rows of ``config/materials.csv``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError, nearest
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import specs
from kr270_milling.base.table import read_table
from kr270_milling.physics.cutting.linear_edge import LinearEdgeLaw

FILE = "materials.csv"
#: K_tc, K_te, K_rc, K_re, K_ac, K_ae as keys of JSON, in the order and the units of LinearEdgeLaw
NAMES = LinearEdgeLaw.result_keys()
SCALE = np.array([spec.scale for spec in specs(LinearEdgeLaw)])  #: [N/m^2, N/m per file unit]
TEXTS = ("material", "cutter", "lubrication", "reference")


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
    columns = (*TEXTS, *NAMES)
    table = read_table(find_file(FILE), columns, columns)
    values = table.numbers(NAMES, np.nan) * SCALE
    texts = zip(*map(table.texts, TEXTS), strict=True)
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
