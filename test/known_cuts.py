"""Cuts with known force coefficients; ``python test/known_cuts.py`` makes config/cuts.csv, which a test compares."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from kr270_milling.base.table import write_table
from kr270_milling.physics.cutting import LinearEdgeLaw, Tool
from kr270_milling.physics.cutting.materials import find_material
from kr270_milling.studies.identification.cuts import CutMeasurements, engagement_angles

TOOL = Tool(diameter=0.02, teeth=4, spindle_speed=8000 * 2 * math.pi / 60)
TRUE = np.array([767.01e6, 27.7e3, 168.8e6, 26.6e3, 222e6, 0.7e3])
FEEDS = (0.05e-3, 0.1e-3, 0.15e-3, 0.2e-3)


def cuts(mode="slot", width=0.02, feeds=FEEDS, tool=TOOL, depth=1e-3) -> CutMeasurements:
    n = len(feeds)
    entry, leave = engagement_angles(mode, width, tool.diameter)
    force = np.full((n, 3), np.nan)
    return CutMeasurements(
        tool, np.array(feeds), np.full(n, depth), np.full(n, entry), np.full(n, leave), force, np.ones(n), False
    )


def measured(some: CutMeasurements, values=TRUE, rng=None, sigma=0.0) -> CutMeasurements:
    force = LinearEdgeLaw(*map(float, values)).mean_forces(some)
    return dataclasses.replace(some, force=force if rng is None else force + sigma * rng.normal(size=force.shape))


CONFIG = Path(__file__).resolve().parents[1] / "config"
NOTES = [
    "EXAMPLE, NOT MEASURED: mean forces of slots and of half immersion up-milling by the closed forms, for the tool of",
    "config/test_piece.yaml and the second row of Al7075-T6 in config/materials.csv, with normal noise of 2 N; replace",
    "this table by your own. Forces on the tool, workpiece axes, x along the feed.",
]
ROWS = [(f, mode, width) for mode, width in (("slot", 20.0), ("up", 10.0)) for f in (0.05, 0.08, 0.11, 0.14, 0.17, 0.2)]
NAMES = ("feed_per_tooth_mm", "depth_mm", "width_mm", "mode", "fx_n", "fy_n", "fz_n")


def example_cuts(path) -> None:
    """The table of cuts."""
    tool = Tool(diameter=0.02, teeth=4, spindle_speed=8000 * 2 * math.pi / 60)
    entry, leave = np.array([engagement_angles(mode, 1e-3 * width, tool.diameter) for _, mode, width in ROWS]).T
    n = len(ROWS)
    feed = 1e-3 * np.array([f for f, _, _ in ROWS])
    some = CutMeasurements(tool, feed, np.full(n, 1e-3), entry, leave, np.full((n, 3), np.nan), np.ones(n), False)
    force = LinearEdgeLaw(*np.nan_to_num(find_material("Al7075-T6")[1].values).tolist()).mean_forces(some)
    force = force + 2.0 * np.random.default_rng(7075).normal(size=force.shape)
    rows = [[f, 1.0, width, mode, *(f"{v:.2f}" for v in force[i])] for i, (f, mode, width) in enumerate(ROWS)]
    write_table(path, NAMES, rows, NOTES)


if __name__ == "__main__":
    example_cuts(CONFIG / "cuts.csv")
