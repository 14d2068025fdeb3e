"""Units of parameter files, and nanoseconds as text."""

from __future__ import annotations

import math

SECOND = 1_000_000_000  # [ns]
#: file unit -> factor to SI
UNITS = {
    "": 1.0, "m": 1.0, "mm": 1e-3, "um": 1e-6, "s": 1.0, "ms": 1e-3, "kg": 1.0, "n": 1.0, "hz": 1.0, "w": 1.0,
    "deg": math.pi / 180, "arcsec": math.pi / 648000,
    "rpm": 2 * math.pi / 60, "m_per_min": 1 / 60, "mm_per_min": 1e-3 / 60, "mm_per_s": 1e-3,
    "m_per_s": 1.0, "m_per_s2": 1.0, "m_per_s3": 1.0, "deg_per_s": math.pi / 180, "deg_per_s2": math.pi / 180,
    "urad_per_n_m": 1e-6, "n_per_m": 1.0, "n_per_mm": 1e3, "n_per_mm2": 1e6, "um_per_n": 1e-6, "kw": 1e3, "n_m": 1.0,
    "kg_m2": 1.0, "gpa": 1e9, "n_per_um": 1e6, "mb": 1e6,
}  # fmt: skip


def seconds(ns: int) -> str:
    """Return nanoseconds as decimal seconds with all digits: 1500000000 is "1.500000000"."""
    whole, rest = divmod(abs(ns), SECOND)
    return f"{'-' if ns < 0 else ''}{whole}.{rest:09d}"
