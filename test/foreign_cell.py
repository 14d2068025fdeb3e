"""A robot and a force sensor with their own clocks: stamps of the wall clock, jitter, lost messages."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.samples import PoseSample, WrenchSample

WALL = 1_700_000_000_123_456_789  # [ns]
PERIOD, JITTER, SENSOR = 4_000_000, 500_000, 1_000_000  # [ns]
LOST = 0.02  # share of the poses
STANDING = 300_000_000  # [ns] before and after the motion
DOWN = np.array([1.0, 0.0, 0.0, 0.0])


def foreign_pass(result, number: int, noise: float = 0.0) -> list[PoseSample | WrenchSample]:
    """Return the messages of a simulated pass as this cell publishes them, by stamp; noise [m]: of the poses."""
    random = np.random.default_rng(number)
    end, start = int(result.time_ns[-1]) + STANDING, WALL + number * 10**10
    posed = np.arange(-STANDING, end, PERIOD)
    posed = (posed + random.integers(-JITTER, JITTER, posed.size))[random.random(posed.size) > LOST]
    place = np.column_stack([np.interp(posed, result.time_ns, axis) for axis in result.tool.T])
    place += random.normal(0.0, noise, place.shape)
    sensed = np.arange(-STANDING, end, SENSOR)
    force = np.column_stack([np.interp(sensed, result.time_ns, a, left=0.0, right=0.0) for a in result.wrench.T])
    poses = [PoseSample(start + ns, "workpiece", row, DOWN) for ns, row in zip(posed.tolist(), place, strict=True)]
    wrenches = [WrenchSample(start + ns, "workpiece", row) for ns, row in zip(sensed.tolist(), force, strict=True)]
    return sorted([*poses, *wrenches], key=lambda sample: sample.stamp)
