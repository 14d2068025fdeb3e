"""Cuts with known force coefficients."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from kr270_milling.physics.cutting import LinearEdgeLaw, Tool
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
