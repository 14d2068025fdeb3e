"""Tables of points with an axis: a finish of a wavy surface by a leaning ball, and a swarf cut of a leaning wall."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

COMMON = ("tool.diameter_mm=10", "timing.jerk_m_per_s3=20", "compensation.method=inverse", "compensation.repeat=true")
#: name -> settings of the cell beside ``COMMON``, on ``test_piece.yaml``
CELLS = {
    "swarf": ("tool.type=bull_nose", "tool.corner_radius_mm=2", "stock.min_mm=[-15,-12,-8]", "stock.max_mm=[15,1.6,0]"),
    "flat swarf": ("tool.type=flat", "stock.min_mm=[-15,-12,-8]", "stock.max_mm=[15,1.6,0]"),
    "finish": ("tool.type=ball", "stock.min_mm=[-12,-8,-8]", "stock.max_mm=[12,8,0]"),
}


def table(rows: Iterable) -> str:
    """CSV of points and axes; F900."""
    lines = [",".join(f"{value:.6f}" for value in [*place, *axis]) for place, axis in rows]
    return "\n".join(["x_mm,y_mm,z_mm,i,j,k,feed_mm_per_min", *(f"{line},900" for line in lines), ""])


def swarf(lead: float = 0.0) -> Iterable:
    """A wall 6 mm high that leans by 10 to 20 deg; the axis is in the wall but for a lead [deg], the tip at its foot.

    An end face that moves in its own plane is pressed out by each vibration, so that a flat end needs a lead.
    """
    ahead = math.radians(lead)
    for x in np.arange(-26.0, 26.1):
        lean = math.radians(15.0 + 5.0 * math.sin(math.pi * x / 40.0))
        out = np.array([0.0, -math.cos(lean), math.sin(lean)])
        yield (
            np.array([x, 0.0, -6.0]) + 5.0 * out,
            (
                math.sin(ahead),
                math.cos(ahead) * math.sin(lean),
                math.cos(ahead) * math.cos(lean),
            ),
        )


def finish() -> Iterable:
    """Three rows 0.3 mm apart, 0.25 to 0.75 mm deep, along x and back, of a ball that leans by 20 deg."""
    wave, axis = math.pi / 20.0, np.array([0.0, math.sin(math.radians(20.0)), math.cos(math.radians(20.0))])
    for row, way in enumerate((1, -1, 1)):
        for x in np.arange(-19.0, 19.1, 0.5)[::way]:
            slope = -0.25 * wave * math.sin(wave * x)
            normal = np.array([-slope, 0.0, 1.0]) / math.hypot(slope, 1.0)
            yield np.array([x, 0.3 * (row - 1), 0.25 * math.cos(wave * x) - 0.5]) + 5.0 * (normal - axis), axis


ROWS = {"swarf": swarf, "flat swarf": swarf, "finish": finish}
